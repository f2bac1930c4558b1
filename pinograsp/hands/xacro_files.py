"""Files that an untrusted xacro file is made of: looked through for what goes beyond arithmetic and its own folder."""

from __future__ import annotations

import functools
import os
import re
import xml.dom.minidom as minidom
from pathlib import Path

from pinograsp.hands import arithmetic
from pinograsp.hands.elements import parse_xml, read_bytes
from pinograsp.hands.ros_packages import Packages, find_package
from pinograsp.hands.yaml_data import SUFFIXES, read_yaml

_EXPRESSION = re.compile(r"\$\{([^}]*)\}")
_SUBSTITUTION = re.compile(r"\$\{([^}]*)\}|\$\(([^)]*)\)|(\$)")
ARGUMENT, PACKAGE = re.compile(r"\s*arg\s+(\w+)\s*"), re.compile(r"\s*find\s+([\w.-]+)\s*")
_IN_PACKAGE = re.compile(r"\$\(\s*find\s+([\w.-]+)\s*\)/(.*)")
_FIRST = re.compile(r"^\$\(\s*find\s[^)]*\)/")
_PACKAGES = re.compile(r"\$\(\s*find\s+([\w.-]+)\s*\)")
_OUTSIDE = "outside the file's own folder and its packages"
_EXTENSION = re.compile(r"\$\(([^)]*)\)")
# What expressions may call beside arithmetic, by their names; the messages are for nobody here.
MESSAGES = ("xacro.message", "xacro.warning", "xacro.error")
LOADERS = ("load_yaml", "xacro.load_yaml")
_MOST_FILES = 100


class Refused(Exception):
    """The file asks for something that is not allowed."""


class Files:
    """A file and those that it includes, parsed and checked once.

    Attributes:
        problems: everything that goes beyond arithmetic and the file's own folder.
    """

    def __init__(self, path: Path, packages: Packages):
        self.folder = path.resolve().parent
        self.problems: list[str] = []
        self._documents: dict[Path, minidom.Document] = {}
        self._data: dict[Path, arithmetic.Value] = {}
        self._given = packages
        self._packages: dict[str, Path | None] = {}
        self._look_through_all(path.resolve())

    def _look_through_all(self, path: Path) -> None:
        """A file and those that it includes."""
        waiting = [path]
        while waiting:
            one = waiting.pop()
            if one in self._documents:
                continue
            if len(self._documents) >= _MOST_FILES:
                raise ValueError(f"it includes more than {_MOST_FILES} files")
            try:
                waiting += self._look_through(one)
            except ValueError as error:
                raise ValueError(f"{one.name}: {error}") from error

    def package(self, name: str) -> Path | None:
        """The folder of a package; None where there is none."""
        if name not in self._packages:
            self._packages[name] = find_package(name, self.folder, self._given)
        return self._packages[name]

    def without(self, name: str) -> str:
        """Why a package is not found, with the names of all others that are not."""
        others = [other for other, folder in self._packages.items() if folder is None and other != name]
        also = f" (nor of {', '.join(others)})" if others else ""
        return (
            f"'$(find {name})': no package.xml of that name{also} in the folders above or in ROS_PACKAGE_PATH: its "
            "folder is to be given by packages="
        )

    def document(self, name: str) -> minidom.Document:
        """A copy of the parsed file; :class:`Refused` where it may not be included.

        Files whose names came out of an expression are looked through here.
        """
        path = Path(name).resolve()
        if path not in self._documents:
            if not self._allowed(path):
                raise Refused(f"include of '{name}': {_OUTSIDE}")
            before = len(self.problems)
            self._look_through_all(path)
            if self.problems[before:]:
                raise Refused("; ".join(self.problems[before:]))
        return self._documents[path].cloneNode(True)  # type: ignore[return-value]  # None is for shallow copies

    def data(self, name: str) -> arithmetic.Value:
        """What a YAML file says; :class:`Refused` where it is none, or one that may not be read."""
        path = Path(name).resolve()
        if not self._allowed(path) or path.suffix not in SUFFIXES:
            raise Refused(
                f"load_yaml of '{name}': only .yaml files of the file's own folder and its packages are allowed"
            )
        if path not in self._data:
            if len(self._data) >= _MOST_FILES:
                raise Refused(f"it reads more than {_MOST_FILES} YAML files")
            try:
                self._data[path] = read_yaml(path)
            except FileNotFoundError:
                raise ValueError(f"load_yaml: no file '{path}': are the arguments right (xacro_args=)?") from None
            except (OSError, ValueError) as error:
                raise Refused(f"load_yaml of '{name}': {error}") from error
        return self._data[path]

    def _allowed(self, path: Path) -> bool:
        return any(path.is_relative_to(one) for one in (self.folder, *self._packages.values()) if one is not None)

    def _look_through(self, path: Path) -> list[Path]:
        """Parse a file and note its problems; the files that it includes."""
        content = read_bytes(path)
        parse_xml(content)  # refuses what is too large, too deep or has a document type
        document = self._documents[path] = minidom.parseString(content)
        included: list[Path] = []
        waiting: list[minidom.Document | minidom.Element] = [document]
        while waiting:
            parent = waiting.pop()
            for node in list(parent.childNodes):
                if isinstance(node, minidom.Element):
                    waiting.append(node)
                    texts = [value for _, value in node.attributes.items()]
                    if node.tagName.split(":")[-1] == "include":
                        included += self._included(node.getAttribute("filename"), path)
                elif isinstance(node, minidom.Text):  # or a CDATA section
                    texts = [node.data]
                else:
                    # Comments, which can make xacro evaluate.
                    parent.removeChild(node)  # type: ignore[type-var]  # no type covers the children of both parents
                    continue
                for text in texts:
                    for name in _PACKAGES.findall(text):
                        self.package(name)  # so that all that are not found can be named at once
                    self.problems += [f"{path.name}: {problem}" for problem in _forbidden_text(text)]
        return included

    def _included(self, name: str, path: Path) -> list[Path]:
        start, inside = path.parent, name
        if found := _IN_PACKAGE.fullmatch(name):
            start, inside = self.package(found[1]) or start, found[2]
            if self.package(found[1]) is None:
                return []  # refused where it is included, which may be never
        if re.search(r"[*?\[]|\$\(\s*find", _EXPRESSION.sub("", _FIRST.sub("", name))):
            self.problems.append(f"{path.name}: include of '{name}': only plain file names are allowed")
            return []
        if "$" in inside:
            return []  # looked through where it is included
        target = (start / inside).resolve()
        if not self._allowed(target):
            self.problems.append(f"{path.name}: include of '{name}': {_OUTSIDE}")
            return []
        return [target] if os.path.isfile(target) else []  # xacro says which are missing, where they are not optional


