"""Hands: from a description (DH tables, URDF, xacro, MJCF) to a :class:`HandModel`."""

from pinograsp.hands.attach import attach
from pinograsp.hands.detach import detach
from pinograsp.hands.drives import Drive, Spring, ratios_of
from pinograsp.hands.load import load_hand
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.servos import servo_gains
from pinograsp.hands.sources import Source

__all__ = [
    "Drive",
    "Finger",
    "HandModel",
    "Source",
    "Spring",
    "attach",
    "detach",
    "load_hand",
    "ratios_of",
    "servo_gains",
]
