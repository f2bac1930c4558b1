"""Where to hold an object: grasps searched, refined and ranked."""

from pinograsp.synthesis.found import FoundGrasp, hold, problem_of
from pinograsp.synthesis.search import GraspSearch, find_grasps
from pinograsp.synthesis.wishes import Approach, Wishes

__all__ = ["Approach", "FoundGrasp", "GraspSearch", "Wishes", "find_grasps", "hold", "problem_of"]
