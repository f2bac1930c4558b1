"""Controls of somebody's own MuJoCo model, at which a hand in it follows a trajectory, and what does not fit."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.handover.actuators import Controls
from pinograsp.handover.model_actuators import SLACK, Actuators, Path, Played
from pinograsp.handover.samples import JointSamples

# Efforts that the actuators do not make are told from this share of the largest on, and where joints would accelerate
# by so much [rad/s^2 or m/s^2].
_UNDONE, _ACCELERATED = 1e-3, 0.1
_APART = 1e-3  # [rad or m] by which constraints of the model may be violated on the way
_SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


def controls(
    model: Any, own: JointSamples, every: JointSamples, qpos: ArrayLike | None, feed_forward: bool, prefix: str
) -> Controls:
    """The controls of a ``mujoco.MjModel``, at which its hand moves as the trajectory and presses with its forces.

    Args:
        own: the trajectory.
        every: the same with coupled joints.
        qpos: of all else (nq,), which is taken to be at rest; None: the model's ``qpos0``.
        feed_forward: False: actuators make no force at the trajectory's state.
        prefix: of the joints' names in the model.

    Raises:
        InvalidInput: not a model, one without the hand's joints, or one whose dynamics are not finite.
    """
    if not isinstance(model, mujoco.MjModel):
        raise InvalidInput(f"model: expected a mujoco.MjModel, got {shorten(model)}")
    path = _path(model, own, every, qpos, prefix)
    try:
        played = Actuators(model).play(path, own, feed_forward)
        notes = _notes(model, path, own, played, feed_forward)
    except mujoco.FatalError as error:
        raise InvalidInput(f"model: expected one that MuJoCo can compute, got its error: {error}") from error
    if not (np.isfinite(played.ctrl).all() and np.isfinite(played.act).all()):
        raise InvalidInput(
            "model: expected one with finite dynamics in the hand's postures, got none: check its masses"
        )
    return Controls(
        qpos=path.qpos,
        qvel=path.qvel,
        act=played.act,
        ctrl=played.ctrl,
        joints=tuple(model.joint(j).name for j in range(model.njnt)),
        actuators=_inputs(model),
        notes=tuple(notes),
    )


def _inputs(model: Any) -> tuple[str, ...]:
    """Names of the controls (nu,): their actuators', a number behind where an actuator has several."""
    names = [""] * model.nu
    for u in range(model.nactuator):
        name = model.actuator(u).name or f"actuator {u}"
        for k in range(model.actuator_ctrlnum[u]):
            names[model.actuator_ctrladr[u] + k] = f"{name} {k + 1}" if k else name
    return tuple(names)


def _path(model: Any, own: JointSamples, every: JointSamples, qpos: ArrayLike | None, prefix: str) -> Path:
    """The trajectory in the model's coordinates; :class:`InvalidInput` where the model has not its joints."""
    joints = {model.joint(j).name: j for j in range(model.njnt) if model.jnt_type[j] in _SCALAR}
    missing = [prefix + name for name in every.names if prefix + name not in joints]
    if missing:
        raise InvalidInput(
            f"model: expected the joints {', '.join(missing)}, it has {', '.join(joints) or 'none'}: see prefix="
        )
    base = model.qpos0 if qpos is None else array_of("qpos", qpos, (model.nq,))
    m, place = every.times.size, {name: joints[prefix + name] for name in every.names}
    found = np.tile(base, (m, 1)), np.zeros((m, model.nv)), np.zeros((m, model.nv))
    for column, j in enumerate(place.values()):
        found[0][:, model.jnt_qposadr[j]] = every.q[:, column]
        found[1][:, model.jnt_dofadr[j]] = every.dq[:, column]
        found[2][:, model.jnt_dofadr[j]] = every.ddq[:, column]
    leads = np.zeros((model.nv, len(own.names)))
    for k, name in enumerate(own.names):
        leads[model.jnt_dofadr[place[name]], k] = 1.0
    for name, c in own.couplings.items():
        if name in place and name not in own.names:
            leads[model.jnt_dofadr[place[name]], own.names.index(c.followed)] = c.factor
    return Path(qpos=found[0], qvel=found[1], qacc=found[2], leads=leads, place=place)


def _notes(model: Any, path: Path, own: JointSamples, played: Played, feed_forward: bool) -> list[str]:
    """What does not fit."""
    names = [model.actuator(u).name or f"actuator {u}" for u in range(model.nactuator)]
    low, high = model.actuator_ctrlrange.T
    limited = model.actuator_ctrllimited.astype(bool)
    beyond = limited & ((played.ctrl < low - SLACK) | (played.ctrl > high + SLACK)).any(axis=0)
    notes = [
        f"{what} {', '.join(which)}"
        for which, what in (
            (
                [name for name, moved in zip(own.names, played.moved) if not moved and name not in own.couplings],
                "no actuator of the model moves",
            ),
            (
                [name for name, idle in zip(names, played.idle) if idle],
                "controls are 0 where they have no effect on joints:",
            ),
            ([name for name, out in zip(_inputs(model), beyond) if out], "controls leave their range:"),
            ([name for name, delay in zip(names, model.actuator_delay) if delay], "controls act with a delay:"),
        )
        if which
    ]
    if any(played.used & (np.array(model.actuator_actnum) > 0)):
        notes.append("actuators have activations: start from the keyframe, or with the archive's act")
    size, joint, acceleration, i = played.off
    bound = [name for name, there in zip(names, played.bound) if there]
    if feed_forward and (size > _UNDONE * played.largest or acceleration > _ACCELERATED):
        notes.append(
            f"with these controls the model's actuators produce up to {size:.3g} N m or N too much or too little at "
            f"{own.names[joint]} ({100 * size / max(played.largest, 1e-300):.3g} % of the largest effort, "
            f"{acceleration:.3g} rad/s^2 or m/s^2, at {own.times[i]:.4g} s): motion and forces will differ from the "
            f"plan" + (f"; at their limits: {', '.join(bound)}" if bound else "")
        )
    return notes + _constraint_notes(model, path, own)


def _constraint_notes(model: Any, path: Path, own: JointSamples) -> list[str]:
    """Coupled joints that nothing couples in the model, and constraints of it that the motion violates."""
    tied, data, off = copy.copy(model), mujoco.MjData(model), mujoco.mjtDisableBit
    tied.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
    tied.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    dofs = [model.jnt_dofadr[j] for j in path.place.values()]
    violations = []
    for i in (0, -1):
        data.qpos[:] = path.qpos[i]
        mujoco.mj_fwdPosition(tied, data)
        equal = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        rows = data.efc_J.reshape(-1, model.nv)[equal]
        touching = rows[:, dofs].any(axis=1)
        violations.append(np.array(data.efc_pos)[equal[touching]])
    loose = [
        name for name in path.place if name not in own.names and not rows[:, model.jnt_dofadr[path.place[name]]].any()
    ]
    notes = [f"nothing in the model couples {', '.join(loose)}, as the hand's description does"] if loose else []
    if violations[0].shape == violations[1].shape:
        apart = float(np.abs(violations[1] - violations[0]).max(initial=0.0))
        if apart > _APART:
            notes.append(
                f"the model's equality constraints are violated by up to {apart:.3g} m or rad on the way: it couples "
                "the joints differently from the plan's hand"
            )
    return notes
