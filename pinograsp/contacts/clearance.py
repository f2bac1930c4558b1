"""Where a hand's collision geometry is, and how far from an object or from itself (distances by the core, or coal)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp import core
from pinograsp.checks import array_of, instance_of
from pinograsp.contacts.compiled import compiled_object, compiled_shape
from pinograsp.contacts.contact_set import ContactSet
from pinograsp.errors import GeometryFailed, InvalidInput
from pinograsp.hands import HandModel
from pinograsp.hands.geometry import solid_of
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import FARTHEST, Array, BoolArray, move_about, pose_of

PALM = "palm"
_FAILED = 10 * FARTHEST  # [m] no hand is as far from its object: coal failed
_OFF = 1e-4  # [m] largest error of coal's depth of an overlap
_CLEAR = 1e-4  # [m] where the hull is farther off than this, the part's own distance is not needed
_TILT = 1e-3  # [rad] tilt that separates the corners of a flat contact
_MOST_SHAPES = 500
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3))).T  # of a box (3, 8)
HOLLOW = 1e-3  # [m] between a link and its convex hull: worth a warning
_POINT = coal.Sphere(1e-7)
_PATCH = 1e-3  # [m] corners nearer to each other are one: curved bodies of up to a metre's radius touch at a point


class HandPart:
    """One collision geometry of the hand: where it is, and how fast it can come closer."""

    def __init__(self, hand: HandModel, one: pin.GeometryObject, names: dict[int, tuple[str, str]]):
        model = hand.model
        self.geometry, self.joint, self.placement = one.geometry, one.parentJoint, one.placement
        # What is fixed to a finger's link is part of it.
        own = model.frames[one.parentFrame].name
        self.finger, self.link = (PALM, hand.palm) if not one.parentJoint else names.get(one.parentJoint, ("", own))
        one.geometry.computeLocalAABB()
        self.hand = hand
        # A ball and a box around it: their centre in the joint's frame (3,), the radius, half of the edges (3,) [m].
        self.centre: Array = one.placement.act(np.array(one.geometry.aabb_center))
        self.radius = float(one.geometry.aabb_radius)
        self.half: Array = 0.5 * (one.geometry.aabb_local.max_ - one.geometry.aabb_local.min_)
        # A mesh's convex hull; where there is none, the geometry itself.
        self.hull = solid_of(self.geometry)

    def transform(self, move: pin.SE3) -> HandPart:
        """The same part of the palm after a motion of the hand."""
        part = copy(self)
        part.placement, part.centre = move * self.placement, move.act(self.centre)
        part.__dict__.pop("corners", None)
        return part

    @cached_property
    def compiled(self) -> Any:
        """The core's shape of it; None where the core is not installed, or knows none."""
        return compiled_shape(self.geometry) if core.is_installed() else None

    @cached_property
    def compiled_hull(self) -> Any:
        """The core's shape of its convex hull; None likewise."""
        if self.hull is self.geometry:
            return self.compiled
        return compiled_shape(self.hull) if core.is_installed() else None

    @property
    def reach(self) -> Array:
        """Bound of the speed of any of its points per unit rate of each actuated joint (n,)."""
        return self.rates[0]

    @cached_property
    def rates(self) -> tuple[Array, Array, Array]:
        """``reach``, bounds of its angular speed (n,), 0 for joints that slide, and what of ``reach`` these make."""
        hand, model = self.hand, self.hand.model
        reach = float(np.linalg.norm(self.centre)) + self.radius
        speeds, turning, sliding = np.zeros((3, hand.n))
        lower, upper = hand.lower, hand.upper
        j = self.joint
        while j:
            i, ratio = model.joints[j].idx_v, abs(hand.ratio(j))
            if hand.is_prismatic(j):
                speeds[i] += ratio
                sliding[i] += ratio
                reach += ratio * max(abs(lower[i]), abs(upper[i]))
            else:
                speeds[i] += ratio * reach
                turning[i] += ratio
            reach += float(np.linalg.norm(model.jointPlacements[j].translation))
            j = model.parents[j]
        return speeds, turning, sliding

    @cached_property
    def corners(self) -> Array:
        """Of the box around it (8, 3), in the joint's frame [m]."""
        corners: Array = self.centre + (self.placement.rotation @ (self.half[:, None] * _CORNERS)).T
        return corners


