"""Samples of a search, in batches: the hand drawn beside the object, closed, the best of a batch refined."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinograsp.contacts import (
    Closure,
    clearance,
    close_hand,
)
from pinograsp.contacts.advance import PreparedClosing
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.support_plane import SupportPlane, deepest_below
from pinograsp.errors import PinograspError
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.hands.efforts import find_stops
from pinograsp.objects.body import Body, tangents
from pinograsp.plan.tolerance import PoseError
from pinograsp.spatial import Array, cross, pose_of
from pinograsp.synthesis.found import ROOMS, FoundGrasp, hold
from pinograsp.synthesis.jaws import cannot_stop_alone, centre_on
from pinograsp.synthesis.prepared_hand import NEAREST, prepare_hand, scene_of
from pinograsp.synthesis.preshapes import Preshape, balance, rest_of
from pinograsp.synthesis.seeds import Pairs, find_pairs
from pinograsp.synthesis.setting import REFUSED, Setting
from pinograsp.synthesis.wishes import Miss, WishCheck, Wishes
from pinograsp.words import printable

_BLOCKED = ("the open hand overlaps the object", "the open hand overlaps the object or the table")
MISSED = "not as wished"
_LEAST_BALANCED = 100.0  # no imbalance is nearly as large
_LOOKS = 5  # at the hand on its way, whether it hits the table
_TURNS = 48  # of a hand about the line between its fingertips, of which a wished approach takes one
_DRAWS = 12  # of pair, preshape and turn, until the open hand is clear of the object
_BACKWARDS = 6  # steps that take an open hand back from an object that it overlaps
_EXACT = 3  # samples of a batch, at most, that the full program is asked about
_DEEP = 0.6  # of the samples lie deeper than between the fingertips
_AROUND = 8  # directions along a table in which an object may be displaced; twice as many without one
_ADVANCES, _ON = 100, 5e-7  # steps that bring an open hand to an object, and the gap [m] that ends them
_WIDER = 0.3  # of the way of the fingers: how much farther back than their preshape they start
_TRIES, _MOST_TRIES = 5, 20  # motions that are tried of the best of a batch, and as long as it is not gentle
_MOVE, _TURN, _SPREAD = 0.1, np.radians(8.0), 0.05  # of a refinement: shares of the object's radius, of ranges; angle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchCase:
    """What all samples of a search have in common; ``rough`` is the hand with its meshes' convex hulls, which is in
    ``scene`` and ``closing`` with the object as well; ``parts``: whether its open fingers are clear of each other, as
    of most hands.
    """

    hand: HandModel
    rough: HandModel
    body: Body
    conditions: GraspConditions
    impact_time: float
    wrap: bool
    preshapes: tuple[Preshape, ...]
    pairs: Pairs
    table: SupportPlane | None
    scene: BulkScene | None
    closing: PreparedClosing
    parts: bool
    wish_check: WishCheck
    setting: Setting | None


def make_search_case(
    hand: HandModel,
    body: Body,
    conditions: GraspConditions,
    impact_time: float,
    wrap: bool,
    rng: np.random.Generator,
    wishes: Wishes,
    setting: Setting | None,
) -> SearchCase:
    """Preshapes of the hand and pairs of the object, which all samples draw from."""
    check = WishCheck(wishes, hand, body, conditions.gravity_o)
    prepared = prepare_hand(hand, check.fingers)
    found = find_pairs(body, rng, check.within, [region for _, region in check.touching])
    return SearchCase(
        hand=hand,
        rough=prepared.rough,
        body=body,
        conditions=conditions,
        impact_time=impact_time,
        wrap=wrap,
        preshapes=prepared.preshapes,
        pairs=check.choose(found, max((one.depth for one in prepared.preshapes), default=0.0)),
        table=SupportPlane.under(body, conditions.gravity_o) if conditions.table else None,
        scene=scene_of(prepared.rough, body),
        closing=PreparedClosing(prepared.rough, body, collisions=prepared.collisions),
        parts=prepared.parts,
        wish_check=check,
        setting=setting,
    )


class Batch(NamedTuple):
    """How the samples of a batch ended, and the best of them, refined; it comes without its hand and object."""

    outcomes: list[str]
    grasp: FoundGrasp | None


class Posed(NamedTuple):
    """A hand placed open beside the object, the posture that it closes to, and the direction (3,) that it looks in, in
    its root frame.
    """

    hand: HandModel
    opened: Array
    closed: Array
    look_h: Array

    @property
    def look_o(self) -> Array:
        """That direction in the world (3,)."""
        look: Array = np.array(self.hand.pose)[:3, :3] @ self.look_h
        return look


def make_batch(case: SearchCase, rng: np.random.Generator, size: int) -> Batch:
    """Draw and close ``size`` samples, and refine the best."""
    outcomes: list[str] = []
    drawn: list[tuple[Posed, Tried]] = []
    for _ in range(size):
        posed = _draw(case, rng)
        if isinstance(posed, str):
            outcomes.append(posed)
            continue
        drawn.append((posed, _try_closing(case, posed)))
        outcomes.append(drawn[-1][1].outcome)
    if not drawn:
        return Batch(outcomes, None)
    ranked = [max(drawn, key=lambda sample: sample[1].worth)]  # each better than the one before
    better = 0  # the attempt that was the last to improve it
    for attempt in range(_MOST_TRIES):
        posed, tried = ranked[-1]
        if attempt >= _TRIES and tried.grasp is not None and tried.grasp.gentle:
            break
        if case.wish_check.wishes.names and tried.grasp is None and attempt - better > _TRIES:
            break
        moved = _move(case, posed, rng, 1.0 - attempt % _TRIES / _TRIES)
        other = _try_closing(case, moved)
        if other.worth > tried.worth:
            ranked.append((moved, other))
            better = attempt
    return Batch(outcomes, _best_of(case, ranked))


def _best_of(case: SearchCase, ranked: list[tuple[Posed, Tried]]) -> FoundGrasp | None:
    """The last of the samples that the hand itself and the full program find as good as they seemed, else the best."""
    best: FoundGrasp | None = None
    for posed, tried in ranked[: -_EXACT - 1 : -1]:
        if tried.grasp is None or (best is not None and best.sound >= tried.grasp.sound):
            break
        placed = posed._replace(hand=case.hand.placed(posed.hand.pose))
        exact = _try_closing(case, _open_wider(case, placed), quick=False).grasp
        if exact is None or exact.room < tried.grasp.room:
            exact = _try_closing(case, placed, quick=False).grasp
        if exact is not None and (best is None or exact.worth > best.worth):
            best = exact
    if best is None:
        return None
    forces = replace(best.forces, problem=replace(best.forces.problem, object=None))
    # Whoever asked for the samples has both, and puts them back.
    closure = replace(best.closure, hand=None, object=None)  # type: ignore[arg-type]  # meshes are heavy
    return replace(best, closure=closure, forces=forces)


def _open_wider(case: SearchCase, posed: Posed) -> Posed:
    """The same with a start from farther back on the way of its fingers, for an object that is not where it should be;
    as far as the joints' limits and the other links let it.
    """
    hand, opened, closed, _ = posed
    wider = np.clip(opened - _WIDER * (closed - opened), hand.lower, hand.upper)
    return posed if case.closing.collisions.between(opened, wider) else posed._replace(opened=wider)


class Tried(NamedTuple):
    """What came of closing a hand: how it ended, the grasp, and what is left of its contacts' unit forces."""

    outcome: str
    grasp: FoundGrasp | None = None
    imbalance: float = np.inf

    @property
    def worth(self) -> tuple[float, ...]:
        """Grasps as they rank; after them contacts that almost balance each other, which a small move may mend."""
        return (-1, -self.imbalance) if self.grasp is None else self.grasp.worth


