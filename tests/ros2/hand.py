"""A hand in MuJoCo, in real time, with the topics of a robot: run by the tests of ros2 in a process of its own.

    python hand.py RUN SCENE RESULT --seconds 5 [--mode ros|alone|constant] ...

The scene is that of ``plan.to_mujoco(scene=True)``, of ``torque`` or ``position`` commands. By --mode its drives follow
messages, the plan's controller called here, or the last command of the plan. RESULT gets a JSON object.
"""

from __future__ import annotations

import argparse
import json
import time

import mujoco
import numpy as np

from pinograsp.plan.felt import Felt, Measured
from pinograsp.planner import load_run

SLIPS = 2e-3  # [m/s] that a sensor of slip tells
FADING = 0.1  # [s] in which the support lets go
LATENCY = 0.03  # [s] that the controller is told
PAUSE = 0.3  # [s] without commands that is told


class Hand:
    """The simulated hand.

    Attributes:
        sent: what the drives follow (n,).
    """

    def __init__(self, plan, scene, interface, stiffness, start):
        self.plan, self.interface = plan, interface
        self.model = mujoco.MjModel.from_xml_path(scene)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key(start).id)
        model, names = self.model, plan.hand.joint_names
        self.joints = [model.joint(name) for name in names]
        self.qpos = [int(joint.qposadr[0]) for joint in self.joints]
        self.dofs = [int(joint.dofadr[0]) for joint in self.joints]
        self.object = model.body("object").id
        # An actuator for each joint, which is geared as its drive.
        self.drives = [int(np.flatnonzero(model.actuator_trnid[:, 0] == joint.id)[0]) for joint in self.joints]
        self.gear = model.actuator_gear[self.drives, 0]
        # Contacts by the body of the finger's link: in the order of the plan.
        self.links = [self._body_of(point) for point in plan.contacts.points_o]
        self.rotations = plan.contacts.rotations_oc
        self.stiffness = stiffness
        holding = plan.motion.holding_torques
        self.sent = holding if interface == "effort" else plan.motion.q[-1] + holding / (stiffness or 1.0)
        self.following = start == "grasp"
        mujoco.mj_forward(model, self.data)
        self.support = [i for i in range(model.nu) if model.actuator(i).name.startswith("support")]
        self.start = self.data.xpos[self.object].copy()
        self.farthest = 0.0

    def _body_of(self, point):
        """The body whose geometry is nearest a contact's point."""
        data, model, best = mujoco.MjData(self.model), self.model, (np.inf, -1)
        mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
        mujoco.mj_forward(model, data)
        own = [g for g in range(model.ngeom) if model.geom_bodyid[g] not in (0, self.object)]
        for contact in data.contact:
            for geom in contact.geom:
                if geom in own:
                    best = min(best, (float(np.linalg.norm(contact.pos - point)), int(model.geom_bodyid[geom])))
        return best[1]

    def step(self, seconds, supported):
        """Go on by some time, the support's control being ``supported``."""
        data = self.data
        for _ in range(max(1, round(seconds / self.model.opt.timestep))):
            if self.following:
                data.ctrl[self.drives] = self.sent / self.gear if self.interface == "effort" else self.sent * self.gear
            data.ctrl[self.support] = supported
            mujoco.mj_step(self.model, data)
        self.farthest = max(self.farthest, float(np.linalg.norm(data.xpos[self.object] - self.start)))

    @property
    def q(self):
        return self.data.qpos[self.qpos].copy()

    @property
    def torques(self):
        return self.data.qfrc_actuator[self.dofs].copy()

    def feel(self):
        """Forces on the object (k, 3) in the contacts' axes, and slips (k,)."""
        model, data, k = self.model, self.data, len(self.links)
        forces, slips, wrench = np.zeros((k, 3)), np.zeros(k), np.zeros(6)
        twist = np.zeros(6)
        for c, contact in enumerate(data.contact):
            bodies = [int(model.geom_bodyid[geom]) for geom in contact.geom]
            if self.object not in bodies:
                continue
            mujoco.mj_contactForce(model, data, c, wrench)
            frame = contact.frame.reshape(3, 3)
            force = frame.T @ wrench[:3] * (1.0 if bodies[1] == self.object else -1.0)
            other = bodies[0] if bodies[1] == self.object else bodies[1]
            speeds = []
            for body in (self.object, other):
                mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, twist, 0)
                speeds.append(twist[3:] + np.cross(twist[:3], contact.pos - data.xpos[body]))
            along = frame[1:] @ (speeds[0] - speeds[1])
            those = [i for i in range(k) if self.links[i] == other]
            if not those:
                continue
            nearest = min(those, key=lambda i: np.linalg.norm(self.plan.contacts.points_o[i] - contact.pos))
            forces[nearest] += self.rotations[nearest].T @ force
            if wrench[0] > 0.05 and np.linalg.norm(along) > SLIPS:
                slips[nearest] = max(slips[nearest], np.linalg.norm(along))
        return forces, slips


