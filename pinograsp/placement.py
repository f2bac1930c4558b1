"""Where to put the palm: placements sampled around an object, closed, ranked by certified energy and load margin."""

from __future__ import annotations

import functools
import itertools
import pickle
import tempfile
import traceback
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path

import cloudpickle
import joblib
import numpy as np
import pinocchio as pin
from tqdm import tqdm

from pinograsp.checks import brief, flag, instance_of, integer, number, processes
from pinograsp.contacts import (
    Closure,
    Contact,
    ContactSet,
    check_geometry,
    clearance,
    close_hand,
    fingertips,
    link_centre,
    open_and_closed,
)
from pinograsp.errors import InvalidInput, PinograspError, PlacementNotFound, Status
from pinograsp.forces import ForceProblem, ForceSolution, GraspConditions, load_factor, optimize_forces
from pinograsp.hands import HandModel
from pinograsp.interrupts import interrupts_kept, parallel_results
from pinograsp.motion import effort_of, torque_limits
from pinograsp.objects.body import Body
from pinograsp.spatial import Array
from pinograsp.writing import write_errors

_ALIGNED = 0.7  # share of the samples whose object axes are aligned with the hand's
_TILT = 0.15  # [rad] noise on aligned orientations
_ADVANCES, _ON = 100, 5e-7  # steps that bring an open hand to an object, and the gap [m] that ends them
_MOST = 100_000  # samples
_BACKWARDS = 8  # steps that take an overlapping object out of the open hand


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """One placement of the palm that holds the object.

    Attributes:
        pose: oMh (4, 4), the hand's root frame in the world.
        closure: the hand closed there.
        forces: certified least-cost forces, at the impact time of the search.
        energy: their objective.
        load_factor: largest multiple of the load that can be held at that impact time.
    """

    pose: Array
    closure: Closure
    forces: ForceSolution
    energy: float
    load_factor: float

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacementSearch:
    """What a placement search found.

    Attributes:
        placements: best first.
        tried: number of samples.
        outcomes: how many of them ended how.
        interrupted: whether it was stopped (Ctrl-C): the placements are those found until then.
    """

    placements: tuple[Placement, ...]
    tried: int
    outcomes: dict[str, int]
    interrupted: bool

    __repr__ = brief()

    @property
    def best(self) -> Placement:
        """The first; :class:`PlacementNotFound` where there is none."""
        if not self.placements:
            counts = ", ".join(f"{count} {what}" for what, count in self.outcomes.items())
            raise PlacementNotFound(f"no placement of {self.tried} holds the object: {counts}", self)
        return self.placements[0]


# Beside hand, object and conditions seven options: of the samples, of their order, and of how they are run.
def find_placements(
    hand: HandModel,
    body: Body,
    conditions: GraspConditions,
    *,
    count: int = 64,
    seed: int = 0,
    margin: float = 1.2,
    impact_time: float = 0.9,
    wrap: bool = False,
    jobs: int = -1,
    progress: bool | None = None,
) -> PlacementSearch:
    """Sample placements of ``hand`` around ``body``, close it in each, and rank what holds.

    A sample puts the object's centre of mass between the half-closed fingertips and the palm, in a random or aligned
    orientation, and moves it away from the palm where the open hand would overlap it. The object stays; the hand is
    placed.

    Args:
        hand: the hand, wherever it is.
        body: what is to be held, where it is.
        conditions: friction, limits and what is to be balanced.
        count: samples.
        seed: of the random numbers; the result does not depend on ``jobs``.
        margin: placements that hold a smaller multiple of the load come after all others.
        impact_time: t_I of the forces that rank the placements [s].
        wrap: for power grasps: the object against the open hand, mostly its palm, and the fingers wrapped round it.
        jobs: processes (joblib); -1: all cores.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        Placements by: enough load margin first, then least energy. Stopped by Ctrl-C: those found until then.

    Raises:
        InvalidInput: conditions or options that cannot be used.
        PinograspError: a process was lost, or the object's own code failed.
    """
    _check(hand, body, conditions, impact_time)
    check_geometry(hand)
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    margin = number("margin", margin, at_least=0)
    impact_time = number("impact time t_I", impact_time, at_least=0, unit="s")
    flag("wrap", wrap)
    jobs = processes(jobs)
    instance_of("progress", progress, bool, type(None))
    seeds = np.random.SeedSequence(seed).spawn(count)
    found: list[Placement] = []
    outcomes: dict[str, int] = {}
    tried, interrupted = 0, False
    bar = tqdm(
        total=count, desc="placements", unit="sample", disable=None if progress is None else not progress, leave=False
    )
    # Meshes are heavy: they go to every process once, and never come back.
    with tempfile.TemporaryDirectory() as folder, interrupts_kept() as interrupt:
        case = _Case(hand=hand, body=body, conditions=conditions, impact_time=impact_time, wrap=wrap)
        try:
            parallel = joblib.effective_n_jobs(jobs) > 1
            task = _in_a_file(case, Path(folder) / "case.pickle") if parallel else case
            with parallel_results(_try, ((task, one) for one in seeds), jobs, return_as="generator") as results:
                for outcome, placement in results:
                    if isinstance(outcome, Exception):
                        raise outcome
                    tried += 1
                    bar.update()
                    outcomes[outcome] = outcomes.get(outcome, 0) + 1
                    if placement is not None:
                        closure = replace(placement.closure, hand=hand.placed(placement.pose), object=body)
                        forces = replace(placement.forces, problem=replace(placement.forces.problem, object=body))
                        found.append(replace(placement, closure=closure, forces=forces))
                    interrupt()
            interrupt()
        except KeyboardInterrupt:
            interrupted = True
        except BrokenProcessPool:
            why = "a process of the search was lost, by lack of memory or a crash: try fewer (jobs=1)"
            raise PinograspError(why) from None
    bar.close()
    found.sort(
        key=lambda one: (one.load_factor < margin, one.energy if one.load_factor >= margin else -one.load_factor)
    )
    return PlacementSearch(placements=tuple(found), tried=tried, outcomes=outcomes, interrupted=interrupted)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Case:
    """What all samples of a search have in common."""

    hand: HandModel
    body: Body
    conditions: GraspConditions
    impact_time: float
    wrap: bool