def parts_of(hand: HandModel) -> list[HandPart]:
    """All parts of a hand, by finger and link; what several fingers share belongs to the first."""
    names = {
        joint: (finger.name, link)
        for finger in reversed(hand.fingers)
        for joint, link in zip(finger.joint_ids, finger.links)
    }
    return [HandPart(hand, one, names) for one in hand.geometry.geometryObjects]


class Gap(NamedTuple):
    """What is known of a part's distance from the object.

    Attributes:
        distance: signed [m], or less than that.
        point: the part's nearest point (3,) in the world; None where ``distance`` is only less.
        normal: unit direction (3,) from the part to the object, along their least distance.
        parted: whether a plane across the normal has the part on one side and the object on the other, ``distance``
            apart.
    """

    distance: float
    point: Array | None
    normal: Array
    parted: bool


class _Clear(NamedTuple):
    """A part that is clear of the object: the distance [m], its nearest point (3,) in the world, and the unit direction
    (3,) from there to the object.
    """

    distance: float
    point: Array
    normal: Array


class Distances:
    """Signed distances of the hand's geometry to an object at a posture."""

    def __init__(self, hand: HandModel, body: Body):
        away = float(np.linalg.norm(body.com_o - hand.pose[:3, 3])) + body.bounding_radius
        if not away <= FARTHEST:
            raise InvalidInput(
                f"object: expected one within {FARTHEST:g} m of the hand's root, got one that reaches to {away:.3g} "
                "m: are the units right?"
            )
        self.model, self.data = hand.model, hand.model.createData()
        self.body, self.shape = body, body.collision_geometry
        self.hull = solid_of(self.shape)
        self.request, self.plain, self.result = coal.DistanceRequest(), coal.DistanceRequest(), coal.DistanceResult()
        self.request.enable_signed_distance = self.plain.enable_signed_distance = True
        self.request.gjk_tolerance = 1e-12
        self.request.gjk_max_iterations = 1000
        self.request.epa_tolerance = 1e-9
        self.put(np.clip(hand.resting, hand.lower, hand.upper), body)

    @cached_property
    def compiled(self) -> Any:
        """The core's shape of the object; None where the core is not installed, or knows none."""
        return compiled_object(self.body) if core.is_installed() else None

    @cached_property
    def compiled_hull(self) -> Any:
        """The core's shape of the object's convex hull; None likewise."""
        if self.hull is self.shape:
            return self.compiled
        return compiled_shape(self.hull) if core.is_installed() else None

    def put(self, q: Array, body: Body | None = None, *, rate: Array | None = None) -> None:
        """Move the hand to the posture q (n,), at joint rates (n,) where velocities are asked for; with ``body``, the
        object to where that, the same solid, is.
        """
        pin.forwardKinematics(self.model, self.data, q, *(() if rate is None else (rate,)))
        if body is not None:
            self.put_object(body)

    def put_object(self, body: Body) -> None:
        """Move the object to where ``body``, the same solid, is."""
        self.body = body
        self._place(np.array(body.shape_pose))

    def move_object(self, shift: Array, turn: Array) -> None:
        """Take the distances to the object turned by ``turn`` (3, 3) about its centre of mass and moved by ``shift``
        (3,), world's axes, from where :attr:`body` is.
        """
        self._place(move_about(self.body.shape_pose, self.body.com_o, shift, turn))

    def _place(self, pose: Array) -> None:
        self.place, self.pose = pose, _coal_pose(pose)

    def of(self, part: HandPart) -> tuple[float, Array]:
        """Distance [m] and the part's nearest point (3,) in the world."""
        if (clear := self._find_clear(part, part.compiled, self.compiled)) is not None:
            return clear.distance, clear.point
        return self._by_coal(part)

    def _by_coal(self, part: HandPart) -> tuple[float, Array]:
        least = -np.inf if part.hull is part.geometry else self.rough(part) - _OFF
        return self.at(part, self.pose, part.geometry, least)

    def rough(self, part: HandPart) -> float:
        """Distance of the part's convex hull [m]: quick, and not more than the part's own."""
        if (clear := self._find_clear(part, part.compiled_hull, self.compiled)) is not None:
            return clear.distance
        return self.at(part, self.pose, part.hull)[0]

    def _find_clear(self, part: HandPart, shape: Any, other: Any, place: Array | None = None) -> _Clear | None:
        """By the core, the distance of a part's ``shape`` from the object's, ``other``, at ``place`` (4, 4) or where it
        is; None where they overlap, or it does not know one of them.
        """
        if shape is None or other is None:
            return None
        at = (self.data.oMi[part.joint] * part.placement).homogeneous
        found = shape.gap_to(at, other, self.place if place is None else place)
        return None if found is None else _Clear(found[0], np.array(found[1]), np.array(found[2]))

    def bound(self, part: HandPart) -> Gap:
        """As :meth:`of`; where the convex hulls are clear of each other, their distance and no point."""
        convex = part.hull is part.geometry and self.hull is self.shape
        if not convex:
            gap, normal = self._between_hulls(part)
            if _CLEAR < gap < _FAILED:  # where coal fails the shape itself is asked
                return Gap(gap, None, normal, True)
        if (clear := self._find_clear(part, part.compiled, self.compiled)) is not None:
            return Gap(*clear, convex)
        gap, point = self._by_coal(part)
        return Gap(gap, point, np.array(self.result.normal), convex and gap > 0.0)

    def _between_hulls(self, part: HandPart) -> tuple[float, Array]:
        """Distance of the convex hulls of a part and the object [m], and its direction (3,)."""
        if (clear := self._find_clear(part, part.compiled_hull, self.compiled_hull)) is not None:
            return clear.distance, clear.normal
        gap = self.measure(part.hull, self.locate(part), self.hull, self.pose)
        return gap, np.array(self.result.normal)

    def measure(
        self,
        geometry: coal.CollisionGeometry,
        pose: coal.Transform3s,
        shape: coal.CollisionGeometry,
        object_pose: coal.Transform3s,
    ) -> float:
        """Signed distance of two shapes [m]: at a coarser tolerance where coal fails at its finest."""
        distance = -np.inf
        for request in (self.request, self.plain):
            self.result.clear()
            distance = coal.distance(geometry, pose, shape, object_pose, request, self.result)
            if -_FAILED < distance < _FAILED:
                break
        return distance

    def at(
        self, part: HandPart, object_pose: coal.Transform3s, geometry: coal.CollisionGeometry, least: float = -np.inf
    ) -> tuple[float, Array]:
        """Distance and nearest point of a part's geometry, or its hull, from the object at another pose (coal's).

        What is below ``least`` [m] cannot be: coal takes some meshes that barely touch for deep inside.
        """
        return self.placed_at(part, self.locate(part), object_pose, geometry, least)

    def locate(self, part: HandPart) -> coal.Transform3s:
        """Where a part is in the world."""
        return locate_for_coal(self.data, part.joint, part.placement)

    def find_depth(self, part: HandPart, normal: Array, how: Array, rounds: int) -> tuple[float, Array, Array] | None:
        """Depth of a part in the object [m], inward normal (3,) and point on the object (3,), by the core, which
        begins along ``normal`` (3,); ``how``: as of its ``Shape.depth_in``. None: it knows no shape, or finds no way
        out.
        """
        if part.compiled is None or self.compiled is None:
            return None
        at = (self.data.oMi[part.joint] * part.placement).homogeneous
        found = part.compiled.depth_in(at, self.compiled, self.place, normal, how, rounds)
        return None if found is None else (found[0], np.array(found[1]), np.array(found[2]))

    def placed_at(
        self,
        part: HandPart,
        pose: coal.Transform3s,
        object_pose: coal.Transform3s,
        geometry: coal.CollisionGeometry,
        least: float = -np.inf,
    ) -> tuple[float, Array]:
        """As :meth:`at`, of a part whose own pose is known."""
        moved, least = object_pose, max(least, -_FAILED)
        for attempt in range(6):
            request = self.request if attempt % 2 == 0 else self.plain
            self.result.clear()
            distance: float = coal.distance(geometry, pose, self.shape, moved, request, self.result)
            point = np.array(self.result.getNearestPoint1())
            if least <= distance < _FAILED and math.isfinite(point @ point):
                return distance, point
            # At its finest tolerance coal can fail on slivers of a mesh: try a coarser one, then a tenth of a
            # micrometre aside.
            aside = object_pose.getTranslation() + 1e-7 * np.array([attempt, 1.0, -attempt])
            moved = coal.Transform3s(object_pose.getRotation(), aside)
        raise GeometryFailed(part.link, type(part.geometry).__name__)

    def near(self, parts: Sequence[HandPart], postures: Array) -> tuple[BoolArray, Array]:
        """Which parts (m, p) may touch the object at postures (m, n), and how far they move from one to the next.

        Those may touch whose boxes' spans reach the object's box. No point of a part moves further (m - 1, p) [m].
        """
        self.shape.computeLocalAABB()
        box, pose = self.shape.aabb_local, self.body.shape_pose
        joints = sorted({part.joint for part in parts})
        column = np.array([joints.index(part.joint) for part in parts], dtype=int)
        placed = np.empty((len(postures), len(joints), 4, 4))
        for i, q in enumerate(postures):
            pin.forwardKinematics(self.model, self.data, q)
            poses = self.data.oMi.tolist()
            placed[i] = [poses[joint].homogeneous for joint in joints]
        carried = placed[:, column]
        centres = np.array([part.centre for part in parts]).reshape(-1, 3)
        own = np.array([part.placement.rotation for part in parts]).reshape(-1, 3, 3)
        edges = own * np.array([part.half for part in parts]).reshape(-1, 1, 3)
        corners = carried[..., :3, :3] @ (centres[:, :, None] + edges @ _CORNERS) + carried[..., :3, 3:]  # (m, p, 3, 8)
        steps = np.diff(corners, axis=0)
        steps = np.sqrt((steps * steps).sum(axis=2).max(axis=2))
        inside = pose[:3, :3].T @ corners - (pose[:3, :3].T @ pose[:3, 3])[:, None]
        apart = np.maximum(box.min_ - inside.max(axis=3), inside.min(axis=3) - box.max_)
        near: BoolArray = apart.max(axis=2) <= _CLEAR
        return near, steps

    def surface(self, point: Array) -> tuple[Array, Array]:
        """The object's surface point nearest to a point (3,), and the inward normal there (3,)."""
        surface, normal, _ = self.body.project(point[None])
        return surface[0], normal[0]

    def patch(self, part: HandPart, point: Array, normal: Array) -> Array:
        """Corners (p, 3) of the area on which a part touches, one point where it is curved.

        Tilted a little about the point, flat bodies touch at one corner of their common area after the other.
        """
        x, y = tangents(normal[None])[0].T
        corners: list[Array] = []
        pose = np.array(self.body.shape_pose)
        # Askew, since along an edge any of its points is as near; two rounds, the second where the first found corners.
        for i, turn in enumerate(0.3 + np.array([0, 2, 4, 6, 1, 3, 5, 7]) * np.pi / 4):
            if i == 4 and len(corners) == 1 and np.linalg.norm(corners[0] - point) <= _PATCH:
                break
            tilt = pin.exp3(_TILT * (np.cos(turn) * x + np.sin(turn) * y))
            moved = pose_of(point + tilt @ (pose[:3, 3] - point) + 1e-4 * normal, tilt @ pose[:3, :3])
            clear = self._find_clear(part, part.compiled, self.compiled, moved)
            corner = self.at(part, _coal_pose(moved), part.geometry)[1] if clear is None else clear.point
            corner = corner - normal * (normal @ (corner - point))
            if all(np.linalg.norm(corner - other) > _PATCH for other in corners):
                corners.append(corner)
        if len(corners) > 1:  # the point itself lies anywhere on a flat area
            return np.array(corners)
        apart = np.linalg.norm(corners[0] - point) > _PATCH
        return np.array([point, *corners] if apart else [point])


