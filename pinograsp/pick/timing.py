"""How fast an arm that holds nothing goes along a path, by TOPP-RA."""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d

from pinograsp.carry import ArmPath
from pinograsp.carry.constraints import ArmLimits
from pinograsp.errors import ExtraMissing
from pinograsp.hands import HandModel
from pinograsp.spatial import Array

_POINTS, _BETWEEN = 200, 4  # of the path at which limits hold, at least, and from each waypoint to the next
_STEP = 1e-3  # [s] of the motion
_ANY = 1e9  # no limit
_SPARE = 1e-9  # limits that are equal are none to TOPP-RA


class Timed(NamedTuple):
    """Motion of a robot's joints, from rest to rest, in steps of about a millisecond: times (m,) [s], others (m, n)."""

    times: Array
    q: Array
    dq: Array
    ddq: Array


def time_path(
    robot: HandModel, path: ArmPath, q: Array, limits: ArmLimits, gravity_o: Array, ramp: float
) -> Timed | None:
    """The fastest motion along a path within limits of torques, speeds and accelerations (Pham and Pham 2018), and its
    moving average over ``ramp`` [s], so that accelerations do not jump; None: the torques do not even hold the arm.

    Args:
        robot: arm and hand.
        path: of the arm.
        q: of the robot (n,), where all other joints stay.
        limits: of the robot's joints (n,).
        gravity_o: (3,) [m/s^2].
        ramp: [s].

    Raises:
        ExtraMissing: TOPP-RA is not installed.
    """
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError as error:
        raise ExtraMissing("toppra times the paths: pip install 'pinograsp[arm]'") from error
    logging.getLogger("toppra").setLevel(logging.ERROR)
    model = robot.model.copy()
    model.gravity.linear = np.array(gravity_o)
    data, which = model.createData(), [robot.joint_names.index(joint) for joint in path.joints]

    def torques_of(at: Array, rate: Array, acceleration: Array) -> Array:
        whole, rates, accelerations = np.array(q), np.zeros(robot.n), np.zeros(robot.n)
        whole[which], rates[which], accelerations[which] = at, rate, acceleration
        return np.array(pin.rnea(model, data, whole, rates, accelerations)[which])

    pairs = [
        np.minimum(one[which], _ANY)[:, None] * [-1.0, 1.0]
        for one in (limits.torque, limits.speed, limits.acceleration)
    ]
    torque, speed, acceleration = (one + np.array([-_SPARE, _SPARE]) for one in pairs)
    kinds = [
        constraint.JointVelocityConstraint(speed),
        constraint.JointAccelerationConstraint(acceleration),
        constraint.JointTorqueConstraint(torques_of, torque, np.zeros(len(which))),
    ]
    for kind in kinds:
        kind.set_discretization_type(1)  # limits hold at both ends of each interval
    curve = toppra.SplineInterpolator(path.s, path.q)
    between = np.interp(np.arange(_BETWEEN * (len(path.s) - 1)) / _BETWEEN, np.arange(len(path.s)), path.s)
    points = np.union1d(between, np.linspace(0.0, 1.0, _POINTS)).round(12)
    solver = algorithm.TOPPRA(kinds, curve, gridpoints=np.unique(points), parametrizer="ParametrizeConstAccel")
    timed = solver.compute_trajectory(0.0, 0.0)
    if timed is None:
        return None
    motion = _average(robot, which, q, timed, ramp)
    # Between the points of the path it may be beyond its limits by a little.
    torques = np.array([pin.rnea(model, data, *row) for row in zip(motion.q, motion.dq, motion.ddq)])
    still = np.array([pin.computeGeneralizedGravity(model, data, row) for row in motion.q])
    own = [limit[which] for limit in (limits.torque, limits.speed, limits.acceleration)]
    moving, left = np.abs(torques - still)[:, which], np.maximum(own[0] - np.abs(still[:, which]), _SPARE)
    squares = [(moving / left).max(), (np.abs(motion.dq[:, which]) / own[1]).max() ** 2]
    squares.append((np.abs(motion.ddq[:, which]) / own[2]).max())
    slower = max(1.0, float(max(squares))) ** 0.5
    return Timed(slower * motion.times, motion.q, motion.dq / slower, motion.ddq / slower**2)


def _average(robot: HandModel, which: list[int], q: Array, timed: object, ramp: float) -> Timed:
    """The moving average of a motion, which keeps to the limits of its speeds and accelerations."""
    duration = float(timed.duration)  # type: ignore[attr-defined]
    count, width = int(np.ceil((duration + ramp) / _STEP)), max(1, round(ramp / _STEP))
    times = _STEP * np.arange(count + width + 1, dtype=float)
    at = timed(np.clip(times - ramp / 2.0, 0.0, duration))  # type: ignore[operator]
    smooth = at
    for _ in range(2):  # once for continuous accelerations, once more for the samples' own
        smooth = uniform_filter1d(smooth, max(1, width // 2), axis=0, mode="nearest")
    whole = np.tile(q, (len(times), 1))
    whole[:, which] = smooth
    dq: Array = np.gradient(whole, _STEP, axis=0)
    dq[[0, -1]] = 0.0
    ddq: Array = np.gradient(dq, _STEP, axis=0)
    return Timed(times, whole, dq, ddq)
