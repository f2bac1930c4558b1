"""Contact forces: the problem, grid searches, the multiplier QP, certified convex optima, margins, robust sets."""

from pinograsp.forces.batch import BatchSolution, ForceBatch, solve_batch
from pinograsp.forces.global_optimum import Branch, optimize_grasp
from pinograsp.forces.grid import GridSpec, grid_values
from pinograsp.forces.infeasibility import Diagnosis, Infeasibility, diagnose
from pinograsp.forces.load_set import LoadSet
from pinograsp.forces.margins import ForceClosure, GraspMargins, force_closure, grasp_margins, load_margin, min_weight
from pinograsp.forces.multipliers import MultiplierQP, MultiplierSolution, refine_multipliers
from pinograsp.forces.optimize import FORCE_SOLVERS, Certificate, optimize_forces, warm_up
from pinograsp.forces.problem import ForceProblem, TorqueLimits
from pinograsp.forces.program import OBJECTIVES
from pinograsp.forces.reliability import Reliability, holding_probability
from pinograsp.forces.robust import RobustForces, optimize_robust
from pinograsp.forces.search import SEARCHES, grid_search
from pinograsp.forces.sensitivity import BetterContacts, Sensitivity, force_sensitivity, optimize_contacts
from pinograsp.forces.solution import ForceSolution
from pinograsp.forces.solvers import SOLVERS

__all__ = [
    "FORCE_SOLVERS",
    "OBJECTIVES",
    "SEARCHES",
    "SOLVERS",
    "BatchSolution",
    "BetterContacts",
    "Branch",
    "Certificate",
    "Diagnosis",
    "ForceBatch",
    "ForceClosure",
    "ForceProblem",
    "ForceSolution",
    "GraspMargins",
    "GridSpec",
    "Infeasibility",
    "LoadSet",
    "MultiplierQP",
    "MultiplierSolution",
    "Reliability",
    "RobustForces",
    "Sensitivity",
    "TorqueLimits",
    "diagnose",
    "force_closure",
    "force_sensitivity",
    "grasp_margins",
    "grid_search",
    "grid_values",
    "holding_probability",
    "load_margin",
    "min_weight",
    "optimize_contacts",
    "optimize_forces",
    "optimize_grasp",
    "optimize_robust",
    "refine_multipliers",
    "solve_batch",
    "warm_up",
]
