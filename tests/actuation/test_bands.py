"""Forces on contacts that are softer or stiffer than planned, against closed forms, a convex solver and linear algebra."""

from __future__ import annotations

import secrets

import cvxpy as cp
import numpy as np
import pytest
from conftest import make_contacts
from scipy.optimize import brentq

import pinograsp as pg
from pinograsp.actuation import (
    CompliantHand,
    contact_stiffness,
    drive_scenarios,
    force_band,
    gains_within,
    stiffness_scenarios,
)
from pinograsp.contacts import MarhefkaOrin
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem, ForceSolution, TorqueLimits
from pinograsp.motion import torque_limits

LINEAR = MarhefkaOrin(stiffness=4000.0, exponent=1.0)
FACTORS = np.array([0.2, 0.5, 1.0, 3.0, 20.0])


def solution_of(contacts, forces, **settings):
    """A solution with these forces (k, 3); the load is what they balance."""
    forces = np.asarray(forces, dtype=float)
    problem = ForceProblem(
        contacts=contacts,
        load=-contacts.G @ forces.ravel(),
        **{"mu": 0.8, "friction": pg.Friction(model="cone")} | settings,
    )
    return ForceSolution(
        status=pg.Status.OK, problem=problem, search="test", solver="", impact_time=0.9, forces_c=forces, elapsed=0.0
    )


def jaws(squeeze=10.0, law=LINEAR, **settings):
    """Two opposed contacts 6 cm apart."""
    sides = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    contacts = make_contacts(-0.03 * sides, sides, fingers=("left", "right"))
    return solution_of(contacts, [[0, 0, squeeze]] * 2, compliance=law, **settings)


PRESSING = np.zeros((6, 2))
PRESSING[2, 0] = PRESSING[5, 1] = 1.0


@pytest.mark.parametrize("gain", [10.0, 1400.0, 14000.0, 1e7])
def test_a_servo_in_series_with_a_linear_contact(gain):
    """F' = F* (C_c* + C_h) / (C_c' + C_h)."""
    band = force_band(jaws(), CompliantHand(jacobian=PRESSING, gains=[gain, gain]), FACTORS)
    C, C_h = 1 / LINEAR.stiffness, 1 / gain
    expected = 10.0 * (C + C_h) / (C / FACTORS + C_h)
    np.testing.assert_allclose(band.normal_forces, np.column_stack([expected] * 2), rtol=1e-9)
    np.testing.assert_allclose(band.lowest, expected.min(), rtol=1e-9)
    np.testing.assert_allclose(band.highest, expected.max(), rtol=1e-9)
    assert band.deviation == pytest.approx(np.abs(expected / 10 - 1).max())
    assert band.holds.all() and band.balanced.all() and not any(band.remarks)
    np.testing.assert_allclose(band.shifts, 0.0, atol=1e-12)


@pytest.mark.parametrize("rho", [1.0, 1.5, 2.0])
def test_a_servo_on_one_side_in_series_with_both_contacts(rho):
    """The other finger stands still: the depths of both contacts and the servo's deflection add up to what they were."""
    law, gain = MarhefkaOrin(stiffness=5e4, exponent=rho), 1400.0
    J = PRESSING[:, :1]
    band = force_band(jaws(law=law), CompliantHand(jacobian=J, gains=[gain]), FACTORS)
    whole = 2 * (10.0 / law.stiffness) ** (1 / rho) + 10.0 / gain
    expected = [
        brentq(
            lambda F, K: 2 * (F / K) ** (1 / rho) + F / gain - whole, 1e-3, 1e3, args=(s * law.stiffness,), xtol=1e-13
        )
        for s in FACTORS
    ]
    np.testing.assert_allclose(band.normal_forces, np.column_stack([expected] * 2), rtol=1e-8)
    # The finger that stands still keeps its place, and the object comes nearer to it the softer they are.
    depth = (np.array(expected) / (FACTORS * law.stiffness)) ** (1 / rho)
    np.testing.assert_allclose(band.shifts[:, 0], depth - depth[2], atol=1e-9)


def test_rigid_drives_give_forces_in_proportion_to_the_stiffness():
    band = force_band(jaws(), CompliantHand(jacobian=PRESSING, gains=[np.inf, np.inf]), FACTORS)
    np.testing.assert_allclose(band.normal_forces[:, 0], 10.0 * FACTORS, rtol=1e-9)


def paper_solution(hand, contacts, final_angles, make_problem):
    problem = make_problem(balance="wrench", friction=pg.Friction(model="cone", safety=1.3))
    solution = pg.optimize_forces(problem, 0.9)
    assert solution.status is pg.Status.OK
    return solution, torque_limits(hand, contacts, hand.configuration(final_angles), limit=100.0).jacobian


