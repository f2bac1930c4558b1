"""Checks of what callers hand in: every message says what was expected, what came, and the remedy."""

from __future__ import annotations

import difflib
import functools
import math
import operator
import os
import reprlib
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import fields
from enum import Enum
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Scalar = TypeVar("_Scalar", bound=np.generic)
_Kind = TypeVar("_Kind")
_Value = TypeVar("_Value")
_Text = TypeVar("_Text", bound=str)

_LONGEST_REPR = 280  # characters


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """A private, C-contiguous, read-only copy: records must not change under their owner."""
    copy = np.array(array, order="C")
    copy.setflags(write=False)
    return copy


def frozen(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """``array`` itself, set read-only: for arrays that nobody else holds."""
    array.setflags(write=False)
    return array


def record_of(kind: type[_Kind], values: Mapping[str, object]) -> _Kind:
    """A frozen record (without slots) from all its values at once: several times faster than its constructor."""
    record = object.__new__(kind)
    record.__dict__.update(values)
    return record


def rebuild(record: DataclassInstance) -> tuple[Callable[[], DataclassInstance], tuple[()]]:
    """For ``__reduce__``: a record is rebuilt from its constructor's arguments, without what it has cached since."""
    arguments = {field.name: getattr(record, field.name) for field in fields(record) if field.init}
    return functools.partial(type(record), **arguments), ()


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80


def shorten(value: object) -> str:
    """``value`` for a message: on one line, and shortened."""
    try:
        return " ".join(_SHORT.repr(value).split())
    except Exception:  # a repr of the caller's own class, or an integer of too many digits
        return f"{'an' if isinstance(value, int) else 'a'} {type(value).__name__}"


def one_line(error: BaseException, most: int = 300) -> str:
    """The text of another library's error on one line, shortened; with its type, where the text may need that."""
    kind = "" if type(error) is ValueError or isinstance(error, InvalidInput) else f"{type(error).__name__}: "
    text = " ".join(f"{kind}{error}".split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def brief(*names: str) -> Callable[..., str]:
    """A ``__repr__`` of a record that fits a terminal: its class and the attributes ``names``, by default its fields.

    Arrays and other records within it are shown by shape, name or number.
    """

    def __repr__(self: DataclassInstance) -> str:
        return in_brief(self, names or [field.name for field in fields(self) if field.repr])

    return __repr__


def in_brief(record: object, names: Iterable[str]) -> str:
    """The class of a record and its attributes ``names``, as :func:`brief` shows them."""
    parts: list[str] = []
    size = len(type(record).__name__) + 2
    for name in names:
        part = f"{name}={_brief(getattr(record, name))}"
        size += len(part) + 2
        if size > _LONGEST_REPR:
            parts.append("...")
            break
        parts.append(part)
    return f"{type(record).__name__}({', '.join(parts)})"


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray):
        if value.size > 6 or value.dtype.kind not in "fiub":
            return f"array{value.shape}"
        return "[" + ", ".join(f"{one:.4g}" for one in value.ravel().tolist()) + "]"
    if isinstance(value, Enum):
        return str(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    if value is None or isinstance(value, bool | int):
        return repr(value)[:30]
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else f"{value[:57]}...")
    if isinstance(value, dict | tuple | list):
        names = [name for one in value if isinstance(name := getattr(one, "name", one), str)]
        if len(names) == len(value) <= 6 and sum(map(len, names)) <= 80:
            return f"({', '.join(names)})"
        return f"{len(value)} entries"
    name = getattr(value, "name", None)
    return type(value).__name__ + (f" {name[:40]!r}" if isinstance(name, str) else "")


def array_of(name: str, value: object, shape: tuple[int | None, ...]) -> Array:
    """``value`` as a finite float array of ``shape`` (``None`` = any size), or :class:`InvalidInput`."""
    if type(value) is np.ndarray and value.dtype is _FLOAT:
        array = np.array(value, order="C")
    else:
        array = floats_of(name, value, f"numbers of shape {_words(shape)}")
    if array.shape != shape and (
        array.ndim != len(shape) or any(s is not None and s != a for s, a in zip(shape, array.shape))
    ):
        raise InvalidInput(f"{name}: expected shape {_words(shape)}, got {array.shape}")
    # The sum of squares is quicker to look at, but may overflow; of many numbers BLAS would start threads for it.
    small = array.size <= _FEW and math.isfinite(np.vdot(array, array))
    if not small and not np.isfinite(array).all():
        raise InvalidInput(f"{name}: expected finite numbers, got {shorten(array.tolist())}")
    return frozen(array)


_FLOAT, _EYE = np.dtype(float), np.eye(3)
_BOTTOM = np.array([0.0, 0.0, 0.0, 1.0])  # last row of a homogeneous placement
_FEW = 1000  # numbers: looked at one by one, as many take no longer
_MOST_JOBS = 1000


def floats_of(name: str, value: object, wanted: str = "numbers") -> Array:
    """``value`` as a float array of any shape: no texts, truth values, complex numbers, dates or masks. Infinity and
    NaN are kept.
    """
    try:
        if np.ma.is_masked(value) or isinstance(value, bytearray):
            raise TypeError
        array = np.asarray(value)
        if array.dtype.kind == "O":
            if not all(isinstance(one, Real) and not isinstance(one, bool) for one in array.flat):
                raise TypeError
        elif array.dtype.kind not in "iuf":
            raise TypeError
        with np.errstate(over="ignore"):
            return np.array(array, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InvalidInput(f"{name}: expected {wanted}, got {shorten(value)}") from None


def finite_of(name: str, value: object) -> Array:
    """``value`` as a finite float array of any shape, or :class:`InvalidInput`."""
    array = value if type(value) is np.ndarray and value.dtype is _FLOAT else floats_of(name, value)
    if not np.isfinite(array).all():
        raise InvalidInput(f"{name}: expected finite numbers, got {shorten(array.tolist())}")
    return array


def at_least_zero(name: str, value: object) -> Array:
    """``value`` as a finite float array of any shape without negative numbers, or :class:`InvalidInput`."""
    array = finite_of(name, value)
    if array.size and array.min() < 0:
        raise InvalidInput(f"{name}: expected values >= 0, got {shorten(array.tolist())}")
    return array


def alike(names: str, *arrays: Array) -> None:
    """:class:`InvalidInput` unless the arrays broadcast against each other."""
    try:
        np.broadcast_shapes(*(array.shape for array in arrays))
    except ValueError:
        shapes = " and ".join(str(array.shape) for array in arrays)
        raise InvalidInput(f"{names}: expected shapes that go together, got {shapes}") from None


def each_of(name: str, value: object, k: int) -> Array:
    """``value`` as a finite float array (k,): one number applies to all."""
    one = isinstance(value, Real) or (isinstance(value, np.ndarray) and value.ndim == 0)
    return frozen(np.full(k, number(name, value))) if one else array_of(name, value, (k,))


def _words(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"


def placement_of(name: str, value: object) -> Array:
    """``value`` as a placement (4, 4) with an orthonormal right-handed rotation, or :class:`InvalidInput`."""
    pose = array_of(name, value, (4, 4))
    if not are_rotations(pose[:3, :3]):
        raise InvalidInput(f"{name}: expected a homogeneous placement with an orthonormal right-handed rotation")
    if not np.abs(pose[3] - _BOTTOM).max() <= 1e-9:  # rounding of products and inverses
        transposed = ": transpose it, its translation is in the last row" if (pose[:, 3] == _BOTTOM).all() else ""
        raise InvalidInput(f"{name}: expected the last row 0 0 0 1, got {pose[3].tolist()}{transposed}")
    return pose if np.array_equal(pose[3], _BOTTOM) else read_only(np.vstack([pose[:3], _BOTTOM]))


def placements_of(name: str, value: object, count: int) -> Array:
    """``value`` as that many placements (N, 4, 4), or :class:`InvalidInput`."""
    poses = array_of(name, value, (count, 4, 4))
    off = ~are_rotations(poses[:, :3, :3]) | np.any(poses[:, 3] != _BOTTOM, axis=1)
    if off.any():
        raise InvalidInput(
            f"{name}: expected homogeneous placements with orthonormal right-handed rotations, number "
            f"{int(np.argmax(off))} is none"
        )
    return poses


def are_rotations(matrices: Array) -> BoolArray:
    """Which of the matrices (..., 3, 3) are orthonormal and right-handed (...,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(matrices @ matrices.swapaxes(-1, -2) - _EYE).max(axis=(-1, -2))
        proper: BoolArray = (off <= 1e-6) & (np.linalg.det(matrices) > 0)
    return proper


def number(
    name: str,
    value: object,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    unit: str = "",
) -> float:
    """``value`` as a finite float within the bounds, or :class:`InvalidInput`."""
    try:
        result = _real(value)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInput(
            f"{name}: expected {_describe_wanted(above, at_least, at_most, unit)}, got {shorten(value)}"
        ) from None
    if (
        not math.isfinite(result)
        or (above is not None and not result > above)
        or (at_least is not None and result < at_least)
        or (at_most is not None and result > at_most)
    ):
        raise InvalidInput(f"{name}: expected {_describe_wanted(above, at_least, at_most, unit)}, got {result:g}")
    return result


def _real(value: object) -> float:
    if type(value) is not float:
        if isinstance(value, np.ndarray) and value.ndim == 0 and not isinstance(value, np.ma.MaskedArray):
            value = value[()]
        if not isinstance(value, Real) or isinstance(value, bool):
            raise TypeError
    return float(value)


def _describe_wanted(above: float | None, at_least: float | None, at_most: float | None, unit: str) -> str:
    bounds = [
        f"{sign} {bound:g}" for sign, bound in ((">", above), (">=", at_least), ("<=", at_most)) if bound is not None
    ]
    return f"a finite number{' ' if bounds else ''}{' and '.join(bounds)}" + (f" [{unit}]" if unit else "")


def share_of(name: str, value: object) -> float:
    """``value`` as a number from 0 to below 1, or :class:`InvalidInput`."""
    share = number(name, value, at_least=0)
    if not share < 1:
        raise InvalidInput(f"{name}: expected a share from 0 to below 1, got {share:g}")
    return share


def integer(name: str, value: object, *, at_least: int | None = None, at_most: int | None = None) -> int:
    """``value`` as an int within the bounds, or :class:`InvalidInput`."""
    try:
        if isinstance(value, bool | np.bool_ | np.ma.MaskedArray):
            raise TypeError
        result = operator.index(value)  # type: ignore[arg-type]  # raises TypeError for what is no integer
    except (TypeError, ValueError):
        result = None
    if result is None or (at_least is not None and result < at_least) or (at_most is not None and result > at_most):
        bounds = [f"{sign} {bound}" for sign, bound in ((">=", at_least), ("<=", at_most)) if bound is not None]
        raise InvalidInput(
            f"{name}: expected an integer{' ' if bounds else ''}{' and '.join(bounds)}, got {shorten(value)}"
        )
    return result


def processes(jobs: object) -> int:
    """``jobs`` as joblib takes it, -1 for all cores, or :class:`InvalidInput`."""
    if isinstance(jobs, bool) or not isinstance(jobs, int | np.integer) or not (jobs == -1 or 1 <= jobs <= _MOST_JOBS):
        raise InvalidInput(
            f"jobs: expected a number of processes from 1 to {_MOST_JOBS}, or -1 for all cores, got {shorten(jobs)}"
        )
    return int(jobs)


def flag(name: str, value: object) -> bool:
    """``value`` as True or False, or :class:`InvalidInput`: a text or a number is neither."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidInput(f"{name}: expected True or False, got {shorten(value)}")
    return bool(value)


def text_of(name: str, value: object) -> str:
    """``value`` if it is a text, or :class:`InvalidInput`."""
    if not isinstance(value, str):
        raise InvalidInput(f"{name}: expected a text, got {shorten(value)}")
    return value


def path_of(name: str, value: object) -> Path:
    """``value`` as a path, or :class:`InvalidInput`."""
    if not isinstance(value, str | os.PathLike) or not isinstance(os.fspath(value), str) or not str(value):
        raise InvalidInput(f"{name}: expected a path, got {shorten(value)}")
    if "\0" in os.fspath(value):  # the system's calls would raise errors of their own
        raise InvalidInput(f"{name}: expected a path, got one with a null character: {shorten(value)}")
    return Path(value)


def instance_of(name: str, value: object, *kinds: type[_Kind]) -> _Kind:
    """``value`` if it is of one of the kinds, or :class:`InvalidInput`."""
    if not isinstance(value, kinds):
        names = [kind.__name__ for kind in kinds if kind is not type(None)] + ["None"] * (type(None) in kinds)
        raise InvalidInput(f"{name}: expected {_list(names)}, got {shorten(value)}")
    return value


def _list(names: list[str]) -> str:
    first = f"an {names[0]}" if names[0][0] in "AEIO" else f"a {names[0]}"
    return " or ".join([first, *names[1:]])


def mapping_of(
    name: str, value: Mapping[str, _Value], wanted: str = "a mapping with names as keys"
) -> dict[str, _Value]:
    """``value`` as a dict whose keys are texts, or :class:`InvalidInput`."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise InvalidInput(f"{name}: expected {wanted}, got {shorten(value)}")
    return dict(value)


def items_of(name: str, value: object, *kinds: type[_Kind]) -> tuple[_Kind, ...]:
    """``value`` as a tuple of items of those kinds, or :class:`InvalidInput`."""
    wanted = " or ".join(kind.__name__ for kind in kinds)
    one = isinstance(value, np.ndarray) and value.ndim == 0
    if one or isinstance(value, str | bytes | Mapping | Set) or not isinstance(value, Iterable):
        raise InvalidInput(f"{name}: expected a sequence of {wanted}, got {shorten(value)}")
    items = tuple(value)
    for item in items:
        if not isinstance(item, kinds):
            raise InvalidInput(f"{name}: expected a sequence of {wanted}, got {shorten(item)} in it")
    return items


def one_of(name: str, value: object, allowed: Iterable[_Text]) -> _Text:
    """``value`` if it is one of ``allowed``; otherwise :class:`InvalidInput` with the nearest spelling."""
    allowed = list(allowed)
    if isinstance(value, str) and value in allowed:
        return next(one for one in allowed if one == value)
    near = difflib.get_close_matches(value[:100], allowed, n=1) if isinstance(value, str) else ()
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise InvalidInput(f"{name}: expected one of {', '.join(allowed) or '(none)'}, got {shorten(value)}{hint}")
