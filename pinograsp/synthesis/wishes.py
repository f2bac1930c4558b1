"""What a user asks of a grasp besides that it holds: by which fingers, where, from which side."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, instance_of, integer, items_of, number, one_of, read_only
from pinograsp.contacts import PALM, Closure
from pinograsp.contacts.edges import on_edges, turns_nearby
from pinograsp.contacts.support_plane import SupportPlane
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body, check_box
from pinograsp.spatial import Array
from pinograsp.synthesis.preshapes import measure_thickness
from pinograsp.synthesis.seeds import Pairs, Region, find_gap
from pinograsp.words import printable

Side: TypeAlias = Literal["above", "below", "side"]
_SIDES: dict[str, tuple[float, float]] = {"above": (0.0, 0.0), "below": (180.0, 180.0), "side": (90.0, 90.0)}  # [deg]
_CONE = np.radians(40.0)  # of approaches that are named by a word
_OFF_EDGES = 6e-3  # [m] of surfaces that are drawn where no contact may lie on an edge: fingertips are not points
_SAME_FINGER = {"pinky": "little", "little": "pinky", "forefinger": "index"}
FINGERS = 3  # that are to take part, where a hand has so many and enough grasps of so many hold
_BESIDE = 1e-3  # [m] that fingers may start along an object, for a hand that comes from one side
_SLIT = 1e-3  # [m] of openings that are not told
_NO_FINGER = "no finger of this hand"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Approach:
    """From which side the hand comes: the direction from where its fingers start to what is between their tips.

    And its fingers start before the object, as seen along the direction: a palm beside a mug does not come from above.

    Attributes:
        direction: that the hand looks in (3,), of any length; (0, 0, -1) in the world comes from above.
        cone: largest angle between the two [rad].
        frame: ``"world"`` or ``"object"``: whose axes the direction has.
    """

    direction: Array
    cone: float = _CONE
    frame: Literal["world", "object"] = "world"

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self, *, direction: ArrayLike, cone: float = ..., frame: Literal["world", "object"] = ...
        ) -> None: ...

    __repr__ = brief()

    def __post_init__(self) -> None:
        direction = array_of("approach: direction", self.direction, (3,))
        if not direction.any():
            raise InvalidInput("approach: direction: expected a direction, got 0, 0, 0")
        object.__setattr__(self, "direction", read_only(direction / np.linalg.norm(direction)))
        object.__setattr__(self, "cone", number("approach: cone", self.cone, above=0, at_most=np.pi, unit="rad"))
        one_of("approach: frame", self.frame, ("world", "object"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wishes:
    """What a grasp is to be like; what is not said may be anyhow. Grasps that are not so are not found.

    A part of the object is a name (:attr:`Body.regions <pinograsp.objects.body.Body.regions>`, as the groups of an OBJ
    file) or a box, lower and upper corner (2, 3) along the axes of its own frame [m].

    Attributes:
        fingers: names of those that alone may touch; the others stay open. The palm is no finger.
        least_fingers: that touch at least. Without it 3 are preferred, where a hand has so many; 2 for pinches.
        within: part outside which nothing touches.
        touching: parts of which each is touched by a finger.
        forbidden: parts that nothing touches.
        approach: from which side the hand comes: ``"above"``, ``"below"`` or ``"side"`` (level), within 40 deg, or an
            :class:`Approach`.
        edges: False: no contact on an edge of the object.
        palm: True: the palm touches, too; False: it does not.
        opening: how far the object may be displaced before the open hand is in its way [m].

    Example:
        >>> import pinograsp as pg
        >>> hand, ball = pg.load_hand("panda"), pg.Sphere(radius=0.02, mass=0.1)
        >>> wishes, conditions = pg.Wishes(approach="above"), pg.GraspConditions(mu=0.6)
        >>> found = pg.find_grasps(hand, ball, conditions, wishes=wishes, count=4, seed=0, jobs=1)
        >>> print(len(found.grasps) > 0)
        True

    See Also:
        :func:`~pinograsp.synthesis.find_grasps`, :func:`~pinograsp.pick.plan_pick`.
    """

    fingers: Sequence[str] | None = None
    least_fingers: int | None = None
    within: str | ArrayLike | None = None
    touching: Sequence[str | ArrayLike] = ()
    forbidden: Sequence[str | ArrayLike] = ()
    approach: Side | Approach | None = None
    edges: bool = True
    palm: bool | None = None
    opening: float = 0.0

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        if self.fingers is not None:
            put("fingers", items_of("fingers", self.fingers, str))
            if not self.fingers or len(set(self.fingers)) < len(self.fingers):
                raise InvalidInput(f"fingers: expected names, each once, got {list(self.fingers)}")
        if self.least_fingers is not None:
            put("least_fingers", integer("least_fingers", self.least_fingers, at_least=1))
        put("within", None if self.within is None else _part("within", self.within))
        for name in ("touching", "forbidden"):
            parts = getattr(self, name)
            if isinstance(parts, str) or not isinstance(parts, Sequence):
                raise InvalidInput(f"{name}: expected a list of parts, got {parts!r:.60}")
            put(name, tuple(_part(name, part) for part in parts))
        if isinstance(self.approach, str):
            one_of("approach", self.approach, _SIDES)
        instance_of("approach", self.approach, str, Approach, type(None))
        flag("edges", self.edges)
        instance_of("palm", self.palm, bool, type(None))
        put("opening", number("opening", self.opening, at_least=0, at_most=1, unit="m"))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what is asked for."""
        return tuple(one.name for one in fields(self) if not _is_default(getattr(self, one.name), one.default))

    def without(self, *names: str) -> Wishes:
        """The same without some of them."""
        defaults: dict[str, Any] = {one.name: one.default for one in fields(self) if one.name in names}
        return replace(self, **defaults)


