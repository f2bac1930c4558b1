"""Xacro files, expanded without allowing an untrusted file more than arithmetic.

Xacro evaluates Python expressions in ``${...}``, reads YAML files, includes other files, and reads environment
variables. Unless the caller trusts the file, a copy of xacro expands it that can do none of this: for every expression,
every ``$(...)`` and every file, wherever and whenever it meets them, it calls this module. That evaluates arithmetic
(never by Python's ``eval``), also in ``$(eval ...)``, knows ``$(arg ...)`` and ``$(find ...)``, and gives it files of
the description's own folder and of the packages that it finds: xacro files and, as plain data, YAML files, each read
once.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.dom import expatbuilder

from xacro.substitution_args import convert_value

from pinograsp.hands import arithmetic
from pinograsp.hands.arithmetic import NotAllowed
from pinograsp.hands.elements import parse_xml, read_bytes
from pinograsp.hands.ros_packages import PackageNotFound, Packages, find_package
from pinograsp.hands.yaml_data import read_yaml

# One parameter of a macro: xacro's own pattern takes hours for some.
_PARAMETER = re.compile(
    r"""\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{[^}]*\}|\$\([^)]*\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)(?:\s+|$)(.*)""",
    re.DOTALL,
)
PACKAGE, _ARGUMENT = re.compile(r"\$\(\s*find\s+([\w.-]+)\s*\)"), re.compile(r"\$\(\s*arg\s+(\w+)\s*\)")
_EXPRESSION = re.compile(r"\$\(eval (.*)\)", re.DOTALL)
_FORBIDDEN = re.compile(r"\$(?![{(\w]).?|\$\{\s*(?:xacro|python|load_yaml)\s*\}")  # stray, and names of what is more
_MOST_WORK, _MOST_TIME = 100_000, 10.0  # elements and expressions together, and [s]


class Guard:
    """What a copy of xacro asks instead of evaluating, opening or including; its limits for one file."""

    def __init__(self, module: Any, folder: Path, packages: Packages):  # xacro has no types
        self.module, self.folder, self.given = module, folder, packages
        self.work, self.until = 0, time.monotonic() + _MOST_TIME
        self.named, self.packages = set[str](), dict[str, Path]()  # by the texts of the files; and their folders
        self.files: dict[Path, Any] = {}  # parsed documents, and data
        self.functions: dict[str, Callable[..., Any]] = dict.fromkeys(("load_yaml", "xacro.load_yaml"), self._load_data)
        self.functions |= dict.fromkeys(("xacro.message", "xacro.warning", "xacro.error"), lambda *_: "")
        self.functions["xacro.arg"] = self._argument
        replaced = {
            "safe_eval": self._evaluate,
            "eval_extension": self._evaluate_extension,
            "parse": self._parse,
            "get_include_files": self._find_included,
            "re_macro_arg": _PARAMETER,
            "_global_symbols": {},
            **{name: self._limit(vars(module).get(name)) for name in ("eval_all", "eval_text", "parse_macro_arg")},
        }
        if lacking := ", ".join(replaced.keys() - vars(module).keys()):  # they might evaluate or open elsewhere
            raise RuntimeError(f"this xacro cannot be guarded (it has no {lacking}): pass trusted=True, or use 2.x")
        # What is disabled is not needed: a call of it is a gap in the guard.
        disabled = dict.fromkeys(("load_yaml", "eval", "exec", "compile", "open", "glob"), _refuse)
        vars(module).update(replaced, **disabled)

    def _charge(self, size: int) -> None:
        self.work += 1 + size // 32
        if self.work > _MOST_WORK:
            raise NotAllowed(f"it expands to more than {_MOST_WORK} elements and expressions")
        if time.monotonic() > self.until:
            raise NotAllowed(f"expanding it takes more than {_MOST_TIME:g} s")

    def _limit(self, function: Any) -> Callable[..., Any]:
        """A function of xacro that goes through an element, or a text."""

        def call(subject: Any, *others: Any, **named: Any) -> Any:
            text = subject if isinstance(subject, str) else ""
            self._charge(len(text))
            if "$" in text and len(text) > arithmetic.MOST_TEXT:
                raise NotAllowed(f"a text with expressions has more than {arithmetic.MOST_TEXT} characters")
            return function(subject, *others, **named)

        return call

    def _evaluate(self, expression: str, symbols: Mapping[str, arithmetic.Value], _: object = None) -> arithmetic.Value:
        self._charge(arithmetic.size_of(value := arithmetic.evaluate(expression, symbols, self.functions)))
        return value

    def _evaluate_extension(self, text: str) -> str:
        if package := PACKAGE.fullmatch(text):
            return str(self._find(package[1]))
        if argument := _ARGUMENT.fullmatch(text):
            return self._argument(argument[1])
        if expression := _EXPRESSION.fullmatch(text):
            arguments: dict[str, str] = self.module.substitution_args_context["arg"]
            named = arguments.keys() & set(re.findall(r"\w+", expression[1]))
            names = {name: convert_value(arguments[name], "auto") for name in named} | {"true": True, "false": False}
            return str(self._evaluate(expression[1], names))
        raise NotAllowed(f"'{text}': only $(arg name), $(find package) and $(eval expression) are allowed")

    def _argument(self, name: arithmetic.Value) -> str:
        arguments: dict[str, str] = self.module.substitution_args_context["arg"]
        if name not in arguments:
            raise NameError(f"undefined argument '{name}': give it a value (xacro_args=), or a default")
        self._charge(len(arguments[name]))
        return arguments[name]

    # -- files: those of its own folder and its packages -------------------------------------------------------------

    def _find(self, name: str) -> Path:
        """The folder of a package; where there is none, the error names the others that are missing as well."""
        if name not in self.packages:
            folders = {one: find_package(one, self.folder, self.given) for one in (name, *sorted(self.named - {name}))}
            if (folder := folders.pop(name)) is None:
                others = ", ".join(other for other in folders if folders[other] is None)
                raise PackageNotFound(name, others)
            self.packages[name] = folder
        return self.packages[name]

    def _read(self, what: str, name: str, read: Callable[[Path], Any]) -> Any:
        """What is in a file of a folder whose files may be read; read once."""
        path = Path(name).resolve()
        if not any(path.is_relative_to(one) for one in (self.folder, *self.packages.values())):
            raise NotAllowed(f"{what} of '{name}': outside the file's own folder and its packages")
        if path not in self.files:
            self.files[path] = read(path)
        return self.files[path]

    def _find_included(self, name: str, symbols: Mapping[str, arithmetic.Value]) -> Iterator[str]:
        if re.search(r"[*?\[]|.\$\(\s*find", re.sub(r"\$\{[^}]*\}", "", name)):
            raise NotAllowed(f"include of '{name}': only plain file names are allowed")
        path = self.module.abs_filename_spec(str(self.module.eval_text(name, symbols)))
        self.module.all_includes.append(path)
        yield path

    def _parse(self, _: object, name: str) -> Any:
        try:
            return self._read("include", name, self._read_document).cloneNode(True)
        except OSError as error:  # in xacro's own words: it goes on where the file is optional
            self.module.filestack.pop()
            raise self.module.XacroException(exc=error) from error

    def _load_data(self, name: object) -> arithmetic.Value:
        path = self.module.abs_filename_spec(str(name))
        try:
            return self._read("load_yaml", path, read_yaml)
        except FileNotFoundError:
            raise ValueError(f"load_yaml: no file '{path}': are the arguments right (xacro_args=)?") from None
        except (OSError, ValueError) as error:
            raise NotAllowed(f"load_yaml of '{path}': {error}") from error

    def _read_document(self, path: Path) -> Any:
        """The parsed file, without comments, in which xacro may evaluate; refused for what is not allowed in it."""
        content = read_bytes(path)
        self._charge(len(content))
        root = parse_xml(content)  # refuses what is too large, too deep or has a document type
        texts = [text for one in root.iter() for text in (one.text, one.tail, *one.attrib.values()) if text]
        self.named.update(package for text in texts for package in PACKAGE.findall(text))
        if forbidden := [text for text in texts if _FORBIDDEN.search(text)]:
            raise NotAllowed(f"only arithmetic is allowed, not {' nor '.join(forbidden)}")
        builder: Any = expatbuilder.ExpatBuilderNS()  # as minidom's own
        builder.comment_handler = builder.pi_handler = lambda *_: None
        return builder.parseString(content)


def _refuse(*_: object, **__: object) -> None:
    raise NotAllowed("only arithmetic is allowed")
