"""Planning: from a force problem, or a hand and an object, to a grasp plan; writing and reading plans."""

from pinograsp.planner.assemble import record_failure
from pinograsp.planner.best import plan_best
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.planner.options import PlanOptions, Search
from pinograsp.planner.planning import plan_grasp, plan_grasp_on
from pinograsp.planner.run_folders import load_run, save_run
from pinograsp.planner.tolerance import find_tolerance

__all__ = [
    "GraspPlan",
    "PlanOptions",
    "Search",
    "find_tolerance",
    "load_run",
    "plan_best",
    "plan_grasp",
    "plan_grasp_on",
    "record_failure",
    "save_run",
]
