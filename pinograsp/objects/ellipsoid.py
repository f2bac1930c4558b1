"""Ellipsoids: the nearest surface point from one equation in one unknown."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from pinograsp.checks import brief
from pinograsp.objects.body import NO_DIRECTION, Primitive, tangents
from pinograsp.objects.primitives import positive_lengths
from pinograsp.spatial import Array, BoolArray

if TYPE_CHECKING:
    import coal
    from numpy.typing import ArrayLike
    from typing_extensions import Unpack

    from pinograsp.objects.body import PrimitiveArguments

# Newton's method converges from one side on every input; the slowest ones seen need about 40 steps.
_MOST_STEPS = 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipsoid(Primitive):
    """A solid ellipsoid along the body axes.

    Attributes:
        semi_axes: (3,) along the body's x, y and z [m].
        mass, density, pose, shape_b: see :class:`~pinograsp.objects.body.Primitive`.

    Example:
        >>> import pinograsp as pg
        >>> egg = pg.Ellipsoid(semi_axes=(0.02, 0.02, 0.03), density=1000.0)
        >>> print(f"{1e3 * egg.mass:.1f} g")
        50.3 g

    See Also:
        :class:`~pinograsp.objects.Sphere`, :class:`~pinograsp.objects.Capsule`.
    """

    semi_axes: Array

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(self, *, semi_axes: ArrayLike, **body: Unpack[PrimitiveArguments]) -> None: ...

    __repr__ = brief()

    def _check_shape(self) -> None:
        self._set(semi_axes=positive_lengths("ellipsoid semi_axes", self.semi_axes))

    @property
    def volume(self) -> float:
        """[m^3]."""
        return float(4 / 3 * pi * np.prod(self.semi_axes))

    @property
    def _inertia_per_mass(self) -> Array:
        squares = self.semi_axes**2
        return np.diag(squares.sum() - squares) / 5

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return float(self.semi_axes.max())

    @property
    def collision_geometry(self) -> coal.Ellipsoid:
        """A ``coal.Ellipsoid`` in the shape's own frame."""
        import coal

        return coal.Ellipsoid(*self.semi_axes)

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        """The nearest point is x_i = e_i^2 y_i / (e_i^2 + t), where t > -e_min^2 puts it on the surface.

        After D. Eberly, Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid (Geometric Tools, 2013).
        Unlike there, the unknown is u = (t + e_min^2) / e_min^2, which keeps its digits where t comes near the pole,
        and Newton's method solves 1 / |p(u)| = 1 with p_i = x_i / e_i: its left side is concave and increasing, so the
        steps from the left never overshoot.
        """
        e = self.semi_axes
        least = e.min()
        extra = (e - least) * (e + least) / least**2  # e_i^2 / e_min^2 - 1
        self._refuse(
            self._between_two_sides(local, extra),
            local,
            "a point between two opposite sides of the ellipsoid has no nearest surface point: move it to the surface",
        )
        reach = (1 + extra) * np.abs(local) / e  # p_i = reach_i / (u + extra_i)
        u, p = np.maximum((reach - extra).max(axis=1, initial=0.0), 0.0), reach
        for _ in range(_MOST_STEPS):
            width = u[:, None] + extra
            p = np.divide(reach, width, out=np.zeros_like(reach), where=reach > 0)
            squared = (p**2).sum(axis=1)
            miss = np.sqrt(squared) - 1
            if np.all(np.abs(miss) <= 1e-15):
                break
            slope = np.divide(p**2, width, out=np.zeros_like(p), where=reach > 0).sum(axis=1)
            u = u + squared * miss / slope
        gradient = p / e
        steepness = np.linalg.norm(gradient, axis=1)
        outward = np.copysign(gradient, local) / steepness[:, None]
        # y - x = (u - 1) e_min^2 x / e^2: along the normal, with the sign of u - 1.
        return np.copysign(p * e, local), outward, (u - 1) * least**2 * steepness

    def _between_two_sides(self, local: Array, extra: Array) -> BoolArray:
        """Whether points (k, 3) lie on the ellipse, across the shortest semi-axis, that is as near to both sides."""
        e = self.semi_axes
        shortest = e.argmin()
        focal = np.maximum(extra * e.min() ** 2 / e, np.finfo(float).tiny)  # its semi-axes; a point on a sphere
        off = np.maximum(np.abs(local) - NO_DIRECTION, 0.0)
        on_plane = off[:, shortest] == 0
        off[:, shortest] = 0.0
        with np.errstate(over="ignore"):
            between: BoolArray = on_plane & (np.linalg.norm(off / focal, axis=1) <= 1)
        return between

    def _curvature_s(self, surface: Array, outward: Array) -> tuple[Array, Array]:
        across = tangents(outward)
        steepness = np.linalg.norm(surface / self.semi_axes**2, axis=1)
        form = np.einsum("kia,i,kib->kab", across, 1 / self.semi_axes**2, across) / steepness[:, None, None]
        curvatures, directions = np.linalg.eigh(form)
        return curvatures, np.einsum("kia,ka->ki", across, directions[:, :, 0])
