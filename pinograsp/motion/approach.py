"""Approach phase: a fifth-order polynomial from rest to the state at impact (Eq. 19)."""

from __future__ import annotations

import numpy as np

from pinograsp.checks import array_of, number, one_of

STARTS = ("rest", "paper")


def approach(times, impact_time: float, start, q, dq, ddq, *, acceleration_at_start: str = "rest"):
    """Joint positions, rates and accelerations (m, n) at ``times`` (m,) [s] in [0, t_I].

    From ``start`` (n,) [rad] at rest to ``q``, ``dq``, ``ddq`` (n,) at ``impact_time``. The acceleration at t = 0 is
    zero (``"rest"``) or -ddq (``"paper"``, the boundary condition (i) below Eq. 19).
    """
    number("impact time", impact_time, above=0, unit="s")
    one_of("acceleration at start", acceleration_at_start, STARTS)
    start, q, dq, ddq = (array_of("approach state", v, (None,)) for v in (start, q, dq, ddq))
    T = impact_time
    a0, a1 = start, np.zeros_like(start)
    a2 = -ddq / 2 if acceleration_at_start == "paper" else np.zeros_like(start)
    # What the cubic and higher terms must still supply at T, solved in closed form.
    gap, rate, curvature = q - a0 - a2 * T**2, dq - 2 * a2 * T, ddq - 2 * a2
    a3 = (10 * gap - 4 * rate * T + curvature * T**2 / 2) / T**3
    a4 = (-15 * gap + 7 * rate * T - curvature * T**2) / T**4
    a5 = (6 * gap - 3 * rate * T + curvature * T**2 / 2) / T**5
    t = array_of("times", times, (None,))[:, None]
    position = a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))
    velocity = a1 + t * (2 * a2 + t * (3 * a3 + t * (4 * a4 + t * 5 * a5)))
    acceleration = 2 * a2 + t * (6 * a3 + t * (12 * a4 + t * 20 * a5))
    return position, velocity, acceleration
