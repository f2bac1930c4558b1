"""Independent simulations of plans.

It shares no contact, force, torque or energy code with the planner.
"""

from pinograsp.plan import Simulation, Verdict
from pinograsp.simulation.monte_carlo import MonteCarlo, monte_carlo
from pinograsp.simulation.random_errors import Errors
from pinograsp.simulation.sensing import Sensors
from pinograsp.simulation.settings import BaseMotion, Disturbance, Push, Servo
from pinograsp.simulation.simulate import simulate
from pinograsp.simulation.thresholds import LoadThreshold, SlipThreshold, load_threshold, slip_threshold
from pinograsp.simulation.what_holds import WhatHolds, what_holds

__all__ = [
    "BaseMotion",
    "Disturbance",
    "Errors",
    "LoadThreshold",
    "MonteCarlo",
    "Push",
    "Sensors",
    "Servo",
    "Simulation",
    "SlipThreshold",
    "Verdict",
    "WhatHolds",
    "load_threshold",
    "monte_carlo",
    "simulate",
    "slip_threshold",
    "what_holds",
]
