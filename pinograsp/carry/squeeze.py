"""Squeezes that do not follow every load: commanded once for the whole way, or changed no faster than at some rate.

The hand commands normal forces F; the contacts react to each load as equal springs do
(:func:`~pinograsp.forces.matrices.elastic_reaction`), with tangential forces that friction allows:

    n_i = F_i + C (w_i - w_0),   A x_i = w_i,   friction and limits of x_i,   |F_i+1 - F_i| <= rate dt_i,

w_i being what the contacts give the object and w_0 that of the first instant. The least sum of squares of F is a convex
program with second-order cones, which Clarabel solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp.carry.constraints import PathConstraints
from pinograsp.carry.passage import Passage
from pinograsp.carry.solving import solve_carry
from pinograsp.checks import brief
from pinograsp.errors import CarryInfeasible, CarryUndecided
from pinograsp.forces.matrices import elastic_reaction
from pinograsp.forces.solve.conic import Cone, cone_rows, solve
from pinograsp.spatial import Array, multiply_rows

_BALANCED = 1e-6  # error of what was found, over the largest load
_PROOF = 1e-6  # of a ray that rules forces out, over what it gains
_FORCES, _LEAST = 1e-6, 1e-3  # relative, of the squared forces: what is asked for, and the gap that is good enough
_HALVINGS = 9  # of the interval in which the largest factor on the speed lies


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WaySqueeze:
    """Forces along a passage.

    Attributes:
        passage: the timing.
        x: forces (N, k, d), as in a force program.
        commanded: normal forces that are commanded (N, k) [N].
        residual: largest error of the balance, over the largest load [-].
        notes: what the caller should know.
    """

    passage: Passage
    x: Array
    commanded: Array
    residual: float
    notes: tuple[str, ...] = ()

    __repr__ = brief("residual")


def squeeze_least(passage: Passage) -> WaySqueeze:
    """The forces of least squares at every sample.

    Raises:
        CarryUndecided: none were found.
    """
    grasp, count = passage.constraints.grasp, passage.constraints.count
    found = solve_carry(passage.constraints.least_forces(np.full(count + 1, passage.level)), accuracy=_FORCES)
    # Which forces are taken matters less than that they balance the loads.
    least = found.residual < _BALANCED and found.gap < _LEAST
    notes = () if least else ("the forces hold the loads, but they are not the least ones",)
    if found.residual >= _BALANCED and passage.fastest:
        found = passage.solution
    if found.residual >= _BALANCED:
        raise CarryUndecided(
            f"no forces were found, although some exist for this timing: balance to {found.residual:.1e} after "
            f"{found.rounds} rounds",
            solution=found,
        )
    x = found.x[:, : grasp.problem.k].copy()
    x[..., -1] += grasp.spare
    return WaySqueeze(passage=passage, x=x, commanded=x[..., -1], residual=found.residual, notes=notes)


def squeeze_steadily(passage: Passage, rate: float, *, slower: bool) -> WaySqueeze:
    """Normal forces that are commanded once, or change at no more than ``rate`` [N/s].

    ``slower``: whether to slow down where there are none at this speed; otherwise that is an error.

    Raises:
        CarryInfeasible: there are none.
    """
    every = [passage.constraints, *passage.constraints.others]
    steps = np.diff(passage.instants)

    def search(factor: float) -> CommonSqueeze:
        return find_common_squeeze(every, steps / factor, rate, passage.level * factor**2)

    found, factor = search(1.0), 1.0
    if not found.exists:
        low, high, best = 0.0, 1.0, None
        for _ in range(_HALVINGS):
            factor = (low + high) / 2.0
            tried = search(factor)
            low, high, best = (factor, high, tried) if tried.exists else (low, factor, best)
        if best is None or not slower:
            kind = "constant squeeze" if not rate else f"squeeze that changes by at most {rate:g} N/s"
            at_rest = "not even at rest" if best is None else f"at {low:.3g} times that speed one does"
            raise CarryInfeasible(
                f"no {kind} withstands the whole path at this speed{', proven' if found.ruled_out else ''}; {at_rest}: "
                "let the squeeze follow the loads (squeeze='least'), or go slower",
                at=float(passage.s[int(passage.headroom.argmin())]),
                solution=found,
                factor=low,
            )
        found, factor = best, low
    passage = passage.speed_up(factor)
    return WaySqueeze(passage=passage, x=found.x[0], commanded=found.commanded, residual=found.residual)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonSqueeze:
    """What came of a search for a common squeeze; N samples, S scenarios of loads.

    Attributes:
        commanded: normal forces F at the first load (N, k) [N]; empty where none was found.
        x: forces of every scenario (S, N, k, d), as in a force program.
        ruled_out: whether there is none, by a ray that was checked.
        residual: largest error of balance and limits, over the largest load [-].
    """

    commanded: Array
    x: Array
    ruled_out: bool
    residual: float

    __repr__ = brief("ruled_out", "residual")

    @property
    def exists(self) -> bool:
        """Whether there is one."""
        return bool(len(self.commanded))


def find_common_squeeze(scenarios: Sequence[PathConstraints], steps: Array, rate: float, level: float) -> CommonSqueeze:
    """The squeeze of least squares that withstands every scenario's loads at all samples.

    Args:
        scenarios: programs of timed loads (S), of the same contacts.
        steps: time from each sample to the next (N - 1,) [s].
        rate: largest change of each normal force [N/s]; 0: one squeeze for all samples.
        level: square of the factor on the speed of the timing that the programs are for.
    """
    return _CommonProgram(scenarios, steps, rate, level).solve()


class _CommonProgram:
    """Columns: F of each sample, or of all (m, k), then x of each scenario and sample (S, N, k d); over a force."""

    def __init__(self, scenarios: Sequence[PathConstraints], steps: Array, rate: float, level: float):
        first = scenarios[0]
        problem = first.grasp.problem
        self.matrices, self.k, self.d = first.matrices, problem.k, problem.friction.d
        self.S, self.N, self.width = len(scenarios), first.count, self.k * self.d
        self.m = self.N if rate else 1
        lines = [one.alone for one in scenarios]
        wanted = np.stack([line.E.sum(axis=2) * level + line.e for line in lines])
        wrenches = np.stack([one.middle.wrench.at_square(level) * one.wrench_scale for one in scenarios])
        self.size = max(float(np.abs(wanted).max()), 1e-9)
        self.A, self.target = lines[0].A, wanted / self.size
        C = elastic_reaction(problem)
        self.change = -multiply_rows(wrenches - wrenches[0, 0], C.T) / self.size
        moved = np.stack([line.B.sum(axis=2) * level for line in lines])
        low, high = (np.stack([getattr(line, end) for line in lines]) - moved for end in ("low", "high"))
        if own := self.matrices.fixed:  # what the drives make they make once: the rest is the fingers' own reaction
            others = np.ones((self.S, self.N), dtype=bool)
            others[0, 0] = False
            low[others, -own:], high[others, -own:] = -np.inf, np.inf
        self.low, self.high = low / self.size, high / self.size
        self.least, self.most = lines[0].least / self.size, lines[0].most / self.size
        self.spare = first.grasp.spare
        self.most_change = rate * steps / self.size

    def _stack(self) -> tuple[sp.csc_matrix, Array, list[Cone]]:
        """Rows, right-hand side and cones of A z + s = b."""
        friction = cone_rows(self.matrices)
        count, each = self.S * self.N, sp.identity(self.S * self.N, format="csr")
        common = sp.identity(self.m * self.k, format="csr")
        to_sample = np.ones((self.N, 1)) if self.m == 1 else sp.identity(self.N)
        of_sample = sp.kron(np.ones((self.S, 1)), sp.kron(to_sample, sp.identity(self.k)), format="csr")

        def alone(block: Array) -> sp.csr_matrix:
            """Rows of the forces of every sample."""
            return sp.hstack([sp.csr_matrix((count * len(block), common.shape[0])), sp.kron(each, block)], format="csr")

        normal = sp.kron(each, friction.select)
        rows = [alone(self.A), sp.hstack([-of_sample, normal])]
        right = [self.target.ravel(), self.change.ravel()]
        equations = count * (len(self.A) + self.k)
        rows.append(sp.hstack([-common, sp.csr_matrix((common.shape[0], count * self.width))]))
        right.append(np.zeros(common.shape[0]))
        rows += [alone(-friction.select), alone(friction.select), alone(friction.facets)]
        right += [np.tile(-self.least, count), np.tile(self.most, count), np.zeros(count * len(friction.facets))]
        R = alone(self.matrices.R)
        for sign, ends in ((-1.0, self.low), (1.0, self.high)):
            kept = np.isfinite(ends).ravel()
            rows.append(sign * R[kept])
            right.append(sign * ends.ravel()[kept])
        if self.m > 1:
            later = sp.kron(sp.diags([-1.0, 1.0], [0, 1], shape=(self.N - 1, self.N)), sp.identity(self.k))
            change = sp.hstack([later, sp.csr_matrix((later.shape[0], count * self.width))])
            rows += [change, -change]
            right += 2 * [np.repeat(self.most_change, self.k)]
        inequalities = sum(len(one) for one in right) - equations
        rows.append(alone(friction.second))
        right.append(np.zeros(count * len(friction.second)))
        cones: list[Cone] = [clarabel.ZeroConeT(equations), clarabel.NonnegativeConeT(inequalities)]
        cones += [clarabel.SecondOrderConeT(size) for size in friction.sizes * count]
        return sp.vstack(rows, format="csc"), np.concatenate(right), cones

    def solve(self) -> CommonSqueeze:
        """The squeeze, or the proof that there is none."""
        A, b, cones = self._stack()
        columns, commanded = A.shape[1], self.m * self.k
        weights = np.zeros(columns)
        weights[:commanded] = 1.0 / self.m
        found = solve(sp.diags(weights, format="csc"), np.zeros(columns), A, b, cones)
        z, slack, ray = (np.array(part) for part in (found.x, found.s, found.z))
        nothing = CommonSqueeze(
            commanded=np.zeros((0, self.k)),
            x=np.zeros((self.S, 0, self.k, self.d)),
            ruled_out=False,
            residual=np.inf,
        )
        if "Infeasible" in str(found.status):
            # Where A' ray = 0 > b . ray no z has A z + s = b with s in the cones, whose duals they are.
            along = float(b @ ray)
            proven = along < 0 and float(np.abs(A.T @ ray).max()) <= -_PROOF * along
            return replace(nothing, ruled_out=proven)
        residual = float(np.abs(A @ z + slack - b).max()) if np.isfinite(z).all() else np.inf
        if not residual <= _BALANCED:
            return nothing
        F = np.broadcast_to(z[:commanded].reshape(self.m, self.k), (self.N, self.k))
        x = z[commanded:].reshape(self.S, self.N, self.k, self.d)
        x[..., -1] += self.spare / self.size
        return CommonSqueeze(commanded=self.size * F + self.spare, x=self.size * x, ruled_out=False, residual=residual)
