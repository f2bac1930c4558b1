"""The squeeze that holds a set of loads: against another solver, against every load of the set, and when there is none."""

from __future__ import annotations

import secrets
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from conftest import make_contacts

import pinograsp as pg
from pinograsp.contacts import Friction, contacts_at
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    LoadSet,
    SqueezeScenario,
    TorqueLimits,
    disturbance_margin,
    optimize_forces,
    optimize_reserve,
    optimize_robust,
    producible_reserve,
    reserve_along,
)
from pinograsp.forces.robust import program as robust_room
from pinograsp.motion import MotionSpec, plan_motion

CONE = Friction(model="cone")


def oracle(problem, wrenches, impact_time):
    """Least work, or None: CVXPY and ECOS, one F_n for all loads, tangential forces per load."""
    k = problem.k
    low, high = problem.normal_force_range(impact_time)
    size = float(np.linalg.norm(problem.load[:3]))
    F = cp.Variable(k)
    rows = [low / size <= F, high / size >= F]
    G = np.array(problem.contacts.G).reshape(6, k, 3)
    G[3:] /= problem.moment_length
    for wrench in wrenches:
        u = cp.Variable((k, 2))
        load = np.append(wrench[:3], wrench[3:] / problem.moment_length) / size
        net = sum(G[:, i, :2] @ u[i] + G[:, i, 2] * F[i] for i in range(k)) + load
        rows.append(net[: problem.rows] == 0)
        if problem.friction.model == "pyramid":
            rows.append(
                cp.abs(u) <= cp.reshape(cp.multiply(problem.mu / np.sqrt(2), F), (k, 1), order="C") @ np.ones((1, 2))
            )
        else:
            rows.append(cp.norm(u, axis=1) <= cp.multiply(problem.mu, F))
    terms = problem.energy_terms(impact_time, "work")
    unit = terms[0][0] * size ** terms[0][1]
    cost = sum(c * size**e / unit * cp.sum(cp.power(F, e)) for c, e in terms)
    found = cp.Problem(cp.Minimize(cost), rows)
    found.solve(solver="ECOS", abstol=1e-10, reltol=1e-10, feastol=1e-10)
    return None if found.status not in ("optimal", "optimal_inaccurate") else found.value * unit


@pytest.mark.parametrize("friction", [Friction(), CONE], ids=["pyramid", "cone"])
@pytest.mark.parametrize("balance", ["force", "wrench"])
def test_equal_to_another_solver(make_problem, friction, balance):
    problem = make_problem(balance=balance, friction=friction, measure="work")
    loads = LoadSet.around(problem.load, mass_range=(0.8, 1.15))
    pushed = LoadSet(loads=problem.load + 0.3 * np.random.default_rng(0).normal(size=(5, 6)) * [1, 1, 1, 0, 0, 0])
    for each in (loads, pushed):
        found = optimize_robust(problem, each, 0.82, objective="work")
        expected = oracle(problem, each.loads, 0.82)
        if expected is None:
            assert found.status is Status.INFEASIBLE
        else:
            assert found.status is Status.OK and found.certificate.objective == pytest.approx(expected, rel=1e-6)
            assert found.certificate.is_optimal()


def test_a_single_load_is_the_ordinary_optimum(make_problem):
    for settings in ({}, {"friction": CONE}, {"friction": Friction(model="soft", torsion=0.002)}):
        problem = make_problem(balance="wrench", **settings)
        for objective in ("work", "impulse", "peak"):
            robust = optimize_robust(problem, LoadSet(loads=[problem.load]), 0.85, objective=objective)
            plain = optimize_forces(problem, 0.85, objective=objective)
            assert robust.certificate.objective == pytest.approx(plain.certificate.objective, rel=1e-6)


