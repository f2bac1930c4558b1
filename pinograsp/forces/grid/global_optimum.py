"""The global optimum over the impact time and all normal forces, with a certified gap: branch and bound in t_I.

For a fixed t_I the problem is convex (:mod:`pinograsp.forces.optimize`). Over an interval of impact times it is bounded
from below by one convex program: every coefficient of the energy takes its least value (they are monotone in
tau = t_F - t_I: impulse grows with it, the damping's part of the work falls), and F_n may range from the least lower
to the greatest upper bound (both ends grow with tau). The bound itself is proven by the program's dual. Intervals are
split until the best forces found cost at most ``gap`` more than the least bound left.
"""

from __future__ import annotations

import heapq
import time
from dataclasses import replace

from tqdm import tqdm

from pinograsp.checks import instance_of, number
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import Infeasibility
from pinograsp.forces.grid.cells import progress_bar
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import Branch, GlobalSolution, solution_of
from pinograsp.forces.solve.answers import CertifiedForces
from pinograsp.forces.solve.program import Objective, Program, assemble, energy_terms_at, program_at, weights_of
from pinograsp.forces.solve.solver_order import ProgramOutcome, SolverName, SolverOrder, check_solver

_NARROWEST = 1e-10  # [s]: on narrower intervals of t_I the bounds differ by less than the certificates' accuracy
# Largest number of intervals that are split, and of relaxations that no solver decides: at the limit of feasibility
# halving an interval does not help.
_MOST, _UNDECIDED = 2000, 30


def optimize_grasp(
    problem: ForceProblem,
    *,
    objective: Objective | None = None,
    solver: SolverName = "auto",
    gap: float = 1e-6,
    progress: bool | None = None,
) -> GlobalSolution:
    """Find the globally least-cost forces over all impact times of ``problem.impact_time_range`` and all decelerations.

    Args:
        problem: contacts, load, friction, limits; any deceleration shape.
        objective, solver: as for :func:`~pinograsp.forces.optimize_forces`.
        gap: relative gap at which the search ends [-].
        progress: progress bar on stderr: None (long searches on a terminal), True or False.

    Returns:
        The optimum. Its ``certificate.lower_bound`` bounds *every* impact time, so ``certificate.relative_gap`` is
        the global gap; ``branches`` is the log. ``INFEASIBLE``: every interval is proven infeasible, ``infeasibility``
        is the proof of the one that came closest. ``INACCURATE``: some interval was not decided, or the gap not
        reached, within 2000 intervals or 30 undecided ones. ``INTERRUPTED`` (Ctrl-C): the best so far, with the bound
        reached.

    Raises:
        InvalidInput: unknown objective or solver, or a gap below 1e-9.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> best = pg.optimize_grasp(problem)
        >>> print(best.status, best.normal_forces.round(1), f"t_I = {best.impact_time:.2f} s")
        ok [1.1 1.1 1.1] t_I = 0.95 s

    See Also:
        :func:`~pinograsp.forces.optimize_forces` at one impact time; :func:`~pinograsp.forces.grid_search`, the paper's
        method.
    """
    started = time.perf_counter()
    instance_of("problem", problem, ForceProblem)
    instance_of("progress", progress, bool, type(None))
    search = _BranchAndBound(problem, weights_of(objective, problem), check_solver(solver))
    gap = number("gap", gap, above=0)
    if gap < 1e-9:
        raise InvalidInput(f"gap: expected at least 1e-9 (the certificates' own accuracy), got {gap:g}")
    interrupted = False
    bar = progress_bar(None, "branch and bound", "interval", progress)
    try:
        search.run(gap, bar)
    except KeyboardInterrupt:
        interrupted = True
    bar.close()
    return search.solution(gap, interrupted, started)


