"""Solid primitives. The body frame b sits at the centre of mass; the cylinder's axis is its z axis."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pinograsp.checks import array_of, number, read_only
from pinograsp.errors import InvalidInput

# Nearer than this to a centre or an axis [m], no direction to the surface is preferred over another.
_NO_DIRECTION = 1e-9


def _checked_pose(pose) -> np.ndarray:
    pose = array_of("pose", pose, (4, 4))
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise InvalidInput("pose: expected a homogeneous placement with an orthonormal right-handed rotation")
    return pose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sphere:
    """A solid sphere.

    Attributes:
        radius: [m].
        mass: [kg].
        pose: oMb (4, 4), the body frame (at the centre of mass) in the world [m].
    """

    radius: float
    mass: float
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self):
        object.__setattr__(self, "radius", number("sphere radius", self.radius, above=0, unit="m"))
        object.__setattr__(self, "mass", number("sphere mass", self.mass, above=0, unit="kg"))
        object.__setattr__(self, "pose", _checked_pose(self.pose))

    @property
    def com_o(self) -> np.ndarray:
        """Centre of mass (3,) in the world [m]."""
        return self.pose[:3, 3]

    @property
    def inertia_b(self) -> np.ndarray:
        """Rotational inertia (3, 3) about the centre of mass, body axes [kg m^2]."""
        return read_only(0.4 * self.mass * self.radius**2 * np.eye(3))

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return self.radius

    def project(self, points_o) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nearest surface points (k, 3) [m], inward unit normals (k, 3) and signed distances (k,) [m].

        The distance is negative inside. Raises :class:`InvalidInput` at the centre, where no normal is defined.
        """
        offset = array_of("points", points_o, (None, 3)) - self.com_o
        radial = np.linalg.norm(offset, axis=1)
        if np.any(radial < _NO_DIRECTION):
            raise InvalidInput("a point at the sphere's centre has no nearest surface point: move it to the surface")
        normals = -offset / radial[:, None]
        return self.com_o - self.radius * normals, normals, radial - self.radius


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cylinder:
    """A solid cylinder about its body z axis.

    Attributes:
        radius: [m].
        height: [m].
        mass: [kg].
        pose: oMb (4, 4), the body frame (at the centre of mass, half-way up) in the world [m].
    """

    radius: float
    height: float
    mass: float
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self):
        object.__setattr__(self, "radius", number("cylinder radius", self.radius, above=0, unit="m"))
        object.__setattr__(self, "height", number("cylinder height", self.height, above=0, unit="m"))
        object.__setattr__(self, "mass", number("cylinder mass", self.mass, above=0, unit="kg"))
        object.__setattr__(self, "pose", _checked_pose(self.pose))

    @property
    def com_o(self) -> np.ndarray:
        """Centre of mass (3,) in the world [m]."""
        return self.pose[:3, 3]

    @property
    def inertia_b(self) -> np.ndarray:
        """Rotational inertia (3, 3) about the centre of mass, body axes [kg m^2]."""
        across = self.mass * (3 * self.radius**2 + self.height**2) / 12
        return read_only(np.diag([across, across, self.mass * self.radius**2 / 2]))

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return float(np.hypot(self.radius, self.height / 2))

    def project(self, points_o) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nearest surface points (k, 3) [m], inward unit normals (k, 3) and signed distances (k,) [m].

        The distance is negative inside. Beyond a rim the nearest point lies on the rim and the normal points at it.
        Raises :class:`InvalidInput` on the axis, where the side has no nearest point.
        """
        points = array_of("points", points_o, (None, 3))
        rotation = self.pose[:3, :3]
        local = (points - self.com_o) @ rotation
        radial = np.linalg.norm(local[:, :2], axis=1)
        beyond_side, beyond_cap = radial - self.radius, np.abs(local[:, 2]) - self.height / 2
        on_side = beyond_side >= beyond_cap
        if np.any((radial < _NO_DIRECTION) & on_side):
            raise InvalidInput("a point on the cylinder's axis has no nearest side point: move it to the surface")
        outward = np.zeros_like(local)
        outward[:, :2] = local[:, :2] / np.maximum(radial, _NO_DIRECTION)[:, None]
        cap = np.column_stack([0 * radial, 0 * radial, np.where(local[:, 2] < 0, -1.0, 1.0)])
        rim = (beyond_side > 0) & (beyond_cap > 0)
        distance = np.where(rim, np.hypot(beyond_side, beyond_cap), np.maximum(beyond_side, beyond_cap))
        normal = np.where(on_side[:, None], outward, cap)
        # The quotient blends the side's and the cap's directions in proportion to how far the point is beyond each.
        blend = beyond_side[:, None] * outward + beyond_cap[:, None] * cap
        normal = np.where(rim[:, None], blend / np.where(rim, distance, 1.0)[:, None], normal)
        surface = local - distance[:, None] * normal
        return surface @ rotation.T + self.com_o, -normal @ rotation.T, distance