@pytest.fixture(scope="module")
def paper(hand, contacts, final_angles, make_problem):
    return paper_solution(hand, contacts, final_angles, make_problem)


def test_torque_control_gives_the_planned_forces(paper):
    """Three fingers with three joints or more each: their torques determine all contact forces."""
    solution, jacobian = paper
    hand = CompliantHand.at(solution.problem.contacts, jacobian, gains=np.zeros(jacobian.shape[2]))
    assert np.linalg.matrix_rank(hand.jacobian, tol=1e-6) == 9
    band = force_band(solution, hand)
    np.testing.assert_allclose(band.forces_c, np.tile(solution.forces_c, (6, 1, 1)), atol=1e-8)
    assert band.deviation < 1e-8 and band.holds.all()


@pytest.mark.parametrize("gain", [0.5, 5.0, 50.0])
@pytest.mark.parametrize("factor", [0.2, 20.0])
def test_a_convex_solver_finds_the_same_forces(paper, gain, factor):
    """The energy written again in CVXPY: all joints, no eliminated motions, and friction enough for no contact to slip."""
    solution, jacobian = paper
    solution = solution_of(solution.problem.contacts, solution.forces_c, mu=20.0)
    problem, planned = solution.problem, np.array(solution.forces_c)
    law, n, k = problem.compliance, jacobian.shape[2], problem.k
    hand = CompliantHand.at(problem.contacts, jacobian, gains=np.full(n, gain))
    band = force_band(solution, hand, [factor])

    # Lengths in mm: solvers like numbers near one.
    lateral = np.diag(contact_stiffness(law, planned[:, 2])).reshape(k, 3)[:, 0]
    q, x = cp.Variable(n), cp.Variable(6)  # [mrad], [mm, mrad]
    moved = hand.jacobian @ q - problem.contacts.G.T @ x
    depth = 1e3 * (planned[:, 2] / law.stiffness) ** (2 / 3) + moved[2::3]
    aside = [1e3 * planned[:, j] / lateral + moved[j::3] for j in (0, 1)]
    softer = lateral * factor ** (2 / 3) / 1e3
    K = factor * law.stiffness / 1e3**1.5
    stored = K / 2.5 * cp.sum(cp.power(cp.pos(depth), 2.5)) + sum(cp.sum(cp.multiply(softer, a**2)) for a in aside) / 2
    servo = gain / 1e3 * cp.sum_squares(q) / 2 - (hand.jacobian.T @ planned.ravel()) @ q
    work = problem.load @ x
    cp.Problem(cp.Minimize(stored + servo - work)).solve(solver=cp.CLARABEL)
    expected = K * np.maximum(depth.value, 0) ** 1.5
    np.testing.assert_allclose(band.normal_forces[0], expected, rtol=2e-4)
    np.testing.assert_allclose(band.shifts[0], x.value / 1e3, atol=1e-3 * np.abs(x.value).max() / 1e3)


def test_forces_always_balance_the_load(paper):
    solution, jacobian = paper
    hand = CompliantHand.at(solution.problem.contacts, jacobian, gains=np.full(jacobian.shape[2], 5.0))
    band = force_band(solution, hand)
    assert band.balanced.all()
    for forces in band.forces_c:
        left = solution.problem.residual(forces)
        assert np.linalg.norm(left) < 1e-7
    np.testing.assert_allclose(band.forces_c[2], solution.forces_c, atol=1e-8)  # factor 1
    np.testing.assert_allclose(band.shifts[2], 0.0, atol=1e-12)


def test_small_changes_are_those_of_the_linear_map(paper):
    """dF/ds at factor 1: contacts of (1 + ds) K press by f* ds more (rho = 1), and the grasp gives way to that."""
    solution, jacobian = paper
    forces = np.array(solution.forces_c)
    linear = solution_of(solution.problem.contacts, forces, compliance=LINEAR)
    hand = CompliantHand.at(linear.problem.contacts, jacobian, gains=np.full(jacobian.shape[2], 5.0))
    step = 1e-5
    low, high = force_band(linear, hand, [1 - step, 1 + step]).forces_c
    K, G, J = contact_stiffness(LINEAR, forces[:, 2]), linear.problem.contacts.G, hand.jacobian
    T = np.hstack([J, -G.T])
    stiff = T.T @ K @ T
    stiff[: hand.n, : hand.n] += 5.0 * np.eye(hand.n)
    expected = forces.ravel() - K @ T @ np.linalg.solve(stiff, T.T @ forces.ravel())
    np.testing.assert_allclose((high - low).ravel() / (2 * step), expected, rtol=1e-5, atol=1e-6)


