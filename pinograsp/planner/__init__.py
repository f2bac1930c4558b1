"""From a force problem, or a hand and an object, to a grasp plan."""

from pinograsp.planner.planning import Objective, Search, plan_grasp, plan_grasp_on

__all__ = ["Objective", "Search", "plan_grasp", "plan_grasp_on"]
