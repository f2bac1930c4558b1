"""What the interior-point method of carrying takes and gives: a program, and where it ended."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pinograsp.contacts import Friction
from pinograsp.spatial import Array, BoolArray, IntArray

_SMALL = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """The data; N intervals, k contacts with d numbers each, m rows of R, r rows of C.

    Attributes:
        friction: the model; x is scaled so that tangential forces are limited by F_n alone.
        k: contacts.
        A: (b, k d), of full rank.
        E: (N, b, 2).
        e: (N, b).
        R: (m, k d).
        B: (N, m, 2).
        low: (N, m), minus infinity where there is no limit.
        high: (N, m), infinity where there is no limit.
        C: (N, r, 2).
        c: (N, r).
        least: smallest normal forces (k,).
        most: largest normal forces (k,), finite.
        top: of y, finite: (N + 1,) where neighbours share a node, else (2 N,).
        given: values of y that are known, not a number where they are not; as ``top``.
        step: how long an interval of the path is; its time 2 step / (sqrt(y_i) + sqrt(y_i+1)) is the cost; None: no.
        gain: what a unit of y gains, as ``top``: minus this times y is the cost; None: no.
        weights: W (k d,), diagonal; None: forces cost nothing.
    """

    friction: Friction
    k: int
    A: Array
    E: Array
    e: Array
    R: Array
    B: Array
    low: Array
    high: Array
    C: Array
    c: Array
    least: Array
    most: Array
    top: Array
    given: Array
    step: float | None = None
    gain: Array | None = None
    weights: Array | None = None

    @property
    def count(self) -> int:
        """Number of intervals."""
        return len(self.E)

    @property
    def shared(self) -> bool:
        """Whether neighbours share a node."""
        return len(self.top) == self.count + 1

    @property
    def nodes(self) -> IntArray:
        """The two nodes of each interval (N, 2)."""
        first = np.arange(self.count) * (1 if self.shared else 2)
        return np.stack([first, first + 1], axis=1)

    @property
    def moderate(self) -> Array:
        """Squared speeds whose loads are about as large as those at rest, as ``top``: a place to begin."""
        size = np.abs(self.e).max(initial=0.0)
        still = np.maximum(np.abs(self.e).max(axis=1), 1e-3 * size + 1e-12)
        each = still / np.maximum(np.abs(self.E.sum(axis=2)).max(axis=1), 1e-9 * still)
        if not self.shared:
            return np.repeat(each, 2)
        padded = np.concatenate([each[:1], each, each[-1:]])
        return np.asarray(np.minimum(padded[:-1], padded[1:]))

    def normal_first(self, rows: Array) -> Array:
        """Rows (m, k d) over forces as they are here, over (d, k) with the normal force first."""
        d = self.friction.d
        own = rows.reshape(-1, self.k, d)[:, :, [d - 1, *range(d - 1)]]
        return np.asarray(own.transpose(0, 2, 1).reshape(-1, self.k * d))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """Where the method ended.

    Attributes:
        y: squared speeds, as ``top`` of the program.
        x: forces (N, k, d).
        objective: the cost.
        lower_bound: of the cost of any solution, from the multipliers.
        residual: largest error of balance and limits, over the size of the loads [-].
        rounds: iterations.
        accuracy: what was asked of gap and residual.
        rows: multipliers of the rows of R, at their low and high ends (2, N, m).
        pairs: multipliers of the rows of C (N, r).
        speeds: multipliers of the limits of y, as ``top``.
        normals: multipliers of least and most normal forces (2, N, k).
        cones: multipliers of friction (N, k).
    """

    y: Array
    x: Array
    objective: float
    lower_bound: float
    residual: float
    rounds: int
    accuracy: float
    rows: Array
    pairs: Array
    speeds: Array
    normals: Array
    cones: Array

    @property
    def gap(self) -> float:
        """Objective less bound, over the objective [-]."""
        return (self.objective - self.lower_bound) / max(abs(self.objective), _SMALL)

    @property
    def converged(self) -> bool:
        """Whether this is a solution."""
        return self.gap < 10 * self.accuracy and self.residual < 10 * self.accuracy


def may_bind(program: Program, share: float) -> BoolArray:
    """The rows of R (m,) that some forces up to a share of the largest bring to a limit where nothing moves."""
    rows = program.R.reshape(-1, program.k, program.friction.d)
    normal, friction = rows[..., -1], program.friction.support(rows[..., :-1])
    ends = np.stack([program.least, np.maximum(share * program.most, program.least)])[:, None]
    most, least = ((normal + sign * friction) * ends for sign in (1.0, -1.0))
    high, low = most.max(axis=0).sum(axis=1), least.min(axis=0).sum(axis=1)
    return np.asarray((high > program.high.min(axis=0)) | (low < program.low.max(axis=0)))


def with_rows(program: Program, kept: BoolArray) -> Program:
    """The program with these rows of R alone (m,)."""
    if kept.all():
        return program
    parts = {name: getattr(program, name)[:, kept] for name in ("B", "low", "high")}
    return replace(program, R=program.R[kept], **parts)


def beyond_rows(program: Program, found: Solved) -> Array:
    """How far the rows of R (m,) are beyond their limits, at most."""
    p = found.y[program.nodes]
    rows = found.x.reshape(program.count, -1) @ program.R.T
    rows = rows + program.B[..., 0] * p[:, :1] + program.B[..., 1] * p[:, 1:]
    return np.asarray(np.maximum(rows - program.high, program.low - rows).max(axis=0))


class Times(NamedTuple):
    """How long intervals take at constant acceleration, with derivatives.

    Attributes:
        value: (N,).
        slope: (N, 2).
        bend: (N, 2, 2).
    """

    value: Array
    slope: Array
    bend: Array


def times(pairs: Array, step: float) -> Times:
    """Of intervals of length ``step`` between squared speeds ``pairs`` (N, 2)."""
    root = np.sqrt(pairs)
    both = root.sum(axis=1)
    value = 2.0 * step / both
    root = np.maximum(root, 1e-75)
    slope = -value[:, None] / (2.0 * both[:, None] * root)
    bend = np.einsum("ni,nj,n->nij", 1.0 / root, 1.0 / root, value / (2.0 * both**2))
    for j in (0, 1):
        bend[:, j, j] += value / (4.0 * both * root[:, j] ** 3)
    return Times(value, slope, bend)


def gained_by_times(y: Array, slopes: Array, free: BoolArray, step: float) -> Array | None:
    """A lower bound, its only entry (1,), of the change that squared speeds z >= 0 make of the times, their derivatives
    at y (N + 1,) replaced by ``slopes`` (N + 1,): 0 where speeds are not ``free``.

    Between a quarter of y_i and four times as much times are convex by c_i or more in z_i, so that nothing gains more
    than the sum of slopes^2 / 2 c there; and where c_i d^2 / 4, d = 3/4 y_i, is more than twice that, nothing does
    beyond, for on its way out it has lost more than that. None where it is less.
    """
    p = np.maximum(np.stack([y[:-1], y[1:]]), 1e-150)
    curvature = np.zeros(len(y))
    # What 1 / (sqrt a + sqrt b) has besides the square of its gradient, where it is least: 4 a, 4 b.
    each = step / (2.0 * np.sqrt(p).sum(axis=0) ** 2 * p**1.5) / 32.0
    curvature[:-1] += each[0]
    curvature[1:] += each[1]
    gained = float((slopes**2 / (2.0 * curvature)).sum())
    beyond = (curvature * (0.75 * y) ** 2 / 4.0)[free]
    return np.array([-gained]) if 2.0 * gained < beyond.min(initial=np.inf) else None
