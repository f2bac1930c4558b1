"""Parameters of tests that take long: a few by default, the others with ``-m slow``."""

from __future__ import annotations

from collections.abc import Iterable

import pytest


def slow_except(values: Iterable, *quick) -> list:
    """The values, or tuples of them, as parameters: marked slow but for those of ``quick``."""
    return [
        value
        if value in quick
        else pytest.param(*(value if isinstance(value, tuple) else [value]), marks=pytest.mark.slow)
        for value in values
    ]
