"""Carrying in simulation: arm, hand and a free object, along the whole path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.loads import LoadedRobot
from pinograsp.checks import instance_of
from pinograsp.contacts import law_of
from pinograsp.handover import JointTrajectory
from pinograsp.hands.servos import GIVES, QUICKEST, find_pressing
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.plan import Simulation
from pinograsp.simulation import Servo, simulate
from pinograsp.simulation.options import SimulationSettings
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array

if TYPE_CHECKING:
    from typing_extensions import Unpack

_STEP = 2e-3  # [s] of the commands
_CHANGE = 0.15  # [s] from the grasp's squeeze to the first one of the way
_SETTLE = 0.05  # [s] between letting go and setting off
LETTING_GO = 0.2  # [s]
_POSTURES = 9  # on the way, at which the arm's inertia is looked at


def simulate_carry(
    plan: CarryPlan, *, disturbance: Disturbance | None = None, **settings: Unpack[SimulationSettings]
) -> Simulation:
    """Simulate a carry plan, and judge whether the object stays in the hand.

    At the start of the path the hand closes on the fixed object, as in the grasp's own plan. Its squeeze changes to the
    first one of the path, the object is let go, and the arm moves along the path; then it holds still. The object
    counts as held if it stays with the palm and comes to rest.

    Args:
        plan: from :func:`~pinograsp.carry.plan_carry`.
        disturbance: differences from the plan.
        settings: as for :func:`~pinograsp.simulation.simulate`. The default servos are those of the hand's description;
            joints of an arm without servos give way by 0.03 rad or m under their largest torque.

    Raises:
        InvalidInput: not a carry plan, or unusable settings. ExtraMissing, SimulationDiverged: as there.
    """
    instance_of("plan", plan, CarryPlan)
    chosen: SimulationSettings = {"letting_go": LETTING_GO, **settings}
    if chosen.get("servo") is None:
        chosen["servo"] = choose_servo(plan)
    task = build_simulation_task(plan, chosen["letting_go"])
    seen = simulate(task, disturbance=disturbance, **chosen)
    off = float(task.times[-1]) - plan.duration
    return replace(seen, notes=(*seen.notes, f"carried along the path from {off:.3f} to {task.times[-1]:.3f} s"))


def choose_servo(plan: CarryPlan) -> Servo:
    """The hand's servos, soft while it closes as its plan has them, and for joints of the arm without any stiff ones,
    damped critically on the way.

    What a joint moves when all others give way is less than what it moves when they do not, by far where axes are
    nearly in line; more damping than for that would need shorter steps than the contacts do.
    """
    robot, own = plan.robot, Servo.of(plan.robot)
    arm = LoadedRobot.carry(robot, plan.grasp).arm
    bare = arm[np.isnan(robot.servo_stiffness[arm]) & (robot.effort[arm] > 0)]
    stiffness, damping = np.array(own.stiffness), np.array(own.damping)
    least = np.full(robot.n, np.inf)
    for q in plan.q[np.linspace(0, len(plan.q) - 1, _POSTURES).astype(int)]:
        mass = robot.joint_inertia(q) + np.diag(own.rotor - robot.model.armature)
        least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(mass)))
    stiffness[bare] = np.minimum(robot.effort / GIVES, QUICKEST**2 * least)[bare]
    damping[bare] = 2.0 * np.sqrt(stiffness * least)[bare]
    servo = Servo(
        stiffness=stiffness, damping=damping, rotor=own.rotor, control=own.control, pressing=find_pressing(robot)
    )
    if (soft := plan.closing_stiffness) is None:
        return servo
    return replace(servo, closing=np.array([soft.get(name, k) for name, k in zip(robot.joint_names, stiffness)]))


class ClosingPhase(NamedTuple):
    """How a robot closes its hand at the start of a carry plan's way, up to the first squeeze of it.

    Times (m,) [s], positions, speeds and torques (m, n); ``moved`` (4, 4): from the axes of the grasp to where the
    object is then, which the palm has turned.
    """

    times: Array
    q: Array
    dq: Array
    torques: Array
    moved: Array


def close_for_way(plan: CarryPlan, way: JointTrajectory) -> ClosingPhase:
    """The closing of a carry plan's hand, then the change to the first squeeze of its ``way``."""
    robot, grasp, carried = plan.robot, plan.grasp, LoadedRobot.carry(plan.robot, plan.grasp)
    motion, start = plan.closing, np.array(way.q[0])
    start[carried.fingers] = motion.q[-1][carried.finger_dofs]
    moved = carried.axes(start[None])[0]
    # Closing: the fingers' motion, with the contacts' torques of the grasp.
    q, dq, ddq = np.tile(start, (len(motion.times), 1)), *np.zeros((2, len(motion.times), robot.n))
    for own, grasped in ((q, motion.q), (dq, motion.dq), (ddq, motion.ddq)):
        own[:, carried.fingers] = grasped[:, carried.finger_dofs]
    # In the grasp's axes gravity pulls as the palm lies now, where the motion was planned for that.
    gravity = grasp.gravity_o if motion is grasp.motion else moved[:3, :3].T @ plan.gravity_o
    bare = inverse_dynamics(grasp.hand, motion.q, motion.dq, motion.ddq, gravity_o=gravity)
    torques = inverse_dynamics(robot, q, dq, ddq, gravity_o=plan.gravity_o)
    torques[:, carried.fingers] += (motion.torques - bare)[:, carried.finger_dofs]
    # Then the first squeeze of the way, the arm bearing the object as it is let go.
    change = np.linspace(0.0, 1.0, max(2, round(_CHANGE / _STEP)) + 1)[1:]
    blend, rise = (1.0 - np.cos(np.pi * change)) / 2.0, np.pi / 2.0 * np.sin(np.pi * change) / _CHANGE
    shift = way.q[0] - q[-1]
    presses = np.isin(np.arange(robot.n), carried.fingers)
    squeezed = torques[-1] + blend[:, None] * (way.effort[0] - torques[-1]) * presses
    return ClosingPhase(
        times=np.concatenate([motion.times, float(motion.times[-1]) + change * _CHANGE]),
        q=np.concatenate([q, q[-1] + blend[:, None] * shift]),
        dq=np.concatenate([dq, rise[:, None] * shift]),
        torques=np.concatenate([torques, squeezed]),
        moved=moved,
    )


