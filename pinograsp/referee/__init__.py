"""The referee: plans tried in an independent simulation. Shares no contact, force, torque or energy code with what it judges."""

from pinograsp.referee.settings import Disturbance, Push, Servo
from pinograsp.referee.simulate import simulate
from pinograsp.referee.simulation import Simulation, Verdict

__all__ = ["Disturbance", "Push", "Servo", "Simulation", "Verdict", "simulate"]
