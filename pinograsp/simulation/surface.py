"""How deep a convex part of the hand is in an object that is not convex, by the object's own triangles.

An overlap is the shortest shift of the object that clears the part. Of a convex object one face or edge decides it. In
a concave corner of the object several do: a shift t clears all of them where n_i . t >= d_i, with the inward normals
n_i and the depths d_i along these. The shortest t depends continuously on the pose, so that forces do not jump where a
part rolls from one facet of a hollow to the next.

A part between opposite sides, as a finger jammed in a ring, has the overlap with the side that it touched first.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pinograsp.objects import Mesh
from pinograsp.spatial import Array, IntArray

CLEAR = 2e-4  # [m] clearance to which the object is moved; small, so that its other sides stay out of the way
_ALIKE = 3e-5  # [rad] normals this close are equal
_ROUNDS = 20
_HOLLOW = 1e-8  # [m] two points lie in a hollow where each is this far above the other's tangent plane...
_PARALLEL = 1 - 5e-7  # ...and where the cosine between their normals is less than this (1e-3 rad)
_FACING = -0.25  # least cosine between a triangle's normal and the direction of a search: others are at its back
_FLAT = 1e-5  # [m, -] triangles whose planes differ by less are one face
_UNTURNED = np.eye(3)
_STARTS = 12  # directions tried for a part that appears inside the surface


class Side(NamedTuple):
    """One face or edge that a part is nearest to.

    Attributes:
        normal: into the object, in its frame (3,).
        depth: along the normal, negative where clear [m].
        point: on the object's surface, in its frame (3,) [m].
        triangle: its index.
    """

    normal: Array
    depth: float
    point: Array
    triangle: int


class Deepest(NamedTuple):
    """The overlap of a part with the object.

    Attributes:
        depth: length of the shortest shift that clears the part, or less the distance where it is clear [m].
        normal: the shift's direction, into the object, in its frame (3,).
        point: on the object's surface, in its frame; of several sides the mean by their shares in the shift (3,) [m].
        triangle: index of the triangle touched; None where several sides share the overlap.
    """

    depth: float
    normal: Array
    point: Array
    triangle: int | None


class Face(NamedTuple):
    """A flat face of the object.

    Attributes:
        pieces: convex polygons (k, 3), corners in order [m].
        normal: outward (3,).
        middles: of the pieces (p, 3) [m].
        radii: of the pieces about their middles (p,) [m].
    """

    pieces: list[Array]
    normal: Array
    middles: Array
    radii: Array

    def within(self, point: Array, radius: float) -> list[Array]:
        """The pieces that reach into a ball."""
        away = self.middles - point
        return [self.pieces[i] for i in np.flatnonzero((away * away).sum(axis=1) < (self.radii + radius) ** 2)]


class MeshSurface:
    """The triangles of an object that is not convex. All is in the shape's own frame, placements ``mine`` included."""

    def __init__(self, mesh: Mesh):
        self.vertices, self.triangles = mesh.vertices - mesh.com_b, np.array(mesh.faces)
        self.model = _model(self.vertices, self.triangles)
        self.model.computeLocalAABB()
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        inward = np.cross(c - a, b - a)
        self.normals: Array = inward / np.maximum(np.linalg.norm(inward, axis=1), 1e-300)[:, None]
        self.offsets: Array = (self.normals * a).sum(axis=1)
        self._facing: dict[tuple[float, ...], tuple[coal.BVHModelBase, IntArray]] = {}
        self._faces: dict[int, Face] = {}
        self._beside: dict[int, IntArray] = {}
        self.all = np.arange(len(self.triangles))
        self.request, self.plain, self.result = coal.DistanceRequest(), coal.DistanceRequest(), coal.DistanceResult()
        self.request.enable_signed_distance = self.plain.enable_signed_distance = True
        self.request.gjk_tolerance, self.request.gjk_max_iterations = 1e-12, 1000

    def near(self, shape: coal.ShapeBase, mine: coal.Transform3s) -> Side:
        """The side nearest to a part; of one that overlaps the surface, any side there and a depth of 0 or more."""
        gap, side = self._nearest(shape, mine, np.zeros(3), self.model, self.all)
        return side._replace(depth=-gap)

    def deepest_anew(self, shape: coal.ShapeBase, mine: coal.Transform3s, side: Side) -> tuple[Deepest, Array]:
        """As :meth:`deepest`, from the nearest side alone; of a part that appears inside, the shortest way out."""
        normals = [side.normal] if side.depth < 0 else self._starts(shape, mine) or [side.normal]
        tried = [self.deepest(shape, mine, normal, 2 * CLEAR * normal) for normal in normals]
        known = (Deepest(side.depth, side.normal, side.point, side.triangle), 2 * CLEAR * side.normal)
        return min((one for one in tried if one is not None), key=lambda one: one[0].depth, default=known)

    def _starts(self, shape: coal.ShapeBase, mine: coal.Transform3s) -> list[Array]:
        """Inward normals of the triangles that a part overlaps."""
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.num_max_contacts = 1000
        coal.collide(shape, mine, self.model, coal.Transform3s(), request, result)
        # The primitive of a shape is -1.
        met = sorted({max(one.b1, one.b2) for one in (result.getContact(i) for i in range(result.numContacts()))})
        found = np.zeros((0, 3))
        for normal in self.normals[met]:
            if not (found @ normal > 0.95).any():
                found = np.vstack([found, normal])
        return list(found[:_STARTS])

    def deepest(
        self, shape: coal.ShapeBase, mine: coal.Transform3s, normal: Array, away: Array
    ) -> tuple[Deepest, Array] | None:
        """The overlap, from a guess of its normal (3,) and of a shift (3,) that clears the part; None if none does.

        The second value is the shift that leaves the part clear by :data:`CLEAR`: the guess of the next call.
        """
        sides: list[Side] = []
        found: Deepest | None = None
        further = CLEAR
        for _ in range(_ROUNDS):
            length = float(np.linalg.norm(away))
            model, index = self._towards(away / length if length > 0.5 * CLEAR else normal)
            gap, side = self._nearest(shape, mine, away, model, index)
            if gap < 0.2 * CLEAR:  # not clear yet of that triangle
                away, further = away + further * self.normals[side.triangle], 2 * further
                continue
            sides = [*[one for one in sides if _across_a_hollow(one, side)][-2:], side]
            found, clear = _shortest(sides, 0.0), _shortest(sides, CLEAR)
            alike = np.abs(found.normal - normal).max() < _ALIKE
            moved = clear.depth * clear.normal - away
            normal, away, further = found.normal, away + moved, CLEAR
            if alike and np.abs(moved).max() < 0.5 * CLEAR:
                break
        return None if found is None else (found, away)

    def face(self, triangle: int) -> Face:
        """The flat face of a triangle; it may be of several areas."""
        if triangle not in self._faces:
            normal = self.normals[triangle]
            apart = self.vertices[self.triangles] @ normal - self.offsets[triangle]
            own = np.flatnonzero((np.abs(apart).max(axis=1) < _FLAT) & (self.normals @ normal > 0.5))
            pieces = self._one_polygon(own, normal) or [self.vertices[self.triangles[i]] for i in own]
            middles = np.array([piece.mean(axis=0) for piece in pieces])
            radii = [np.linalg.norm(piece - middle, axis=1).max() for piece, middle in zip(pieces, middles)]
            self._faces.update(dict.fromkeys(own.tolist(), Face(pieces, -normal, middles, np.array(radii))))
        return self._faces[triangle]

    def face_towards(self, triangle: int, point: Array, direction: Array) -> int:
        """The triangle at a point (3,) of this one that best faces a direction (3,) into the object."""
        if triangle not in self._beside:
            self._beside[triangle] = np.flatnonzero(np.isin(self.triangles, self.triangles[triangle]).any(axis=1))
        near = self._beside[triangle]
        corners = self.vertices[self.triangles[near]]
        at = np.abs(self.normals[near] @ point - self.offsets[near]) < _FLAT
        at &= ((corners.min(axis=1) < point + _FLAT) & (corners.max(axis=1) > point - _FLAT)).all(axis=1)
        near = near[at] if at.any() else np.array([triangle])
        return int(near[(self.normals[near] @ direction).argmax()])

    def _one_polygon(self, own: IntArray, normal: Array) -> list[Array]:
        """The triangles of a face as one polygon where they fill their hull, else nothing."""
        points = self.vertices[np.unique(self.triangles[own])]
        x = np.linalg.svd(normal[None])[2][1]
        flat = (points - points[0]) @ np.column_stack([x, np.cross(normal, x)])
        try:
            hull = ConvexHull(flat)
        except QhullError:
            return []
        a, b, c = (self.vertices[self.triangles[own, i]] for i in range(3))
        area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        return [points[hull.vertices]] if area > (1 - 1e-6) * hull.volume else []

    def _towards(self, direction: Array) -> tuple[coal.BVHModelBase, IntArray]:
        """The triangles that do not turn their backs to a direction (3,) in the object's frame, and their indices."""
        key = tuple(np.round(1.5 * direction).tolist())
        if key not in self._facing:
            middle = np.array(key) / np.linalg.norm(key)
            own = np.flatnonzero(self.normals @ middle > _FACING)
            self._facing[key] = _model(self.vertices, self.triangles[own]), own
        return self._facing[key]

    def _nearest(
        self, shape: coal.ShapeBase, mine: coal.Transform3s, shift: Array, model: coal.BVHModelBase, index: IntArray
    ) -> tuple[float, Side]:
        """Distance [m] from a part to the object moved by ``shift`` (3,), and the side there, of the object unmoved."""
        result, moved = self.result, coal.Transform3s(_UNTURNED, shift)
        for request in (self.request, self.plain):
            result.clear()
            gap = float(coal.distance(shape, mine, model, moved, request, result))
            own, other = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            if np.isfinite(own).all() and np.isfinite(other).all():
                break
        triangle = int(index[max(result.b1, result.b2)])  # the primitive of a shape is -1
        normal: Array = (other - own) / gap if gap > 0.1 * CLEAR else self.normals[triangle]
        return gap, Side(normal, float(normal @ shift) - gap, other - shift, triangle)


