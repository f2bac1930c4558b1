"""Carrying: how fast an arm may move the object in its hand, and how hard the hand must squeeze along the path."""

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.folder import load_carry, save_carry
from pinograsp.carry.loads import CarryScenario
from pinograsp.carry.path import ArmPath
from pinograsp.carry.plan import plan_carry
from pinograsp.carry.simulation import simulate_carry

__all__ = ["ArmPath", "CarryPlan", "CarryScenario", "load_carry", "plan_carry", "save_carry", "simulate_carry"]
