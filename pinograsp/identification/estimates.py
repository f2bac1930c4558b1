"""Intervals by bootstrap."""

from __future__ import annotations

import numpy as np

from pinograsp.hands.estimates import Estimate
from pinograsp.spatial import Array

_INTERVAL = (0.025, 0.975)


def widen(value: float, drawn: Array, factor: float = 1.0, share: float = 0.0) -> Estimate:
    """The interval of a bootstrap's figures (r,), widened by a factor and a share of the value."""
    low, high = np.quantile(drawn, _INTERVAL)
    below, above = (np.hypot(factor * way, share * value) for way in (min(low - value, 0.0), max(high - value, 0.0)))
    return Estimate(float(value), float(value - below), float(value + above))
