"""Defaults that several doors have: Python's records and functions, case files and the command line.

Plain numbers: the command line's help loads nothing heavy for them.
"""

MU = 0.6  # friction coefficient: rubber or skin on most household things, on the safe side
GRASPS = 64  # samples of a search
GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]

# Limits of the grasp phase, Eqs. (13) and (14): the paper's (Table V) but for the depth, of which it allows 5 mm, and
# the deceleration: its 1 m/s^2 takes 0.15 s to press with 15 N, in which an object that nothing else holds drops.
FINAL_TIME = 1.0  # t_F [s]
IMPACT_TIMES = (0.80, 0.95)  # t_I [s]
ACCELERATIONS = (0.01, 4.0)  # A [m/s^2]
MAX_SPEED = 2.0  # A tau [m/s]
MAX_DEPTH = 10e-3  # delta_F [m]: 50 N at the default contact law, more than most hands press with

TOUCHES = 2e-3  # [m] from the surface, at which a link of somebody else's grasp touches
HOLD, TIME_STEP = 1.0, 2.5e-4  # [s] of a simulation: how long the object is held, and its steps
