"""Searching grasps: opposed preshapes put on opposed surfaces of the object, closed, judged, and the best refined.

A sample takes two surfaces of the object that face each other, a preshape whose fingertips oppose each other about as
far apart, any turn about the line between them, and any depth towards the palm; the hand closes, and what touches is
judged by what the contacts withstand in their weakest direction per newton of squeeze (Ferrari and Canny, 1992).
Samples are closed with the convex hulls of the hand's meshes, which is quick; the best are moved about a little, as
long as that improves them, and closed with the exact geometry in the end.
"""

from __future__ import annotations

import functools
import pickle
import tempfile
import traceback
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cloudpickle
import joblib
import numpy as np
import pinocchio as pin
from tqdm import tqdm

from pinograsp.checks import brief, flag, instance_of, integer, number, processes
from pinograsp.contacts import (
    PALM,
    Closure,
    Contact,
    ContactSet,
    NearPoint,
    check_geometry,
    clearance,
    close_hand,
    near_points,
)
from pinograsp.contacts.quality import ferrari_canny
from pinograsp.errors import GraspNotFound, InvalidInput, PinograspError, Status
from pinograsp.forces import ForceProblem, ForceSolution, GraspConditions, Reserve, load_factor, optimize_forces
from pinograsp.hands import HandModel
from pinograsp.hands.geometry import hulls
from pinograsp.interrupts import interrupts_kept, parallel_results
from pinograsp.motion import effort_of, torque_limits
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array
from pinograsp.synthesis.preshapes import Preshape, preshapes
from pinograsp.synthesis.seeds import Pairs, pairs_of
from pinograsp.writing import write_errors

_MOST = 100_000  # samples
_DRAWS = 12  # of pair, preshape and turn, until the open hand is clear of the object
_BACKWARDS = 6  # steps that take an open hand back from an object that it overlaps
_BALANCED = 0.15  # imbalance of preshapes that are used, where there are enough of them
_NEAREST = 12  # preshapes nearest in width to a pair, of which one is taken
_DEEP = 0.6  # of the samples lie deeper than between the fingertips
_ADVANCES, _ON = 100, 5e-7  # steps that bring an open hand to an object, and the gap [m] that ends them
_BATCH, _TRIES = 8, 8  # samples of which the best is refined, and motions that are tried of it
_MOVE, _TURN, _SPREAD = 0.1, np.radians(8.0), 0.05  # of a refinement: shares of the object's radius, of ranges; angle
_CENTRINGS, _CHEAP, _RATHER = 8, 100.0, 3.0  # closings that centre jaws; they rather close on, or move, than turn
_SHARP, _POINTS = 0.1, 20_000  # tolerance and effort of the quality
_MILLIMETRES = 100.0  # an object that many times too large or too small was drawn in other units


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundGrasp:
    """One grasp: the hand placed and closed so that it holds the object.

    Attributes:
        pose: oMh (4, 4), the hand's root frame in the world.
        closure: the hand closed there.
        forces: certified least-cost forces, at the impact time of the search.
        quality: what the contacts withstand in their weakest direction per newton of squeeze [-], moments over the
            reserve's arm, with the friction that the reserve relies on; 0 without force closure.
        energy: objective of the forces.
        load_factor: largest multiple of the load that can be held at that impact time.
    """

    pose: Array
    closure: Closure
    forces: ForceSolution
    quality: float
    energy: float
    load_factor: float

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspSearch:
    """What a search of grasps found.

    Attributes:
        grasps: best first.
        tried: number of samples.
        outcomes: how many of them ended how.
        opening: least and largest width between the fingertips of this hand's preshapes [m].
        width: least distance of two surfaces of the object that face each other [m]; infinity: there are none.
        interrupted: whether it was stopped (Ctrl-C): the grasps are those found until then.
    """

    grasps: tuple[FoundGrasp, ...]
    tried: int
    outcomes: dict[str, int]
    opening: tuple[float, float]
    width: float
    interrupted: bool

    __repr__ = brief()

    @property
    def best(self) -> FoundGrasp:
        """The first; :class:`GraspNotFound` where there is none."""
        if not self.grasps:
            raise GraspNotFound(self.explain(), self)
        return self.grasps[0]

    def explain(self) -> str:
        """What came of it in words: how many samples ended how, and what to do where none holds."""
        counts = ", ".join(f"{count} {what}" for what, count in self.outcomes.items())
        if self.grasps:
            return f"{len(self.grasps)} grasps of {self.tried} samples: {counts}"
        text, (least, largest) = f"no grasp of {self.tried} samples holds the object: {counts}", self.opening
        sizes = f"its opposed surfaces are {1e3 * self.width:.3g} mm apart or more, and this hand opens by"
        if self.width > largest:
            text += f". The object is too large: {sizes} {1e3 * largest:.3g} mm"
        elif self.width < least / _MILLIMETRES:
            text += f". The object is very small: {sizes} {1e3 * least:.3g} to {1e3 * largest:.3g} mm"
        if not least / _MILLIMETRES < self.width < largest * _MILLIMETRES:
            text += "; millimetres read as metres, or metres as millimetres? (scale=0.001)"
        return text


