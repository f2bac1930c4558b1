"""Handing a plan over to a robot's controller: one smooth joint trajectory at its rate, as CSV, ROS 2 message or MuJoCo
keyframes.

The path runs through nodes with position, velocity and acceleration, by polynomials of fifth degree between them: all
three are continuous everywhere, from rest to rest. The nodes are the plan's own samples. If the plan's acceleration
jumps (between approach and grasp phase, when a limit stops a joint, and at t_F, when the deceleration ends), the nodes
within half of ``blend`` are left out, so that one polynomial bridges the jump; its deviation from the plan is measured
and reported.

The same exists for the actual drives of a hand: their torques, servo positions that produce the forces, positions with
feed-forward and gains, or width and force of a gripper.
"""

from __future__ import annotations

from pinograsp.handover.build import Sampling, joint_trajectory
from pinograsp.handover.commands import Command, Commanding, drive_commands
from pinograsp.handover.core_files import write_core
from pinograsp.handover.grasp_rows import commanded_postures, grasp_rows, write_dexgraspbench
from pinograsp.handover.jaws import JawCommand, JointTarget, gripper_message, jaw_commands, write_jaws
from pinograsp.handover.lerobot_rows import write_lerobot
from pinograsp.handover.reading import read_csv, read_ros2
from pinograsp.handover.registers import FingerClosing, Units, closing_commands, write_closings, write_registers
from pinograsp.handover.trajectory import JointTrajectory

__all__ = [
    "Command",
    "Commanding",
    "FingerClosing",
    "JawCommand",
    "JointTarget",
    "JointTrajectory",
    "Sampling",
    "Units",
    "closing_commands",
    "commanded_postures",
    "drive_commands",
    "grasp_rows",
    "gripper_message",
    "jaw_commands",
    "joint_trajectory",
    "read_csv",
    "read_ros2",
    "write_closings",
    "write_core",
    "write_dexgraspbench",
    "write_jaws",
    "write_lerobot",
    "write_registers",
]
