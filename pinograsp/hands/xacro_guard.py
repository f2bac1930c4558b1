"""Xacro files, expanded without allowing an untrusted file more than arithmetic.

Xacro evaluates Python expressions in ``${...}``, reads YAML files, includes other files, and reads environment
variables. Unless the caller trusts the file, a copy of xacro expands it that can do none of this: for every expression,
every ``$(...)`` and every file, wherever and whenever it meets them, it calls this module. That evaluates arithmetic
(never by Python's ``eval``), knows ``$(arg ...)`` and ``$(find ...)``, and gives it files of the description's own
folder and of the packages that it finds, which are read and checked once, before the expansion.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import io
import os
import re
import threading
import time
import xml.dom.minidom as minidom
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import arithmetic
from pinograsp.hands.elements import parse_xml, read_bytes
from pinograsp.hands.ros_packages import Packages, find_package

_SUBSTITUTION = re.compile(r"\$\{([^}]*)\}|\$\(([^)]*)\)|(\$)")
_ARGUMENT, _PACKAGE = re.compile(r"\s*arg\s+(\w+)\s*"), re.compile(r"\s*find\s+([\w.-]+)\s*")
_IN_PACKAGE = re.compile(r"\$\(\s*find\s+([\w.-]+)\s*\)/(.*)")
# One parameter of a macro: xacro's own pattern takes hours for some.
_PARAMETER = re.compile(
    r"""\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{[^}]*\}|\$\([^)]*\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)(?:\s+|$)(.*)""",
    re.DOTALL,
)
_MOST_FILES, _MOST_WORK, _MOST_TIME = 100, 100_000, 10.0  # files, elements and expressions together, and [s]


def expand_xacro(
    path: str | Path,
    mappings: Mapping[str, object] | None = None,
    *,
    trusted: bool = False,
    packages: Packages = MappingProxyType({}),
) -> str:
    """The URDF text that xacro makes of the file at ``path``.

    ``mappings`` fills ``<xacro:arg>``. With ``trusted=False`` (default) a file that asks for more than arithmetic and
    includes of its own folder, or of packages in the folders above it and where ROS looks, is refused with
    :class:`HandNotLoaded`, which lists every such place. ``trusted=True``
    hands the file to xacro as it is: it can then read any file and run any program the user can, so use it for your own
    files only. ``packages`` gives the folders of ROS packages by name, which are looked for first; neither way needs an
    installation of ROS.
    """
    path = Path(path)
    texts = {name: str(value) for name, value in (mappings or {}).items()}
    complaints = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaints):  # xacro prints its warnings; they belong in the error, if any
            document = _trusted(path, texts, packages) if trusted else _guarded(path, texts, packages)
        for node in list(document.childNodes):  # xacro's banner carries the path it was given: not reproducible
            if node.nodeType == node.COMMENT_NODE:
                document.removeChild(node)
        lines = document.toprettyxml(indent="  ").splitlines()
    except HandNotLoaded:
        raise
    except Exception as error:  # xacro raises its own, the XML parser's, and whatever an expression raises
        problem = "it includes or calls itself without end" if isinstance(error, RecursionError) else error
        raise HandNotLoaded(path, f"xacro could not expand it: {problem}") from error
    return "\n".join(line for line in lines if line.strip()) + "\n"


def _trusted(path: Path, mappings: dict[str, str], packages: Packages) -> minidom.Document:
    with _ONE_AT_A_TIME:  # xacro keeps its state in its module
        module = _copy_of_xacro()
        extended = module.eval_extension

        def with_packages(text: str) -> Any:  # what xacro makes of it
            found = _PACKAGE.fullmatch(text[2:-1])
            folder = find_package(found[1], path.resolve().parent, packages) if found else None
            return extended(text) if folder is None else str(folder)

        module.eval_extension = with_packages
        document: minidom.Document = module.process_file(str(path), mappings=mappings)
        return document


def _guarded(path: Path, mappings: dict[str, str], packages: Packages) -> minidom.Document:
    files = _Files(path, packages)
    if files.problems:
        raise HandNotLoaded(path, [*files.problems, "pass trusted=True to load_hand if you trust this file"])
    with _ONE_AT_A_TIME:  # xacro keeps its state in its module
        module = _harmless_xacro()
        module.guard.begin(files)
        try:
            document: minidom.Document = module.process_file(str(path), mappings=mappings)
            return document
        except RecursionError:
            raise
        except Exception as error:
            refused: BaseException | None = error
            while refused is not None and not isinstance(refused, _Refused | arithmetic.NotArithmetic):
                refused = getattr(refused, "exc", None)
            if refused is None:
                raise
            raise HandNotLoaded(path, [str(error), "pass trusted=True to load_hand if you trust this file"]) from error
        finally:
            module.guard.end()


class _Refused(Exception):
    """The file asks for something that is not allowed."""


# -- files -------------------------------------------------------------------------------------------------------------


class _Files:
    """A file and those that it includes, parsed and checked once.

    Attributes:
        problems: everything that goes beyond arithmetic and the file's own folder.
    """

    def __init__(self, path: Path, packages: Packages):
        self.folder = path.resolve().parent
        self.problems: list[str] = []
        self._documents: dict[Path, minidom.Document] = {}
        self._given = packages
        self._packages: dict[str, Path | None] = {}
        waiting = [path.resolve()]
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

    def document(self, name: str) -> minidom.Document:
        """A copy of the parsed file; :class:`_Refused` where it is not one that was checked."""
        found = self._documents.get(Path(name).resolve())
        if found is None:
            raise _Refused(f"the file '{name}' is missing, or may not be included")
        return found.cloneNode(True)  # type: ignore[return-value]  # None is for shallow copies

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
                forbidden = (problem for text in texts for problem in _forbidden_text(text, self.package))
                self.problems += [f"{path.name}: {problem}" for problem in forbidden]
        return included

    def _included(self, name: str, path: Path) -> list[Path]:
        start, inside = path.parent, name
        if (found := _IN_PACKAGE.fullmatch(name)) and (package := self.package(found[1])) is not None:
            start, inside = package, found[2]
        if "$" in inside or re.search(r"[*?\[]", inside):
            self.problems.append(f"{path.name}: include of '{name}': only plain file names are allowed")
            return []
        target = (start / inside).resolve()
        if not any(target.is_relative_to(one) for one in (self.folder, *self._packages.values()) if one is not None):
            self.problems.append(f"{path.name}: include of '{name}': outside the file's own folder and its packages")
            return []
        return [target] if os.path.isfile(target) else []  # xacro says which are missing, where they are not optional


def _forbidden_text(text: str, package: Callable[[str], Path | None]) -> list[str]:
    problems: list[str] = []
    if "$" in text and len(text) > arithmetic.MOST_TEXT:
        return [f"a text with expressions has more than {arithmetic.MOST_TEXT} characters"]
    for match in _SUBSTITUTION.finditer(text):
        expression, extension, dollar = match.groups()
        if dollar:
            problems.append(f"stray '$' in '{text.strip()}'")
        elif extension is not None:
            if (found := _PACKAGE.fullmatch(extension)) and package(found[1]) is None:
                problems.append(
                    f"'$({extension})': no package.xml of that name in the folders above or in ROS_PACKAGE_PATH: give "
                    "its folder (packages=, --package NAME=DIR)"
                )
            elif not found and not _ARGUMENT.fullmatch(extension):
                problems.append(f"'$({extension})': only $(arg name) and $(find package) are allowed")
        else:
            try:
                tree = arithmetic.parsed(expression)
            except arithmetic.NotArithmetic as error:
                problems.append(f"expression '${{{expression}}}': only arithmetic is allowed: {error}")
            else:
                problems += [
                    f"expression '${{{expression}}}': only arithmetic is allowed, not {name}"
                    for name in arithmetic.names(tree)
                    if name in _beyond_arithmetic()
                ]
    return problems


@functools.cache
def _beyond_arithmetic() -> frozenset[str]:
    """Xacro's own names that are not arithmetic."""
    import xacro

    return frozenset(xacro._global_symbols) - set(arithmetic.FUNCTIONS) - {"math"}


