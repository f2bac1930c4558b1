"""Xacro files, expanded without allowing an untrusted file more than arithmetic.

Xacro evaluates Python expressions in ``${...}``, reads YAML files, includes other files, and reads environment
variables. Unless the caller trusts the file, a copy of xacro expands it that can do none of this: for every expression,
every ``$(...)`` and every file, wherever and whenever it meets them, it calls this module. That evaluates arithmetic
(never by Python's ``eval``), knows ``$(arg ...)`` and ``$(find ...)``, and gives it files of the description's own
folder and of the packages that it finds: xacro files, which are read and checked once, before the expansion, and YAML
files, as plain data.
"""

from __future__ import annotations

import contextlib
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
from pinograsp.hands.file_reads import digest_of
from pinograsp.hands.ros_packages import Packages, find_package
from pinograsp.hands.xacro_files import ARGUMENT, LOADERS, MESSAGES, PACKAGE, Files, Refused

# One parameter of a macro: xacro's own pattern takes hours for some.
_PARAMETER = re.compile(
    r"""\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{[^}]*\}|\$\([^)]*\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)(?:\s+|$)(.*)""",
    re.DOTALL,
)
_ONE_AT_A_TIME = threading.Lock()  # for the error stream is everybody's
_TRUST = "pass trusted=True if you trust this file"
_MOST_WORK, _MOST_TIME = 100_000, 10.0  # elements and expressions together, and [s]


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
    try:
        with _ONE_AT_A_TIME, contextlib.redirect_stderr(io.StringIO()):  # xacro prints what its errors say as well
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
    module = _copy_of_xacro()
    extended = module.eval_extension

    def with_packages(text: str) -> Any:  # what xacro makes of it
        found = PACKAGE.fullmatch(text[2:-1])
        folder = find_package(found[1], path.resolve().parent, packages) if found else None
        return extended(text) if folder is None else str(folder)

    module.eval_extension = with_packages
    document: minidom.Document = module.process_file(str(path), mappings=mappings)
    for name in (str(path), *module.all_includes):
        with contextlib.suppress(OSError):
            digest_of(name)
    return document


def _guarded(path: Path, mappings: dict[str, str], packages: Packages) -> minidom.Document:
    files = Files(path, packages)
    if files.problems:
        raise HandNotLoaded(path, [*files.problems, _TRUST])
    try:
        document: minidom.Document = _harmless_xacro(files).process_file(str(path), mappings=mappings)
        return document
    except RecursionError:
        raise
    except Exception as error:
        refused: BaseException | None = error
        while refused is not None and not isinstance(refused, Refused | arithmetic.NotArithmetic):
            refused = getattr(refused, "exc", None)
        if refused is None:
            raise
        raise HandNotLoaded(path, [str(error), _TRUST]) from error


# -- a copy of xacro that calls this module ----------------------------------------------------------------------------

_DISABLED = ("load_yaml", "eval", "exec", "compile", "open", "glob")


def _copy_of_xacro() -> Any:  # xacro has no types
    """A copy of the module xacro of its own: xacro keeps its state in its module, and nobody else's is to change."""
    spec: Any = importlib.util.find_spec("xacro")  # never None: the package depends on it
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _harmless_xacro(files: Files) -> Any:  # xacro has no types
    """A copy of the module xacro, which asks a guard instead of evaluating, opening or including."""
    module = _copy_of_xacro()
    guard = _Guard(module, files)
    replaced = {
        "safe_eval": guard.evaluate,
        "eval_extension": guard.argument,
        "parse": guard.parse,
        "get_include_files": guard.included,
        "parse_macro_arg": _parameter,
        "replace_node": guard.replaced(getattr(module, "replace_node", None)),
        "_global_symbols": {},
    }
    if lacking := replaced.keys() - vars(module).keys():  # other versions might evaluate or open elsewhere
        without = ", ".join(sorted(lacking))
        raise RuntimeError(f"this xacro cannot be guarded (it has no {without}): pass trusted=True, or use 2.x")
    # What is disabled is not needed: a call of it is a gap in the guard.
    vars(module).update(replaced, **dict.fromkeys(_DISABLED, _disabled))
    return module


def _disabled(*_: object, **__: object) -> None:
    raise Refused("only arithmetic is allowed")


# What replaces an element: nothing, a node or several.
_Nodes: TypeAlias = minidom.Node | list[minidom.Node] | None


class _Guard:
    """What the copy of xacro calls instead, and its limits for one file."""

    def __init__(self, module: Any, files: Files):  # the copy of xacro has no types
        self.module, self.files = module, files
        self.work, self.until = 0, time.monotonic() + _MOST_TIME
        self.functions: dict[str, Callable[..., arithmetic.Value]] = {
            **dict.fromkeys(LOADERS, self.loaded),
            **dict.fromkeys(MESSAGES, lambda *_: ""),
        }

    def charge(self, work: int) -> None:
        self.work += work
        if self.work > _MOST_WORK:
            raise Refused(f"it expands to more than {_MOST_WORK} elements and expressions")
        if time.monotonic() > self.until:
            raise Refused(f"expanding it takes more than {_MOST_TIME:g} s")

    def evaluate(self, expression: str, symbols: Mapping[str, arithmetic.Value], _: object = None) -> arithmetic.Value:
        value = arithmetic.evaluate(expression, symbols, self.functions)
        self.charge(1 + arithmetic.size_of(value) // (16 if isinstance(value, dict) else 64))
        return value

    def loaded(self, name: object) -> arithmetic.Value:
        return self.files.data(str(self.module.abs_filename_spec(str(name))))

    def argument(self, text: str) -> str:
        self.charge(1)
        if package := PACKAGE.fullmatch(text[2:-1]):
            if (folder := self.files.package(package[1])) is None:
                raise Refused(self.files.without(package[1]))
            return str(folder)
        found = ARGUMENT.fullmatch(text[2:-1])
        if not found:
            raise Refused(f"'{text}': only $(arg name) and $(find package) are allowed")
        arguments: dict[str, str] = self.module.substitution_args_context["arg"]
        if found[1] not in arguments:
            raise NameError(f"undefined argument '{found[1]}': give it a value (xacro_args=), or a default")
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

    def replaced(self, replace: Any) -> Callable[..., None]:
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
