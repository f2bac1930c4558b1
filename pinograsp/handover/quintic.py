"""Polynomials of fifth degree through nodes with position, velocity and acceleration, and what goes along with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinograsp.spatial import Array


def between(nodes: Array, states: Sequence[Array], times: Array) -> tuple[Array, Array, Array]:
    """q, dq, ddq (s, n) at ``times`` (s,) of the quintic polynomials between nodes (m,) with q, dq, ddq (m, n)."""
    if len(nodes) == 1:
        q, dq, ddq = (np.repeat(values, len(times), axis=0) for values in states)
        return q, dq, ddq
    left = np.clip(np.searchsorted(nodes, times, side="right") - 1, 0, len(nodes) - 2)
    T, t = np.diff(nodes)[left, None], (times - nodes[left])[:, None]
    (q, dq, ddq), (q_next, dq_next, ddq_next) = ([values[i] for values in states] for i in (left, left + 1))
    a2 = ddq / 2
    gap, rate, curvature = q_next - q - T * (dq + T * a2), dq_next - dq - T * ddq, ddq_next - ddq
    a3 = (10 * gap - 4 * rate * T + curvature * T**2 / 2) / T**3
    a4 = (-15 * gap + 7 * rate * T - curvature * T**2) / T**4
    a5 = (6 * gap - 3 * rate * T + curvature * T**2 / 2) / T**5
    position = q + t * (dq + t * (a2 + t * (a3 + t * (a4 + t * a5))))
    velocity = dq + t * (ddq + t * (3 * a3 + t * (4 * a4 + t * 5 * a5)))
    return position, velocity, ddq + t * (6 * a3 + t * (12 * a4 + t * 20 * a5))


def interpolate(at: Array, times: Array, columns: Array) -> Array:
    """Columns (m, n) that are known at ``times`` (m,), linearly at ``at`` (s,)."""
    return np.column_stack([np.interp(at, times, column) for column in columns.T])
