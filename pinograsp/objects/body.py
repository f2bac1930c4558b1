"""What every solid has: mass, pose, and its surface seen from the world."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypedDict, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, items_of, mapping_of, number, placement_of, read_only, shorten
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray, cross, moments_problem, move_about

if TYPE_CHECKING:
    import coal

_Solid = TypeVar("_Solid", bound="Body")

# Nearer than this to a centre, an axis or a mid-plane [m], no direction to the surface is preferred over another;
# nearer than this to an edge, no curvature is. Far above rounding for objects of a metre, far below any tolerance.
NO_DIRECTION = 1e-9
_DIGITS = 1e-2  # of inertias in files, which are rounded
_LEAST, _MOST = 1e-3, 5.0  # [m] across, of what hands hold
_UNITS = "are the units right?"
_SIZES = {"radius": 2, "semi_axes": 2, "height": 1, "length": 1, "size": 1}  # by the names of solids' fields
_FAR = 1e100  # [m] squares of more overflow


class BodyArguments(TypedDict, total=False):
    """Arguments of every solid's constructor besides its size, see :class:`Body`."""

    mass: float | None
    density: float | None
    pose: ArrayLike
    inertia: ArrayLike | None
    notes: tuple[str, ...]
    regions: Mapping[str, ArrayLike]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A solid, homogeneous unless said otherwise; its body frame b is the frame in which its shape was given, that of
    its file.

    Attributes:
        mass: [kg].
        density: [kg/m^3]. Give one of the two; the other follows. Both are accepted if they agree, so that records can
            be copied; to copy one with another size, set the one that changes to None.
        pose: oMb (4, 4), the body frame in the world [m].
        inertia: rotational inertia (3, 3) about the centre of mass, body axes [kg m^2], if it was measured; None: that
            of a homogeneous solid.
        notes: changes to the input, and sizes that suggest other units than metres.
        regions: named parts, such as the groups of an OBJ file: lower and upper corner (2, 3) of a box in the body
            frame [m].
        shape_pose: oMs (4, 4), the shape's own frame s in the world [m], in which ``collision_geometry`` is: at the
            centre of mass, with the body's axes, or those of a primitive that its file turned.
    """

    mass: float = None  # type: ignore[assignment]  # a number once the constructor is done
    density: float = None  # type: ignore[assignment]  # likewise
    pose: Array = field(default_factory=lambda: np.eye(4))
    inertia: Array | None = field(default=None, repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    regions: Mapping[str, Array] = field(default_factory=dict, repr=False)
    shape_pose: Array = field(init=False, repr=False)

    __repr__ = brief()

    def __post_init__(self) -> None:
        self._check_shape()
        self._put(self.pose)
        name, mass, density = self._name, self.mass, self.density
        if mass is None and density is None:
            raise InvalidInput(f"{name}: expected mass= [kg] or density= [kg/m^3], got neither: give one of them")
        volume = number(f"{name} volume", self.volume, above=0, unit="m^3")
        if mass is not None:
            mass = number(f"{name} mass", mass, above=0, unit="kg")
        if density is not None:
            density = number(f"{name} density", density, above=0, unit="kg/m^3")
        if mass is not None and density is not None and abs(mass - density * volume) > 1e-9 * mass:
            raise InvalidInput(
                f"{name}: expected mass= or density=, got both, and they disagree ({mass:g} kg, but {density:g} kg/m^3 "
                f"makes {density * volume:g} kg): give one of them"
            )
        self._set(
            mass=number(f"{name} mass", density * volume, above=0, unit="kg") if mass is None else mass,
            density=mass / volume if density is None else density,
        )
        if self.inertia is not None:
            most = self.mass * self.bounding_radius * self.bounding_radius
            self._set(inertia=_checked_inertia(name, self.inertia, most))
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                finite = bool(np.isfinite(self.inertia_b).all())
        except OverflowError:
            finite = False
        if not finite:
            raise InvalidInput(f"{name}: expected a size whose inertia is a finite number, this one is too large")
        given = [note for note in items_of("notes", self.notes, str) if not note.endswith(_UNITS)]
        self._set(notes=(*given, *self._doubtful_units()))
        regions: Mapping[str, ArrayLike] = mapping_of("regions", self.regions, "{name: (lower, upper corner)}")
        self._set(regions={name: read_only(check_box(f"region '{name}'", box)) for name, box in regions.items()})

    @property
    def _across(self) -> float:
        """The largest size that was given, of radii the diameter [m]."""
        return max(times * float(np.max(getattr(self, name))) for name, times in _SIZES.items() if hasattr(self, name))

    def _doubtful_units(self) -> tuple[str, ...]:
        """A note where lengths are likely to be in other units than metres."""
        across = self._across
        if _LEAST <= across <= _MOST:
            return ()
        fit = "0.001 makes metres of millimetres" if across > _MOST else "1000 undoes metres read as millimetres"
        return (
            f"{self._name}: {across:.3g} m across, and hands hold objects of {1e3 * _LEAST:g} mm to {_MOST:g} m; the "
            f"factor {fit} (of a mesh: scale=): {_UNITS}",
        )

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _put(self, pose: ArrayLike) -> None:
        pose = placement_of("pose", pose)
        self._set(pose=pose, shape_pose=read_only(pose @ self.shape_b))

    def _check_lengths(self, *names: str) -> None:
        self._set(**{name: number(f"{self._name} {name}", getattr(self, name), above=0, unit="m") for name in names})

    @property
    def _name(self) -> str:
        return type(self).__name__.lower()

    # -- what each solid has of its own

    def _check_shape(self) -> None:
        """Check the sizes, and store them as numbers and read-only arrays."""
        raise NotImplementedError

    @property
    def shape_b(self) -> Array:
        """bMs (4, 4): the shape's own frame s, which is at the centre of mass, in the body frame [m]."""
        raise NotImplementedError

    @property
    def volume(self) -> float:
        """[m^3]."""
        raise NotImplementedError

    @property
    def _inertia_per_mass(self) -> Array:
        """Rotational inertia (3, 3) of one kilogram about the centre of mass, axes of s [m^2]."""
        raise NotImplementedError

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        raise NotImplementedError

    @property
    def collision_geometry(self) -> coal.CollisionGeometry:
        """Coal's geometry in the shape's frame s."""
        raise NotImplementedError

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        """Nearest surface points (k, 3) [m], outward unit normals (k, 3), signed distances (k,) [m], in s."""
        raise NotImplementedError

    def _curvature_s(self, surface: Array, outward: Array) -> tuple[Array, Array]:
        """Principal curvatures (k, 2) [1/m], smaller first, and the direction (k, 3) of the first, in s."""
        raise NotImplementedError

    # -- what follows from it

    @property
    def com_b(self) -> Array:
        """Centre of mass (3,) in the body frame [m]."""
        return self.shape_b[:3, 3]

    @property
    def com_o(self) -> Array:
        """Centre of mass (3,) in the world [m]."""
        return self.shape_pose[:3, 3]

    @property
    def inertia_b(self) -> Array:
        """Rotational inertia (3, 3) about the centre of mass, body axes [kg m^2]."""
        if self.inertia is not None:
            return self.inertia
        turn = self.shape_b[:3, :3]
        return read_only(self.mass * turn @ self._inertia_per_mass @ turn.T)

    @property
    def inertia_s(self) -> Array:
        """Rotational inertia (3, 3) about the centre of mass, axes of the shape's own frame s [kg m^2]."""
        turn = self.shape_b[:3, :3]
        return read_only(turn.T @ self.inertia_b @ turn)

    def placed(self: _Solid, pose: ArrayLike) -> _Solid:
        """Return the same solid with its body frame at ``pose`` oMb (4, 4) [m]."""
        moved = copy.copy(self)
        moved._put(pose)
        return moved

    def moved(self: _Solid, shift_o: ArrayLike, turn_o: ArrayLike) -> _Solid:
        """Return the same solid turned by ``turn_o`` (3, 3) about its centre of mass, which moves by ``shift_o`` (3,)
        [m].

        Both are in the world's axes.
        """
        shift, turn = array_of("shift", shift_o, (3,)), array_of("turn", turn_o, (3, 3))
        return self.placed(move_about(self.pose, self.com_o, shift, turn))

    def project(self, points_o: ArrayLike) -> tuple[Array, Array, Array]:
        """Find the nearest surface points (k, 3) [m], inward unit normals (k, 3) and signed distances (k,) [m].

        The distance is negative inside. Beyond an edge, a rim or a corner the nearest point lies on it and the normal
        points at it; on one (within 1e-9 m, so that rounding does not decide) it is the mean of the faces' that meet
        there. Inside, where neighbouring faces are equally near, one of them is taken.

        Raises:
            InvalidInput: a point without a nearest surface point, within 1e-9 m of a centre, an axis or a mid-plane,
                where the nearest ones lie in opposite directions.
        """
        surface, outward, distance = self._nearest_s(self._local(points_o))
        return surface @ self.shape_pose[:3, :3].T + self.com_o, -outward @ self.shape_pose[:3, :3].T, distance

    def curvature(self, points_o: ArrayLike) -> tuple[Array, Array]:
        """Principal curvatures (k, 2) [1/m], smaller first, and the direction (k, 3) of the first, in the world.

        At the surface points nearest to ``points_o`` (k, 3) [m]; positive where the solid is convex. The direction is
        a unit vector in the tangent plane, any one of them where the two curvatures are equal.

        Raises:
            InvalidInput: as in :meth:`project`, or a point on an edge, a rim or a corner, where the curvature is
                infinite.
        """
        surface, outward, _ = self._nearest_s(self._local(points_o))
        curvatures, first = self._curvature_s(surface, outward)
        return curvatures, first @ self.shape_pose[:3, :3].T

    def _local(self, points_o: ArrayLike) -> Array:
        points = array_of("points", points_o, (None, 3))
        if np.abs(points).max(initial=0.0) > _FAR:
            raise InvalidInput(f"points: expected them within {_FAR:g} m of the origin, got {shorten(points.tolist())}")
        local: Array = (points - self.com_o) @ self.shape_pose[:3, :3]
        return local

    def _refuse(self, where: BoolArray, points_s: Array, complaint: str) -> None:
        """Raise the complaint about the first of the points (k, 3) for which ``where`` (k,) holds."""
        if np.any(where):
            point = points_s[np.argmax(where)] @ self.shape_pose[:3, :3].T + self.com_o
            raise InvalidInput(f"{complaint} (at {(1e3 * point).round(3).tolist()} mm in the world)")


