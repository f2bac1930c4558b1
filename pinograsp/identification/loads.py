"""What a hand lifts, by drives that are known."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.hands.estimates import Estimate
from pinograsp.identification.estimates import widen
from pinograsp.identification.motion import IdentifiedMotion, draw_blocks, make_torque
from pinograsp.identification.motion_log import MotionLog, differentiate, find_moving, find_window
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.spatial import Array, IntArray

# Intervals are wider than the bootstrap has them, as those of drives: see motion.py.
_MASS_WIDER, _MASS_SHARE = 1.3, 0.005
_DRIVES = 0.2  # share of the drives' own intervals: their errors are mostly alike in both logs, and cancel
_LENGTHS = np.array([1.0, 0.05, 0.05, 0.05])  # units of m [kg] and m c [kg m] that are alike, by lengths of a hand
_TOLD = 0.95  # share of a figure that the motion tells


def identify_load(
    hand: HandModel,
    log: MotionLog,
    drives: IdentifiedMotion,
    link: str,
    *,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
    seed: int = 0,
) -> tuple[Estimate, Array | None]:
    """Identify the mass that a link carries besides its own [kg], and its centre of mass in the link's frame (3,) [m];
    None if the motion does not determine it: joints with parallel axes do not show where it is along them.

    If the motion cannot separate the mass from its position, as with the last joint alone, the mass is assumed at the
    link's origin.

    Args:
        hand, gravity_o, seed: as for :func:`identify_motion`.
        log: log of the hand that moves with it.
        drives: drives identified without it.
        link: link that carries it.

    Raises:
        InvalidInput: the link does not exist, joints are coupled, or no drive is known.
    """
    if hand.model.njoints - 1 != hand.n:
        raise InvalidInput("load: expected a hand whose joints move one by one, got one with coupled joints")
    frame = hand.model.frames[hand.frame_id(link)]
    path = differentiate(log)
    torques = inverse_dynamics(hand, *path, gravity_o=gravity_o)
    model = hand.model.copy()
    model.gravity.linear = array_of("gravity", gravity_o, (3,))
    data, first = model.createData(), 10 * (int(frame.parentJoint) - 1)
    known = [(i, drive) for i, drive in enumerate(hand.drives) if drive.name in drives.drives]
    if not known:
        raise InvalidInput("drives: expected one or more that are known, got none")
    rows = range(0, len(log.times), max(1, len(log.times) // 2000))
    regressors = np.array(
        [
            pin.computeJointTorqueRegressor(model, data, *(one[s] for one in path))[:, first : first + 4].copy()
            for s in rows
        ]
    )
    blocks, wanted, doubts = [], [], []
    for i, drive in known:
        j, fit = hand.joint_names.index(drive.joints[0]), drives.drives[drive.name]
        made = drive.arms[0] * make_torque(fit, log, i, path[1][:, j], path[2][:, j])
        moving = find_moving(path[1][:, j], find_window(log))[rows] & np.isfinite(made[rows])
        blocks.append(np.where(moving[:, None], regressors[:, j], 0.0))
        wanted.append(np.where(moving, made[rows] - torques[rows, j], 0.0))
        doubt = (fit.effort_step.high - fit.effort_step.low) / (2 * fit.effort_step.value)
        doubts.append(np.where(moving, doubt * made[rows], 0.0))
    A, y = np.stack(blocks, axis=1), np.stack(wanted, axis=1)  # (s, drives, 4), (s, drives)
    # What the motion tells of m and m c, lengths in 50 mm: directions of large singular values.
    values, directions = np.linalg.svd(A.reshape(-1, 4) * _LENGTHS, full_matrices=False)[1:]
    told = directions[values > 0.02 * values[0]]
    share = np.sum(told**2, axis=0)
    if share[0] < _TOLD:  # the mass alone is not: taken as if it were at the link's origin
        lever = frame.placement.translation
        A, told, share = A[..., :1] + A[..., 1:] @ lever[:, None], np.ones((1, 1)), np.zeros(4)

    def solve(chosen: IntArray, y: Array = y) -> Array:
        columns = A[chosen].reshape(-1, A.shape[-1]) * _LENGTHS[: A.shape[-1]] @ told.T
        found = told.T @ np.linalg.lstsq(columns, y[chosen].ravel(), rcond=None)[0]
        return np.asarray(found * _LENGTHS[: A.shape[-1]])

    every = np.arange(len(A))
    best = solve(every)
    # By drive, the change of the mass for an effort that is stronger by the half width of its interval.
    changes = [solve(every, doubt[:, None] * one)[0] for doubt, one in zip(doubts, np.eye(len(known)))]
    dt = float(np.median(np.diff(log.times))) * rows.step
    drawn = np.array([solve(chosen) for chosen in draw_blocks(len(A), dt, np.random.default_rng(seed))])
    unsure = np.hypot(_MASS_SHARE * best[0], _DRIVES * np.linalg.norm(changes))
    mass = widen(best[0], drawn[:, 0], _MASS_WIDER, float(unsure / abs(best[0])) if best[0] else 0.0)
    if share.min() < _TOLD or best[0] <= 0:
        return mass, None
    return mass, np.asarray(frame.placement.actInv(best[1:] / best[0]))