# -- a copy of xacro that calls this module ----------------------------------------------------------------------------

_ONE_AT_A_TIME = threading.Lock()
# What the copy must have for the guard to replace it: other versions might evaluate or open elsewhere.
_REPLACED = (
    "safe_eval",
    "eval_extension",
    "parse",
    "get_include_files",
    "parse_macro_arg",
    "replace_node",
    "load_yaml",
    "_global_symbols",
)
_DISABLED = ("eval", "exec", "compile", "open", "glob")


def _copy_of_xacro() -> Any:  # xacro has no types
    """A second copy of the module xacro."""
    spec: Any = importlib.util.find_spec("xacro")  # never None: the package depends on it
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@functools.cache
def _harmless_xacro() -> Any:  # xacro has no types
    """A copy of the module xacro, which asks its ``guard`` instead of evaluating, opening or including."""
    module = _copy_of_xacro()
    if lacking := [name for name in _REPLACED if name not in vars(module)]:
        raise RuntimeError(
            f"this version of xacro cannot be guarded (it has no {', '.join(lacking)}): pass trusted=True, or use 2.x"
        )
    guard = module.guard = _Guard(module)
    module.safe_eval, module.eval_extension, module.parse = guard.evaluate, guard.argument, guard.parse
    module.get_include_files, module.parse_macro_arg = guard.included, _parameter
    module.replace_node = guard.replaced(module.replace_node)
    module._global_symbols = {}
    for name in ("load_yaml", *_DISABLED):  # not needed: a call of one of them is a gap in the guard
        setattr(module, name, _disabled)
    return module