def _try_closing(case: SearchCase, posed: Posed, *, quick: bool = True) -> Tried:
    """The outcome of closing a hand where it is; ``quick``: as one of many."""
    if case.parts and (hit := case.closing.collisions.between(rest_of(case.hand), posed.opened)):
        return Tried(f"open fingers collide ({_name_pair(hit[0])})")
    try:
        closure = _closure(case, posed, quick)
    except PinograspError:  # a link deep inside the object, or a mesh that no distance can be computed of
        return Tried("the hand could not be closed")
    if closure.self_collisions:
        return Tried(f"fingers collide ({_name_pair(closure.self_collisions[0])})")
    if not _above(case, posed.hand, np.linspace(posed.opened, closure.q, _LOOKS)):
        return Tried("the hand would hit the table")
    look_o = posed._replace(hand=closure.hand).look_o
    if rejected := _reject(case.wish_check.misses(closure, look_o)):
        return rejected
    # Samples were drawn where there is room, and hardly moved since.
    if not quick and (why := _refuse(case, posed._replace(hand=closure.hand))):
        return Tried(why)
    wanted = case.wish_check.wanted_fingers
    outcome, grasp = hold(closure, case.conditions, impact_time=case.impact_time, quick=quick, wanted_fingers=wanted)
    if grasp is not None:
        grasp = replace(grasp, room=_find_room(case, grasp.pose, posed.opened), look_o=look_o)
        if rejected := _reject(case.wish_check.misses_of_room(grasp.room)):
            return rejected
    touching = [touch for touch in closure.touches if touch.finger]
    if grasp is not None or len(touching) < 2:
        return Tried(outcome, grasp)
    _, imbalance = balance(*(np.array([getattr(one, at) for one in touching]) for at in ("point_o", "normal_o")))
    return Tried(outcome, imbalance=imbalance)


