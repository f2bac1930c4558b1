"""Triangles in space: the nearest point of a mesh, inside or outside, and the curvature of what it approximates."""

from __future__ import annotations

from typing import Any

import numpy as np

from pinograsp import core
from pinograsp.objects.body import NO_DIRECTION, tangents
from pinograsp.spatial import Array, BoolArray, IntArray, cross

_LEAF = 4  # triangles per leaf of the search tree: few enough to test them all, many enough to keep the tree shallow
_FEW_PAIRS = 1_500  # of a point and a triangle, which all at once take less time than the tree
_FEW_BOXES = 5_000  # of a point and a leaf, likewise
_MOST_PAIRS = 1_000_000  # of a point and a box or triangle held at once; beyond, the points are split
# Two nearest points within NO_DIRECTION of being equally near, seen at more than 135 degrees from each other, are on
# opposite sides: a thin wall, an axis. Below that they are neighbours across an edge, and either will do.
_OPPOSITE = -np.sqrt(0.5)
_ROUNDING = 1e-12  # [m] of triangles whose distances differ by less the first is the nearest one
# Height over longest edge below which a triangle's normal is rounding.
_NEEDLE = 1e-10
_LONGEST = 0.4  # edge of the pieces that a curvature is fitted to, of the fit's radius
_SINGULAR = 1e-12  # least eigenvalue of a fit's normal equations, of the largest
_EDGES = ((0, 1), (1, 2), (2, 0))
_TINY = np.finfo(float).tiny  # divides what is zero anyway


