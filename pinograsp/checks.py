"""Checks of what callers hand in: every message says what was expected, what came, and the remedy."""

from __future__ import annotations

import difflib
import functools
import math
from collections.abc import Iterable
from dataclasses import fields

import numpy as np

from pinograsp.errors import InvalidInput


def read_only(array: np.ndarray) -> np.ndarray:
    """A private, C-contiguous, read-only copy: records must not change under their owner."""
    copy = np.array(array, order="C")
    copy.setflags(write=False)
    return copy


def frozen(array: np.ndarray) -> np.ndarray:
    """``array`` itself, made read-only: for arrays that nobody else holds."""
    array.setflags(write=False)
    return array


def record_of(kind, values: dict):
    """A frozen record (without slots) from all its values at once: several times faster than its constructor."""
    record = object.__new__(kind)
    record.__dict__.update(values)
    return record


def rebuilt(record) -> tuple:
    """What ``__reduce__`` of a record returns that is made again from its arguments, without what it has kept since."""
    arguments = {field.name: getattr(record, field.name) for field in fields(record) if field.init}
    return functools.partial(type(record), **arguments), ()


def array_of(name: str, value, shape: tuple[int | None, ...]) -> np.ndarray:
    """``value`` as a finite float array of ``shape`` (``None`` = any size), or :class:`InvalidInput`."""
    try:
        array = np.array(value, dtype=float, order="C")
    except (TypeError, ValueError):
        raise InvalidInput(f"{name}: expected numbers of shape {_words(shape)}, got {value!r}") from None
    if array.shape != shape and (
        array.ndim != len(shape) or any(s is not None and s != a for s, a in zip(shape, array.shape))
    ):
        raise InvalidInput(f"{name}: expected shape {_words(shape)}, got {array.shape}")
    # The sum of squares is quicker to look at, but may overflow.
    if not math.isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        raise InvalidInput(f"{name}: expected finite numbers, got {array.tolist()}")
    return frozen(array)


def _words(shape) -> str:
    return "(" + ", ".join("any" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"


def placement_of(name: str, value) -> np.ndarray:
    """``value`` as a placement (4, 4) with an orthonormal right-handed rotation, or :class:`InvalidInput`."""
    pose = array_of(name, value, (4, 4))
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise InvalidInput(f"{name}: expected a homogeneous placement with an orthonormal right-handed rotation")
    return pose


def number(name: str, value, *, above: float | None = None, at_least: float | None = None, unit: str = "") -> float:
    """``value`` as a finite float within the bounds, or :class:`InvalidInput`."""
    bound = f" > {above:g}" if above is not None else f" >= {at_least:g}" if at_least is not None else ""
    wanted = f"a finite number{bound}" + (f" [{unit}]" if unit else "")
    try:
        result = float(value)
    except (TypeError, ValueError):
        raise InvalidInput(f"{name}: expected {wanted}, got {value!r}") from None
    if (
        not np.isfinite(result)
        or (above is not None and not result > above)
        or (at_least is not None and result < at_least)
    ):
        raise InvalidInput(f"{name}: expected {wanted}, got {result:g}")
    return result


def one_of(name: str, value: str, allowed: Iterable[str]) -> str:
    """``value`` if it is one of ``allowed``; otherwise :class:`InvalidInput` with the nearest spelling."""
    allowed = list(allowed)
    if value in allowed:
        return value
    near = difflib.get_close_matches(str(value), allowed, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise InvalidInput(f"{name}: expected one of {', '.join(allowed) or '(none)'}, got '{value}'{hint}")