def check_geometry(hand: HandModel) -> None:
    """Raise InvalidInput for a hand without collision geometry, or with too much of it to search in reasonable time."""
    instance_of("hand", hand, HandModel)
    if hand.geometry.ngeoms > _MOST_SHAPES:
        raise InvalidInput(
            f"hand '{hand.name}' has {hand.geometry.ngeoms} collision shapes, expected at most {_MOST_SHAPES}: "
            "give root= the hand's palm, or fewer shapes"
        )
    if not hand.geometry.ngeoms:
        raise InvalidInput(f"hand '{hand.name}' has no collision geometry: nothing can touch (see its notes)")
    solid = {one.parentJoint for one in hand.geometry.geometryObjects}
    if hand.fingers and all(solid.isdisjoint(finger.joint_ids) for finger in hand.fingers):
        raise InvalidInput(
            f"hand '{hand.name}': no finger has collision geometry, so none can touch: give the file's links collision "
            "shapes (in MJCF: geoms whose contype or conaffinity is not 0)"
        )


def _coal_pose(pose: Array) -> coal.Transform3s:
    return coal.Transform3s(np.array(pose[:3, :3]), np.array(pose[:3, 3]))


def locate_for_coal(data: pin.Data, joint: int, placement: pin.SE3) -> coal.Transform3s:
    """Where something placed on a joint is in the world, as coal takes it."""
    placed = data.oMi[joint] * placement
    return coal.Transform3s(placed.rotation, placed.translation)


