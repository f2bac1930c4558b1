"""Contact forces: the problem, grid searches, the multiplier QP, certified convex optima, margins, robust sets."""

from pinograsp.forces.autodiff import to_jax, to_torch
from pinograsp.forces.better_contacts import BetterContacts, optimize_contacts
from pinograsp.forces.certificate import TOLERANCE, Certificate, Infeasibility, Tolerance
from pinograsp.forces.conditions import GraspConditions, TorqueLimit
from pinograsp.forces.diagnosis import Diagnosis, diagnose
from pinograsp.forces.grid.cells import GridSpec, grid_values
from pinograsp.forces.grid.global_optimum import optimize_grasp
from pinograsp.forces.grid.search import SEARCHES, GridMethod, GridSearch, grid_search
from pinograsp.forces.optimize import optimize_forces
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.forces import Reaction, RobustForces, SqueezeScenario
from pinograsp.forces.robust.load_set import LoadSet
from pinograsp.forces.robust.margins import (
    GraspMargins,
    disturbance_margin,
    disturbance_margins,
    grasp_margins,
    load_factor,
)
from pinograsp.forces.robust.optimum import optimize_robust
from pinograsp.forces.robust.reliability import Reliability, holding_probability
from pinograsp.forces.robust.reserve import Reserve
from pinograsp.forces.robust.reserve_search import (
    least_squeeze,
    optimize_reserve,
    producible_reserve,
    reserve_along,
    search_reserve,
)
from pinograsp.forces.robust.sensitivity import Sensitivity, force_sensitivity
from pinograsp.forces.robust.task import Task
from pinograsp.forces.robust.wrench_closure import ForceClosure, force_closure, min_weight
from pinograsp.forces.settings import ForceSettings
from pinograsp.forces.solution import (
    Branch,
    ConvexSolution,
    ForceSolution,
    GlobalSolution,
    GridLog,
    GridSolution,
)
from pinograsp.forces.solve.batch import BatchSolution, ForceBatch, solve_batch
from pinograsp.forces.solve.export import to_qp, to_socp
from pinograsp.forces.solve.multipliers import MultiplierQP, MultiplierSolution, refine_multipliers
from pinograsp.forces.solve.program import OBJECTIVES, Objective, ObjectiveName
from pinograsp.forces.solve.registry import unregister_solver
from pinograsp.forces.solve.solver_order import SOLVERS, SolverName, available_solvers, register_solver
from pinograsp.forces.solve.solvers import QP_SOLVERS, QPSolverName, qp_solvers
from pinograsp.forces.solve.standard_form import (
    Column,
    Cones,
    ConicProgram,
    ForceQP,
    ForceSOCP,
    QuadraticProgram,
    SolverAnswer,
)
from pinograsp.forces.solver import ForceSolver
from pinograsp.forces.torque_limits import TorqueLimits, Underactuation

__all__ = [
    "OBJECTIVES",
    "QP_SOLVERS",
    "SEARCHES",
    "SOLVERS",
    "TOLERANCE",
    "BatchSolution",
    "BetterContacts",
    "Branch",
    "Certificate",
    "Column",
    "Cones",
    "ConicProgram",
    "ConvexSolution",
    "Diagnosis",
    "ForceBatch",
    "ForceClosure",
    "ForceProblem",
    "ForceQP",
    "ForceSOCP",
    "ForceSettings",
    "ForceSolution",
    "ForceSolver",
    "GlobalSolution",
    "GraspConditions",
    "GraspMargins",
    "GridLog",
    "GridMethod",
    "GridSearch",
    "GridSolution",
    "GridSpec",
    "Infeasibility",
    "LoadSet",
    "MultiplierQP",
    "MultiplierSolution",
    "Objective",
    "ObjectiveName",
    "QPSolverName",
    "QuadraticProgram",
    "Reaction",
    "Reliability",
    "Reserve",
    "RobustForces",
    "Sensitivity",
    "SolverAnswer",
    "SolverName",
    "SqueezeScenario",
    "Task",
    "Tolerance",
    "TorqueLimit",
    "TorqueLimits",
    "Underactuation",
    "available_solvers",
    "diagnose",
    "disturbance_margin",
    "disturbance_margins",
    "force_closure",
    "force_sensitivity",
    "grasp_margins",
    "grid_search",
    "grid_values",
    "holding_probability",
    "least_squeeze",
    "load_factor",
    "min_weight",
    "optimize_contacts",
    "optimize_forces",
    "optimize_grasp",
    "optimize_reserve",
    "optimize_robust",
    "producible_reserve",
    "qp_solvers",
    "refine_multipliers",
    "register_solver",
    "reserve_along",
    "search_reserve",
    "solve_batch",
    "to_jax",
    "to_qp",
    "to_socp",
    "to_torch",
    "unregister_solver",
]