def test_too_large_forces_do_not_hold():
    capped = jaws(max_normal_force=12.0)
    band = force_band(capped, CompliantHand(jacobian=PRESSING, gains=[1400.0] * 2), [0.2, 1.0, 20.0])
    assert band.holds.tolist() == [True, True, False]
    assert band.remarks[:2] == ("", "") and "left presses with" in band.remarks[2] and "right" in band.remarks[2]


def test_torques_beyond_their_limits_do_not_hold():
    jacobian = np.zeros((2, 6, 2))
    jacobian[0, 0, 0], jacobian[1, 0, 1] = 1.0, -1.0
    limits = TorqueLimits(jacobian=jacobian, bias=np.zeros(2), limit=[11.0, 100.0], joints=("one", "two"))
    band = force_band(jaws(torques=limits), CompliantHand(jacobian=PRESSING, gains=[1400.0] * 2), [1.0, 20.0])
    assert band.holds.tolist() == [True, False]
    assert "one needs a torque" in band.remarks[1] and "two" not in band.remarks[1]


@pytest.mark.parametrize("mu", [0.25, 0.0])
def test_what_hangs_by_friction_slips_where_the_squeeze_is_less(mu):
    """Jaws hold 4 N aside with 10 N each at mu = 0.25: 2 N each, 80 % of their friction."""
    contacts = jaws().problem.contacts
    forces = [[2.0, 0, 10.0], [2.0, 0, 10.0]]
    hand = CompliantHand(jacobian=PRESSING, gains=[14000.0] * 2)
    band = force_band(solution_of(contacts, forces, mu=mu, compliance=LINEAR), hand, [0.2, 1.0, 20.0])
    np.testing.assert_allclose(band.forces_c[:, :, 0], 2.0, rtol=1e-9)
    if mu:
        np.testing.assert_allclose(band.friction, 2.0 / (mu * band.normal_forces), rtol=1e-9)
    else:
        assert np.all(np.isinf(band.friction))
    assert band.holds.tolist() == [False, mu > 0, mu > 0]
    assert "left slips" in band.remarks[0]


@pytest.mark.parametrize("model", ["pyramid", "cone", "soft"])
def test_where_some_contacts_slip_the_others_hold_what_they_do_not(model):
    """Two pairs of jaws hold 8 N along z; the pair on servos presses less on softer contacts, the other as before."""
    directions = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    contacts = make_contacts(-0.03 * directions, directions)
    J = np.zeros((12, 4))
    J[[2, 5, 8, 11], range(4)] = 1.0
    hand = CompliantHand(jacobian=J, gains=[14000.0, 14000.0, 0.0, 0.0])
    friction = pg.Friction(model=model, torsion=0.01 if model == "soft" else 0.0, safety=1.5)
    solution = solution_of(contacts, [[2.0, 0, 10.0]] * 4, mu=0.4, compliance=LINEAR, friction=friction)
    band = force_band(solution, hand, [0.2, 1.0])
    C, C_h = 1 / LINEAR.stiffness, 1 / 14000.0
    pressed = 10.0 * (C + C_h) / (5 * C + C_h)
    np.testing.assert_allclose(band.forces_c[0, :, 2], [pressed, pressed, 10.0, 10.0], rtol=1e-8)
    np.testing.assert_allclose(band.forces_c[0, :, 0], [0.4 * pressed] * 2 + [4.0 - 0.4 * pressed] * 2, rtol=1e-8)
    np.testing.assert_allclose(band.friction[0, :2], 1.0, rtol=1e-8)

    assert band.holds.all() and band.friction[0, 2] < 1.0


def test_contacts_open_rather_than_pull():
    """A wedge of loads: the soft grasp lets one contact go, and says that nothing balances the rest."""
    contacts = jaws().problem.contacts
    law = MarhefkaOrin(stiffness=4000.0, exponent=1.5)
    forces = [[0, 0, 12.0], [0, 0, 1.0]]  # the load pushes with 11 N against the left one
    band = force_band(
        solution_of(contacts, forces, compliance=law),
        CompliantHand(jacobian=0 * PRESSING, gains=[np.inf] * 2),
        [0.05, 1.0],
    )
    assert np.all(band.normal_forces >= 0) and band.balanced.all()
    np.testing.assert_allclose(band.normal_forces[0], [11.0, 0.0], atol=1e-7)


