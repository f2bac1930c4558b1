"""Figures of records as plain values, for people and their scripts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from pinograsp.checks import items_of
from pinograsp.spatial import Array

Plain = dict[str, Any]  # what JSON can hold, units in the names


def plain_fields(record: Any, **units: str) -> Plain:
    """The fields of a record of numbers, texts and arrays as plain JSON values; ``units``: names with units for some.

    Infinite numbers are None.
    """
    values = {one.name: getattr(record, one.name) for one in fields(record)}
    return {units.get(name, name): _plain(value) for name, value in values.items()}


def by_contact(names: tuple[str, ...], values: Array) -> Plain:
    """A value for each contact (k, ...) by its name, as plain JSON values."""
    return dict(zip(items_of("names", names, str), _plain(values)))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_plain(one) for one in value.tolist()]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, tuple | list) else value
