"""What a carried grasp and its robot may use: limits less the share that is kept free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.carry.constraints import ArmLimits
from pinograsp.carry.loads import LoadedRobot
from pinograsp.checks import each_of, number
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem, Reserve, TorqueLimit
from pinograsp.forces.matrices import balance_columns
from pinograsp.hands import HandModel
from pinograsp.motion import effort_of, torque_limits
from pinograsp.motion.torques import torques_matter
from pinograsp.objects.body import Body
from pinograsp.planner import GraspPlan
from pinograsp.spatial import Array

_ANY = 1e9  # [m/s, m/s^2] no limit
_RANK = 1e-9  # singular values below this share of the largest are none


def limit_arm(
    robot: HandModel,
    torque_limit: TorqueLimit,
    speed: ArrayLike | None,
    acceleration: ArrayLike | None,
    reserve: float,
    object_speed: float | None = None,
) -> ArmLimits:
    """Of a robot's joints; speeds and accelerations (n,), None: the robot's own speeds, no acceleration. And of what it
    carries [m/s], None: any.
    """
    n, kept = robot.n, 1.0 - reserve
    return ArmLimits(
        torque=kept * effort_of(robot, torque_limit),
        speed=kept * (robot.speed_limits if speed is None else read_joint_limits("speed", speed, n)),
        acceleration=np.full(n, np.inf)
        if acceleration is None
        else kept * read_joint_limits("acceleration", acceleration, n),
        object_speed=np.inf if object_speed is None else number("object speed", object_speed, above=0, unit="m/s"),
    )


def read_joint_limits(name: str, value: ArrayLike, n: int) -> Array:
    """One limit for all of n joints, or one for each (n,), above 0."""
    found = each_of(name, value, n)
    if np.any(found <= 0):
        raise InvalidInput(f"{name}: expected values above 0, got {found.tolist()}")
    return found


def find_disturbance(grasp: GraspPlan, body: Body, size: float | None) -> tuple[float, float]:
    """Force in any direction [N], or moment about any axis [N m], to withstand on the way as well.

    ``body``: what is held. ``size``: of the force; None: what the grasp's plan withstands besides its weight, a heavier
    object included.
    """
    own = grasp.reserve
    if size is not None:
        return size, size * Reserve().arm(body)
    if own is None:
        return 0.0, 0.0
    return own.force + own.mass * body.mass * float(np.linalg.norm(grasp.gravity_o)), own.moment


def spare_forces(problem: ForceProblem, force: float, moment: float) -> Array:
    """Normal forces (k,) [N] that contacts keep beyond what friction needs, for disturbances of these sizes [N, N m].

    Contacts react to a disturbance as equal springs do (Salisbury and Roth, 1983): x changes by T w along the surface
    and by N w along the normal. |u + T w| <= F + N w for all |w| <= r follows from |u| <= F - r (|T| + |N|).
    """
    friction, k, d = problem.friction, problem.k, problem.friction.d
    widths = friction.scale(problem.mu)
    arms = np.ones_like(widths)
    arms[:, 2:] = friction.torsion
    columns = balance_columns(problem, np.where(widths > 0, arms, 0.0))
    reaction = np.asarray(np.linalg.pinv(columns, rcond=_RANK)).reshape(k, d, -1)
    across = np.divide(
        reaction[:, :-1] * arms[:, :, None],
        widths[:, :, None],
        where=widths[:, :, None] > 0,
        out=np.zeros((k, d - 1, 6)),
    )
    spare = np.zeros((2, k))
    for part, rows in enumerate((slice(0, 3), slice(3, 6))):
        T = across[:, :, rows]
        size = np.zeros(k)
        if friction.round_dimensions:
            size = np.linalg.norm(T[:, : friction.round_dimensions], 2, axis=(1, 2))
        if len(friction.facets):
            size = np.maximum(size, np.linalg.norm(friction.facets @ T, axis=2).max(axis=1))
        spare[part] = size + np.linalg.norm(reaction[:, -1, rows], axis=1)
    return np.asarray(np.maximum(force * spare[0], moment / problem.moment_length * spare[1]))


def limit_grasp(
    grasp: GraspPlan, loaded: LoadedRobot, reserve: float, limit: TorqueLimit, mu: float
) -> tuple[ForceProblem, tuple[Array, Array]]:
    """The grasp's problem, its friction and the torques of its hand less the reserve, and the normal forces' range.

    ``mu``: share of the friction coefficients that there is at least [-].
    """
    held, kept, hand = grasp.problem, 1.0 - reserve, grasp.hand
    contacts, q = held.contacts, np.array(grasp.motion.q[-1])
    friction = replace(held.friction, safety=held.friction.safety / kept)
    # Limits of each joint are the robot's.
    own = limit[loaded.of_hand] if isinstance(limit, np.ndarray) and limit.ndim else limit
    most = effort_of(hand, own)
    arm = np.setdiff1d(np.arange(hand.n), loaded.finger_dofs)
    most[arm] = np.inf  # rows of their own, without contact forces
    torques = None
    if torques_matter(hand, most):
        depth = grasp.forces.final_depths
        torques = torque_limits(hand, contacts, q, depth=depth, limit=most, gravity_o=held.gravity_o)
        torques = replace(torques, headroom=reserve)
    problem = replace(
        held,
        mu=mu * held.mu,
        friction=friction,
        torques=torques,
        balance="wrench",
        # How fast the hand closed (Eqs. 13b and 13c) does not matter any more, how deep contacts may be (13a) does.
        acceleration_range=(1.0 / _ANY, _ANY),
        max_speed=_ANY,
    )
    low = np.zeros(held.k) if held.min_normal_force is None else held.min_normal_force
    high = np.full(held.k, held.deepest_force)
    if held.max_normal_force is not None:
        high = np.minimum(high, held.max_normal_force)
    return problem, (low, np.maximum(kept * high, low + 1e-9))
