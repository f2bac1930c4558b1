"""Friction of contacts, from slips."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.estimates import Estimate
from pinograsp.identification.estimates import widen

_RESAMPLES, _WIDER = 200, 1.1  # medians of some tens of samples scatter by more than a bootstrap has it


def identify_friction(
    normal: ArrayLike, tangential: ArrayLike, slips: ArrayLike, *, seed: int = 0
) -> tuple[Estimate | None, float]:
    """Identify the friction coefficient of a contact that slipped, and a lower bound: the largest ratio of forces while
    it stuck.

    Args:
        normal, tangential: forces (s,) [N], or in another common unit.
        slips: whether it slips (s,).
        seed: of the bootstrap.

    Returns:
        The coefficient (None if it never slipped for ten samples), and the lower bound.

    Raises:
        InvalidInput: arrays of other sizes, or a normal force that is never above 0.
    """
    fn, ft = array_of("normal", normal, (None,)), np.abs(array_of("tangential", tangential, (None,)))
    slipping = np.asarray(slips)
    if fn.shape != ft.shape or slipping.shape != fn.shape or slipping.dtype != bool:
        raise InvalidInput("normal, tangential, slips: expected (s,), (s,) and booleans (s,)")
    pressed = fn > 0.05 * fn.max(initial=0.0)
    if not pressed.any():
        raise InvalidInput("normal: expected forces above 0, got none")
    ratio = np.where(pressed, ft / np.where(pressed, fn, 1.0), 0.0)
    stuck = float(np.quantile(ratio[pressed & ~slipping], 0.99)) if (pressed & ~slipping).any() else 0.0
    found = ratio[pressed & slipping]
    if len(found) < 10:
        return None, stuck
    rng = np.random.default_rng(seed)
    drawn = np.median(found[rng.integers(len(found), size=(_RESAMPLES, len(found)))], axis=1)
    return widen(float(np.median(found)), drawn, _WIDER), stuck