class Topics:
    """The hand's topics: what it senses, with every ``loss``-th message lost, and what it is sent."""

    def __init__(self, hand, message, loss, seed):
        import rclpy
        from rclpy.qos import QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        rclpy.init(args=[])
        self.rclpy, self.hand, self.loss, self.rng = rclpy, hand, loss, np.random.default_rng(seed)
        self.node = rclpy.create_node("hand")
        self.joints = self.node.create_publisher(JointState, "joint_states", qos_profile_sensor_data)
        self.forces, self.slips = (
            self.node.create_publisher(Float64MultiArray, name, qos_profile_sensor_data) for name in ("forces", "slips")
        )
        kind, topic = (Float64MultiArray, "commands") if message == "array" else (JointTrajectory, "joint_trajectory")
        self.node.create_subscription(kind, topic, self.take, QoSProfile(depth=1))
        self.state, self.array = JointState(name=list(hand.plan.hand.joint_names)), Float64MultiArray
        self.executor = rclpy.executors.SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.received = []
        self.pauses = []  # before the first command after a while: how long, and by how much it differs

    def take(self, message):
        if self.rng.random() < self.loss:
            return
        if hasattr(message, "points"):
            point = message.points[0]
            values = point.effort if self.hand.interface == "effort" else point.positions
        else:
            values = message.data
        values = np.array(values)
        now = time.perf_counter()
        if self.received and now - self.received[-1] > PAUSE:
            self.pauses.append((now - self.received[-1], float(np.abs(values - self.hand.sent).max())))
        self.received.append(now)
        self.hand.sent, self.hand.following = values, True

    def tell(self, senses):
        if self.rng.random() < self.loss:
            return
        forces, slips = self.hand.feel()
        if "joints" in senses:
            self.state.header.stamp = self.node.get_clock().now().to_msg()
            self.state.position, self.state.effort = self.hand.q.tolist(), self.hand.torques.tolist()
            self.joints.publish(self.state)
        if "forces" in senses:
            self.forces.publish(self.array(data=forces.ravel().tolist()))
        if "slips" in senses:
            self.slips.publish(self.array(data=slips.tolist()))

    def spin(self, seconds):
        """Take the newest command, then wait."""
        end = time.perf_counter() + seconds
        self.executor.spin_once(timeout_sec=0.0)
        time.sleep(max(0.0, end - time.perf_counter()))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("run")
    parser.add_argument("scene")
    parser.add_argument("result")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--mode", choices=("ros", "alone", "constant"), default="ros")
    parser.add_argument("--interface", choices=("effort", "position"), default="effort")
    parser.add_argument("--message", choices=("array", "trajectory"), default="array")
    parser.add_argument("--stiffness", type=float)
    parser.add_argument("--start", choices=("start", "grasp"), default="grasp")
    parser.add_argument(
        "--release", type=float, default=1.0, help="when the support lets go [s after the first command]"
    )
    parser.add_argument("--senses", nargs="+", default=["joints", "forces", "slips"])
    parser.add_argument("--period", type=float, default=0.004)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--mu", type=float)
    parser.add_argument("--mass", type=float, default=1.0, help="times the planned one")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()

    plan = load_run(arguments.run)
    hand = Hand(plan, arguments.scene, arguments.interface, arguments.stiffness, arguments.start)
    if arguments.mu is not None:
        hand.model.geom_friction[:, 0] = arguments.mu
    hand.model.body_mass[hand.object] *= arguments.mass
    hand.model.body_inertia[hand.object] *= arguments.mass
    topics = Topics(hand, arguments.message, arguments.loss, arguments.seed) if arguments.mode == "ros" else None
    controller = plan.grip_controller(latency=LATENCY, period=arguments.period, stiffness=arguments.stiffness)
    hand.following |= topics is None
    begun = time.perf_counter()
    first, behind = (0.0 if topics is None else None), 0.0
    for tick in range(10**9):
        now = tick * arguments.period
        if topics is not None and first is None and topics.received:
            first = now
        since = -1.0 if first is None else now - first
        if since > arguments.seconds or now > arguments.seconds + 120.0:
            break
        supported = 1.0 if since < 0 else float(np.clip(1.0 - (since - arguments.release) / FADING, 0.0, 1.0))
        if supported > 0.0:
            hand.farthest = 0.0
            hand.start = hand.data.xpos[hand.object].copy()
        hand.step(arguments.period, supported)
        if topics is not None:
            topics.tell(arguments.senses)
            ahead = begun + now + arguments.period - time.perf_counter()
            behind = max(behind, -ahead)
            topics.spin(max(0.0, ahead))
        elif arguments.mode == "alone":
            forces, slips = hand.feel()
            felt = {
                "torques": hand.torques if "joints" in arguments.senses else None,
                "forces": forces if "forces" in arguments.senses else None,
                "slips": slips if "slips" in arguments.senses else None,
            }
            told = {name: Measured(value, now) for name, value in felt.items() if value is not None}
            command = controller.step(Felt(time=now, **told))
            hand.sent = np.array(command.torques if arguments.interface == "effort" else command.references)
    forces, slips = hand.feel()
    result = {
        "moved": hand.farthest,
        "squeeze": float(forces[:, 2].sum()),
        "sent": hand.sent.tolist(),
        "behind": behind,
        "received": 0 if topics is None else len(topics.received),
        "pauses": [] if topics is None else topics.pauses,
    }
    with open(arguments.result, "w", encoding="utf-8") as file:
        json.dump(result, file)


if __name__ == "__main__":
    main()
