"""The methods that solve a program, asked one after the other until an answer passes its certificate."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from pinograsp.errors import Status
from pinograsp.forces.active_set import solve_dense
from pinograsp.forces.answers import Answer, CertifiedForces, certify
from pinograsp.forces.certificate import Infeasibility
from pinograsp.forces.conic import HUGE, solve_conic
from pinograsp.forces.infeasibility import prove
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import Program
from pinograsp.forces.solvers import SOLVERS, compiled_solvers

_USEFUL = 1e-3  # of the load: forces that miss their limits by more are no answer at all
_COMPILED = ("interior", "newton")
FORCE_SOLVERS = ("auto", *_COMPILED, *SOLVERS)
# Up to here a dense active-set method is faster on pyramids than a sparse interior-point method (benchmarks/forces.py).
_DENSE_UP_TO = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What came of a program.

    Attributes:
        status: ``OK``, ``INFEASIBLE`` or ``INACCURATE``.
        solver: the one that answered; of a proof the first one asked, "" if none was.
        forces: with their certificate; of an inaccurate outcome the best that were found, or None.
        infeasibility: the proof that there are no forces, or None.
    """

    status: Status
    solver: str
    forces: CertifiedForces | None = None
    infeasibility: Infeasibility | None = None


def solve_certified(problem: ForceProblem, program: Program, solver: str) -> Outcome:
    """Forces of a program, or the proof that there are none; where a certificate fails the next method is asked."""
    if np.any(program.lo > program.hi):
        return Outcome(status=Status.INFEASIBLE, solver="", infeasibility=prove(problem, program))
    best = Outcome(status=Status.INACCURATE, solver=solver)
    backends = _backends(program, solver)
    for name in backends:
        answer = _answer(program, name)
        if answer is None or not all(np.abs(part).max(initial=0.0) < HUGE for part in answer[:3]):
            continue
        found = certify(problem, program, answer)
        if found.certificate.is_optimal():
            return Outcome(status=Status.OK, solver=name, forces=found)
        # Kept for the record, unless it is of no use: the one that misses its limits least.
        violation = found.certificate.violation
        if violation <= _USEFUL * program.force_scale and (
            best.forces is None or violation < best.forces.certificate.violation
        ):
            best = Outcome(status=Status.INACCURATE, solver=name, forces=found)
    proof = prove(problem, program)
    return best if proof is None else Outcome(status=Status.INFEASIBLE, solver=backends[0], infeasibility=proof)


def _backends(program: Program, solver: str) -> tuple[str, ...]:
    """The methods to ask, in order: the one asked for, then the general ones; every one takes what it can."""
    general = ("daqp", "clarabel") if program.k <= _DENSE_UP_TO else ("clarabel", "daqp")
    if solver == "auto":
        compiled = sys.modules.get("pinograsp.forces.compiled")
        solver = (compiled.template_of(program).choice(solver) if compiled else "") or general[0]
    return tuple(dict.fromkeys((solver, *general)))


def _answer(program: Program, name: str) -> Answer | None:
    if name == "clarabel":
        return solve_conic(program)
    if name not in _COMPILED:
        return solve_dense(program, name)
    compiled_solvers()
    from pinograsp.forces.compiled import solve_program

    return solve_program(program, name)
