"""Taxels: forces and centres of arrays, what is dead or saturated, and what the contacts of a plan are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.plan import LinkContacts
from pinograsp.reflex import ContactTaxels, Felt, TaxelArray, TaxelCalibration
from pinograsp.simulation import Disturbance, Sensors

# Of a resistive taxel whose counts fall: 5000 at rest, 1000 at 2 N and at more.
FALLS = TaxelCalibration(counts=[5000, 4000, 1500, 1000], forces=[0, 0.2, 1, 2], noise=0.05, valid=(900, 6000))
RISES = TaxelCalibration(counts=[10, 110, 210], forces=[0, 1, 3], noise=[0.01, 0.1, 0.3], valid=(-20, 300))
GRID = np.stack(np.meshgrid(np.arange(4) * 4e-3, np.arange(3) * 4e-3, [0.01], indexing="ij"), axis=-1).reshape(-1, 3)
PAD = TaxelArray(link="tip", points_l=GRID, normals_l=np.tile([0, 0, 2.0], (12, 1)), calibration=FALLS)


def counts_of(forces, calibration=FALLS):
    """The raw counts at which a taxel tells these forces."""
    return np.interp(forces, calibration.forces, calibration.counts)


def contacts_at(points, links=None, normals=None):
    points = np.array(points, dtype=float)
    k = len(points)
    return LinkContacts(
        names=tuple(f"c{i}" for i in range(k)),
        links=tuple(links or ["tip"] * k),
        points_l=points,
        normals_l=np.tile([0.0, 0.0, 1.0], (k, 1)) if normals is None else np.array(normals, dtype=float),
        normal_forces=np.ones(k),
    )


forces_of_a_pad = st.lists(st.floats(0, 2), min_size=12, max_size=12)


@given(forces=forces_of_a_pad, seed=st.integers(0, 99))
@settings(max_examples=50, deadline=None)
def test_the_force_is_the_sum_and_the_order_of_taxels_is_of_no_effect(forces, seed):
    raw = counts_of(forces)
    told = PAD.measure(raw)
    assert told.normal_force == pytest.approx(sum(forces), abs=1e-9) and told.noise == pytest.approx(0.05 * 12**0.5)
    order = np.random.default_rng(seed).permutation(12)
    other = replace(PAD, points_l=GRID[order]).measure(raw[order])
    assert other.normal_force == pytest.approx(told.normal_force) and other.noise == pytest.approx(told.noise)
    np.testing.assert_allclose(other.centre_l, told.centre_l, atol=1e-12)
    if sum(forces) > 1e-6:
        np.testing.assert_allclose(told.centre_l, np.average(GRID, axis=0, weights=forces), atol=1e-9)


def test_the_centre_of_one_pressed_taxel_is_its_place():
    for i in range(12):
        np.testing.assert_allclose(PAD.measure(counts_of(1.3 * np.eye(12)[i])).centre_l, GRID[i], atol=1e-15)
    assert np.all(np.isnan(PAD.measure(np.full(12, 5000.0)).centre_l))  # nothing presses


def test_curves_rise_or_fall_and_end_at_what_is_told_at_least():
    np.testing.assert_allclose(RISES.measure([10, 60, 160, -5]).forces, [0, 0.5, 2, 0])
    np.testing.assert_allclose(RISES.measure([60, 160]).noise, [0.055, 0.2])
    told = FALLS.measure([5200, 4500, 1500, 950])
    np.testing.assert_allclose(told.forces, [0, 0.1, 1, 2])
    assert told.beyond.tolist() == [False, False, False, True] and not told.dead.any()
    raw = np.linspace(900, 6000, 400)
    assert np.all(np.diff(FALLS.measure(raw).forces) <= 0)


@pytest.mark.parametrize("dead", [0.0, 65535.0, np.nan, np.inf])
def test_dead_taxels_are_told_and_left_out_and_too_many_of_them_tell_no_force(dead):
    forces = np.linspace(0.1, 1.2, 12)
    raw = counts_of(forces)
    raw[[2, 7]] = dead
    told = PAD.measure(raw)
    assert np.flatnonzero(told.taxels.dead).tolist() == [2, 7]
    assert told.normal_force == pytest.approx(forces.sum() - forces[2] - forces[7])
    raw[:4] = dead  # 5 of 12
    told = PAD.measure(raw)
    assert np.isnan([told.normal_force, told.noise, *told.centre_l]).all() and told.taxels.dead.sum() == 5


def test_one_calibration_for_each_taxel():
    array = TaxelArray(link="tip", points_l=GRID[:2], normals_l=GRID[:2] + 1, calibration=(FALLS, RISES))
    told = array.measure([4000, 160])
    assert told.normal_force == pytest.approx(2.2)
    np.testing.assert_allclose(told.taxels.forces, [0.2, 2.0])


def test_contacts_feel_the_taxels_of_their_links_that_are_nearest_and_face_their_way():
    rng = np.random.default_rng(3)
    side = TaxelArray(  # on another face of the link: its taxels press elsewhere
        link="tip", points_l=GRID + [0, 0, -0.003], normals_l=np.tile([0, 0, -1.0], (12, 1)), calibration=FALLS
    )
    other = replace(PAD, link="palm")
    contacts = contacts_at(
        [[0.0, 0.004, 0.01], [0.012, 0.004, 0.01], [0.0, 0.0, 0.01], [0, 0, 0]], ["tip", "tip", "palm", "thumb"]
    )
    sensing = ContactTaxels(contacts=contacts, arrays=(PAD, side, other))
    assert sensing.felt.tolist() == [True, True, True, False]
    forces = rng.uniform(0, 1.5, (3, 12))
    told = sensing.measure([counts_of(one) for one in forces])
    near = np.linalg.norm(GRID - contacts.points_l[0], axis=1) < np.linalg.norm(GRID - contacts.points_l[1], axis=1)
    wanted = [forces[0, near].sum(), forces[0, ~near].sum(), forces[2].sum()]
    np.testing.assert_allclose(told.normal_forces, [*wanted, np.nan])
    np.testing.assert_allclose(told.centres_l[0], np.average(GRID[near], axis=0, weights=forces[0, near]))
    assert told.arrays[1].normal_force == pytest.approx(forces[1].sum())
    # What presses at an angle counts along the contact's normal.
    tilted = contacts_at(GRID[:1], normals=[[np.sin(0.6), 0, np.cos(0.6)]])
    told = ContactTaxels(contacts=tilted, arrays=(PAD,)).measure([counts_of(forces[0])])
    assert told.normal_forces[0] == pytest.approx(np.cos(0.6) * forces[0].sum())


def test_what_is_not_felt_is_taken_as_commanded():
    contacts = contacts_at([[0, 0, 0.01], [0, 0, 0.05], [0, 0, 0]], ["tip", "tip", "thumb"])
    contacts = replace(contacts, links=("tip", "palm", "thumb"))
    near = replace(PAD, link="palm", points_l=GRID + [0, 0, 0.02])  # 20 mm from its contact
    sensing = ContactTaxels(contacts=contacts, arrays=(PAD, near))
    assert sensing.felt.tolist() == [True, False, False]
    raw = [counts_of(np.full(12, 0.1)), counts_of(np.ones(12))]
    told = sensing.measure(raw).make_measurement(0.5, [5.0, 6.0, 7.0])
    np.testing.assert_allclose(told.value, [1.2, 6, 7])
    assert told.time == 0.5
    # One dead of the four taxels within 6 mm of the contact, and two of them.
    local = replace(sensing, reach=6e-3)
    raw[0][0] = np.nan
    assert local.measure(raw).normal_forces[0] == pytest.approx(1.1)
    raw[0][1] = np.nan
    assert (
        np.isnan(local.measure(raw).normal_forces[0]) and local.measure(raw).make_measurement(0.5, np.ones(3)) is None
    )
    # Saturated: at least what is told, and what is commanded if that is more.
    raw[0] = counts_of(np.full(12, 0.1))
    raw[0][5] = 950.0
    reading = sensing.measure(raw)
    assert reading.beyond.tolist() == [True, False, False] and reading.normal_forces[0] == pytest.approx(3.1)
    assert [reading.make_measurement(0, [one, 1, 1]).value[0] for one in (2.0, 5.0)] == pytest.approx([3.1, 5.0])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: replace(FALLS, counts=[5000, 4000, 4500, 1000]), "all rise or all fall"),
        (lambda: replace(FALLS, forces=[0, 0.2, 0.1, 2]), "never fall"),
        (lambda: replace(FALLS, forces=[0.1, 0.2, 0.3, 2]), "0 at rest"),
        (lambda: replace(FALLS, valid=(1200, 6000)), "1000 to 5000"),
        (lambda: replace(FALLS, noise=-1.0), ">= 0"),
        (lambda: replace(PAD, normals_l=np.zeros((12, 3))), "of some length"),
        (lambda: replace(PAD, calibration=(FALLS,) * 3), "one for each of 12"),
        (lambda: PAD.measure(np.zeros(3)), r"expected shape \(12,\)"),
        (lambda: ContactTaxels(contacts=None, arrays=(PAD,)), "LinkContacts"),
        (lambda: ContactTaxels(contacts=contacts_at(GRID[:1]), arrays=()), "one or more"),
        (lambda: ContactTaxels(contacts=contacts_at(GRID[:1]), arrays=(PAD,)).measure([]), "each of 1 arrays"),
    ],
)
def test_what_cannot_be_used_is_refused(make, said):
    with pytest.raises(InvalidInput, match=said):
        make()


@pytest.fixture(scope="module")
def plan():
    conditions, body = pg.GraspConditions(mu=0.6), pg.Cylinder(radius=0.033, height=0.12, mass=0.25)
    found = pg.find_grasps(pg.load_hand("allegro_right"), body, conditions, count=16, seed=1, jobs=1, progress=False)
    return pg.plan_best(found, conditions, progress=False)


def patches_of(plan, count):
    """Patches of 9 taxels around the first contacts of a plan, each along its contact's normal."""
    places, patches = plan.contacts_on_links, []
    curve = TaxelCalibration(counts=[0, 1000, 4000], forces=[0, 20, 100], noise=0.1, valid=(-50, 5000))
    for link, point, normal in list(zip(places.links, places.points_l, places.normals_l))[:count]:
        along = np.linalg.svd(normal[None])[2][1:]
        points = point + 2e-3 * np.array([[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)]) @ along
        patches.append(TaxelArray(link=link, points_l=points, normals_l=np.tile(normal, (9, 1)), calibration=curve))
    return ContactTaxels(contacts=places, arrays=tuple(patches)), curve


