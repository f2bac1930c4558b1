"""Numbers at the ends of floats: the right answer or a refusal, never a NaN, a warning or a foreign exception."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput

BALL = pg.Sphere(radius=0.03, mass=0.2)
CONTACTS = pg.contacts_at(None, BALL, 0.03 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]]))
ENDS = [1.7e308, 1e200, 1e20, 1e-20, 1e-200, 1e-320, 5e-324]
LIMITS = {"jacobian": np.full((3, 6, 2), 0.05), "bias": np.zeros(2), "limit": [2.0, 2.0]}


def problem(**settings):
    return pg.ForceProblem.holding(BALL, CONTACTS, **{"mu": 0.8} | settings)


MAKE = {
    "mu": lambda v: problem(mu=v),
    "load": lambda v: problem().with_load([0, 0, -v, 0, 0, 0]),
    "mass": lambda v: pg.ForceProblem.holding(pg.Sphere(radius=0.03, mass=v), CONTACTS, mu=0.8),
    "stiffness": lambda v: problem(compliance=pg.MarhefkaOrin(stiffness=v)),
    "moment length": lambda v: problem(moment_length=v),
    "final time": lambda v: problem(final_time=v, impact_time_range=(0.8 * v, 0.9 * v)),
    "torsion": lambda v: problem(friction=pg.Friction(model="soft", torsion=v)),
    "safety": lambda v: problem(friction=pg.Friction(model="cone", safety=v)),
    "torque limit": lambda v: problem(torques=pg.TorqueLimits(**LIMITS | {"limit": [v, v]})),
    "Jacobian": lambda v: problem(torques=pg.TorqueLimits(**LIMITS | {"jacobian": np.full((3, 6, 2), v)})),
    "bias": lambda v: problem(torques=pg.TorqueLimits(**LIMITS | {"bias": [v, 0.0]})),
}


@pytest.mark.parametrize("name", MAKE)
def test_values_at_the_ends_of_floats(name):
    for value in ENDS:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                given = MAKE[name](value)
                found = pg.optimize_forces(given, 0.9 * given.final_time, objective="least_squares")
            except InvalidInput:
                continue
        assert np.isfinite(found.forces_c).all(), value
        assert found.certificate is None or np.isfinite(found.certificate.objective), value


@pytest.mark.parametrize("objective", ["least_squares", "work", "peak"])
@pytest.mark.parametrize("weight", ENDS)
def test_weights_at_the_ends_of_floats(objective, weight):
    """One weight changes the unit of the objective, not the forces."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if not 1e-100 <= weight <= 1e100:
            with pytest.raises(InvalidInput, match=f"weight of '{objective}'"):
                pg.optimize_forces(problem(), 0.9, objective={objective: weight})
            return
        found = pg.optimize_forces(problem(), 0.9, objective={objective: weight})
    plain = pg.optimize_forces(problem(), 0.9, objective=objective)
    assert found.status is plain.status is pg.Status.OK
    assert found.certificate.objective == pytest.approx(weight * plain.certificate.objective, rel=2e-6)
