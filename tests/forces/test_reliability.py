"""How probably contacts hold under random errors: closed forms, single solves, seeds, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import around_cylinder
from scipy.spatial.transform import Rotation
from scipy.stats import norm

import pinograsp as pg
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import holding_probability

MODELS = {"pyramid": pg.Friction(), "cone": pg.Friction(model="cone"), "soft": pg.Friction(model="soft", torsion=4e-3)}
IMPACT = 0.9


def two_fingers(**settings):
    """Two opposed contacts, the weight along their tangents: it holds where mu F >= m g / 2 at both, whatever the rest
    does.
    """
    body = pg.Box(size=(0.04, 0.04, 0.04), mass=0.5)
    contacts = pg.contacts_at(None, body, np.array([[0.02, 0.0, 0.0], [-0.02, 0.0, 0.0]]))
    return pg.ForceProblem.holding(
        body, contacts, **{"mu": 0.6, "friction": MODELS["cone"], "balance": "force"} | settings
    )


def test_friction_alone_has_a_closed_form():
    """With both contacts' mu drawn apart, m g <= (mu_1 + mu_2) F: the sum of two normal variables."""
    problem, squeeze, spread = two_fingers(), 4.3, 0.15
    found = holding_probability(
        problem, IMPACT, normal_forces=[squeeze] * 2, friction=spread, load=0.0, points=0.0, normals=0.0, count=20_000
    )
    weight, mean, std = 0.5 * 9.81, 2 * 0.6 * squeeze, np.sqrt(2) * spread * 0.6 * squeeze
    expected = norm.sf(weight, mean, std)
    low, high = found.interval
    assert 0.1 < expected < 0.9 and low - 0.005 < expected < high + 0.005 and high - low < 0.02
    assert found.undecided == 0
    # A squeeze that counts on its safety factor is judged by friction as it is.
    safe = replace(problem, friction=replace(problem.friction, safety=1.5))
    again = holding_probability(
        safe, IMPACT, normal_forces=[squeeze] * 2, friction=spread, load=0.0, points=0.0, normals=0.0, count=20_000
    )
    assert np.array_equal(again.held, found.held)


def test_load_alone_has_a_closed_form():
    problem, squeeze = two_fingers(), 5.0
    found = holding_probability(
        problem,
        IMPACT,
        normal_forces=[squeeze] * 2,
        friction=0.0,
        load=0.3,
        points=0.0,
        normals=0.0,
        count=20_000,
        seed=3,
    )
    limit = 2 * 0.6 * squeeze / (0.5 * 9.81)
    expected = norm.cdf(limit, 1.0, 0.3) - norm.cdf(-limit, 1.0, 0.3)
    assert found.interval[0] - 0.005 < expected < found.interval[1] + 0.005


@pytest.mark.parametrize("name", MODELS)
def test_every_sample_is_a_problem_of_its_own(name):
    body, rng = pg.Cylinder(radius=0.03, height=0.2, mass=0.5), np.random.default_rng(2)
    contacts = pg.contacts_at(None, body, around_cylinder(rng, 4, 0.03))
    problem = pg.ForceProblem.holding(body, contacts, mu=0.35, friction=MODELS[name], max_depth=5e-3)
    found = holding_probability(
        problem,
        IMPACT,
        friction=0.3,
        disturbance=[0.5, 0.5, 0.5, 0.01, 0.01, 0.01],
        points=3e-3,
        normals=0.1,
        count=300,
        seed=1,
    )
    assert 20 <= found.held.sum() <= 290
    for i in range(0, 300, 10):
        moved = tuple(
            replace(contact, point_o=p, rotation_oc=_frame(contact.rotation_oc, n))
            for contact, p, n in zip(contacts, found.points_o[i], found.normals_o[i])
        )
        one = replace(problem, contacts=replace(contacts, contacts=moved), mu=found.mu[i], load=found.loads[i])
        status = pg.optimize_forces(one, IMPACT, objective="work", solver="clarabel").status
        assert (status is Status.OK) == found.held[i]
    assert np.all(found.squeeze(0.95) >= found.squeeze(0.5)) and found.squeeze(1.0).max() == found.normal_forces.max()


def _frame(frame, normal):
    """The frame turned the shortest way to another normal."""
    axis = np.cross(frame[:, 2], normal)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return frame
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, frame[:, 2] @ normal)).as_matrix() @ frame


def test_seeds_and_less_error():
    problem = two_fingers(balance="wrench", friction=MODELS["soft"])
    one, same, other = (holding_probability(problem, IMPACT, count=500, seed=seed) for seed in (0, 0, 1))
    assert np.array_equal(one.normal_forces, same.normal_forces) and not np.array_equal(one.mu, other.mu)
    none = holding_probability(problem, IMPACT, friction=0.0, load=0.0, points=0.0, normals=0.0, count=3)
    assert none.probability == 1.0 and np.ptp(none.normal_forces, axis=0).max() == 0.0


def test_unusable_errors_are_refused():
    problem = two_fingers()
    for wrong, message in (
        ({"friction": -0.1}, "error of friction"),
        ({"load": np.nan}, "error of load"),
        ({"points": -1.0}, "error of points"),
        ({"disturbance": [1.0, 2.0]}, "disturbance"),
        ({"disturbance": -np.ones(6)}, "disturbance"),
        ({"normal_forces": [1.0]}, "normal forces"),
        ({"normal_forces": [-1.0, 1.0]}, "normal forces"),
        ({"count": 0}, "count"),
    ):
        with pytest.raises(InvalidInput, match=message):
            holding_probability(problem, IMPACT, **wrong)
    limits = pg.TorqueLimits(jacobian=np.zeros((2, 6, 1)), bias=[0.0], limit=[1.0])
    with pytest.raises(InvalidInput, match="torque limits"):
        holding_probability(replace(problem, torques=limits), IMPACT)
    lost = holding_probability(problem, IMPACT, normal_forces=[0.01, 0.01], count=10)
    assert lost.probability == 0.0 and lost.interval[0] == 0.0
    with pytest.raises(InvalidInput, match="none of the samples"):
        lost.squeeze()
    with pytest.raises(InvalidInput, match="share"):
        holding_probability(problem, IMPACT, count=10).squeeze(1.5)
