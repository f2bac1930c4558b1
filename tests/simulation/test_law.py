"""The simulation's own contact forces, against the law in closed form."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinograsp.plan import ContactLaw
from pinograsp.simulation.law import ContactForces, Touches
from pinograsp.spatial import pose_of, rotation_rpy

K, RHO, MU, KT = 5e4, 1.5, 0.5, 2e4
SQUARE = 0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def make_forces(counts, *, damping=0.0, mu=MU, torsion=0.0, places=()):
    law = ContactLaw(stiffness=K, damping=damping, exponent=RHO)
    return ContactForces(law, [mu] * len(counts), torsion, KT, np.array(counts), places)


def touch(depths, points=None, *, velocity=(0.0, 0, 0), spin=0.0, parts=None, geometry=None, normal=(0.0, 0, 1)):
    """Points of one part, along z, with the same velocity."""
    c, none = len(depths), np.zeros(len(depths), dtype=int)
    return Touches(
        none if parts is None else np.array(parts),
        none if geometry is None else np.array(geometry),
        np.zeros((c, 3)) if points is None else points,
        np.tile(normal, (c, 1)),
        np.array(depths),
        np.tile(np.array(velocity, dtype=float), (c, 1)),
        np.full(c, spin),
    )


def test_normal_force_is_equation_4():
    forces = make_forces([1], damping=100.0)
    pressing = forces.press(touch([2e-3], velocity=[0.0, 0, 0.1]), 1e-4)
    assert pressing.normal[0] == pytest.approx((100 * 0.1 + K) * 2e-3**RHO, rel=1e-12)
    assert forces.press(touch([2e-3], velocity=[0.0, 0, -1e4]), 1e-4).normal[0] == 0.0  # it does not pull


@pytest.mark.slow
@pytest.mark.no_cover
def test_friction_sticks_then_slips_and_says_where_the_energy_goes():
    made, dt, steps = make_forces([1]), 1e-5, 4000
    normal, forces = K * 2e-3**RHO, []
    made.press(touch([2e-3]), dt)
    held = made.elastic
    for _ in range(steps):
        forces.append(made.press(touch([2e-3], velocity=[0.01, 0, 0]), dt).force_o[0, 0])
    assert forces[99] == pytest.approx(KT * 100 * dt * 0.01, rel=1e-9)  # the spring
    assert forces[-1] == pytest.approx(MU * normal, rel=1e-9)  # the cone
    work = np.sum(0.5 * (np.array([0.0, *forces[:-1]]) + forces)) * dt * 0.01
    assert made.slipped + made.elastic - held == pytest.approx(work, rel=1e-9)
    assert made.slip[0] == pytest.approx(0.01 * steps * dt - MU * normal / KT, rel=1e-6)


@pytest.mark.slow
def test_soft_fingers_twist_up_to_their_limit():
    forces = make_forces([1], torsion=5e-3)
    for _ in range(5000):
        pressing = forces.press(touch([2e-3], spin=1.0), 1e-4)
    assert pressing.moment_o[0, 2] == pytest.approx(5e-3 * K * 2e-3**RHO, rel=1e-9)


def test_springs_turn_with_the_object():
    """A hand that turns takes its grip along: the same stretch along axes that turn."""
    forces, pose = make_forces([1], mu=10.0), np.eye(4)
    force = forces.press(touch([2e-3], velocity=[0.01, 0, 0]), 1e-3, pose).force_o[0]
    pose[:3, :3] = turn = pin.exp3(np.array([0.0, 0.0, 0.4]))  # about the normal
    np.testing.assert_allclose(forces.press(touch([2e-3]), 1e-3, pose).force_o[0], turn @ force, atol=1e-9)


@pytest.mark.slow
def test_an_area_that_can_hold_does_not_creep_where_it_hardly_presses():
    """Points with a hundredth of the force carry their share of the load up to the cone, and hold it then."""
    forces = make_forces([2])

    def press(speed):
        return forces.press(touch([1e-3, 9e-4, 6e-5, 5e-5], SQUARE, velocity=[speed, 0, 0]), 1e-4)

    most = MU * press(0.0).normal.sum()
    loaded = 0.0
    for _ in range(10_000):
        if loaded < 0.95 * most:
            loaded = press(1e-3).force_o[:, 0].sum()
    for _ in range(1000):
        still = press(0.0)
    assert still.force_o[:, 0].sum() == pytest.approx(loaded, rel=1e-9)
    assert forces.slip[0] == 0.0
    for _ in range(2000):
        sliding = press(1e-2)
    assert sliding.force_o[:, 0] == pytest.approx(MU * sliding.normal, rel=1e-6)


@pytest.mark.parametrize("around", [[], [0.5], [0.6, 0.3, 0.1], [0.7] * 6])
def test_of_one_planned_contact_the_deepest_point_counts(around):
    """However many shallower points an engine finds around it; with several contacts planned they all count."""
    depths = 1e-3 * np.array([1.0, *around])
    places = np.column_stack([1e-3 * np.arange(len(depths)), np.zeros((len(depths), 2))])
    one, all_of_them = (make_forces([count]).press(touch(depths, places), 1e-3).normal for count in (1, len(depths)))
    assert one.sum() == pytest.approx(K * 1e-3**RHO, rel=0.02)
    assert all_of_them == pytest.approx(K * depths**RHO, rel=1e-9)


def test_points_of_an_area_share_what_the_plan_counts():
    pressing = make_forces([3]).press(touch([1e-3] * 4, SQUARE), 1e-4)
    assert pressing.normal.sum() == pytest.approx(3 * K * 1e-3**RHO, rel=1e-12)


def test_of_several_contacts_each_counts_where_it_was_planned():
    """Two corners planned, the engine finds two more that are shallower, the object may be anywhere: the forces are
    those of the law at the planned corners, whether they are equally deep or not.
    """
    places = np.array([[0.0, 0, 0], [0.02, 0, 0]])
    forces, pose = make_forces([2], places=[places]), pose_of([0.1, 0.2, 0.3], rotation_rpy(0.3, -0.2, 0.5))
    points = SQUARE * [2, 1, 1] @ pose[:3, :3].T + pose[:3, 3]
    for depths in ([1.0, 1.0, 0.6, 0.6], [1.0, 0.7, 0.5, 0.3], [1.0, 1.0, 1e-9, 1e-9]):
        depths = 1e-3 * np.array(depths)
        pressing = forces.press(touch(depths, points, normal=pose[:3, 2]), 1e-4, pose)
        assert pressing.normal[:2] == pytest.approx(K * depths[:2] ** RHO, rel=0.05)
        assert pressing.normal[2:].sum() < 0.02 * pressing.normal.sum()
    # One point alone bears what both would.
    alone = forces.press(touch([1e-3], points[:1], normal=pose[:3, 2]), 1e-4, pose)
    assert alone.normal.sum() == pytest.approx(2 * K * 1e-3**RHO)
    # Nor does it matter that two of the planned ones are nearly the same.
    close = make_forces([4], places=[np.concatenate([places, places + [0, 1e-3, 0]])])
    four = close.press(touch([1e-3] * 4, points, normal=pose[:3, 2]), 1e-4, pose)
    assert four.normal.sum() == pytest.approx(4 * K * 1e-3**RHO)


def test_of_a_link_with_one_contact_its_deepest_body_presses():
    """A second body of the same link that comes to touch, less deep, changes nothing; where more is planned all points
    count.
    """
    forces, depths = make_forces([1, 2]), [1e-3, 4e-4, 2e-4, 1e-3]
    counted = forces.drop_shallower(touch(depths, SQUARE, parts=[0, 0, 1, 1], geometry=[7, 8, 9, 10]))
    assert counted.geometry.tolist() == [7, 9, 10]
    normal = forces.press(counted, 1e-4).normal
    assert normal[0] == pytest.approx(K * 1e-3**RHO, rel=1e-12) and np.all(normal > 0)