def _disabled(*_: object, **__: object) -> None:
    raise _Refused("only arithmetic is allowed")


# What replaces an element: nothing, a node or several.
_Nodes: TypeAlias = minidom.Node | list[minidom.Node] | None


class _Guard:
    """What the copy of xacro calls instead, and its limits for one file."""

    def __init__(self, module: Any):  # the copy of xacro, which has no types
        self.module = module

    def begin(self, files: _Files) -> None:
        self.files = files
        self.work, self.until = 0, time.monotonic() + _MOST_TIME

    def end(self) -> None:
        del self.files
        self.module.substitution_args_context.clear()

    def charge(self, work: int) -> None:
        self.work += work
        if self.work > _MOST_WORK:
            raise _Refused(f"it expands to more than {_MOST_WORK} elements and expressions")
        if time.monotonic() > self.until:
            raise _Refused(f"expanding it takes more than {_MOST_TIME:g} s")

    def evaluate(self, expression: str, symbols: Mapping[str, arithmetic.Value], _: object = None) -> arithmetic.Value:
        value = arithmetic.evaluate(expression, symbols)
        self.charge(1 + (len(value) // 64 if isinstance(value, str | list) else 0))
        return value

    def argument(self, text: str) -> str:
        self.charge(1)
        if (package := _PACKAGE.fullmatch(text[2:-1])) and (folder := self.files.package(package[1])) is not None:
            return str(folder)
        found = _ARGUMENT.fullmatch(text[2:-1])
        if not found:
            raise _Refused(f"'{text}': only $(arg name) and $(find package) are allowed")
        arguments: dict[str, str] = self.module.substitution_args_context["arg"]
        if found[1] not in arguments:
            raise NameError(f"undefined argument '{found[1]}': give it a value, or a default")
        return arguments[found[1]]

    def parse(self, _: object, name: str) -> minidom.Document:
        if not os.path.isfile(name):  # in xacro's own words: it goes on where the file is optional
            self.module.filestack.pop()
            raise self.module.XacroException(f"No such file: {name}", exc=FileNotFoundError(name))
        document = self.files.document(name)
        self.charge(_weight(document))
        return document

    def included(self, name: str, symbols: Mapping[str, arithmetic.Value]) -> Iterator[str]:
        yield self.module.abs_filename_spec(str(self.module.eval_text(name, symbols)))

    def replaced(self, replace: Callable[..., None]) -> Callable[..., None]:
        def counted(element: minidom.Node, by: _Nodes, content_only: bool = False) -> None:
            for one in by if isinstance(by, list) else [by]:
                self.charge(1 if one is None else _weight(one))
            replace(element, by, content_only)

        return counted


def _weight(node: minidom.Node) -> int:
    """Elements below a node, and more for long texts."""
    weight, waiting = 0, [node]
    while waiting:
        one = waiting.pop()
        weight += 1
        if isinstance(one, minidom.Element):
            if one.hasAttributes():
                weight += sum(len(value) for _, value in one.attributes.items()) // 64
        elif isinstance(one, minidom.Text):
            weight += len(one.data) // 64
        waiting += one.childNodes
    return weight


def _parameter(text: str) -> tuple[str, tuple[str | None, str | None] | None, str]:
    """The first parameter of a macro: its name, (whether and which to forward, default) or None, and the rest."""
    found = _PARAMETER.match(text)
    if not found:
        name, *others = text.split(None, 1)
        return name, None, others[0] if others else ""
    name, forward, default, rest = found.groups()
    return name, (name if forward else None, default or None), rest
