"""Identification: what a hand's drives and contacts are, from logs of it."""

from pinograsp.identification.closings import ContactFit, Estimate, IdentifiedClosings, identify_closings
from pinograsp.identification.logs import Log, read_log
from pinograsp.identification.servos import Motor, identify_servo_stiffness, read_bam, read_duty

__all__ = [
    "ContactFit",
    "Estimate",
    "IdentifiedClosings",
    "Log",
    "Motor",
    "identify_closings",
    "identify_servo_stiffness",
    "read_bam",
    "read_duty",
    "read_log",
]