def _check(hand: HandModel, body: Body, conditions: GraspConditions, impact_time: float) -> None:
    """Raise at once what every sample would raise: with a problem of one contact under the same conditions."""
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body)
    instance_of("conditions", conditions, GraspConditions)
    at = body.pose[:3, 3]
    contact = Contact(finger="any", link="", point_o=at, rotation_oc=np.eye(3), length=None, distance=0.0)
    problem = conditions.problem(body, ContactSet(contacts=(contact,), com_o=at + [0.0, 0.0, 1.0]))
    problem.checked_impact_time(impact_time)
    effort_of(hand, conditions.torque_limit)


def _in_a_file(case: _Case, path: Path) -> str:
    """Write the case to a file, for other processes; its name."""
    try:
        content = cloudpickle.dumps(case)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise InvalidInput(
            f"find_placements: hand, object or conditions cannot go to other processes ({error}): use jobs=1"
        ) from None
    with write_errors(path):
        path.write_bytes(content)
    return str(path)


@functools.lru_cache(maxsize=1)
def _case(path: str) -> _Case:
    case: _Case = pickle.loads(Path(path).read_bytes())
    return case


def _try(case: _Case | str, seed: np.random.SeedSequence) -> tuple[str | Exception, Placement | None]:
    """The outcome of one sample, or the error that it ended in."""
    try:
        return _outcome(case, seed)
    except PinograspError as error:  # plain ones: those that carry more do not survive the way to another process
        return (InvalidInput if isinstance(error, InvalidInput) else PinograspError)(str(error)), None
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {error} (in {at.name}, {at.filename}, line {at.lineno})"
        return PinograspError(f"find_placements: a sample failed with {what}"), None


def _outcome(case: _Case | str, seed: np.random.SeedSequence) -> tuple[str, Placement | None]:
    """The outcome of one sample of a case, or of the file it is in; a placement comes without its hand and object."""
    case = _case(case) if isinstance(case, str) else case
    wrap = case.wrap
    try:
        sample = _sample(case.hand, case.body, np.random.default_rng(seed), wrap)
        if isinstance(sample, str):
            return sample, None
        placed, opened, closed = sample
        closure = close_hand(placed, case.body, start=opened, target=closed, wrap=wrap)
    except PinograspError:  # a link deep inside the object, or a mesh that no distance can be computed of
        return "the hand could not be closed", None
    if closure.self_collisions:
        return "fingers collide with each other", None
    outcome, placement = hold(closure, case.conditions, impact_time=case.impact_time)
    if placement is not None:
        forces = replace(placement.forces, problem=replace(placement.forces.problem, object=None))
        # Whoever asked for the sample has both, and puts them back.
        closure = replace(placement.closure, hand=None, object=None)  # type: ignore[arg-type]  # meshes are heavy
        placement = replace(placement, closure=closure, forces=forces)
    return outcome, placement


def hold(closure: Closure, conditions: GraspConditions, *, impact_time: float = 0.9) -> tuple[str, Placement | None]:
    """Forces that hold a closed hand's object, as a placement; and the outcome in words."""
    instance_of("closure", closure, Closure)
    instance_of("conditions", conditions, GraspConditions)
    touching = [touch for touch in closure.touches if touch.finger]
    if len(touching) < 2:
        return "fewer than two contacts", None
    # Where the jaws have pushed the object, the hand goes instead: the object's place is given.
    closure = _hand_moved(closure)
    contacts = closure.contacts()
    problem = problem_of(closure.hand, closure.object, contacts, conditions)
    forces = optimize_forces(problem, impact_time)
    if forces.status is not Status.OK or forces.certificate is None:
        return f"forces {forces.status}", None
    return "holds", Placement(
        pose=closure.hand.pose,
        closure=closure,
        forces=forces,
        energy=forces.certificate.objective,
        load_factor=load_factor(problem, impact_time=impact_time),
    )