def _forbidden_text(text: str) -> list[str]:
    problems: list[str] = []
    if "$" in text and len(text) > arithmetic.MOST_TEXT:
        return [f"a text with expressions has more than {arithmetic.MOST_TEXT} characters"]
    for match in _SUBSTITUTION.finditer(text):
        expression, extension, dollar = match.groups()
        if dollar:
            problems.append(f"stray '$' in '{text.strip()}'")
        elif extension is not None:
            problems += _forbidden_extension(extension)
        else:
            for inner in _EXTENSION.findall(expression):
                problems += _forbidden_extension(inner)
            problems += _forbidden_expression(expression)
    return problems


def _forbidden_extension(text: str) -> list[str]:
    """Expressions in it are evaluated first; the name that comes out is looked at where it is used."""
    named = _EXPRESSION.sub("x", text)
    if PACKAGE.fullmatch(named) or ARGUMENT.fullmatch(named):
        return [problem for inner in _EXPRESSION.findall(text) for problem in _forbidden_expression(inner)]
    return [f"'$({text})': only $(arg name) and $(find package) are allowed"]


def _forbidden_expression(text: str) -> list[str]:
    beyond = f"expression '${{{text}}}': only arithmetic and looking up of data are allowed"
    try:
        tree = arithmetic.parsed(_EXTENSION.sub("x", text))
    except arithmetic.NotPython:
        return []  # refused where it is evaluated, which may be never: ${f('${name}')} ends at the first }
    except arithmetic.NotArithmetic as error:
        return [f"{beyond}: {error}"]
    used = arithmetic.names(tree, (*LOADERS, *MESSAGES))
    return [f"{beyond}, not {name}" for name in sorted(used & _beyond_arithmetic())]


@functools.cache
def _beyond_arithmetic() -> frozenset[str]:
    """Xacro's own names that are not arithmetic."""
    import xacro

    return frozenset(xacro._global_symbols) - {*arithmetic.FUNCTIONS, *arithmetic.CONSTANTS, "math"}
