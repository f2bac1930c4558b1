"""What the writers of all formats share: the numbers that are added, and the containers."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

UNIT = {"force_unit": "N", "force_frame": "object"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Payload:
    """What is written besides the grasps themselves.

    Attributes:
        labels: {name: (N,)}.
        extras: {name: (N, ...)}.
        texts: the forces' unit and frame, where there are forces.
    """

    labels: dict[str, NDArray[Any]]
    extras: dict[str, NDArray[Any]]
    texts: dict[str, str]


def npy_of(value: Any) -> bytes:
    """An .npy file of plain dicts, lists and arrays, as ``numpy.save`` writes it."""
    array = np.empty(len(value) if isinstance(value, list) else (), dtype=object)
    if isinstance(value, list):
        array[:] = value
    else:
        array[()] = value
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()