NO_WISHES = Wishes()


def _is_default(value: object, default: object) -> bool:
    return value is default or (isinstance(value, bool | float | tuple) and value == default)


def _part(name: str, part: str | ArrayLike) -> str | Array:
    return part if isinstance(part, str) else read_only(check_box(name, part))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Miss:
    """A wish that a closed hand does not meet.

    Attributes:
        wish: its name.
        by: how much is missing [-]: shares of the object's radius, of pi, or of fingers.
        description: what is there instead, in words.
        fingers: that are in the way.
    """

    wish: str
    by: float
    description: str
    fingers: tuple[str, ...] = ()

    __repr__ = brief()


class WishCheck:
    """Wishes of a hand and an object, looked at in a search.

    Args:
        wishes: the wishes.
        hand: the hand.
        body: the object, where it is.
        gravity_o: (3,), for above and below [m/s^2].

    Raises:
        InvalidInput: fingers or parts that there are not, or fingers that cannot be moved alone.
    """

    def __init__(self, wishes: Wishes, hand: HandModel, body: Body, gravity_o: ArrayLike = (0.0, 0.0, -9.81)):
        self.wishes, self.hand, self.body, self.radius = wishes, hand, body, body.bounding_radius
        self.fingers = None if wishes.fingers is None else find_fingers(hand, wishes.fingers)
        available = len(hand.fingers) if self.fingers is None else len(self.fingers)
        if wishes.least_fingers is not None and wishes.least_fingers > available:
            raise InvalidInput(
                f"least_fingers: expected at most {available}, got {wishes.least_fingers}: "
                + ("the hand has no more" if self.fingers is None else "fingers= names no more")
            )
        self.within = None if wishes.within is None else _region(wishes.within, body)
        self.touching = [(_name_part(part), _region(part, body)) for part in wishes.touching]
        self.forbidden = [(_name_part(part), _region(part, body)) for part in wishes.forbidden]
        self.look_o, self.least, self.most = _cone(wishes.approach, body, gravity_o)
        # Where the object begins along one direction; the sides have none.
        self.begins: float | None = None
        if self.look_o is not None and self.least == 0:
            self.begins = SupportPlane.under(body, -self.look_o).height
        self.of_parts = self.within is not None or bool(self.forbidden)
        self.wanted_fingers = wishes.least_fingers or min(FINGERS, available)
        if self.fingers is not None and wishes.least_fingers is None:
            self.wanted_fingers = available

    # -- in the seeds

    def choose(self, pairs: Pairs, reach: float) -> Pairs:
        """The pairs of surfaces that may be held so by fingers of a ``reach`` [m]; all of them where none may."""
        ends = pairs.ends_o
        fits = np.ones(len(pairs.widths), dtype=bool)
        for _, region in self.forbidden:
            fits &= (region.outside(ends[0]) > 0) & (region.outside(ends[1]) > 0)
        if self.touching:
            fits &= np.any([(region.outside(end) == 0) for _, region in self.touching for end in ends], axis=0)
        if self.look_o is not None:  # the hand looks across the line between its fingertips
            along = np.clip(np.abs(pairs.axes_o @ self.look_o), 0.0, 1.0)
            fits &= (np.arcsin(along) <= self.most) & (np.pi - np.arcsin(along) >= self.least)
            if self.begins is not None:
                fits &= pairs.middles_o @ self.look_o - reach <= self.begins
        pairs = pairs.select(fits) if fits.any() else pairs
        if not self.wishes.edges and len(pairs.widths):
            inward = (pairs.axes_o, -pairs.axes_o)
            near = [turns_nearby(self.body, end, axes, _OFF_EDGES) for end, axes in zip(pairs.ends_o, inward)]
            far = ~(near[0] | near[1])
            pairs = pairs.select(far) if far.any() else pairs
        return pairs

    def draw_turn(self, frames: Array, rng: np.random.Generator) -> int:
        """Which of the frames (m, 3, 3), whose third columns a hand may look along, is taken."""
        off = self._measure_approach(frames[:, :, 2])
        return int(rng.choice(np.flatnonzero(off <= off.min() + 1e-9)))

    def limit_depth(self, middle_o: Array, out_o: Array, depth: float) -> float:
        """How far towards its palm a hand that looks along ``out_o`` may have what is in the middle of its fingertips
        [m], which are ``depth`` from where its fingers start; below 0: not even at their tips.
        """
        if self.begins is None or self.look_o is None:
            return np.inf
        along = max(float(out_o @ self.look_o), 1e-3)
        return depth - (float(middle_o @ self.look_o) - self.begins) / along

    def _measure_approach(self, looks_o: Array) -> Array:
        """By how much directions (m, 3) that a hand looks along are off the wished approach (m,) [rad]."""
        if self.look_o is None:
            return np.zeros(len(looks_o))
        angles = np.arccos(np.clip(looks_o @ self.look_o, -1.0, 1.0))
        return np.asarray(np.maximum(0.0, np.maximum(self.least - angles, angles - self.most)))

    # -- of what came of it

    def misses(self, closure: Closure, look_o: Array) -> Iterator[Miss]:
        """The wishes that a closed hand, which looks along ``look_o`` (3,), does not meet, but for room."""
        touching = {touch.finger for touch in closure.touches} - {""}
        fingers = touching - {PALM}
        yield from self._misses_of_fingers(touching, fingers)
        back = np.linalg.inv(np.array(closure.pushed)) if not np.array_equal(closure.pushed, np.eye(4)) else None
        patches = [(touch.finger, _move_back(touch.patch_o, back)) for touch in closure.touches]
        if self.within is not None:
            outside = _find_largest((finger, float(self.within.outside(patch).max())) for finger, patch in patches)
            if outside:
                worst = max(outside.values())
                yield Miss(
                    wish="within",
                    by=worst / self.radius,
                    description=f"touches up to {1e3 * worst:.3g} mm outside",
                    fingers=tuple(outside),
                )
        for name, region in self.forbidden:
            inside = _find_largest((finger, _inside(region, patch)) for finger, patch in patches)
            if inside:
                by = max(inside.values())
                description = f"touches {name}, {1e3 * by:.3g} mm from where it ends"
                yield Miss(wish="forbidden", by=by / self.radius, description=description, fingers=tuple(inside))
        for name, region in self.touching:
            distances = [float(region.outside(patch).min()) for finger, patch in patches if finger in fingers]
            away = min(distances, default=self.radius)
            if away > 0:
                yield Miss(wish="touching", by=away / self.radius, description=f"{1e3 * away:.3g} mm away from {name}")
        off = float(self._measure_approach((look_o if back is None else back[:3, :3] @ look_o)[None])[0])
        if off > 1e-6:
            description = f"comes from {np.degrees(off):.0f} deg beyond what was asked for"
            yield Miss(wish="approach", by=off / np.pi, description=description)
        elif self.begins is not None and self.look_o is not None:
            start = _find_start(closure.hand, closure.q)
            start = start if back is None else _move_back(start[None], back)[0]
            beside = float(start @ self.look_o) - self.begins
            if beside > _BESIDE:
                description = f"has its palm beside the object: its fingers start {1e3 * beside:.3g} mm along it"
                yield Miss(wish="approach", by=beside / self.radius, description=description)
        if touching and not self.wishes.edges and (sharp := on_edges(closure.object, closure.contacts())).any():
            description = f"has {sharp.sum()} of {len(sharp)} contacts on edges"
            yield Miss(wish="edges", by=float(sharp.mean()), description=description)

    def _misses_of_fingers(self, touching: set[str], fingers: set[str]) -> Iterator[Miss]:
        wishes = self.wishes
        if self.fingers is not None and (others := fingers - set(self.fingers)):
            yield Miss(
                wish="fingers", by=1.0, description=f"is by {_list(sorted(fingers))}", fingers=tuple(sorted(others))
            )
        if wishes.least_fingers is not None and len(fingers) < wishes.least_fingers:
            description = f"{len(fingers)} of {wishes.least_fingers} fingers reach it"
            yield Miss(wish="least_fingers", by=float(wishes.least_fingers - len(fingers)), description=description)
        if wishes.palm is not None and (PALM in touching) is not wishes.palm:
            description = "the palm does not reach it" if wishes.palm else "the palm touches it"
            yield Miss(wish="palm", by=1.0, description=description)

    def misses_of_room(self, room: float) -> Iterator[Miss]:
        """The same of the room about the object in the open hand [m]."""
        if room < self.wishes.opening:
            description = f"the open hand leaves {1e3 * room:.3g} mm"
            yield Miss(wish="opening", by=(self.wishes.opening - room) / self.radius, description=description)

    def describe_parts(self) -> str:
        """How large the parts are that are asked for, how wide the openings at them, and how thick the fingers."""
        regions = [*([("the part", self.within)] if self.within is not None else []), *self.touching]
        told, gaps = [], []
        for name, region in regions:
            size = " x ".join(f"{1e3 * one:.3g}" for one in region.upper - region.lower)
            gap = find_gap(self.body, region, np.random.default_rng(0))
            gaps += [gap] if gap > _SLIT else []
            told.append(f"{name}: {size} mm" + (f", with an opening of {1e3 * gap:.2g} mm" if gap > _SLIT else ""))
        if gaps:
            thick = measure_thickness(self.hand)
            taking = [thick[name] for name in self.fingers or thick]
            least, most = (f"{1e3 * one:.2g}" for one in (min(taking), max(taking)))
            told.append(f"the fingers are {least if least == most else f'{least} to {most}'} mm thick")
        return f" ({'; '.join(told)})"


