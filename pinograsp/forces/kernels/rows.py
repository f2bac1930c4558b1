"""The balance by component, and what it leaves: parts of the dual Newton method and of the loops around it."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import FLAGS, NEWTON
from pinograsp.forces.kernels.layouts import Balance, Cones
from pinograsp.spatial import Array


@jit(**NEWTON)
def slopes_of(A: Array, y: Array, out: Array) -> None:
    """out (d k,) = A' y with A (m, d k)."""
    a, b, c = y[0], y[1], y[2]
    if y.shape[0] == 6:
        d, e, f = y[3], y[4], y[5]
        for l in range(A.shape[1]):
            out[l] = a * A[0, l] + b * A[1, l] + c * A[2, l] + d * A[3, l] + e * A[4, l] + f * A[5, l]
    else:
        for l in range(A.shape[1]):
            out[l] = a * A[0, l] + b * A[1, l] + c * A[2, l]


@jit(**FLAGS)
def columns(points: Array, rotations: Array, mu: Array, torsion: float, arm: float, A: Array, widths: Array) -> None:
    """Balance A (m, d k) by component from contact points (k, 3) about the centre of mass and frames (k, 3, 3), moments
    over ``arm``; widths (d, k): the unit of each component [N, N m per newton at the friction limit].
    """
    m, k, d = A.shape[0], points.shape[0], widths.shape[0]
    e = d - 1
    for i in range(k):
        widths[0, i], widths[1, i], widths[e, i] = mu[i], mu[i], 1.0
        if d == 4:
            widths[2, i] = torsion
        for j in range(3):
            at = (e if j == 2 else j) * k + i
            size = 1.0 if j == 2 else mu[i]
            u, v, w = size * rotations[i, 0, j], size * rotations[i, 1, j], size * rotations[i, 2, j]
            A[0, at], A[1, at], A[2, at] = u, v, w
            if m == 6:
                x, y, z = points[i, 0] / arm, points[i, 1] / arm, points[i, 2] / arm
                A[3, at], A[4, at], A[5, at] = y * w - z * v, z * u - x * w, x * v - y * u
        if d == 4:
            for r in range(m):
                A[r, 2 * k + i] = rotations[i, r - 3, 2] * torsion / arm if r >= 3 else 0.0


@jit(**FLAGS)
def judge(balance: Balance, cones: Cones, x: Array) -> tuple[float, float]:
    """Norm of A x - b and the largest violation of friction and bounds on F_n."""
    A, b, _ = balance
    lo, hi, radii, n_round = cones
    m, (d, k) = A.shape[0], x.shape
    e, violation, off = d - 1, 0.0, 0.0
    for i in range(k):
        F, t = x[e, i], 0.0
        for j in range(n_round):
            t += x[j, i] * x[j, i]
        t = np.sqrt(t)
        for j in range(n_round, e):
            t = max(t, abs(x[j, i]) / radii[j])
        violation = max(violation, max(t - F, max(lo[i] - F, F - hi[i])))
    for r in range(m):
        t = -b[r]
        for i in range(k):
            for j in range(d):
                t += A[r, j * k + i] * x[j, i]
        off += t * t
    return np.sqrt(off), violation
