"""What keeps an arm from carrying faster, in words."""

from __future__ import annotations

import numpy as np

from pinograsp.carry.program import CarrySolution
from pinograsp.carry.programs import Programs
from pinograsp.spatial import Array, BoolArray

_BINDS = 1e-3  # share of the largest multiplier from which on a limit binds


def binding_of(programs: Programs, found: CarrySolution, slack: BoolArray | None = None) -> tuple[str, ...]:
    """What binds in each interval: the limit whose multiplier, over a relative change of it, is largest.

    Args:
        programs: what was solved.
        found: its solution: of the least time, or of how fast each interval may be passed by itself.
        slack: intervals (N,) where nothing binds, whatever the multipliers are; None: where they are small.
    """
    problem, N = programs.problem, programs.count
    names, S = problem.contacts.names, 1 + len(programs.others)
    with np.errstate(invalid="ignore"):
        size = np.maximum(np.abs(programs.matrices.R_lo), np.abs(programs.matrices.R_hi))
    size = np.where(np.isfinite(size), size, 0.0)

    def together(values: Array) -> Array:
        """Of all scenarios."""
        return np.asarray(values.reshape(N, S, -1).sum(axis=1))

    rows = together(np.abs(found.rows).sum(axis=0)) if len(size) else np.zeros((N, 0))
    least, most = (together(each) for each in found.normals)
    torques = problem.torques
    hand = [] if torques is None or not len(programs.matrices.R) else [f"torque of {j}" for j in torques.limited_joints]
    hand += ["what the drives can make"] * (rows.shape[1] - len(hand))
    if slack is None:
        speeds = found.speeds * programs.top
        speeds = np.maximum(speeds[:-1], speeds[1:])
    else:
        speeds = (found.speeds.reshape(N, 2) * np.stack([programs.top[:-1], programs.top[1:]], axis=1)).sum(axis=1)
    words = [
        *(f"friction of {name}" for name in names),
        *(f"largest force of {name}" for name in names),
        *(f"least force of {name}" for name in names),
        *hand,
        *programs.arm_rows[2],
        "speed of the joints",
    ]
    values = np.concatenate(
        [
            together(found.cones * found.x[..., -1]),
            most * programs.most,
            least * np.maximum(programs.least, 1e-3 * programs.most),
            rows * size,
            together(found.pairs),
            speeds[:, None],
        ],
        axis=1,
    )
    largest = values.argmax(axis=1)
    nothing = values.max(axis=1) <= _BINDS * values.max() if slack is None else slack
    return tuple("nothing" if nothing[i] else words[j] for i, j in enumerate(largest.tolist()))
