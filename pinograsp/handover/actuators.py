"""What a MuJoCo model's actuators must be told so that a hand follows a trajectory.

The model comes from outside: its arrays are read, the package itself is not needed.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, shown
from pinograsp.errors import InvalidInput
from pinograsp.hands.coupling import Coupling
from pinograsp.spatial import Array
from pinograsp.words import printable
from pinograsp.writing import write_file

_SLACK = 1e-6  # beyond a control range, in its unit
# MuJoCo's numbers for transmissions by joints and tendons, fixed tendons, and joints of one degree of freedom.
_JOINT, _TENDON, _WRAPS_JOINT, _SCALAR = (0, 1), 3, 1, (2, 3)


class Driven(Protocol):
    """A trajectory, as far as its actuators are concerned; the fields are those of ``JointTrajectory``."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joints (n,)."""

    @property
    def times(self) -> Array:
        """(m,) [s]."""

    @property
    def q(self) -> Array:
        """Positions (m, n)."""

    @property
    def dq(self) -> Array:
        """Rates (m, n)."""

    @property
    def effort(self) -> Array:
        """Feed-forward (m, n)."""

    @property
    def couplings(self) -> Mapping[str, Coupling]:
        """By coupled joint."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Controls:
    """What a model gets over time.

    Attributes:
        qpos: (m, nq).
        qvel: (m, nv).
        ctrl: (m, nu).
        joints: names of the joints in ``qpos``.
        actuators: names of the actuators (nu,).
        notes: what does not fit.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    notes: tuple[str, ...] = ()


def controls(
    model: Any, own: Driven, every: Driven, qpos: ArrayLike | None, feed_forward: bool, prefix: str
) -> Controls:
    """The controls of a ``mujoco.MjModel``, at which its actuators make what the trajectory asks for.

    Args:
        own: the trajectory.
        every: the same with coupled joints.
        qpos: of all else (nq,); None: the model's ``qpos0``.
        feed_forward: whether actuators make the trajectory's effort.
        prefix: of the joints' names in the model.

    Raises:
        InvalidInput: not a model, or one without the hand's joints.
    """
    try:
        joints = [model.joint(j).name for j in range(model.njnt)]
        actuators = [model.actuator(u).name or f"actuator {u}" for u in range(model.nu)]
    except (AttributeError, TypeError) as error:
        raise InvalidInput(f"model: expected a mujoco.MjModel, got {shown(model)}") from error
    missing = [prefix + name for name in every.names if prefix + name not in joints]
    if missing:
        raise InvalidInput(
            f"model: expected the joints {', '.join(missing)}, it has {', '.join(joints) or 'none'}: see prefix="
        )
    base = model.qpos0 if qpos is None else array_of("qpos", qpos, (model.nq,))
    m, place = every.times.size, {name: joints.index(prefix + name) for name in every.names}
    positions, velocities = np.tile(base, (m, 1)), np.zeros((m, model.nv))
    for column, j in enumerate(place.values()):
        positions[:, model.jnt_qposadr[j]] = every.q[:, column]
        velocities[:, model.jnt_dofadr[j]] = every.dq[:, column]
    length, speed = np.zeros((m, model.nu)), np.zeros((m, model.nu))
    moments = np.zeros((model.nu, len(own.names)))
    unknown: set[int] = set()
    notes: list[str] = []
    leads = {place[name]: (own.names.index(name), 1.0) for name in own.names}
    leads |= {
        place[name]: (own.names.index(c.followed), c.factor) for name, c in own.couplings.items() if name in place
    }
    for u in range(model.nu):
        pulls = _pulls(model, u)
        if pulls is None or model.actuator_gaintype[u] > 1 or model.actuator_biastype[u] > 1:
            unknown.add(u)
            continue
        for j, arm in pulls:
            length[:, u] += arm * positions[:, model.jnt_qposadr[j]]
            speed[:, u] += arm * velocities[:, model.jnt_dofadr[j]]
            if j in leads:
                moments[u, leads[j][0]] += arm * leads[j][1]
    # Actuators that share a joint share its effort: the least sum of squares.
    force = own.effort @ np.linalg.pinv(moments) if feed_forward and model.nu else np.zeros_like(length)
    (g0, g1, g2), (b0, b1, b2) = model.actuator_gainprm[:, :3].T, model.actuator_biasprm[:, :3].T
    affine = model.actuator_gaintype == 1
    gain = g0 + np.where(affine, g1 * length + g2 * speed, 0.0)
    bias = np.where(model.actuator_biastype == 1, b0 + b1 * length + b2 * speed, 0.0)
    usable = np.array([u not in unknown for u in range(model.nu)]) & (gain != 0).all(axis=0)
    ctrl = np.where(usable, (force - bias) / np.where(gain == 0, 1.0, gain), 0.0)
    idle = [name for name, column in zip(own.names, moments.T) if not column.any() and name not in own.couplings]
    low, high = model.actuator_ctrlrange.T
    beyond = model.actuator_ctrllimited.astype(bool) & ((ctrl < low - _SLACK) | (ctrl > high + _SLACK)).any(axis=0)
    for names, what in (
        (idle, "no actuator of the model moves"),
        (
            [a for a, ok in zip(actuators, usable) if not ok],
            "controls are 0, not joints or fixed tendons with affine gains:",
        ),
        ([a for a, out in zip(actuators, beyond) if out], "controls leave their range:"),
        ([a for a, kind in zip(actuators, model.actuator_dyntype) if kind], "controls act with a delay of their own:"),
    ):
        notes += [f"{what} {', '.join(names)}"] if names else []
    return Controls(
        qpos=positions,
        qvel=velocities,
        ctrl=ctrl,
        joints=tuple(joints),
        actuators=tuple(actuators),
        notes=tuple(notes),
    )


