"""The plan of a search: of the best grasp whose motion can be carried out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pinograsp.checks import instance_of
from pinograsp.contacts import Closure
from pinograsp.contacts.doubt import doubtful_share
from pinograsp.errors import NoGrasp, Status
from pinograsp.forces import GraspConditions
from pinograsp.planner.assemble import pressing_too
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.planner.planning import Search, plan_grasp_on
from pinograsp.synthesis import GraspSearch
from pinograsp.synthesis.found import SOUND

_FAR = 0.02  # slip of a contact while it presses, relative to the object's size
_TRIES = 4  # plans that are not firm, before the first of them is taken


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

    Those whose contacts slide far while they press or lie on edges, those in which other links press on the object,
    too, and those that the hand's own servos let go of (:meth:`GraspPlan.object_stiffness`), come after the others.

    Args:
        found: what :func:`~pinograsp.synthesis.find_grasps` found.
        conditions: friction, limits, what is to be balanced, and the reserve.
        search: as for :func:`~pinograsp.planner.plan_grasp_on`.
        solver: as for :func:`~pinograsp.planner.plan_grasp_on`.
        objective: as for :func:`~pinograsp.planner.plan_grasp_on`.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        The first plan that is ``OK``; where none is, that of the best grasp that could be planned, with its status.
        One of those that come last only if the first few all are so.

    Raises:
        GraspNotFound: the search found no grasp.
        NoGrasp: none could be planned; the failure of the best grasp.
    """
    instance_of("search", found, GraspSearch)
    best: GraspPlan | None = None
    failure: NoGrasp | None = None
    tried = 0
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
        if plan.status is Status.INTERRUPTED or (plan.status is Status.OK and _firm(plan, closure)):
            return plan
        if best is None or (plan.status is Status.OK and best.status is not Status.OK):
            best = plan
        tried += plan.status is Status.OK
        if tried == _TRIES or (best.status is Status.OK and grasp.sound < SOUND):
            break
    if best is not None:
        return best
    raise failure or NoGrasp("no grasp of the search could be planned")


def _firm(plan: GraspPlan, closure: Closure) -> bool:
    """Whether the contacts stay where they press, none on an edge, no other link presses, and the servos keep the
    object there.
    """
    slip, solution = np.asarray(plan.motion.slip), plan.searched()
    if slip.size and float(slip.max()) > _FAR * closure.object.bounding_radius:
        return False
    if doubtful_share(plan.hand, closure.object, solution.problem.contacts, plan.forces.normal_forces) > 0:
        return False
    return not pressing_too(plan.hand, solution, plan.motion.q[-1]) and plan.object_stiffness().is_stable()
