"""The methods that solve a program, tried one after the other until an answer passes its certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from pinograsp import core
from pinograsp.checks import one_of
from pinograsp.errors import Status
from pinograsp.forces.certificate import Infeasibility
from pinograsp.forces.infeasibility import prove
from pinograsp.forces.matrices import Matrices
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.active_set import DenseMethod
from pinograsp.forces.solve.answers import CertifiedForces, ProgramAnswer, certify_answer
from pinograsp.forces.solve.compiled import PreparedForces, solve_program
from pinograsp.forces.solve.conic import HUGE, ConicMethod, exponents_of
from pinograsp.forces.solve.program import EnergyTerms, Program
from pinograsp.forces.solve.registry import Takes, ask_solver, list_registered, register
from pinograsp.forces.solve.solvers import OwnQPSolver, qp_solvers
from pinograsp.forces.solve.template import Template
from pinograsp.spatial import Array

_USEFUL = 1e-3  # relative to the load: forces that miss their limits by more are not recorded
CompiledName = Literal["interior", "newton"]
COMPILED: tuple[CompiledName, ...] = get_args(CompiledName)
OwnSolver = Literal["auto", CompiledName, OwnQPSolver]
# For completion; registered ones have any name.
SolverName: TypeAlias = OwnSolver | str
# Those that come with the package; all that are there: available_solvers().
SOLVERS: tuple[OwnSolver, ...] = get_args(OwnSolver)
AT_HAND = ("auto", *COMPILED, "daqp")  # for sure, and without the time that a look at the others takes
# Up to here a dense active-set method is faster on pyramids than a sparse interior-point method (benchmarks/forces.py).
_DENSE_UP_TO = 20


def available_solvers() -> tuple[str, ...]:
    """Return the names that ``solver=`` accepts here: the compiled methods, every solver that qpsolvers finds,
    registered ones.
    """
    return ("auto", *COMPILED, *dict.fromkeys((*qp_solvers(), *list_registered())))


def check_solver(name: str) -> str:
    """``name`` if it is a solver that is there; else :class:`~pinograsp.errors.InvalidInput` with those that are."""
    return one_of("solver", name, AT_HAND if isinstance(name, str) and name in AT_HAND else available_solvers())


def register_solver(name: str, function: Callable[[Any], Any], *, takes: Takes = "qp") -> None:
    """Register a solver of your own, to be called by its name: ``optimize_forces(problem, t, solver=name)``.

    This package's own certificate judges whatever it returns; if that fails, DAQP and Clarabel follow as with every
    solver. Names are known in this process only: workers of a sweep have to register their own.

    Args:
        name: free so far (:func:`available_solvers`).
        function: takes a program and returns x (n,), or a :class:`SolverAnswer` with multipliers (solutions of
            qpsolvers and Clarabel are accepted, too), or None if it finds none. Without multipliers the lower bound is
            proven with those of one more solve of this package's own. Its exceptions are passed on.
        takes: ``"qp"``: the function gets a :class:`QuadraticProgram`, several for grasp energies and cones (Newton
            steps, each positive definite; cones need multipliers); ``"socp"``: one :class:`ConicProgram`, with power
            cones for grasp energies.

    Raises:
        InvalidInput: a name that is taken, no function, an unknown kind of program.
    """
    register(name, function, takes, available_solvers())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramOutcome:
    """The outcome of a program.

    Attributes:
        status: ``OK``, ``INFEASIBLE`` or ``INACCURATE``.
        solver: the method that answered; for a proof the first method tried, "" if there was none.
        forces: with their certificate; for an inaccurate outcome the best that were found, or None.
        infeasibility: the proof that there are no forces, or None.
    """

    status: Status
    solver: str
    forces: CertifiedForces | None = None
    infeasibility: Infeasibility | None = None


class SolverOrder:
    """The methods that solve the programs of these matrices, each prepared when it is first used.

    Attributes:
        order: names of the methods, in the order in which they are tried.
    """

    def __init__(self, matrices: Matrices, solver: str):
        """With "auto" the order depends on the matrices and on whether the core is installed, and on nothing else."""
        general = ("daqp", "clarabel") if matrices.k <= _DENSE_UP_TO else ("clarabel", "daqp")
        self._matrices = matrices
        if solver == "auto":
            compiled = [name for name in ("newton", "interior") if self.takes(name)] if core.is_installed() else []
            solver = next(iter(compiled), general[0])
        self.order = tuple(dict.fromkeys((solver, *general)))
        self._dense: dict[str, DenseMethod] = {}
        self._conic: ConicMethod | None = None

    @cached_property
    def template(self) -> Template:
        """The matrices as the compiled methods take them."""
        return Template(self._matrices)

    def prepare(
        self, problem: ForceProblem, terms: EnergyTerms, normal_force_range: tuple[Array, Array]
    ) -> PreparedForces | None:
        """All but the load for the first method, in the core; None where that is not a compiled one, or does not take
        these problems.
        """
        method = self.order[0]
        # Equations of an underactuated hand have one side each: as programs alone their other side is set.
        if method not in COMPILED or not self.takes(method) or self._matrices.fixed:
            return None
        return PreparedForces(problem, self.template, method, terms, normal_force_range)

    def takes(self, name: str) -> bool:
        """Whether a compiled method takes these matrices."""
        return self._matrices.separates if name == "newton" else self._matrices.decoupled

    def solve(self, problem: ForceProblem, program: Program, *, first: str = "", tried: bool = False) -> ProgramOutcome:
        """Forces of a program, or the proof that there are none; where a certificate fails the next method is tried.

        ``first`` is tried before the others. ``tried``: the first of ``order`` was tried elsewhere, without success.
        """
        if np.any(program.lo > program.hi):
            return ProgramOutcome(status=Status.INFEASIBLE, solver="", infeasibility=prove(problem, program))
        order = self.order if not first else tuple(dict.fromkeys((first, *self.order)))
        best = ProgramOutcome(status=Status.INACCURATE, solver=order[0])
        for name in order:
            answer = None if tried and name == self.order[0] else self._answer(problem, program, name)
            if answer is None or not all(np.abs(part).max(initial=0.0) < HUGE for part in answer[:3]):
                continue
            found = certify_answer(problem, program, answer)
            if found.certificate.is_optimal():
                return ProgramOutcome(status=Status.OK, solver=name, forces=found)
            # Recorded if nothing better follows: the answer that misses its limits least.
            violation = found.certificate.violation
            if violation <= _USEFUL * program.force_scale and (
                best.forces is None or violation < best.forces.certificate.violation
            ):
                best = ProgramOutcome(status=Status.INACCURATE, solver=name, forces=found)
        proof = prove(problem, program)
        return best if proof is None else ProgramOutcome(status=Status.INFEASIBLE, solver=order[0], infeasibility=proof)

    def _answer(self, problem: ForceProblem, program: Program, name: str) -> ProgramAnswer | None:
        if name in COMPILED:
            if not self.takes(name):
                return None
            return solve_program(problem, program, self.template, name)
        if name == "clarabel":
            return self._over_cones(program).solve(program)
        if name in list_registered("socp"):
            method = self._over_cones(program)
            found = ask_solver(name, method.standard_form(program))
            answer = None if found is None else method.answer(program, found.x, found.z)
        else:
            if name not in self._dense:
                self._dense[name] = DenseMethod(self._matrices, name)
            answer = self._dense[name].solve(program)
        if answer is not None and not len(answer.y):
            own = self._over_cones(program).solve(program)
            answer = answer if own is None else own._replace(x=answer.x)
        return answer

    def _over_cones(self, program: Program) -> ConicMethod:
        exponents = exponents_of(program)
        if self._conic is None or self._conic.exponents != exponents:
            self._conic = ConicMethod(self._matrices, exponents)
        return self._conic