def test_every_load_of_the_hull_is_held(make_problem):
    problem = make_problem(balance="wrench", friction=CONE, measure="work")
    loads = LoadSet.around(problem.load, mass_range=(0.9, 1.2))
    found = optimize_robust(problem, loads, 0.82)
    weights = np.random.default_rng(0).dirichlet(np.ones(len(loads.loads)), size=10)
    for load in weights @ loads.loads:
        assert disturbance_margin(replace(problem, load=load), problem.load, normal_forces=found.normal_forces) >= -1e-6
    # And no more: one of the vertices is at the edge.
    nominal = optimize_forces(problem, 0.82)
    assert found.certificate.objective > nominal.certificate.objective * 1.05


def test_every_disturbance_of_the_ball_is_met_by_the_response(make_problem):
    problem = make_problem(balance="wrench", friction=CONE, measure="work")
    found = optimize_robust(problem, LoadSet.around(problem.load, ball=0.1), 0.82)
    assert found.status is Status.OK and found.certificate.is_optimal()
    rng = np.random.default_rng(0)
    scale = found.problem.friction.scale(found.problem.mu)
    scaled = found.problem.scaled_columns
    u0 = found.forces_c[0][:, :2] / scale
    for _ in range(200):
        w = rng.normal(size=6)
        w *= 0.1 / np.linalg.norm(w)
        tangential = (u0 + found.response @ w) * scale
        assert np.all(np.linalg.norm(tangential, axis=1) <= problem.mu * found.normal_forces * (1 + 1e-6))
        net = np.einsum("rkc,kc->r", scaled[:, :, :2], tangential) + scaled[:, :, 2] @ found.normal_forces
        assert np.abs(net + problem.scaled_load + w).max() < 1e-6
    larger = optimize_robust(problem, LoadSet.around(problem.load, ball=0.12), 0.82)
    assert larger.certificate.objective > found.certificate.objective


def test_a_box_of_disturbances_in_force_balance(make_problem):
    problem = make_problem(balance="force", measure="work")
    found = optimize_robust(problem, LoadSet.around(problem.load, box=[0.2, 0.2, 0.2, 1e-3, 1e-3, 1e-3]), 0.82)
    assert found.status is Status.OK and len(found.balanced) == 8  # moments play no part
    assert found.forces_c.shape == (8, 3, 3) and "hold all of 8 loads" in found.explain()


def test_the_least_friction_of_a_range_decides(make_problem):
    problem = make_problem(balance="wrench", measure="work")
    loads = LoadSet(loads=[problem.load])
    ranged = optimize_robust(problem, loads, 0.82, mu_range=(0.65, 0.9))
    low = optimize_robust(replace(problem, mu=0.65), loads, 0.82)
    assert ranged.certificate.objective == pytest.approx(low.certificate.objective, rel=1e-9)


def test_a_load_that_cannot_be_held_is_proven(make_problem):
    problem = make_problem(balance="wrench", measure="work")
    found = optimize_robust(problem, LoadSet.around(problem.load, mass_range=(1.0, 3.0)), 0.85)
    assert found.status is Status.INFEASIBLE and found.infeasibility.margin > 0
    assert "cannot be held even alone" in found.explain()


def test_loads_that_exclude_each_other(make_problem):
    """Each load can be held by itself, but no single squeeze does for both."""
    problem = make_problem(balance="wrench", measure="work")
    found = optimize_robust(problem, LoadSet.around(problem.load, box=[0.2, 0.2, 0.2, 0, 0, 0]), 0.85)
    assert found.status is Status.INFEASIBLE and found.infeasibility is None
    assert "no common normal forces" in found.explain() and found.certificate is None


