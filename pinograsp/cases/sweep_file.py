"""The sweep file: the inputs of a case that vary, and their values; from YAML to the checked inputs of every plan."""

from __future__ import annotations

import contextlib
import difflib
import functools
import json
import math
import os
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from pinograsp.cases.case import load_case
from pinograsp.cases.changes import CaseChanges
from pinograsp.cases.object_case import ObjectCase, object_fields
from pinograsp.cases.reading import change_values, check_extent, read_mapping, validate
from pinograsp.cases.sections import CaseSection, NotNegative, Number, Positive, find_source
from pinograsp.cases.sweep_rows import IMPACT_TIME, SweepBase
from pinograsp.checks import mapping_of, path_of
from pinograsp.errors import CaseRejected, InvalidInput
from pinograsp.hands.file_reads import ABSENT, noting_files

_MOST = 10_000_000  # rows; their indices are kept in memory
_BIGGEST = 10_000_000  # bytes of a sweep file: lists of values may be long
_WITH_FILES = ("hand", "object", "packages", "xacro_args", "srdf", "drives")  # inputs that may name other files
_LOOKED_AT = 20  # number of first rows of which at least one must be usable


def _check_rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] >= pair[1]:
        raise ValueError(f"expected the lower end first, got {pair[0]:g}, {pair[1]:g}")
    return pair


Pair = Annotated[tuple[Number, Number], AfterValidator(_check_rising)]
PositivePair = Annotated[tuple[Positive, Positive], AfterValidator(_check_rising)]


class Span(CaseSection):
    """``steps`` values from ``from`` to ``to``, both included, evenly spaced or with even ratios (``log``)."""

    from_: Number = Field(alias="from")
    to: Number
    steps: Annotated[int, Field(ge=2, le=_MOST)]
    spacing: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _log_is_of_positive_numbers(self) -> Span:
        if self.spacing == "log" and min(self.from_, self.to) <= 0:
            raise ValueError("spacing 'log' needs from and to above 0")
        return self

    def values(self) -> list[float]:
        """The values of the range, ends included."""
        spaced = np.geomspace if self.spacing == "log" else np.linspace
        values: list[float] = spaced(self.from_, self.to, self.steps).tolist()
        return values


class Draw(CaseSection):
    """A distribution: exactly one of these. ``normal`` is mean and standard deviation."""

    uniform: Pair | None = None
    log_uniform: PositivePair | None = None
    normal: tuple[Number, NotNegative] | None = None
    choice: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _check_mapping(cls, given: object) -> object:
        if not isinstance(given, dict | Draw):
            raise ValueError("expected a distribution, for example {uniform: [0.4, 1.0]}")
        return given

    @model_validator(mode="after")
    def _one_distribution(self) -> Draw:
        if sum(value is not None for value in (self.uniform, self.log_uniform, self.normal, self.choice)) != 1:
            raise ValueError("give one of uniform, log_uniform, normal and choice")
        return self

    def values(self, count: int, seed: list[int]) -> list[Any]:
        """``count`` random values; a larger count begins with the same values."""
        rng = np.random.default_rng(seed)
        if self.choice is not None:
            return [self.choice[int(i)] for i in len(self.choice) * rng.random(count)]
        if self.normal is not None:
            mean, deviation = self.normal
            drawn = rng.normal(mean, deviation, size=count)
        elif self.log_uniform is not None:
            low, high = np.log(self.log_uniform)
            drawn = np.exp(rng.uniform(low, high, size=count))
        else:
            low, high = self.uniform or (0.0, 0.0)  # the validator has seen that it is there
            drawn = rng.uniform(low, high, size=count)
        values: list[float] = drawn.tolist()
        return values


