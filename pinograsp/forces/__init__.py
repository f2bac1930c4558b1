"""Contact forces: the problem, the grid searches, the QP over the friction multipliers."""

from pinograsp.forces.grid import GridSpec, grid_values
from pinograsp.forces.infeasibility import Diagnosis, Infeasibility, diagnose
from pinograsp.forces.multipliers import MultiplierSolution, refine_multipliers
from pinograsp.forces.optimize import Certificate, optimize_forces
from pinograsp.forces.problem import ForceProblem, TorqueLimits
from pinograsp.forces.program import OBJECTIVES
from pinograsp.forces.search import SEARCHES, grid_search
from pinograsp.forces.solution import ForceSolution
from pinograsp.forces.solvers import SOLVERS

__all__ = [
    "SEARCHES",
    "SOLVERS",
    "ForceProblem",
    "ForceSolution",
    "GridSpec",
    "MultiplierSolution",
    "grid_search",
    "grid_values",
    "refine_multipliers",
]
