"""Kinematics, dynamics and contact forces of robotic hands on Pinocchio."""