def test_torque_limits_hold_for_every_load(make_problem, contacts):
    problem = make_problem(balance="force", measure="work")
    rng = np.random.default_rng(5)
    J = np.concatenate([rng.normal(size=(3, 3, 4)) * 0.05, np.zeros((3, 3, 4))], axis=1)
    loads = LoadSet.around(problem.load, mass_range=(0.9, 1.1))
    free = optimize_robust(problem, loads, 0.82)
    limits = TorqueLimits(jacobian=J, bias=np.zeros(4), limit=np.full(4, 10.0))

    def torques(found):
        forces_o = np.einsum("kij,skj->ski", contacts.rotations_oc, found.forces_c)
        return np.abs([limits.torques(f) for f in forces_o])

    limit = 0.98 * torques(free).max()
    limited = optimize_robust(
        replace(problem, torques=TorqueLimits(jacobian=J, bias=np.zeros(4), limit=np.full(4, limit))), loads, 0.82
    )
    if limited.status is Status.OK:
        assert torques(limited).max() <= limit * (
            1 + 1e-6
        ) and limited.certificate.objective > free.certificate.objective * (1 + 1e-9)
    else:
        assert limited.status is Status.INFEASIBLE


def test_unusable_sets(make_problem):
    problem = make_problem(balance="wrench")
    load = problem.load
    for bad in (
        lambda: LoadSet(loads=np.zeros((0, 6))),
        lambda: LoadSet(loads=[[1, 2, 3]]),
        lambda: LoadSet(loads=[load], ball=-1),
        lambda: LoadSet.around(load, mass_range=(1.2, 0.9)),
        lambda: LoadSet.around(load, box=[-1, 0, 0, 0, 0, 0]),
        lambda: optimize_robust(problem, LoadSet(loads=[load]), 0.85, objective="least_squares"),
        lambda: optimize_robust(problem, LoadSet(loads=[load]), 0.85, mu_range=(0.9, 0.5)),
        lambda: optimize_robust(problem, LoadSet(loads=[load]), float("nan")),
        lambda: optimize_robust(
            replace(problem, friction=Friction(model="soft", torsion=1e-3)), LoadSet(loads=[load], ball=0.1), 0.85
        ),
    ):
        with pytest.raises(InvalidInput):
            bad()


@pytest.mark.parametrize("compiled", [False, True])
def test_crossed_bounds(make_problem, monkeypatch, compiled):
    monkeypatch.setattr(robust_room.core, "is_installed", lambda: compiled)
    problem = make_problem(balance="wrench", max_normal_force=1e-3)
    assert optimize_robust(problem, LoadSet(loads=[problem.load]), 0.8).status is Status.INFEASIBLE


def test_the_load_that_cannot_be_held_is_found_in_bulk(make_problem, monkeypatch):
    """Where the core is installed all loads are looked at together: the proof is of the same load."""
    from pinograsp.forces.solve import batch

    problem = make_problem(balance="wrench", friction=CONE)
    load = np.array(problem.load)
    loads = LoadSet(loads=[0.2 * load, 0.5 * load, 0.9 * load, 40 * load, 0.4 * load])
    asked = []
    bulk = batch.solve_batch
    monkeypatch.setattr(batch, "solve_batch", lambda *args, **kwargs: asked.append(bulk(*args, **kwargs)) or asked[-1])
    found = optimize_robust(problem, loads, 0.85)
    assert [answer.ok.tolist() for answer in asked] == [[True, True, True, False, True]]
    monkeypatch.setattr(robust_room.core, "is_installed", lambda: False)
    plain = optimize_robust(problem, loads, 0.85)
    assert len(asked) == 1 and found.status is plain.status is Status.INFEASIBLE
    assert (
        found.infeasibility.margin == pytest.approx(plain.infeasibility.margin, rel=1e-9)
        and plain.infeasibility.margin > 0
    )


