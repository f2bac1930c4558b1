"""What an MJCF file says of an element: included files, the compiler's settings, default classes, frames, numbers."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import shown
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import MOST_ELEMENTS, floats, parse_xml, read_bytes
from pinograsp.hands.file_reads import is_there
from pinograsp.spatial import Array

# All actuators are one kind to MuJoCo, with one set of defaults; the shortcuts set their gain and bias.
_FORCES = {"biastype": "none", "gaintype": "fixed", "gainprm": "1"}
_SERVOS = {"biastype": "affine"}
_OTHERS = ("position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "adhesion", "dcmotor")
_SHORTCUTS: dict[str, dict[str, str]] = {"motor": _FORCES, "general": {}, **dict.fromkeys(_OTHERS, _SERVOS)}
# Which of a shortcut's own attributes is its gain.
_GAINS = {"position": "kp", "intvelocity": "kp", "velocity": "kv", "damper": "kv"}
_WITH_DEFAULTS = frozenset(
    {"joint", "geom", "mesh", "material", "equality", "tendon", "actuator"}
)  # of what is read here
_MOST_INCLUDES, _DEEPEST, _MOST_CLASSES = 1000, 20, 2000
_ORIENTATIONS = frozenset({"quat", "axisangle", "euler", "xyaxes", "zaxis"})
_AXES = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


class Source:
    """An MJCF file.

    Attributes:
        element: its outermost element, included files put in place.
        folder: of the file.
        compiler: settings.
        problems: collected while reading.

    Files are included from the first file's own folder and those below it, unless it is trusted.
    """

    def __init__(self, name: str, element: ElementTree.Element, path: Path, trusted: bool):
        self.name, self.element, self.folder, self.trusted = name, element, path.resolve().parent, trusted
        self._problems: dict[str, None] = {}  # in order, each once
        self._size, self._includes = sum(1 for _ in element.iter()), 0
        self._include(element, path, (path,))
        self.compiler: dict[str, str] = {}
        for one in element.findall("compiler"):
            self.compiler.update(one.attrib)
        self.degrees = self.compiler.get("angle", "degree") != "radian"
        self.autolimits = self.compiler.get("autolimits", "true") == "true"
        self._defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for one in element.findall("default"):
            self._read_defaults(one, one.get("class", "main"))
            self._defaults["main"] = self._defaults[one.get("class", "main")]

    @property
    def problems(self) -> list[str]:
        """The problems found so far, each once."""
        return list(self._problems)

    def _include(self, element: ElementTree.Element, path: Path, above: tuple[Path, ...]) -> None:
        """Put what an element includes, on any level, in place."""
        waiting = [element]
        while waiting:
            parent = waiting.pop()
            for child in list(parent):
                if child.tag != "include":
                    waiting.append(child)
                    continue
                place = list(parent).index(child)
                parent.remove(child)
                self._includes += 1
                if self._includes > _MOST_INCLUDES or len(above) > _DEEPEST:
                    raise HandNotLoaded(
                        self.name,
                        f"expected at most {_MOST_INCLUDES} included files, {_DEEPEST} deep: it includes more, or "
                        "itself",
                    )
                name = child.get("file", "")
                try:
                    found, included = self._included(name, path)
                    if found in above:
                        raise ValueError("includes itself")
                except (OSError, ValueError) as error:
                    self.problem(f"<include file={shown(name)}>: {error}")
                    continue
                self._size += sum(1 for _ in included.iter())
                if self._size > MOST_ELEMENTS:
                    raise HandNotLoaded(
                        self.name, f"expected at most {MOST_ELEMENTS} elements, with those of included files"
                    )
                self._include(included, found, (*above, found))
                parent[place:place] = list(included)

    def _included(self, name: str, path: Path) -> tuple[Path, ElementTree.Element]:
        """The named file, beside the one that includes it or beside the first, and its outermost element."""
        found = next((one.resolve() for one in (path.parent / name, self.folder / name) if is_there(one)), None)
        if found is None:
            raise ValueError("no such file")
        if not (self.trusted or found.is_relative_to(self.folder)):
            raise ValueError(
                "outside the first file's own folder (symbolic links followed): pass trusted=True if you trust this "
                "file"
            )
        return found, parse_xml(read_bytes(found))

    def _read_defaults(self, element: ElementTree.Element, name: str) -> None:
        waiting: list[tuple[ElementTree.Element, str, dict[str, dict[str, str]]]] = [(element, name, {})]
        while waiting:
            element, name, inherited = waiting.pop()
            own = self._defaults.setdefault(name, {})
            if len(self._defaults) > _MOST_CLASSES:
                raise HandNotLoaded(self.name, f"expected at most {_MOST_CLASSES} default classes")
            for tag, attributes in inherited.items():
                own[tag] = _merged(attributes, own[tag]) if tag in own else attributes
            nested: list[ElementTree.Element] = []
            for child in element:
                if child.tag == "default":
                    nested.append(child)
                elif child.tag in _SHORTCUTS:
                    own["actuator"] = _actuator(child.tag, child.attrib, own.get("actuator", {}))
                elif child.tag in _WITH_DEFAULTS:
                    own[child.tag] = _merged(own.get(child.tag, {}), child.attrib)
            for child in reversed(nested):
                if inner := child.get("class"):
                    waiting.append((child, inner, own))
                else:
                    self.problem("<default> inside another needs class=")

    def attributes(
        self, element: ElementTree.Element, childclass: str | None = None, tag: str | None = None
    ) -> dict[str, str]:
        """Attributes of an element, completed by the defaults that its class has for ``tag`` (default: its own)."""
        name = element.get("class") or childclass or "main"
        if name not in self._defaults:
            self.problem(f"<{element.tag} name='{element.get('name', '')}'>: unknown default class '{name}'")
            name = "main"
        tag = tag or element.tag
        if tag in _SHORTCUTS:
            return _actuator(tag, element.attrib, self._defaults[name].get("actuator", {}))
        return _merged(self._defaults[name].get(tag, {}), element.attrib)

    def problem(self, text: str) -> None:
        """Note a problem, to be raised with all others."""
        self._problems[text] = None

    def numbers(
        self, attributes: dict[str, str], key: str, default: str, least: int = 1, most: int | None = None
    ) -> Array:
        """Between ``least`` and ``most`` (default: ``least``) finite numbers of an attribute; the default and a problem
        where there are others.
        """
        try:
            values = floats(attributes.get(key, default))
        except ValueError:
            values = []
        if not least <= len(values) <= (most or least):
            wanted = f"{least}" if (most or least) == least else f"{least} to {most}"
            where, given = attributes.get("name", ""), attributes.get(key)
            self.problem(f"'{where}': {key}= expects {wanted} finite numbers, got {shown(given)}")
            values = [float(value) for value in default.split()]
        return np.array(values)

    def limited(self, attributes: dict[str, str], flag: str, key: str) -> bool:
        """Whether a range applies: by its flag or, where that is left open, by the range being there."""
        setting = attributes.get(flag, "auto")
        if setting == "auto" and self.autolimits and key in attributes:
            low, high = self.numbers(attributes, key, "0 0", 2)
            return bool(low < high)
        return setting == "true"

    def asset(self, file: str, folder: str) -> Path:
        """The file of a mesh or a texture; ``folder``: the compiler's setting for its kind."""
        file = file.replace("\\", "/")
        if self.compiler.get("strippath", "false") == "true":
            file = file.split("/")[-1]
        return self.folder / self.compiler.get(folder, self.compiler.get("assetdir", "")) / file

    def placement(self, attributes: dict[str, str]) -> pin.SE3:
        """Position and orientation, in whichever way the latter is given."""
        return pin.SE3(self._rotation(attributes), self.numbers(attributes, "pos", "0 0 0", 3))

    def _rotation(self, attributes: dict[str, str]) -> Array:
        unit = math.pi / 180 if self.degrees else 1.0
        if "euler" in attributes:
            R = np.eye(3)
            for axis, angle in zip(self.compiler.get("eulerseq", "xyz"), self.numbers(attributes, "euler", "0 0 0", 3)):
                turn = _turned(_AXES.get(axis.lower(), _AXES["x"]), angle * unit)
                R = R @ turn if axis.islower() else turn @ R  # lower case: about axes that turn along
            return R
        if "axisangle" in attributes:
            values = self.numbers(attributes, "axisangle", "0 0 1 0", 4)
            return _turned(self.direction(attributes, values[:3]), values[3] * unit)
        if "xyaxes" in attributes:
            values = self.numbers(attributes, "xyaxes", "1 0 0 0 1 0", 6)
            x = self.direction(attributes, values[:3])
            y = self.direction(attributes, values[3:] - x * (x @ values[3:]))
            return np.column_stack([x, y, np.cross(x, y)])
        if "zaxis" in attributes:
            return turned_to(self.direction(attributes, self.numbers(attributes, "zaxis", "0 0 1", 3)))
        w, x, y, z = self.numbers(attributes, "quat", "1 0 0 0", 4)
        if w == x == y == z == 0:
            self.problem(f"'{attributes.get('name', '')}': quat= is zero, expected a rotation")
            w = 1.0
        rotation: Array = pin.Quaternion(w, x, y, z).normalized().matrix()
        return rotation

    def direction(self, attributes: dict[str, str], vector: ArrayLike) -> Array:
        """A unit vector (3,), z and a problem where the given one is zero."""
        vector = np.asarray(vector, dtype=float)
        length = float(np.linalg.norm(vector))
        if length < 1e-12:
            self.problem(f"'{attributes.get('name', '')}': an axis is zero, expected a direction")
            return np.array(_AXES["z"])
        return vector / length

    def contents(
        self, body: ElementTree.Element, childclass: str | None
    ) -> Iterator[tuple[ElementTree.Element, str | None, pin.SE3]]:
        """Yield what a body holds, as (element, default class, placement in the body), frames resolved."""
        waiting = [(child, childclass, pin.SE3.Identity()) for child in reversed(list(body))]
        while waiting:
            child, inherited, at = waiting.pop()
            if child.tag == "frame":
                own = child.get("childclass", child.get("class", inherited))
                at = at * self.placement(child.attrib)
                waiting += [(inner, own, at) for inner in reversed(list(child))]
            else:
                yield child, inherited, at


