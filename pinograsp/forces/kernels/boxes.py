"""Least squares in a box: multipliers at fixed normal forces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import factor, solve
from pinograsp.forces.kernels.flags import FLAGS, NEWTON, PIECE
from pinograsp.spatial import Array

_STEPS = 60
_SEARCHES = 60  # evaluations of one line search


class Box(NamedTuple):
    """The memory of :func:`box_least_squares`, views of one array.

    Attributes:
        eps: weight of |k|^2.
        load: (6,).
        row: (m,), and ``fixed`` (m,): b = fixed + row * load[:m].
        fixed: (m,).
        H: (m, n).
        k: the result (n,).
        work: scratch.
    """

    eps: float
    load: Array
    row: Array
    fixed: Array
    H: Array
    k: Array
    work: Array


class _Room(NamedTuple):
    """Gradient g, step d, right-hand side b, residual y (m,); S = H' y and V = H' d (n,); the Hessian M (m, m)."""

    g: Array
    d: Array
    b: Array
    y: Array
    S: Array
    V: Array
    M: Array


def box_in(memory: Array) -> Box:
    """The parts of an array of :func:`box_memory`, which begins with m, n and eps."""
    m, n = int(memory[0]), int(memory[1])
    load, row, fixed, rest = memory[3:9], memory[9 : 9 + m], memory[9 + m : 9 + 2 * m], memory[9 + 2 * m :]
    H, k, work = rest[: m * n].reshape((m, n)), rest[m * n : m * n + n], rest[m * n + n :]
    return Box(memory[2], load, row, fixed, H, k, work)


_compiled_box_in = jit(**FLAGS)(box_in)


def box_memory(m: int, n: int, eps: float) -> tuple[Array, Box]:
    """Memory for H (m, n), m <= 6, and its parts, which are views of it."""
    memory = np.zeros(9 + 2 * m + m * n + n + 60 + 2 * n)
    memory[:3] = m, n, eps
    return memory, box_in(memory)


@jit(**PIECE)
def _room_in(work: Array, m: int, n: int) -> _Room:
    return _Room(
        work[:m],
        work[6 : 6 + m],
        work[12 : 12 + m],
        work[18 : 18 + m],
        work[60 : 60 + n],
        work[60 + n : 60 + 2 * n],
        work[24 : 24 + m * m].reshape((m, m)),
    )


@jit(**PIECE)
def _evaluate(box: Box, inverse: float, room: _Room) -> float:
    """k, gradient and Hessian for the room's y; returns the largest entry of the gradient."""
    g, _, b, y, S, _, M = room
    H, k = box.H, box.k
    m, n = H.shape
    for r in range(m):
        g[r] = y[r] - b[r]
        for c in range(r + 1, m):
            M[r, c] = 0.0
        M[r, r] = 1.0
    for j in range(n):
        t = min(max(-S[j] * inverse, -1.0), 1.0)
        k[j] = t
        for r in range(m):
            g[r] -= H[r, j] * t
        if abs(t) < 1.0:
            for r in range(m):
                for c in range(r, m):
                    M[r, c] += inverse * H[r, j] * H[c, j]
    size = 0.0
    for r in range(m):
        size = max(size, abs(g[r]))
    return size


@jit(**PIECE)
def _step_length(inverse: float, room: _Room) -> float:
    """How far to go along -d. The derivative falls from its value at 0: its root (regula falsi, Illinois)."""
    g, d, b, y, S, V, _ = room
    start, along, square = 0.0, 0.0, 0.0
    for r in range(g.shape[0]):
        along += (y[r] - b[r]) * d[r]
        square += d[r] * d[r]
        start += g[r] * d[r]
    below, above, at_below, at_above, t, side = 0.0, -1.0, start, 0.0, 1.0, 0
    for _search in range(_SEARCHES):
        rest = along - t * square
        for j in range(S.shape[0]):
            rest -= V[j] * min(max(-(S[j] - t * V[j]) * inverse, -1.0), 1.0)
        if abs(rest) <= 0.1 * start:
            break
        if rest < 0.0:
            above, at_above = t, rest
            if side < 0:
                at_below *= 0.5
            side = -1
        else:
            below, at_below = t, rest
            if side > 0:
                at_above *= 0.5
            side = 1
        t = 4.0 * t if above < 0.0 else below + at_below * (above - below) / (at_below - at_above)
    return t


@jit(**NEWTON)
def box_least_squares(memory: Array) -> bool:
    """Minimise 1/2 |H k + b|^2 + eps/2 |k|^2 over |k| <= 1, in the arrays of :func:`box_memory`; True: converged.

    By Newton's method on the dual, whose unknowns y (m,) are the residual: k_j = -h_j . y / eps clipped to [-1, 1]
    leaves y - H k - b = 0, the gradient of a strongly convex function.
    """
    box = _compiled_box_in(memory)
    load, row, fixed, H, inverse = box.load, box.row, box.fixed, box.H, 1.0 / box.eps
    m, n = H.shape
    room = _room_in(box.work, m, n)
    g, d, b, y, S, V, M = room
    largest = 0.0
    for r in range(m):
        b[r], y[r] = fixed[r] + load[r] * row[r], 0.0
        if not abs(b[r]) < 1e12:
            return False
        largest = max(largest, abs(b[r]))
    for j in range(n):
        S[j] = 0.0
    for _ in range(_STEPS):
        if _evaluate(box, inverse, room) <= 1e-12 * (1.0 + largest):
            return True
        for r in range(m):
            d[r] = g[r]
        factor(M)
        solve(M, d)
        for j in range(n):
            t = 0.0
            for r in range(m):
                t += H[r, j] * d[r]
            V[j] = t
        t = _step_length(inverse, room)
        for r in range(m):
            y[r] -= t * d[r]
        for j in range(n):
            S[j] -= t * V[j]
    return False