def _reject(misses: Iterator[Miss]) -> Tried | None:
    """A sample that is not as wished: it ranks after all that are, and the nearer, the better."""
    found = list(misses)
    if not found:
        return None
    return Tried(f"{MISSED} ({found[0].wish})", imbalance=_LEAST_BALANCED + sum(one.by for one in found))


def _name_pair(links: tuple[str, str]) -> str:
    """Two links in words."""
    one, other = (printable(link, 60) for link in links)
    return f"{one} with {other}"


def _find_room(case: SearchCase, pose: Array, opened: Array) -> float:
    """How far the object may be displaced before the open hand, placed at a pose (4, 4), is in its way [m]."""
    if case.scene is None or case.wrap:
        return 0.0
    table, scene = case.table, case.scene
    error = PoseError(distance=1.0, angle=0.0, count=_AROUND if table else 2 * _AROUND)
    ways, _ = error.spread(None if table is None else table.up_o)
    roots = np.tile(pose, (len(ways), 1, 1))
    q, parts = np.tile(opened, (len(ways), 1)), np.arange(len(scene.parts))
    room = 0.0
    opening = case.wish_check.wishes.opening
    sizes = {*ROOMS, *np.arange(ROOMS[-1], opening, ROOMS[1]).tolist(), opening} - {0.0}  # none jumps over a finger
    for size in sorted(sizes):
        roots[:, :3, 3] = pose[:3, 3] - size * ways
        if scene.gaps(q, roots, parts, _ON).min() < _ON:
            break
        room = size
    return room


def _closure(case: SearchCase, posed: Posed, rough: bool) -> Closure:
    """The hand closed; fingers that touch the object where they should not stay open, as long as two others close.

    ``rough``: it is that of hulls.
    """
    hand, closed, prepared = posed.hand, posed.closed.copy(), case.closing
    if not rough:
        prepared = PreparedClosing(hand, case.body, collisions=prepared.collisions)
    if cannot_stop_alone(hand) and not case.wrap:
        closure = centre_on(hand, case.body, posed.opened, closed, prepared)
        if closure is not None:
            return closure
    closing = {finger.name: finger for finger in hand.fingers}
    while True:
        closure = close_hand(hand, case.body, start=posed.opened, target=closed, wrap=case.wrap, prepared=prepared)
        misses = case.wish_check.misses(closure, posed.look_o) if case.wish_check.of_parts else ()
        outside = {name for miss in misses for name in miss.fingers if name in closing}
        if not outside or len(closing) - len(outside) < 2:
            return closure
        for name in outside:
            dofs = closing.pop(name).dofs
            closed[dofs] = posed.opened[dofs]


def _draw(case: SearchCase, rng: np.random.Generator) -> Posed | str:
    """A hand clear of the object, its fingertips about two surfaces that face each other; else why there is none."""
    pairs = case.pairs
    if not len(pairs.widths):
        return "no two surfaces of the object face each other"
    # Fingertips press joints that give way along a drive open; fingers that wrap close them.
    fitting = tuple(one for one in case.preshapes if one.yielded is not case.wrap)
    shapes = fitting if len(fitting) >= NEAREST // 2 else case.preshapes
    widths = np.array([one.width for one in shapes])
    why = Counter[str]()
    for _ in range(_DRAWS if shapes else 0):
        # Pairs near the centre of mass are drawn more often: there the weight turns nothing.
        i = min(int(rng.exponential(len(pairs.widths) / 4)), len(pairs.widths) - 1)
        nearest = np.argsort(np.abs(widths - pairs.widths[i]), kind="stable")[:NEAREST]
        shape = shapes[int(rng.choice(nearest))]
        axis = pairs.axes_o[i] if rng.random() < 0.5 else -pairs.axes_o[i]
        frame = _across(axis, rng.uniform(0, 2 * np.pi))
        if case.wish_check.look_o is not None:
            frames = np.array([_across(axis, turn) for turn in rng.uniform(0, 2 * np.pi, _TURNS)])
            frame = frames[case.wish_check.draw_turn(frames, rng)]
        deep = rng.uniform(0, 1) * shape.depth if rng.random() < _DEEP else 0.0
        turn = frame @ _across_of(shape).T
        deepest = case.wish_check.limit_depth(pairs.middles_o[i], turn @ shape.out_h, shape.depth)
        if deepest < 0:
            continue
        deep = min(deep, deepest)
        # The hand's centre between its fingertips, moved towards the palm, goes to the middle of the pair.
        at = pairs.middles_o[i] - turn @ (shape.centre_h - deep * shape.out_h)
        out = turn @ shape.out_h
        placed = _clear(case, pose_of(at, turn), out, shape.opened)
        if placed is not None and case.wrap:
            placed = _press_on(case, placed, shape.opened, out)
        if placed is not None and _above(case, placed, shape.opened[None]):
            posed = Posed(placed, shape.opened, shape.closed, shape.out_h)
            if not (refused := _refuse(case, posed)):
                return posed
            why[refused] += 1
    return why.most_common(1)[0][0] if why else _BLOCKED[case.table is not None]


