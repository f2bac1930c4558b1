"""Picking: from an object on a table to a carried object, with a given arm."""

from pinograsp.pick.folder import load_pick, save_pick
from pinograsp.pick.pick_motion import PickMotion
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.place import PlaceRegion
from pinograsp.pick.plan import plan_pick
from pinograsp.pick.record import PickPhase
from pinograsp.pick.simulation import PickSimulation, simulate_pick

__all__ = [
    "PickMotion",
    "PickPhase",
    "PickPlan",
    "PickSimulation",
    "PlaceRegion",
    "load_pick",
    "plan_pick",
    "save_pick",
    "simulate_pick",
]
