"""Where to hold an object: grasps searched, refined and ranked."""

from pinograsp.synthesis.found import FoundGrasp, hold, problem_of
from pinograsp.synthesis.search import GraspSearch, find_grasps

__all__ = ["FoundGrasp", "GraspSearch", "find_grasps", "hold", "problem_of"]