def find_fingers(hand: HandModel, names: Sequence[str]) -> tuple[str, ...]:
    """The hand's own names of fingers, for names in any case, where little and pinky are the same.

    Raises:
        InvalidInput: no such finger, or one that a motor moves together with others.
    """
    known = {finger.name.lower(): finger.name for finger in hand.fingers}
    found: list[str] = []
    for name in names:
        low = name.strip().lower()
        one = known.get(low) or known.get(_SAME_FINGER.get(low, ""))
        if one is None:
            near = difflib.get_close_matches(low, known, n=1)
            hint = f"; did you mean '{known[near[0]]}'?" if near else ""
            raise InvalidInput(
                f"fingers: '{printable(name, 60)}' is {_NO_FINGER}, which has {_list(known.values())}{hint}"
            )
        found.append(one)
    free = [finger for finger in hand.fingers if finger.name not in found]
    moving = {i for finger in hand.fingers if finger.name in found for i in finger.dofs.tolist()}
    if together := [finger.name for finger in free if moving & set(finger.dofs.tolist())]:
        raise InvalidInput(
            f"fingers: {_list(found)} cannot close alone: the same motor moves {_list(together)}: name these, too"
        )
    return tuple(dict.fromkeys(found))


def _find_start(hand: HandModel, q: Array) -> Array:
    """Where the fingers' chains part (3,), the mean of their first joints, in the world [m]."""
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, np.array(q))
    return np.asarray(np.mean([data.oMi[finger.joint_ids[0]].translation for finger in hand.fingers], axis=0))


