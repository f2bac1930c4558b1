"""Xacro files, expanded without allowing an untrusted file more than arithmetic.

Xacro evaluates Python expressions in ``${...}``, reads YAML files, includes other files, and reads environment
variables. Unless the caller trusts the file, a copy of xacro expands it that can do none of this: for every expression,
every ``$(...)`` and every file, wherever and whenever it meets them, it calls this module. That evaluates arithmetic
(never by Python's ``eval``), knows ``$(arg ...)`` and ``$(find ...)``, and gives it files of the description's own
folder and of the packages that it finds: xacro files, each read and looked through once, and YAML files, as plain data.
"""

from __future__ import annotations

import ast
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
from typing import Any

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import arithmetic
from pinograsp.hands.elements import parse_xml, read_bytes
from pinograsp.hands.file_reads import digest_of
from pinograsp.hands.ros_packages import Packages, find_package
from pinograsp.hands.yaml_data import SUFFIXES, read_yaml

# One parameter of a macro: xacro's own pattern takes hours for some.
_PARAMETER = re.compile(
    r"""\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{[^}]*\}|\$\([^)]*\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)(?:\s+|$)(.*)""",
    re.DOTALL,
)
_EXPRESSION, _EXTENSION = re.compile(r"\$\{([^}]*)\}"), re.compile(r"\$\(([^)]*)\)")
_ANY = re.compile(r"\$\{([^}]*)\}|\$\(([^)]*)\)|(\$)")
_ARGUMENT, _PACKAGE = re.compile(r"\s*arg\s+(\w+)\s*"), re.compile(r"\s*find\s+([\w.-]+)\s*")
_NO_PLAIN_NAME = re.compile(r"[*?\[]|.\$\(\s*find")  # of an included file, expressions left out
# What expressions may call beside arithmetic: files of data, mappings, and messages, which are for nobody here.
_CALLS = re.compile(r"\b((xacro\.)?load_yaml|xacro\.(message|warning|error)|dict)\s*\(")
_NOT_VALUES = {"xacro", "python", "load_yaml"}
_ONE_AT_A_TIME = threading.Lock()  # for the error stream is everybody's
_TRUST = "pass trusted=True if you trust this file"
_MOST_WORK, _MOST_TIME = 100_000, 10.0  # elements and expressions together, and [s]
_MOST_FILES = 100


