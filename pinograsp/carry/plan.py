"""How fast an arm may carry what its hand holds along a path, and how hard the hand must squeeze on the way."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.carry.interior_point import Solved, solve, times
from pinograsp.carry.loads import Carried
from pinograsp.carry.path import ArmPath
from pinograsp.carry.programs import ArmLimits, Programs
from pinograsp.carry.record import CarryPlan
from pinograsp.checks import array_of, each_of, instance_of, integer, read_only, share_of
from pinograsp.errors import CarryInfeasible, CarryUndecided, InvalidInput
from pinograsp.forces import ForceProblem, TorqueLimit, optimize_forces
from pinograsp.handover import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.motion import effort_of, torque_limits
from pinograsp.motion.torques import torques_matter
from pinograsp.planner import GraspPlan
from pinograsp.spatial import Array

ACCURACY = 1e-7  # relative, of the duration
_SLOWER = 1e-6  # squared speeds at which forces are chosen, less than the fastest: there is room for a choice
_BALANCED, _LEAST = 1e-6, 1e-3  # errors of the loads, and the gap, with which chosen forces are good enough
_BINDS = 1e-3  # share of the largest multiplier from which on a limit binds


def plan_carry(
    robot: HandModel,
    grasp: GraspPlan,
    path: ArmPath | JointTrajectory | Mapping[str, ArrayLike],
    *,
    intervals: int = 500,
    reserve: float = 0.1,
    torque_limit: TorqueLimit = "effort",
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
) -> CarryPlan:
    """The fastest timing of a path from rest to rest that a grasp, its friction and the motors bear.

    The path's parameter s moves with piecewise constant acceleration; wrench and torques are linear in it and in the
    squared speed, so that timing and contact forces together are one convex program (Verscheure et al. 2009, with exact
    friction cones), solved to a proven gap. Balance and limits hold at the middles of the intervals; forces are the
    least ones (sum of squares) for that timing.

    Args:
        robot: arm and hand in one model.
        grasp: as planned with this robot, or with its hand alone: what is held, where, with what friction.
        path: of the arm: ``{joint: waypoints}`` [rad or m], an :class:`~pinograsp.carry.ArmPath`, or a trajectory, of
            which the shape counts. Other joints stay as they are in the grasp.
        intervals: of the path, N.
        reserve: share of friction, largest normal forces, torques, speeds and accelerations that is kept free [-].
        torque_limit: largest |torque| of the robot's joints as for :class:`~pinograsp.forces.GraspConditions`.
        speed: largest |speed|, one number or (n,) [rad/s or m/s]; None: the robot's own, where it has them.
        acceleration: largest |acceleration| likewise [rad/s^2 or m/s^2]; None: no limit.
        gravity_o: (3,) [m/s^2] in the robot's world.

    Raises:
        InvalidInput: unusable numbers, a path of other joints than the arm's or beyond their limits, a robot without
            the grasp's hand.
        CarryInfeasible: no timing holds the object: at a point of the path there are no forces, proven.
        CarryUndecided: none was found, and none is ruled out.
    """
    started = time.perf_counter()
    instance_of("robot", robot, HandModel)
    instance_of("grasp", grasp, GraspPlan)
    way = _path_of(path)
    N, reserve = integer("intervals", intervals, at_least=2, at_most=100_000), share_of("reserve", reserve)
    gravity = array_of("gravity", gravity_o, (3,))
    held = grasp.problem
    if held.object is None:
        raise InvalidInput("grasp: expected one of a known object, whose mass and inertia are to be carried")
    carried = Carried(robot, grasp.hand, held.object, np.array(grasp.motion.q[-1]))
    limits = _limits(robot, torque_limit, speed, acceleration, reserve)
    s = np.linspace(0.0, 1.0, N + 1)
    middle, nodes = carried.along(way, (s[:-1] + s[1:]) / 2.0, gravity), carried.along(way, s, gravity)
    problem, range_n = _with_reserve(grasp, carried, reserve, torque_limit)
    programs = Programs(problem, range_n, carried, limits, middle, nodes)
    elapsed = {"loads": time.perf_counter() - started}
    mark = time.perf_counter()
    fastest = solve(programs.program(), accuracy=ACCURACY)
    elapsed["timing"] = time.perf_counter() - mark
    if not fastest.converged:
        raise _failure(programs, range_n, s, fastest)
    mark = time.perf_counter()
    anywhere = solve(programs.fastest_anywhere(), accuracy=ACCURACY)
    limit = np.sqrt(anywhere.y.reshape(N, 2).mean(axis=1))
    y = fastest.y * (1.0 - _SLOWER)
    forces = solve(programs.gentlest(y), accuracy=ACCURACY)
    elapsed["forces"] = time.perf_counter() - mark
    # Which forces are taken matters less than that they balance the loads.
    least = forces.residual < _BALANCED and forces.gap < _LEAST
    notes = () if least else ("the forces bear the loads, but they are not the least ones",)
    chosen = forces if least else replace(fastest, y=y)
    return _plan(programs, way, s, fastest, chosen, limit, reserve, elapsed, notes)


def _path_of(path: ArmPath | JointTrajectory | Mapping[str, ArrayLike]) -> ArmPath:
    if isinstance(path, JointTrajectory):
        return ArmPath.of(path)
    if isinstance(path, Mapping):
        return ArmPath.through(path)
    return instance_of("path", path, ArmPath)


def _limits(
    robot: HandModel,
    torque_limit: TorqueLimit,
    speed: ArrayLike | None,
    acceleration: ArrayLike | None,
    reserve: float,
) -> ArmLimits:
    n, kept = robot.n, 1.0 - reserve

    def each(name: str, value: ArrayLike | None) -> Array:
        if value is None:
            return np.full(n, np.inf)
        found = each_of(name, value, n)
        if np.any(found <= 0):
            raise InvalidInput(f"{name}: expected values above 0, got {found.tolist()}")
        return found

    own = np.where(robot.velocity > 0, robot.velocity, np.inf)
    return ArmLimits(
        torque=kept * effort_of(robot, torque_limit),
        speed=kept * (own if speed is None else each("speed", speed)),
        acceleration=kept * each("acceleration", acceleration),
    )


def _with_reserve(
    grasp: GraspPlan, carried: Carried, reserve: float, limit: TorqueLimit
) -> tuple[ForceProblem, tuple[Array, Array]]:
    """The grasp's problem, its friction and the torques of its hand less the reserve, and the normal forces' range."""
    held, kept, hand = grasp.problem, 1.0 - reserve, grasp.hand
    contacts, q = held.contacts, np.array(grasp.motion.q[-1])
    friction = replace(held.friction, safety=held.friction.safety / kept)
    # Limits of each joint are the robot's.
    own = limit[carried.of_hand] if isinstance(limit, np.ndarray) and limit.ndim else limit
    most = effort_of(hand, own)
    arm = np.setdiff1d(np.arange(hand.n), np.concatenate([finger.dofs for finger in hand.fingers]))
    most[arm] = np.inf  # rows of their own, without contact forces
    torques = None
    if torques_matter(hand, most):
        depth = grasp.searched().profile.final_depth
        torques = torque_limits(hand, contacts, q, depth=depth, limit=most, gravity_o=held.gravity_o)
        torques = replace(torques, reserve=reserve)
    problem = replace(held, friction=friction, torques=torques, balance="wrench")
    low, high = held.normal_force_range(grasp.forces.impact_time)
    return problem, (low, np.maximum(kept * high, low + 1e-9))


def _failure(programs: Programs, range_n: tuple[Array, Array], s: Array, found: Solved) -> Exception:
    """Why there is no timing: where the object cannot even be held at rest, with the proof."""
    still = programs.middle.wrench.still
    held = replace(programs.problem, min_normal_force=None, max_normal_force=range_n[1])
    order = np.unique(np.linspace(0, len(still) - 1, min(len(still), 60)).astype(int))
    for i in order.tolist():
        torques = held.torques
        if torques is not None:
            torques = replace(torques, bias=programs.middle.torque.still[i, programs.carried.of_hand])
        at_rest = optimize_forces(
            replace(held, load=-still[i], torques=torques), 0.9 * held.final_time, objective="peak"
        )
        if at_rest.infeasibility is not None:
            at = (s[i] + s[i + 1]) / 2.0
            return CarryInfeasible(
                f"at {100 * at:.3g} % of the path the grasp cannot hold the object even at rest, with what is kept "
                f"free (proven): {at_rest.infeasibility}; turn the hand less, squeeze from other sides, keep less free",
                at=float(at),
                solution=at_rest,
            )
    return CarryUndecided(
        f"no timing was found, and none is ruled out: relative gap {found.gap:.1e}, balance to {found.residual:.1e} "
        f"after {found.rounds} rounds; the arm may not bear the object at rest: see its torque limits",
        solution=found,
    )


def _plan(
    programs: Programs,
    path: ArmPath,
    s: Array,
    fastest: Solved,
    chosen: Solved,
    limit: Array,
    reserve: float,
    elapsed: dict[str, float],
    notes: tuple[str, ...],
) -> CarryPlan:
    problem, carried, middle = programs.problem, programs.carried, programs.middle
    y, N, k, d = chosen.y, programs.count, problem.k, problem.friction.d
    b, a = (y[:-1] + y[1:]) / 2.0, np.diff(y) / (2.0 * programs.step)
    widths = problem.friction.scale(problem.mu)
    local = np.concatenate([chosen.x[..., :2] * widths[:, :2], chosen.x[..., -1:]], axis=2)
    torsion = chosen.x[..., 2] * widths[:, 2] if d == 4 else np.zeros((N, k))
    forces = np.einsum("kij,nkj->nki", problem.contacts.rotations_oc, local)
    torques = middle.torque.at(a, b)
    torques[:, carried.fingers] += _contact_torques(programs, chosen)[:, carried.fingers]
    took = times(np.stack([y[:-1], y[1:]], axis=1), programs.step).value
    speed = np.sqrt(y)
    use = problem.friction.gauge(chosen.x[..., :-1]) / np.maximum(chosen.x[..., -1], 1e-300)
    return CarryPlan(
        robot=carried.robot,
        path=path,
        contacts=tuple(problem.contacts.names),
        s=read_only(s),
        times=read_only(np.concatenate([[0.0], np.cumsum(took)])),
        speed=read_only(speed),
        limit=read_only(limit),
        q=read_only(middle.q),
        dq=read_only(middle.speed * np.sqrt(b)[:, None]),
        ddq=read_only(middle.acceleration.at(a, b)),
        torques=read_only(torques),
        loads=read_only(-middle.wrench.at(a, b)),
        forces_o=read_only(forces),
        normal_forces=read_only(chosen.x[..., -1]),
        torsion=read_only(torsion),
        friction_use=read_only(use),
        binding=_binding(programs, fastest),
        reserve=reserve,
        duration=float(took.sum()),
        lower_bound=fastest.lower_bound,
        residual=chosen.residual,
        elapsed=elapsed,
        notes=notes,
    )


def _contact_torques(programs: Programs, chosen: Solved) -> Array:
    """J^T f of the robot's joints (N, n) [N m or N], the arm's left out."""
    problem, carried = programs.problem, programs.carried
    found = np.zeros((programs.count, carried.robot.n))
    contacts, widths = problem.contacts, problem.friction.scale(problem.mu)
    if problem.torques is None:
        J = torque_limits(carried.hand, contacts, carried.posture[carried.of_hand], limit=np.inf).jacobian
    else:
        J = problem.torques.jacobian
    local = np.concatenate([chosen.x[..., :2] * widths[:, :2], chosen.x[..., -1:]], axis=2)
    forces = np.einsum("kij,nkj->nki", contacts.rotations_oc, local)
    tau = np.einsum("kxj,nkx->nj", J[:, :3], forces)
    if problem.friction.d == 4:
        moments = np.einsum("nk,kx->nkx", chosen.x[..., 2] * widths[:, 2], contacts.rotations_oc[:, :, 2])
        tau += np.einsum("kxj,nkx->nj", J[:, 3:], moments)
    found[:, carried.of_hand] = tau
    return found


def _binding(programs: Programs, found: Solved) -> tuple[str, ...]:
    """What binds in each interval: the limit whose multiplier, over a relative change of it, is largest."""
    problem = programs.problem
    names = problem.contacts.names
    least, most = found.normals
    rows = np.abs(found.rows).sum(axis=0)
    with np.errstate(invalid="ignore"):
        size = np.maximum(np.abs(programs.matrices.R_lo), np.abs(programs.matrices.R_hi))
    size = np.where(np.isfinite(size), size, 0.0)
    torques = problem.torques
    hand = [] if torques is None or not len(programs.matrices.R) else [f"torque of {j}" for j in torques.limited_joints]
    hand += ["what the drives can make"] * (rows.shape[1] - len(hand))
    speeds = found.speeds * programs.top
    words = [
        *(f"friction of {name}" for name in names),
        *(f"largest force of {name}" for name in names),
        *(f"least force of {name}" for name in names),
        *hand,
        *programs.arm_words,
        "speed of the joints",
    ]
    values = np.concatenate(
        [
            found.cones * found.x[..., -1],
            most * programs.most,
            least * np.maximum(programs.least, 1e-3 * programs.most),
            rows * size,
            found.pairs,
            np.maximum(speeds[:-1], speeds[1:])[:, None],
        ],
        axis=1,
    )
    largest = values.argmax(axis=1)
    peak = values.max()
    return tuple(words[j] if values[i, j] > _BINDS * peak else "nothing" for i, j in enumerate(largest.tolist()))