def problem_of(hand: HandModel, body: Body, contacts: ContactSet, conditions: GraspConditions) -> ForceProblem:
    """The problem of holding an object with a closed hand, torques limited at the posture of the contacts."""
    problem = conditions.problem(body, contacts)
    limit = effort_of(hand, conditions.torque_limit)
    if not np.isfinite(limit).any():
        return problem
    if contacts.posture is None:
        raise InvalidInput("torque limits: expected contacts with a posture, as a closed hand's have: close the hand")
    torques = torque_limits(hand, contacts, contacts.posture, limit=limit, gravity_o=problem.gravity_o)
    return replace(problem, torques=torques)


def _hand_moved(closure: Closure) -> Closure:
    """The same closure with the hand moved back instead of the object pushed."""
    if np.array_equal(closure.pushed, np.eye(4)):
        return closure
    back = pin.SE3(np.array(closure.pushed)).inverse()
    touches = tuple(
        replace(
            touch,
            point_o=back.act(touch.point_o),
            normal_o=back.rotation @ touch.normal_o,
            patch_o=touch.patch_o @ back.rotation.T + back.translation,
        )
        for touch in closure.touches
    )
    return replace(
        closure,
        hand=closure.hand.placed((back * pin.SE3(np.array(closure.hand.pose))).homogeneous),
        object=closure.object.placed((back * pin.SE3(np.array(closure.object.pose))).homogeneous),
        touches=touches,
        pushed=np.eye(4),
    )


def _sample(hand: HandModel, body: Body, rng: np.random.Generator, wrap: bool) -> tuple[HandModel, Array, Array] | str:
    """The hand placed so that the object lies in its grasp, with an open and a closed posture; or why not, in words."""
    data = hand.model.createData()
    low, high = np.maximum(hand.lower, -np.pi), np.minimum(hand.upper, np.pi)
    pin.framesForwardKinematics(hand.model, data, low + rng.uniform(0.3, 0.7) * (high - low))
    tips = fingertips(hand, data)
    palm = link_centre(hand, data, 0)
    out = tips.mean(axis=0) - palm
    length = max(float(np.linalg.norm(out)), 1e-3)
    approach = out / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])
    across = tips[0] - tips[1:].mean(axis=0)
    across = across - approach * (approach @ across)
    if np.linalg.norm(across) < 1e-6:
        across = np.cross(approach, np.eye(3)[int(np.argmin(np.abs(approach)))])
    across /= np.linalg.norm(across)
    if rng.random() < _ALIGNED:
        frame = np.column_stack([across, np.cross(approach, across), approach])
        rotation = frame @ _AXES[rng.integers(len(_AXES))] @ pin.exp3(rng.normal(scale=_TILT * rng.random(), size=3))
    else:
        rotation = pin.exp3(np.pi * rng.uniform() ** (1 / 3) * _unit(rng.normal(size=3)))
    # Between palm and fingertips: fingertip grasps at the far end, power grasps at the near one.
    at = palm + out * rng.uniform(0.3, 1.1) + rng.normal(scale=0.05 * length, size=3)
    for _ in range(_BACKWARDS):
        # oMh = oMb (wMb)^-1 wMh, with w the world in which the hand is placed now.
        pose = pin.SE3(np.array(body.pose)) * pin.SE3(rotation, at).inverse() * pin.SE3(np.array(hand.pose))
        placed = hand.placed(pose.homogeneous)
        opened, closed = open_and_closed(placed, body)
        if clearance(placed, body, opened) > 0:
            if not wrap:
                return placed, opened, closed
            pressed = _pressed_on(placed, body, opened, pose.rotation @ hand.pose[:3, :3].T @ approach)
            return "the hand passes the object by" if pressed is None else (pressed, opened, closed)
        at = at + approach * 0.3 * body.bounding_radius
    return "the open hand overlaps the object"


def _pressed_on(hand: HandModel, body: Body, q: Array, direction: Array) -> HandModel | None:
    """The hand moved along ``direction`` (3,) until it touches the object; None where it passes by."""
    pose, moved = np.array(hand.pose), 0.0
    for _ in range(_ADVANCES):
        gap = clearance(hand, body, q)
        if gap <= _ON:
            return hand
        moved += gap
        if moved > 10 * body.bounding_radius:
            return None
        pose[:3, 3] += (gap - 0.2 * _ON) * direction
        hand = hand.placed(pose)
    return None


def _unit(v: Array) -> Array:
    unit: Array = v / np.linalg.norm(v)
    return unit


def _rotations_of_a_cube() -> list[Array]:
    signed = (
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    )
    return [turn for turn in signed if np.linalg.det(turn) > 0]


_AXES = _rotations_of_a_cube()
