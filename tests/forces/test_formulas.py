"""The formulas of docs/concepts: what soft fingers hold, and the grasp map."""

from __future__ import annotations

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.forces import load_factor

CAN = pg.Cylinder(radius=0.03, height=0.12, mass=0.35)
BOX = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9, 1.0])
def test_soft_fingers_hold_an_ellipse_of_force_and_moment(share):
    """(f / mu)^2 + (m / e)^2 <= F_n^2: two jaws of F_n that share a force across and a moment about their line."""
    squeeze, mu, e = 10.0, 0.5, 5e-3
    force, moment = share * 2 * mu * squeeze, np.sqrt(1 - share**2) * 2 * e * squeeze
    problem = pg.ForceProblem(
        contacts=pg.contacts_at(None, BOX, [[0.02, 0, 0], [-0.02, 0, 0]]),
        load=[0, 0, -force, moment, 0, 0],
        mu=mu,
        friction=pg.Friction(model="soft", torsion=e),
    )
    assert load_factor(problem, normal_forces=[squeeze] * 2) == pytest.approx(1.0, rel=1e-6)


def test_the_grasp_map_takes_forces_in_contact_axes():
    contacts = pg.contacts_at(None, CAN, [[0.03, 0, 0], [-0.015, 0.026, 0.01], [-0.015, -0.026, -0.01]])
    f = np.array([[1.0, 0, 5], [0, 1, 4], [0.5, 0, 3]])
    h = np.array([R @ one for R, one in zip(contacts.rotations_oc, f)])
    wrench = np.append(h.sum(axis=0), np.cross(contacts.points_o - contacts.com_o, h).sum(axis=0))
    assert contacts.G @ f.ravel() == pytest.approx(wrench, abs=1e-12)
