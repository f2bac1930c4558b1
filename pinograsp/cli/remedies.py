"""Advice that names Python's keywords, in the words of the command line."""

from __future__ import annotations

import re
import shlex

# By keyword of load_hand: the option, and what stands for its value where none is said. None: there is no option.
_OPTIONS: dict[str, tuple[str, str] | None] = {
    "root": ("--root", "LINK"),
    "palm": ("--palm", "LINK"),
    "fingers": ("--finger", "NAME=LINK"),
    "packages": ("--package", "NAME=DIR"),
    "xacro_args": ("--arg", "NAME=VALUE"),
    "trusted": ("--trusted", ""),
    "masses": ("--masses", "estimate"),
    "exclude": ("--exclude", "LINK"),
    "srdf": ("--srdf", "FILE"),
    "posture": ("--posture", "JOINT=VALUE"),
    "limits": None,
    "drives": None,
    "springs": None,
}
_KEYWORD = re.compile(rf"(?<![\w.'/=-])(?<!from Python )({'|'.join(_OPTIONS)})=(?:'([^']*)'|(True)\b)?")


def as_options(text: str) -> str:
    """Return the text with ``root='hand'`` as ``--root hand``, and so on; arguments without an option are marked as for
    Python.
    """
    return _KEYWORD.sub(_option, text)


def _option(found: re.Match[str]) -> str:
    keyword, value, yes = found.groups()
    option = _OPTIONS[keyword]
    if option is None:
        return f"from Python {found[0]}"
    if yes:
        return option[0]
    return f"{option[0]} {option[1] if value is None else shlex.quote(value)}".rstrip()
