"""Where to hold an object: grasps searched, refined and ranked."""

from pinograsp.synthesis.search import FoundGrasp, GraspSearch, find_grasps, hold, problem_of

__all__ = ["FoundGrasp", "GraspSearch", "find_grasps", "hold", "problem_of"]
