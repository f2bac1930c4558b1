"""Motion: contact-phase postures, grasp-phase and approach trajectories, joint torques."""

from pinograsp.motion.contact_ik import ContactPostures, contact_postures
from pinograsp.motion.online import LoopSettings, OnlineForces
from pinograsp.motion.producible import PressingTogether, pressing_together
from pinograsp.motion.surfaces import normal_at_rest
from pinograsp.motion.torques import effort_of, preload_slope, torque_limits, torques_matter
from pinograsp.motion.trajectory import MotionSpec, draft_motion, plan_motion

__all__ = [
    "ContactPostures",
    "LoopSettings",
    "MotionSpec",
    "OnlineForces",
    "PressingTogether",
    "contact_postures",
    "draft_motion",
    "effort_of",
    "normal_at_rest",
    "plan_motion",
    "preload_slope",
    "pressing_together",
    "torque_limits",
    "torques_matter",
]
