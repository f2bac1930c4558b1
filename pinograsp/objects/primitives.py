"""Spheres, cylinders, capsules and boxes. Their frame is in their middle; axes of revolution are its z axis."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from pinograsp.checks import array_of, brief
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import NO_DIRECTION, Primitive, tangents
from pinograsp.spatial import Array

if TYPE_CHECKING:
    import coal
    from numpy.typing import ArrayLike
    from typing_extensions import Unpack

    from pinograsp.objects.body import PrimitiveArguments


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sphere(Primitive):
    """A solid sphere.

    Attributes:
        radius: [m].
        mass, density, pose, shape_b: see :class:`~pinograsp.objects.body.Primitive`.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> place = pg.spatial.pose_of([0.4, 0.0, 0.1], np.eye(3))
        >>> ball = pg.Sphere(radius=0.03, mass=0.2).placed(place)
        >>> print(ball.com_o, f"{ball.density:.0f} kg/m^3")
        [0.4 0.  0.1] 1768 kg/m^3

    See Also:
        :class:`~pinograsp.objects.Ellipsoid`, :class:`~pinograsp.objects.Mesh`.
    """

    radius: float

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(self, *, radius: float, **body: Unpack[PrimitiveArguments]) -> None: ...

    __repr__ = brief()

    def _check_shape(self) -> None:
        self._check_lengths("radius")

    @property
    def volume(self) -> float:
        """[m^3]."""
        return 4 / 3 * pi * self.radius * self.radius * self.radius

    @property
    def _inertia_per_mass(self) -> Array:
        return 0.4 * self.radius**2 * np.eye(3)

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return self.radius

    @property
    def collision_geometry(self) -> coal.Sphere:
        """A ``coal.Sphere`` in the shape's own frame."""
        import coal

        return coal.Sphere(self.radius)

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        radial = np.linalg.norm(local, axis=1)
        self._refuse(
            radial < NO_DIRECTION,
            local,
            "a point at the sphere's centre has no nearest surface point: move it to the surface",
        )
        outward = local / radial[:, None]
        return self.radius * outward, outward, radial - self.radius

    def _curvature_s(self, surface: Array, outward: Array) -> tuple[Array, Array]:
        return np.full((len(surface), 2), 1 / self.radius), tangents(outward)[:, :, 0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cylinder(Primitive):
    """A solid cylinder about its body z axis.

    Attributes:
        radius: [m].
        height: [m].
        mass, density, pose, shape_b: see :class:`~pinograsp.objects.body.Primitive`; the body
            frame is half-way up.

    Example:
        >>> import pinograsp as pg
        >>> can = pg.Cylinder(radius=0.03, height=0.12, mass=0.25)
        >>> points, normals, distances = can.project([[0.05, 0.0, 0.02]])  # onto the surface
        >>> print(points.round(3), normals.round(3), distances.round(3))
        [[0.03 0.   0.02]] [[-1.  0.  0.]] [0.02]

    See Also:
        :class:`~pinograsp.objects.Capsule`, :class:`~pinograsp.objects.Box`, :class:`~pinograsp.objects.Mesh`.
    """

    radius: float
    height: float

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(self, *, radius: float, height: float, **body: Unpack[PrimitiveArguments]) -> None: ...

    __repr__ = brief()

    def _check_shape(self) -> None:
        self._check_lengths("radius", "height")

    @property
    def volume(self) -> float:
        """[m^3]."""
        return pi * self.radius * self.radius * self.height

    @property
    def _inertia_per_mass(self) -> Array:
        across = (3 * self.radius**2 + self.height**2) / 12
        return np.diag([across, across, self.radius**2 / 2])

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return float(np.hypot(self.radius, self.height / 2))

    @property
    def collision_geometry(self) -> coal.Cylinder:
        """A ``coal.Cylinder`` in the shape's own frame."""
        import coal

        return coal.Cylinder(self.radius, self.height)

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        radial = np.linalg.norm(local[:, :2], axis=1)
        beyond_side, beyond_cap = radial - self.radius, np.abs(local[:, 2]) - self.height / 2
        on_side = beyond_side >= beyond_cap
        self._refuse(
            (radial < NO_DIRECTION) & on_side,
            local,
            "a point on the cylinder's axis has no nearest side point: move it to the surface",
        )
        self._refuse(
            (np.abs(local[:, 2]) < NO_DIRECTION) & ~on_side,
            local,
            "a point half-way between the cylinder's caps has no nearest cap: move it to the surface",
        )
        outward = np.zeros_like(local)
        outward[:, :2] = local[:, :2] / np.maximum(radial, NO_DIRECTION)[:, None]
        cap = np.column_stack([0 * radial, 0 * radial, np.where(local[:, 2] < 0, -1.0, 1.0)])
        rim = (beyond_side > 0) & (beyond_cap > 0)
        distance = np.where(rim, np.hypot(beyond_side, beyond_cap), np.maximum(beyond_side, beyond_cap))
        normal = np.where(on_side[:, None], outward, cap)
        # The quotient blends the side's and the cap's directions in proportion to how far the point is beyond each.
        blend = beyond_side[:, None] * outward + beyond_cap[:, None] * cap
        normal = np.where(rim[:, None], blend / np.where(rim, distance, 1.0)[:, None], normal)
        at_rim = np.maximum(np.abs(beyond_side), np.abs(beyond_cap)) <= NO_DIRECTION
        normal = np.where(at_rim[:, None], (outward + cap) / np.sqrt(2), normal)
        return local - distance[:, None] * normal, normal, distance

    def _curvature_s(self, surface: Array, outward: Array) -> tuple[Array, Array]:
        beyond_side = np.linalg.norm(surface[:, :2], axis=1) - self.radius
        beyond_cap = np.abs(surface[:, 2]) - self.height / 2
        self._refuse(
            np.minimum(beyond_side, beyond_cap) > -NO_DIRECTION,
            surface,
            "the cylinder's rim has no finite curvature: move the point off the rim",
        )
        side = beyond_side > beyond_cap
        curvatures = np.zeros((len(surface), 2))
        curvatures[side, 1] = 1 / self.radius
        return curvatures, np.where(side[:, None], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Capsule(Primitive):
    """A solid cylinder about its body z axis with a half-sphere on each end.

    Attributes:
        radius: [m].
        length: of the cylindrical part, between the centres of the half-spheres [m].
        mass, density, pose, shape_b: see :class:`~pinograsp.objects.body.Primitive`.

    Example:
        >>> import pinograsp as pg
        >>> handle = pg.Capsule(radius=0.015, length=0.08, mass=0.1)
        >>> print(f"{handle.density:.0f} kg/m^3, reaches {1e3 * handle.bounding_radius:.0f} mm")
        1415 kg/m^3, reaches 55 mm

    See Also:
        :class:`~pinograsp.objects.Cylinder`, :class:`~pinograsp.objects.Ellipsoid`.
    """

    radius: float
    length: float

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(self, *, radius: float, length: float, **body: Unpack[PrimitiveArguments]) -> None: ...

    __repr__ = brief()

    def _check_shape(self) -> None:
        self._check_lengths("radius", "length")

    @property
    def volume(self) -> float:
        """[m^3]."""
        return pi * self.radius * self.radius * (self.length + 4 / 3 * self.radius)

    @property
    def _inertia_per_mass(self) -> Array:
        r, l = self.radius, self.length
        middle = l / (l + 4 / 3 * r)  # the cylindrical part's share of the volume
        across = middle * (3 * r**2 + l**2) / 12 + (1 - middle) * (0.4 * r**2 + l**2 / 4 + 3 / 8 * l * r)
        return np.diag([across, across, middle * r**2 / 2 + (1 - middle) * 0.4 * r**2])

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return self.length / 2 + self.radius

    @property
    def collision_geometry(self) -> coal.Capsule:
        """A ``coal.Capsule`` in the shape's own frame."""
        import coal

        return coal.Capsule(self.radius, self.length)

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        axis = np.zeros_like(local)
        axis[:, 2] = np.clip(local[:, 2], -self.length / 2, self.length / 2)
        radial = np.linalg.norm(local - axis, axis=1)
        self._refuse(
            radial < NO_DIRECTION,
            local,
            "a point on the capsule's axis has no nearest surface point: move it to the surface",
        )
        outward = (local - axis) / radial[:, None]
        return axis + self.radius * outward, outward, radial - self.radius

    def _curvature_s(self, surface: Array, outward: Array) -> tuple[Array, Array]:
        side = np.abs(surface[:, 2]) <= self.length / 2
        curvatures = np.full((len(surface), 2), 1 / self.radius)
        curvatures[side, 0] = 0.0
        return curvatures, np.where(side[:, None], [0.0, 0.0, 1.0], tangents(outward)[:, :, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box(Primitive):
    """A solid box along the body axes.

    Attributes:
        size: full edge lengths (3,) [m].
        mass, density, pose, shape_b: see :class:`~pinograsp.objects.body.Primitive`.

    Example:
        >>> import pinograsp as pg
        >>> box = pg.Box(size=(0.04, 0.06, 0.1), density=500.0)
        >>> print(f"{box.mass:.2f} kg, reaches {1e3 * box.bounding_radius:.0f} mm")
        0.12 kg, reaches 62 mm

    See Also:
        :class:`~pinograsp.objects.Cylinder`, :class:`~pinograsp.objects.Sphere`, :class:`~pinograsp.objects.Mesh`;
        :func:`~pinograsp.objects.object_from` makes shapes from text.
    """

    size: Array

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(self, *, size: ArrayLike, **body: Unpack[PrimitiveArguments]) -> None: ...

    __repr__ = brief()

    def _check_shape(self) -> None:
        self._set(size=positive_lengths("box size", self.size))

    @property
    def volume(self) -> float:
        """[m^3]."""
        return float(np.prod(self.size))

    @property
    def _inertia_per_mass(self) -> Array:
        squares = self.size**2
        return np.diag(squares.sum() - squares) / 12

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return float(np.linalg.norm(self.size) / 2)

    @property
    def collision_geometry(self) -> coal.Box:
        """A ``coal.Box`` in the shape's own frame."""
        import coal

        return coal.Box(*self.size)

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        half, each = self.size / 2, np.arange(len(local))
        beyond = np.abs(local) - half
        axis = beyond.argmax(axis=1)
        inside = beyond[each, axis] <= 0
        self._refuse(
            inside & (np.abs(local[each, axis]) < NO_DIRECTION),
            local,
            "a point half-way between two faces of the box has no nearest face: move it to the surface",
        )
        face = np.zeros_like(local)
        face[each, axis] = np.where(local[each, axis] < 0, -1.0, 1.0)
        gap = np.maximum(beyond, 0.0) * np.sign(local)
        distance = np.where(inside, beyond[each, axis], np.linalg.norm(gap, axis=1))
        outward = np.where(inside[:, None], face, gap / np.where(inside, 1.0, distance)[:, None])
        here = np.abs(beyond) <= NO_DIRECTION
        at_edge = (here.sum(axis=1) > 1) & (beyond <= NO_DIRECTION).all(axis=1)
        outward[at_edge] = (here * np.where(local < 0, -1.0, 1.0))[at_edge] / np.sqrt(here[at_edge].sum(axis=1))[
            :, None
        ]
        surface = np.clip(local, -half, half)
        surface[each[inside], axis[inside]] = (face * half)[inside, axis[inside]]
        return surface, outward, distance

    def _curvature_s(self, surface: Array, outward: Array) -> tuple[Array, Array]:
        on_faces = np.abs(surface) > self.size / 2 - NO_DIRECTION
        self._refuse(
            on_faces.sum(axis=1) > 1,
            surface,
            "the edges and corners of the box have no finite curvature: move the point off the edge",
        )
        # Along the first body axis that lies in the face.
        return np.zeros((len(surface), 2)), np.eye(3)[on_faces.argmin(axis=1)]


def positive_lengths(name: str, value: object) -> Array:
    """Three lengths > 0 (3,) [m], or :class:`InvalidInput`."""
    lengths = array_of(name, value, (3,))
    if np.any(lengths <= 0):
        raise InvalidInput(f"{name}: expected three lengths > 0 [m], got {lengths.tolist()}")
    return lengths
