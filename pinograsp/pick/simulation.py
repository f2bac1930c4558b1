"""The whole of a pick in simulation: a free object, what it stands on, arm and hand by their own servos."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from pinograsp.carry.simulation import choose_servo
from pinograsp.checks import brief, each_of, instance_of
from pinograsp.contacts import law_of
from pinograsp.contacts.support_plane import SupportPlane
from pinograsp.errors import InvalidInput, SimulationDiverged
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.objects import Capsule, Cylinder, Sphere
from pinograsp.objects.body import Body
from pinograsp.pick.arm import Arm, Nearest
from pinograsp.pick.record import PickRecord
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.simulate import make_forces
from pinograsp.simulation.table import Table
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array, inverse_of, rotation_angle
from pinograsp.words import lines_of

_STEP = 5e-4  # [s]
_EVERY = 20  # steps between looks
_SETTLE = 0.5  # [s] after the motion
_LOST, _TURNED = 0.01, 10.0  # [m], [deg] from its place in the palm, or from where it is to be put
_BELOW = 1e-3  # [m] that an object comes below the plane that it is put on
_FASTEST = 1e3  # [m/s, rad/s]
_KNOWN = {
    "mu",
    "mass_factor",
    "stiffness",
    "object_offset",
    "object_turn",
    "joint_friction",
    "servo_gain",
    "drive_gain",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickSimulation:
    """The result of a simulated pick.

    Attributes:
        done: whether all phases succeeded.
        failed: the first failure: ``carry``: the object left its place in the hand; ``leave``: the object ended
            elsewhere; ``touched``: the robot or the object hit something; "": none.
        moved, turned: of the object in the palm while it was carried [m], [deg].
        off, off_angle: final distance and rotation from the target pose [m], [deg], for round objects that of their
            axis; None: it was only lifted.
        nearest: the pair that came nearest to each other, of robot, object and obstacles, and its distance [m].
        times: of the samples (m,) [s].
        q: joint positions (m, n).
        object_poses: of the object's frame (m, 4, 4).
        elapsed: computing time [s].
    """

    done: bool
    failed: str
    moved: float
    turned: float
    off: float | None
    off_angle: float | None
    nearest: Nearest
    times: Array
    q: Array
    object_poses: Array
    elapsed: float

    __repr__ = brief("done", "failed", "moved", "off", "nearest")

    def __str__(self) -> str:
        where = (
            ""
            if self.off is None or self.off_angle is None
            else f"put down {1e3 * self.off:.2g} mm and {self.off_angle:.2g} deg off"
        )
        return lines_of(
            "done" if self.done else f"not done: {self.failed}",
            f"moved by {1e3 * self.moved:.2g} mm and {self.turned:.2g} deg in the hand",
            where,
            f"nearest: {self.nearest.one} and {self.nearest.other}, {1e3 * self.nearest.spare:.2g} mm",
        )

    def tell(self) -> str:
        """The same in one line."""
        return "; ".join(line.strip() for line in str(self).splitlines())

    def summary(self) -> dict[str, Any]:
        """As plain JSON values, units in the names."""
        return {
            "done": self.done,
            "failed": self.failed,
            "moved_m": self.moved,
            "turned_deg": self.turned,
            "off_m": self.off,
            "off_deg": self.off_angle,
            "nearest": {"one": self.nearest.one, "other": self.nearest.other, "distance_m": self.nearest.spare},
        }


def simulate_pick(plan: PickRecord, *, disturbance: Disturbance | None = None) -> PickSimulation:
    """Simulate a pick with a free object, and judge each phase.

    The object stands on a plane at its start and at its target; contacts of the hand follow the grasp's law with
    friction (:mod:`pinograsp.simulation.law`); arm and hand have a servo at each joint, with the plan's torques as
    feed-forward. While the hand closes, its servos have the plan's ``closing_stiffness``. When the object is lifted,
    the fingers are held where they are, and keep that distance from their commands until they open. The simulation also
    measures the least distance of robot and object from obstacles.

    Args:
        plan: from :func:`~pinograsp.pick.plan_pick`.
        disturbance: differences from the plan: mu, mass_factor, stiffness, object_offset, object_turn, joint_friction,
            servo_gain and drive_gain.

    Raises:
        InvalidInput: not a pick plan, or another difference.
        SimulationDiverged: velocities beyond reason.
    """
    began = time.perf_counter()
    plan = instance_of("plan", plan, PickRecord)
    disturbance = Disturbance() if disturbance is None else instance_of("disturbance", disturbance, Disturbance)
    usual = Disturbance()
    for one in fields(Disturbance):
        if one.name not in _KNOWN and not np.array_equal(getattr(disturbance, one.name), getattr(usual, one.name)):
            raise InvalidInput(f"disturbance: expected some of {', '.join(sorted(_KNOWN))}, got {one.name}")
    with without_callbacks():
        world = _World(plan, disturbance)
        world.play()
    return _judge(plan, world, time.perf_counter() - began)


class _World:
    """Robot and object, stepped in time, and what was seen of them."""

    def __init__(self, plan: PickRecord, disturbance: Disturbance):
        self.plan, robot = plan, plan.robot
        body = plan.grasp.body
        assert body is not None
        self.way = plan.trajectory(rate=1.0 / _STEP)
        task = _task_of(plan, body)
        servo = choose_servo(plan.carry).scale_gains(disturbance.servo_gain).scale_gains(disturbance.drive_gain)
        self.engine = MujocoEngine(
            task,
            time_step=_STEP,
            servo=servo,
            mass_factor=disturbance.mass_factor,
            joint_friction=each_of("joint friction", disturbance.joint_friction, robot.n),
        )
        self.law = make_forces(task, self.engine.parts, disturbance)
        self.gain = each_of("drive gain", disturbance.drive_gain, robot.n)
        stands, pose = plan.body.shape_pose, np.array(plan.body.shape_pose)
        pose[:3, 3] += disturbance.object_offset
        pose[:3, :3] = pin.exp3(np.array(disturbance.object_turn)) @ pose[:3, :3]
        self.start, self.shape = pose, inverse_of(plan.body.pose) @ stands
        mass = disturbance.mass_factor * body.mass
        mu = float(plan.grasp.friction.mu.mean()) if disturbance.mu is None else disturbance.mu

        def table_under(at: Array) -> Table:
            return Table(body, at, plan.grasp.gravity_o, mass, mu, _STEP)

        self.tables = [table_under(stands), None if plan.place is None else table_under(plan.place @ self.shape)]
        self.change = _find_change(plan)
        ends = np.cumsum([phase.duration for phase in plan.phases])
        self.taken = round(ends[1] / _STEP)
        # Share of the fingers' distance from their commands that is left, by row of the way.
        opened = np.zeros(len(self.way.times))
        if plan.place is not None:
            opened = np.clip((self.way.times - ends[2]) / (ends[3] - ends[2]), 0.0, 1.0)
        self.left = (1.0 + np.cos(np.pi * opened)) / 2.0
        self.times, self.q, self.poses = list[float](), list[Array](), list[Array]()

    def play(self) -> None:
        """Send the plan's commands, and look at what comes."""
        engine, way = self.engine, self.way
        engine.place(way.q[0], way.dq[0], self.start)
        steps, moved = len(way.times) + round(_SETTLE / _STEP), engine.moved
        for i in range(steps):
            row = min(i, len(way.times) - 1)
            if i == self.taken:
                engine.stiffen(way.q[row])
                moved = engine.moved
            engine.moved = self.left[row] * moved
            touches = self.law.drop_shallower(engine.touches())
            pose, twist = engine.object_pose, engine.object_twist
            pressing = self.law.press(touches, _STEP, pose)
            table = self.tables[int(i * _STEP > self.change)]
            wrench = np.zeros(6) if table is None else table.wrench(pose, twist)
            if i % _EVERY == 0 or i == steps - 1:
                self.times.append(i * _STEP)
                self.q.append(engine.q)
                self.poses.append(pose @ inverse_of(self.shape))
            if not np.abs(engine.dq).max() < _FASTEST or not np.isfinite(twist).all():
                raise SimulationDiverged(i * _STEP, _STEP)
            engine.step(way.q[row], way.dq[row], self.gain * way.effort[row], touches, pressing, wrench)