def _refuse(case: SearchCase, posed: Posed) -> str:
    """Why the open hand cannot be there, besides the object; "": it can."""
    why = "" if case.setting is None else case.setting.refuse(posed.hand, posed.opened)
    return why and f"{REFUSED} ({why})"


def _above(case: SearchCase, hand: HandModel, postures: Array) -> bool:
    """Whether the hand keeps above the table, where there is one, at postures (m, n)."""
    return case.table is None or deepest_below(hand, case.table, postures) is None


def _across(axis: Array, turn: float) -> Array:
    """A frame (3, 3) whose first axis is the given one, turned about it [rad]."""
    first: Array = tangents(axis[None])[0, :, 0]
    out: Array = np.cos(turn) * first + np.sin(turn) * cross(axis, first)
    return np.column_stack([axis, cross(out, axis), out])


def _across_of(shape: Preshape) -> Array:
    """The same frame of a preshape, in the hand: axis, across, out."""
    return np.column_stack([shape.axis_h, cross(shape.out_h, shape.axis_h), shape.out_h])


def _clear(case: SearchCase, pose: Array, out: Array, opened: Array) -> HandModel | None:
    """The hand taken back against ``out`` (3,) until it is clear of the object; None where it stays in its way."""
    for _ in range(_BACKWARDS):
        gap = _gap(case, pose, opened)
        if gap > _ON:
            return case.rough.placed(pose)
        pose = pose.copy()
        pose[:3, 3] -= (0.1 * case.body.bounding_radius - gap) * out
    return None


def _move(case: SearchCase, posed: Posed, rng: np.random.Generator, size: float) -> Posed:
    """The hand moved and turned about the object a little, its fingers spread a little differently."""
    pose, body = np.array(posed.hand.pose), case.body
    turn = pin.exp3(size * _TURN * rng.normal(size=3))
    about = body.com_o if case.wish_check.within is None else case.wish_check.within.middle_o
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = about + turn @ (pose[:3, 3] - about)
    pose[:3, 3] += size * _MOVE * body.bounding_radius * rng.normal(size=3)
    hand = posed.hand
    spread = np.isin(np.arange(hand.n), np.concatenate([finger.dofs for finger in hand.fingers]))
    spread &= (posed.opened == posed.closed) & (find_stops(hand, posed.opened) == 0)
    by = np.where(spread, size * _SPREAD * rng.normal(size=hand.n) * (hand.upper - hand.lower), 0.0)
    opened, closed = (np.clip(q + by, hand.lower, hand.upper) for q in (posed.opened, posed.closed))
    return Posed(case.rough.placed(pose), opened, closed, posed.look_h)


def _press_on(case: SearchCase, hand: HandModel, q: Array, direction: Array) -> HandModel | None:
    """The hand moved along ``direction`` (3,) until it touches the object; None where it passes by."""
    pose, moved = np.array(hand.pose), 0.0
    for _ in range(_ADVANCES):
        gap = _gap(case, pose, q)
        if gap <= _ON:
            return hand.placed(pose)
        moved += gap
        if moved > 10 * case.body.bounding_radius:
            return None
        pose[:3, 3] += (gap - 0.2 * _ON) * direction
    return None


def _gap(case: SearchCase, pose: Array, q: Array) -> float:
    """Between the hand's hulls, placed at a pose (4, 4), and the object [m]; where they overlap, negative."""
    if case.scene is None:
        return clearance(case.rough.placed(pose), case.body, q)
    every = np.arange(len(case.scene.parts))
    return float(case.scene.gaps(q[None], pose[None], every, 20 * case.body.bounding_radius)[0])
