"""Objects as plain JSON values, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import mapping_of, one_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.objects.ellipsoid import Ellipsoid
from pinograsp.objects.mesh import Mesh
from pinograsp.objects.primitives import Box, Capsule, Cylinder, Sphere
from pinograsp.spatial import Array

# Shape -> (its class, what its constructor takes besides mass, density and pose).
_SHAPES: dict[str, tuple[type[Body], tuple[str, ...]]] = {
    "sphere": (Sphere, ("radius",)),
    "cylinder": (Cylinder, ("radius", "height")),
    "capsule": (Capsule, ("radius", "length")),
    "box": (Box, ("size",)),
    "ellipsoid": (Ellipsoid, ("semi_axes",)),
    "mesh": (Mesh, ("vertices", "faces", "convex")),
}
_ALL = ("mass", "density", "pose")
_OPTIONAL = ("inertia", "notes", "regions")  # left out where they say nothing, as is what one kind alone has
_ARRAYS = ("size", "semi_axes", "vertices", "faces", "shape_b", "pose", "inertia", "com")


def _optional(kind: type[Body]) -> tuple[str, ...]:
    return (*_OPTIONAL, "com" if kind is Mesh else "shape_b")


def object_record(body: Body) -> dict[str, Any] | None:
    """The object as plain JSON values: its shape's name and the constructor's arguments. None for other classes."""
    for shape, (kind, names) in _SHAPES.items():
        if type(body) is kind:
            values = {name: getattr(body, name) for name in (*_ALL, *names)}
            more = {name: getattr(body, name) for name in _optional(kind)}
            more = {name: value for name, value in more.items() if value is not None and len(value)}
            if np.array_equal(more.get("shape_b", ()), np.eye(4)):
                del more["shape_b"]
            return {"shape": shape, **{name: _plain(value) for name, value in (values | more).items()}}
    return None


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return list(value) if isinstance(value, tuple) else value


def object_of(record: dict[str, Any]) -> Body:
    """The object that :func:`object_record` wrote down; vertices of meshes agree to rounding.

    Raises:
        InvalidInput: a record that is not one, or of an object that cannot be.
    """
    if not isinstance(record, dict):
        raise InvalidInput(f"object record: expected a mapping with shape and sizes, got {record!r:.60}")
    kind, names = _SHAPES[one_of("object record: shape", record.get("shape"), _SHAPES)]
    wanted = (*_ALL, *names)
    known = {"shape", *wanted, *_optional(kind)}
    if not {"shape", *wanted} <= set(record) <= known:
        raise InvalidInput(f"object record: expected shape, {', '.join(wanted)}, got {', '.join(map(str, record))}")
    values: dict[str, Any] = {
        name: _array(name, value) if name in _ARRAYS else value for name, value in record.items() if name != "shape"
    }
    if "notes" in values:
        if not isinstance(record["notes"], list) or not all(isinstance(note, str) for note in record["notes"]):
            raise InvalidInput(f"object record: notes: expected a list of texts, got {record['notes']!r:.60}")
        values["notes"] = tuple(record["notes"])
    if "regions" in values:
        regions = mapping_of("object record: regions", record["regions"], "{name: (lower, upper corner)}")
        values["regions"] = {name: _array(f"region '{name}'", box) for name, box in regions.items()}
    try:
        return kind(**values)
    except OverflowError as error:
        raise InvalidInput(f"object record: expected numbers that a float can hold, got {error}") from None


def _array(name: str, value: ArrayLike) -> Array:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInput(f"object record: {name}: expected numbers, got {value!r:.60}") from None
