"""What keeps an arm from carrying faster, in words."""

from __future__ import annotations

import numpy as np

from pinograsp.carry.constraints import PathConstraints
from pinograsp.carry.program import CarrySolution
from pinograsp.spatial import Array, BoolArray

_BINDS = 1e-3  # share of the largest multiplier from which on a limit binds


def name_binding(constraints: PathConstraints, found: CarrySolution, slack: BoolArray | None = None) -> tuple[str, ...]:
    """What binds in each interval: the limit whose multiplier, over a relative change of it, is largest.

    Args:
        constraints: what was solved for.
        found: its solution: of the least time, or of how fast each interval may be passed by itself.
        slack: intervals (N,) where nothing binds, whatever the multipliers are; None: where they are small.
    """
    grasp, N, top = constraints.grasp, constraints.count, constraints.top
    names, S = grasp.problem.contacts.names, 1 + len(constraints.others)
    with np.errstate(invalid="ignore"):
        size = np.maximum(np.abs(constraints.matrices.R_lo), np.abs(constraints.matrices.R_hi))
    size = np.where(np.isfinite(size), size, 0.0)

    def sum_scenarios(values: Array) -> Array:
        """Of all scenarios."""
        return np.asarray(values.reshape(N, S, -1).sum(axis=1))

    rows = sum_scenarios(np.abs(found.rows).sum(axis=0)) if len(size) else np.zeros((N, 0))
    least, most = (sum_scenarios(each) for each in found.normals)
    torques = grasp.problem.torques if len(constraints.matrices.R) else None
    hand = [] if torques is None else [f"torque of {joint}" for joint in torques.limited_joints]
    hand += ["what the drives can produce"] * (rows.shape[1] - len(hand))
    if slack is None:
        speeds = found.speeds * top
        speeds = np.maximum(speeds[:-1], speeds[1:])
    else:
        speeds = (found.speeds.reshape(N, 2) * np.stack([top[:-1], top[1:]], axis=1)).sum(axis=1)
    words = [
        *(f"friction of {name}" for name in names),
        *(f"largest force of {name}" for name in names),
        *(f"least force of {name}" for name in names),
        *hand,
        *constraints.arm_rows.names,
        "speed of the joints" + (" or of the object" if np.isfinite(constraints.arm.object_speed) else ""),
    ]
    values = np.concatenate(
        [
            sum_scenarios(found.cones * found.x[..., -1]),
            most * grasp.most,
            least * np.maximum(grasp.least, 1e-3 * grasp.most),
            rows * size,
            sum_scenarios(found.pairs),
            speeds[:, None],
        ],
        axis=1,
    )
    largest = values.argmax(axis=1)
    nothing = values.max(axis=1) <= _BINDS * values.max() if slack is None else slack
    return tuple("nothing" if nothing[i] else words[j] for i, j in enumerate(largest.tolist()))
