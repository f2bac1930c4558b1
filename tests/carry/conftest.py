"""A box in the jaws of a Panda, and what carrying it takes."""

import numpy as np
import pytest
from panda_path import INTERVALS, JOINTS, START, WAYPOINTS

import pinograsp as pg
from pinograsp.carry import plan_carry
from pinograsp.hands.catalogue import file_of


@pytest.fixture(scope="session")
def arm():
    return pg.load_hand(file_of("panda"), posture=dict(zip(JOINTS, START)))


@pytest.fixture(scope="session")
def grasp(arm):
    at = np.eye(4)
    at[2, 3] = 0.1034
    pose = arm.frame_placements(arm.resting, ["panda_hand"])[0] @ at
    return pg.plan_grasp_on(arm, pg.Box(size=[0.04, 0.04, 0.06], mass=0.2, pose=pose), pg.GraspConditions(mu=0.6))


@pytest.fixture(scope="session")
def carried(arm, grasp):
    """As fast as can be, with accelerations that jump."""
    return plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS, ramp=0)


@pytest.fixture(scope="session")
def smoothed(arm, grasp):
    return plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS)
