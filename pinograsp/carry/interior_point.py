"""A primal-dual interior-point method for many force problems at once, coupled by how fast they are passed.

Interval i of N has the forces x_i of k contacts (d numbers each, the normal force last) and the values p_i of two
nodes, squared speeds y. Either neighbours share a node, or every interval has its own two. The program is::

    minimise  cost(y) + sum_i 1/2 x_i . W x_i
    subject to  A x_i = E_i p_i + e_i,   low_i <= R x_i + B_i p_i <= high_i,   C_i p_i <= c_i,
                friction,   least <= F_n <= most,   0 <= y <= top,   some y given,

with A and R the same for all intervals. Steps are Mehrotra's predictor and corrector with the scaling of Nesterov and
Todd (Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010). Forces are eliminated contact by
contact, then with the rows of A and R (orthogonal factors, interval by interval); what is left is tridiagonal in y. So
the time of a step grows in proportion to N and to k. Where neighbours share no unknown speed, each interval takes steps
of its own until it is solved.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.linalg import solveh_banded

from pinograsp.carry.elimination import Factors, GramSchmidt, Householder, Rows
from pinograsp.carry.program import Program, Solved, beyond_rows, gained_by_times, may_bind, times, with_rows
from pinograsp.carry.slacks import Cones, Limits, summed
from pinograsp.spatial import Array, BoolArray

__all__ = ["Program", "Solved", "solve", "times"]

_ROUNDS, _WORSE = 80, 3  # at most; rounds without a much better error after which digits are used up
_BETTER = 0.5  # of the error
_LOST = 12  # rounds without a better error after which an interval is left
_BACK = 0.99  # of the way to the nearest limit
_SMALL = 1e-300
_FALL = 0.6  # of squared speeds in a round
_HEED = 0.3  # of the error of the cost's model
_USUAL = 0.5  # of the largest normal forces: mostly they are less
_FEW = 8  # columns, at most: more are faster one matrix after the other
_UNLIMITED = 1e-14  # weight of a row without limits, over the forces
_HIGH = 30.0  # price of the limits at the start, over the cost
_PART = 1e-2  # of the mean cost: what counts as an interval's own, at least
_MOST = 0.8  # of the intervals: while so many are left, none is dropped
# What a method has of each interval, besides slacks and multipliers.
_OF_INTERVALS = (
    *("x", "y", "multipliers", "off", "cost", "slope", "bend", "took", "degree"),
    *("given", "highest", "free", "gain", "E", "e", "coupling", "S", "squares", "used", "g"),
)


def solve(program: Program, *, accuracy: float = 1e-8, rounds: int = _ROUNDS) -> Solved:
    """Solve a program to a relative ``accuracy`` of the objective, or as near to it as rounding lets it come.

    Rows of R that no forces of half the largest bring to their limits at rest are left out, and put back where the
    solution turns out to be beyond them: what solves a program with fewer limits, and keeps to all, solves it.
    """
    kept = may_bind(program, _USUAL)
    while True:
        found = _Method(with_rows(program, kept)).run(accuracy, rounds)
        over = beyond_rows(program, found)
        broken = ~kept & (over > accuracy)
        if not found.converged or not broken.any():
            break
        kept |= broken | may_bind(program, 1.0)
    own = np.zeros((2, program.count, len(kept)))
    own[..., kept] = found.rows
    return replace(found, rows=own, residual=max(found.residual, float(over[~kept].max(initial=0.0))))


class _Method:
    """The iterates. Intervals are the last axis of all arrays; forces are (d, k, N), the normal force first.

    Where neighbours share no unknown speed, costs, gaps and shares of steps are those of each interval (N,), and y are
    pairs (2, N); else they are numbers.
    """

    def __init__(self, program: Program):
        self.program = program
        self.d, self.k, self.N = program.friction.d, program.k, program.count
        self.facets = program.friction.facets
        self.coupled = program.shared and bool(np.isnan(program.given).any())
        self.given, self.highest = (self._of_nodes(one) for one in (program.given, program.top))
        self.gain = None if program.gain is None else self._of_nodes(program.gain)
        self.free = np.isnan(self.given)
        self.A, self.R = program.normal_first(program.A), program.normal_first(program.R)
        # Rows of R are eliminated before those of A where they are many, else with them: the smaller matrices.
        self.many = 0 < len(self.R) > self.k * self.d - len(self.A)
        E, B, C = (np.ascontiguousarray(one.transpose(1, 2, 0)) for one in (program.E, program.B, program.C))
        self.E, self.e = E, np.ascontiguousarray(program.e.T)
        self.coupling = E if self.many else np.concatenate([E, -B])
        self.S = np.concatenate([B, -B, -C])
        self.squares = C[:, [0, 0, 1]] * C[:, [0, 1, 1]]
        weights = np.zeros(self.k * self.d) if program.weights is None else program.weights
        self.weights = program.normal_first(weights).reshape(self.d, self.k, 1)
        self.size = max(float(np.abs(program.e).max(initial=0.0)), float(program.least.max()), 1e-6)
        self._sides()
        self._start()

    def _of_nodes(self, values: Array) -> Array:
        return values if self.coupled else values[self.program.nodes.T]

    def _sides(self) -> None:
        """Limits of each interval, G x + S p + g > 0 one below the other; those of normal forces have no S."""
        program, k, m = self.program, self.k, len(self.R)
        flat = np.zeros((len(self.facets), k, self.d, k))
        for c in range(k):
            flat[:, c, 0, c], flat[:, c, 1:, c] = 1.0, -self.facets
        unit = np.eye(k, k * self.d)
        self.G = np.concatenate([unit, -unit, flat.reshape(-1, k * self.d), self.R, -self.R])
        names = ("floor", "cap", "flat", "below", "above", "pair")
        ends = np.cumsum([0, k, k, len(self.facets) * k, m, m, len(self.squares)]).tolist()
        self.at = {name: slice(*own) for name, own in zip(names, pairwise(ends))}
        self.first, self.last = ends[3], ends[5]
        low, high = program.low.T, program.high.T
        self.used = np.ones((ends[-1], self.N), dtype=bool)
        self.used[self.first : self.last] = np.isfinite(np.concatenate([low, high]))
        self.g = np.zeros(self.used.shape)
        self.g[:k], self.g[k : 2 * k] = -program.least[:, None], program.most[:, None]
        self.g[self.first :] = np.concatenate([-low, high, program.c.T])
        self.g[~self.used] = 1.0
        # Least slacks at the start; forces are within their own limits.
        width = np.where(np.isfinite(high) & np.isfinite(low), high - low, self.size)
        others = np.maximum(np.abs(program.c.T), 1e-9)
        self.narrow = np.concatenate([np.zeros((self.first, self.N)), 0.05 * np.concatenate([width, width, others])])

    def _changes(self, x: Array, p: Array) -> Array:
        """G x + S p."""
        found = np.zeros(self.g.shape)
        found[: self.last] = self.G @ x.reshape(-1, self.N)
        found[self.first :] += self.S[:, 0] * p[0] + self.S[:, 1] * p[1]
        return found

    def _pairs(self, nodes: Array) -> Array:
        """Values of nodes at the ends of the intervals (2, N)."""
        return np.stack([nodes[:-1], nodes[1:]]) if self.coupled else nodes

    def _gathered(self, pairs: Array) -> Array:
        """Sums of (2, N) at the nodes."""
        if not self.coupled:
            return pairs
        found = np.zeros(self.N + 1)
        found[:-1] = pairs[0]
        found[1:] += pairs[1]
        return found

    def _all(self, sums: list[Array]) -> Array:
        """What sums over the last axes make together: for each interval, or a number."""
        return np.asarray(sum(one.sum() for one in sums) if self.coupled else sum(sums))

    def _start(self) -> None:
        program, N = self.program, self.N
        # Slow at the ends, since the path mostly begins and ends at rest.
        rise = np.minimum(1.0, 8.0 * np.minimum(np.arange(N + 1), np.arange(N, -1, -1)) / N)
        start = np.minimum(0.3 * self.highest * (rise if self.coupled else 1.0), self._of_nodes(program.moderate))
        self.y = np.where(self.free, start, self.given)
        self.x = np.zeros((self.d, self.k, N))
        self.x[0] = (program.least + np.minimum(0.5 * (program.most - program.least), self.size))[:, None]
        self.multipliers = np.zeros((len(self.A), N))
        self.measure_cost()
        mean = float(np.abs(self.cost).mean()) / (N if self.coupled else 1)
        each = max(_HIGH * mean / self.k, 1e-12 * self.size)
        s = np.maximum(self._changes(self.x, self._pairs(self.y)) + self.g, self.narrow)
        self.sides = Limits(s, each / s, self.used)
        self.ends = self.cones = None
        if self.free.any():
            ends = np.stack([self.y, self.highest - self.y])
            self.ends = Limits(ends, each / np.maximum(ends, _SMALL), np.stack([self.free, self.free]))
        if n := program.friction.round_dimensions:
            z = np.zeros((1 + n, self.k, N))
            z[0] = each / self.size
            self.cones = Cones(self.x[: 1 + n].copy(), z)
        self.parts = [one for one in (self.sides, self.ends, self.cones) if one is not None]
        self.degree = self._all([one.degree for one in self.parts])
        self.measure()

    def measure_cost(self) -> None:
        """The cost and its derivatives."""
        program, p = self.program, self._pairs(self.y)
        costs = [0.5 * summed(self.weights * self.x * self.x)]
        self.slope, self.bend = np.zeros((2, self.N)), np.zeros((3, self.N))
        if program.step is not None:
            time = times(p.T, program.step)
            self.took = time.value
            costs.append(time.value)
            self.slope, self.bend = time.slope.T, time.bend.reshape(-1, 4).T[[0, 1, 3]]
        if self.gain is not None:
            costs.append(-summed(self.gain * self.y))
        self.cost = self._all(costs)

    def measure(self) -> None:
        """The cost, and how far slacks are from the values that they stand for."""
        p = self._pairs(self.y)
        self.off = self.A @ self.x.reshape(-1, self.N) - self.E[:, 0] * p[0] - self.E[:, 1] * p[1] - self.e
        self.sides.measure(self._changes(self.x, p) + self.g)
        if self.ends is not None:
            self.ends.measure(np.stack([self.y, self.highest - self.y]))
        self.measure_cost()

    def gap(self, share: Array | float = 0.0) -> Array:
        """The products of all slacks and multipliers, after a share of the step."""
        return self._all([one.gap(share) for one in self.parts])

    def _longest(self) -> Array:
        """Share of the step to the nearest limit."""
        shares = [one.longest() for one in self.parts]
        return np.asarray(min(float(one.min()) for one in shares) if self.coupled else np.minimum.reduce(shares))

    def _factors(self, weight: Array) -> Array:
        """Q (d, d, k, N), with Q^T Q the inverse of what weighs the contacts' forces."""
        d, normal = self.d, weight[self.at["floor"]] + weight[self.at["cap"]]
        if self.cones is not None and not len(self.facets) and not self.weights.any():
            # (W^-2 + weight of the normal force)^-1 = W (1 + g g^T)^-1 W.
            W = self.cones.matrix()
            g = np.sqrt(normal) * W[0]
            size = np.sqrt(1.0 + np.einsum("i...,i...->...", g, g))
            along = np.einsum("i...,ij...->j...", g, W)
            return np.asarray(W - (g / (size * (1.0 + size)))[:, None] * along)
        # Orthogonal factors here as well: of facets, one may weigh 1e18 times what the others do.
        n, m = 0 if self.cones is None else len(self.cones.s), len(self.facets)
        T = np.zeros((d, n + m + d, self.k, self.N))
        if self.cones is not None:
            T[:n, :n] = self.cones.matrix(-1)
        if m:
            root = np.sqrt(weight[self.at["flat"]]).reshape(m, self.k, self.N)
            T[0, n : n + m], T[1:, n : n + m] = root, -self.facets.T[..., None, None] * root
        own = np.zeros((d, self.k, self.N)) + self.weights
        own[0] += normal
        T[range(d), range(n + m, n + m + d)] = np.sqrt(own)
        inverse = GramSchmidt(T.reshape(d, n + m + d, -1)).inverse
        return np.ascontiguousarray(inverse.transpose(1, 0, 2)).reshape(d, d, self.k, self.N)

    def _scaled(self, rows: Array) -> Array:
        """Q rows^T, for rows (m, d k): (m, d k, N)."""
        blocks, found = rows.reshape(-1, self.d, self.k), np.zeros((len(rows), self.d, self.k, self.N))
        for j in range(self.d):
            found += self.Q[:, j] * blocks[:, None, j, :, None]
        return found.reshape(len(rows), -1, self.N)

    def factorise(self) -> None:
        """What both steps of a round share."""
        N, m, forces = self.N, len(self.R), self.d * self.k
        if self.cones is not None:
            self.cones.scale()
        weight = self.sides.weight
        self.Q = self._factors(weight)
        limits = weight[self.at["below"]] + weight[self.at["above"]]
        self.rows = None
        # Orthogonal factors, not those of T^T T: some contacts weigh next to nothing, others all.
        if self.many:
            root = np.sqrt(limits)[:, None]
            self.rows = Rows(root * self._scaled(self.R), root * self.S[:m])
            T = self.rows.columns(self._scaled(self.A))
        else:
            self.give = 1.0 / np.maximum(limits, _UNLIMITED / self.size)
            T, at = np.zeros((len(self.coupling), forces + m, N)), np.arange(m)
            T[:, :forces] = self._scaled(np.concatenate([self.A, self.R]))
            T[len(self.A) + at, forces + at] = np.sqrt(self.give)
        self.factors: Factors = GramSchmidt(T) if len(T) <= _FEW else Householder(T)
        if self.ends is None:
            return
        self.through = [self.factors.transposed(self.coupling[:, j]) for j in (0, 1)]
        if self.rows is not None:
            self.through = [one + self.factors.across(own) for one, own in zip(self.through, self.rows.across)]
        u, v = self.through
        H = self.bend + (0.0 if self.rows is None else self.rows.left)
        H = H + np.stack([np.einsum("rn,rn->n", a, b) for a, b in ((u, u), (u, v), (v, v))])
        H += np.einsum("rn,rjn->jn", weight[self.at["pair"]], self.squares)
        free = self._pairs(self.free)
        self.across = H[1] * (free[0] & free[1])
        self.own = np.where(self.free, self._gathered(H[[0, 2]]) + self.ends.weight.sum(axis=0), 1.0)

    def _speeds(self, right: Array) -> Array:
        """The step of y: what is left of the equations, without forces."""
        if self.coupled:
            banded = np.stack([np.append(0.0, self.across), self.own])
            return np.asarray(solveh_banded(banded, right, check_finite=False))
        ratio = self.across / self.own[0]
        second = (right[1] - ratio * right[0]) / (self.own[1] - ratio * self.across)
        return np.stack([(right[0] - self.across * second) / self.own[0], second])

    def step(self, aim: Array, corrections: list[Array | float], *, refined: bool) -> None:
        """The Newton step towards products ``aim`` of slacks and multipliers."""
        pull = self.sides.pull(aim, corrections[0])
        # Rows that are eliminated with A pull there.
        forth, right = pull.copy(), -self.off
        if not self.many:
            forth[self.first : self.last] = 0.0
            right = np.concatenate([right, self.give * (pull[self.at["below"]] - pull[self.at["above"]])])
        r = (self.G.T @ forth[: self.last]).reshape(self.x.shape) - self.weights * self.x
        if self.cones is not None:
            r[: len(self.cones.s)] += self.cones.pull(aim, corrections[-1])
        pairs = np.einsum("rn,rjn->jn", forth[self.first :], self.S) - self.slope
        nodes = np.zeros(self.y.shape)
        if self.ends is not None:
            to_ends = self.ends.pull(aim, corrections[1])
            nodes = to_ends[0] - to_ends[1] + (0.0 if self.gain is None else self.gain)
        self.dx, self.dy, self.new_multipliers = self._solved_for(r, right, pairs, nodes)
        self._move_slacks(aim, corrections)
        if not refined:
            return
        # Slacks of the cones are far apart in size: what that leaves of the multipliers' equations is solved for again.
        left = self._left_over(self.new_multipliers, share=1.0)
        dx, dy, more = self._solved_for(-left, np.zeros(right.shape), np.zeros(pairs.shape), np.zeros(nodes.shape))
        if np.isfinite(dx).all() and np.isfinite(dy).all():
            self.dx, self.dy = self.dx + dx, self.dy + dy
            self.new_multipliers = self.new_multipliers + more
            self._move_slacks(aim, corrections)

    def _left_over(self, multipliers: Array, share: float = 0.0) -> Array:
        """What the multipliers' equations of the forces leave (d, k, N), after a share of the step."""
        sides = (self.sides.z + share * self.sides.dz)[: self.last]
        left = (self.A.T @ multipliers - self.G.T @ sides).reshape(self.x.shape)
        left += self.weights * (self.x + share * self.dx)
        if self.cones is not None:
            left[: len(self.cones.s)] -= self.cones.z + share * self.cones.dz
        return np.asarray(left)

    def _move_slacks(self, aim: Array, corrections: list[Array | float]) -> None:
        if self.ends is not None:
            self.ends.move(np.stack([self.dy, -self.dy]), aim, corrections[1])
        self.sides.move(self._changes(self.dx, self._pairs(self.dy)), aim, corrections[0])
        if self.cones is not None:
            self.cones.move(self.dx[: len(self.cones.s)])

    def _solved_for(self, r: Array, right: Array, pairs: Array, nodes: Array) -> tuple[Array, Array, Array]:
        """Changes of x and y, and the multipliers of A, for right-hand sides: of the forces (d, k, N), of the rows
        (m, N), of the ends of the intervals (2, N) and of y.
        """
        forces = self.d * self.k
        scaled = np.einsum("ijkn,jkn->ikn", self.Q, r).reshape(forces, self.N)
        if self.rows is not None:
            scaled = self.rows.transposed(scaled)
        else:
            scaled = np.concatenate([scaled, np.zeros((len(self.R), self.N))])
        ready = self.factors.across(scaled) - self.factors.transposed(right)
        dy, own = np.zeros(self.y.shape), ready
        if self.ends is not None:
            pairs = pairs + np.stack([np.einsum("rn,rn->n", one, ready) for one in self.through])
            if self.rows is not None:
                pairs -= np.einsum("jin,in->jn", self.rows.across, scaled)
            dy = self._speeds(np.where(self.free, self._gathered(pairs) + nodes, 0.0))
        dp = self._pairs(dy)
        if self.ends is not None:
            own = ready - self.through[0] * dp[0] - self.through[1] * dp[1]
        left = (scaled - self.factors.along(own))[:forces]
        if self.rows is not None:
            left = self.rows.divided(left - self.rows.across[0] * dp[0] - self.rows.across[1] * dp[1])
        dx = np.einsum("jikn,jkn->ikn", self.Q, left.reshape(self.x.shape))
        return dx, dy, self.factors.divided(own)[: len(self.A)]

    def _round(self) -> Array:
        """A predictor, a corrector and a share of their step, not a number where digits are used up."""
        self.factorise()
        gap = self.gap()
        none: list[Array | float] = [0.0, 0.0, 0.0]
        self.step(np.zeros_like(gap), none, refined=False)
        share = np.minimum(1.0, self._longest())
        after = np.maximum(self.gap(share), 0.0)
        corrections = [0.0 if one is None else one.second_order for one in (self.sides, self.ends, self.cones)]
        aim = np.maximum((after / gap) ** 3 * gap, _HEED * self.model_error(share)) / self.degree
        self.step(aim, corrections, refined=True)
        share = np.minimum(1.0, _BACK * self._longest())
        if self.program.step is not None:
            # The cost's model is of use as long as speeds do not fall by much.
            falling = np.where(self.free, -self.dy / np.maximum(self.y, _SMALL), 0.0)
            share = np.minimum(
                share, _FALL / np.maximum(falling.max() if self.coupled else falling.max(axis=0), _SMALL)
            )
        self._move(np.where(np.isfinite(share), share, np.nan))
        return share

    def model_error(self, share: Array) -> Array | float:
        """How far the cost is from its quadratic model after a share of the step: a smaller gap means nothing."""
        if self.program.step is None:
            return 0.0
        now, dp = self._pairs(self.y), share * self._pairs(self.dy)
        change = times(np.maximum(now + dp, 0.1 * now).T, self.program.step).value - self.took
        model = (self.slope * dp).sum(axis=0) + 0.5 * (self.bend * dp[[0, 0, 1]] * dp[[0, 1, 1]] * [[1], [2], [1]]).sum(
            axis=0
        )
        return self._all([np.abs(change - model)])

    def _move(self, share: Array) -> None:
        self.x, self.y = self.x + share * self.dx, self.y + share * self.dy
        self.multipliers = self.multipliers + share * (self.new_multipliers - self.multipliers)
        for one in self.parts:
            one.step(share)
        if self.cones is not None:
            self.x[: len(self.cones.s)] = self.cones.s
        self.measure()

    def _bound(self) -> tuple[Array, Array]:
        """A lower bound of the cost of any solution, and the largest error of balance and limits.

        What is left over of the multipliers' equations gains at most as much as forces and speeds can change. The cost
        is convex: it is above its tangent, and near the solution by its curvature.
        """
        program, sides, most = self.program, self.sides, self.program.most[:, None]
        r = self._left_over(self.multipliers)
        sums = [
            summed(self.multipliers * self.off) - summed(sides.off * sides.z) - summed(r * self.x),
            summed(np.minimum(r[0] * program.least[:, None], r[0] * most)) - summed(np.abs(r[1:]) * most),
        ]
        errors = [np.abs(self.off).max(axis=0) / self.size, np.abs(sides.off).max(axis=0)]
        if self.ends is not None:
            pairs = self.slope - np.einsum("rjn,rn->jn", self.E, self.multipliers)
            pairs -= np.einsum("rjn,rn->jn", self.S, sides.z[self.first :])
            nodes = self._gathered(pairs) + self.ends.z[1] - self.ends.z[0]
            nodes = np.where(self.free, nodes - (0.0 if self.gain is None else self.gain), 0.0)
            sums.append(-summed(self.ends.off * self.ends.z))
            gained = None
            if program.step is not None and self.coupled:
                gained = gained_by_times(self.y, nodes, self.free, program.step)
            sums.append(summed(np.minimum(nodes * self.highest, 0.0) - nodes * self.y) if gained is None else gained)
            ends = np.abs(self.ends.off)
            errors.append(ends.reshape(-1, ends.shape[-1]).max(axis=0))
        error = np.asarray(max(one.max() for one in errors) if self.coupled else np.maximum.reduce(errors))
        return np.asarray(self.cost - self.gap() + self._all(sums)), error

    def run(self, accuracy: float, rounds: int) -> Solved:
        """Rounds until the gap is small."""
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # where digits are used up
            return self._together(accuracy, rounds) if self.coupled else self._apart(accuracy, rounds)

    def _together(self, accuracy: float, rounds: int) -> Solved:
        """All intervals with the same steps."""
        best, bound, worse, done = self._solved(self._state(), -np.inf, np.inf, 0, accuracy), -np.inf, 0, 0
        for done in range(1, rounds + 1):
            try:
                share = self._round()
            except np.linalg.LinAlgError:  # out of digits
                break
            if not np.isfinite(share):
                break
            own, residual = (float(one) for one in self._bound())
            bound = max(bound, own)
            found = self._solved(self._state(), bound, residual, done, accuracy)
            error, least = (max(abs(one.gap), one.residual) for one in (found, best))
            worse = 0 if error < _BETTER * least else worse + 1
            best = found if error < least else best
            if (found.gap < accuracy and found.residual < accuracy) or (worse >= _WORSE and best.converged):
                break
        return best

    def _apart(self, accuracy: float, rounds: int) -> Solved:
        """Each interval with its own steps, until it is solved or gets no better."""
        state, places = self._state(), np.arange(self.N)
        found = {name: value.copy() for name, value in state.items()}
        bound, residual, merit = np.full(self.N, -np.inf), np.full(self.N, np.inf), np.full(self.N, np.inf)
        worse, done = np.zeros(self.N, dtype=int), 0
        while done < rounds:
            done += 1
            try:
                self._round()
            except np.linalg.LinAlgError:
                break
            own, error = self._bound()
            bound[places] = np.fmax(bound[places], own)
            size = np.maximum(np.abs(self.cost), _PART * np.abs(found["cost"]).mean())
            gap = (self.cost - bound[places]) / size
            now = np.nan_to_num(np.maximum(gap, error) / accuracy, nan=np.inf)
            better = now < merit[places]
            at = places[better]
            merit[at], residual[at] = now[better], error[better]
            for name, value in self._state().items():
                found[name][..., at] = value[..., better]
            worse[places] = np.where(better, 0, worse[places] + 1)
            left = (now >= 1.0) & np.isfinite(now) & (worse[places] < _LOST)
            if not left.any():
                break
            if left.mean() < _MOST:
                self._keep(left)
                places = places[left]
        return self._solved(found, float(bound.sum()), float(residual.max()), done, accuracy)

    def _keep(self, which: BoolArray) -> None:
        """Only these intervals from now on."""
        for name in _OF_INTERVALS:
            if (value := getattr(self, name, None)) is not None:
                setattr(self, name, value[..., which])
        for one in self.parts:
            one.keep(which)
        self.N = len(self.cost)

    def _state(self) -> dict[str, Array]:
        friction = self.sides.z[self.at["flat"]].reshape(-1, self.k, self.N).sum(axis=0)
        return {
            "y": self.y,
            "x": self.x,
            "sides": self.sides.z,
            "ends": np.zeros_like(self.y) if self.ends is None else self.ends.z[1],
            "cones": friction if self.cones is None else friction + self.cones.z[0],
            "cost": self.cost,
        }

    def _solved(self, state: dict[str, Array], bound: float, residual: float, rounds: int, accuracy: float) -> Solved:
        program, z, order = self.program, state["sides"].T, [*range(1, self.d), 0]
        y, speeds = (one if self.coupled else one.T.ravel() for one in (state["y"], state["ends"]))
        if program.shared and not self.coupled:
            y, speeds = program.given, np.zeros_like(program.given)
        floor, cap, below, above, pair = (z[:, self.at[name]] for name in ("floor", "cap", "below", "above", "pair"))
        return Solved(
            y=y,
            x=state["x"][order].transpose(2, 1, 0),
            objective=float(state["cost"].sum()),
            lower_bound=bound,
            residual=residual,
            rounds=rounds,
            accuracy=accuracy,
            rows=np.stack([below, above]),
            pairs=pair,
            speeds=speeds,
            normals=np.stack([floor, cap]),
            cones=state["cones"].T,
        )
