"""How far an arm brings its palm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

_DRAWS, _BEST = 2000, 3  # postures that are drawn, and of which the farthest are stretched
_SPAN = 2.0 * np.pi  # [rad or m] on each side of joints without limits


def measure_reach(hand: Any) -> float | None:
    """Largest distance of the palm of a ``HandModel`` from its arm's first joint, within joint limits [m].

    None of a hand without an arm.
    """
    if not len(hand.arm):
        return None
    model, data = hand.model, hand.model.createData()
    palm = model.getFrameId(hand.palm, pin.FrameType.BODY)
    joint = model.frames[palm].parentJoint
    first = next(j for j in model.supports[joint] if j and model.joints[j].nv)
    low, high = (np.clip(limit[hand.arm], -_SPAN, _SPAN) for limit in (hand.lower, hand.upper))
    q = np.array(hand.resting)

    def distance(x: Any) -> float:
        q[hand.arm] = x
        pin.forwardKinematics(model, data, q)
        place = data.oMi[joint].act(model.frames[palm].placement.translation)
        return float(np.linalg.norm(place - data.oMi[first].translation))

    drawn = np.random.default_rng(0).uniform(low, high, (_DRAWS, len(hand.arm)))
    starts = sorted(drawn, key=distance)[-_BEST:]
    bounds = list(zip(low, high))
    return max(-float(minimize(lambda x: -distance(x), x, bounds=bounds, method="L-BFGS-B").fun) for x in starts)
