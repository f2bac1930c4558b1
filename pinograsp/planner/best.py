"""The plan of a search: of the best grasp whose motion can be carried out."""

from __future__ import annotations

from collections.abc import Mapping

from pinograsp.checks import instance_of
from pinograsp.errors import NoGrasp, Status
from pinograsp.forces import GraspConditions
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.planner.planning import Search, plan_grasp_on
from pinograsp.synthesis import GraspSearch


def plan_best(
    found: GraspSearch,
    conditions: GraspConditions,
    *,
    search: Search = "convex",
    solver: str = "auto",
    objective: str | Mapping[str, float] | None = None,
    progress: bool | None = None,
) -> GraspPlan:
    """Plan the grasps of a search, best first, until one comes out ``OK``.

    Args:
        found: what :func:`~pinograsp.synthesis.find_grasps` found.
        conditions: friction, limits, what is to be balanced, and the reserve.
        search: as for :func:`~pinograsp.planner.plan_grasp_on`.
        solver: as for :func:`~pinograsp.planner.plan_grasp_on`.
        objective: as for :func:`~pinograsp.planner.plan_grasp_on`.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        The first plan that is ``OK``; where none is, that of the best grasp that could be planned, with its status.

    Raises:
        GraspNotFound: the search found no grasp.
        NoGrasp: none could be planned; the failure of the best grasp.
    """
    instance_of("search", found, GraspSearch)
    best: GraspPlan | None = None
    failure: NoGrasp | None = None
    for grasp in found.grasps or (found.best,):
        closure = grasp.closure
        try:
            plan = plan_grasp_on(
                closure.hand,
                closure,
                conditions,
                search=search,
                solver=solver,
                objective=objective,
                progress=progress,
            )
        except NoGrasp as error:
            failure = failure or error
            continue
        if plan.status in (Status.OK, Status.INTERRUPTED):
            return plan
        best = best or plan
    if best is not None:
        return best
    raise failure or NoGrasp("no grasp of the search could be planned")
