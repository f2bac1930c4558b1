"""From an object that stands somewhere to a carried object, with the arm one has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.carry.limits import limit_arm
from pinograsp.checks import instance_of, integer, mapping_of, one_of
from pinograsp.errors import InvalidInput, NoGrasp, PickFailed, Status
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel, detach
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.pick.maker import PickMaker
from pinograsp.pick.pick_motion import PickMotion
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.place import PlaceRegion, find_places, measure_tilts
from pinograsp.pick.reach import PickTask, Reached, Reacher, ReachSetting
from pinograsp.pick.ways import Patience
from pinograsp.planner.best import plan_best, plan_each
from pinograsp.planner.planning import GraspTask
from pinograsp.planner.stopwatch import Stopwatch
from pinograsp.synthesis import GraspSearch, Wishes, find_grasps

# Samples of the searches, one after the other, until a grasp goes.
_COUNTS = (16, 32)
_ENOUGH = 4  # grasps that are reached, after which no more are looked at
_MUCH = 3.0  # times as long as planned: fingers that flick, with which another grasp may do without


def plan_pick(
    robot: HandModel,
    body: Body,
    scene: Scene,
    conditions: GraspConditions,
    wishes: Wishes | None = None,
    *,
    place: ArrayLike | PlaceRegion | None = None,
    start: Mapping[str, float] | None = None,
    motion: PickMotion | None = None,
    seed: int = 0,
    jobs: int = -1,
    progress: bool | None = None,
) -> PickPlan:
    """Plan to pick up an object, carry it, and put it down: grasp, paths, timing and torques.

    The planner searches grasps where the arm can bring the hand and there is room, and tries the best first. A grasp
    needs an arm posture without collisions (inverse kinematics by Pink). The open hand approaches and leaves in a
    straight line; the object goes straight up and is put straight down. OMPL finds the paths between. TOPP-RA times the
    paths of the free hand, and :func:`~pinograsp.carry.plan_carry` times the path with the object under the grasp's own
    limits.

    Args:
        robot: arm and hand in one model (:func:`~pinograsp.hands.attach`), with its root at the mount.
        body: the object, in its place.
        scene: the obstacles.
        conditions: of the grasp.
        wishes: wishes for the grasp.
        place: target pose (4, 4) of the object's frame, or its target position (3,) [m] with unchanged rotation, or a
            region, in which the first possible place is used; None: only lift the object.
        start: the arm's positions, ``{joint: position}`` [rad or m]; others as in its ``posture``. Without both, joints
            are at 0, or in the middle of their ranges if they hit something at 0.
        motion: settings of the arm's motion; None: the defaults of :class:`PickMotion`.
        seed: of all random numbers.
        jobs: processes of the search and of the plans.
        progress: of the search: bar on stderr: None (on a terminal), True or False.

    Raises:
        InvalidInput: unusable values; a robot without an arm; a start in collision; a place without room, or one that
            tilts the object more than allowed.
        PickFailed: no grasp was found, or none is possible; the error gives the reasons.
        ExtraMissing: the extra ``arm`` is not installed.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> from pinograsp.hands.catalogue import file_of
        >>> bent = {"panda_joint2": -0.5, "panda_joint4": -2.0, "panda_joint6": 1.6}
        >>> robot = pg.load_hand(file_of("panda"), posture=bent)
        >>> place = pg.spatial.pose_of([0.5, 0.1, 0.04], np.eye(3))
        >>> box = pg.Box(size=(0.04, 0.05, 0.08), mass=0.2).placed(place)
        >>> scene, conditions = pg.Scene.on_table(), pg.GraspConditions(mu=0.6)
        >>> goal = (0.5, -0.1, 0.04)
        >>> pick = pg.plan_pick(robot, box, scene, conditions, place=goal, seed=1, jobs=1)
        >>> print(pick.status, *(phase.name for phase in pick.phases))
        ok reach close carry open leave

    See Also:
        :func:`~pinograsp.hands.attach`, :class:`~pinograsp.objects.Scene`, :func:`~pinograsp.pick.simulate_pick`.
    """
    clock = Stopwatch("search", "reach", "forces", "ways", "timing")
    instance_of("conditions", conditions, GraspConditions)
    instance_of("robot", robot, HandModel)
    if instance_of("scene", scene, Scene).find_supports(instance_of("body", body, Body)):
        conditions = replace(conditions, table=True)
    motion = PickMotion() if motion is None else instance_of("motion", motion, PickMotion)
    wishes = Wishes() if wishes is None else instance_of("wishes", wishes, Wishes)
    seed = integer("seed", seed, at_least=0)
    rng = np.random.default_rng(seed)
    task = read_task(robot, body, scene, place, start, motion, conditions, rng)
    reacher, setting = Reacher(task, rng), ReachSetting(task)
    limits = limit_arm(task.robot, "effort", motion.speed, motion.acceleration, motion.reserve)
    patience, tried, doubtful, slow = Patience(), 0, None, None
    for round_, count in enumerate(_COUNTS):
        found = find_grasps(
            task.hand,
            body,
            conditions,
            wishes=wishes,
            scene=setting,
            impact_time=0.5 * sum(conditions.impact_time_range),
            count=count,
            seed=seed + round_,
            jobs=jobs,
            progress=progress,
        )
        clock.stop("search")
        tried += reacher.count_refusals(found)
        reached = list[Reached]()
        for grasp in found.grasps:
            if len(reached) == _ENOUGH:
                break
            tried += 1
            if grasp.withstands and (one := reacher.reach(grasp)) is not None:
                reached.append(one)
            elif not grasp.withstands:
                reacher.reasons["cannot be held"] += 1
        clock.stop("reach")
        refused = list[tuple[NoGrasp, GraspTask]]()
        some = _only(found, reached)
        plans = plan_each(some, conditions, jobs=jobs, progress=False, refused=refused) if reached else ()
        for plan in plans:
            chosen = next(one for one in reached if one.grasp.closure is plan.closure)
            clock.stop("forces")
            if plan.status not in (Status.OK, Status.DOUBTFUL):
                reacher.reasons[f"plan {plan.status.value}"] += 1
                continue
            made = PickMaker(task, plan, chosen, motion, limits, patience, seed).make(clock)
            if isinstance(made, str):
                reacher.reasons[made] += 1
                clock.stop("ways")
                continue
            # Where the best grasp is doubtful all are; where the way with it is, another one may do.
            if plan.motion.times[-1] > _MUCH * conditions.final_time:
                slow = slow or made
                continue
            if made.status is Status.OK or plan.status is not Status.OK:
                return _finish(made, tried, clock)
            doubtful = doubtful or made
        if refused:
            reacher.reasons["cannot be held"] += len(refused)
        clock.stop("forces")
        if (second := doubtful or slow) is not None:
            return _finish(second, tried, clock)
        if not found.grasps and reacher.reasons:
            break  # there is hardly room for the hand
    told = _explain(tried, reacher, found)
    if found.grasps and set(reacher.reasons) == {"cannot be held"}:  # then the forces say what would do
        try:
            plan_best(replace(found, grasps=found.grasps[:1]), conditions, progress=False)
        except NoGrasp as error:
            told = f"{told}. {error}"
    raise PickFailed(told, dict(reacher.reasons))


def read_task(
    robot: HandModel,
    body: Body,
    scene: Scene,
    place: ArrayLike | PlaceRegion | None,
    start: Mapping[str, float] | None,
    motion: PickMotion,
    conditions: GraspConditions,
    rng: np.random.Generator,
) -> PickTask:
    """What is to be picked, checked: see :func:`plan_pick`."""
    if not len(robot.arm):
        raise InvalidInput(
            f"robot '{robot.name}': expected an arm that carries the hand, got a hand alone: mount it on one, "
            "pinograsp.hands.attach(arm, hand, link=...)"
        )
    if start is not None:
        names = [robot.joint_names[i] for i in robot.arm]
        given = mapping_of("start", start, "{joint: position}")
        for name in given:
            one_of("start: joint of the arm", name, names)
        robot = robot.with_posture({**robot.posture, **given})
    gravity = np.array(conditions.gravity_o)
    if not (size := float(np.linalg.norm(gravity))):
        raise InvalidInput("gravity: expected some, got none: without it nothing rests on a surface")
    up_o = -gravity / size
    places = find_places(place, body, scene, up_o, rng)
    tilted = float(measure_tilts(places, body, up_o).max(initial=0.0))
    if motion.upright is not None and tilted > motion.upright:
        raise InvalidInput(
            f"upright: expected a place that tilts the object by {np.degrees(motion.upright):.3g} deg at most, got one "
            f"that tilts it by {np.degrees(tilted):.3g} deg"
        )
    task = PickTask(
        robot=robot,
        hand=detach(robot),
        body=body,
        scene=scene,
        places=places,
        start=np.array(robot.resting)[robot.arm],
        lift=motion.lift,
        gravity_o=gravity,
        supports=scene.find_supports(body, places),
    )
    arm = task.arm(task.hand.resting, "free", body, task.start)
    if arm.is_free(task.start):
        return task
    what, nearest = "got one", arm.find_nearest(task.start)
    if not robot.posture:
        middle = (robot.lower + robot.upper)[robot.arm] / 2.0
        if arm.is_free(middle):
            names = [robot.joint_names[i] for i in robot.arm]
            robot = robot.with_posture(dict(zip(names, middle.tolist())))
            return replace(task, robot=robot, hand=detach(robot), start=middle)
        what, nearest = "got none, and for the arm with its joints in the middle one", arm.find_nearest(middle)
    raise InvalidInput(
        f"start: expected a posture that keeps {1e3 * scene.clearance:g} mm from all, {what} in which {nearest.one} is "
        f"{-1e3 * nearest.spare:.3g} mm nearer to {nearest.other}: give another start="
    )


def _finish(made: PickPlan, tried: int, clock: Stopwatch) -> PickPlan:
    """The plan with what takes a while and is told of none but this one."""
    grasp = made.grasp.with_tolerance()
    clock.stop("forces")
    return replace(made, grasp=grasp, tried=tried, elapsed=clock.elapsed)


def _only(found: GraspSearch, reached: list[Reached]) -> GraspSearch:
    return replace(found, grasps=tuple(one.grasp for one in reached))


def _explain(tried: int, reacher: Reacher, last: GraspSearch) -> str:
    """Why nothing goes: what kept the arm from grasps, or, where none was found, what the search of them says."""
    if not last.grasps and sum(reacher.reasons.values()) < last.tried:
        return f"no grasp was found where the arm can bring the hand: {last.explain()}"
    parts = ", ".join(f"{count} {reason}" for reason, count in reacher.reasons.most_common())
    return f"none of {tried} grasps is possible: {parts}"