def clearance(hand: HandModel, body: Body, q: ArrayLike) -> float:
    """Return the least signed distance of the hand's geometry at q (n,) from ``body`` [m]; negative if they overlap."""
    check_geometry(hand)
    distances = Distances(hand, instance_of("body", body, Body))
    distances.put(array_of("q", q, (hand.n,)))
    parts = [HandPart(hand, one, {}) for one in hand.geometry.geometryObjects]
    least = np.inf
    for rough, i in sorted((distances.rough(part), i) for i, part in enumerate(parts)):
        if rough >= least:
            break
        least = min(least, distances.of(parts[i])[0])
    return least


def behind_hulls(hand: HandModel, contacts: ContactSet) -> Array:
    """How far the links themselves are from the contact points that their convex hulls have (k,) [m]; zeros without."""
    gaps = np.zeros(len(contacts))
    if not hand.own_shapes or contacts.posture is None:
        return gaps
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, contacts.posture)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for i, contact in enumerate(contacts):
        joint = 0 if contact.finger == PALM else hand.finger(contact.finger).joint_of(contact.link)
        point = coal.Transform3s(np.eye(3), contact.point_o)
        distances = []
        for one, own in zip(hand.geometry.geometryObjects, hand.own_shapes):
            if one.parentJoint == joint:
                result.clear()
                pose = locate_for_coal(data, joint, one.placement)
                distances.append(coal.distance(own, pose, _POINT, point, request, result))
        gaps[i] = max(0.0, min(distances, default=0.0))
    return gaps