class TriangleSurface:
    """A closed surface of triangles wound outwards, prepared for queries: vertices (n, 3) [m], faces (m, 3).

    Nearest points come from a binary tree of axis-aligned boxes: the core's, or one that all points descend together.
    The sign is that of the angle-weighted normal of the nearest face, edge or corner (J. A. Baerentzen and H. Aanaes,
    Signed Distance Computation Using the Angle Weighted Pseudonormal, IEEE Trans. Vis. Comput. Graph. 11(3), 2005),
    which is exact for closed surfaces that do not cross themselves; at triangles too flat to have a normal the winding
    number decides.
    """

    def __init__(self, vertices: Array, faces: IntArray):
        self.corners = vertices[faces]
        sides = np.roll(self.corners, -1, axis=1) - self.corners
        area = cross(sides[:, 0], sides[:, 1])  # twice the area, along the normal
        longest = np.linalg.norm(sides, axis=2).max(axis=1)
        self.areas = np.linalg.norm(area, axis=1) / 2
        self.heights = 2 * self.areas / np.maximum(longest, _TINY)
        flat = self.heights <= _NEEDLE * longest
        self.normals = np.where(flat[:, None], 0.0, area / np.where(flat, 1.0, 2 * self.areas)[:, None])
        self._feature_normals = self._pseudonormals(vertices, faces, sides)
        unsure = np.zeros(len(vertices), dtype=bool)
        unsure[faces[flat]] = True
        self._unsure: BoolArray = np.any(unsure[faces], axis=1)
        ab, ac = sides[:, 0], -sides[:, 2]
        # Rows that give, from the offset to the first corner: its parts along both sides, the height, and the
        # barycentric coordinates of its foot.
        safe = np.where(flat, 1.0, 2 * self.areas)[:, None]
        duals = cross(ac, self.normals) / safe, cross(self.normals, ab) / safe
        self._rows = np.stack([ab, ac, self.normals, *duals], axis=1)
        self._squares = np.stack([(ab**2).sum(axis=1), (ac**2).sum(axis=1), (ab * ac).sum(axis=1)], axis=1)
        self._solid = np.flatnonzero(~flat)  # those without a normal lie along the sides of others
        self._low, self._high = self.corners.min(axis=1), self.corners.max(axis=1)
        self._compiled: Any = None  # the core's tree, built when it is asked
        self._boxes: list[tuple[Array, Array]] = []  # the tree without the core

    @property
    def compiled(self) -> Any:
        """The core's tree of the triangles."""
        if self._compiled is None:
            self._compiled = core.load().Triangles(self.corners[self._solid])
        return self._compiled

    def __getstate__(self) -> dict[str, Any]:
        """Without the core's tree, which is built anew."""
        return {**self.__dict__, "_compiled": None}

    def _pseudonormals(self, vertices: Array, faces: IntArray, sides: Array) -> Array:
        """Unit normals (m, 7, 3) of each triangle: its own, its three edges' and its three corners'."""
        n = len(vertices)
        pairs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
        keys = pairs.min(axis=2).astype(np.int64) * n + pairs.max(axis=2)
        _, edge = np.unique(keys, return_inverse=True)
        edge = edge.reshape(keys.shape)
        on_edges = np.zeros((edge.max() + 1, 3))
        np.add.at(on_edges, edge, self.normals[:, None])
        units = sides / np.maximum(np.linalg.norm(sides, axis=2), _TINY)[..., None]
        angles = np.arccos(np.clip(-(units * np.roll(units, 1, axis=1)).sum(axis=2), -1, 1))
        on_vertices = np.zeros((n, 3))
        np.add.at(on_vertices, faces, angles[..., None] * self.normals[:, None])
        found = np.concatenate([self.normals[:, None], on_edges[edge], on_vertices[faces]], axis=1)
        found /= np.maximum(np.linalg.norm(found, axis=2), _TINY)[..., None]
        return found

    def _build_tree(self, members: IntArray) -> None:
        """Of triangles with a normal, where there is no compiled core."""
        depth = int(np.ceil(np.log2(max(len(members) / _LEAF, 1))))
        order = np.resize(members, (1, _LEAF << depth))  # repeats fill the last leaves
        centres = self.corners.mean(axis=1)
        for _ in range(depth):
            here = centres[order]
            axis = np.ptp(here, axis=1).argmax(axis=1)
            along = np.take_along_axis(here, axis[:, None, None], axis=2)[..., 0]
            order = np.take_along_axis(order, along.argsort(axis=1), axis=1).reshape(2 * len(order), -1)
        self._leaves = order
        low, high = self._low[order].min(axis=1), self._high[order].max(axis=1)
        self._boxes = [(low, high)]
        while len(low) > 1:
            low, high = np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2])
            self._boxes.insert(0, (low, high))

    def nearest(self, points: Array) -> tuple[Array, Array, Array, BoolArray]:
        """Nearest points (k, 3), outward unit normals (k, 3), signed distances (k,), negative inside, and whether
        (k,) other points are as near on the opposite side.

        On a face the normal is the face's; on an edge or a corner it is the direction to the point, as the gradient of
        the distance is, and for a point on the surface itself the mean normal of the faces that meet there.
        """
        face, feature, surface, opposite = self._search(points)
        offset = points - surface
        distance = np.linalg.norm(offset, axis=1)
        mean = self._feature_normals[face, feature]
        inside = (offset * mean).sum(axis=1) < 0
        unsure = self._unsure[face] & (distance > 0)
        if np.any(unsure):
            inside[unsure] = self.winding_number(points[unsure]) > 0.5
        distance = np.where(inside, -distance, distance)
        apart = (feature > 0) & (np.abs(distance) > NO_DIRECTION)
        # Rounding must not decide whether a point on an edge is taken for one on a face beside it.
        touching = np.abs(distance) <= NO_DIRECTION
        mean[touching] = self._feature_normals[
            face[touching], _feature_at(surface[touching], self.corners[face[touching]])
        ]
        outward = np.where(apart[:, None], offset / np.where(apart, distance, 1.0)[:, None], mean)
        return surface, outward, distance, opposite

    def _search(self, points: Array) -> tuple[IntArray, IntArray, Array, BoolArray]:
        """Nearest triangle (k,), its nearest feature (k,), the point there (k, 3), and whether another is opposite."""
        k = len(points)
        if k == 0:
            return np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros(0, dtype=bool)
        if core.is_installed():
            surface, found = np.empty((k, 3)), np.empty((k, 3), dtype=np.int64)
            self.compiled.find_nearest(np.ascontiguousarray(points, dtype=float), NO_DIRECTION, surface, found)
            return self._solid[found[:, 0]], found[:, 1], surface, found[:, 2] > 0
        point, face = self._near(points)
        surface, feature = _nearest_on(points[point], self.corners[face])
        offset = surface - points[point]
        squared = (offset**2).sum(axis=1)
        first = np.searchsorted(point, np.arange(k))
        least = np.sqrt(np.minimum.reduceat(squared, first)) + _ROUNDING
        best = np.lexsort((face, squared > (least**2)[point], point))[first]
        turned = (offset * offset[best][point]).sum(axis=1) < _OPPOSITE * np.sqrt(squared * squared[best][point])
        turned &= (squared <= _widen(squared[best])[point]) & (squared > NO_DIRECTION**2)
        return face[best], feature[best], surface[best], np.logical_or.reduceat(turned, first)

    def _near(self, points: Array) -> tuple[IntArray, IntArray]:
        """Points, by number in ascending order (p,), and triangles (p,) that may be nearest to them: few each, without
        the core.
        """
        if not self._boxes:
            self._build_tree(self._solid)
        k, count = len(points), len(self._leaves)
        if k * count * _LEAF <= _FEW_PAIRS:
            point, node = np.repeat(np.arange(k), count), np.tile(np.arange(count), k)
        elif k * count <= _FEW_BOXES:
            low, high = self._boxes[-1]
            away = np.maximum(np.abs(points[:, None] - low), np.abs(points[:, None] - high))
            reach = _widen((away**2).sum(axis=2).min(axis=1))
            point, node = np.nonzero(_squared_gap(points[:, None], low, high) <= reach[:, None])
        else:
            reach = self._first_guess(points)
            point, node = np.arange(k), np.zeros(k, dtype=int)
            for low, high in self._boxes[1:]:
                point, node = np.repeat(point, 2), np.repeat(2 * node, 2)
                node[1::2] += 1
                keep = _squared_gap(points[point], low[node], high[node]) <= reach[point]
                point, node = point[keep], node[keep]
                if k > 1 and len(point) * _LEAF > _MOST_PAIRS:
                    (one, faces), (other, more) = self._near(points[: k // 2]), self._near(points[k // 2 :])
                    return np.concatenate([one, k // 2 + other]), np.concatenate([faces, more])
        point, face = np.repeat(point, _LEAF), self._leaves[node].ravel()
        squared, doubt = self._squared_distances(points[point], face)
        farthest = np.minimum.reduceat(squared + doubt, np.searchsorted(point, np.arange(k)))
        keep = squared - doubt <= _widen(farthest)[point]
        return point[keep], face[keep]

    def _first_guess(self, points: Array) -> Array:
        """A squared distance (k,) within which some triangle lies: that to the leaf that lies down the nearer boxes."""
        node = np.zeros(len(points), dtype=int)
        for low, high in self._boxes[1:]:
            children = 2 * node[:, None] + [0, 1]
            gap = _squared_gap(points[:, None], low[children], high[children])
            centre = ((points[:, None] - (low[children] + high[children]) / 2) ** 2).sum(axis=2)
            nearer = np.where(gap[:, 0] == gap[:, 1], centre[:, 1] < centre[:, 0], gap[:, 1] < gap[:, 0])
            node = 2 * node + nearer
        squared, doubt = self._squared_distances(np.repeat(points, _LEAF, axis=0), self._leaves[node].ravel())
        return _widen((squared + doubt).reshape(-1, _LEAF).min(axis=1))

    def _squared_distances(self, points: Array, face: IntArray) -> tuple[Array, Array]:
        """Squared distances (p,) of points (p, 3) from one triangle each, and how far rounding may put them off."""
        rows, squares = self._rows[face], self._squares[face]
        offset = points - self.corners[face, 0]
        along_ab, along_ac, height, beta, gamma = np.einsum("pij,pj->ip", rows, offset)
        ab2, ac2, mixed = squares.T
        reach = np.einsum("pi,pi->p", offset, offset)
        bc2 = ab2 + ac2 - 2 * mixed
        along_bc = along_ac - along_ab - mixed + ab2
        on_edges = [(reach, along_ab, ab2), (reach, along_ac, ac2), (reach - 2 * along_ab + ab2, along_bc, bc2)]
        nearest = np.full(len(points), np.inf)
        for start, along, length2 in on_edges:
            t = np.clip(along / np.maximum(length2, _TINY), 0.0, 1.0)
            nearest = np.minimum(nearest, start + t * (t * length2 - 2 * along))
        within = (beta > 0) & (gamma > 0) & (beta + gamma < 1)
        return np.maximum(np.where(within, height**2, nearest), 0.0), 1e-14 * (reach + ab2 + ac2)

    def winding_number(self, points: Array) -> Array:
        """How often the surface surrounds each point (k,): 1 inside, 0 outside, to rounding.

        The solid angles of all triangles over 4 pi: A. van Oosterom and J. Strackee, The Solid Angle of a Plane
        Triangle, IEEE Trans. Biomed. Eng. 30(2), 1983.
        """
        turns = np.empty(len(points))
        for i, point in enumerate(points):
            a, b, c = np.moveaxis(self.corners - point, 1, 0)
            la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
            across = (a * cross(b, c)).sum(axis=1)
            along = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
            turns[i] = np.arctan2(across, along).sum() / (2 * np.pi)
        return turns

    def curvature(self, surface: Array, outward: Array, radius: float) -> tuple[Array, Array]:
        """Principal curvatures (k, 2), smaller first, and the direction of the first (k, 3), at points of the surface.

        A quadratic z = z0 + b x + c y + (l x^2 + 2 m x y + n y^2) / 2 over the tangent plane is fitted to the part of
        the surface within ``radius``, its weight falling smoothly to zero there; what faces more than 60 degrees away
        is left out. NaN where nothing is left to fit: at sharp edges and tips.
        """
        curvatures, directions = np.full((len(surface), 2), np.nan), np.full((len(surface), 3), np.nan)
        near = [
            np.flatnonzero((_squared_gap(centre, self._low, self._high) < radius**2) & (self.normals @ normal > 0.5))
            for centre, normal in zip(surface, outward)
        ]
        owner: IntArray = np.repeat(np.arange(len(near)), [len(own) for own in near])
        corners = self.corners[np.concatenate([np.zeros(0, dtype=int), *near])]
        cut, owner = _pieces((corners - surface[owner, None]) / radius, owner)
        area = np.linalg.norm(cross(cut[:, 1] - cut[:, 0], cut[:, 2] - cut[:, 0]), axis=1)
        # The rule of the three middles of the edges is exact for quadratics.
        middles = 0.5 * (cut + np.roll(cut, -1, axis=1))
        weights = area[:, None] * np.maximum(1 - (middles**2).sum(axis=2), 0.0) ** 2
        for i, (normal, across) in enumerate(zip(outward, tangents(outward))):
            points, weight = middles[owner == i].reshape(-1, 3), weights[owner == i].ravel()
            (x, y), z = (points @ across).T, points @ normal
            terms = np.column_stack([np.ones_like(x), x, y, x**2 / 2, x * y, y**2 / 2])
            weighted = weight[:, None] * terms
            gram = weighted.T @ terms
            size = np.linalg.eigvalsh(gram)
            if not size[0] > _SINGULAR * size[-1]:
                continue
            _, b, c, l, m, n = np.linalg.solve(gram, weighted.T @ z)
            lift = np.array([[1, 0], [0, 1], [b, c]])
            # An orthonormal basis of the fit's tangent plane: lift @ basis has unit, perpendicular columns.
            basis = np.linalg.inv(np.linalg.cholesky(lift.T @ lift)).T
            second = np.array([[l, m], [m, n]]) / np.sqrt(1 + b * b + c * c)
            values, vectors = np.linalg.eigh(-basis.T @ second @ basis)
            curvatures[i] = values / radius
            first = across @ (basis @ vectors[:, 0])
            directions[i] = first / np.linalg.norm(first)
        return curvatures, directions


def _widen(squared: Array) -> Array:
    """Squares of the distances with NO_DIRECTION added."""
    widened: Array = (np.sqrt(squared) + NO_DIRECTION) ** 2
    return widened


def _squared_gap(points: Array, low: Array, high: Array) -> Array:
    """Squared distance (...,) of points from axis-aligned boxes."""
    gap: Array = (np.maximum(np.maximum(low - points, points - high), 0.0) ** 2).sum(axis=-1)
    return gap


def _nearest_on(points: Array, corners: Array) -> tuple[Array, IntArray]:
    """Nearest point (p, 3) of each triangle (p, 3, 3) and where it lies (p,): 0 the face, 1-3 an edge, 4-6 a corner."""
    best, feature, least = np.empty_like(points), np.zeros(len(points), dtype=int), np.full(len(points), np.inf)
    for i, j in _EDGES:
        start, side = corners[:, i], corners[:, j] - corners[:, i]
        length2 = (side**2).sum(axis=1)
        along = ((points - start) * side).sum(axis=1) / np.where(length2 > 0, length2, 1.0)
        along = np.clip(along, 0.0, 1.0)
        # From the end at 1, the end itself: start + side may be off by rounding.
        at = np.where(along[:, None] == 1, corners[:, j], start + along[:, None] * side)
        squared = ((at - points) ** 2).sum(axis=1)
        nearer = squared < least
        best[nearer], least[nearer] = at[nearer], squared[nearer]
        feature[nearer] = np.where(along == 0, 4 + i, np.where(along == 1, 4 + j, 1 + i))[nearer]
    ab, ac, ap = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = cross(ab, ac)
    square = (normal**2).sum(axis=1)
    safe = np.where(square > 0, square, 1.0)
    beta = (cross(ap, ac) * normal).sum(axis=1) / safe
    gamma = (cross(ab, ap) * normal).sum(axis=1) / safe
    within = (beta > 0) & (gamma > 0) & (beta + gamma < 1)
    foot = points - ((ap * normal).sum(axis=1) / safe)[:, None] * normal
    # In a needle, rounding must not make the foot worse than the edges.
    within &= ((foot - points) ** 2).sum(axis=1) <= least
    best[within], feature[within] = foot[within], 0
    return best, feature


def _feature_at(points: Array, corners: Array) -> IntArray:
    """Where points (p, 3) on triangles (p, 3, 3) lie, as :func:`_nearest_on` numbers it, to within NO_DIRECTION."""
    feature = np.zeros(len(points), dtype=int)
    for n, (i, j) in enumerate(_EDGES):
        side = corners[:, j] - corners[:, i]
        off = np.linalg.norm(cross(points - corners[:, i], side), axis=1)
        feature[off <= NO_DIRECTION * np.linalg.norm(side, axis=1)] = 1 + n
    for i in range(3):
        feature[np.linalg.norm(points - corners[:, i], axis=1) <= NO_DIRECTION] = 4 + i
    return feature


def _pieces(corners: Array, owner: IntArray) -> tuple[Array, IntArray]:
    """Triangles (p, 3, 3) cut at their longest edges until none is too long, without those off the unit ball;
    and whose each is, of the triangles' owners (p,).
    """
    done, owners = [np.zeros((0, 3, 3))], [np.zeros(0, dtype=int)]
    a, b, c = np.moveaxis(corners, 1, 0)
    while len(a):
        # Corner by corner: reductions over three of them cost several times as much.
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        gap = np.maximum(np.maximum(low, -high), 0.0)
        inside = np.einsum("pi,pi->p", gap, gap) < 1
        ends, owner = np.array([a[inside], b[inside], c[inside]]), owner[inside]
        sides = ends[[1, 2, 0]] - ends
        squared = np.einsum("kpi,kpi->kp", sides, sides)
        longest = squared.argmax(axis=0)
        each = np.arange(len(longest))
        small = squared[longest, each] <= _LONGEST**2
        done.append(ends[:, small].transpose(1, 0, 2))
        owners.append(owner[small])
        a, b, c = (ends[(longest + k) % 3, each][~small] for k in range(3))
        middle = (a + b) / 2
        a, b, c = np.concatenate([a, middle]), np.concatenate([middle, b]), np.concatenate([c, c])
        owner = np.tile(owner[~small], 2)
    return np.concatenate(done), np.concatenate(owners)