def _merged(attributes: dict[str, str], over: dict[str, str]) -> dict[str, str]:
    """Attributes with others over them; an orientation replaces one that is given in another way."""
    if not _ORIENTATIONS.isdisjoint(over):
        attributes = {key: value for key, value in attributes.items() if key not in _ORIENTATIONS}
    return {**attributes, **over}


def _actuator(tag: str, given: dict[str, str], inherited: dict[str, str]) -> dict[str, str]:
    """Attributes of an actuator over those it inherits; gains of the shortcuts as those of a general one.

    As in MuJoCo, a shortcut inherits the gains of its own kind, or of a general actuator, but not of other shortcuts.
    """
    over = {**_SHORTCUTS[tag], **given}
    if tag == "motor":
        return _merged(inherited, {"biasprm": "0 0 0", "shortcut": tag, **over})
    if tag not in _GAINS:
        return _merged(inherited, over)
    last = inherited.get("shortcut", "general")
    alike = last == tag or (last == "general" and inherited.get("gaintype", "fixed") == "fixed")
    try:
        gains = [*floats(inherited.get("gainprm", "1")), 0.0, 0.0] if alike else [1.0, 0.0, 0.0]
        bias = [*floats(inherited.get("biasprm", "0")), 0.0, 0.0] if alike else [0.0, 0.0, 0.0]
        gain = floats(given[_GAINS[tag]])[0] if _GAINS[tag] in given else gains[0]
        damping = floats(given["kv"])[0] if "kv" in given else -(gains[2] if tag == "damper" else bias[2])
    except (ValueError, IndexError):  # told where the gains are read
        return _merged(inherited, {**over, "gainprm": "?"})
    if tag == "damper":
        own = {"gaintype": "affine", "gainprm": f"0 0 {-damping!r}", "biastype": "none", "biasprm": "0 0 0"}
    elif tag == "velocity":
        own = {"gaintype": "fixed", "gainprm": repr(gain), "biasprm": f"0 0 {-gain!r}"}
    else:
        own = {"gaintype": "fixed", "gainprm": repr(gain), "biasprm": f"0 {-gain!r} {-damping!r}"}
    return _merged(inherited, {**_SHORTCUTS[tag], **own, "shortcut": tag, **given})


def turned_to(direction: Array) -> Array:
    """The least rotation that turns z to a unit vector."""
    axis = np.cross(_AXES["z"], direction)
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 1e-12 else np.array(_AXES["x"])
    return _turned(axis, math.atan2(sine, direction[2]))


def _turned(axis: ArrayLike, angle: float) -> Array:
    rotation: Array = pin.AngleAxis(float(angle), np.asarray(axis, dtype=float)).toRotationMatrix()
    return rotation
