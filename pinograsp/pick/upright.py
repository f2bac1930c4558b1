"""How far a held object tilts in an arm's postures."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from pinograsp.pick.arm import Arm
from pinograsp.spatial import Array, skew

_STEPS = 50  # of Newton's method, as many as OMPL's own
_LEVEL = 1e-4  # [-] sine of a tilt that is none


class Upright:
    """The tilt of what an arm holds: the angle of its axis that was vertical at x (a,), when it was taken.

    Attributes:
        most: largest tilt [rad].
    """

    def __init__(self, arm: Arm, x: Array, up_o: Array, most: float):
        self.arm, self.up_o, self.most = arm, up_o, most
        self._axis = self._turn(x).T @ up_o  # in the frame of the joint that carries the palm
        self._across = -skew(self._axis)
        self._level = np.linalg.svd(up_o[None])[2][1:]  # two level directions (2, 3)

    def _turn(self, x: Array) -> Array:
        """The rotation (3, 3) of the joint that carries the palm."""
        arm = self.arm
        pin.forwardKinematics(arm.model, arm.data, x)
        turn: Array = arm.data.oMi[arm.palm_joint].rotation
        return turn

    def lean(self, x: Array) -> Array:
        """What of the axis is level at x (a,): (2,), as long as the tilt's sine."""
        leaning: Array = self._level @ (self._turn(x) @ self._axis)
        return leaning

    def lean_slopes(self, x: Array) -> Array:
        """Its derivatives by x: (2, a)."""
        arm = self.arm
        pin.computeJointJacobians(arm.model, arm.data, x)  # and where the joints are
        J = pin.getJointJacobian(arm.model, arm.data, arm.palm_joint, pin.LOCAL)[3:]
        slopes: Array = self._level @ arm.data.oMi[arm.palm_joint].rotation @ self._across @ J
        return slopes

    def measure(self, x: Array) -> float:
        """The tilt at x (a,) [rad]."""
        axis = self._turn(x) @ self._axis
        return math.atan2(float(np.linalg.norm(self._level @ axis)), float(axis @ self.up_o))

    def project(self, x: Array, tolerance: float) -> bool:
        """Move x (a,) to a posture whose tilt's sine is at most that (Newton's method); False: it was not reached."""
        for _ in range(_STEPS):
            lean = self.lean(x)
            if lean @ lean <= tolerance**2:
                return True
            J = self.lean_slopes(x)
            (a, b), (_, d) = J @ J.T
            if not (det := a * d - b * b) > 0.0:
                return False
            x -= (np.array([d * lean[0] - b * lean[1], a * lean[1] - b * lean[0]]) / det) @ J
        return False

    def straighten(self, x: Array) -> Array | None:
        """The nearest posture without tilt, or one that is near; None: none was found."""
        x = x.copy()
        if not self.project(x, _LEVEL) or np.any(x < self.arm.lower) or np.any(x > self.arm.upper):
            return None
        return x if self.measure(x) <= self.most else None
