"""Closing a hand on an object: the first touch of every link, found by continuous collision detection.

All joints follow a path from an open to a closed posture. The distance of a link's geometry to the object shrinks at
most at the speed of the link's fastest point, which the joints' rates and the link's reach bound; so the path can be
followed in steps that no touch is missed in (conservative advancement, Mirtich 1996; distances by coal). What touches
stops every joint that would press it on; the joints beyond it go on, until none moves. A finger whose joints move
together often touches with its tip first, which stops them all; joint after joint from base to tip it wraps round the
object.

Jaws that share an actuator cannot stop one by one. With them the object is not held still: jaws that go on push it
along their normals, without friction, until it is caged between them or until friction would jam it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, flag, frozen, instance_of, items_of, mapping_of, number, read_only
from pinograsp.contacts.advance import TOUCH, Approach, PreparedClosing
from pinograsp.contacts.clearance import Distances, HandPart, check_geometry
from pinograsp.contacts.closure import ClosingPath, Closure, Touch
from pinograsp.contacts.penetration import find_normal
from pinograsp.contacts.pushing import CAGED, PushWay, push_object
from pinograsp.contacts.synergy import open_and_closed
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, BoolArray
from pinograsp.words import format_fixed

Posture: TypeAlias = Mapping[str, ArrayLike] | ArrayLike  # {finger: angles (n_f,)} or q (n,)

_OPEN = 1e-9  # [m] an overlap beyond rounding: the hand cannot start there
_MOST_STEPS = 50_000  # of one closing, which takes some hundreds


def close_hand(
    hand: HandModel,
    body: Body,
    *,
    start: Posture | None = None,
    target: Posture | None = None,
    palm: bool = True,
    fingers: Sequence[str] | None = None,
    wrap: bool = False,
    fixed: bool = False,
    friction: float = 0.5,
    prepared: PreparedClosing | None = None,
) -> Closure:
    """Close ``hand`` on ``body`` until nothing moves any more.

    All joints move from ``start`` to ``target`` by the same share of their ways (the paper's Table IV), or one after
    the other. A link that touches stops the joints that carry it; joints beyond it continue. Coupled joints stop
    together.

    Args:
        hand: placed in the world.
        body: a shape of :mod:`pinograsp.objects`; it does not move unless fingers that share an actuator push it.
        start: open posture, ``{finger: angles (n_f,)}`` [rad] (others at their default) or q (n,). Default: the
            synergy of :func:`open_and_closed`, which works for any hand; joints of no finger stay at ``hand.posture``.
        target: closed posture, in the same form.
        palm: whether the links that do not move can touch the object.
        fingers: names of the fingers that close; default: all. The others stay at ``start``.
        wrap: close joint after joint, from base to tip, for power grasps, so that every link can touch.
        fixed: keep the object still even if fingers share an actuator: the first of them that touches then stops all.
        friction: coefficient at which an object that such fingers push jams between them, so that they push it no
            further [-]. Not used with ``fixed``.
        prepared: what all closings of this hand on this object share, wherever the two are; it decides about ``palm``.
            None: it is computed, which takes milliseconds.

    Raises:
        InvalidInput: the hand overlaps the object at the start (it says where and how deep), or has no geometry.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> closure = pg.close_hand(hand, pg.Sphere(radius=0.02, mass=0.1).placed(up))
        >>> print(closure.contacts().names)
        ('left', 'right')

    See Also:
        :func:`~pinograsp.contacts.contacts_at` for contact points that are known;
        :func:`~pinograsp.planner.plan_grasp_on`.
    """
    check_geometry(hand)
    instance_of("body", body, Body)
    for name, value in (("palm", palm), ("wrap", wrap), ("fixed", fixed)):
        flag(name, value)
    friction = number("friction", friction, at_least=0)
    synergy = open_and_closed(hand, body) if start is None or target is None else (hand.resting, hand.resting)
    opened = _posture(hand, "start", start, synergy[0])
    closed = _posture(hand, "target", target, synergy[1])
    if fingers is not None:
        moving = {int(i) for name in items_of("fingers", fingers, str) for i in hand.finger(name).dofs}
        closed = np.where(np.isin(np.arange(hand.n), sorted(moving)), closed, opened)
    beyond = [
        joint
        for joint, q, low, high in zip(hand.joint_names, opened, hand.lower, hand.upper)
        if not low - 1e-9 <= q <= high + 1e-9
    ]
    if beyond:
        raise InvalidInput(f"start: expected angles within the joint limits, {', '.join(beyond)} is not")
    if prepared is None:
        prepared = PreparedClosing(hand, body, palm=palm)
    closing = Closing(hand, body, opened, closed, prepared, wrap)
    closing.approach()
    if not fixed:
        closing.push(friction)
    return closing.result()


def _posture(hand: HandModel, name: str, given: Posture | None, default: Array) -> Array:
    if given is None:
        return np.array(default)
    if not isinstance(given, Mapping):
        return np.array(array_of(name, given, (hand.n,)))
    q = np.array(default)
    for finger, angles in mapping_of(name, given, "{finger: joint angles} or joint positions").items():
        chain = hand.finger(finger)
        q[chain.dofs] = array_of(f"{name} of '{finger}'", angles, (chain.n,))
    return q


class Meeting(NamedTuple):
    """A part that touches: with which gap [m], at which of its points (3,) when it did, and where on the path."""

    part: HandPart
    gap: float
    point: Array
    at: float


class Closing:
    """The state of a hand that closes: posture, joints that still move, what touches.

    Attributes:
        met: what touches, in that order.
    """

    def __init__(
        self, hand: HandModel, body: Body, start: Array, target: Array, prepared: PreparedClosing, wrap: bool = False
    ):
        self.hand, self.body, self.start, self.target, self.names = hand, body, start, target, hand.joint_names
        self.prepared, self.parts, self.distances = prepared, prepared.parts_at(hand), Distances(hand, body)
        self.way = Approach(prepared, hand, body)
        self.q, self.at = start.copy(), 0.0
        way = target - start
        self.tops = np.where(way > 0, hand.upper, hand.lower)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(way == 0, 0.0, np.minimum(1.0, (self.tops - start) / way))
        self.last = start + share * way
        # Wrapping: each joint has its part of the path, the one nearest to the base the first.
        turn, turns = np.zeros(hand.n), 1
        for finger in hand.fingers if wrap else ():
            turn[finger.dofs] = np.maximum(turn[finger.dofs], np.arange(finger.n))
            turns = max(turns, finger.n)
        self.begins, self.rate, self.ends = turn / turns, turns * way, (turn + share) / turns
        self.free = way != 0  # joints that have not been stopped
        self.met: list[Meeting] = []
        self.stops: dict[str, str] = {}
        self.events = [(0.0, start.copy())]
        self.given = body
        self.at_touch: dict[str, Array] = {}
        users = [sum(i in finger.dofs for finger in hand.fingers) for i in range(hand.n)]
        # Actuators that several fingers share, or the only finger's, which has the palm to press against.
        self.shared = {i for i, n in enumerate(users) if n > 1 or len(hand.fingers) == 1}

    @property
    def moving(self) -> BoolArray:
        """Which joints move now (n,)."""
        moving: BoolArray = self.free & (self.begins <= self.at + 1e-12)
        return moving

    @property
    def touched(self) -> set[str]:
        """Names of the links that touch."""
        return {one.part.link for one in self.met}

    @property
    def touching(self) -> set[str]:
        """Names of the fingers that touch, "palm" among them, and "" for links of none."""
        return {one.part.finger for one in self.met}

    def approach(self) -> None:
        """Follow the path with the object held still."""
        self.distances.put(self.q)
        for i, part in enumerate(self.parts):
            gap = self.distances.bound(part)
            self.way.note(i, gap, 0.0, self.distances.data)
            if gap.distance < -(_OPEN if part.joint else 1e-6):
                raise InvalidInput(
                    f"start: '{part.link}' of hand '{self.hand.name}' overlaps the object by "
                    f"{-1e3 * gap.distance:.3g} mm: open the hand further, or move one of them"
                )
            near = gap.distance <= (TOUCH if part.joint else 1e-6)
            if near and gap.point is not None and part.link not in self.touched:
                self.touch(part, gap.distance, gap.point)
        first = steps = 0
        way, before, rate = self.way, np.zeros(0, dtype=bool), np.zeros(0)
        while self.free.any():
            steps += 1
            if steps > _MOST_STEPS:
                raise InvalidInput(
                    f"hand '{self.hand.name}': closing takes more than {_MOST_STEPS} steps, for "
                    f"'{self.parts[first].link}' stays close to the object for too long, or reaches very far: move "
                    "the object a little, or check the sizes of the hand"
                )
            moving = self.moving
            if not moving.any():  # the next ones' turn
                self.at = float(self.begins[self.free].min())
                continue
            if not np.array_equal(moving, before):
                before, rate = moving, np.where(moving, self.rate, 0.0)
                way.depart(self.at, rate)
            # To the nearest event that could happen: a touch, or a joint's end.
            ends = float(min([*self.ends[moving], *self.begins[self.free & ~moving]]))
            at, made = way.pursue(self.q, rate, self.at, ends, _MOST_STEPS - steps)
            steps += made
            self.q, self.at = self.q + (at - self.at) * rate, at
            first = int(np.argmin(way.stops))
            touch = max(float(way.stops[first]), at)
            if at == ends or (self.advance(min(touch, ends) - at) and ends <= touch):
                self.end_joints()

    def advance(self, step: float) -> bool:
        """Go on by a step, or less: to where a part touches first, which is noted. Whether the whole step was made."""
        rate, q, at, way = np.where(self.moving, self.rate, 0.0), self.q.copy(), self.at, self.way
        near = way.due(at + step)
        clear, hit = 0.0, np.inf  # lengths of a step after which nothing overlaps, and something does
        above, below = np.nan, 0.0  # the least gaps there
        length, halve = step, False
        while True:
            self.q, self.at = q + length * rate, at + length
            self.distances.put(self.q, rate=rate)
            found = {i: self.distances.bound(self.parts[i]) for i in near}
            least = min((gap.distance for gap in found.values()), default=np.inf)
            if (least > TOUCH and hit == np.inf) or abs(least) <= TOUCH or length == hit:
                break
            if least > 0:
                clear, above = length, least
            else:
                hit, below = length, least
            # Where a distance jumps, as coal's of meshes can, there is nothing between clear and hit: every other time
            # the middle is tried.
            if np.isnan(above):
                above = float(way.room(at)[near].min())
            over = above - 0.5 * TOUCH  # rather above zero than below
            share = 0.5 if halve or not over > 0 else min(max(over / (above - below), 0.02), 0.98)
            length = hit if (hit - clear) * way.speed.max() < 0.1 * TOUCH else clear + share * (hit - clear)
            halve = not halve
        for i, gap in found.items():
            way.note(i, gap, self.at, self.distances.data)
        if least <= TOUCH:
            for i in sorted(found, key=lambda i: found[i].distance):
                part, gap = self.parts[i], found[i]
                if gap.distance <= 2 * TOUCH and gap.point is not None and part.link not in self.touched:
                    self.touch(part, gap.distance, gap.point)
        return length == step

    def end_joints(self) -> None:
        """Stop the joints that are at the end of their path or at their limit."""
        for i in np.flatnonzero(self.moving & (self.ends <= self.at + 1e-12)).tolist():
            self.free[i] = False
            self.q[i] = self.last[i]
            self.note_end(i)
        self.events.append((self.at, self.q.copy()))

    def note_end(self, i: int) -> None:
        """Note that joint i is at the end of its path, which may be its limit."""
        at_limit = abs(self.q[i] - self.tops[i]) <= 1e-9
        self.stops[self.names[i]] = "joint limit" if at_limit else "end of path"

    def touch(self, part: HandPart, gap: float, point: Array) -> None:
        """Note a touch and stop the joints that carry the part."""
        self.met.append(Meeting(part, float(gap), point, float(self.at)))
        self.at_touch[part.finger] = self.q.copy()
        for i in np.flatnonzero((part.reach > 0) & self.free):
            self.free[i] = False
            self.stops[self.names[i]] = f"touch of {part.link}"
        self.events.append((self.at, self.q.copy()))

    def push(self, friction: float) -> None:
        """Go on with actuators that several fingers share, the object yielding, until it is caged or jammed."""
        stopped = {name for name, reason in self.stops.items() if reason.startswith("touch")}
        shared = np.array([i in self.shared and name in stopped for i, name in enumerate(self.names)])
        if not shared.any():
            return
        which = [
            i
            for i, part in enumerate(self.parts)
            if not part.joint or (part.reach[shared] > 0).any() or part.link in self.touched
        ]
        parts = [self.parts[i] for i in which]
        speeds = np.array([float(np.abs(self.rate[shared]) @ part.reach[shared]) for part in parts])
        way = PushWay(self.q, self.at, self.rate, np.where(shared, self.last, self.q), parts, speeds)
        compiled = self.prepared.pushing
        if compiled is None:
            q, at, body = push_object(self.distances, way, self.body, friction)
        else:
            q, at, body = compiled.push(way, self.hand, self.body, which, friction)
        self.distances.put(q, body)
        found = [(*self.distances.of(part), part) for part in parts]
        if len({part.finger for gap, _, part in found if gap <= CAGED}) < 2:
            return  # nothing to hold it against: it was only pushed away, so it is left where it was first touched
        self.q, self.at, self.met, self.body = q, at, [], body
        # One jaw may stay a micrometre away while the others cage the object.
        for gap, point, part in sorted(found, key=lambda one: one[0]):
            if gap <= CAGED and part.link not in self.touched:
                self.touch(part, gap, point)
        for i in np.flatnonzero(shared & (np.abs(self.last - q) <= 1e-12)).tolist():
            self.note_end(i)
        self.events.append((at, q.copy()))

    def find_posture(self) -> Array:
        """Where the hand ends (n,): fingers that found nothing to touch are where they started, out of the others'
        way.
        """
        q, touching = self.q.copy(), self.touching
        # What went on beyond a finger's last touch without meeting anything goes back to where it was then.
        for finger in self.hand.fingers:
            last = self.at_touch.get(finger.name)
            if last is None:
                continue
            for i in finger.dofs.tolist():
                if not self.stops.get(self.names[i], "").startswith("touch") and i not in self.shared:
                    q[i] = last[i]
        busy = {int(i) for finger in self.hand.fingers if finger.name in touching for i in finger.dofs}
        for finger in self.hand.fingers:
            if finger.name not in touching:
                away = [i for i in finger.dofs if int(i) not in busy]
                q[away] = self.start[away]
        return q

    def result(self) -> Closure:
        """The record."""
        self.distances.put(self.q, self.body)  # what touches has been there since it did
        touches = tuple(map(self._describe, self.met))
        self.events.append((max(self.at, self.events[-1][0]), self.q.copy()))
        q, touching = self.find_posture(), self.touching
        notes = [f"'{touch.link}' touches, but belongs to no finger" for touch in touches if not touch.finger]
        if idle := [finger for finger in self.hand.fingers if finger.name not in touching]:
            notes.append(f"without contact and therefore left open: {', '.join(finger.name for finger in idle)}")
        pushed = np.eye(4)
        if self.body is not self.given:
            pushed = np.array(self.body.pose) @ np.linalg.inv(self.given.pose)
            moved = ", ".join(format_fixed(1e3 * v, 2) for v in self.body.com_o - self.given.com_o)
            turned = np.degrees(np.linalg.norm(pin.log3(pushed[:3, :3])))
            notes.append(
                f"the object was pushed by ({moved}) mm and turned by {turned:.2f} deg by fingers that cannot stop "
                "individually"
            )
        return Closure(
            hand=self.hand,
            object=self.body,
            q=read_only(q),
            start=read_only(self.start),
            target=read_only(self.target),
            touches=touches,
            stops=self.stops,
            path=ClosingPath(
                shares=frozen(np.array([share for share, _ in self.events])),
                postures=frozen(np.array([posture for _, posture in self.events])),
            ),
            self_collisions=self.prepared.collisions.between(self.start, q),
            pushed=read_only(pushed),
            notes=tuple(notes),
        )

    def _describe(self, met: Meeting) -> Touch:
        """Where and how a part touches, at the posture that distances are taken at."""
        part, point = met.part, met.point
        surface, own = self.distances.surface(point)
        normal, sharp = find_normal(self.distances, part, point, own)
        patch = self.distances.patch(part, point, normal)
        if len(patch) > 1:
            point = patch.mean(axis=0)
            surface, _ = self.distances.surface(point)
        local = self.distances.data.oMi[part.joint].actInv(point)
        return Touch(
            finger=part.finger,
            link=part.link,
            joint_id=part.joint,
            at=met.at,
            point_o=read_only(surface),
            normal_o=read_only(normal),
            gap=met.gap,
            point_l=read_only(local),
            length=float(np.linalg.norm(local)),
            patch_o=read_only(patch),
            sharp=sharp,
        )
