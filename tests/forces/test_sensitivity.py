"""Derivatives of optimal forces and of their cost against finite differences; contact points that move downhill."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import around_cylinder
from marks import slow_except

import pinograsp as pg
from pinograsp.contacts import ContactSet
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import force_sensitivity, optimize_contacts

MODELS = {
    "cone": pg.Friction(model="cone", safety=1.1),
    "pyramid": pg.Friction(),
    "soft": pg.Friction(model="soft", torsion=4e-3),
    "cone, torsion": pg.Friction(model="cone", torsion=4e-3),
}
IMPACT, STEP = 0.9, 1e-5
BODY = pg.Cylinder(radius=0.03, height=0.3, mass=0.2)


def problem_of(seed, friction, k=4, balance="wrench"):
    rng = np.random.default_rng(seed)
    while True:
        contacts = pg.contacts_at(None, BODY, around_cylinder(rng, k, 0.03, jitter=0.4))
        load = np.append(rng.normal(size=3), 0.01 * rng.normal(size=3))
        problem = pg.ForceProblem(
            contacts=contacts,
            load=load,
            mu=rng.uniform(0.5, 0.9, k),
            friction=friction,
            balance=balance,
            moment_length=0.03,
            max_depth=5e-3,
        )
        if pg.optimize_forces(problem, IMPACT).status is Status.OK:
            return problem


def changed(problem, i, point=None, turn=None):
    """With contact i moved, or its frame turned by a rotation vector."""
    contacts = list(problem.contacts)
    own = contacts[i]
    if point is not None:
        own = replace(own, point_o=own.point_o + point)
    if turn is not None:
        own = replace(own, rotation_oc=pin.exp3(np.asarray(turn)) @ own.rotation_oc)
    contacts[i] = own
    return replace(problem, contacts=ContactSet(contacts=tuple(contacts), com_o=problem.contacts.com_o))


def differences(make, objective, size=STEP):
    """Central differences of forces and cost of ``make(step)``; None where a limit becomes active or stops being so."""
    ends = [pg.optimize_forces(make(sign * size), IMPACT, objective=objective) for sign in (1, -1)]
    if any(end.status is not Status.OK for end in ends):
        return None
    one, other = (end.certificate for end in ends)
    if any(np.any(getattr(one, name) != getattr(other, name)) for name in ("at_friction", "at_least", "at_most")):
        return None
    return (ends[0].forces_c - ends[1].forces_c) / (2 * size), (one.objective - other.objective) / (2 * size)


@pytest.mark.parametrize("objective", ["least_squares", {"work": 1.0, "least_squares": 1e-3}, "work"])
@pytest.mark.parametrize("name", slow_except(MODELS, "cone"))
def test_derivatives_are_the_limits_of_differences(name, objective):
    checked = 0
    for seed, balance in ((1, "wrench"), (2, "wrench"), (3, "force")):
        problem = problem_of(seed, MODELS[name], balance=balance)
        solution = pg.optimize_forces(problem, IMPACT, objective=objective)
        own = force_sensitivity(solution)
        cases = [
            (
                lambda h, r=r: problem.with_load(problem.load + h * np.eye(6)[r]),
                own.forces_load[:, :, r],
                own.cost_load[r],
            )
            for r in range(6)
        ]
        for i in range(problem.k if own.unique else 0):
            cases.append(
                (
                    lambda h, i=i: replace(problem, mu=problem.mu + h * np.eye(problem.k)[i]),
                    own.forces_mu[:, :, i],
                    own.cost_mu[i],
                )
            )
            for c in range(3):
                step = np.eye(3)[c]
                # A metre of contact is much: a tenth of the step.
                cases.append(
                    (
                        lambda h, i=i, s=step: changed(problem, i, point=0.1 * h * s),
                        0.1 * own.forces_points[:, :, i, c],
                        0.1 * own.cost_points[i, c],
                    )
                )
                cases.append(
                    (
                        lambda h, i=i, s=step: changed(problem, i, turn=h * s),
                        own.forces_turns[:, :, i, c],
                        own.cost_turns[i, c],
                    )
                )
        scale = solution.certificate.objective
        for make, by_forces, by_cost in cases:
            found = differences(make, objective)
            if found is None:
                continue
            checked += 1
            assert by_cost == pytest.approx(found[1], rel=2e-3, abs=2e-4 * scale)
            if own.unique:
                assert by_forces == pytest.approx(found[0], rel=5e-3, abs=5e-3 * max(1.0, np.abs(found[0]).max()))
        assert objective == "work" or own.unique
    assert checked >= (60 if objective != "work" else 12)


def test_a_contact_without_friction_has_derivatives():
    problem = problem_of(4, MODELS["cone"])
    problem = replace(problem, mu=problem.mu * [1, 1, 0, 1])
    solution = pg.optimize_forces(problem, IMPACT, objective="least_squares")
    assert solution.status is Status.OK
    own = force_sensitivity(solution)
    assert own.unique and np.isfinite(own.forces_points).all()
    for make, by_forces in (
        (lambda h: problem.with_load(problem.load + h * np.eye(6)[2]), own.forces_load[:, :, 2]),
        (lambda h: changed(problem, 2, turn=[0, h, 0]), own.forces_turns[:, :, 2, 1]),
        (lambda h: changed(problem, 2, point=[0, 0, 0.1 * h]), 0.1 * own.forces_points[:, :, 2, 2]),
    ):
        found, _ = differences(make, "least_squares")
        assert by_forces == pytest.approx(found, abs=5e-3 * max(1.0, np.abs(found).max()))


APEX = [[-0.029, -0.007, 0.008], [0.002, 0.03, 0.008], [-0.023, 0.019, 0.005]]
APEX += [[-0.02, 0.022, -0.033], [0.025, 0.017, 0.033], [0.01, 0.028, 0.021]]


@pytest.mark.parametrize("objective", ["work", "impulse", {"work": 1.0, "least_squares": 1e-4}, "least_squares"])
@pytest.mark.parametrize("name", MODELS)
def test_the_cost_of_load_is_right_where_contacts_are_at_the_apex_of_their_cones(name, objective):
    """The optimal cost is convex in the load: no difference quotient to the right is below a derivative, none to the
    left above it. Quotients over 1e-3 N come within their curvature of it."""
    load = np.array([0.59, 0.88, 1.05, -0.02, 0.0, 0.02])
    problem = pg.ForceProblem(
        contacts=pg.contacts_at(None, BODY, APEX),
        load=load,
        mu=0.8,
        acceleration_range=(1e-6, 1.0),
        max_depth=0.01,
        friction=MODELS[name],
    )
    solution = pg.optimize_forces(problem, IMPACT, objective=objective)
    cost = solution.certificate.objective
    own = force_sensitivity(solution)
    if objective == "work" and name == "cone":
        assert solution.normal_forces.min() < 1e-6  # at the apex
    noise = 2e-6 * cost  # twice the gap that a certificate allows
    for r, step in enumerate(np.diag([1e-3] * 3 + [3e-5] * 3)):
        up, down = (
            pg.optimize_forces(problem.with_load(load + sign * step), IMPACT, objective=objective).certificate.objective
            for sign in (1, -1)
        )
        change = own.cost_load[r] * step[r]
        assert cost - down - noise <= change <= up - cost + noise
        assert change == pytest.approx((up - down) / 2, abs=noise + 0.1 * (up - 2 * cost + down))


def test_at_a_jump_the_cost_of_load_is_between_the_derivatives_to_either_side():
    """Two jaws at their least F_n hold up to 2 mu F_n across; more load needs F_n = load / (2 mu) of each."""
    box = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
    problem = pg.ForceProblem(
        contacts=pg.contacts_at(None, box, [[0.02, 0, 0], [-0.02, 0, 0]]),
        load=np.zeros(6),
        mu=0.5,
        friction=pg.Friction(model="cone"),
        balance="force",
        min_normal_force=2.0,
        max_depth=5e-3,
    )
    ends = []
    for weight in (1.9, 2.0, 2.1):
        solution = pg.optimize_forces(problem.with_load([0, 0, -weight, 0, 0, 0]), IMPACT, objective="work")
        ends.append(force_sensitivity(solution))
    below, at, above = (-end.cost_load[2] for end in ends)
    terms = problem.energy_terms(IMPACT, "work")
    slope = sum(2 * c * p * 2.1 ** (p - 1) for c, p in terms)  # of two jaws, F_n = load / (2 mu) = load
    assert below == pytest.approx(0.0, abs=1e-9) and above == pytest.approx(slope, rel=1e-6)
    assert -1e-9 <= at <= slope and not ends[1].unique


def test_multipliers_price_the_load():
    problem = problem_of(5, MODELS["cone"])
    solution = pg.optimize_forces(problem, IMPACT, objective="least_squares")
    own = force_sensitivity(solution)
    assert own.multipliers == pytest.approx(own.cost_load, abs=1e-9)
    # Forces that are doubled with their load cost four times as much: Euler's theorem, where no bound of F_n is active.
    certificate = solution.certificate
    if not (certificate.at_least.any() or certificate.at_most.any()):
        assert own.cost_load @ problem.load == pytest.approx(2 * certificate.objective, rel=1e-6)


@pytest.mark.parametrize("name", ["cone", "pyramid"])
def test_contacts_move_downhill_on_the_surface(name):
    problem = problem_of(7, MODELS[name])
    for objective in ("work", "least_squares"):
        better = optimize_contacts(problem, BODY, IMPACT, objective=objective, reach=8e-3)
        start = pg.optimize_forces(problem, IMPACT, objective=objective)
        assert better.costs[0] == pytest.approx(start.certificate.objective, rel=1e-9)
        assert list(better.costs) == sorted(better.costs, reverse=True) and better.costs[-1] < 0.97 * better.costs[0]
        points = better.contacts.points_o
        assert np.hypot(*points.T[:2]) == pytest.approx(np.full(4, 0.03), abs=1e-9)
        assert np.linalg.norm(points - problem.contacts.points_o, axis=1).max() <= 8e-3 * (1 + 1e-9)
        again = pg.optimize_forces(better.problem, IMPACT, objective=objective, solver="clarabel")
        assert again.certificate.objective == pytest.approx(better.costs[-1], rel=1e-6)


def test_what_has_no_derivative_is_refused():
    problem = problem_of(1, MODELS["cone"])
    heavy = pg.optimize_forces(problem.with_load(1e4 * problem.load), IMPACT)
    for solution, message in (
        (heavy, "infeasible"),
        (pg.optimize_forces(problem, IMPACT, objective="peak"), "peak"),
        (pg.optimize_forces(replace(problem, friction=pg.Friction(edges=8)), IMPACT), "4 edges"),
        (
            pg.grid_search(
                problem_of(1, MODELS["pyramid"], k=2, balance="force"),
                pg.GridSpec(accelerations=[0.1, 0.5]),
                progress=False,
            ),
            "expected a ConvexSolution, got GridSolution",
        ),
    ):
        with pytest.raises(InvalidInput, match=message):
            force_sensitivity(solution)
    with pytest.raises(InvalidInput, match="hold the load"):
        optimize_contacts(problem.with_load(1e4 * problem.load), BODY, IMPACT)
    with pytest.raises(InvalidInput, match="reach"):
        optimize_contacts(problem, BODY, IMPACT, reach=0.0)
