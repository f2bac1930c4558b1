"""What a MuJoCo model's actuators are sent over time, as keyframes and as an archive."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinograsp.spatial import Array
from pinograsp.words import printable
from pinograsp.writing import write_file


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Controls:
    """What a model gets over time.

    Attributes:
        qpos: (m, nq).
        qvel: (m, nv).
        ctrl: (m, nu).
        act: activations (m, na); None: the actuators have none.
        joints: names of the joints in ``qpos``.
        actuators: names of the actuators by control (nu,).
        notes: what does not fit.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    act: Array | None = None
    notes: tuple[str, ...] = ()

    def samples(self) -> dict[str, Array]:
        """What there is by sample, in MuJoCo's words."""
        activations = {} if self.act is None else {"act": self.act}
        return {"qpos": self.qpos, "qvel": self.qvel, **activations, "ctrl": self.ctrl}


def keyframes(times: Array, found: Controls, keys: Mapping[str, int]) -> list[str]:
    """Lines of XML: names in comments, and keyframes at the samples ``keys``, in their order."""
    lines = [
        # no comment may hold two hyphens in a row
        f"<!-- {what}: {re.sub('-(?=-)', '- ', ', '.join(map(printable, names)))} -->"
        for what, names in (("qpos", found.joints), ("ctrl", found.actuators))
    ]
    for name, i in sorted(keys.items(), key=lambda key: key[1]):
        values = {"time": times[i : i + 1]} | {kind: rows[i] for kind, rows in found.samples().items()}
        attributes = " ".join(f'{k}="{" ".join(map(repr, v.tolist()))}"' for k, v in values.items() if v.size)
        lines.append(f'<key name="{name}" {attributes}/>')
    return lines


def archive(times: Array, found: Controls) -> bytes:
    """The controls over time as an ``.npz``."""
    written = io.BytesIO()
    names = {"joints": np.array(found.joints, dtype=str), "actuators": np.array(found.actuators, dtype=str)}
    np.savez_compressed(written, allow_pickle=False, times=times, **found.samples(), **names)
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
