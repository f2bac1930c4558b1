"""What contacts keep for disturbances, which come besides the loads of the way."""

from dataclasses import replace

import numpy as np
import pytest
from panda_path import WAYPOINTS
from whole_carries import random_carry

from pinograsp.carry import plan_carry
from pinograsp.carry.limits import find_disturbance, spare_forces
from pinograsp.contacts import Friction
from pinograsp.errors import CarryInfeasible

MODELS = (Friction(model="cone"), Friction(model="soft", torsion=5e-3), Friction(model="pyramid", edges=8))


@pytest.mark.parametrize("friction", MODELS, ids=lambda one: one.model)
@pytest.mark.parametrize("seed", range(3))
def test_disturbances_are_borne_with_the_spare_forces(arm, seed, friction):
    """Forces within friction, the spare on top, and the reaction of equal springs to any disturbance: within friction."""
    problem = random_carry(arm, seed, k=5, friction=friction).problem
    rng, force, moment = np.random.default_rng(seed), 0.7, 0.03
    spare = spare_forces(problem, force, moment)
    k, widths = problem.k, problem.friction.scale(problem.mu)
    G, contacts = problem.contacts.G, problem.contacts
    if friction.model == "soft":  # moments about the normals, at an arm of the torsion
        twist = np.zeros((6, k))
        twist[3:] = contacts.rotations_oc[:, :, 2].T * friction.torsion
        G = np.hstack([G, twist])
    scale = np.diag([1, 1, 1, *3 * [1 / problem.moment_length]])
    inverse = np.linalg.pinv(scale @ G)
    for _ in range(200):
        share = rng.uniform()
        direction = rng.normal(size=(2, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        wrench = np.concatenate([share * force * direction[0], (1 - share) * moment * direction[1]])
        change = inverse @ scale @ -wrench
        local = change[: 3 * k].reshape(k, 3)
        # At the limit of friction before, in any direction.
        across = rng.normal(size=(k, friction.d - 1))
        across /= np.maximum(friction.gauge(across), 1e-12)[:, None]
        normal = rng.uniform(0.1, 5.0, k)
        u = across * normal[:, None]
        u[:, :2] += local[:, :2] / widths[:, :2]
        if friction.model == "soft":
            u[:, 2] += change[3 * k :] * friction.torsion / widths[:, 2]
        assert (friction.gauge(u) <= normal + spare + local[:, 2] + 1e-9).all()


def test_nothing_is_kept_for_no_disturbance(arm):
    problem = random_carry(arm, 3).problem
    np.testing.assert_array_equal(spare_forces(problem, 0.0, 0.0), 0.0)
    np.testing.assert_allclose(spare_forces(problem, 2.0, 0.0), 2 * spare_forces(problem, 1.0, 0.0))


def test_the_disturbance_is_that_of_the_grasp(grasp):
    body, weight = grasp.body, 9.81 * grasp.body.mass
    force, moment = find_disturbance(grasp, body, None)
    assert force == pytest.approx((grasp.reserve.disturbance + grasp.reserve.mass) * weight)
    assert moment == pytest.approx(grasp.reserve.moment)
    assert find_disturbance(replace(grasp, reserve=None), body, None) == (0.0, 0.0)
    assert find_disturbance(grasp, body, 1.5)[0] == 1.5


def test_what_is_kept_is_pressed_on_top(arm, grasp):
    bare, more = (plan_carry(arm, grasp, WAYPOINTS, intervals=25, disturbance=size) for size in (0.0, 0.4))
    assert more.squeeze.min() > bare.squeeze.min() + 0.4
    assert more.friction_use.max() < bare.friction_use.max()
    assert more.fastest >= bare.fastest * (1 - 1e-6)


def test_more_than_the_caps_is_told(arm, grasp):
    with pytest.raises(CarryInfeasible, match="to withstand the disturbances"):
        plan_carry(arm, grasp, WAYPOINTS, intervals=10, disturbance=1000.0)