def _find_change(plan: PickRecord) -> float:
    """When the plane where the object is put takes the place of the one where it was taken [s]: in the middle of the
    way, or when the object is above it; it is infinitely wide.
    """
    carry, grasp = plan.phases[2], plan.grasp
    begin = sum(phase.duration for phase in plan.phases[:2])
    change = carry.duration / 2.0
    if plan.place is not None:
        body, rows = grasp.body, np.flatnonzero(carry.times >= change)
        assert body is not None
        first, *palms = plan.robot.frame_placements(carry.q[[0, *rows]], [plan.robot.palm])[:, 0]

        def lowest(pose: Array) -> float:
            return SupportPlane.under(body.placed(pose), grasp.gravity_o).height

        plane = lowest(plan.place @ inverse_of(plan.body.pose) @ body.pose)
        low = [lowest(palm @ inverse_of(first) @ body.pose) < plane - _BELOW for palm in palms]
        change = max([change, *carry.times[rows[low]].tolist()])
    return float(begin + change)


def _task_of(plan: PickRecord, body: Body) -> Task:
    """What the engine and the law of contacts ask for."""
    grasp, robot, way = plan.grasp, plan.robot, plan.phases[0]
    forces = grasp.forces
    return Task(
        hand=robot,
        body=body,
        times=way.times,
        q=way.q,
        dq=way.dq,
        torques=way.torques,
        holding_torques=way.torques[-1],
        torque_limit=np.where(robot.effort > 0, robot.effort, np.inf),
        impact_time=forces.impact_time,
        final_time=forces.final_time,
        names=grasp.contacts.names,
        links=grasp.contacts.links,
        points_o=grasp.contacts.points_o,
        rotations_oc=grasp.contacts.rotations_oc,
        com_o=grasp.contacts.com_o,
        forces_o=grasp.motion.forces_o[-1],
        normal_forces=forces.normal_forces,
        settled_forces=forces.normal_forces,
        depths=law_of(grasp.law).depth(forces.normal_forces),
        mu=grasp.friction.mu,
        torsion=grasp.friction.torsion,
        law=grasp.law,
        load=np.zeros(6),
        gravity_o=grasp.gravity_o,
        carrier=robot.palm,
    )