@pytest.mark.parametrize("name", ["pyramid", "cone", "soft", "ball"])
def test_forces_under_any_load_of_the_set_balance_it(make_problem, name):
    friction = {"cone": Friction(model="cone"), "soft": Friction(model="soft", torsion=0.003)}.get(name, Friction())
    problem = make_problem(balance="wrench", friction=friction)
    half = np.array([0.05, 0, 0.05, 0, 2e-4, 0])
    loads = LoadSet.around(problem.load, box=half, ball=0.05 if name == "ball" else 0.0)
    robust = optimize_robust(problem, loads, 0.82)
    assert robust.status is Status.OK
    rng = np.random.default_rng(0)
    inside = [problem.load + half * rng.uniform(-1, 1, 6) for _ in range(4)] + [loads.loads[0]]
    if name == "ball":
        inside.append(problem.load + half * [1, 0, 0, 0, 0, 0] + np.array([0.04, 0, 0, 0, 0, 0]))
    for load in [None, *inside]:
        found = robust.under(load)
        assert found.problem.load == pytest.approx(problem.load if load is None else load)
        assert found.normal_forces == pytest.approx(robust.normal_forces, rel=1e-12) and found.residual_norm < 1e-6
        used = np.column_stack([found.forces_c[:, :2], found.torsion])[:, : friction.d - 1] / friction.scale(problem.mu)
        assert np.all(friction.gauge(used) <= found.normal_forces * (1 + 1e-6))
        # Friction alone: the margin of the same normal forces says the same.
        assert disturbance_margin(found.problem, [0, 0, 1.0, 0, 0, 0], normal_forces=found.normal_forces) >= 0
    for outside in (problem.load + 4 * half, 2 * problem.load):
        with pytest.raises(InvalidInput, match="one of the set"):
            robust.under(outside)


def test_a_robust_squeeze_is_carried_out(hand, make_problem):
    problem = make_problem(balance="wrench")
    robust = optimize_robust(problem, LoadSet.around(problem.load, box=[0.1, 0, 0.1, 0, 0, 0]), 0.82)
    spec = MotionSpec(samples=1, time_step=0.02)
    motion = plan_motion(hand, robust.under(), spec)
    assert motion.status is Status.OK
    normals = np.einsum("kx,kx->k", motion.forces_o[-1], problem.contacts.rotations_oc[:, :, 2])
    assert normals == pytest.approx(robust.normal_forces, rel=1e-9)
    assert motion.forces_o[-1].sum(axis=0) == pytest.approx(-problem.load[:3], abs=1e-6)
    # More squeeze than the load alone asks for needs more torque.
    alone = plan_motion(hand, optimize_forces(problem, 0.82), spec)
    assert np.abs(motion.holding_torques).max() > np.abs(alone.holding_torques).max()
    nothing = optimize_robust(problem, LoadSet(loads=[100 * problem.load]), 0.85)
    with pytest.raises(InvalidInput, match="infeasible"):
        plan_motion(hand, nothing.under())
    with pytest.raises(InvalidInput, match="solution"):
        plan_motion(hand, problem)


def two_jaws(contact_set, mass=0.2):
    body = pg.Box(size=(0.04, 0.04, 0.06), mass=mass)
    rows = [("left", "", (0.02, 0, 0), (-1, 0, 0), None), ("right", "", (-0.02, 0, 0), (1, 0, 0), None)]
    friction = Friction(model="soft", torsion=0.005)
    limits = {"acceleration_range": (1e-6, 50.0), "max_depth": 5e-2}
    return pg.ForceProblem.holding(body, contact_set(rows), mu=0.6, friction=friction, **limits)


