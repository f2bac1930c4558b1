"""Searching grasps: opposed preshapes put on opposed surfaces of the object, closed, judged, and the best refined.

A sample takes two surfaces of the object that face each other, a preshape whose fingertips oppose each other about as
far apart, any turn about the line between them, and any depth towards the palm; the hand closes, and what touches is
judged by what the contacts withstand in their weakest direction per newton of squeeze (Ferrari and Canny, 1992).
Samples are closed with the convex hulls of the hand's meshes, which is quick; the best are moved about a little, as
long as that improves them, and closed with the exact geometry in the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pinograsp import defaults
from pinograsp.checks import brief, flag, instance_of, integer, number, processes
from pinograsp.contacts import (
    Contact,
    ContactSet,
    check_geometry,
)
from pinograsp.errors import GraspNotFound
from pinograsp.forces import GraspConditions, Task
from pinograsp.hands import HandModel
from pinograsp.hands.joint_limits import PLACEHOLDERS
from pinograsp.hands.load import ON_ROOT
from pinograsp.interrupts import interrupts_kept
from pinograsp.motion import effort_of
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.showing import in_notebook
from pinograsp.synthesis.found import SOUND, FoundGrasp
from pinograsp.synthesis.near import what_would_do
from pinograsp.synthesis.preshapes import measure_opening
from pinograsp.synthesis.samples import (
    MISSED,
    SearchCase,
    make_search_case,
)
from pinograsp.synthesis.search_run import BATCH, SearchRun, plain_error, rank, with_bodies
from pinograsp.synthesis.setting import REFUSED, Setting, Surroundings
from pinograsp.synthesis.wishes import NO_WISHES, WishCheck, Wishes

_MOST = 100_000  # samples
_NO_WAY = "Its fingertips come together nowhere on their way: look at the joints' axes and limits (view shows them)"
_ROUNDS, _MOST_ROUNDS = 4, 8  # times ``count`` samples are tried, as long as no grasp is sound; where some withstand
_PINCHING = 2  # of four rounds: where nothing is sound, the others look for power grasps
_FEW = 6  # batches that are searched without a wish, to say whether it is in the way
_TOO_LARGE, _TOO_SMALL = 10.0, 100.0  # times: such an object was drawn in other units; walls may be thin


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspSearch:
    """What a search of grasps found.

    Attributes:
        grasps: best first.
        tried: number of samples.
        outcomes: how many of them ended how.
        opening: least and largest width between this hand's fingertips [m].
        width: least distance of two surfaces of the object that face each other [m]; infinity: there are none.
        interrupted: whether it was stopped (Ctrl-C): the grasps are those found until then.
        remarks: what in the hand's description may be in the way: more than a hand in the file, finger joints that
            neither a motor nor a spring moves.
        near: where no grasp withstands the reserve, the best of those that do without the limits of forces and torques,
            or with more friction besides: they show what is in the way.
        advice: lines of what would let forces hold the first of these, reserve included; each was tried.
        unmet: where no grasp that is as wished withstands the reserve, lines that name the wishes in the way: a search
            without each of them was made.
    """

    grasps: tuple[FoundGrasp, ...]
    tried: int
    outcomes: dict[str, int]
    opening: tuple[float, float]
    width: float
    interrupted: bool
    remarks: tuple[str, ...] = ()
    near: tuple[FoundGrasp, ...] = ()
    advice: tuple[str, ...] = ()
    unmet: tuple[str, ...] = ()

    __repr__ = brief()
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        return self.explain()

    @property
    def best(self) -> FoundGrasp:
        """The first; :class:`GraspNotFound` where there is none."""
        if not self.grasps:
            raise GraspNotFound(self.explain(), self)
        return self.grasps[0]

    @property
    def size_remark(self) -> str:
        """That the object is larger than the hand opens, or very small for it, in words; else nothing."""
        least, largest = self.opening
        if not np.isfinite(self.width):
            told = "No two surfaces of the object face each other, 0.1 mm apart or more"
            return f"{told}; this hand opens by {1e3 * least:.3g} to {1e3 * largest:.3g} mm"
        sizes = f"its opposed surfaces are {1e3 * self.width:.3g} mm apart or more, and this hand opens by"
        if self.width > largest:
            return f"The object is too large: {sizes} {1e3 * largest:.3g} mm"
        if self.width < least / _TOO_SMALL:
            return f"The object is very small: {sizes} {1e3 * least:.3g} to {1e3 * largest:.3g} mm"
        return ""

    @property
    def causes(self) -> dict[str, int]:
        """The outcomes, without which links and which wishes, the most frequent first."""
        found: dict[str, int] = {}
        for what, count in self.outcomes.items():
            cause = what if what.startswith((MISSED, REFUSED)) else what.partition(" (")[0]
            found[cause] = found.get(cause, 0) + count
        return dict(sorted(found.items(), key=lambda one: one[1], reverse=True))

    def _advise_on_most(self) -> str:
        """What may be done about what failed most often; empty where nothing is known."""
        for cause, count in self.causes.items():
            if advice := _ADVICE.get(cause):
                return f"{count} of {self.tried}, {cause}: {advice}"
        return ""

    def explain(self) -> str:
        """What came of it in words: how many samples ended how, and what to do where none holds."""
        causes = self.causes
        advice = [] if self.unmet else [self._advise_on_most()]
        counts = "; ".join(f"{_SAID.get(what, what)}: {count}" for what, count in causes.items())
        samples = _count(self.tried, "sample")
        if self.grasps:
            good = sum(grasp.withstands for grasp in self.grasps)
            which = "" if good == len(self.grasps) else f" ({good} with a squeeze that has the reserve)"
            grasps = _count(len(self.grasps), "grasp")
            text = f"{grasps}{which} from {samples}, the best of every {BATCH} moved about. As drawn: {counts}"
            remark = [] if good else [self.size_remark, *advice]
            return "\n".join(filter(None, [text, *remark, *self.unmet, *self.advice]))
        text, (least, largest) = f"no grasp of {samples} holds the object: {counts}", self.opening
        text = ". ".join(filter(None, [text, self.size_remark, *self.remarks]))
        if not least / _TOO_SMALL < self.width < largest * _TOO_LARGE:
            text += "; millimetres read as metres, or metres as millimetres? (scale=0.001)"
        return "\n".join(filter(None, [text, *advice, *self.unmet, *self.advice]))


_ADVICE = {
    "fingers collide": "fewer fingers may do better, Wishes(fingers=...), or a larger object",
    "open fingers collide": "fewer fingers may do better, Wishes(fingers=...)",
    "fewer than two contacts": "the object may be too small for this hand, or out of reach of its other fingers",
    "forces infeasible": "more friction, less mass, or higher limits of force and torque",
    "the open hand overlaps the object": "the hand opens too little, or another part of the object is narrower: "
    "Wishes(within=...)",
    "the open hand overlaps the object or the table": 'a higher object, or Wishes(approach="above")',
    "the hand would hit the table": 'Wishes(approach="above"), or a higher part: Wishes(within=...)',
    "the hand could not be closed": "links begin inside the object: look at scale and units",
}
_SAID = {"holds": "held"}  # outcomes of many


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


# Beside hand, object and conditions seven options: of the samples and of how they are run.
def find_grasps(
    hand: HandModel,
    body: Body,
    conditions: GraspConditions,
    *,
    wishes: Wishes = NO_WISHES,
    scene: Scene | Setting | None = None,
    count: int = defaults.GRASPS,
    seed: int = 0,
    impact_time: float = 0.9,
    wrap: bool = False,
    jobs: int = -1,
    progress: bool | None = None,
) -> GraspSearch:
    """Search grasps of ``body`` by ``hand``, and rank what holds. The object stays; the hand is placed.

    Args:
        hand: the hand, wherever it is.
        body: what is to be held, where it is.
        conditions: friction, limits and what is to be balanced.
        wishes: by which fingers, where and from which side it is to be held.
        scene: what stands around: the open hand keeps its distance. Where the object stands on some of it, ``table`` is
            on. Or another :class:`Setting`, of what else keeps hands from places, for those who may search again: at
            most half as many samples are tried where some withstand the reserve; ``near`` and ``unmet`` are empty.
        count: samples; up to four times as many, as long as no grasp withstands the reserve on contacts that are sure,
            and firmly, and the object is not too large; without wishes up to eight times where some withstand it, but
            not so.
        seed: of the samples' random numbers; the result does not depend on ``jobs``. A hand's preshapes are drawn once,
            with a seed of their own.
        impact_time: t_I of the forces that grasps are tried with [s].
        wrap: for power grasps: the object against the open hand, mostly its palm, and the fingers wrapped round it;
            these are looked for as well where half of the samples found nothing.
        jobs: processes; -1: all cores. One outside the main thread, and on other systems than Linux.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        First those that withstand the reserve within the torque limits, by the fingers that take part (up to those that
        are wished, or 3), then by the least squeeze that does; those with doubtful contacts, or a squeeze above 15
        times the weight, after the others; then by what they withstand in the weakest direction per newton; last those
        without force closure, by the multiple of the load that they hold.
        Stopped by Ctrl-C: those found until then.

    Raises:
        InvalidInput: conditions, wishes or options that cannot be used.
        PinograspError: a process was lost, or the object's own code failed.

    Example:
        >>> import pinograsp as pg
        >>> hand, ball = pg.load_hand("panda"), pg.Sphere(radius=0.02, mass=0.1)
        >>> conditions = pg.GraspConditions(mu=0.6)
        >>> found = pg.find_grasps(hand, ball, conditions, count=4, seed=0, jobs=1)
        >>> print(found.grasps[0].closure.contacts().names)
        ('left', 'right')

    See Also:
        :class:`~pinograsp.synthesis.Wishes`; :func:`~pinograsp.planner.plan_best` plans what was found.
    """
    _check(hand, body, conditions, impact_time)
    check_geometry(hand)
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    impact_time = number("impact time t_I", impact_time, at_least=0, unit="s")
    flag("wrap", wrap)
    instance_of("wishes", wishes, Wishes)
    wrap |= wishes.palm is True
    explains = scene is None or isinstance(scene, Scene)
    if isinstance(scene, Scene):
        conditions = replace(conditions, table=conditions.table or bool(scene.find_supports(body)))
        scene = Surroundings(scene, body)
    jobs = processes(jobs)
    instance_of("progress", progress, bool, type(None))
    first, *rounds = np.random.SeedSequence(seed).spawn(1 + _MOST_ROUNDS)
    try:
        case = make_search_case(hand, body, conditions, impact_time, wrap, np.random.default_rng(first), wishes, scene)
    except Exception as error:
        raise plain_error(error) from None
    widths = [one.width for one in case.preshapes]
    opening = max(0.0, min(widths, default=0.0)), max([*widths, measure_opening(hand, wishes.fingers)])
    width = float(min(case.pairs.widths, default=np.inf))
    run = SearchRun(case, count, jobs, progress)
    too_large = width > opening[1]
    with interrupts_kept() as interrupt:
        try:
            for i, one in enumerate(rounds):
                some = any(grasp.withstands for grasp in run.found)
                if i == _ROUNDS and (wishes.names or not some or not explains):
                    break
                if i == _PINCHING and some and not explains:
                    break  # whoever asks may ask again
                power = i % _ROUNDS >= _PINCHING and wishes.palm is None
                run.batches(one, interrupt, wrap=wrap or power)
                # Off its middle, what is too large may be held all the same.
                hopeless = (too_large and (not run.found or i + 1 == _PINCHING)) or run.has_no_room
                if hopeless or any(grasp.sound == SOUND for grasp in run.found):
                    break
            lacking = explains and not run.has_no_room and not any(grasp.withstands for grasp in run.found)
            unmet = (
                _find_unmet(run, first, rounds[0], interrupt)
                if lacking and (wishes.names or _tasks(conditions))
                else ()
            )
            # Where some are as wished, loads, limits or friction may be in the way as well.
            forceless = any(what.startswith("forces infeasible") for what in run.outcomes)
            near = run.near(rounds[0], interrupt) if lacking and (forceless or not unmet) else ()
        except KeyboardInterrupt:
            run.interrupted, near, unmet = True, (), ()
    run.bar.close()
    near = tuple(with_bodies(hand, body, one) for one in near)
    return GraspSearch(
        grasps=tuple(with_bodies(hand, body, one) for one in rank(run.found)),
        tried=sum(run.outcomes.values()),
        outcomes=run.outcomes,
        opening=opening,
        width=width,
        interrupted=run.interrupted,
        remarks=_remarks(hand) + (() if case.preshapes else (_NO_WAY,)),
        near=near,
        advice=what_would_do(near, conditions, impact_time),
        unmet=unmet,
    )


def _find_unmet(
    run: SearchRun, first: np.random.SeedSequence, seed: np.random.SeedSequence, interrupt: Callable[[], None]
) -> tuple[str, ...]:
    """Which wishes are in the way, in words: a round of samples without each of them, then without all.

    What is to be done with the object counts as one of them.
    """
    case, lines = run.case, list[str]()
    wishes, tasks = case.wish_check.wishes, _tasks(case.conditions)
    tries: list[tuple[str, ...]] = [(name,) for name in (*wishes.names, *(["tasks"] if tasks else []))]
    if len(tries) > 1:
        tries.append(tuple(name for (name,) in tries))
    for names in tries:
        if len(names) > 1 and lines:
            break
        conditions = case.conditions
        if "tasks" in names and conditions.reserve is not None:
            conditions = replace(conditions, reserve=replace(conditions.reserve, tasks=()))
        wrap = case.wrap and (wishes.palm is not True or "palm" not in names)
        rng, fewer = np.random.default_rng(first), wishes.without(*names)
        other = make_search_case(case.hand, case.body, conditions, case.impact_time, wrap, rng, fewer, case.setting)
        found = [grasp for grasp in run.other_round(other, seed, interrupt, _FEW) if grasp.withstands]
        if found:
            lines.append(_say_unmet(case, names, [with_bodies(case.hand, case.body, grasp) for grasp in found]))
    return tuple(lines)


def _tasks(conditions: GraspConditions) -> tuple[Task, ...]:
    return () if conditions.reserve is None else conditions.reserve.tasks


def _say_unmet(case: SearchCase, names: tuple[str, ...], found: list[FoundGrasp]) -> str:
    """A line about wishes without which there are grasps: how near the nearest of these comes."""
    wishes, tasks = case.wish_check.wishes, ", ".join(task.describe() for task in _tasks(case.conditions))
    alone = WishCheck(wishes.without(*set(wishes.names) - set(names)), case.hand, case.body, case.conditions.gravity_o)
    misses = [[*alone.misses(one.closure, one.look_o), *alone.misses_of_room(one.room)] for one in found]
    nearest = "; ".join(miss.description for miss in min(misses, key=lambda each: sum(miss.by for miss in each)))
    which = ", ".join(f"{name}={tasks if name == 'tasks' else _as_text(getattr(wishes, name))}" for name in names)
    lead = f"the wish {which} is" if len(names) == 1 else f"the wishes {which} are together"
    size = alone.describe_parts() if {"within", "touching"} & set(names) else ""
    if not nearest:
        nearest = "does all else" if "tasks" in names else "is as wished: more samples, or another seed, may find it"
    held = "hold the object" if case.conditions.reserve is None else "keep the reserve"
    count = f"{_count(len(found), 'grasp')} {held if len(found) > 1 else held.replace(' ', 's ', 1)}"
    return f"{lead} in the way: without, {count}, and the nearest {nearest}{size}"


def _as_text(value: object) -> str:
    return str(value.tolist()) if isinstance(value, np.ndarray) else str(value)


def _remarks(hand: HandModel) -> tuple[str, ...]:
    """What in a hand's description may be in the way of any grasp."""
    remarks = [note.removeprefix(ON_ROOT) for note in hand.notes if note.startswith((ON_ROOT, PLACEHOLDERS))]
    fingers = {joint for finger in hand.fingers for joint in finger.actuated}
    sprung = {spring.joint for spring in hand.springs}
    if limp := [joint for joint in hand.passive_joints if joint in fingers and joint not in sprung]:
        remarks.append(f"No motor moves the finger joints {', '.join(limp)}: drives= gives them some")
    return tuple(remarks)


def _check(hand: HandModel, body: Body, conditions: GraspConditions, impact_time: float) -> None:
    """Raise at once what every sample would raise: with a problem of one contact under the same conditions."""
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body)
    instance_of("conditions", conditions, GraspConditions)
    at = body.com_o
    contact = Contact(finger="any", link="", point_o=at, rotation_oc=np.eye(3), length=None, distance=0.0)
    problem = conditions.problem(body, ContactSet(contacts=(contact,), com_o=at + [0.0, 0.0, 1.0]))
    problem.checked_impact_time(impact_time)
    effort_of(hand, conditions.torque_limit)
