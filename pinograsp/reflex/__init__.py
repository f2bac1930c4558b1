"""The squeeze follows what is felt while an object is held."""

from pinograsp.plan.felt import Command, Controller, Felt, Measured
from pinograsp.reflex.grip_controller import GripController, GripSettings

__all__ = ["Command", "Controller", "Felt", "GripController", "GripSettings", "Measured"]
