"""Scenarios: the plan's loads are the planned object's, whatever else it may be, and in whatever order that is said."""

from itertools import permutations

import numpy as np
import pytest
from panda_path import WAYPOINTS

from pinograsp.carry import CarryScenario, plan_carry

HEAVY, SLIPPERY, OFF = CarryScenario(mass=1.2), CarryScenario(mu=0.8), CarryScenario(com=(0.004, 0, 0))
VALUES = ("times", "loads", "torques", "normal_forces", "commanded", "commanded_q", "commanded_torques")


@pytest.mark.slow
@pytest.mark.parametrize("squeeze", ["least", "constant"])
def test_the_order_of_scenarios_does_not_matter(arm, grasp, squeeze):
    plans = [
        plan_carry(arm, grasp, WAYPOINTS, intervals=10, squeeze=squeeze, scenarios=order)
        for order in list(permutations([HEAVY, SLIPPERY, OFF]))[::2]
    ]
    for plan in plans[1:]:
        for name in VALUES:
            np.testing.assert_array_equal(getattr(plan, name), getattr(plans[0], name), err_msg=name)


@pytest.mark.parametrize("squeeze", ["least", "constant"])
def test_loads_are_those_of_the_planned_object(arm, grasp, squeeze):
    """The arm comes to rest slowly: the last load is the weight, to the share of its last acceleration."""
    weight = grasp.problem.object.mass * 9.81
    options = {"intervals": 15, "acceleration": 0.2, "ramp": 0.3}
    alone = plan_carry(arm, grasp, WAYPOINTS, **options)
    for scenarios in ([HEAVY, SLIPPERY], [HEAVY, CarryScenario()]):
        plan = plan_carry(arm, grasp, WAYPOINTS, scenarios=scenarios, squeeze=squeeze, **options)
        assert np.linalg.norm(plan.loads[-1, :3]) == pytest.approx(weight, rel=0.01)
        # The acceleration binds, not the grasp: the same motion, to the accuracy of the timing.
        np.testing.assert_allclose(plan.loads, alone.loads, atol=0.01 * weight)
        moving = np.abs(alone.torques).max(axis=0) > 0.5
        arm_alone = moving & ~np.isin(arm.joint_names, ["panda_finger_joint1", "panda_finger_joint2"])
        np.testing.assert_allclose(plan.torques[:, arm_alone], alone.torques[:, arm_alone], atol=0.05)


def test_more_scenarios_ask_for_no_less_squeeze(arm, grasp):
    options = {"intervals": 10, "acceleration": 0.2, "ramp": 0.3, "squeeze": "constant"}
    alone, heavy, both = (
        plan_carry(arm, grasp, WAYPOINTS, scenarios=scenarios, **options).commanded[0].sum()
        for scenarios in ([], [HEAVY], [SLIPPERY, HEAVY])
    )
    assert alone < heavy < both
