"""The programs of carrying and their solutions as data.

Interval i of N has the forces x_i of k contacts (d numbers each, the normal force last) and the values p_i of two
nodes, squared speeds y. Either neighbours share a node, or every interval has its own two. The program is::

    minimise  cost(y) + sum_i 1/2 x_i . W x_i
    subject to  A x_i = E_i p_i + e_i,   low_i <= R x_i + B_i p_i <= high_i,   C_i p_i <= c_i,
                friction,   least <= F_n <= most,   0 <= y <= top,   some y given,

with A and R the same for all intervals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinograsp.contacts import Friction
from pinograsp.spatial import Array, BoolArray, IntArray, multiply_rows

_SMALL = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryProgram:
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
    def nodes(self) -> IntArray:
        """The two nodes of each interval (N, 2)."""
        first = np.arange(self.count) * (1 if len(self.top) == self.count + 1 else 2)
        return np.stack([first, first + 1], axis=1)

    @property
    def free(self) -> BoolArray:
        """Nodes whose y are not known, as ``top``."""
        return np.isnan(self.given)

    def add_at_nodes(self, pairs: Array) -> Array:
        """Sums at the nodes, as ``top``, of values at the two ends of each interval (N, 2)."""
        return np.asarray(np.bincount(self.nodes.ravel(), pairs.ravel(), len(self.top)), dtype=float)

    def scale(self, force: float, square: float) -> CarryProgram:
        """The same program with forces over ``force`` [N] and squared speeds over ``square`` [1/s^2]."""
        return replace(
            self,
            E=self.E * (square / force),
            e=self.e / force,
            B=self.B * (square / force),
            low=self.low / force,
            high=self.high / force,
            C=self.C * square,
            least=self.least / force,
            most=self.most / force,
            top=self.top / square,
            given=self.given / square,
            step=None if self.step is None else self.step / square**0.5,
            gain=None if self.gain is None else self.gain * square,
            weights=None if self.weights is None else self.weights * force**2,
        )

    def measure_cost(self, x: Array, y: Array) -> float:
        """The cost of forces x (N, k d) and squared speeds y, as ``top``."""
        cost = 0.0 if self.weights is None else 0.5 * float((self.weights * x**2).sum())
        if self.gain is not None:
            cost -= float(self.gain @ y)
        if self.step is not None:
            cost += float(measure_times(y[self.nodes], self.step).sum())
        return cost

    def measure_residual(self, x: Array, y: Array) -> float:
        """The largest error of balance and limits, for forces x (N, k d) and squared speeds y, as ``top``.

        Forces count over the largest load, rows of C and speeds over their limits.
        """
        p, each = y[self.nodes], x.reshape(self.count, self.k, -1)
        size = max(float(np.abs(self.e).max(initial=0.0)), float(self.least.max()), 1e-6)
        balance = np.abs(multiply_rows(x, self.A.T) - np.einsum("nbj,nj->nb", self.E, p) - self.e)
        normal, slide = each[..., -1], self.friction.gauge(each[..., :-1])
        forces = (balance, self.beyond_rows(x, y), slide - normal, self.least - normal, normal - self.most)
        limits = (np.einsum("nrj,nj->nr", self.C, p) - self.c, y[self.free] / self.top[self.free] - 1.0)
        return max(
            *(float(one.max(initial=0.0)) / size for one in forces), *(float(one.max(initial=0.0)) for one in limits)
        )

    def beyond_rows(self, x: Array, y: Array) -> Array:
        """How far the rows of R (m,) are beyond their limits at most, below zero where they are within them."""
        rows = multiply_rows(x, self.R.T) + np.einsum("nmj,nj->nm", self.B, y[self.nodes])
        return np.asarray(np.maximum(rows - self.high, self.low - rows).max(axis=0))

    def rows_that_may_bind(self, share: float) -> BoolArray:
        """The rows of R (m,) that some forces up to a share of the largest bring to a limit where nothing moves."""
        rows = self.R.reshape(-1, self.k, self.friction.d)
        normal, friction = rows[..., -1], self.friction.support(rows[..., :-1])
        ends = np.stack([self.least, np.maximum(share * self.most, self.least)])[:, None]
        most, least = ((normal + sign * friction) * ends for sign in (1.0, -1.0))
        high, low = most.max(axis=0).sum(axis=1), least.min(axis=0).sum(axis=1)
        return np.asarray((high > self.high.min(axis=0)) | (low < self.low.max(axis=0)))

    def keep_rows(self, kept: BoolArray) -> CarryProgram:
        """The program with these rows of R alone (m,)."""
        parts = {name: getattr(self, name)[:, kept] for name in ("B", "low", "high")}
        return replace(self, R=self.R[kept], **parts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarrySolution:
    """Where a program ended.

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
    def is_solution(self) -> bool:
        """Whether this is a solution."""
        return self.gap < 10 * self.accuracy and self.residual < 10 * self.accuracy


def measure_times(pairs: Array, step: float) -> Array:
    """How long intervals of length ``step`` take (N,), evenly accelerated between squared speeds ``pairs`` (N, 2)."""
    return np.asarray(2.0 * step / np.sqrt(pairs).sum(axis=1))
