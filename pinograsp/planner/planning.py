"""From a force problem, or a hand and an object, to a grasp plan: the order of the stages."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pinograsp.checks import instance_of
from pinograsp.contacts import Closure, close_hand
from pinograsp.contacts.support_plane import SupportPlane
from pinograsp.errors import GraspInfeasible, InvalidInput, SearchFailed
from pinograsp.forces import ForceProblem, GraspConditions, Reserve, TorqueLimit
from pinograsp.forces.relaxation import Setup
from pinograsp.hands import HandModel
from pinograsp.motion import MotionSpec, effort_of
from pinograsp.objects.body import Body
from pinograsp.planner.assemble import assemble_plan
from pinograsp.planner.drive_cautions import find_wrong_way
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.planner.options import AS_USUAL, PlanOptions
from pinograsp.planner.overshoot import lower_caps, slow_squeeze, soften_blow
from pinograsp.planner.refusals import with_advice
from pinograsp.planner.rounds import search_forces_and_motion


def plan_grasp(
    hand: HandModel,
    problem: ForceProblem,
    options: PlanOptions = AS_USUAL,
    *,
    torque_limit: TorqueLimit = None,
    reserve: Reserve | None = None,
    progress: bool | None = None,
) -> GraspPlan:
    """Plan a grasp: least-energy contact forces, then the joint motion and torques with the least peak torque.

    Args:
        hand: the hand, placed in the world.
        problem: contacts (of this hand), load, friction and limits.
        options: how to search.
        torque_limit: the convex search keeps the holding torques at t_F within it: largest |torque| (n,) or one number
            [N m], or ``"effort"``: the hand's own effort limits (joints without one are not limited: a warning names
            them); None: the problem's own limits, if it has any.
        reserve: what the forces withstand besides the problem's load, for a problem with an object and the convex
            search only.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        The plan with its status: ``OK``; ``UNBALANCED`` if the QP found that the paper's grid point balances only
            within its net-force limit; ``JOINT_LIMIT`` or ``NOT_TRACKED`` if the motion is at fault; ``INTERRUPTED``.

    Raises:
        GraspInfeasible: no forces within the limits hold the load; the error has the search record and the reason: the
            grid's rejection histogram, or the convex search's proof with its diagnosis.
        GraspUndecided: no forces were found, but it is not proven that none exist.
        SearchInterrupted: stopped (Ctrl-C) before any forces were found.
        InvalidInput: an objective or torque limit without the convex search.
        ContactNotReached: a finger cannot reach its contact points.

    Example:
        >>> import pinograsp as pg
        >>> case = pg.load_case("paper")
        >>> hand = case.load_hand()
        >>> problem = case.make_problem(hand)  # contacts, load, friction
        >>> plan = pg.plan_grasp(hand, problem)
        >>> print(plan.status, plan.forces.normal_forces.round(1), "N")
        ok [11.2  6.1  4.9] N

    See Also:
        :func:`~pinograsp.planner.plan_grasp_on` finds the contacts by closing the hand.
    """
    instance_of("hand", hand, HandModel)
    instance_of("problem", problem, ForceProblem)
    instance_of("options", options, PlanOptions)
    instance_of("reserve", reserve, Reserve, type(None))
    limit = None if torque_limit is None else effort_of(hand, torque_limit)
    return GraspTask(
        hand=hand, setup=Setup(problem, _of_hand(hand, reserve), limit), options=options, progress=progress
    ).plan()


def plan_grasp_on(
    hand: HandModel,
    body: Body | Closure,
    conditions: GraspConditions,
    options: PlanOptions = AS_USUAL,
    *,
    progress: bool | None = None,
) -> GraspPlan:
    """Plan a grasp on an object: close the hand on it, then :func:`plan_grasp` with the contacts found.

    With a reserve (``conditions.reserve``) the forces are the squeeze that withstands it, searched over the impact
    times (:func:`~pinograsp.forces.search_reserve`), and ``plan.solution`` is its reaction to the weight alone.

    Args:
        hand: the hand, placed in the world.
        body: the object, or this hand already closed on it (:func:`~pinograsp.contacts.close_hand`).
        conditions: friction, limits and balance.
        options: how to search.
        progress: as for :func:`plan_grasp`.

    Raises:
        InvalidInput: another hand than the closure's, or a hand that touches nothing. Others as for :func:`plan_grasp`.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> ball = pg.Sphere(radius=0.02, mass=0.1).placed(up)  # between the open jaws
        >>> plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.6))
        >>> print(plan.status, plan.forces.normal_forces.round(1), "N")
        ok [1.9 1.9] N

    See Also:
        :func:`~pinograsp.planner.plan_grasp` for given contacts; :func:`~pinograsp.planner.plan_best` for grasps that
        are searched.
    """
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body, Closure)
    started = time.perf_counter()
    closure = body if isinstance(body, Closure) else close_hand(hand, body)
    if not _is_same(hand, closure.hand):
        raise InvalidInput("hand: expected the closure's own, where it was closed (closure.hand), got another one")
    return GraspTask.of_closure(closure, conditions, options, progress=progress, started=started).plan()


def _of_hand(hand: HandModel, reserve: Reserve | None) -> Reserve | None:
    return None if reserve is None else reserve.of_hand(hand)


def _is_same(hand: HandModel, other: HandModel) -> bool:
    """Whether they are the same hand in the same place."""
    return hand is other or (
        hand.name == other.name and hand.joint_names == other.joint_names and np.array_equal(hand.pose, other.pose)
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspTask:
    """What is to be planned, and how.

    Attributes:
        hand: placed in the world.
        setup: the forces' problem, the reserve, and the limit of the holding torques (n,) [N m], infinity: none.
        options: how to search.
        progress: bar on stderr: None (on a terminal), True or False.
        elapsed: of the stages before [s].
        closure: the hand closed on the object; None: contacts were given.
        conditions: under which it is held; None: a problem was given.
    """

    hand: HandModel
    setup: Setup
    options: PlanOptions
    progress: bool | None = None
    elapsed: Mapping[str, float] = field(default_factory=dict)
    closure: Closure | None = None
    conditions: GraspConditions | None = None

    @classmethod
    def of_closure(
        cls,
        closure: Closure,
        conditions: GraspConditions,
        options: PlanOptions,
        *,
        progress: bool | None = None,
        started: float | None = None,
    ) -> GraspTask:
        """What is to be planned of a closed hand; ``started``: when closing it began, of ``time.perf_counter()``."""
        started = time.perf_counter() if started is None else started
        instance_of("conditions", conditions, GraspConditions)
        motion = instance_of("options", options, PlanOptions).motion
        if motion is None:
            motion = MotionSpec(
                start={finger.name: closure.start[finger.dofs] for finger in closure.hand.fingers},
                posture={finger.name: closure.q[finger.dofs] for finger in closure.hand.fingers},
            )
        body = instance_of("object", closure.object, Body)
        if conditions.table:
            motion = replace(motion, table=SupportPlane.under(body, conditions.gravity_o))
        problem = slow_squeeze(closure.hand, lower_caps(closure.hand, conditions.problem(body, closure.contacts())))
        limit = None if conditions.torque_limit is None else effort_of(closure.hand, conditions.torque_limit)
        return cls(
            hand=closure.hand,
            setup=Setup(problem, _of_hand(closure.hand, conditions.reserve), limit),
            options=replace(options, motion=motion),
            progress=progress,
            elapsed={"closing": time.perf_counter() - started},
            closure=closure,
            conditions=conditions,
        )

    def plan(self) -> GraspPlan:
        """The plan; :class:`SearchFailed` says what would do, see :meth:`advise`."""
        try:
            return self.attempt()
        except SearchFailed as error:
            raise self.advise(error) from None

    def advise(self, error: SearchFailed) -> SearchFailed:
        """What an attempt ended in, with what would do: each is tried with the same task."""

        def attempt(setup: Setup) -> GraspPlan:
            body, closure = setup.problem.object, self.closure
            if closure is not None and body is not None and body is not closure.object:
                closure = replace(closure, object=body)
            return replace(self, setup=setup, closure=closure, progress=False).attempt()

        return with_advice(error, self.hand, self.setup, attempt)

    def attempt(self) -> GraspPlan:
        """Forces, then motion."""
        hand, limit = self.hand, self.setup.limit
        stages = search_forces_and_motion(hand, self.setup, self.options, self.progress)
        gentler = soften_blow(hand, self.setup.problem, stages.motion, self.setup.reserve)
        if gentler is not self.setup.problem:
            gentle = replace(self.setup, problem=gentler)
            stages = search_forces_and_motion(hand, gentle, self.options, self.progress).after(stages.elapsed)
        if wrong := find_wrong_way(hand, stages.motion):
            raise GraspInfeasible(f"no grasp that this hand can produce: {wrong}", stages.forces)
        notes: tuple[str, ...] = ()
        if limit is not None and not np.isfinite(limit).any():
            notes = (f"no joint of '{hand.name}' has an effort limit: torques are not limited",)
        return assemble_plan(
            hand,
            stages.forces,
            stages.motion,
            elapsed={**self.elapsed, **stages.elapsed},
            closure=self.closure,
            conditions=self.conditions,
            reserve=stages.reserve,
            notes=notes,
        )
