"""How stiff the servos of a hand's joints are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import each_of, instance_of, shown
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.spatial import Array

_SERVO = 50.0  # [N m/rad] stiffness of a small servo; at a sliding joint that of the same, 30 mm from its axis
_LEVER = 0.03  # [m]


def servo_gains(hand: HandModel, stiffness: ArrayLike | None = None) -> Array:
    """Gains of the joints' servos (n,) [N m/rad or N/m]; default: the drives' own, else 50 N m/rad or 55.6 kN/m.

    Raises:
        InvalidInput: no hand, or gains that are not numbers from 0 on, one or (n,).
    """
    instance_of("hand", hand, HandModel)
    if stiffness is None:
        known = hand.servo_stiffness
        return np.where(np.isnan(known), np.where(hand.slides, _SERVO / _LEVER**2, _SERVO), known)
    gains = each_of("servo stiffness", stiffness, hand.n)
    if gains.min() < 0:
        raise InvalidInput(f"servo stiffness: expected values from 0 on (torque control), got {shown(gains.tolist())}")
    return gains
