"""The parameters of the node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pinograsp.checks import each_of, items_of, number, one_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.planner import GraspPlan
from pinograsp.reflex import GripSettings
from pinograsp.spatial import Array, pose_of, rotation_rpy

INTERFACES = ("effort", "position")
MESSAGES = ("array", "trajectory")
ACTS_ON = ("hand", "object")
# Name -> default, what it is. None: not given.
PARAMETERS: dict[str, tuple[Any, str]] = {
    "rate": (500.0, "rate of the commands [Hz]"),
    "interface": ("effort", "what is commanded: effort (torques) or position (references of position servos)"),
    "message": ("array", "array (std_msgs/Float64MultiArray) or trajectory (trajectory_msgs/JointTrajectory)"),
    "joints": (None, "names of the controller's joints, in its order; default: the plan's"),
    "stiffness": (None, "stiffness of the position servos, one number or one per joint of the plan [N m/rad or N/m]"),
    "effort_scale": (1.0, "efforts per unit of joint_states, one number or one per joint of the plan"),
    "sensor_pose": ([0.0] * 6, "pose of the wrist's sensor in the plan's world: x, y, z, roll, pitch, yaw [m, rad]"),
    "wrench_acts_on": ("hand", "whether the wrench acts on the hand (the object's pull) or on the object"),
    "start_time": (0.5, "time in which a hold changes from the measured efforts to its own [s]"),
    "latency": (0.03, "latency of sensors and drives together [s]"),
    "max_normal_force": (None, "cap of the normal forces, one number or one per contact [N]; default: the plan's"),
    "noise": (0.1, "standard deviation of measured forces, as a share of them"),
    "margin": (1.25, "safety factor: friction is used up to the estimate divided by it"),
    "kept": (0.45, "share of the planned squeeze that is kept"),
    "release": (0.4, "time in which the squeeze falls to 1/e [s]"),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parameters:
    """What the node is told.

    Attributes:
        rate: of the commands [Hz].
        interface: effort or position.
        message: array or trajectory.
        joints: names of the controller's joints, in its order (c,).
        places: of these among the plan's joints (c,).
        stiffness: of the joints' position servos (n,) [N m/rad or N/m]; None: torques are commanded.
        effort_scale: efforts per unit of what is measured (n,).
        sensor_pose: of the wrist's sensor in the plan's world (4, 4).
        wrench_sign: 1 where the wrench acts on the object, -1 where it acts on the hand.
        start_time: in which a hold goes over from measured efforts to its own [s].
        settings: of the controller.
    """

    rate: float
    interface: str
    message: str
    joints: tuple[str, ...]
    places: list[int]
    stiffness: Array | None
    effort_scale: Array
    sensor_pose: Array
    wrench_sign: float
    start_time: float
    settings: GripSettings

    @classmethod
    def of(cls, given: dict[str, Any], plan: GraspPlan) -> Parameters:
        """From values by the names of ``PARAMETERS``; :class:`InvalidInput` where one cannot be used."""
        hand, rate = plan.hand, number("rate", given["rate"], above=0, at_most=5000, unit="Hz")
        names = given["joints"] or hand.joint_names
        joints = items_of("joints", names, str)
        for name in joints:
            one_of("joint", name, hand.joint_names)
        if len(set(joints)) < len(joints):
            raise InvalidInput(f"joints: expected each once, got {', '.join(joints)}")
        interface = one_of("interface", given["interface"], INTERFACES)
        stiffness = _stiffness(hand, given["stiffness"]) if interface == "position" else None
        scale = each_of("effort_scale", given["effort_scale"], hand.n)
        pose = np.asarray(given["sensor_pose"], dtype=float)
        if pose.shape != (6,) or not np.isfinite(pose).all():
            raise InvalidInput(f"sensor_pose: expected x, y, z, roll, pitch, yaw, got {shorten(given['sensor_pose'])}")
        settings: GripSettings = {
            "period": 1.0 / rate,
            "latency": given["latency"],
            "noise": given["noise"],
            "margin": given["margin"],
            "kept": given["kept"],
            "release": given["release"],
            "max_normal_force": given["max_normal_force"],
            "stiffness": stiffness,
        }
        return cls(
            rate=rate,
            interface=interface,
            message=one_of("message", given["message"], MESSAGES),
            joints=joints,
            places=[hand.joint_names.index(name) for name in joints],
            stiffness=stiffness,
            effort_scale=scale,
            sensor_pose=pose_of(pose[:3], rotation_rpy(*pose[3:])),
            wrench_sign=1.0 if one_of("wrench_acts_on", given["wrench_acts_on"], ACTS_ON) == "object" else -1.0,
            start_time=number("start_time", given["start_time"], at_least=0, unit="s"),
            settings=settings,
        )


def _stiffness(hand: HandModel, given: Any) -> Array:
    """Of the joints' servos (n,): as given, or the drives' own."""
    stiffness = hand.servo_stiffness if given is None else each_of("stiffness", given, hand.n)
    if unknown := [name for name, one in zip(hand.joint_names, stiffness) if not one > 0]:
        raise InvalidInput(
            f"stiffness: expected numbers above 0 for interface:=position, got none for {', '.join(unknown)}: give the "
            "servos' gains, as -p stiffness:=5.0, or take interface:=effort"
        )
    return np.array(stiffness, dtype=float)
