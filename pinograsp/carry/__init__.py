"""Carrying: how fast an arm may move what its hand holds, and how hard the hand must squeeze on the way."""

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.folder import load_carry, save_carry
from pinograsp.carry.loads import CarryScenario
from pinograsp.carry.path import ArmPath
from pinograsp.carry.plan import plan_carry
from pinograsp.carry.simulation import simulate_carry

__all__ = ["ArmPath", "CarryPlan", "CarryScenario", "load_carry", "plan_carry", "save_carry", "simulate_carry"]
