"""How an arm is to go when it picks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import brief, number, share_of

_LEAST_TILT = 0.01  # [rad] that postures, splines and rounding take


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickMotion:
    """Settings of the arm's motion.

    Attributes:
        lift: distance by which the object goes straight up, and comes straight down [m].
        upright: largest tilt of the held object [rad]; None: any.
        acceleration: largest |acceleration| of the arm's joints, one number or (n,) [rad/s^2 or m/s^2].
        speed: largest |speed| of the arm's joints, one number or (n,) [rad/s or m/s]; None: the robot's own.
        object_speed: largest speed of the object [m/s]; None: any.
        reserve: share of torques, speeds and accelerations, and of the grasp's friction along the path, that is kept
            free [-].
    """

    lift: float = 0.1
    upright: float | None = None
    acceleration: ArrayLike = 10.0
    speed: ArrayLike | None = None
    object_speed: float | None = None
    reserve: float = 0.3

    __repr__ = brief("lift", "upright", "object_speed", "reserve")

    def __post_init__(self) -> None:
        number("lift", self.lift, above=0, at_most=2, unit="m")
        if self.upright is not None:
            number("upright", self.upright, at_least=_LEAST_TILT, at_most=np.pi, unit="rad")
        share_of("reserve", self.reserve)
