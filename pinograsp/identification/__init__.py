"""Identification of a hand's drives and contacts from its logs."""

from pinograsp.hands.estimates import Estimate
from pinograsp.identification.closings import ContactFit, IdentifiedClosings, identify_closings
from pinograsp.identification.loads import identify_load
from pinograsp.identification.logs import Log, read_log
from pinograsp.identification.motion import DriveFit, IdentifiedMotion, apply_fits, identify_motion
from pinograsp.identification.motion_log import MotionLog, read_motion
from pinograsp.identification.servos import Motor, identify_servo_stiffness, read_bam, read_duty
from pinograsp.identification.slips import identify_friction
from pinograsp.identification.taxels import find_lag, identify_taxel

__all__ = [
    "ContactFit",
    "DriveFit",
    "Estimate",
    "IdentifiedClosings",
    "IdentifiedMotion",
    "Log",
    "MotionLog",
    "Motor",
    "apply_fits",
    "find_lag",
    "identify_closings",
    "identify_friction",
    "identify_load",
    "identify_motion",
    "identify_servo_stiffness",
    "identify_taxel",
    "read_bam",
    "read_duty",
    "read_log",
    "read_motion",
]
