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
GIVES = 0.03  # [rad or m] by which an arm's joint gives way to its largest torque, where its stiffness is not known
QUICKEST = 700.0  # [rad/s] of its servo: damping that acts at the beginning of a step of 1 ms is stable below 1000
CLOSED = 0.1  # [s] after t_F until which a finger may go on to reach a misplaced object; then joints are held


def unknown_stiffness(hand: HandModel) -> str | None:
    """What is assumed where the stiffness of a hand's servos is not known, in words; None where it is."""
    bare, slides = np.isnan(hand.servo_stiffness), np.array(hand.slides)
    stiff = bare & (_stiffness_of_arm(hand) > 0)
    gains = [(SERVO, "N m/rad", bare & ~stiff & ~slides), (SLIDING_SERVO, "N/m", bare & ~stiff & slides)]
    taken = [f"{gain:.3g} {unit}" for gain, unit, which in gains if which.any()]
    taken += [f"{GIVES:g} rad under the largest torque of the arm's"] if stiff.any() else []
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
    """Return the gains of the joints' servos (n,) [N m/rad or N/m].

    The default gains are those of the drives, or else 50 N m/rad or 55.6 kN/m. Joints of an arm get gains with which
    they give way by 0.03 rad or m under their largest torque.

    Raises:
        InvalidInput: not a hand, or gains that are not one or (n,) numbers >= 0.
    """
    instance_of("hand", hand, HandModel)
    if stiffness is None:
        known = hand.servo_stiffness
        guessed = _stiffness_of_arm(hand)
        guessed = np.where(guessed > 0, guessed, np.where(hand.slides, SLIDING_SERVO, SERVO))
        return np.where(np.isnan(known), guessed, known)
    gains = each_of("servo stiffness", stiffness, hand.n)
    if gains.min() < 0:
        raise InvalidInput(
            f"servo stiffness: expected values from 0 on (torque control), got {shorten(gains.tolist())}"
        )
    return gains


def _stiffness_of_arm(hand: HandModel) -> Array:
    """Of the joints that carry the palm (n,) [N m/rad or N/m], where their efforts are known; 0 of all others."""
    arm, stiffness = hand.arm, np.zeros(hand.n)
    if not len(arm):
        return stiffness
    # What a joint moves when all others give way is less than what it moves when they do not.
    least = 1.0 / np.diag(np.linalg.inv(hand.joint_inertia(hand.resting)))
    stiffness[arm] = np.minimum(hand.effort / GIVES, QUICKEST**2 * least)[arm]
    return np.where(np.isfinite(stiffness), stiffness, 0.0)
