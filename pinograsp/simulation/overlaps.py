"""Overlaps of the hand's convex geometry with an object that is not convex, from coal's distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from pinograsp.hands import HandModel
from pinograsp.simulation.geometry import make_convex
from pinograsp.simulation.surface import Deepest, MeshSurface
from pinograsp.spatial import Array, IntArray

_NEAR = 2e-4  # [m] parts farther apart are skipped until they may have come closer
_STILL = 1e-6  # [m] a part that touches is measured again when it has moved this far against the object
_JUMP = 1e-3  # [m] a larger motion between two calls is a new placement: the last normal is of no use
_FLUSH = 2e-6  # [m] corners of a hull this near to the plane of a face belong to it
_ONCE, _TWICE = np.ones(12), np.full(12, 2.0)  # factors of sums
_CORNERS = 8  # largest number of corners of a common area
_MOST = 0.995  # of the depth: an area that is nowhere as deep lacks the deepest point

_Point2: TypeAlias = list[float]  # (2,)


class _Planes(NamedTuple):
    """Points at which hand and object touch, each with the object's tangent plane there; the object's frame.

    Attributes:
        points: on the object's surface (c, 3) [m].
        normals: into the object (c, 3).
        slopes: how the depths change with the placement of the joint that carries the geometry: with the columns
            (4, 3) of its rotation and its position (c, 12).
        heights: the depths are these plus slopes times placement (c,) [m].
    """

    points: Array
    normals: Array
    slopes: Array
    heights: Array


_NOTHING = _Planes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 12)), np.zeros(0))


class _Part:
    """One convex geometry of the hand, with where it touches, and the normal and the shift out of the object found in
    the last call.
    """

    def __init__(self, joint: int, placement: pin.SE3, shape: coal.ShapeBase):
        self.joint, self.placement, self.shape = joint, placement, shape
        shape.computeLocalAABB()
        self.centre, self.radius = np.array(shape.aabb_center), float(shape.aabb_radius)
        self.footprint = _Footprint(shape)
        self.normal: Array | None = None
        self.away: Array | None = None
        self.planes = _NOTHING


class _Flat(NamedTuple):
    """A flat face of a geometry, or a straight edge on a round surface.

    Attributes:
        corners: in order, the ends of an edge (k, 3) [m].
        normal: outward (3,); None: of an edge.
    """

    corners: Array
    normal: Array | None


class _Footprint:
    """The flat face or straight edge of a convex geometry that faces a direction."""

    def __init__(self, shape: coal.ShapeBase):
        self.shape = shape
        self.points: Array | None = None
        self.faces: dict[int, tuple[Array, Array]] = {}
        if isinstance(shape, coal.Box):
            self.points = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T * np.array(shape.halfSide).ravel()
        elif isinstance(shape, coal.ConvexBase):
            self.points = np.array(shape.points())
        if self.points is not None:
            self.planes: Array = ConvexHull(self.points, qhull_options="Qt").equations

    def towards(self, direction: Array, rotation: Array, position: Array) -> _Flat | None:
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
            return _Flat((shape.radius * out + ends) @ rotation.T + position, None)
        else:
            return None
        return _Flat(corners @ rotation.T + position, rotation @ normal)

    def _face(self, points: Array, d: Array) -> tuple[Array, Array]:
        i = int((self.planes[:, :3] @ d).argmax())
        if i not in self.faces:
            plane = self.planes[i]
            corners = points[np.abs(points @ plane[:3] + plane[3]) < _FLUSH]
            x, y = _across(plane[:3])
            across = (corners - corners.mean(axis=0)) @ np.column_stack([x, y])
            self.faces[i] = corners[np.arctan2(across[:, 1], across[:, 0]).argsort()], plane[:3].copy()
        return self.faces[i]


def _common_area(
    own: _Flat, others: Sequence[_Flat], point: Array, normal: Array, depth: float
) -> list[tuple[Array, float]]:
    """Points (3,) of the object where a face or an edge of the hand lies on a face of the object or is about to, with
    depths.

    ``others`` are the convex pieces of that face. ``point`` is the deepest; it is added where the others are not as
    deep.
    """
    axes = np.column_stack([*_across(normal), normal])
    mine, pieces = _Heights(own, point, axes), [_Heights(other, point, axes) for other in others]
    outline = [corner for piece in pieces for corner in _clip(mine.corners, piece.corners)]
    found: list[tuple[Array, float]] = []
    if outline:
        area = np.array(outline)
        if len(area) > _CORNERS or len(pieces) > 1:  # those farthest out
            turn = (np.arange(_CORNERS) + 0.5) * 2 * np.pi / _CORNERS
            area = area[np.unique((area @ np.array([np.cos(turn), np.sin(turn)])).argmax(axis=0))]
        surface = pieces[0].over(area)
        depths = mine.over(area) - surface
        found = [(point + axes @ [*at, z], float(deep)) for at, z, deep in zip(area, surface, depths) if deep > -_STILL]
    if max((deep for _, deep in found), default=-_STILL) < _MOST * depth:
        found.append((point, depth))
    return found


class _Heights:
    """A face or an edge as heights over the common tangent plane."""

    def __init__(self, flat: _Flat, point: Array, axes: Array):
        corners: Array = (flat.corners - point) @ axes
        self.corners: list[_Point2] = corners[:, :2].tolist()
        self.z, self.at = corners[:, 2], corners[0]
        self.normal: Array | None = None if flat.normal is None else flat.normal @ axes

    def over(self, points: Array) -> Array:
        """Heights over points (k, 2)."""
        out = points - self.at[:2]
        if self.normal is not None:
            plane: Array = self.at[2] - out @ self.normal[:2] / self.normal[2]
            return plane
        start, end = np.array(self.corners)
        along = end - start
        height: Array = self.at[2] + (out @ along) / float(along @ along) * (self.z[1] - self.z[0])
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


class Overlaps(NamedTuple):
    """The c points at which the hand overlaps the object.

    Attributes:
        geometry: indices of the hand's convex geometries (c,).
        points: on the object's surface (c, 3) [m].
        normals: into the object (c, 3).
        depths: (c,) [m].
    """

    geometry: IntArray
    points: Array
    normals: Array
    depths: Array


class Collider:
    """Overlaps of the hand's geometry with an object that is not convex, see :mod:`pinograsp.simulation.surface`.

    A part is measured again when it has moved against the object: as far as it was clear, or, where it touches, by
    :data:`_STILL`. In between its points are those of tangent planes, off by the square of the motion over the radius
    of curvature.

    Attributes:
        joints: Pinocchio's indices of the joints that carry the hand's convex geometries (g,).
    """

    def __init__(self, hand: HandModel, surface: MeshSurface):
        self.parts = [
            _Part(one.parentJoint, one.placement, shape)
            for one in hand.geometry.geometryObjects
            if (shape := make_convex(one.geometry, one.name, [])) is not None
        ]
        self.joints, self.surface = np.array([part.joint for part in self.parts], dtype=int), surface
        self.centre, self.radius = np.array(surface.model.aabb_center), float(surface.model.aabb_radius)
        # From the columns of a joint's placement to how far its geometry turns about its middle, and that.
        self.levers = np.zeros((len(self.parts), 4, 4))
        for lever, part in zip(self.levers, self.parts):
            lever[:3, :3] = part.radius * np.sqrt(0.5) * np.eye(3)
            lever[3] = [*part.placement.act(part.centre), 1.0]
        # By these, where each part was when it was measured, and how far it may move from there.
        self.measured, self.allowed = np.zeros((len(self.parts), 12)), np.full(len(self.parts), -1.0)
        self._gather()

    def collide(self, rotations: Array, positions: Array, rotation: Array, position: Array) -> Overlaps:
        """All overlaps, with the geometries' joints at rotations (g, 3, 3) and positions (g, 3), and the object at a
        rotation (3, 3) and a position (3,).
        """
        # Placements in the object's frame, their columns as rows: one product for all.
        columns = np.concatenate([rotations.transpose(0, 2, 1), (positions - position)[:, None]], axis=1)
        placed = (columns.reshape(-1, 3) @ rotation).reshape(-1, 4, 3)
        there = (self.levers @ placed).reshape(-1, 12)
        change = there - self.measured
        moved = np.sqrt((change * change) @ _TWICE)  # no point of the part has moved farther
        due = (moved > self.allowed).nonzero()[0]
        for i in due:
            if moved[i] > self.allowed[i] + _JUMP:
                self.parts[i].normal = None
            self.allowed[i] = self._measure(self.parts[i], placed[i].T, there[i, 9:])
        if due.size:
            self.measured[due] = there[due]
            self._gather()
        points, normals, slopes, heights = self.planes
        depths = heights + (placed.reshape(-1, 12).take(self.owners, 0) * slopes) @ _ONCE
        own = (depths > 0).nonzero()[0]
        points, normals = points.take(own, 0) @ rotation.T + position, normals.take(own, 0) @ rotation.T
        return Overlaps(self.owners.take(own), points, normals, depths.take(own))

    def _gather(self) -> None:
        """Put the points of all parts side by side."""
        every = [part.planes for part in self.parts]
        self.planes = _Planes(*(np.concatenate(one) for one in zip(_NOTHING, *every)))
        self.owners = np.repeat(np.arange(len(every)), [len(one.heights) for one in every])

    def _measure(self, part: _Part, joint: Array, middle: Array) -> float:
        """Find where a part touches, its joint's placement being (3, 4) in the object's frame; returns how far it may
        move before it is measured again.
        """
        part.planes = _NOTHING
        apart = float(np.linalg.norm(middle - self.centre)) - part.radius - self.radius
        if apart > _NEAR:
            part.normal = None
            return apart - 0.5 * _NEAR
        rotation = joint[:, :3] @ part.placement.rotation
        position = joint[:, :3] @ part.placement.translation + joint[:, 3]
        deepest = self._find_deepest(part, coal.Transform3s(rotation, position))
        depth, normal = deepest.depth, deepest.normal
        if depth > -_STILL:
            own = part.footprint.towards(normal, rotation, position)
            others = [] if own is None else self._faces(own, deepest)
            found = [(deepest.point, depth)]
            if own is not None and others:
                found = _common_area(own, others, deepest.point, normal, depth)
            points, depths = (np.array(one) for one in zip(*found))
            arms = np.column_stack([(points - joint[:, 3]) @ joint[:, :3], np.ones(len(points))])
            slopes = (arms[:, :, None] * normal).reshape(-1, 12)
            part.planes = _Planes(points, np.tile(normal, (len(points), 1)), slopes, depths - points @ normal)
        return max(-depth - 0.5 * _NEAR, -0.5 * depth, _STILL)

    def _faces(self, own: _Flat, deepest: Deepest) -> list[_Flat]:
        """The object's face against the hand's, in convex pieces; none where several sides share the overlap."""
        if deepest.triangle is None:
            return []
        face = self.surface.face(self.surface.face_towards(deepest.triangle, deepest.point, deepest.normal))
        middle = own.corners.mean(axis=0)
        away = own.corners - middle
        pieces = face.within(middle, float(np.sqrt((away * away).sum(axis=1).max())))
        return [_Flat(corners, face.normal) for corners in pieces]

    def _find_deepest(self, part: _Part, mine: coal.Transform3s) -> Deepest:
        """How deep a part is in the object; negative where it is clear."""
        surface = self.surface
        if part.normal is not None and part.away is not None:
            found = surface.deepest(part.shape, mine, part.normal, part.away)
        else:
            side = surface.near(part.shape, mine)
            if side.depth < -_NEAR:
                return Deepest(side.depth, side.normal, side.point, side.triangle)
            found = surface.deepest_anew(part.shape, mine, side)
        part.normal = None
        if found is None:  # never clear: as if it were far inside
            return self._find_deepest(part, mine)
        best, away = found
        if best.depth > -_NEAR:
            part.normal, part.away = best.normal, away
        return best