def _model(vertices: Array, triangles: IntArray) -> coal.BVHModelBase:
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), len(vertices))
    for a, b, c in vertices[triangles]:
        model.addTriangle(a, b, c)
    model.endModel()
    return model


def _across_a_hollow(one: Side, other: Side) -> bool:
    """Whether two sides face each other: only a shift that clears both will do. Of a bulge one of them is enough."""
    between = other.point - one.point
    apart = one.normal @ other.normal < _PARALLEL
    return bool(apart and between @ one.normal < -_HOLLOW and between @ other.normal > _HOLLOW)


def _shortest(sides: list[Side], clearance: float) -> Deepest:
    """The shortest shift that leaves a clearance [m] to all sides; where none does, or none is needed, the deepest."""
    top = max(sides, key=lambda side: side.depth)
    if len(sides) > 1 and top.depth + clearance > 0:
        normals, depths = np.array([one.normal for one in sides]), np.array([one.depth + clearance for one in sides])
        for size in range(1, len(sides) + 1):
            for which in combinations(range(len(sides)), size):
                own = normals[list(which)]
                gram = own @ own.T
                if np.linalg.det(gram) < 1e-9:
                    continue
                shares = np.linalg.solve(gram, depths[list(which)])
                shift = shares @ own
                if shares.min() < 0 or (normals @ shift < depths - 1e-9).any():
                    continue
                length = float(np.linalg.norm(shift))
                point = shares @ np.array([sides[i].point for i in which]) / shares.sum()
                return Deepest(length, shift / length, point, sides[which[0]].triangle if size == 1 else None)
    return Deepest(top.depth + clearance, top.normal, top.point, top.triangle)
