"""Approach phase: a fifth-order polynomial from rest to the state at impact (Eq. 19)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, number, one_of
from pinograsp.spatial import Array

StartAcceleration = Literal["rest", "paper"]
STARTS: tuple[StartAcceleration, ...] = get_args(StartAcceleration)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """Motion of n joints at m samples.

    Attributes:
        q: positions (m, n) [rad].
        dq: rates (m, n) [rad/s].
        ddq: accelerations (m, n) [rad/s^2].
    """

    q: Array
    dq: Array
    ddq: Array

    __repr__ = brief()


def approach(
    times: ArrayLike,
    impact_time: float,
    start: ArrayLike,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    *,
    acceleration_at_start: StartAcceleration = "rest",
) -> JointPath:
    """The motion of n joints at ``times`` (m,) [s] in [0, t_I].

    From ``start`` (n,) [rad] at rest to ``q``, ``dq``, ``ddq`` (n,) at ``impact_time``. The acceleration at t = 0 is
    zero (``"rest"``) or -ddq (``"paper"``, the boundary condition (i) below Eq. 19).
    """
    number("impact time", impact_time, above=0, unit="s")
    one_of("acceleration at start", acceleration_at_start, STARTS)
    a0, q_T, dq_T, ddq_T = (array_of("approach state", v, (None,)) for v in (start, q, dq, ddq))
    T = impact_time
    a1 = np.zeros_like(a0)
    a2 = -ddq_T / 2 if acceleration_at_start == "paper" else np.zeros_like(a0)
    # What the cubic and higher terms must still supply at T, solved in closed form.
    gap, rate, curvature = q_T - a0 - a2 * T**2, dq_T - 2 * a2 * T, ddq_T - 2 * a2
    a3 = (10 * gap - 4 * rate * T + curvature * T**2 / 2) / T**3
    a4 = (-15 * gap + 7 * rate * T - curvature * T**2) / T**4
    a5 = (6 * gap - 3 * rate * T + curvature * T**2 / 2) / T**5
    t = array_of("times", times, (None,))[:, None]
    position = a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))
    velocity = a1 + t * (2 * a2 + t * (3 * a3 + t * (4 * a4 + t * 5 * a5)))
    acceleration = 2 * a2 + t * (6 * a3 + t * (12 * a4 + t * 20 * a5))
    return JointPath(q=position, dq=velocity, ddq=acceleration)
