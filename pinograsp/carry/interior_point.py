"""A primal-dual interior-point method for many force problems at once, coupled by how fast they are passed.

Interval i of N has the forces x_i of k contacts (d numbers each, the normal force last) and the values p_i of two
nodes, squared speeds y. Either neighbours share a node, or every interval has its own two. The program is::

    minimise  cost(y) + sum_i 1/2 x_i . W x_i
    subject to  A x_i = E_i p_i + e_i,   low_i <= R x_i + B_i p_i <= high_i,   C_i p_i <= c_i,
                friction,   least <= F_n <= most,   0 <= y <= top,   some y given,

with A and R the same for all intervals. Steps are Mehrotra's predictor and corrector with the scaling of Nesterov and
Todd (Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010). Forces are eliminated contact by
contact, then row by row of A and R (orthogonal factors, interval by interval); what is left is tridiagonal in y. So the
time of a step grows in proportion to N and to k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from pinograsp.carry.slacks import Cones, Limits
from pinograsp.contacts import Friction
from pinograsp.spatial import Array, IntArray

_ROUNDS, _WORSE = 80, 4  # at most; rounds without a better bound after which digits are used up
_BACK = 0.99  # of the way to the nearest limit
_SMALL = 1e-300
_FALL = 0.6  # of squared speeds in a round
_HEED = 0.3  # of the error of the cost's model
_UNLIMITED = 1e-14  # weight of a row without limits, over the forces


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
    def nodes(self) -> IntArray:
        """The two nodes of each interval (N, 2)."""
        shared = len(self.top) == self.count + 1
        first = np.arange(self.count) * (1 if shared else 2)
        return np.stack([first, first + 1], axis=1)


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


def solve(program: Program, *, accuracy: float = 1e-8, rounds: int = _ROUNDS) -> Solved:
    """Solve a program to a relative ``accuracy`` of the objective, or as near to it as rounding lets it come."""
    return _Method(program).run(accuracy, rounds)


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


class _Method:
    """The iterates."""

    def __init__(self, program: Program):
        self.program = program
        self.nodes = program.nodes
        self.free = np.isnan(program.given)
        self.d = d = program.friction.d
        self.order = [d - 1, *range(program.friction.round_dimensions)]
        self.facets = program.friction.facets
        self.M = np.concatenate([program.A, program.R])
        blocks = self.M.reshape(len(self.M), program.k, d).transpose(1, 2, 0)
        self.blocks = np.ascontiguousarray(blocks)  # (k, d, rows)
        self.coupling = np.concatenate([program.E, -program.B], axis=1)
        self.size = max(float(np.abs(program.e).max(initial=0.0)), float(program.least.max()), 1e-6)
        self.weights = np.zeros(program.k * d) if program.weights is None else program.weights
        self._start()

    def _start(self) -> None:
        program = self.program
        N, k, d = program.count, program.k, self.d
        # Slow at the ends, since the path mostly begins and ends at rest.
        rise = np.minimum(1.0, 8.0 * np.minimum(np.arange(N + 1), np.arange(N, -1, -1)) / N)
        shape = rise if len(program.top) == N + 1 else 1.0
        self.y = np.where(self.free, 0.3 * program.top * shape, program.given)
        room = program.most - program.least
        normal = np.minimum(0.5 * room, self.size)
        self.x = np.zeros((N, k, d))
        self.x[..., -1] = program.least + normal
        self.measure_cost()
        price = max(abs(self.cost) / (N * k * self.size), 1e-12) * np.ones((N, k))
        self.floor = Limits(np.broadcast_to(normal, (N, k)), price)
        self.cap = Limits(program.most - self.x[..., -1], price)
        self.cones = self.flat = None
        if len(self.order) > 1:
            z = np.zeros((N, k, len(self.order)))
            z[..., 0] = price
            self.cones = Cones(self.x[..., self.order].copy(), z)
        if len(self.facets):
            shape3 = N, k, len(self.facets)
            force = np.broadcast_to((program.least + normal)[:, None], shape3)
            self.flat = Limits(force, np.broadcast_to(price[..., None], shape3))
        p, each = self.y[self.nodes], self.size * price[0, 0]
        rows = np.einsum("nrj,nj->nr", program.B, p) + self.x.reshape(N, -1) @ program.R.T
        width = np.where(np.isfinite(program.high) & np.isfinite(program.low), program.high - program.low, self.size)
        self.below, self.above = (
            Limits(slack, each / slack, np.isfinite(end))
            for end, sign in ((program.low, 1.0), (program.high, -1.0))
            for slack in [np.maximum(np.where(np.isfinite(end), sign * (rows - end), 1.0), 0.05 * width + 1e-9)]
        )
        slack = program.c - np.einsum("nrj,nj->nr", program.C, p)
        slack = np.maximum(slack, 0.05 * np.maximum(np.abs(program.c), 1e-9))
        self.pair = Limits(slack, each / slack)
        y = np.where(self.free, self.y, 1.0)
        self.bottom = Limits(y, each / y, self.free)
        self.top = Limits(np.where(self.free, program.top - y, 1.0), each / program.top, self.free)
        self.multipliers = np.zeros((N, len(program.A)))

    @property
    def limits(self) -> dict[str, Limits]:
        """All but the cones, by name."""
        names = ("floor", "cap", "below", "above", "pair", "bottom", "top")
        found: dict[str, Limits] = {name: getattr(self, name) for name in names}
        return found if self.flat is None else found | {"flat": self.flat}

    @property
    def parts(self) -> list[Limits | Cones]:
        """Limits and cones."""
        return [*self.limits.values(), *([] if self.cones is None else [self.cones])]

    def measure_cost(self) -> None:
        """The cost and its derivatives."""
        program, y = self.program, self.y
        p = y[self.nodes]
        self.cost = 0.5 * float(((self.x.reshape(len(p), -1) ** 2) @ self.weights).sum())
        self.slope, self.bend = np.zeros((len(p), 2)), np.zeros((len(p), 2, 2))
        if program.step is not None:
            time = times(p, program.step)
            self.cost += float(time.value.sum())
            free = self.free[self.nodes]
            self.slope = np.where(free, time.slope, 0.0)
            self.bend = np.where(free[:, :, None] & free[:, None, :], time.bend, 0.0)
        if program.gain is not None:
            self.cost -= float(program.gain @ y)

    def measure(self) -> None:
        """The cost, and how far slacks are from the values that they stand for."""
        program, x, y = self.program, self.x, self.y
        p, flat = y[self.nodes], x.reshape(len(x), -1)
        self.off = flat @ program.A.T - np.einsum("nrj,nj->nr", program.E, p) - program.e
        rows = flat @ program.R.T + np.einsum("nrj,nj->nr", program.B, p)
        self.below.measure(rows - np.where(self.below.used, program.low, 0.0))
        self.above.measure(np.where(self.above.used, program.high, 0.0) - rows)
        self.pair.measure(program.c - np.einsum("nrj,nj->nr", program.C, p))
        self.floor.measure(x[..., -1] - program.least)
        self.cap.measure(program.most - x[..., -1])
        self.bottom.measure(y)
        self.top.measure(program.top - y)
        if self.flat is not None:
            self.flat.measure(x[..., -1:] - x[..., :-1] @ self.facets.T)
        self.measure_cost()

    def _factors(self) -> Array:
        """Q (N, k, d, d), with Q^T Q the inverse of what weighs the contacts' forces."""
        d, normal = self.d, self.floor.weight + self.cap.weight
        if self.cones is not None:
            self.cones.scale()
        if self.cones is not None and self.flat is None and not self.weights.any():
            # (W^-2 + weight of the normal force)^-1 = W (1 + g g^T)^-1 W.
            last = [*range(1, d), 0]
            W = self.cones.matrix()[..., last, :][..., last]
            g = np.sqrt(normal)[..., None] * W[..., -1]
            size = np.sqrt(1.0 + np.einsum("nki,nki->nk", g, g))
            along = np.einsum("nki,nkij->nkj", g, W)
            return np.asarray(
                W - (1.0 / (size * (1.0 + size)))[..., None, None] * g[..., :, None] * along[..., None, :]
            )
        D = np.zeros((*self.x.shape, d))
        if self.cones is not None:
            inverse = self.cones.matrix(-1.0)
            D[np.ix_(range(len(D)), range(self.program.k), self.order, self.order)] = inverse @ inverse
        if self.flat is not None:
            rows = np.concatenate([-self.facets, np.ones((len(self.facets), 1))], axis=1)
            D += np.einsum("nkr,ri,rj->nkij", self.flat.weight, rows, rows)
        at = np.arange(d)
        D[..., at, at] += self.weights.reshape(-1, d)
        D[..., -1, -1] += normal
        return np.linalg.inv(np.linalg.cholesky(D))

    def factorise(self) -> None:
        """What both steps of a round share."""
        program, N, limited = self.program, self.program.count, len(self.program.R)
        self.Q = self._factors()
        rows, forces = len(self.M), program.k * self.d
        self.give = 1.0 / np.maximum(self.below.weight + self.above.weight, _UNLIMITED / self.size)
        T = np.zeros((N, forces + limited, rows))
        T[:, :forces] = (self.Q @ self.blocks).reshape(N, forces, rows)
        at = np.arange(limited)
        T[:, forces + at, rows - limited + at] = np.sqrt(self.give)
        # Orthogonal factors, not those of T^T T: some contacts weigh next to nothing, others all.
        self.factor, upper = np.linalg.qr(T)
        self.upper_inverse = np.linalg.inv(upper)
        self.coupled = np.einsum("nrs,nrj->nsj", self.upper_inverse, self.coupling)
        H = self.bend + np.einsum("nrj,nrl->njl", self.coupled, self.coupled)
        H += np.einsum("nr,nrj,nrl->njl", self.pair.weight, program.C, program.C)
        free = self.free[self.nodes]
        H *= free[:, :, None] & free[:, None, :]
        diagonal = self._gathered(np.einsum("njj->nj", H)) + self.bottom.weight + self.top.weight
        self.banded = np.zeros((2, len(self.y)))
        self.banded[0, self.nodes[:, 1]] = H[:, 0, 1]
        self.banded[1] = np.where(self.free, diagonal, 1.0)

    def _gathered(self, pairs: Array) -> Array:
        """Sums of (N, 2) at the nodes."""
        return np.asarray(np.bincount(self.nodes.ravel(), pairs.ravel(), len(self.y)), dtype=float)

    def step(self, aim: float, corrections: dict[str, Array]) -> None:
        """The Newton step towards products ``aim`` of slacks and multipliers."""
        program, N, limits = self.program, self.program.count, self.limits
        pull = {name: one.pull(aim, corrections.get(name, 0.0)) for name, one in limits.items()}
        r = -(self.weights * self.x.reshape(N, -1)).reshape(self.x.shape)
        if self.cones is not None:
            r[..., self.order] += self.cones.pull(aim, corrections.get("cones", 0.0))
        if self.flat is not None:
            r[..., -1] += pull["flat"].sum(axis=2)
            r[..., :-1] -= pull["flat"] @ self.facets
        r[..., -1] += pull["floor"] - pull["cap"]
        right = np.concatenate([-self.off, self.give * (pull["below"] - pull["above"])], axis=1)
        scaled = np.zeros(self.factor.shape[:2])
        forces = program.k * self.d
        scaled[:, :forces] = np.einsum("nkij,nkj->nki", self.Q, r).reshape(N, -1)
        ready = np.einsum("nir,ni->nr", self.factor, scaled) - np.einsum("nrs,nr->ns", self.upper_inverse, right)
        pairs = np.einsum("nrj,nr->nj", self.coupled, ready) - self.slope
        pairs -= np.einsum("nrj,nr->nj", program.C, pull["pair"])
        nodes = self._gathered(pairs) + pull["bottom"] - pull["top"]
        nodes += 0.0 if program.gain is None else program.gain
        self.dy = solveh_banded(self.banded, np.where(self.free, nodes, 0.0))
        dp = self.dy[self.nodes]
        own = ready - np.einsum("nrj,nj->nr", self.coupled, dp)
        left = (scaled - np.einsum("nir,nr->ni", self.factor, own))[:, :forces].reshape(self.x.shape)
        self.dx = np.einsum("nkji,nkj->nki", self.Q, left)
        self.new_multipliers = np.einsum("nrs,ns->nr", self.upper_inverse, own)[:, : len(program.A)]
        rows = self.dx.reshape(N, -1) @ program.R.T + np.einsum("nrj,nj->nr", program.B, dp)
        normal = self.dx[..., -1]
        changes = {"floor": normal, "cap": -normal, "below": rows, "above": -rows, "bottom": self.dy, "top": -self.dy}
        changes["pair"] = -np.einsum("nrj,nj->nr", program.C, dp)
        changes["flat"] = self.dx[..., -1:] - self.dx[..., :-1] @ self.facets.T
        for name, one in limits.items():
            one.move(changes[name], aim, corrections.get(name, 0.0))
        if self.cones is not None:
            self.cones.move(self.dx[..., self.order])

    def run(self, accuracy: float, rounds: int) -> Solved:
        """Rounds of two steps each, until the gap is small."""
        with np.errstate(all="ignore"):
            return self._rounds(accuracy, rounds)

    def _rounds(self, accuracy: float, rounds: int) -> Solved:
        self.measure()
        best: Solved | None = None
        worse = 0
        degree = sum(one.degree for one in self.parts)
        for done in range(1, rounds + 1):
            try:
                self.factorise()
                gap = sum(one.gap() for one in self.parts)
                self.step(0.0, {})
                share = min(1.0, *(one.longest() for one in self.parts))
                after = max(sum(one.gap(share) for one in self.parts), 0.0)
                corrections = {name: one.second_order for name, one in self.limits.items()}
                if self.cones is not None:
                    corrections["cones"] = self.cones.second_order
                self.step(max((after / gap) ** 3 * gap, _HEED * self.model_error(share)) / degree, corrections)
            except (np.linalg.LinAlgError, ValueError):  # out of digits; ValueError: not a number
                break
            share = min(1.0, _BACK * min(one.longest() for one in self.parts))
            if self.program.step is not None:
                # The cost's model is of use as long as speeds do not fall by much.
                falling = float((-self.dy / np.maximum(self.y, _SMALL))[self.free].max(initial=0.0))
                share = min(share, _FALL / max(falling, _SMALL))
            if not np.isfinite(share):
                break
            self._move(share)
            if not np.isfinite(self.cost) or not np.isfinite(self.off).all():
                break
            found = self._solved(done, accuracy, -np.inf if best is None else best.lower_bound)
            better = best is None or found.gap < best.gap or found.residual < 0.5 * best.residual
            worse = 0 if better else worse + 1
            best = found if better else best
            if (found.gap < accuracy and found.residual < accuracy) or (worse >= _WORSE and best and best.converged):
                break
        assert best is not None
        return best

    def model_error(self, share: float) -> float:
        """How far the cost is from its quadratic model after a share of the step: a smaller gap means nothing."""
        if self.program.step is None:
            return 0.0
        now, dp = self.y[self.nodes], share * self.dy[self.nodes]
        change = times(np.maximum(now + dp, 0.1 * now), self.program.step).value - times(now, self.program.step).value
        model = np.einsum("nj,nj->n", self.slope, dp) + 0.5 * np.einsum("ni,nij,nj->n", dp, self.bend, dp)
        return float(np.abs(change - model).sum())

    def _move(self, share: float) -> None:
        self.x, self.y = self.x + share * self.dx, self.y + share * self.dy
        self.multipliers = self.multipliers + share * (self.new_multipliers - self.multipliers)
        for one in self.parts:
            one.step(share)
        if self.cones is not None:
            self.x[..., self.order] = self.cones.s
        self.measure()

    def _lower_bound(self) -> float:
        """Of the cost of any solution: what is left over of the multipliers' equations gains at most as much as forces
        and speeds can change. The cost is convex: it is above its tangent.
        """
        program, N = self.program, self.program.count
        r = (self.weights * self.x.reshape(N, -1)).reshape(self.x.shape)
        if self.cones is not None:
            r[..., self.order] -= self.cones.z
        if self.flat is not None:
            r[..., -1] -= self.flat.z.sum(axis=2)
            r[..., :-1] += self.flat.z @ self.facets
        r[..., -1] += self.cap.z - self.floor.z
        rows = self.above.z - self.below.z
        r += (self.multipliers @ program.A + rows @ program.R).reshape(r.shape)
        pairs = self.slope - np.einsum("nrj,nr->nj", program.E, self.multipliers)
        pairs += np.einsum("nrj,nr->nj", program.B, rows) + np.einsum("nrj,nr->nj", program.C, self.pair.z)
        nodes = self._gathered(pairs) + self.top.z - self.bottom.z
        nodes = np.where(self.free, nodes - (0.0 if program.gain is None else program.gain), 0.0)
        bound = self.cost + float(np.vdot(self.multipliers, self.off)) - sum(one.gap() for one in self.parts)
        bound -= sum(float(np.vdot(one.off, one.z)) for one in self.limits.values())
        most = program.most[:, None]
        bound -= float((np.abs(r[..., :-1]) * most).sum() + (r * self.x).sum())
        bound += float(np.minimum(r[..., -1] * program.least, r[..., -1] * program.most).sum())
        return bound + float(np.minimum(nodes * program.top, 0.0).sum() - nodes @ self.y)

    def _solved(self, rounds: int, accuracy: float, bound: float) -> Solved:
        off = [np.abs(self.off).max() / self.size, *(np.abs(one.off).max(initial=0.0) for one in self.limits.values())]
        cones = np.zeros(self.x.shape[:2])
        if self.cones is not None:
            cones += self.cones.z[..., 0]
        if self.flat is not None:
            cones += self.flat.z.sum(axis=2)
        return Solved(
            y=self.y,
            x=self.x.copy(),
            objective=self.cost,
            lower_bound=max(bound, self._lower_bound()),
            residual=float(max(off)),
            rounds=rounds,
            accuracy=accuracy,
            rows=np.stack([self.below.z, self.above.z]),
            pairs=self.pair.z,
            speeds=self.top.z,
            normals=np.stack([self.floor.z, self.cap.z]),
            cones=cones,
        )
