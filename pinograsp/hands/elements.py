"""XML of a robot: parsed, and its elements and numbers looked up."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from pinograsp.checks import shorten
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.file_reads import note_content

_XACRO = "{http://www.ros.org/wiki/xacro}"
# Far above any robot, low enough that reading them takes seconds.
MOST_BYTES, MOST_ELEMENTS, DEEPEST = 20_000_000, 50_000, 1000
# Of numbers in SI units, far above those of any robot: beyond it products and squares overflow in the end.
LARGEST = 1e6
LEAST = 1e-9  # of ranges, limits and directions, far below those of any robot
_MOST_ATTRIBUTES, _MOST_DIGITS = 1000, 2000  # of an element; characters of the numbers in one attribute


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """The content of a regular file; OSError for anything else, and for more than ``most`` bytes.

    Pipes and devices are not opened: they could make the reader wait, or never end.
    """
    size = os.stat(path).st_size
    if not os.path.isfile(path):
        raise OSError(f"{path} is not a regular file")
    if size > most:
        raise OSError(f"{path} has {size} bytes, more than the {most} that are read")
    content = path.read_bytes()
    note_content(path, content)
    return content


def is_text(value: str) -> bool:
    """Whether a text is that of an XML file, not the path of one."""
    return value.lstrip("\ufeff \t\r\n").startswith("<")


class _Builder(ElementTree.TreeBuilder):
    """Builds a tree of bounded size and depth, from XML without a document type."""

    def __init__(self, most: int):
        super().__init__()
        self.most, self.count, self.depth = most, 0, 0

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        raise ValueError("document type and entity declarations are not allowed")

    def start(self, tag: str, attributes: dict[str, str], /) -> ElementTree.Element:
        self.count, self.depth = self.count + 1, self.depth + 1
        if self.count > self.most:
            raise ValueError(f"expected at most {self.most} elements")
        if len(attributes) > _MOST_ATTRIBUTES:
            raise ValueError(f"expected at most {_MOST_ATTRIBUTES} attributes in an element")
        if self.depth > DEEPEST:
            raise ValueError(f"elements nested without end: expected at most {DEEPEST} deep")
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> ElementTree.Element:
        self.depth -= 1
        return super().end(tag)


def parse_xml(content: str | bytes, most: int = MOST_ELEMENTS) -> ElementTree.Element:
    """The outermost element of a text, or of a file's bytes in the encoding that they declare.

    Raises:
        ValueError: not well-formed, of an unknown encoding, too large or too deep, or with a document type (whose
            entities could make a small file a huge one, or bring in other files).
    """
    try:
        return ElementTree.fromstring(content, parser=ElementTree.XMLParser(target=_Builder(most)))
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"not well-formed XML: {error}") from error


def parse(source: str, text: str) -> ElementTree.Element:
    """The outermost element of a description, names without namespaces.

    Raises:
        HandNotLoaded: not XML, or not of a robot.
    """
    try:
        robot = parse_xml(text.lstrip("\ufeff").strip())
    except ValueError as error:
        raise HandNotLoaded(source, str(error)) from error
    if any(element.tag.startswith(_XACRO) for element in robot.iter()):
        raise HandNotLoaded(source, "holds xacro commands: give the file the ending .xacro, or expand it first")
    for element in robot.iter():
        element.tag = element.tag.rsplit("}", 1)[-1]
    if robot.tag not in ("robot", "mujoco"):
        raise HandNotLoaded(source, f"expected <robot> (URDF) or <mujoco> (MJCF), found <{robot.tag}>")
    return robot


def find_named(robot: ElementTree.Element, tag: str) -> list[tuple[str, ElementTree.Element]]:
    """The robot's elements of a kind, with their names."""
    return [(element.get("name", ""), element) for element in robot.findall(tag)]


def end_of(joint: ElementTree.Element, tag: str) -> str:
    """The link of a joint's <parent> or <child>."""
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")


def floats(text: str) -> list[float]:
    """Numbers separated by blanks; ValueError for anything else, for infinite ones and for too long a text."""
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"more than {_MOST_DIGITS} characters")
    values = [float(value) for value in text.split()]
    if not all(map(math.isfinite, values)):
        raise ValueError("not finite")
    return values


def numbers(
    element: ElementTree.Element, key: str, count: int, default: str | None = None, most: float = math.inf
) -> list[float]:
    """``count`` finite numbers of an attribute, no larger than ``most``; ValueError for anything else."""
    text = element.get(key, default)
    try:
        values = [] if text is None else floats(text)
    except ValueError:
        values = []
    if len(values) != count:
        raise ValueError(f"expected {count} finite number{'s' * (count > 1)}, got {shorten(text)}")
    if max(map(abs, values)) > most:
        raise ValueError(f"expected {'numbers' if count > 1 else 'a number'} of at most {most:g}, got {shorten(text)}")
    return values
