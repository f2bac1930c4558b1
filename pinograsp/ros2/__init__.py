"""Grasp plans in ROS 2: a node that plays a plan's trajectory, and holds the object with its reflex."""

from pinograsp.ros2.running import run_node

__all__ = ["run_node"]