class Samples(CaseSection):
    """``count`` independent random draws of all other keys, which are inputs of the case."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Draw]  # pyright: ignore[reportIncompatibleVariableOverride]  # as pydantic asks for

    count: Annotated[int, Field(ge=1, le=_MOST)]
    seed: Annotated[int, Field(ge=0)] = 0

    @property
    def draws(self) -> dict[str, Draw]:
        """The distributions by key."""
        return self.__pydantic_extra__


def _several(values: object) -> object:
    if not isinstance(values, list | tuple):
        raise ValueError("expected a list of values, or {from, to, steps}")
    return values


ValueList = Annotated[tuple[Any, ...], Field(min_length=1), BeforeValidator(_several)]
# Tagged, so that an error in one kind is not reported for the other as well.
Values = Annotated[
    Annotated[Span, Tag("range")] | Annotated[ValueList, Tag("list")],
    Discriminator(lambda value: "range" if isinstance(value, dict | Span) else "list"),
]


class SweepSpec(CaseSection):
    """A sweep of a case, or of a hand and an object.

    ``set`` holds fixed inputs, ``over`` a grid of all combinations, and ``samples`` random draws, which are all used at
    every point of the grid. Relative paths start at ``folder``, the sweep file's own.
    """

    schema_: Literal[1] = Field(1, alias="schema")
    case: str | None = None
    hand: str | None = None
    object: str | dict[str, Any] | None = None
    what: Literal["plan", "forces"] = "plan"
    set: dict[str, Any] = Field({})
    over: dict[str, Values] = Field({})
    samples: Samples | None = None
    name: str = Field("sweep", exclude=True)
    folder: Path = Field(Path("."), exclude=True)

    @model_validator(mode="after")
    def _fits_together(self) -> SweepSpec:
        if (self.case is None) == (self.hand is None) or (self.hand is None) != (self.object is None):
            raise ValueError("expected either case, or hand and object")
        if not self.over and not (self.samples and self.samples.draws):
            raise ValueError("nothing to vary: expected inputs under over or under samples")
        keys = {"set": {*self.set}, "over": {*self.over}, "samples": {*(self.samples.draws if self.samples else ())}}
        for a, b in combinations(keys, 2):
            if twice := sorted(keys[a] & keys[b]):
                raise ValueError(f"expected every input once, got {', '.join(twice)} under {a} and {b}")
        named = set().union(*keys.values())
        if (IMPACT_TIME in named) != (self.what == "forces"):
            wanted = "needs" if self.what == "forces" else "has no"
            raise ValueError(f"what: {self.what} {wanted} {IMPACT_TIME} [s] under set, over or samples")
        if {"trusted", "hand.trusted"} & named:
            raise ValueError("trusted: a file cannot say this itself: expand the hand's xacro to a URDF first")
        if self.samples and (drawn := self.samples.count * len(self.samples.draws)) > _MOST:
            raise ValueError(f"expected at most {_MOST} drawn values, got {drawn}")
        if self.rows > _MOST:
            raise ValueError(f"expected at most {_MOST} rows, got {self.rows}: take fewer values or draws")
        return self

    @functools.cached_property
    def grid(self) -> dict[str, list[Any]]:
        """The values of each input of the grid."""
        return {key: values.values() if isinstance(values, Span) else list(values) for key, values in self.over.items()}

    @functools.cached_property
    def random_inputs(self) -> dict[str, list[Any]]:
        """The draws of each random input; they do not depend on the other inputs."""
        if self.samples is None:
            return {}
        return {
            key: draw.values(self.samples.count, [self.samples.seed, *key.encode()])
            for key, draw in self.samples.draws.items()
        }

    @property
    def rows(self) -> int:
        """Number of plans."""
        sizes = [values.steps if isinstance(values, Span) else len(values) for values in self.over.values()]
        return math.prod(sizes) * (self.samples.count if self.samples else 1)

    @property
    def inputs(self) -> dict[str, list[Any]]:
        """The inputs that vary, with their values."""
        return {**self.grid, **self.random_inputs}

    def row(self, index: int) -> dict[str, Any]:
        """The inputs of a plan; the draws vary fastest, then the last key of the grid."""
        count = self.samples.count if self.samples else 1
        at, draw = divmod(index, count)
        picked = {}
        for key, values in reversed(self.grid.items()):
            at, i = divmod(at, len(values))
            picked[key] = values[i]
        return {
            **{key: picked[key] for key in self.grid},
            **{key: values[draw] for key, values in self.random_inputs.items()},
        }

    @functools.cached_property
    def base(self) -> SweepBase:
        """The case with its fixed inputs, for all rows.

        Raises:
            CaseRejected: the case cannot be used, an input does not exist, or none of the first rows can be used.
        """
        fixed = {key: value for key, value in self.set.items() if key != IMPACT_TIME}
        always = {key: value for key, value in self.set.items() if key == IMPACT_TIME}
        kind: Literal["case", "object"] = "case" if self.object is None else "object"
        data, folder, known = self._start_case(fixed) if kind == "case" else self._start_object(fixed)
        base = SweepBase(kind=kind, what=self.what, folder=folder, data=data, always=always)
        for key, values in self.inputs.items():
            if key not in known and key != IMPACT_TIME:
                self._try_key(base, key, values[0], known)
        first: InvalidInput | None = None
        for index in range(min(self.rows, _LOOKED_AT)):
            try:
                base.look(self.row(index))
                break
            except InvalidInput as error:
                first = first or error
        else:
            raise CaseRejected(f"sweep '{self.name}': none of the first rows can be used: {first}")
        return base

    def _start_case(self, fixed: dict[str, Any]) -> tuple[dict[str, Any], str, list[str]]:
        """What the rows of a case start from: plain values, the folder of relative paths, and the keys that exist."""
        source = find_source(str(self.case), self.folder)
        known = _names(load_case(source).settings())
        try:
            loaded = load_case(source, cast(CaseChanges, fixed))
        except CaseRejected as error:
            raise self._reject(error, fixed, known) from None
        return loaded.model_dump(mode="json", by_alias=True, exclude_unset=True), str(loaded.folder), known

    def _start_object(self, fixed: dict[str, Any]) -> tuple[dict[str, Any], str, list[str]]:
        """The same of a hand and an object."""
        fields = object_fields(self.object or "")
        known = _names({**ObjectCase.of(hand="", object="").settings(), "object": fields})
        try:
            data = change_values({"hand": self.hand, "object": fields}, fixed)
            validate(ObjectCase, {**data, "folder": self.folder})
        except CaseRejected as error:
            raise self._reject(error, fixed, known) from None
        return data, str(self.folder), known

    def _try_key(self, base: SweepBase, key: str, value: Any, known: list[str]) -> None:
        """Refuse an input that does not exist; keys without a value in this case are found by trying them."""
        try:
            base.look({key: value})
        except InvalidInput as error:
            if any(
                words in str(error) for words in ("unknown key", "no further keys", "expected an index", "field of ")
            ):
                raise self._reject(error, [key], known) from None

    def _reject(self, error: InvalidInput, keys: Iterable[str], known: list[str]) -> CaseRejected:
        """The error of a case as the sweep's own, with the nearest spelling of unknown keys."""
        text = str(error).replace("--set ", "")
        if "did you mean" not in text:
            for key in keys:
                if key not in known and (near := difflib.get_close_matches(key, known, n=1)):
                    text += f"; '{key}': did you mean '{near[0]}'?"
        return CaseRejected(f"sweep '{self.name}': {text}")

    @functools.cached_property
    def files(self) -> dict[str, str]:
        """All files that hands and objects of the rows are made of, ``{path: SHA-256}``."""
        start = self.row(0)
        rows = [start]
        for key, values in self.inputs.items():
            if key.partition(".")[0] in _WITH_FILES:
                named = {text: value for value in values if '"' in (text := json.dumps(value))}
                rows += [{**start, key: value} for value in named.values()]
        with noting_files() as files:
            for row in rows:
                with contextlib.suppress(InvalidInput):  # it will be a row that says so
                    case = self.base.case(row)
                    case.load_hand()
                    case.make_object()
        return files

    def settings(self) -> dict[str, Any]:
        """The sweep as plain values, with the values of its case and the contents of all its files, wherever they
        lie.
        """
        contents: dict[str, list[str]] = {}
        for path, digest in sorted(self.files.items(), key=lambda one: one[1]):
            if digest != ABSENT:
                contents.setdefault(os.path.basename(path), []).append(digest)
        return {
            **self.model_dump(mode="json", by_alias=True),
            "of": self.base.case({}).settings(),
            "files": contents,
        }


