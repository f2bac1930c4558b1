"""Objects from one line of text, as command lines and tables of objects have them."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

from pinograsp.checks import one_of, shown
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.objects.ellipsoid import Ellipsoid
from pinograsp.objects.mesh import Mesh
from pinograsp.objects.primitives import Box, Capsule, Cylinder, Sphere


def _lengths(text: str) -> list[float]:
    return [float(part) for part in text.split("x")]


def _yes_or_no(text: str) -> bool:
    return {"true": True, "false": False}[text]


# How the text of a field is read, and what it should be.
_Field: TypeAlias = tuple[Callable[[str], object], str]

_NUMBER: _Field = (float, "a number, for example 0.02")
_LENGTHS: _Field = (_lengths, "three lengths, for example 0.02x0.03x0.04")
_FLAG: _Field = (_yes_or_no, "true or false")
_TEXT: _Field = (str, "a text")
# Shape -> (its constructor, fields it needs, fields it may have).
_SHAPES: dict[str, tuple[Callable[..., Body], dict[str, _Field], dict[str, _Field]]] = {
    "sphere": (Sphere, {"radius": _NUMBER}, {}),
    "cylinder": (Cylinder, {"radius": _NUMBER, "height": _NUMBER}, {}),
    "capsule": (Capsule, {"radius": _NUMBER, "length": _NUMBER}, {}),
    "box": (Box, {"size": _LENGTHS}, {}),
    "ellipsoid": (Ellipsoid, {"semi_axes": _LENGTHS}, {}),
    "mesh": (Mesh.load, {"path": _TEXT}, {"scale": _NUMBER, "convex": _FLAG}),
}
_WEIGHT = {"mass": _NUMBER, "density": _NUMBER}


def object_from(spec: str) -> Body:
    """The object that a text describes, at the world's origin (move it with ``placed``).

    ``shape:field=value,field=value,...`` with the fields of the shapes in metres, kilograms and kg/m^3:
    ``"cylinder:radius=0.02,height=0.12,mass=0.2"``, ``"box:size=0.04x0.06x0.1,density=500"``,
    ``"mesh:path=mug.stl,scale=0.001,density=400,convex=true"``; sphere, capsule and ellipsoid alike.

    Raises:
        InvalidInput: unknown shape or field, a field missing or given twice, or a value that cannot be used.
    """
    if not isinstance(spec, str):
        raise InvalidInput(f"object: expected a text such as 'sphere:radius=0.03,mass=0.2', got {shown(spec)}")
    shape, _, rest = spec.strip().partition(":")
    construct, needed, optional = _SHAPES[one_of("shape of the object", shape.strip(), _SHAPES)]
    fields = {**needed, **optional, **_WEIGHT}
    values: dict[str, object] = {}
    # A comma ends a field only where another one begins: file names may have commas.
    for part in re.split(r",(?=\s*\w+\s*=)", rest) if rest.strip() else []:
        name, equals, text = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InvalidInput(
                f"object {shown(spec)}: expected field=value, got {shown(part)}; fields: {', '.join(fields)}"
            )
        read, wanted = fields[one_of(f"field of {shape.strip()}", name, fields)]
        if name in values:
            raise InvalidInput(f"object {shown(spec)}: expected each field once, got {name} twice")
        try:
            values[name] = read(text)
        except (KeyError, ValueError):
            raise InvalidInput(f"object {shown(spec)}: {name}: expected {wanted}, got {shown(text)}") from None
    missing = [name for name in needed if name not in values]
    if missing:
        raise InvalidInput(
            f"object {shown(spec)}: expected {', '.join(needed)} and mass or density, got no {', '.join(missing)}"
        )
    return construct(**values)
