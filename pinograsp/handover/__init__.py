"""A plan handed over to a robot's controller: one smooth joint trajectory at its rate, as CSV, ROS 2 message or MuJoCo
keyframes.

The path runs through nodes with position, velocity and acceleration, by polynomials of fifth degree between them: all
three are continuous everywhere, from rest to rest. The nodes are the plan's own samples. Where the plan's acceleration
jumps (where the approach meets the grasp phase, where a joint is stopped by its limit, and at t_F, where the
deceleration ends) those within half of ``blend`` are left out, so that one polynomial leads across; how far it then is
from the plan is measured and told.
"""

from __future__ import annotations

from pinograsp.handover.build import Sampling, joint_trajectory
from pinograsp.handover.trajectory import JointTrajectory, read_csv, read_ros2

__all__ = ["JointTrajectory", "Sampling", "joint_trajectory", "read_csv", "read_ros2"]