def check_box(name: str, corners: ArrayLike) -> Array:
    """Check a box along an object's axes and return its lower and upper corner (2, 3) [m]; :class:`InvalidInput` if it
    is not a box.
    """
    box = array_of(name, corners, (2, 3))
    if not (box[0] < box[1]).all():
        raise InvalidInput(f"{name}: expected lower corner < upper corner, got {box[0].tolist()} and {box[1].tolist()}")
    return box


class PrimitiveArguments(BodyArguments, total=False):
    """Arguments of a primitive's constructor besides its size, see :class:`Primitive`."""

    shape_b: ArrayLike


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Primitive(Body):
    """A solid with a middle and axes of its own: the body frame, unless its file puts it elsewhere in a link's frame.

    Attributes:
        mass, density, pose, inertia, notes, shape_pose: see :class:`Body`.
        shape_b: bMs (4, 4), the middle and the axes of the primitive in the body frame [m].
    """

    shape_b: Array = field(default_factory=lambda: np.eye(4), repr=False)  # pyright: ignore  # frozen

    __repr__ = brief()

    def __post_init__(self) -> None:
        self._set(shape_b=placement_of("shape_b", self.shape_b))
        Body.__post_init__(self)


class InertiaImpossible(InvalidInput):
    """An inertia that no solid of that mass and size can have."""


def _checked_inertia(name: str, value: object, most: float) -> Array:
    """An inertia (3, 3) with moments that a solid can have, none above ``most``, that of its mass at its farthest."""
    inertia = array_of(f"{name} inertia", value, (3, 3))
    moments = np.asarray(np.linalg.eigvalsh((inertia + inertia.T) / 2), dtype=float)
    if np.abs(inertia - inertia.T).max() > _DIGITS * moments[2]:
        raise InertiaImpossible(f"{name} inertia: expected a symmetric matrix, got {shorten(inertia.tolist())}")
    if problem := moments_problem(moments, most):
        raise InertiaImpossible(f"{name} inertia: {problem}")
    return read_only((inertia + inertia.T) / 2)


def tangents(normals: Array) -> Array:
    """Compute two orthonormal directions (k, 3, 2) across each unit normal (k, 3)."""
    aside = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first: Array = cross(normals, aside)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, cross(normals, first)], axis=2)
