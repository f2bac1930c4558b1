"""A path of the Panda that ships with example-robot-data."""

import numpy as np

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
START = (0.3, -0.4, 0.2, -2.0, 0.3, 1.9, 0.5)
WAY = np.array([START, [0.8, 0.0, 0.3, -1.6, 0.2, 1.9, 1.2], [1.4, 0.4, -0.2, -1.2, -0.3, 1.5, 0.4]])
WAYPOINTS = dict(zip(JOINTS, WAY.T))
INTERVALS = 60