# Beside hand, object and conditions six options: of the samples and of how they are run.
def find_grasps(
    hand: HandModel,
    body: Body,
    conditions: GraspConditions,
    *,
    count: int = 64,
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
        count: samples.
        seed: of the random numbers; the result does not depend on ``jobs``.
        impact_time: t_I of the forces that grasps are tried with [s].
        wrap: for power grasps: the object against the open hand, mostly its palm, and the fingers wrapped round it.
        jobs: processes (joblib); -1: all cores.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        Grasps by what they withstand in the weakest direction per newton of squeeze; those without force closure come
        last, by the multiple of the load that they hold. Stopped by Ctrl-C: those found until then.

    Raises:
        InvalidInput: conditions or options that cannot be used.
        PinograspError: a process was lost, or the object's own code failed.
    """
    _check(hand, body, conditions, impact_time)
    check_geometry(hand)
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    impact_time = number("impact time t_I", impact_time, at_least=0, unit="s")
    flag("wrap", wrap)
    jobs = processes(jobs)
    instance_of("progress", progress, bool, type(None))
    first, *seeds = np.random.SeedSequence(seed).spawn(1 + -(-count // _BATCH))
    case = _case_of(hand, body, conditions, impact_time, wrap, np.random.default_rng(first))
    found: list[FoundGrasp] = []
    outcomes: dict[str, int] = {}
    interrupted = False
    sizes = [min(_BATCH, count - i) for i in range(0, count, _BATCH)]
    bar = tqdm(
        total=count, desc="grasps", unit="sample", disable=None if progress is None else not progress, leave=False
    )
    # Meshes are heavy: they go to every process once, and never come back.
    with tempfile.TemporaryDirectory() as folder, interrupts_kept() as interrupt:
        try:
            parallel = joblib.effective_n_jobs(jobs) > 1
            task = _in_a_file(case, Path(folder) / "case.pickle") if parallel else case
            work = ((task, one, size) for one, size in zip(seeds, sizes))
            with parallel_results(_try, work, jobs, return_as="generator") as results:
                for batch in results:
                    if isinstance(batch, Exception):
                        raise batch
                    for outcome in batch.outcomes:
                        outcomes[outcome] = outcomes.get(outcome, 0) + 1
                    bar.update(len(batch.outcomes))
                    if batch.grasp is not None:
                        found.append(batch.grasp)
                    interrupt()
            interrupt()
        except KeyboardInterrupt:
            interrupted = True
        except BrokenProcessPool:
            why = "a process of the search was lost, by lack of memory or a crash: try fewer (jobs=1)"
            raise PinograspError(why) from None
    bar.close()
    widths = [one.width for one in case.preshapes]
    return GraspSearch(
        grasps=tuple(_with_bodies(hand, body, one) for one in sorted(found, key=_rank)),
        tried=sum(outcomes.values()),
        outcomes=outcomes,
        opening=(max(0.0, min(widths, default=0.0)), max(widths, default=0.0)),
        width=float(min(case.pairs.widths, default=np.inf)),
        interrupted=interrupted,
    )


def _rank(grasp: FoundGrasp) -> tuple[float, float]:
    return -grasp.quality, -grasp.load_factor


def _with_bodies(hand: HandModel, body: Body, grasp: FoundGrasp) -> FoundGrasp:
    """A grasp as it came from another process, with its hand and object."""
    closure = replace(grasp.closure, hand=hand.placed(grasp.pose), object=body)
    forces = replace(grasp.forces, problem=replace(grasp.forces.problem, object=body))
    return replace(grasp, closure=closure, forces=forces)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Case:
    """What all samples of a search have in common."""

    hand: HandModel
    rough: HandModel
    body: Body
    conditions: GraspConditions
    impact_time: float
    wrap: bool
    preshapes: tuple[Preshape, ...]
    pairs: Pairs


def _case_of(
    hand: HandModel,
    body: Body,
    conditions: GraspConditions,
    impact_time: float,
    wrap: bool,
    rng: np.random.Generator,
) -> _Case:
    shapes = preshapes(hand, rng)
    good = [one for one in shapes if one.imbalance < _BALANCED]
    return _Case(
        hand=hand,
        rough=replace(hand, geometry=hulls(hand.geometry)),
        body=body,
        conditions=conditions,
        impact_time=impact_time,
        wrap=wrap,
        preshapes=tuple(good if len(good) >= _NEAREST else shapes[: 4 * _NEAREST]),
        pairs=pairs_of(body, rng),
    )


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
            f"find_grasps: hand, object or conditions cannot go to other processes ({error}): use jobs=1"
        ) from None
    with write_errors(path):
        path.write_bytes(content)
    return str(path)


@functools.lru_cache(maxsize=1)
def _case(path: str) -> _Case:
    case: _Case = pickle.loads(Path(path).read_bytes())
    return case


class _Batch(NamedTuple):
    """How the samples of a batch ended, and the best of them, refined; it comes without its hand and object."""

    outcomes: list[str]
    grasp: FoundGrasp | None


def _try(case: _Case | str, seed: np.random.SeedSequence, size: int) -> _Batch | Exception:
    """A batch of samples, or the error that it ended in."""
    try:
        return _batch(_case(case) if isinstance(case, str) else case, np.random.default_rng(seed), size)
    except PinograspError as error:  # plain ones: those that carry more do not survive the way to another process
        return (InvalidInput if isinstance(error, InvalidInput) else PinograspError)(str(error))
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {error} (in {at.name}, {at.filename}, line {at.lineno})"
        return PinograspError(f"find_grasps: a sample failed with {what}")


class _Posed(NamedTuple):
    """A hand placed open beside the object, and the posture that it closes to."""

    hand: HandModel
    opened: Array
    closed: Array


def _batch(case: _Case, rng: np.random.Generator, size: int) -> _Batch:
    outcomes: list[str] = []
    best: tuple[float, _Posed, FoundGrasp] | None = None
    for _ in range(size):
        posed = _drawn(case, rng)
        outcome, grasp = ("the open hand overlaps the object", None) if posed is None else _closed(case, posed)
        outcomes.append(outcome)
        if posed is not None and grasp is not None and (best is None or grasp.quality > best[0]):
            best = (grasp.quality, posed, grasp)
    if best is None:
        return _Batch(outcomes, None)
    quality, posed, grasp = best
    for attempt in range(_TRIES):
        moved = _moved(case, posed, rng, 1.0 - attempt / _TRIES)
        _, other = _closed(case, moved)
        if other is not None and other.quality > quality:
            quality, posed, grasp = other.quality, moved, other
    _, exact = _closed(case, _Posed(case.hand.placed(posed.hand.pose), posed.opened, posed.closed))
    if exact is None:
        return _Batch(outcomes, None)
    forces = replace(exact.forces, problem=replace(exact.forces.problem, object=None))
    # Whoever asked for the samples has both, and puts them back.
    closure = replace(exact.closure, hand=None, object=None)  # type: ignore[arg-type]  # meshes are heavy
    return _Batch(outcomes, replace(exact, closure=closure, forces=forces))


def _closed(case: _Case, posed: _Posed) -> tuple[str, FoundGrasp | None]:
    """The outcome of closing a hand where it is."""
    closure = None
    try:
        if _shared(posed.hand) and not case.wrap:
            closure = _centred(posed, case.body)
        if closure is None:
            closure = close_hand(posed.hand, case.body, start=posed.opened, target=posed.closed, wrap=case.wrap)
    except PinograspError:  # a link deep inside the object, or a mesh that no distance can be computed of
        return "the hand could not be closed", None
    if closure.self_collisions:
        return "fingers collide with each other", None
    return hold(closure, case.conditions, impact_time=case.impact_time)


def _shared(hand: HandModel) -> bool:
    """Whether fingers share an actuator, or a single one presses against the palm: they cannot stop one by one."""
    return len(hand.fingers) == 1 or len({i for one in hand.fingers for i in one.dofs.tolist()}) < sum(
        one.n for one in hand.fingers
    )


def _centred(posed: _Posed, body: Body) -> Closure | None:
    """The closure of fingers that cannot stop one by one, with the hand moved so that they touch at the same time.

    Pushing the object between them would take far longer. None where that does not come to two fingers that touch.
    """
    hand, way = posed.hand, posed.closed - posed.opened
    fingers = {one.name for one in hand.fingers} | ({PALM} if len(hand.fingers) == 1 else set())
    closure = None
    for _ in range(_CENTRINGS):
        try:
            closure = close_hand(hand, body, start=posed.opened, target=posed.closed, fixed=True)
        except PinograspError:  # moved into the object
            break
        touching = {touch.finger for touch in closure.touches}
        near = near_points(hand, body, closure.q)
        # The others are too far away to take part.
        pressing = [name for name, one in near.items() if name in fingers and one.gap < 2 * body.bounding_radius]
        if len(pressing) < 2 or touching.issuperset(pressing):
            break
        hand = hand.placed(_evened(hand, body, closure.q, way, [near[name] for name in pressing]))
    if closure is None or len({touch.finger for touch in closure.touches} & fingers) < 2:
        return None
    return closure


def _evened(hand: HandModel, body: Body, q: Array, way: Array, pressing: list[NearPoint]) -> Array:
    """The pose (4, 4) with the least motion of the hand after which closing on brings all points to the surface."""
    data = hand.model.createData()
    pin.computeJointJacobians(hand.model, data, q)
    points = np.array([one.point_o for one in pressing])
    _, normals, _ = body.project(points)
    arm = body.bounding_radius
    closing = []
    for one, point, normal in zip(pressing, points, normals):
        J = np.zeros((6, hand.n))
        if one.joint:
            J = pin.getJointJacobian(hand.model, data, one.joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, hand.n)
        speed = J[:3] @ way + np.cross(J[3:] @ way, point - data.oMi[one.joint].translation)
        closing.append(normal @ speed)
    turning = np.cross(points - body.com_o, normals) / (_RATHER * arm)
    rows = np.column_stack([normals, turning, _CHEAP * np.array(closing)])
    motion = np.linalg.lstsq(rows, np.array([one.gap for one in pressing]), rcond=1e-9)[0]
    size = float(np.linalg.norm(motion[:3]))
    if size > arm:
        motion *= arm / size
    turn = pin.exp3(motion[3:6] / (_RATHER * arm))
    pose = np.array(hand.pose)
    pose[:3, 3] = body.com_o + turn @ (pose[:3, 3] - body.com_o) + motion[:3]
    pose[:3, :3] = turn @ pose[:3, :3]
    return pose


def _drawn(case: _Case, rng: np.random.Generator) -> _Posed | None:
    """A hand clear of the object, its fingertips about two surfaces that face each other; None: not found."""
    pairs, body = case.pairs, case.body
    widths = np.array([one.width for one in case.preshapes])
    for _ in range(_DRAWS):
        # Pairs near the centre of mass are drawn more often: there the weight turns nothing.
        i = min(int(rng.exponential(len(pairs.widths) / 4)), len(pairs.widths) - 1)
        nearest = np.argsort(np.abs(widths - pairs.widths[i]), kind="stable")[:_NEAREST]
        shape = case.preshapes[int(rng.choice(nearest))]
        axis = pairs.axes_o[i] if rng.random() < 0.5 else -pairs.axes_o[i]
        frame = _across(axis, rng.uniform(0, 2 * np.pi))
        deep = rng.uniform(0, 1) * shape.depth if rng.random() < _DEEP else 0.0
        turn = frame @ _across_of(shape).T
        # The hand's centre between its fingertips, moved towards the palm, goes to the middle of the pair.
        at = pairs.middles_o[i] - turn @ (shape.centre_h - deep * shape.out_h)
        out = turn @ shape.out_h
        placed = _clear(case, _pose(turn, at), out, shape.opened)
        if placed is not None and case.wrap:
            placed = _pressed_on(placed, body, shape.opened, out)
        if placed is not None:
            return _Posed(placed, shape.opened, shape.closed)
    return None


def _across(axis: Array, turn: float) -> Array:
    """A frame (3, 3) whose first axis is the given one, turned about it [rad]."""
    first = tangents(axis[None])[0, :, 0]
    out = np.cos(turn) * first + np.sin(turn) * np.cross(axis, first)
    return np.column_stack([axis, np.cross(out, axis), out])


def _across_of(shape: Preshape) -> Array:
    """The same frame of a preshape, in the hand: axis, across, out."""
    return np.column_stack([shape.axis_h, np.cross(shape.out_h, shape.axis_h), shape.out_h])


def _pose(rotation: Array, at: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, at
    return pose


def _clear(case: _Case, pose: Array, out: Array, opened: Array) -> HandModel | None:
    """The hand taken back against ``out`` (3,) until it is clear of the object; None where it stays in its way."""
    for _ in range(_BACKWARDS):
        placed = case.rough.placed(pose)
        gap = clearance(placed, case.body, opened)
        if gap > _ON:
            return placed
        pose = pose.copy()
        pose[:3, 3] -= (0.1 * case.body.bounding_radius - gap) * out
    return None


def _moved(case: _Case, posed: _Posed, rng: np.random.Generator, size: float) -> _Posed:
    """The hand moved and turned about the object a little, its fingers spread a little differently."""
    pose, body = np.array(posed.hand.pose), case.body
    turn = pin.exp3(size * _TURN * rng.normal(size=3))
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = body.com_o + turn @ (pose[:3, 3] - body.com_o)
    pose[:3, 3] += size * _MOVE * body.bounding_radius * rng.normal(size=3)
    hand = posed.hand
    spread = posed.opened == posed.closed
    by = np.where(spread, size * _SPREAD * rng.normal(size=hand.n) * (hand.upper - hand.lower), 0.0)
    opened, closed = (np.clip(q + by, hand.lower, hand.upper) for q in (posed.opened, posed.closed))
    return _Posed(case.rough.placed(pose), opened, closed)


def hold(closure: Closure, conditions: GraspConditions, *, impact_time: float = 0.9) -> tuple[str, FoundGrasp | None]:
    """Forces that hold a closed hand's object, as a grasp; and the outcome in words."""
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
    reserve = Reserve() if conditions.reserve is None else conditions.reserve
    quality = ferrari_canny(
        contacts,
        problem.mu * (1.0 - reserve.friction),
        friction=replace(problem.friction, torsion=problem.friction.torsion * (1.0 - reserve.friction)),
        moment_length=reserve.arm(closure.object) or None,
        balance=problem.balance,
        tolerance=_SHARP,
        limit=_POINTS,
    )
    return "holds", FoundGrasp(
        pose=closure.hand.pose,
        closure=closure,
        forces=forces,
        quality=float(quality.lower),
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