def four_on_a_ball():
    directions = np.array([[1.0, 0.0, 0.1], [-0.5, 0.8, -0.1], [-0.5, -0.8, 0.2], [0.0, 0.1, -1.0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    contacts = make_contacts(0.03 * directions, -directions, fingers=["any"] * 4)
    limits = {"acceleration_range": (1e-6, 50.0), "max_depth": 5e-3}
    return pg.ForceProblem.holding(pg.Sphere(radius=0.03, mass=0.3), contacts, mu=0.7, friction=CONE, **limits)


def test_two_jaws_bear_a_push_along_their_line_as_springs_alone(contact_set):
    problem = two_jaws(contact_set)
    push = np.array([1.2, 0, 0, 0, 0, 0])
    loads = LoadSet(loads=[problem.load, problem.load + push, problem.load - push])
    stiff = optimize_robust(problem, loads, 0.85, objective="peak")
    assert stiff.status is Status.INFEASIBLE  # F_n that does not change cannot balance it
    found = optimize_robust(problem, loads, 0.85, objective="peak", reaction="elastic")
    # Half of the push goes to either side, and the lighter pressed one still has to carry its half of the weight.
    weight = 0.2 * 9.81
    assert found.status is Status.OK
    assert found.normal_forces == pytest.approx([weight / 2 / 0.6 + 0.6] * 2, rel=1e-6)
    assert found.under(problem.load + push).normal_forces - found.normal_forces == pytest.approx([0.6, -0.6], abs=1e-6)
    assert found.under().normal_forces == pytest.approx(found.normal_forces, rel=1e-9)


def test_springs_of_every_contact_give_way_alike():
    """The reaction against the equilibrium of springs, solved for the displacement and the turn of the object."""
    problem = four_on_a_ball()
    body, contacts, directions = problem.object, problem.contacts, -problem.contacts.rotations_oc[:, :, 2]
    push = np.array([0.3, -0.2, 0.4, 0.002, 0.001, -0.003])
    found = optimize_robust(problem, LoadSet(loads=[problem.load, problem.load + push]), 0.85, reaction="elastic")
    stiffness = np.zeros((6, 6))
    arms = contacts.points_o - body.pose[:3, 3]
    for arm in arms:
        cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
        moved = np.hstack([np.eye(3), -cross])  # velocity of the point per twist of the object
        stiffness += moved.T @ moved
    twist = np.linalg.solve(stiffness, push)
    pressed = [-(twist[:3] + np.cross(twist[3:], arm)) @ -d for arm, d in zip(arms, directions)]
    assert found.under(problem.load + push).normal_forces - found.normal_forces == pytest.approx(pressed, abs=1e-6)


def test_an_elastic_squeeze_is_optimal_for_another_solver(make_problem):
    problem = make_problem(balance="wrench", friction=CONE, measure="work")
    rng = np.random.default_rng(1)
    pushes = problem.load + 0.1 * rng.normal(size=(6, 6)) * [1, 1, 1, 0.01, 0.01, 0.01]
    found = optimize_robust(problem, LoadSet(loads=pushes), 0.82, objective="work", reaction="elastic")
    G = np.array(problem.contacts.G)
    G[3:] /= problem.moment_length
    scaled = (pushes - problem.load) / np.repeat([1.0, problem.moment_length], 3)
    changes = -(np.linalg.pinv(G) @ scaled.T).T[:, 2::3]
    low, high = problem.normal_force_range(0.82)
    F, rows = cp.Variable(problem.k), []
    rows += [low <= F, high >= F]
    for wrench, change in zip(pushes, changes):
        u = cp.Variable((problem.k, 2))
        load = np.append(wrench[:3], wrench[3:] / problem.moment_length)
        columns = G.reshape(6, problem.k, 3)
        net = sum(columns[:, i, :2] @ u[i] + columns[:, i, 2] * (F[i] + change[i]) for i in range(problem.k))
        rows += [net + load == 0, cp.norm(u, axis=1) <= cp.multiply(problem.mu, F + change)]
    terms = problem.energy_terms(0.82, "work")
    cost = sum(c / terms[0][0] * cp.sum(cp.power(F, e)) for c, e in terms)
    expected = cp.Problem(cp.Minimize(cost), rows)
    expected.solve(solver="CLARABEL")
    assert found.status is Status.OK and found.certificate.is_optimal()
    assert found.certificate.objective == pytest.approx(expected.value * terms[0][0], rel=1e-6)


def test_elastic_loads_that_cannot_be_held_are_proven(contact_set):
    problem = two_jaws(contact_set)
    twist = np.array([0, 0, 0, 0, 0.5, 0])  # about a line across the jaws: neither friction nor springs
    low = replace(problem, max_normal_force=np.full(2, 3.0))
    for each, push in ((low, np.array([8.0, 0, 0, 0, 0, 0])), (problem, np.array([0, 0, -1e3, 0, 0, 0])), (low, twist)):
        loads = LoadSet(loads=[each.load, each.load + push])
        found = optimize_robust(each, loads, 0.85, reaction="elastic")
        assert found.status is Status.INFEASIBLE, push


def test_caps_count_for_the_reaction_too(contact_set):
    problem = two_jaws(contact_set)
    loads = LoadSet(loads=[problem.load + [s, 0, 0, 0, 0, 0] for s in (-1.2, 0, 1.2)])
    needed = 0.2 * 9.81 / 2 / 0.6 + 2 * 0.6
    for cap, status in ((1.001 * needed, Status.OK), (0.999 * needed, Status.INFEASIBLE)):
        capped = replace(problem, max_normal_force=np.full(2, cap))
        assert optimize_robust(capped, loads, 0.85, reaction="elastic").status is status


def test_the_best_squeeze_on_a_line_of_normal_forces():
    """Through the best of all squeezes it is that one; on another line it lies on it, with its proof."""
    problem = four_on_a_ball()
    reserve = pg.Reserve(torque=0.0)
    best = optimize_reserve(problem, reserve, 0.85)
    along = np.array([1.0, 0.8, 1.1, 0.6])
    found = reserve_along(problem, reserve, best, best.normal_forces - 0.3 * along, along)
    assert found.status is Status.OK
    assert found.certificate.objective == pytest.approx(best.certificate.objective, rel=1e-5)
    start = best.normal_forces * [1.2, 1.1, 1.3, 1.0]
    found = reserve_along(problem, reserve, best, start, along)
    size = (found.normal_forces - start) @ along / (along @ along)
    assert found.normal_forces == pytest.approx(start + size * along, rel=1e-6)
    assert found.certificate.objective >= best.certificate.objective
    assert found.certificate.relative_gap < 1e-6  # proven for the line


def test_contacts_nearly_on_a_line_need_what_two_on_it_do():
    """Soft fingers, two of them beside each other: one direction is balanced by next to nothing, and rounding decides."""
    body, rng = pg.Cylinder(radius=0.03, height=0.14, mass=0.3), np.random.default_rng(secrets.randbelow(10**9))

    def squeeze(angles, heights):
        points = np.column_stack([0.03 * np.cos(angles), 0.03 * np.sin(angles), heights])
        contacts = contacts_at(None, body, points)
        friction = Friction(model="soft", torsion=0.003)
        return optimize_reserve(pg.ForceProblem.holding(body, contacts, mu=0.6, friction=friction), pg.Reserve(), 0.9)

    two, found = squeeze(np.array([0.0, np.pi]), np.zeros(2)), []
    for off in 10.0 ** -rng.uniform(3, 6, size=30):
        angles = np.array([0.0, np.pi, np.pi]) + off * rng.normal(size=3)
        found.append(squeeze(angles, 0.03 * off * rng.normal(size=3)))
    objectives = [one.certificate.objective for one in found if one.status is Status.OK]
    assert len(objectives) >= 24  # 29 on average
    assert np.allclose(objectives, two.certificate.objective, rtol=0.01)


def test_no_squeeze_on_a_line_that_does_not_press(contact_set):
    problem = two_jaws(contact_set)
    best = optimize_reserve(problem, pg.Reserve(torque=0.0), 0.85)
    start = best.normal_forces + [0.5, 0.0]  # two that face each other press alike
    found = reserve_along(problem, pg.Reserve(torque=0.0), best, start, np.ones(2))
    assert found.status is Status.INACCURATE
    with pytest.raises(InvalidInput, match="direction: expected one in which a normal force changes"):
        reserve_along(problem, pg.Reserve(), best, start, np.zeros(2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "capped, shares", [(False, (0.5, 3.0)), (True, (0.5, 3.0)), (False, np.linspace(0.6, 1.5, 10))]
)
def test_squeezes_in_scenarios_are_optimal_for_another_solver(capped, shares):
    """Loads as assumed, and in scenarios whose normal forces follow the planned forces; of many a few are enough."""
    free = four_on_a_ball()
    body, contacts = free.object, free.contacts
    reserve = pg.Reserve(friction=0.0, torque=0.0, normal_force=0.0)
    rng, k = np.random.default_rng(secrets.randbelow(2**32)), free.k
    G = np.array(contacts.G)
    G[3:] /= free.moment_length
    inner = np.eye(3 * k) - np.linalg.pinv(G) @ G
    scenarios = []
    for share in shares:  # as a hand that gives way: internal forces change in proportion, and a little otherwise
        change = (np.eye(3 * k) + (share - 1) * inner + 0.05 * inner @ rng.normal(size=(3 * k, 3 * k)) @ inner)[2::3]
        offset = (0.02 * inner @ rng.normal(size=3 * k))[2::3]
        scenarios.append(
            SqueezeScenario(
                normal=change[:, 2::3], tangential=np.delete(change, np.s_[2::3], axis=1), offset=np.array(offset)
            )
        )

    def squeezed(problem):
        start = optimize_reserve(problem, reserve, 0.85)
        return producible_reserve(problem, reserve, start, np.zeros((0, k)), scenarios=lambda _: scenarios)

    problem = free
    if capped:  # only the stiffest contacts meet the cap
        most = max((one.normal @ squeezed(free).normal_forces).max() for one in scenarios)
        problem = replace(free, max_normal_force=np.full(k, 0.97 * most))
    found = squeezed(problem)

    loads = reserve.load_set(body).loads
    scaled = (loads - problem.load) / np.repeat([1.0, problem.moment_length], 3)
    changes = -(np.linalg.pinv(G) @ scaled.T).T[:, 2::3]
    low, high = problem.normal_force_range(0.85)
    F, own, columns = cp.Variable(k), cp.Variable((k, 2)), G.reshape(6, k, 3)
    rows = [low <= F, high >= F]
    across = cp.reshape(own, (2 * k,), order="C")
    under = [F, *(one.normal @ F + one.tangential @ across + one.offset for one in scenarios)]
    for i, normal in enumerate(under):
        for wrench, change in zip([problem.load, *loads], [np.zeros(k), *changes]):
            u = own if i == 0 and wrench is problem.load else cp.Variable((k, 2))
            pressed = normal + change
            net = sum(columns[:, j, :2] @ u[j] + columns[:, j, 2] * pressed[j] for j in range(k))
            rows += [net + np.append(wrench[:3], wrench[3:] / problem.moment_length) == 0]
            rows += [cp.norm(u, axis=1) <= cp.multiply(problem.mu, pressed)]
            rows += [pressed <= problem.max_normal_force] if capped else []
    terms = problem.energy_terms(found.impact_time)
    cost = sum(c / terms[0][0] * cp.sum(cp.power(F, e)) for c, e in terms)
    expected = cp.Problem(cp.Minimize(cost), rows)
    expected.solve(solver="CLARABEL")
    assert found.status is Status.OK and found.certificate.is_optimal() and found.impact_time == 0.85
    assert found.certificate.objective == pytest.approx(expected.value * terms[0][0], rel=1e-6)
    assert found.certificate.objective > 1.05 * optimize_reserve(problem, reserve, 0.85).certificate.objective
    if capped:
        assert found.certificate.objective > (1 + 1e-6) * squeezed(free).certificate.objective
