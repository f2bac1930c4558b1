"""A grasp for a controller in C++: the constants of its loop, and of a grip on it, as a header or as JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pinograsp.checks import mapping_of, one_line, path_of
from pinograsp.errors import InvalidInput
from pinograsp.writing.files import write_file

_FIELDS = (
    *("components", "round", "torsion", "arm", "safety", "ramp", "most_rate", "most_steps", "joints", "couplings"),
    "borne",
)
_ON_LINKS = ("link_points", "link_normals")  # contacts in the frames of their links, for taxels
_ARRAYS = (
    *("com", "points", "rotations", "mu", "least", "largest", "torque_limit", "jacobian", "gravity", "posture"),
    "load",
)
# Words of C++ that could be the name of a file, and namespaces that are there.
_KEPT = (
    "alignas alignof and asm auto bitand bitor bool break case catch char class co_await co_return co_yield compl "
    "concept const const_cast consteval constexpr constinit continue decltype default delete do double "
    "dynamic_cast else enum explicit export extern false final float for friend goto if import inline int long "
    "module mutable namespace new noexcept not nullptr operator or override pinograsp private protected public "
    "register reinterpret_cast requires return short signed sizeof static static_assert static_cast std struct "
    "switch template this thread_local throw true try typedef typeid typename union unsigned using virtual void "
    "volatile wchar_t while xor"
)
_INPUTS = ("points", "rotations", "mu", "least", "largest", "torque_limit", "com")


def write_core(constants: Mapping[str, Any], path: str | Path) -> Path:
    """Write what :meth:`pinograsp.motion.OnlineForces.constants` or
    :meth:`pinograsp.reflex.GripController.constants` gives; returns the path.

    Args:
        constants: of a loop, or of a grip, which has those of its loop under ``loop``; ``contact_links`` (k,),
            ``link_points`` (k, 3) [m] and ``link_normals`` (k, 3) among those of the loop say where on the links its
            contacts are.
        path: ``.hpp``: a header with the constants, and with functions that set up the loop and the grip; ``.json``:
            the constants alone, ``null`` for no limit. Existing files are replaced.

    Raises:
        InvalidInput: another suffix, or constants of something else. ResultsNotWritten.
    """
    path = path_of("path", path)
    constants = mapping_of("constants", constants)
    if path.suffix not in (".hpp", ".json"):
        raise InvalidInput(f"path: expected a name that ends in .hpp or .json, got {path.name!r}")
    try:
        header, plain = _header(constants, path.stem), _json(constants)
    except (LookupError, TypeError, ValueError) as error:
        raise InvalidInput(
            f"constants: expected those of a loop or a grip, OnlineForces.constants() or GripController.constants(), "
            f"got others ({one_line(error)})"
        ) from error
    text = header if path.suffix == ".hpp" else plain
    return write_file(path, text.encode())


def _json(constants: Mapping[str, Any]) -> str:
    def finite(value: Any) -> Any:
        if isinstance(value, list):
            return [finite(one) for one in value]
        if isinstance(value, Mapping):
            return {name: finite(one) for name, one in value.items()}
        return None if isinstance(value, float) and math.isinf(value) else value

    return json.dumps({"pinograsp": version("pinograsp")} | finite(constants), indent=1) + "\n"


def _flat(values: Any) -> Iterable[Any]:
    if not isinstance(values, list):
        yield values
        return
    for one in values:
        yield from _flat(one)


def _number(value: float) -> str:
    return "pinograsp::core::infinity" if math.isinf(value) else repr(value)


def _list(values: Any) -> str:
    return ", ".join(_number(float(one)) for one in _flat(values))


def _namespace(name: str) -> str:
    """The name of a file as that of a namespace: other letters are _, and what C++ keeps for itself is preceded."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "grasp"
    return f"grasp_{plain}" if plain[0].isdigit() or plain in _KEPT.split() else plain


def _header(constants: Mapping[str, Any], name: str) -> str:
    grip = constants if "loop" in constants else None
    constants, kind = (constants, "Online") if grip is None else (constants["loop"], "Grip")
    space = _namespace(name)
    named: dict[str, Any] = {"contact_links": []} | dict(constants)
    names = ("contact_names", "contact_links", "joint_names")
    texts = {key: ", ".join(json.dumps(one) for one in named[key]) for key in names}
    lines = [
        f"// A grasp for pinograsp::core::{kind}, made by pinograsp {version('pinograsp')}.",
        "// Positions in metres, world axes; forces in newtons, the load about the centre of mass.",
        "#pragma once",
        "",
        "#include <algorithm>",
        "#include <memory>",
        "",
        f"#include <pinograsp/core/{kind.lower()}.hpp>",
        "",
        f"namespace {space} {{",
        "",
        f"constexpr int contacts = {constants['contacts']}, joints = {constants['joints']};",
        f"constexpr double period = {constants['period']!r};  // [s]",
    ]
    if texts["contact_links"]:
        lines.append("// Where the contacts are, link_points and link_normals in the frames of contact_links.")
    for key, text in texts.items():
        if text:
            lines.append(f"constexpr const char* {key}[] = {{{text}}};")
    arrays = [key for key in (*_ARRAYS, *_ON_LINKS) if list(_flat(constants.get(key, [])))]
    for key in arrays:
        lines.append(f"constexpr double {key}[] = {{{_list(constants[key])}}};")
    lines += ["", "// A loop of its own, ready for the first tick.", "inline auto make_loop() {"]
    lines += ["    pinograsp::core::OnlineSetup setup;", "    setup.contacts = contacts;"]
    lines += [f"    setup.{key} = {_number(constants[key])};" for key in _FIELDS]
    lines.append(f"    setup.moments = {'true' if constants['moments'] else 'false'};")
    links = ", ".join("{" + ", ".join(map(str, link)) + "}" for link in constants["links"])
    lines.append(f"    setup.links = {{{links}}};")
    lines.append(f"    setup.limited = {{{', '.join(map(str, constants['limited']))}}};")
    for key in ("coupling_rows", "coupled"):
        lines.append(f"    setup.{key} = {{{_list(constants[key])}}};")
    lines.append(f"    setup.stops = {{{', '.join(map(str, constants['stops']))}}};")
    lines.append("    auto loop = pinograsp::core::make_online(setup);")
    for key in _INPUTS:
        if key in arrays:
            lines.append(f"    std::copy(std::begin({key}), std::end({key}), loop->{key});")
    lines += [f"    loop->{key} = {key};" for key in ("jacobian", "gravity") if key in arrays]
    lines += ["    return loop;", "}", ""]
    if grip is not None:
        lines += _make_grip(grip)
    return "\n".join([*lines, f"}}  // namespace {space}", ""])


def _make_grip(constants: Mapping[str, Any]) -> list[str]:
    """The function that sets up a grip."""
    lines = ["// A squeeze that reacts to measurements, on such a loop, which has to live as long."]
    lines += ["inline auto make_grip(pinograsp::core::Online& loop) {", "    pinograsp::core::GripSetup setup;"]
    for key, value in constants.items():
        if key in ("gravity", "load"):  # arrays there, all others are vectors
            lines += [f"    setup.{key}[{i}] = {one!r};" for i, one in enumerate(value)]
        elif isinstance(value, list):
            lines.append(f"    setup.{key} = {{{_list(value)}}};")
        elif key != "loop":
            lines.append(f"    setup.{key} = {json.dumps(value) if isinstance(value, bool) else _number(value)};")
    return [*lines, "    return std::make_unique<pinograsp::core::Grip>(loop, setup);", "}", ""]
