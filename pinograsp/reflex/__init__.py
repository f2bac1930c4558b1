"""A squeeze that reacts to the hand's sensors while it holds an object."""

from pinograsp.plan.felt import Command, Controller, Felt, Measured
from pinograsp.reflex.grip_controller import GripController, GripSettings
from pinograsp.reflex.taxels import (
    ContactReading,
    ContactTaxels,
    TaxelArray,
    TaxelCalibration,
    TaxelForces,
    TaxelReading,
)

__all__ = [
    "Command",
    "ContactReading",
    "ContactTaxels",
    "Controller",
    "Felt",
    "GripController",
    "GripSettings",
    "Measured",
    "TaxelArray",
    "TaxelCalibration",
    "TaxelForces",
    "TaxelReading",
]