class _BranchAndBound:
    def __init__(self, problem: ForceProblem, weights: dict[str, float], solver: str):
        self.problem, self.weights, self.solver = problem, weights, solver
        self.matrices = matrices_of(problem, weights)
        self.solvers = SolverOrder(self.matrices, solver)
        self.first = self.solvers.order[0]  # the method to try first: with "auto" the one that answered last
        self.best: CertifiedForces | None = None
        self.best_value, self.best_time, self.best_solver = float("inf"), self.problem.impact_time_range[0], ""
        self.open: list[tuple[float, int, float, float]] = []
        self.closed_bound = float("inf")  # least bound of intervals set aside
        self.log: list[Branch] = []
        self.proof: Infeasibility | None = None
        self.unresolved = False
        self.undecided = 0  # number of relaxations with neither forces nor a proof

    def run(self, gap: float, bar: tqdm) -> None:
        low, high = self.problem.impact_time_range
        for t in dict.fromkeys((high, low)):
            self.visit(t)
        self.keep(low, high, self.relax(low, high, -float("inf")))
        splits = 0
        while self.open and splits < _MOST and self.undecided < _UNDECIDED:
            bound, _, a, b = heapq.heappop(self.open)
            if bound >= self.best_value - gap * self.size():
                self.closed_bound = min(self.closed_bound, bound)
                self.log.append(Branch(a, b, bound, self.best_value, "bounded"))
                continue
            if b - a <= _NARROWEST:
                self.unresolved = True
                self.closed_bound = min(self.closed_bound, bound)
                self.log.append(Branch(a, b, bound, self.best_value, "unresolved"))
                continue
            splits += 1
            self.log.append(Branch(a, b, bound, self.best_value, "split"))
            middle = (a + b) / 2
            # Kept open while its halves are bounded: an interruption then still has a valid bound.
            heapq.heappush(self.open, (bound, -1, a, b))
            self.visit(middle)
            left, right = self.relax(a, middle, bound), self.relax(middle, b, bound)
            self.open.remove((bound, -1, a, b))
            heapq.heapify(self.open)
            self.keep(a, middle, left)
            self.keep(middle, b, right)
            bar.update()
        self.log += [Branch(a, b, bound, self.best_value, "unresolved") for bound, _, a, b in sorted(self.open)]

    def size(self) -> float:
        """The size that the gap is compared with: that of the incumbent's certificate."""
        return self.best.certificate.objective_size if self.best else 0.0

    def visit(self, t: float) -> None:
        """Best forces at one impact time; they become the incumbent if they are the cheapest so far."""
        found = self.solve(program_at(self.problem, self.matrices, t))
        if (
            found.status is Status.OK
            and found.forces is not None
            and found.forces.certificate.objective < self.best_value
        ):
            self.best, self.best_value = found.forces, found.forces.certificate.objective
            self.best_time, self.best_solver = t, found.solver

    def solve(self, program: Program) -> ProgramOutcome:
        """The outcome of a program; of several proofs the one with the least margin is kept."""
        found = self.solvers.solve(self.problem, program, first=self.first)
        if self.solver == "auto" and found.status is Status.OK:
            self.first = found.solver
        proof = found.infeasibility
        if proof is not None and (self.proof is None or proof.margin < self.proof.margin):
            self.proof = proof
        return found

    def relax(self, a: float, b: float, parent: float) -> float:
        """Proven lower bound of the objective over t_I in [a, b]; infinite: the relaxation is proven infeasible."""
        problem = self.problem
        early, late = (energy_terms_at(problem, self.weights, t) for t in (a, b))
        least = ([(min(x, y), p) for (x, p), (y, _) in zip(early[m], late[m])] for m in early)
        terms = dict(zip(early, least))
        (_, hi), (lo, _) = problem.normal_force_range(a), problem.normal_force_range(b)
        program = assemble(self.matrices, problem.scaled_load, terms, lo, hi)
        found = self.solve(program)
        self.undecided += found.status is Status.INACCURATE
        if found.status is Status.INFEASIBLE:
            return float("inf")
        return parent if found.forces is None else max(parent, found.forces.certificate.lower_bound)

    def keep(self, a: float, b: float, bound: float) -> None:
        if bound == float("inf"):
            self.log.append(Branch(a, b, bound, self.best_value, "infeasible"))
        else:
            heapq.heappush(self.open, (bound, len(self.log), a, b))

    def solution(self, gap: float, interrupted: bool, started: float) -> GlobalSolution:
        if self.best is None:
            undecided = Status.INACCURATE if self.unresolved or self.open else Status.INFEASIBLE
            outcome = ProgramOutcome(
                status=Status.INTERRUPTED if interrupted else undecided, solver=self.solver, infeasibility=self.proof
            )
        else:
            left = min([self.closed_bound, self.best_value, *(bound for bound, *_ in self.open)])
            certificate = replace(self.best.certificate, lower_bound=left)
            closed = certificate.relative_gap <= gap * (1 + 1e-9)
            status = Status.INTERRUPTED if interrupted else Status.OK if closed else Status.INACCURATE
            forces = replace(self.best, certificate=certificate)
            outcome = ProgramOutcome(status=status, solver=self.best_solver, forces=forces)
        found = solution_of(self.problem, outcome, impact_time=self.best_time, weights=self.weights, started=started)
        return GlobalSolution(**vars(found), branches=tuple(self.log))
