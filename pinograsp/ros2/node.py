"""The node: what it subscribes to, what it publishes, and when."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from pinograsp.errors import InvalidInput
from pinograsp.plan.felt import Felt, Measured
from pinograsp.planner import GraspPlan
from pinograsp.ros2.course import Approach, Hold, Sent
from pinograsp.ros2.messages import JointReader, Told, read_numbers, read_vector, read_wrench
from pinograsp.ros2.parameters import PARAMETERS, Parameters
from pinograsp.spatial import Array

_PATIENCE = {"hold": 2.0, "play": 5.0}  # [s] in which what a start needs has to come
_OLDEST, _AHEAD = 1.0, 0.1  # [s] that stamps may be behind and ahead of the node's clock
_BEYOND = 1.05  # times a torque limit: what is measured above that is in other units


class GripNode:
    """Plays a plan's trajectory, holds the object, or both.

    Its ticks, and the times of measurements, are on one clock: a steady one, which no setting of the machine's time
    moves; simulated time with ``use_sim_time``. A message's stamp tells its age on the clock of ROS, which is then
    counted back on the steady one; without a stamp (0) it was measured when it came.

    Args:
        plan: whose grasp is held.
        plays: whether its trajectory is sent first.
        reflex: whether the controller follows what is felt; else the plan's last command stays.

    Raises:
        InvalidInput: parameters that cannot be used. ExtraMissing: the compiled core is not installed.
    """

    def __init__(self, plan: GraspPlan, *, plays: bool, reflex: bool):
        import rclpy
        from rcl_interfaces.msg import ParameterDescriptor
        from rclpy.clock import Clock, ClockType

        self.plan, self.plays, self.error = plan, plays, ""
        self.node: Any = rclpy.create_node("pinograsp")
        try:
            given = {
                name: self.node.declare_parameter(
                    name, default, ParameterDescriptor(description=text, read_only=True, dynamic_typing=True)
                ).value
                for name, (default, text) in PARAMETERS.items()
            }
            self.parameters = parameters = Parameters.of(given, plan)
            self.hold: Hold | None = None
            if reflex:
                controller = plan.grip_controller(**parameters.settings)
                self.hold = Hold(plan, controller, parameters.start_time, parameters.stiffness is not None)
        except InvalidInput:
            self.node.destroy_node()
            raise
        self.approach: Approach | None = None
        self.log, self._ros_clock = self.node.get_logger(), self.node.get_clock()
        simulated = self.node.get_parameter("use_sim_time").value
        self._clock = self._ros_clock if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._told = Told(self.log.warning)
        self._joints = JointReader(plan.hand.joint_names)
        self._new: dict[str, Measured] = {}
        self._counts: dict[str, int] = {}
        self._positions: Array | None = None
        self._efforts: Array | None = None
        self._last = self._looked = -math.inf
        self._begun: float | None = None
        self._holding = False
        self._patience = _PATIENCE["play" if plays else "hold"]
        self._ticks = 0
        self._subscribe()
        self._advertise()
        self.node.create_timer(1.0 / parameters.rate, self._tick, clock=self._clock)
        self.node.create_timer(1.0, self._tell, clock=self._clock)

    @property
    def now(self) -> float:
        """On the clock of the ticks [s]."""
        return float(self._clock.now().nanoseconds) * 1e-9

    # -- what is sensed ------------------------------------------------------------------------------------------------

    def _subscribe(self) -> None:
        from geometry_msgs.msg import AccelStamped, WrenchStamped
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        k = len(self.plan.contacts.names)
        topics: list[tuple[str, Any, Callable[[Any], Array]]] = [
            ("forces", Float64MultiArray, partial(read_numbers, shape=(k, 3))),
            ("normal_forces", Float64MultiArray, partial(read_numbers, shape=(k,))),
            ("slips", Float64MultiArray, partial(read_numbers, shape=(k,))),
            ("wrench", WrenchStamped, self._read_wrench),
            ("acceleration", AccelStamped, lambda message: read_vector(message.accel.linear)),
        ]
        for topic, kind, read in topics:
            self.node.create_subscription(kind, topic, partial(self._feel, topic, read), qos_profile_sensor_data)
        self.node.create_subscription(JointState, "joint_states", self._feel_joints, qos_profile_sensor_data)

    def _read_wrench(self, message: Any) -> Array:
        wrench = read_wrench(message, self.parameters.sensor_pose, self.plan.contacts.com_o)
        return self.parameters.wrench_sign * wrench

    def _feel(self, topic: str, read: Callable[[Any], Array], message: Any) -> None:
        try:
            self._put(topic, read(message), message)
        except InvalidInput as error:
            self._told.leave_out(topic, error)

    def _feel_joints(self, message: Any) -> None:
        try:
            positions = self._joints.read("position", message)
            self._positions = self._positions if positions is None else positions
        except InvalidInput as error:
            self._told.leave_out("joint_states", error)
            return
        try:
            efforts = self._joints.read("effort", message)
            if efforts is None:
                return
            if not efforts.any():  # as drivers write that measure none
                raise InvalidInput("effort: expected measured values, got only zeros")
            self._efforts = self.parameters.effort_scale * efforts
            self._put("torques", self._efforts, message)
        except InvalidInput as error:
            self._told.leave_out("joint_states", error)

    def _put(self, name: str, value: Array, message: Any) -> None:
        """A measurement for the next tick; :class:`InvalidInput` for a stamp of another time."""
        header, age = getattr(message, "header", None), 0.0
        if header is not None and (header.stamp.sec or header.stamp.nanosec):
            stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
            age = (self._ros_clock.now().nanoseconds - stamp) * 1e-9
            if not -_AHEAD <= age <= _OLDEST:
                raise InvalidInput(
                    f"stamp: expected at most {_OLDEST:g} s before and {_AHEAD:g} s after the node's time, got "
                    f"{abs(age):.3g} s {'before' if age > 0 else 'after'} it: set the clocks, or send a stamp of 0"
                )
        now = self.now
        self._new[name] = Measured(value, now - max(age, 0.0))
        self._counts[name] = self._counts.get(name, 0) + 1

    # -- what is sent --------------------------------------------------------------------------------------------------

    def _advertise(self) -> None:
        from std_msgs.msg import Float64MultiArray, String
        from trajectory_msgs.msg import JointTrajectory

        arrays = self.parameters.message == "array"
        self._topic = "commands" if arrays else "joint_trajectory"
        self._ahead = divmod(round(1e9 / self.parameters.rate), 1_000_000_000)  # a period [s, ns]
        self._commands = self.node.create_publisher(
            Float64MultiArray if arrays else JointTrajectory, self._topic, 1
        )  # reliable
        self._status = self.node.create_publisher(String, "~/status", 1)

    def _tick(self) -> None:
        now = self.now
        if now < self._last:  # a simulation has begun again
            self.log.warning("time has gone back: measurements are forgotten")
            self._begun, self._holding, self._looked = None, False, -math.inf
            self._positions = self._efforts = None
            self._new.clear()
        self._last = now
        self._ticks += 1
        if self._begun is None and not self._begin(now):
            return
        since = now - (self._begun or 0.0)
        if self.approach is not None and not self._holding:
            sent = self.approach.at(since)
            self._holding = since >= self.approach.duration and self.hold is not None
            if self._holding and self.hold is not None:
                self.hold.begin(now, None)  # from the plan's last command
        elif self.hold is not None:
            felt = Felt(time=now, **self._new)
            self._new.clear()
            sent = self.hold.at(felt)
        self._send(sent)

    def _begin(self, now: float) -> bool:
        """Whether there is what a start needs: joints that are felt, and of a trajectory somebody who takes it."""
        if self._looked == -math.inf:
            self._looked = now
        late = now - self._looked > self._patience
        if self.plays:
            listens = self._commands.get_subscription_count() > 0
            if self._positions is None or not listens:
                if late:
                    topic, what = (
                        ("joint_states", "positions of the hand's joints")
                        if self._positions is None
                        else (self._topic, "a controller that receives commands")
                    )
                    self.error = (
                        f"{self.node.resolve_topic_name(topic)}: expected {what}, got none in {self._patience:g} s"
                    )
                return False
            try:
                self.approach = Approach(self.plan, self.parameters.rate, self._positions, self.parameters.stiffness)
            except InvalidInput as error:
                self.error = str(error)
                return False
            self.log.info(f"plays for {self.approach.duration:.3g} s from the hand's present posture")
            now = self.now  # the trajectory took its time to make
        elif self.hold is not None:
            if self._efforts is None and not late:
                return False
            self.hold.begin(now, self._usable_efforts())
            self._holding = True
        self._begun = now
        return True

    def _usable_efforts(self) -> Array | None:
        """Measured efforts to start from."""
        if self._efforts is None:
            self.log.warning(
                f"joint_states: no efforts in {self._patience:g} s, starts from the plan's holding torques"
            )
            return None
        if np.any(np.abs(self._efforts) > _BEYOND * self.plan.torque_limit):
            self.log.warning(
                "joint_states: efforts above the joints' limits, starts from the plan's holding torques: see the "
                "parameter effort_scale"
            )
            return None
        return self._efforts

    def _send(self, sent: Sent) -> None:
        parameters = self.parameters
        positions, places = sent.positions, parameters.places
        if parameters.message == "array":
            from std_msgs.msg import Float64MultiArray

            values = sent.efforts if parameters.interface == "effort" else positions
            message = Float64MultiArray(data=array("d", values[places].tolist()))
        else:
            from builtin_interfaces.msg import Duration
            from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

            point = JointTrajectoryPoint(
                positions=array("d", positions[places].tolist()),
                time_from_start=Duration(sec=self._ahead[0], nanosec=self._ahead[1]),
            )
            if parameters.interface == "effort":
                point.effort = array("d", sent.efforts[places].tolist())
            message = JointTrajectory(joint_names=list(parameters.joints), points=[point])
        self._commands.publish(message)

    # -- what is told --------------------------------------------------------------------------------------------------

    def _tell(self) -> None:
        """A line of the log, and the same as JSON."""
        from std_msgs.msg import String

        ticks, self._ticks = self._ticks, 0
        counts, self._counts = self._counts, {}
        told: dict[str, Any] = {
            "phase": "waiting" if self._begun is None else "hold" if self._holding else "play",
            "rate": ticks,
            "felt": counts,
            "left_out": self._told.counts,
            "listeners": self._commands.get_subscription_count(),
        }
        line = f"{told['phase']} at {ticks} Hz"
        if self.hold is not None and self._holding:
            grip = self.hold.controller
            slipping = [name for name, slips in zip(self.plan.contacts.names, grip.slipping) if slips]
            told |= {
                "status": str(grip.status),
                "squeeze_N": round(float(grip.forces[:, 2].sum()), 3),
                "load_N": round(float(np.linalg.norm(grip.load[:3])), 3),
                "slipping": slipping,
                "reflexes": grip.reflexes,
                "blind": grip.blind,
            }
            line += f", squeeze {told['squeeze_N']} N, load {told['load_N']} N, {grip.reflexes} reflexes"
            line += f", slips at {', '.join(slipping)}" if slipping else ""
            line += ", no measurements" if grip.blind else ""
        line += "" if told["listeners"] else f", no subscriber on {self.node.resolve_topic_name(self._topic)}"
        self.log.info(line)
        self._status.publish(String(data=json.dumps(told)))