def build_simulation_task(plan: CarryPlan, letting_go: float) -> Task:
    """The task of a carry plan: closing, letting go for a time [s], the way."""
    robot, grasp, carried = plan.robot, plan.grasp, LoadedRobot.carry(plan.robot, plan.grasp)
    way = plan.trajectory(rate=1.0 / _STEP)
    closing = close_for_way(plan, way)
    turn = closing.moved[:3, :3]
    release = float(closing.times[-1])
    off = release + letting_go + _SETTLE
    # During letting go: a sample at its end is enough, torques in between are linear.
    forces = plan.forces_o[-1] @ turn.T
    return Task(
        hand=robot,
        body=carried.body.placed(closing.moved @ carried.body.pose),
        times=np.concatenate([closing.times, off + way.times]),
        q=np.concatenate([closing.q, way.q]),
        dq=np.concatenate([closing.dq, way.dq]),
        torques=np.concatenate([closing.torques, way.effort]),
        holding_torques=way.effort[-1],
        torque_limit=np.where(robot.effort > 0, robot.effort, np.inf),
        impact_time=float(plan.closing.times[plan.closing.impact]),
        final_time=release,
        names=plan.contacts,
        links=grasp.contacts.links,
        points_o=grasp.contacts.points_o @ turn.T + closing.moved[:3, 3],
        rotations_oc=turn @ grasp.contacts.rotations_oc,
        com_o=turn @ grasp.contacts.com_o + closing.moved[:3, 3],
        forces_o=forces,
        normal_forces=plan.normal_forces[-1],
        settled_forces=plan.normal_forces[-1],
        depths=law_of(grasp.law).depth(np.maximum(plan.normal_forces[-1], 0.0)),
        mu=grasp.friction.mu,
        torsion=grasp.friction.torsion,
        law=grasp.law,
        load=np.zeros(6),
        gravity_o=plan.gravity_o,
        carrier=grasp.hand.palm,
    )