@pytest.mark.parametrize("count", [2, 3])
def test_a_grip_holds_by_what_its_taxels_tell_with_a_finger_that_has_none(plan, count):
    sensing, curve = patches_of(plan, count)
    assert sensing.felt.sum() == count
    controller, rng, wanted = plan.grip_controller(latency=0.025), np.random.default_rng(0), []

    def by_taxels(felt):
        """What the simulation measures, as the counts of taxels that share it."""
        normal = None
        if felt.normal_forces is not None:
            parts = [np.maximum(force, 0) * rng.dirichlet(np.ones(9)) for force in felt.normal_forces.value[:count]]
            raw = [np.interp(part, curve.forces, curve.counts) for part in parts]
            reading = sensing.measure(raw)
            np.testing.assert_allclose(
                reading.normal_forces[:count], np.maximum(felt.normal_forces.value[:count], 0), atol=1e-9
            )
            normal = reading.make_measurement(felt.normal_forces.time, controller.forces[:, 2])
        wanted.append(controller.forces[:, 2].copy())
        return controller.step(Felt(felt.time, normal_forces=normal, slips=felt.slips))

    sensors = Sensors(quantities=("normal_forces", "slips"), noise=0.1, delay=0.02, seed=3)
    heavier = Disturbance(mu=0.5, mass_factor=1.3)
    seen = pg.simulate(plan, controller=by_taxels, sensors=sensors, disturbance=heavier, support="fixed", hold=0.5)
    assert seen.verdict.held, seen.verdict.reason
    assert np.all(np.isfinite(wanted)) and len(wanted) > 100
