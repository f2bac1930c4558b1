"""When trajectories are sampled."""

from __future__ import annotations

import numpy as np

from pinograsp.checks import number
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array

_MOST = 1_000_000  # samples of a trajectory


def sample_times(duration: float, rate: float) -> Array:
    """Times (m,) [s] from 0 to ``duration`` [s], at a ``rate`` [Hz] but for the last one.

    Raises:
        InvalidInput: a rate that is not above 0, or millions of samples.
    """
    step = 1.0 / number("rate", rate, above=0, unit="Hz")
    if duration > _MOST * step:
        raise InvalidInput(f"rate: expected fewer than {_MOST} samples in {duration:.4g} s, got {rate:g} Hz")
    return np.append(np.arange(0.0, duration - 0.5 * step, step), duration)
