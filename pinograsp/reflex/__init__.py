"""The squeeze follows what is felt while an object is held."""

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