class NotAllowed(Exception):
    """The file asks for something that is not allowed."""


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
    :class:`HandNotLoaded`, which lists the places. ``trusted=True``
    hands the file to xacro as it is: it can then read any file and run any program the user can, so use it for your own
    files only. ``packages`` gives the folders of ROS packages by name, which are looked for first; neither way needs an
    installation of ROS.
    """
    path = Path(path)
    texts = {name: str(value) for name, value in (mappings or {}).items()}
    spec: Any = importlib.util.find_spec("xacro")  # never None: the package depends on it
    module: Any = importlib.util.module_from_spec(spec)  # a copy: xacro keeps its state in its module
    spec.loader.exec_module(module)
    try:
        with _ONE_AT_A_TIME, contextlib.redirect_stderr(io.StringIO()):  # xacro prints what its errors say as well
            if trusted:
                _find_packages(module, path.resolve().parent, packages)
            else:
                _Guard(module, path.resolve().parent, packages)
            document = module.process_file(str(path), mappings=texts)
        for name in (str(path), *module.all_includes) if trusted else ():
            with contextlib.suppress(OSError):
                digest_of(name)
        for node in list(document.childNodes):  # xacro's banner carries the path it was given: not reproducible
            if node.nodeType == node.COMMENT_NODE:
                document.removeChild(node)
        lines = document.toprettyxml(indent="  ").splitlines()
    except Exception as error:  # xacro raises its own, the XML parser's, and whatever an expression raises
        refusal: BaseException | None = error
        while refusal is not None and not isinstance(refusal, NotAllowed | arithmetic.NotArithmetic):
            refusal = getattr(refusal, "exc", None)
        if refusal is not None:
            raise HandNotLoaded(path, [*str(error).split("\n"), _TRUST]) from error
        problem = "it includes or calls itself without end" if isinstance(error, RecursionError) else error
        raise HandNotLoaded(path, f"xacro could not expand it: {problem}") from error
    return "\n".join(line for line in lines if line.strip()) + "\n"


def _find_packages(module: Any, folder: Path, packages: Packages) -> None:
    """Let a copy of xacro find packages without ROS."""
    evaluate = module.eval_extension

    def evaluate_extension(text: str) -> Any:  # what xacro makes of it
        named = _PACKAGE.fullmatch(text[2:-1])
        found = find_package(named[1], folder, packages) if named else None
        return evaluate(text) if found is None else str(found)

    module.eval_extension = evaluate_extension


class _Guard:
    """What a copy of xacro asks instead of evaluating, opening or including; its limits for one file."""

    def __init__(self, module: Any, folder: Path, packages: Packages):  # xacro has no types
        self.module, self.folder, self.given = module, folder, packages
        self.work, self.until = 0, time.monotonic() + _MOST_TIME
        self.packages: dict[str, Path | None] = {}
        self.files: dict[Path, Any] = {}  # parsed documents, and data
        self.functions = dict.fromkeys(("load_yaml", "xacro.load_yaml"), self.load_data)
        self.functions |= dict.fromkeys(("xacro.message", "xacro.warning", "xacro.error"), lambda *_: "")
        replaced = {
            "safe_eval": self.evaluate,
            "eval_extension": self.evaluate_extension,
            "parse": self.parse,
            "get_include_files": self.find_included,
            "parse_macro_arg": _parse_parameter,
            "replace_node": self.count_nodes(getattr(module, "replace_node", None)),
            "_global_symbols": {},
        }
        if lacking := replaced.keys() - vars(module).keys():  # other versions might evaluate or open elsewhere
            without = ", ".join(sorted(lacking))
            raise RuntimeError(f"this xacro cannot be guarded (it has no {without}): pass trusted=True, or use 2.x")
        # What is disabled is not needed: a call of it is a gap in the guard.
        disabled = dict.fromkeys(("load_yaml", "eval", "exec", "compile", "open", "glob"), _refuse)
        vars(module).update(replaced, **disabled)

    def charge(self, work: int) -> None:
        self.work += work
        if self.work > _MOST_WORK:
            raise NotAllowed(f"it expands to more than {_MOST_WORK} elements and expressions")
        if time.monotonic() > self.until:
            raise NotAllowed(f"expanding it takes more than {_MOST_TIME:g} s")

    def evaluate(self, expression: str, symbols: Mapping[str, arithmetic.Value], _: object = None) -> arithmetic.Value:
        value = arithmetic.evaluate(expression, symbols, self.functions)
        self.charge(1 + arithmetic.size_of(value) // (16 if isinstance(value, dict) else 64))
        return value

    def evaluate_extension(self, text: str) -> str:
        self.charge(1)
        if package := _PACKAGE.fullmatch(text[2:-1]):
            return str(self.find(package[1]))
        if not (argument := _ARGUMENT.fullmatch(text[2:-1])):
            raise NotAllowed(f"'{text}': only $(arg name) and $(find package) are allowed")
        arguments: dict[str, str] = self.module.substitution_args_context["arg"]
        if argument[1] not in arguments:
            raise NameError(f"undefined argument '{argument[1]}': give it a value (xacro_args=), or a default")
        return arguments[argument[1]]

    def count_nodes(self, replace: Any) -> Callable[..., None]:
        def replace_node(element: minidom.Node, by: Any, content_only: bool = False) -> None:
            for one in by if isinstance(by, list) else [by]:
                self.charge(_weigh(one))
            replace(element, by, content_only)

        return replace_node

    # -- files: those of its own folder and its packages -------------------------------------------------------------

    def find(self, name: str) -> Path:
        """The folder of a package."""
        if name not in self.packages:
            self.packages[name] = find_package(name, self.folder, self.given)
        if (found := self.packages[name]) is not None:
            return found
        others = [other for other, folder in self.packages.items() if folder is None and other != name]
        also = f" (nor of {', '.join(others)})" if others else ""
        raise NotAllowed(
            f"'$(find {name})': no package.xml of that name{also} in the folders above or in ROS_PACKAGE_PATH: its "
            "folder is to be given by packages="
        )

    def check_place(self, what: str, name: str) -> Path:
        """The path that a name stands for, in a folder whose files may be read."""
        path = Path(name).resolve()
        if not any(path.is_relative_to(one) for one in (self.folder, *self.packages.values()) if one is not None):
            raise NotAllowed(f"{what} of '{name}': outside the file's own folder and its packages")
        if path not in self.files and len(self.files) >= _MOST_FILES:
            raise NotAllowed(f"it reads more than {_MOST_FILES} files")
        return path

    def find_included(self, name: str, symbols: Mapping[str, arithmetic.Value]) -> Iterator[str]:
        if _NO_PLAIN_NAME.search(_EXPRESSION.sub("", name)):
            raise NotAllowed(f"include of '{name}': only plain file names are allowed")
        yield self.module.abs_filename_spec(str(self.module.eval_text(name, symbols)))

    def parse(self, _: object, name: str) -> minidom.Document:
        path = self.check_place("include", name)
        if not os.path.isfile(path):  # in xacro's own words: it goes on where the file is optional
            self.module.filestack.pop()
            raise self.module.XacroException(f"No such file: {name}", exc=FileNotFoundError(name))
        if path not in self.files:
            self.files[path] = self.look_through(path)
        document: minidom.Document = self.files[path].cloneNode(True)
        self.charge(_weigh(document))
        return document

    def load_data(self, name: object) -> arithmetic.Value:
        name = str(self.module.abs_filename_spec(str(name)))
        path = self.check_place("load_yaml", name)
        if path.suffix not in SUFFIXES:
            raise NotAllowed(f"load_yaml of '{name}': only {' and '.join(SUFFIXES)} files are allowed")
        if path not in self.files:
            try:
                self.files[path] = read_yaml(path)
            except FileNotFoundError:
                raise ValueError(f"load_yaml: no file '{path}': are the arguments right (xacro_args=)?") from None
            except (OSError, ValueError) as error:
                raise NotAllowed(f"load_yaml of '{name}': {error}") from error
        return self.files[path]

    def look_through(self, path: Path) -> minidom.Document:
        """The parsed file, without comments, in which xacro may evaluate; refused for what is not allowed in it."""
        content = read_bytes(path)
        try:
            parse_xml(content)  # refuses what is too large, too deep or has a document type
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from error
        document = minidom.parseString(content)
        problems: list[str] = []
        waiting: list[Any] = [document]  # no type covers the children of both documents and elements
        while waiting:
            parent = waiting.pop()
            for node in list(parent.childNodes):
                texts = [value for _, value in (node.attributes or {}).items()]
                if isinstance(node, minidom.Text):  # or a CDATA section
                    texts = [node.data]
                elif isinstance(node, minidom.Element):
                    waiting.append(node)
                else:
                    parent.removeChild(node)
                for text in texts:
                    for package in re.findall(r"\$\(\s*find\s+([\w.-]+)\s*\)", text):
                        with contextlib.suppress(NotAllowed):  # so that all that are not found can be named at once
                            self.find(package)
                    problems += [f"{path.name}: {problem}" for problem in _find_forbidden(text)]
        if problems:
            raise NotAllowed("\n".join(problems))
        return document


def _refuse(*_: object, **__: object) -> None:
    raise NotAllowed("only arithmetic is allowed")


def _find_forbidden(text: str) -> Iterator[str]:
    """Yield what a text asks for that is not allowed; names out of expressions are looked at where they are used."""
    if "$" in text and len(text) > arithmetic.MOST_TEXT:
        yield f"a text with expressions has more than {arithmetic.MOST_TEXT} characters"
        return
    for expression, extension, dollar in _ANY.findall(text):
        if dollar:
            yield f"stray '$' in '{text.strip()}'"
        for inner in [extension, *_EXTENSION.findall(expression)]:
            name = _EXPRESSION.sub("x", inner)
            if inner and not (_PACKAGE.fullmatch(name) or _ARGUMENT.fullmatch(name)):
                yield f"'$({inner})': only $(arg name) and $(find package) are allowed"
        for inner in [expression, *_EXPRESSION.findall(extension)]:
            beyond = f"expression '${{{inner}}}': only arithmetic and looking up of data are allowed"
            try:
                arithmetic.parse_expression(_EXTENSION.sub("x", inner))
                called = arithmetic.parse_expression(_CALLS.sub("(", _EXTENSION.sub("x", inner)))
            except arithmetic.NotPython:
                continue  # refused where it is evaluated, which may be never: ${f('${name}')} ends at the first }
            except arithmetic.NotArithmetic as error:
                yield f"{beyond}: {error}"
                continue
            names = {node.id for node in ast.walk(called) if isinstance(node, ast.Name)}
            yield from (f"{beyond}, not {name}" for name in sorted(names & _NOT_VALUES))


def _weigh(node: minidom.Node | None) -> int:
    """Elements below a node, and more for long texts."""
    weight, waiting = 0, [node]
    while waiting:
        one = waiting.pop()
        weight += 1
        if isinstance(one, minidom.Element) and one.hasAttributes():
            weight += sum(len(value) for _, value in one.attributes.items()) // 64
        elif isinstance(one, minidom.Text):
            weight += len(one.data) // 64
        waiting += [] if one is None else one.childNodes
    return weight


def _parse_parameter(text: str) -> tuple[str, tuple[str | None, str | None] | None, str]:
    """The first parameter of a macro: its name, (whether and which to forward, default) or None, and the rest."""
    found = _PARAMETER.match(text)
    if not found:
        name, *others = text.split(None, 1)
        return name, None, others[0] if others else ""
    name, forward, default, rest = found.groups()
    return name, (name if forward else None, default or None), rest
