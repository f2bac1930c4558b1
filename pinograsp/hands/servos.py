"""How stiff the servos of a hand's joints are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import each_of, instance_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.hands.drives import SERVO, SLIDING_SERVO
from pinograsp.hands.model import HandModel
from pinograsp.spatial import Array, BoolArray

# Ratio of damping to stiffness [s], stable for links of hardly any mass. MuJoCo's couplings need damping that is not
# implicit: critical there.
SETTLING = 0.01
CLOSED = 0.1  # [s] after t_F until which a finger may go on to reach a misplaced object; then joints are held


def unknown_stiffness(hand: HandModel) -> str | None:
    """What is assumed where the stiffness of a hand's servos is not known, in words; None where it is."""
    bare, slides = np.isnan(hand.servo_stiffness), np.array(hand.slides)
    gains = [(SERVO, "N m/rad", bare & ~slides), (SLIDING_SERVO, "N/m", bare & slides)]
    taken = [f"{gain:.3g} {unit}" for gain, unit, which in gains if which.any()]
    if not taken:
        return None
    return f"the stiffness of {int(bare.sum())} of {hand.n} joints' servos is a guess: {' and '.join(taken)}"


def find_pressing(hand: HandModel) -> BoolArray:
    """Which joints (n,) a jaw's drive closes until it presses with the effort that is asked for: those that each move
    with a drive of their own. Where one drive moves several, servos keep the object between them.
    """
    alone = {drive.joints[0] for drive in hand.drives if drive.control == "jaw" and len(drive.joints) == 1}
    return np.isin(hand.joint_names, sorted(alone))


def servo_gains(hand: HandModel, stiffness: ArrayLike | None = None) -> Array:
    """Gains of the joints' servos (n,) [N m/rad or N/m]; default: the drives' own, else 50 N m/rad or 55.6 kN/m.

    Raises:
        InvalidInput: no hand, or gains that are not numbers from 0 on, one or (n,).
    """
    instance_of("hand", hand, HandModel)
    if stiffness is None:
        known = hand.servo_stiffness
        return np.where(np.isnan(known), np.where(hand.slides, SLIDING_SERVO, SERVO), known)
    gains = each_of("servo stiffness", stiffness, hand.n)
    if gains.min() < 0:
        raise InvalidInput(
            f"servo stiffness: expected values from 0 on (torque control), got {shorten(gains.tolist())}"
        )
    return gains