def _cone(approach: Side | Approach | None, body: Body, gravity_o: ArrayLike) -> tuple[Array | None, float, float]:
    """A direction (3,) in the world, and the least and the largest angle to it [rad]."""
    if approach is None:
        return None, 0.0, np.pi
    if isinstance(approach, Approach):
        turn = np.array(body.pose)[:3, :3] if approach.frame == "object" else np.eye(3)
        return turn @ approach.direction, 0.0, approach.cone
    down = array_of("gravity", gravity_o, (3,))
    if not down.any():
        raise InvalidInput(f"approach: '{approach}' needs gravity: give a direction, Approach(direction=...)")
    low, high = np.radians(_SIDES[approach])
    return down / np.linalg.norm(down), max(0.0, low - _CONE), min(np.pi, high + _CONE)


def _region(part: str | ArrayLike, body: Body) -> Region:
    if isinstance(part, str):
        if part not in body.regions:
            has = f"which has {_list(body.regions)}" if body.regions else "whose file names none: give a box"
            raise InvalidInput(f"'{printable(part, 60)}' is no part of this object, {has}")
        box = body.regions[part]
    else:
        box = np.asarray(part, dtype=float)
    # No further than the object may reach: points are drawn inside.
    com, radius = body.com_b, body.bounding_radius
    lower, upper = (np.clip(corner, com - radius, com + radius) for corner in box)
    return Region(lower=lower, upper=upper, pose=body.pose)


def _inside(region: Region, points: Array) -> float:
    """How deep the deepest of some points (p, 3) is inside [m]; 0: none is."""
    local = (points - region.pose[:3, 3]) @ region.pose[:3, :3]
    depth: Array = np.minimum(local - region.lower, region.upper - local).min(axis=1)
    return max(0.0, float(depth.max()))


def _move_back(points: Array, back: Array | None) -> Array:
    """Points (p, 3) that a pushed object carried along, back where it was."""
    return points if back is None else points @ back[:3, :3].T + back[:3, 3]


def _find_largest(pairs: Iterator[tuple[str, float]]) -> dict[str, float]:
    """The largest positive value by name."""
    found: dict[str, float] = {}
    for name, value in pairs:
        if value > 0:
            found[name] = max(value, found.get(name, 0.0))
    return found


def _name_part(part: str | ArrayLike) -> str:
    return f"'{part}'" if isinstance(part, str) else "the given box"


def _list(names: Iterable[str]) -> str:
    return ", ".join(printable(name, 60) for name in names)
