"""Xacro files, expanded without giving a stranger's file more than arithmetic.

Xacro evaluates Python expressions in ``${...}``, reads YAML files, includes other files, and reads environment
variables. Unless the caller trusts the file, it is scanned first, includes too, and only arithmetic, properties,
macros, ``$(arg ...)`` and includes from the file's own folder are let through.
"""

from __future__ import annotations

import ast
import contextlib
import io
import math
import re
import xml.dom.minidom
from pathlib import Path

from pinograsp.errors import HandNotLoaded

_MATH = frozenset(name for name in vars(math) if not name.startswith("_"))
_FUNCTIONS = frozenset({"abs", "min", "max", "round", "int", "float", "bool", "len", "True", "False"}) | _MATH
_SUBSTITUTION = re.compile(r"\$\{([^}]*)\}|\$\(([^)]*)\)|(\$)")
_NODES = (
    ast.Expression, ast.Constant, ast.Name, ast.Load, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.BoolOp,
    ast.boolop, ast.Compare, ast.cmpop, ast.IfExp, ast.Call, ast.Subscript, ast.List, ast.Tuple, ast.Attribute,
)  # fmt: skip


def expand_xacro(path: str | Path, mappings: dict[str, object] | None = None, *, trusted: bool = False) -> str:
    """The URDF text that xacro makes of the file at ``path``.

    ``mappings`` fills ``<xacro:arg>``. With ``trusted=False`` (default) a file that asks for more than arithmetic and
    includes of its own folder is refused with :class:`HandNotLoaded`, which lists every such place. ``trusted=True``
    hands the file to xacro as it is: it can then read any file the user can, so use it for your own files only.
    """
    import xacro

    path = Path(path)
    try:
        if not trusted:
            problems = _forbidden(path.resolve(), path.resolve().parent, set())
            if problems:
                raise HandNotLoaded(path, [*problems, "pass trusted=True to load_hand if you trust this file"])
        texts = {name: str(value) for name, value in (mappings or {}).items()}
        complaints = io.StringIO()
        with contextlib.redirect_stderr(complaints):  # xacro prints its warnings; they belong in the error, if any
            document = xacro.process_file(str(path), mappings=texts)
    except HandNotLoaded:
        raise
    except Exception as error:  # xacro raises its own, the XML parser's, and whatever an expression raises
        problem = "it includes or calls itself without end" if isinstance(error, RecursionError) else error
        raise HandNotLoaded(path, f"xacro could not expand it: {problem}") from error
    for node in list(document.childNodes):  # xacro's banner carries the path it was given: not reproducible
        if node.nodeType == node.COMMENT_NODE:
            document.removeChild(node)
    lines = document.toprettyxml(indent="  ").splitlines()
    return "\n".join(line for line in lines if line.strip()) + "\n"


def _forbidden(path: Path, folder: Path, seen: set[Path]) -> list[str]:
    """Everything in the file, and in the files it includes, that goes beyond arithmetic and the own folder."""
    seen.add(path)
    text = path.read_text(encoding="utf-8")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        return [f"{path.name}: document type and entity declarations are not allowed"]
    problems = []
    for node in _walk(xml.dom.minidom.parseString(text)):
        if node.nodeType in (node.TEXT_NODE, node.CDATA_SECTION_NODE):
            texts = [node.data]
        elif node.nodeType == node.ELEMENT_NODE:
            texts = [value for _, value in node.attributes.items()]
            if node.tagName.split(":")[-1] == "include":
                problems += _forbidden_include(node.getAttribute("filename"), path, folder, seen)
        else:
            continue
        problems += [f"{path.name}: {problem}" for value in texts for problem in _forbidden_text(value)]
    return problems


def _walk(node):
    for child in node.childNodes:
        yield child
        yield from _walk(child)


def _forbidden_include(filename: str, path: Path, folder: Path, seen: set[Path]) -> list[str]:
    if "$" in filename or re.search(r"[*?\[]", filename):
        return [f"{path.name}: include of '{filename}': only plain file names are allowed"]
    target = (path.parent / filename).resolve()
    if not target.is_relative_to(folder):
        return [f"{path.name}: include of '{filename}': outside the file's own folder"]
    return [] if target in seen or not target.is_file() else _forbidden(target, folder, seen)


def _forbidden_text(text: str) -> list[str]:
    problems = []
    for match in _SUBSTITUTION.finditer(text):
        expression, extension, dollar = match.groups()
        if dollar:
            problems.append(f"stray '$' in '{text.strip()}'")
        elif extension is not None:
            if not re.fullmatch(r"arg\s+\w+", extension.strip()):
                problems.append(f"'$({extension})': only $(arg name) is allowed")
        elif not _is_arithmetic(expression):
            problems.append(f"expression '${{{expression}}}': only arithmetic is allowed")
    return problems


def _is_arithmetic(expression: str) -> bool:
    if "$" in expression:
        return False
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    import xacro

    hidden = frozenset(xacro._global_symbols) - _FUNCTIONS - {"math"}
    for node in ast.walk(tree):
        if not isinstance(node, _NODES):
            return False
        if isinstance(node, ast.Name) and (node.id in hidden or node.id.startswith("__")):
            return False
        if isinstance(node, ast.Attribute) and not (
            isinstance(node.value, ast.Name) and node.value.id == "math" and node.attr in _MATH
        ):
            return False
        # Text could be assembled into a new expression, or formatted into one: numbers and comparisons need neither.
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and ("$" in node.value or "%" in node.value):
            return False
    return True
