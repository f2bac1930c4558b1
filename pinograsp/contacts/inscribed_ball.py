"""The largest ball about the origin inside a convex set that is known by its support points only.

A simplicial polytope grows inside the set (Zheng, "An efficient algorithm for a grasp quality measure", IEEE
Transactions on Robotics 29(2), 2013): its facet nearest to the origin bounds the radius from below, the support value
of the set along that facet's normal bounds it from above, and where they differ the support point is added. The
polytope is grown about a point of its own interior, so that the origin may lie inside, outside or on the boundary.

Why the lower bound is safe although planes are rounded: every facet f is kept with a unit normal y_f and the *least*
y_f . v of its vertices, b_f. The facets are a closed surface around the interior point: one that a new point sees is
replaced by the cone from the point over its rim, which stays on the far side of y_f . x = b_f. So the surface never
enters the convex set {x : y_f . x < b_f for all f}, and that set, with the ball of radius min b_f, lies inside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import array_of, brief, integer, number, read_only
from pinograsp.spatial import Array, IntArray

# Distances below this share of the set's size count as zero: above the rounding of planes through badly placed points.
_FLAT = 1e-11
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InscribedBall:
    """Bounds of the radius of the largest origin-centred ball in a convex set; in the set's unit.

    Attributes:
        lower: a ball of this radius is inside; 0 where the origin is not strictly inside.
        upper: no larger ball is inside: the set's support value along ``direction``.
        direction: unit vector (d,) towards the nearest boundary found; where the radius is 0 the set has no point
            beyond the plane through the origin with this normal.
        converged: whether ``upper - lower`` is within the tolerance.
        points: support points the inner polytope was made of.
    """

    lower: float
    upper: float
    direction: Array
    converged: bool
    points: int

    __repr__ = brief()

    @property
    def radius(self) -> float:
        """The certified radius, ``lower``."""
        return self.lower


def inscribed_ball(
    support_point: Callable[[Array], Array],
    dimension: int,
    *,
    tolerance: float = 1e-6,
    floor: float = 0.0,
    limit: int = 300_000,
) -> InscribedBall:
    """The largest ball about the origin in a convex compact set W.

    Args:
        support_point: maps a unit direction y (d,) to a point w (d,) of W that maximises y . w.
        dimension: d.
        tolerance: relative gap ``(upper - lower) / upper`` to reach [-]. Gaps below 1e-11 of the set's size are always
            taken as closed, and a set thinner than that as flat.
        floor: gap that is fine whatever the radius, in the set's unit: a smooth set whose boundary passes near the
            origin needs no end of facets for a relative gap.
        limit: facets, and points, that the inner polytope may have. A smooth set needs many at a fine tolerance; at the
            limit the bounds reached are returned with ``converged=False``. 300 000 facets in 6-D take some 5 s, 100 MB.

    Returns:
        Bounds with lower <= radius <= upper up to the rounding of a dot product. W may be flat or leave the origin
        out: then both are 0, and ``direction`` separates.

    Raises:
        InvalidInput: settings that cannot be used, or a support point that is not d finite numbers.
    """
    d = integer("dimension", dimension, at_least=1)
    tolerance = number("tolerance", tolerance, at_least=0)
    floor = number("floor", floor, at_least=0)
    limit = integer("limit of facets", limit, at_least=d + 1)

    lower, upper, direction = 0.0, np.inf, np.eye(d)[0]

    def ask(y: Array) -> Array:
        nonlocal upper, direction
        point = array_of("support point", support_point(y), (d,))
        if y @ point < upper:
            upper, direction = float(y @ point), y.copy()
        return point

    simplex, size, flat = _start(ask, d)
    rounding = 8 * d * _EPS * size
    if flat is not None or upper <= rounding:
        flat = direction if flat is None else flat
        return InscribedBall(lower=0.0, upper=0.0, direction=read_only(flat), converged=True, points=len(simplex))
    polytope = Polytope(simplex, _FLAT * size)
    while True:
        facet = polytope.nearest()
        y, inner = polytope.normals[facet], polytope.offsets[facet]
        lower = max(lower, inner - rounding) if polytope.sound else 0.0
        point = ask(y)
        outer = float(y @ point)
        if upper <= rounding:
            lower = upper = 0.0
            break
        enough = max(tolerance * upper, floor, _FLAT * size)
        # A facet whose own highest vertex is the support point cannot be moved outwards.
        if upper - lower <= enough or outer - polytope.highest(facet) <= _FLAT * size:
            break
        if not polytope.sound or max(len(polytope), len(polytope.points)) > limit or not polytope.add(point):
            break
    upper = upper + rounding if upper > 0 else 0.0
    return InscribedBall(
        lower=float(lower),
        upper=float(upper),
        direction=read_only(direction),
        converged=bool(upper - lower <= max(tolerance * upper, floor, 2 * _FLAT * size)),
        points=len(polytope.points),
    )


def _start(ask: Callable[[Array], Array], d: int) -> tuple[Array, float, Array | None]:
    """d + 1 support points far apart, the size of the set, and a separating direction if the set is flat."""
    axes = np.vstack([np.eye(d), -np.eye(d)])
    probes = np.array([ask(y) for y in axes])
    size = float(np.linalg.norm(probes, axis=1).max())
    simplex = probes[[np.argmax(np.linalg.norm(probes, axis=1))]]
    if size == 0:
        return simplex, size, axes[0]
    while len(simplex) <= d:
        # Directions across the affine hull so far; the farthest support point along one of them joins.
        across = np.linalg.svd(simplex[1:] - simplex[0])[2][len(simplex) - 1 :] if len(simplex) > 1 else np.eye(d)
        across = np.vstack([across, -across])
        found = np.array([ask(y) for y in across])
        height = np.einsum("ij,ij->i", across, found - simplex[0])
        best = int(np.argmax(height))
        if height[best] <= _FLAT * size:
            basis = across[: len(across) // 2]
            away = -basis.T @ (basis @ simplex[0])
            distance = np.linalg.norm(away)
            return simplex, size, away / distance if distance > _FLAT * size else basis[0]
        simplex = np.vstack([simplex, found[best]])
        size = max(size, float(np.linalg.norm(found, axis=1).max()))
    return simplex, size, None


class Polytope:
    """A closed simplicial surface around ``centre`` that grows by the points it is given.

    ``facets`` (n, d) are numbers of ``points``, ascending; ``normals`` (n, d) point outwards and have unit length;
    ``offsets`` (n,) are the least component along the normal of a facet's vertices. Rows ``vacant`` hold no facet,
    their offset is infinite. ``sound`` says that the planes leave the centre inside, in spite of rounding.
    """

    def __init__(self, simplex: Array, flat: float):
        d = simplex.shape[1]
        self.flat = flat
        self.centre = simplex.mean(axis=0)
        self.points = simplex
        self.rims = np.array([[j for j in range(d) if j != i] for i in range(d)], dtype=np.int64).reshape(d, d - 1)
        self.facets = np.array([[j for j in range(d + 1) if j != i] for i in range(d + 1)], dtype=np.int64)
        self.normals, self.offsets = self.planes(self.points, self.facets)
        self.sound = bool(np.all(self.offsets > self.normals @ self.centre))
        self.vacant = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.facets) - len(self.vacant)

    def nearest(self) -> int:
        """The facet with the least offset."""
        return int(np.argmin(self.offsets))

    def highest(self, facet: int) -> float:
        """The greatest component of a facet's vertices along its normal: the offset, up to rounding."""
        return float((self.points[self.facets[facet]] @ self.normals[facet]).max())

    def add(self, point: Array) -> bool:
        """Grow to ``point``; False, and nothing is changed, if it is seen by no facet or would spoil the surface."""
        d = len(point)
        seen = np.flatnonzero(self.normals @ point > self.offsets + self.flat)
        ridges = self.facets[seen][:, self.rims].reshape(len(seen) * d, d - 1)
        base = len(self.points)
        if base ** (d - 1) < 2**63:
            keys = ridges @ base ** np.arange(d - 1, dtype=np.int64)
            _, first, count = np.unique(keys, return_index=True, return_counts=True)
        else:
            _, first, count = np.unique(ridges, axis=0, return_index=True, return_counts=True)
        # The rim of the seen region: ridges that an odd number of seen facets have.
        rim = ridges[first[count % 2 == 1]]
        facets = np.column_stack([rim, np.full(len(rim), base, dtype=np.int64)])
        points = np.vstack([self.points, point])
        normals, offsets = self.planes(points, facets)
        if len(seen) == 0 or not np.all(offsets > normals @ self.centre):  # also catches nan
            return False
        self.points = points
        rows = self._rows(seen, len(facets))
        self.facets[rows], self.normals[rows], self.offsets[rows] = facets, normals, offsets
        return True

    def _rows(self, freed: IntArray, need: int) -> IntArray:
        """Free the rows of facets that are gone and hand out ``need`` rows; copying all facets would cost the most."""
        self.normals[freed], self.offsets[freed] = 0.0, np.inf
        vacant = np.concatenate([self.vacant, freed])
        if need > len(vacant):
            n = len(self.facets)
            more = max(need - len(vacant), n)
            self.facets = np.concatenate([self.facets, np.zeros((more, self.facets.shape[1]), dtype=np.int64)])
            self.normals = np.concatenate([self.normals, np.zeros((more, self.normals.shape[1]))])
            self.offsets = np.concatenate([self.offsets, np.full(more, np.inf)])
            vacant = np.concatenate([vacant, np.arange(n, n + more)])
        self.vacant = vacant[need:]
        return vacant[:need]

    def planes(self, points: Array, facets: IntArray) -> tuple[Array, Array]:
        """Unit normals (m, d) away from the centre and offsets (m,) of facets (m, d)."""
        corners = points[facets]
        spokes = corners - self.centre
        ones = np.ones((*facets.shape, 1))
        try:
            normals = np.linalg.solve(spokes, ones)[..., 0]
        except np.linalg.LinAlgError:  # for facets without extent any plane through them will do
            flat, normals = np.linalg.slogdet(spokes)[0] == 0, np.zeros(facets.shape)
            normals[~flat] = np.linalg.solve(spokes[~flat], ones[~flat])[..., 0]
            normals[flat] = np.linalg.pinv(spokes[flat]).sum(axis=2)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals, np.einsum("mvd,md->mv", corners, normals).min(axis=1)
