"""Overlaps of hand and object: depths and normals of the hand's convex geometry, from coal's distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.simulation.geometry import convex, object_shape
from pinograsp.simulation.surface import Deepest, Surface
from pinograsp.spatial import Array

_CLEAR = 1e-3  # [m] clearance to which the object is moved: the direction between nearest points is accurate there
_NEAR = 2e-4  # [m] parts farther apart are skipped until they may have come closer
_ALIKE = 3e-5  # [rad] normals this close are equal: the error of the depth is of second order
_ROUNDS = 20
_JUMP = 1e-3  # [m] a larger motion between two calls is a new placement: the last normal is of no use
_FARTHEST = 1.0  # [m] assumed travel of a sliding joint without limits
_FLUSH = 2e-6  # [m] corners of a hull this near to the plane of a face belong to it
_ABREAST = 2e-4  # [m] edges side by side count as touching within this distance
_CORNERS = 8  # largest number of corners of a common area
_MOST = 0.995  # of the depth: an area that is nowhere as deep lacks the deepest point

_Point2: TypeAlias = list[float]  # (2,)


class _Part:
    """One convex geometry of the hand, with the normal and the shift found for it in the last call."""

    def __init__(self, joint: int, placement: pin.SE3, shape: coal.ShapeBase):
        self.joint, self.placement, self.shape = joint, placement, shape
        shape.computeLocalAABB()
        self.centre, self.radius = np.array(shape.aabb_center), float(shape.aabb_radius)
        self.footprint = _Footprint(shape)
        self.normal: Array | None = None
        self.shift = 2 * _CLEAR
        self.away: Array | None = None  # where the object is not convex, instead of the shift along the normal

    def forget(self) -> None:
        """Start the next search anew."""
        self.normal, self.shift = None, 2 * _CLEAR


class _Face(NamedTuple):
    """A flat face: corners in order (k, 3) [m] and outward normal (3,)."""

    corners: Array
    normal: Array


class _Edge(NamedTuple):
    """A straight line on a round surface: its ends (2, 3) and the radius of the surface [m]."""

    corners: Array
    radius: float


class _Footprint:
    """The flat face or straight edge of a convex geometry that faces a direction."""

    def __init__(self, shape: coal.ShapeBase):
        self.shape = shape
        self.points: Array | None = None
        self.faces: dict[int, _Face] = {}
        if isinstance(shape, coal.Box):
            self.points = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T * np.array(shape.halfSide).ravel()
        elif isinstance(shape, coal.ConvexBase):
            self.points = np.array(shape.points())
        if self.points is not None:
            self.planes: Array = ConvexHull(self.points, qhull_options="Qt").equations

    def towards(self, direction: Array, rotation: Array, position: Array) -> _Face | _Edge | None:
        """The face or edge that faces a direction (3,), the geometry being placed; None where it is round."""
        d, shape = direction @ rotation, self.shape
        if self.points is not None:
            corners, normal = self._face(self.points, d)
        elif isinstance(shape, coal.Cylinder) and abs(d[2]) > np.sqrt(0.5):
            turn = np.arange(2 * _CORNERS) * np.pi / _CORNERS
            up = np.sign(d[2])
            rim = [shape.radius * np.cos(turn), shape.radius * np.sin(turn), np.full(turn.size, up * shape.halfLength)]
            corners, normal = np.array(rim).T, np.array([0.0, 0.0, up])
        elif isinstance(shape, coal.Cylinder | coal.Capsule) and abs(d[2]) < 0.9:
            out = d if isinstance(shape, coal.Capsule) else np.array([d[0], d[1], 0.0]) / np.hypot(d[0], d[1])
            ends = shape.halfLength * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
            return _Edge((shape.radius * out + ends) @ rotation.T + position, shape.radius)
        else:
            return None
        return _Face(corners @ rotation.T + position, rotation @ normal)

    def _face(self, points: Array, d: Array) -> _Face:
        i = int((self.planes[:, :3] @ d).argmax())
        if i not in self.faces:
            plane = self.planes[i]
            corners = points[np.abs(points @ plane[:3] + plane[3]) < _FLUSH]
            x, y = _across(plane[:3])
            across = (corners - corners.mean(axis=0)) @ np.column_stack([x, y])
            self.faces[i] = _Face(corners[np.arctan2(across[:, 1], across[:, 0]).argsort()], plane[:3].copy())
        return self.faces[i]


def _common_area(
    own: _Face | _Edge, others: Sequence[_Face | _Edge], point: Array, normal: Array, depth: float
) -> list[tuple[Array, float]]:
    """Points (3,) of the object where faces or edges of hand and object lie on each other, with depths.

    ``others`` are the object's edge, or its face in convex pieces. ``point`` is the deepest; it is added where the
    others are not as deep.
    """
    x, y = _across(normal)
    axes = np.column_stack([x, y, normal])
    mine, pieces = _Heights(own, point, axes), [_Heights(other, point, axes) for other in others]
    theirs = pieces[0]
    outline = [corner for piece in pieces for corner in _common_outline(mine, piece)]
    found: list[tuple[Array, float]] = []
    if outline:
        area = np.array(outline)
        if len(area) > _CORNERS or len(pieces) > 1:  # those farthest out
            turn = (np.arange(_CORNERS) + 0.5) * 2 * np.pi / _CORNERS
            area = area[np.unique((area @ np.array([np.cos(turn), np.sin(turn)])).argmax(axis=0))]
        surface = theirs.over(area, beside=mine.is_edge)
        depths = mine.over(area) - surface
        found = [(point + axes @ [*at, z], float(deep)) for at, z, deep in zip(area, surface, depths) if deep > 0]
    if max((deep for _, deep in found), default=0.0) < _MOST * depth:
        found.append((point, depth))
    return found


def _common_outline(mine: _Heights, theirs: _Heights) -> list[_Point2]:
    if mine.is_edge and theirs.is_edge:
        return _abreast(mine.corners, theirs.corners)
    if theirs.is_edge:
        return _clip(theirs.corners, mine.corners)
    return _clip(mine.corners, theirs.corners)


class _Heights:
    """A face or an edge as heights over the common tangent plane."""

    def __init__(self, flat: _Face | _Edge, point: Array, axes: Array):
        corners: Array = (flat.corners - point) @ axes
        self.corners: list[_Point2] = corners[:, :2].tolist()
        self.z, self.at, self.is_edge = corners[:, 2], corners[0], len(corners) == 2
        self.normal: Array | None = flat.normal @ axes if isinstance(flat, _Face) else None
        self.radius = flat.radius if isinstance(flat, _Edge) else 0.0

    def over(self, points: Array, *, beside: bool = False) -> Array:
        """Heights over points (k, 2); ``beside``: with the curvature of the surface to the sides of an edge."""
        out = points - self.at[:2]
        if self.normal is not None:
            plane: Array = self.at[2] - out @ self.normal[:2] / self.normal[2]
            return plane
        start, end = np.array(self.corners)
        along = end - start
        length = float(along @ along)
        height: Array = self.at[2] + (out @ along) / length * (self.z[1] - self.z[0])
        if beside:
            height = height + (out @ [-along[1], along[0]]) ** 2 / length / (2 * self.radius)
        return height


def _across(n: Array) -> tuple[Array, Array]:
    """Two directions perpendicular to a unit normal (3,), right-handed with it (Duff et al. 2017)."""
    sign = 1.0 if n[2] >= 0 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return np.array([1 + sign * n[0] ** 2 * a, sign * b, -sign * n[0]]), np.array([b, sign + n[1] ** 2 * a, -n[1]])


def _clip(corners: list[_Point2], by: list[_Point2]) -> list[_Point2]:
    """The part of a polygon or an edge that lies within a convex polygon (Sutherland and Hodgman)."""
    if sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(by, by[1:] + by[:1])) < 0:
        by = by[::-1]
    for a, b in zip(by, by[1:] + by[:1]):
        ex, ey = b[0] - a[0], b[1] - a[1]
        sides = [ex * (p[1] - a[1]) - ey * (p[0] - a[0]) for p in corners]
        if min(sides, default=0.0) >= 0:
            continue
        left = []
        for k, (p, s) in enumerate(zip(corners, sides)):
            if s >= 0:
                left.append(p)
            if len(corners) == 2 and k == 1:
                break  # an edge does not close
            q, t = corners[(k + 1) % len(corners)], sides[(k + 1) % len(corners)]
            if s * t < 0:
                r = s / (s - t)
                left.append([p[0] + r * (q[0] - p[0]), p[1] + r * (q[1] - p[1])])
        corners = left
    return corners


def _abreast(edge: list[_Point2], other: list[_Point2]) -> list[_Point2]:
    """Ends of the part of an edge that lies on another edge."""
    start, end = np.array(edge)
    other_start, other_end = np.array(other)
    e, f = end - start, other_end - other_start
    out, length = start - other_start, float(np.hypot(*f))
    low, high = 0.0, 1.0
    # The positions along the other edge and across it are linear in the position on this one.
    for direction, least, most in ((f / length, 0.0, length), (np.array([-f[1], f[0]]) / length, -_ABREAST, _ABREAST)):
        at, slope = float(out @ direction), float(e @ direction)
        if abs(slope) < 1e-12:
            if not least <= at <= most:
                return []
            continue
        ends = sorted(((least - at) / slope, (most - at) / slope))
        low, high = max(low, ends[0]), min(high, ends[1])
    return [(start + low * e).tolist(), (start + high * e).tolist()] if low < high else []


class Overlap(NamedTuple):
    """One point at which the hand overlaps the object.

    Attributes:
        joint: Pinocchio's index of the joint that carries the geometry.
        geometry: index of the hand's convex geometry.
        point: on the object's surface (3,) [m].
        normal: into the object (3,).
        depth: [m].
    """

    joint: int
    geometry: int
    point: Array
    normal: Array
    depth: float


class _Pose(NamedTuple):
    """Joint positions (n,) with rotation (3, 3) and position (3,) of the object."""

    q: Array
    rotation: Array
    position: Array


class Collider:
    """Overlaps of the hand's geometry with the object: depths along the common normal of the surfaces.

    Coal's depth of an overlap is not exact. The object is therefore moved along the last estimate of the normal until
    it is clear by a millimetre. There coal's nearest points are exact; their direction is the next estimate. Of an
    object that is not convex, see :mod:`pinograsp.simulation.surface`.
    """

    def __init__(self, hand: HandModel, body: Body):
        self.notes: list[str] = []
        parts = [
            _Part(one.parentJoint, one.placement, shape)
            for one in hand.geometry.geometryObjects
            if (shape := convex(one.geometry, one.name, self.notes)) is not None
        ]
        self.geometry, self.hand = parts, hand
        shape = object_shape(body, self.notes)
        self.surface = shape if isinstance(shape, Surface) else None
        self.object = shape.model if isinstance(shape, Surface) else shape
        self.object.computeLocalAABB()
        self.centre, self.radius = np.array(self.object.aabb_center), float(self.object.aabb_radius)
        self.extent = float(np.linalg.norm(self.centre)) + self.radius
        self.footprint = None if isinstance(shape, Surface) else _Footprint(shape)
        self.reach = np.array([self._reach(part) for part in parts]).reshape(len(parts), hand.n)
        # Lower bounds of the distances: the last known ones, less the largest motion since.
        self.slack = np.zeros(len(parts))
        self.last: _Pose | None = None
        self.request, self.plain, self.result = coal.DistanceRequest(), coal.DistanceRequest(), coal.DistanceResult()
        self.request.enable_signed_distance = self.plain.enable_signed_distance = True
        self.request.gjk_tolerance, self.request.gjk_max_iterations = 1e-12, 1000

    def _reach(self, part: _Part) -> Array:
        """How far any point of a geometry can move for each unit of each actuated joint (n,)."""
        hand, model, bound = self.hand, self.hand.model, np.zeros(self.hand.n)
        far, j = float(np.linalg.norm(part.placement.act(part.centre))) + part.radius, part.joint
        while j:
            i, ratio, slides = model.joints[j].idx_v, abs(hand.ratio(j)), hand.is_prismatic(j)
            bound[i] += ratio * (1.0 if slides else far)
            if slides:
                far += ratio * min(max(abs(hand.lower[i]), abs(hand.upper[i])) + 0.01, _FARTHEST)
            far += float(np.linalg.norm(model.jointPlacements[j].translation))
            j = model.parents[j]
        return bound

    def collide(self, placements: Sequence[pin.SE3], q: Array, rotation: Array, position: Array) -> list[Overlap]:
        """All overlaps, with the joints at ``placements`` (at q) and the object at a rotation and position."""
        if self.last is not None:
            turned = rotation - self.last.rotation
            shift = np.linalg.norm(position - self.last.position)
            object_moved = shift + self.extent * np.sqrt(0.5 * (turned * turned).sum())
            self.slack -= self.reach @ np.abs(q - self.last.q) + object_moved
        self.last = _Pose(q, rotation, position)
        found: list[Overlap] = []
        pose = coal.Transform3s(rotation, position)
        centre = position + rotation @ self.centre
        for i in np.flatnonzero(self.slack <= 0):
            part = self.geometry[i]
            placed = placements[part.joint] * part.placement
            if self.slack[i] < -_JUMP:
                part.forget()
            apart = float(np.linalg.norm(placed.act(part.centre) - centre)) - part.radius - self.radius
            if apart > _NEAR:
                self.slack[i], part.normal = apart - 0.5 * _NEAR, None
                continue
            mine = coal.Transform3s(placed.rotation, placed.translation)
            touched = self._overlap(part, mine, pose)
            depth, normal, point, _ = touched
            self.slack[i] = max(-depth - 0.5 * _NEAR, 0.0) if depth < -_NEAR else 0.0
            if depth > 0:
                own = part.footprint.towards(normal, placed.rotation, placed.translation)
                others = [] if own is None else self._faces(own, touched, rotation, position)
                points = [(point, depth)]
                if own is not None and others:
                    points = _common_area(own, others, point, normal, depth)
                found += [Overlap(part.joint, int(i), at, normal, deep) for at, deep in points]
        return found

    def _faces(self, own: _Face | _Edge, touched: Deepest, rotation: Array, position: Array) -> Sequence[_Face | _Edge]:
        """The object's face, in convex pieces, or edge against the hand's; none where it is round."""
        if self.footprint is not None:
            other = self.footprint.towards(-touched.normal, rotation, position)
            return [] if other is None else [other]
        if self.surface is None or touched.triangle is None:
            return []
        point, normal = (touched.point - position) @ rotation, touched.normal @ rotation
        face = self.surface.face(self.surface.face_towards(touched.triangle, point, normal))
        middle = own.corners.mean(axis=0)
        away = own.corners - middle
        pieces = face.within((middle - position) @ rotation, float(np.sqrt((away * away).sum(axis=1).max())))
        return [_Face(corners @ rotation.T + position, rotation @ face.normal) for corners in pieces]

    def _overlap(self, part: _Part, mine: coal.Transform3s, pose: coal.Transform3s) -> Deepest:
        if self.surface is None:
            return Deepest(*self._deepest(part, mine, pose), None)
        return self._deepest_of_surface(self.surface, part, mine, pose)

    def _deepest_of_surface(
        self, surface: Surface, part: _Part, mine: coal.Transform3s, pose: coal.Transform3s
    ) -> Deepest:
        if part.normal is not None and part.away is not None:
            found = surface.deepest(part.shape, mine, pose, part.normal, part.away)
        else:
            side = surface.near(part.shape, mine, pose)
            if side.depth < -_NEAR:
                return Deepest(side.depth, side.normal, side.point, side.triangle)
            found = surface.deepest_anew(part.shape, mine, pose, side)
        part.forget()
        if found is None:  # never clear: as if it were far inside
            return self._deepest_of_surface(surface, part, mine, pose)
        best, away = found
        if best.depth > -_NEAR:
            part.normal, part.away = best.normal, away
        return best

    def _deepest(self, part: _Part, mine: coal.Transform3s, pose: coal.Transform3s) -> tuple[float, Array, Array]:
        """Depth [m], negative where clear, inward normal (3,), and the point on the object's surface (3,)."""
        normal, shift = part.normal, part.shift
        found: tuple[float, Array] | None = None
        if normal is None:
            gap, point, normal = self._gap(part, mine, pose)
            if gap > _NEAR:
                return -gap, normal, point
            found = -gap, point
        position, rotation = pose.getTranslation(), pose.getRotation()
        for _ in range(_ROUNDS):
            moved = coal.Transform3s(rotation, position + shift * normal)
            gap, other, direction = self._gap(part, mine, moved)
            if gap < 0.5 * _CLEAR:  # not clear yet
                shift += _CLEAR - min(gap, 0.0)
                continue
            # The width of the overlap along this direction is exact.
            found = shift * float(normal @ direction) - gap, other - shift * normal
            alike, spare = np.abs(direction - normal).max() < _ALIKE, gap - _CLEAR
            normal, shift = direction, shift - spare
            if alike and abs(spare) < 0.5 * _CLEAR:
                break
        if found is None:  # never clear along the last normal
            part.forget()
            return self._deepest(part, mine, pose)
        depth, point = found
        if depth > -_NEAR:
            part.normal, part.shift = normal, shift
        else:
            part.forget()
        return depth, normal, point

    def _gap(self, part: _Part, mine: coal.Transform3s, pose: coal.Transform3s) -> tuple[float, Array, Array]:
        """Distance [m], the object's nearest point (3,), and the direction to it from the hand's nearest point (3,)."""
        result = self.result
        for request in (self.request, self.plain):
            result.clear()
            gap = coal.distance(part.shape, mine, self.object, pose, request, result)
            own, other = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            if np.isfinite(own).all() and np.isfinite(other).all():
                break
        return gap, other, (other - own) / gap if gap > 0.5 * _NEAR else np.array(result.normal)