def load_sweep(source: str | Path | dict[str, Any]) -> SweepSpec:
    """A sweep from a YAML file, or from a mapping with the same content.

    Raises:
        CaseRejected: no such file, broken YAML, unknown keys or unusable values, in the sweep or in its case.
    """
    if isinstance(source, dict):
        name, folder, data = "sweep", Path("."), source
    else:
        path = path_of("sweep", source)
        name, keys = str(path), "case, over, samples"
        data = read_mapping(path, "sweep", name, f"a YAML file with {keys}", _BIGGEST, keys)
        folder = path.resolve().parent
    mapping_of("sweep", data)
    check_extent(data, f"sweep '{name}'")
    for key in ("name", "folder"):
        if key in data:
            raise CaseRejected(f"sweep '{name}': {key}: unknown key")
    spec = validate(SweepSpec, {**data, "name": name, "folder": folder}, f"sweep '{name}'", Draw.model_fields)
    try:
        json.dumps([spec.set, spec.object, {key: v for key, v in spec.over.items() if not isinstance(v, Span)}])
    except (TypeError, ValueError) as error:
        raise CaseRejected(f"sweep '{name}': expected numbers, texts, lists and mappings as values: {error}") from None
    spec.base  # noqa: B018  (raises its errors now, not with the first row)
    return spec


def _names(value: object, name: str = "") -> list[str]:
    """The dotted names of all plain values within a value, and of the sections that hold them."""
    parts: Iterable[tuple[object, object]]
    if isinstance(value, dict):
        parts = value.items()
    elif isinstance(value, list):
        parts = enumerate(value)
    else:
        return [name]
    inner = [one for key, part in parts for one in _names(part, f"{name}.{key}" if name else str(key))]
    return [*([name] if name else []), *inner]
