"""Postures of an arm in which its palm is where it is wanted, by Pink's quadratic programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pinograsp.errors import ExtraMissing
from pinograsp.pick.arm import Arm
from pinograsp.spatial import Array

if TYPE_CHECKING:
    import pink

_MOST_STEPS = 60  # of one start, of some 0.2 ms each
_CLOSE = 1e-5  # [m], [rad] of the palm from where it is wanted
_DAMPING = 1e-3  # of the steps, in proportion to what is left (Levenberg-Marquardt)
_SAME = 0.1  # [rad or m] postures this close are one
_JUMP = 0.5  # [rad or m] from one point of a line to the next: the arm turns over


class PalmSolver:
    """Inverse kinematics of an arm's palm."""

    def __init__(self, arm: Arm):
        try:
            import pink
            from pink.limits import ConfigurationLimit
        except ImportError as error:
            raise ExtraMissing("pin-pink solves the arm's inverse kinematics: pip install 'pinograsp[arm]'") from error
        self.arm, self._pink = arm, pink
        self.limits = (ConfigurationLimit(arm.model),)
        self.task = pink.FrameTask(
            arm.robot.palm, position_cost=1.0, orientation_cost=0.3, lm_damping=_DAMPING, gain=1.0
        )

    def solve(self, target: Array, start: Array, steps: int = _MOST_STEPS) -> Array | None:
        """The arm's positions (a,) with the palm at ``target`` (4, 4), from ``start`` (a,); None: not found so."""
        arm = self.arm
        self.task.set_target(pin.SE3(target))
        inside = np.clip(start, arm.lower, arm.upper)
        at: pink.Configuration = self._pink.Configuration(arm.model, arm.data, inside)
        for _ in range(steps):
            if np.abs(self.task.compute_error(at)).max() < _CLOSE:
                return np.array(at.q)
            velocity = self._pink.solve_ik(
                at, [self.task], 1.0, solver="daqp", damping=1e-9, limits=self.limits, safety_break=False
            )
            at.integrate_inplace(velocity, 1.0)
        return np.array(at.q) if np.abs(self.task.compute_error(at)).max() < _CLOSE else None

    def find_postures(self, target: Array, starts: Array) -> list[Array]:
        """Different postures with the palm at ``target`` (4, 4), from ``starts`` (s, a), in their order."""
        found = list[Array]()
        for start in starts:
            x = self.solve(target, start)
            if x is not None and all(np.abs(x - one).max() > _SAME for one in found):
                found.append(x)
        return found

    def follow(self, targets: Array, start: Array) -> Array | None:
        """The positions (m, a) along palms ``targets`` (m, 4, 4), from ``start`` (a,); None: where it cannot go on."""
        path, x = list[Array](), start
        for target in targets:
            after = self.solve(target, x)
            if after is None or np.abs(after - x).max() > _JUMP:
                return None
            path.append(after)
            x = after
        return np.array(path)
