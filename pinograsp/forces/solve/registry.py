"""Solvers of the caller's own, by name: they get a program and return x; what they say is judged by this package."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from pinograsp.checks import array_of, instance_of, one_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.forces.solve.standard_form import Cones, ConicProgram, QuadraticProgram, SolverAnswer
from pinograsp.spatial import Array

Takes = Literal["qp", "socp"]
TAKES: tuple[Takes, ...] = get_args(Takes)


class _Solver(NamedTuple):
    """A registered solver."""

    function: Callable[[Any], Any]
    takes: Takes


_SOLVERS: dict[str, _Solver] = {}


class Answered(NamedTuple):
    """What a registered solver found: x, and multipliers where it gave them (see :class:`SolverAnswer`)."""

    x: Array
    y: Array | None
    z: Array | None
    z_box: Array | None


def register(name: str, function: Callable[[Any], Any], takes: str, taken: tuple[str, ...]) -> None:
    """Put a solver under a name that is not among ``taken``."""
    if not instance_of("solver's name", name, str).strip():
        raise InvalidInput(f"solver's name: expected a text that is not empty, got {shorten(name)}")
    if not callable(function):
        raise InvalidInput(f"solver '{name}': expected a function of a program, got {shorten(function)}")
    if name in taken:
        raise InvalidInput(
            f"solver '{name}': expected a name that is free, got one of {', '.join(taken)}; "
            "take another, or unregister_solver(name) first if it is your own"
        )
    _SOLVERS[name] = _Solver(function, one_of("takes", takes, TAKES))


def unregister_solver(name: str) -> None:
    """Forget a solver of :func:`register_solver`.

    Raises:
        InvalidInput: no solver was registered under this name.
    """
    del _SOLVERS[one_of("registered solver", name, list_registered())]


def list_registered(takes: Takes | None = None) -> tuple[str, ...]:
    """Names of the registered solvers, or of those that take such programs."""
    return tuple(name for name, solver in _SOLVERS.items() if takes in (None, solver.takes))


def ask_solver(name: str, program: QuadraticProgram | ConicProgram) -> Answered | None:
    """The answer of the registered solver ``name``; None where it finds none. Its exceptions are the caller's.

    Raises:
        InvalidInput: what it returned is no answer.
    """
    kind = QuadraticProgram if isinstance(program, QuadraticProgram) else ConicProgram
    parts_of = {field.name: getattr(program, field.name) for field in fields(kind)}
    own: dict[str, Any] = {part: one if isinstance(one, Cones) else one.copy() for part, one in parts_of.items()}
    found = _SOLVERS[one_of("solver", name, list_registered())].function(kind(**own))
    # Solutions of qpsolvers and Clarabel have these attributes, too.
    if found is None or not getattr(found, "found", True):
        return None
    if not hasattr(found, "x"):
        found = SolverAnswer(found)
    if found.x is None:
        return None
    sizes = {"x": len(program.q), "z": len(program.b)}
    if isinstance(program, QuadraticProgram):
        sizes |= {"y": len(program.b), "z": len(program.h), "z_box": len(program.q)}
    parts: dict[str, Array | None] = dict.fromkeys(Answered._fields)
    for part, size in sizes.items():
        value = getattr(found, part, None)
        if value is None or (part != "x" and not np.size(value) and size):
            continue
        try:
            if not np.isfinite(value).all():
                return None
        except TypeError:
            pass  # the next line says what is wrong
        parts[part] = array_of(f"{part} from solver '{name}'", value, (size,))
    return Answered(**parts)  # type: ignore[arg-type]  # x is among the sizes
