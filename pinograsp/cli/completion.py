"""What a shell offers as the value of an option. Where it is offered nothing, it completes the names of files."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

Completer = Callable[[str], list[str]]

# Written out, as long as importing the package takes a second; tests compare them with what the package takes.
SEARCHES = ("convex", "hybrid", "paper", "paper+qp")
BALANCES = ("force", "wrench")
MEASURES = ("impulse", "work")
SOLVERS = ("auto", "interior", "newton", "daqp", "proxqp", "osqp", "clarabel")
FRICTION = ("pyramid", "cone", "soft")
MASSES = ("estimate", "file")
CONTROLS = ("impedance", "position", "torque")
SUPPORTS = ("fixed", "table", "none")
EXECUTORS = ("joblib", "dask")
COMMANDS = ("torque", "position", "impedance", "jaw")  # what motors are sent
UNITS = ("SI", "register")
TIMINGS = ("fastest", "given")
SQUEEZES = ("least", "constant")
RESERVES = ("none", "default")


def make_completer(choices: Iterable[str]) -> Completer:
    """Completes one of the choices."""

    def complete(incomplete: str) -> list[str]:
        return [choice for choice in choices if choice.startswith(incomplete)]

    return complete


def complete_hands(incomplete: str) -> list[str]:
    """Names of the catalogue; of files the shell knows more."""
    from pinograsp.hands.catalogue import CATALOGUE

    return make_completer(CATALOGUE)(incomplete)


def cases(incomplete: str) -> list[str]:
    """Built-in cases, and YAML files here."""
    from pinograsp.cases import builtin_cases

    files = sorted(str(path) for path in Path().glob("*.y*ml"))
    return make_completer([*builtin_cases(), *files])(incomplete)


def objects(incomplete: str) -> list[str]:
    """An example of each kind of object, to be changed."""
    from pinograsp.objects.spec import object_language

    return make_completer(line.partition(", as ")[2] for line in object_language()[1:])(incomplete)


def runs(incomplete: str) -> list[str]:
    """Folders of runs below runs/ and here."""
    return make_completer(sorted(_find_folders("plan.json", incomplete)))(incomplete)


def exportable(incomplete: str) -> list[str]:
    """Folders of runs, and of carry plans below carries/ and here."""
    return make_completer(sorted({*_find_folders("plan.json", incomplete), *_find_folders("carry.json", incomplete)}))(
        incomplete
    )


def graspable(incomplete: str) -> list[str]:
    """Runs and cases."""
    return [*cases(incomplete), *runs(incomplete)]


def keys(incomplete: str) -> list[str]:
    """Keys of a case, as ``--set`` takes them."""
    from pinograsp.cases import load_case

    settings = load_case("paper").settings()
    del settings["schema"], settings["assumed"]
    return make_completer(f"{key}=" for key in _keys(settings))(incomplete)


def formats(incomplete: str) -> list[str]:
    """Formats of files of grasps."""
    from pinograsp.data import FORMATS

    return make_completer(["auto", *FORMATS])(incomplete)


def conventions(incomplete: str) -> list[str]:
    """What files of grasps may mean by their hand."""
    from pinograsp.data import CONVENTIONS

    return make_completer(CONVENTIONS)(incomplete)


def protocols(incomplete: str) -> list[str]:
    """Benchmarks whose loads grasps can be certified with."""
    from pinograsp.certification import PROTOCOLS

    return make_completer(PROTOCOLS)(incomplete)


def _find_folders(name: str, incomplete: str) -> Iterator[str]:
    """Folders that hold a file of that name: those here, those in a folder here, and those where the text points to."""
    there = glob.escape(os.path.dirname(incomplete))
    for pattern in {"*", "*/*", os.path.join(there, "*")}:
        yield from map(os.path.dirname, glob.glob(os.path.join(pattern, name)))


def _keys(value: object, before: str = "") -> Iterator[str]:
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _keys(inner, f"{before}.{key}" if before else key)
    else:
        yield before