def test_gains_within_a_tolerance_are_those_of_the_closed_form():
    C, s = 1 / LINEAR.stiffness, FACTORS
    for tolerance in (0.02, 0.1, 0.5):
        found = gains_within(jaws(), CompliantHand(jacobian=PRESSING, gains=np.ones(2)), tolerance, factors=s)

        def off(log_gain):
            C_h = np.exp(-log_gain)
            return np.abs((C + C_h) / (C / s + C_h) - 1).max() - tolerance

        expected = np.exp(brentq(off, np.log(1e-3), np.log(1e7)))
        assert found.scale == pytest.approx(expected, rel=2e-4) and found.scale <= expected * (1 + 1e-9)
        np.testing.assert_allclose(found.gains, found.scale)
        assert found.monotonic and found.band.deviation <= tolerance


def test_ratios_of_gains_are_kept_and_other_drives_stay():
    hand = CompliantHand(jacobian=np.hstack([PRESSING, 0 * PRESSING]), gains=[3.0, 1.0, np.inf, 0.0])
    found = gains_within(jaws(), hand, 0.1)
    assert found.gains[0] == pytest.approx(3 * found.gains[1]) and found.gains[1] == found.scale
    assert found.gains[2] == np.inf and found.gains[3] == 0.0
    square = CompliantHand(jacobian=PRESSING, gains=np.diag([3.0, 1.0]))
    assert gains_within(jaws(), square, 0.1).scale == pytest.approx(found.scale, rel=2e-4)


def test_wide_tolerances_allow_rigid_drives_and_rigid_hands_none():
    hand = CompliantHand(jacobian=PRESSING, gains=np.ones(2))
    assert gains_within(jaws(), hand, 19.5).scale == np.inf
    assert np.isinf(gains_within(jaws(), hand, 19.5).gains).all()
    # One drive yields, and moves no contact: the others are rigid whatever its gain.
    stiff = CompliantHand(jacobian=np.hstack([PRESSING, 0 * PRESSING[:, :1]]), gains=[np.inf, np.inf, 1.0])
    none = gains_within(jaws(), stiff, 0.1)
    assert none.scale == 0.0 and none.gains[2] == 0.0 and none.band.deviation == pytest.approx(19.0)


ONES = CompliantHand(jacobian=PRESSING, gains=np.ones(2))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: force_band(jaws(), ONES, []), "stiffness factors"),
        (lambda: force_band(jaws(), ONES, [0.0]), "stiffness factors"),
        (lambda: force_band(jaws(), ONES, [np.inf]), "stiffness factors"),
        (lambda: force_band(jaws(), ONES, 2.0), "stiffness factors"),
        (lambda: force_band("plan", ONES), "ForceSolution"),
        (lambda: force_band(jaws(), None), "CompliantHand"),
        (
            lambda: force_band(jaws(), CompliantHand(jacobian=np.ones((9, 2)), gains=[1, 1])),
            "2 contacts, got that of 3",
        ),
        (lambda: force_band(jaws(), ONES, tangential_ratio=-1), "tangential"),
        (lambda: force_band(jaws(law=MarhefkaOrin(exponent=0.5)), ONES), "exponent >= 1"),
        (lambda: force_band(jaws(0.0), ONES), "no squeeze"),
        (lambda: gains_within(jaws(), ONES, 0.0), "tolerance"),
        (lambda: gains_within(jaws(), CompliantHand(jacobian=PRESSING, gains=[0, np.inf]), 0.1), "servo gains"),
    ],
)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(pg.PinograspError, match=words):
        call()


def test_friction_without_lateral_stiffness_is_refused():
    hanging = solution_of(jaws().problem.contacts, [[1.0, 0, 10.0]] * 2)
    with pytest.raises(pg.PinograspError, match="tangential_ratio > 0"):
        force_band(hanging, ONES, tangential_ratio=0.0)


def test_a_solution_without_forces_is_refused(make_problem):
    heavy = make_problem(max_normal_force=0.5, friction=pg.Friction(model="cone"))
    none = pg.optimize_forces(heavy, 0.9)
    assert not none.found
    with pytest.raises(pg.PinograspError, match="expected one with forces"):
        force_band(none, CompliantHand(jacobian=np.ones((9, 2)), gains=[1, 1]))


