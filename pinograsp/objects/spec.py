"""Objects from one line of text, as command lines and tables of objects have them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pinograsp.checks import one_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.objects.ellipsoid import Ellipsoid
from pinograsp.objects.load import load_object
from pinograsp.objects.mesh import Mesh
from pinograsp.objects.primitives import Box, Capsule, Cylinder, Sphere


def _lengths(text: str) -> list[float]:
    return [float(part) for part in text.split("x")]


def _yes_or_no(text: str) -> bool:
    return {"true": True, "false": False}[text]


def _package(text: str) -> dict[str, str]:
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise ValueError
    return {name.strip(): folder.strip()}


class _Field(NamedTuple):
    """How the text of a field is read, what it should be, and what to say of it after its name."""

    read: Callable[[str], object]
    wanted: str
    about: str


class _Shape(NamedTuple):
    """A constructor, fields that it needs, fields that it may have, and one line that makes such an object."""

    make: Callable[..., Body]
    needed: dict[str, _Field]
    optional: dict[str, _Field]
    example: str


def _number(about: str) -> _Field:
    return _Field(float, "a number, for example 0.02", about)


def _three(about: str) -> _Field:
    return _Field(_lengths, "three lengths, for example 0.02x0.03x0.04", about)


_RADIUS = _number("[m]")
_SHAPES: dict[str, _Shape] = {
    "sphere": _Shape(Sphere, {"radius": _RADIUS}, {}, "sphere:radius=0.03,mass=0.2"),
    "cylinder": _Shape(
        Cylinder,
        {"radius": _RADIUS, "height": _number("from end to end, along z [m]")},
        {},
        "cylinder:radius=0.02,height=0.12,mass=0.2",
    ),
    "capsule": _Shape(
        Capsule,
        {"radius": _RADIUS, "length": _number("of the straight part, along z [m]")},
        {},
        "capsule:radius=0.02,length=0.06,density=900",
    ),
    "box": _Shape(Box, {"size": _three("along x, y and z [m]")}, {}, "box:size=0.03x0.03x0.08,mass=0.1"),
    "ellipsoid": _Shape(
        Ellipsoid,
        {"semi_axes": _three("along x, y and z [m]")},
        {},
        "ellipsoid:semi_axes=0.02x0.03x0.04,mass=0.1",
    ),
    "mesh": _Shape(
        Mesh.load,
        {
            "path": _Field(
                str,
                "a text",
                "of an STL, OBJ, PLY, GLB, OFF or DAE file, of a folder of such parts, or a pattern as parts/*.obj",
            )
        },
        {
            "scale": _number("(metres per unit of the file: 0.001 for millimetres)"),
            "convex": _Field(_yes_or_no, "true or false", "(true: take the convex hull)"),
        },
        "mesh:path=mug.stl,scale=0.001,convex=false,density=600",
    ),
    "file": _Shape(
        load_object,
        {"path": _Field(str, "a text", "of a URDF, SDF or MJCF file of one object, with its mass if you give none")},
        {
            "hulls": _Field(_yes_or_no, "true or false", "(true: take the convex hull of each of its meshes)"),
            "body": _Field(str, "a text", "(of an MJCF file with several)"),
            "package": _Field(_package, "NAME=DIR", "NAME=DIR (folder of a ROS package of its meshes)"),
        },
        "file:path=mug.urdf,hulls=false,mass=0.3",
    ),
}
_WEIGHT = {
    "mass": _number("[kg]"),
    "density": _number("[kg/m^3]"),
}


def object_language() -> list[str]:
    """What :func:`object_from` reads, a line for each shape with all its fields and an example."""
    weight = " or ".join(f"{name} {field.about}" for name, field in _WEIGHT.items())
    lines = [f"SHAPE:FIELD=VALUE,FIELD=VALUE,... Every shape takes {weight}, and:"]
    for name, shape in _SHAPES.items():
        fields = [f"{field} {one.about}" for field, one in shape.needed.items()]
        fields += [f"optionally {field} {one.about}" for field, one in shape.optional.items()]
        lines.append(f"{name}: {', '.join(fields)}, as {shape.example}")
    return lines


def object_from(spec: str, *, packages: Mapping[str, str | Path] | None = None) -> Body:
    """Return the object that a text describes, at the world's origin (move it with ``placed``).

    ``shape:field=value,field=value,...`` with the fields of the shapes in metres, kilograms and kg/m^3:
    ``"cylinder:radius=0.02,height=0.12,mass=0.2"``, ``"box:size=0.04x0.06x0.1,density=500"``,
    ``"mesh:path=mug.stl,scale=0.001,density=400,convex=true"``, ``"file:path=mug.urdf"``; sphere, capsule and ellipsoid
    alike. An object of a file is placed as in :func:`~pinograsp.objects.load_object`.

    Args:
        spec: the text.
        packages: folders of ROS packages, ``{name: folder}``, for the meshes of files (``file:``).

    Raises:
        InvalidInput: unknown shape or field, a field missing or given twice, or a value that cannot be used.

    Example:
        >>> import pinograsp as pg
        >>> can = pg.object_from("cylinder:radius=0.03,height=0.12,mass=0.25")
        >>> print(type(can).__name__, can.radius, can.mass)
        Cylinder 0.03 0.25

    See Also:
        :class:`~pinograsp.objects.Cylinder`, :class:`~pinograsp.objects.Mesh`, :func:`~pinograsp.objects.load_object`.
    """
    if not isinstance(spec, str):
        raise InvalidInput(f"object: expected a text such as 'sphere:radius=0.03,mass=0.2', got {shorten(spec)}")
    shape, _, rest = spec.strip().partition(":")
    construct, needed, optional, _ = _SHAPES[one_of("shape of the object", shape.strip(), _SHAPES)]
    fields = {**needed, **optional, **_WEIGHT}
    values: dict[str, Any] = {}
    # A comma ends a field only where another one begins: file names may have commas.
    for part in re.split(r",(?=\s*\w+\s*=)", rest) if rest.strip() else []:
        name, equals, text = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InvalidInput(
                f"object {shorten(spec)}: expected field=value, got {shorten(part)}; fields: {', '.join(fields)}"
            )
        read, wanted, _ = fields[one_of(f"field of {shape.strip()}", name, fields)]
        if name in values:
            raise InvalidInput(f"object {shorten(spec)}: expected each field once, got {name} twice")
        try:
            values[name] = read(text)
        except (KeyError, ValueError):
            raise InvalidInput(f"object {shorten(spec)}: {name}: expected {wanted}, got {shorten(text)}") from None
    missing = [name for name in needed if name not in values]
    if missing:
        raise InvalidInput(
            f"object {shorten(spec)}: expected {', '.join(needed)} and mass or density, got no {', '.join(missing)}"
        )
    if construct is load_object:
        values["packages"] = {**(packages or {}), **values.pop("package", {})}
    return construct(**values)