def _find_nearest(plan: PickRecord, world: _World, spans: dict[str, tuple[float, float]]) -> Nearest:
    """What came nearest of all that is not to touch."""
    least = Nearest(math.inf, "", "")
    times, poses = np.array(world.times), np.array(world.poses)
    supports = plan.find_supports()
    for name, (first, last) in spans.items():
        seen = np.flatnonzero((times >= first) & (times <= last))
        if not len(seen):
            continue
        body = plan.body.placed(poses[seen[0]])
        arm = Arm(plan.robot, world.q[seen[0]], plan.scene, body, "held" if name == "carry" else "free", supports)
        found = [arm.find_apart(world.q[i][arm.dofs]) for i in seen]
        least = min(least, *found, key=lambda one: one.spare)
    return least


def _judge(plan: PickRecord, world: _World, elapsed: float) -> PickSimulation:
    times, poses, q = np.array(world.times), np.array(world.poses), np.array(world.q)
    bounds = np.cumsum([0.0, *(phase.duration for phase in plan.phases)])
    spans = dict(zip((phase.name for phase in plan.phases), pairwise(bounds)))
    palms = plan.robot.frame_placements(q, [plan.robot.palm])[:, 0]
    held = np.flatnonzero((times >= spans["carry"][0]) & (times <= spans["carry"][1]))
    within = np.array([inverse_of(palms[i]) @ poses[i] for i in held])
    moved, turned = (np.array(one) for one in zip(*(_apart(within[0], one) for one in within)))
    off = off_angle = None
    rolls = isinstance(plan.body, Sphere)  # nobody sees it
    failed = "carry" if moved.max() > _LOST or (turned.max() > _TURNED and not rolls) else ""
    if plan.place is not None:
        off, off_angle = _apart(plan.place, poses[-1])
        if isinstance(plan.body, Sphere | Cylinder | Capsule):  # nobody sees it turn about its axis
            off_angle = 0.0 if isinstance(plan.body, Sphere) else _tilt(plan, poses[-1])
        if not failed and (off > _LOST or off_angle > _TURNED):
            failed = "leave"
    elif not failed and (off_end := _apart(within[0], inverse_of(palms[-1]) @ poses[-1]))[0] > _LOST:
        failed, moved = "carry", np.append(moved, off_end[0])
    nearest = _find_nearest(plan, world, spans)
    if not failed and nearest.spare < 0:
        failed = "touched"
    return PickSimulation(
        done=not failed,
        failed=failed,
        moved=float(moved.max()),
        turned=float(turned.max()),
        off=off,
        off_angle=off_angle,
        nearest=nearest,
        times=times,
        q=q,
        object_poses=poses,
        elapsed=elapsed,
    )


def _tilt(plan: PickRecord, pose: Array) -> float:
    """Angle [deg] of a round object's axis from where it was to be put."""
    assert plan.place is not None
    axis = (inverse_of(plan.body.pose) @ plan.body.shape_pose)[:3, 2]
    cosine = float((plan.place[:3, :3] @ axis) @ (pose[:3, :3] @ axis))
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


def _apart(one: Array, other: Array) -> tuple[float, float]:
    """Distance [m] and angle [deg] between two poses (4, 4)."""
    turn = rotation_angle(one[:3, :3].T @ other[:3, :3])
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), math.degrees(turn)
