"""Xacro files, expanded by xacro without ROS: guarded, unless the caller trusts the file."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.arithmetic import NotAllowed
from pinograsp.hands.elements import read_bytes
from pinograsp.hands.file_reads import digest_of
from pinograsp.hands.ros_packages import PackageNotFound, Packages, find_package
from pinograsp.hands.tree import MOVING
from pinograsp.hands.xacro_guard import PACKAGE, Guard
from pinograsp.words import few

_ONE_AT_A_TIME = threading.Lock()  # for the error stream is everybody's


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
    :class:`HandNotLoaded` where xacro comes to that. ``trusted=True`` hands the file to xacro as it is: it can then
    read any file and run any program the user can, so use it for your own files only. ``packages`` gives the folders of
    ROS packages by name, which are looked for first; neither way needs an installation of ROS.
    """
    path = Path(path)
    texts = {name: str(value) for name, value in (mappings or {}).items()}
    spec: Any = importlib.util.find_spec("xacro")  # never None: the package depends on it
    module: Any = importlib.util.module_from_spec(spec)  # a copy: xacro keeps its state in its module
    spec.loader.exec_module(module)
    try:
        with _ONE_AT_A_TIME, contextlib.redirect_stderr(io.StringIO()):  # xacro prints what its errors say as well
            (_find_packages if trusted else Guard)(module, path.resolve().parent, packages)
            defined = _note_macros(module)
            document = module.process_file(str(path), mappings=texts)
        for name in (str(path), *module.all_includes) if trusted else ():
            with contextlib.suppress(OSError):
                digest_of(name)
        # Without xacro's banner, which carries the path that it was given: not reproducible.
        lines = document.documentElement.toprettyxml(indent="  ").splitlines()
    except Exception as error:  # xacro raises its own, the XML parser's, and whatever an expression raises
        cause = _cause_of(error)
        problem = "it includes or calls itself without end" if isinstance(error, RecursionError) else str(error)
        problem = f"no entry {problem}" if isinstance(cause, KeyError) else problem
        place = "".join(f"{Path(name).name}: " for name in (getattr(module, "filestack", None) or [])[-1:])
        problems = [place + line for line in problem.split("\n")]
        if isinstance(cause, PackageNotFound):
            raise HandNotLoaded(path, problems) from error
        if name := _property_without_prefix(cause, (path, *getattr(module, "all_includes", ()))):
            old = f"'{name}' is a property as xacro took it before 2018: write <xacro:property> for <property>"
            raise HandNotLoaded(path, f"{old}, and likewise include, macro, insert_block, if and unless") from error
        if isinstance(cause, NotAllowed | SyntaxError):
            raise HandNotLoaded(path, [*problems, "pass trusted=True if you trust this file"]) from error
        raise HandNotLoaded(path, f"xacro could not expand it: {'; '.join(problems)}") from error
    if (left := _calls_without_prefix(document, defined)) and not _moves(document):
        raise HandNotLoaded(
            path, f"macros are called as xacro took it before 2018: write <xacro:{left[0]}> for {few(left, 4)}"
        )
    return "\n".join(['<?xml version="1.0" ?>', *filter(str.strip, lines)]) + "\n"


def _note_macros(module: Any) -> set[str]:
    """Names of macros, which are added as a copy of xacro comes to them."""
    names, grab = set[str](), module.grab_macro

    def grab_macro(element: Any, macros: Any) -> Any:  # what xacro makes of it
        names.add(element.getAttribute("name").removeprefix("xacro:"))
        return grab(element, macros)

    module.grab_macro = grab_macro
    return names


def _calls_without_prefix(document: Any, macros: set[str]) -> list[str]:
    return sorted(macros & {element.tagName for element in document.getElementsByTagName("*")})


def _property_without_prefix(error: BaseException, files: Iterable[str | Path]) -> str | None:
    """The name that an expression lacks, where one of the files defines it in an element that xacro leaves alone."""
    lacking = re.match(r"name '(\w+)' is not defined", str(error)) if isinstance(error, NameError) else None
    if lacking is None:
        return None
    element = re.compile(rb"<property\s[^>]*\bname\s*=\s*[\"']%b[\"']" % lacking[1].encode())
    with contextlib.suppress(OSError):
        return lacking[1] if any(element.search(read_bytes(Path(file))) for file in files) else None
    return None


def _moves(document: Any) -> bool:
    return any(
        joint.getAttribute("type") in (*MOVING, "continuous") for joint in document.getElementsByTagName("joint")
    )


def _cause_of(error: BaseException) -> BaseException:
    """What xacro's own errors wrap."""
    while isinstance(inner := getattr(error, "exc", None), BaseException):
        error = inner
    return error


def _find_packages(module: Any, folder: Path, packages: Packages) -> None:
    """Let a copy of xacro find packages without ROS."""
    evaluate = module.eval_extension

    def evaluate_extension(text: str) -> Any:  # what xacro makes of it
        package = PACKAGE.fullmatch(text)
        found = package and find_package(package[1], folder, packages)
        if found or not package:
            return str(found) if found else evaluate(text)
        try:
            return evaluate(text)  # ROS may know more packages
        except Exception as error:
            raise PackageNotFound(package[1]) from error

    module.eval_extension = evaluate_extension