@pytest.mark.parametrize("factor", [0.3, 1.0, 8.0])
@pytest.mark.parametrize(("law", "off"), [(LINEAR, 1e-6), (MarhefkaOrin(), 0.2)])
def test_scenarios_follow_the_band_to_first_order(paper, factor, law, off):
    """They are the band's forces at the solution, and near it: exactly on linear contacts, which stick here; on others
    but for the tangential stiffness, which stays that of the solution.
    """
    contacts, planned, jacobian = paper[0].problem.contacts, np.array(paper[0].forces_c), paper[1]
    hand = CompliantHand.at(contacts, jacobian, gains=np.full(jacobian.shape[2], 5.0))
    (one,) = stiffness_scenarios(solution_of(contacts, planned, compliance=law, mu=20.0), hand, [factor])

    def missed(forces):
        band = force_band(solution_of(contacts, forces, compliance=law, mu=20.0), hand, [factor])
        said = one.normal @ forces[:, 2] + one.tangential @ forces[:, :2].ravel() + one.offset
        return np.abs(said - band.normal_forces[0]).max()

    inner = np.random.default_rng(3).normal(size=planned.size)
    inner -= np.linalg.pinv(contacts.G) @ (contacts.G @ inner)
    inner *= 0.01 * planned[:, 2].min() / np.abs(inner).max()
    assert missed(planned) < 1e-7
    assert missed(planned + inner.reshape(planned.shape)) < off * np.abs(inner).max()


def test_drives_that_make_other_efforts_than_they_are_told():
    """Each makes s (F* - g z): F (2c + 1/(s1 g1) + 1/(s2 g2)) = F* (2c + 1/g1 + 1/g2) on both sides."""
    gains, share = (800.0, 3000.0), 0.3
    found = drive_scenarios(jaws(), CompliantHand(jacobian=PRESSING, gains=gains), share)
    by_drive = [(1 - share,) * 2, (1 + share,) * 2, *((1 - share, 1), (1 + share, 1), (1, 1 - share), (1, 1 + share))]
    assert len(found) == len(by_drive)
    for one, told in zip(found, by_drive):
        made = 2 / 4000.0 + sum(1 / (s * g) for s, g in zip(told, gains))
        expected = (2 / 4000.0 + sum(1 / g for g in gains)) / made
        assert one.normal.sum(axis=1) == pytest.approx([expected, expected]) and np.abs(one.offset).max() < 1e-6
    torques = drive_scenarios(jaws(), CompliantHand(jacobian=PRESSING, gains=[1e-6, 1e-6]), share)
    assert torques[0].normal.sum(axis=1) == pytest.approx([0.7, 0.7], rel=1e-6)
    rigid = drive_scenarios(jaws(), CompliantHand(jacobian=PRESSING, gains=[np.inf, np.inf]), share)
    assert all(one.normal.sum(axis=1) == pytest.approx([1.0, 1.0]) for one in rigid)
    with pytest.raises(InvalidInput, match="share of the drives' efforts: expected a share from 0 to below 1"):
        drive_scenarios(jaws(), CompliantHand(jacobian=PRESSING, gains=gains), 1.0)


def test_scenarios_of_drives_follow_the_equilibrium_to_first_order(paper):
    """At the solution they are its own forces there; near it, those of a solution that is near."""
    contacts, planned, jacobian = paper[0].problem.contacts, np.array(paper[0].forces_c), paper[1]
    hand = CompliantHand.at(contacts, jacobian, gains=np.full(jacobian.shape[2], 5.0))
    inner = np.random.default_rng(secrets.randbelow(2**32)).normal(size=planned.size)
    inner -= np.linalg.pinv(contacts.G) @ (contacts.G @ inner)
    inner = (0.01 * planned[:, 2].min() / np.abs(inner).max() * inner).reshape(planned.shape)
    told, near = (
        drive_scenarios(solution_of(contacts, forces, compliance=LINEAR, mu=20.0), hand, 0.3)
        for forces in (planned, planned + inner)
    )

    def normal_forces(one, forces):
        return one.normal @ forces[:, 2] + one.tangential @ forces[:, :2].ravel() + one.offset

    for one, other in zip(told, near):
        there = normal_forces(other, planned + inner)
        assert np.abs(normal_forces(one, planned + inner) - there).max() < 1e-6 * planned[:, 2].max()


def test_scenarios_of_a_servo_in_series_with_both_jaws():
    """Springs c of either contact and 1/g of the drive: F' = F* (2c + 1/g) / (2c/s + 1/g) on both sides."""
    hand = CompliantHand(jacobian=PRESSING, gains=[800.0, np.inf])
    for one, factor in zip(stiffness_scenarios(jaws(), hand, [0.25, 4.0]), (0.25, 4.0)):
        share = (2 / 4000.0 + 1 / 800.0) / (2 / (factor * 4000.0) + 1 / 800.0)
        assert one.normal.sum(axis=1) == pytest.approx([share, share]) and np.abs(one.offset).max() < 1e-6