def keyframes(times: Array, found: Controls, keys: Mapping[str, int]) -> list[str]:
    """Lines of XML: names in comments, and keyframes at the samples ``keys``, in their order."""
    lines = [
        # no comment may hold two hyphens in a row
        f"<!-- {what}: {re.sub('-(?=-)', '- ', ', '.join(map(printable, names)))} -->"
        for what, names in (("qpos", found.joints), ("ctrl", found.actuators))
    ]
    for name, i in sorted(keys.items(), key=lambda key: key[1]):
        values = {"time": times[i : i + 1], "qpos": found.qpos[i], "qvel": found.qvel[i], "ctrl": found.ctrl[i]}
        attributes = " ".join(f"{k}={quoteattr(' '.join(map(repr, v.tolist())))}" for k, v in values.items() if v.size)
        lines.append(f'<key name="{name}" {attributes}/>')
    return lines


def archive(times: Array, found: Controls) -> bytes:
    """The controls over time as an ``.npz``."""
    written = io.BytesIO()
    np.savez_compressed(
        written,
        times=times,
        qpos=found.qpos,
        qvel=found.qvel,
        ctrl=found.ctrl,
        joints=np.array(found.joints, dtype=str),
        actuators=np.array(found.actuators, dtype=str),
    )
    return written.getvalue()


def write_keyframes(path: Path, times: Array, impact_time: float | None, found: Controls) -> None:
    """Write keyframes ``start``, ``impact`` and ``final`` to be included, and the controls beside them."""
    last = times.size - 1
    keys = {"start": 0, "final": last}
    if impact_time is not None:  # the first sample that touches
        keys["impact"] = min(int(np.searchsorted(times, impact_time - 1e-9)), last)
    inner = "\n".join(f"    {line}" for line in keyframes(times, found, keys))
    write_file(path.with_suffix(".npz"), archive(times, found))
    write_file(path, f"<mujoco>\n  <keyframe>\n{inner}\n  </keyframe>\n</mujoco>\n".encode())


def _pulls(model: Any, u: int) -> list[tuple[int, float]] | None:
    """Joints that an actuator moves, and the arm of each; None for what is not a joint or a fixed tendon."""
    kind, target, gear = model.actuator_trntype[u], model.actuator_trnid[u, 0], float(model.actuator_gear[u, 0])
    if kind in _JOINT:
        pulls = [(int(target), gear)]
    elif kind == _TENDON:
        wraps = range(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
        if any(model.wrap_type[w] != _WRAPS_JOINT for w in wraps):
            return None
        pulls = [(int(model.wrap_objid[w]), gear * float(model.wrap_prm[w])) for w in wraps]
    else:
        return None
    return pulls if all(model.jnt_type[j] in _SCALAR for j, _ in pulls) else None
