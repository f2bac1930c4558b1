"""The reserve of a squeeze: its set of loads against the ball it promises, every load of it, and scaling laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import linprog

import pinograsp as pg
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import Reserve, optimize_reserve
from pinograsp.forces.robust.reserve import CIRCUMSCRIBED

CONE = pg.Friction(model="cone")
FREE = {"acceleration_range": (1e-6, 20.0), "max_depth": 5e-2}  # limits of F_n that do not bind


def ball_in_four_fingers(contact_set, body, **settings):
    directions = np.array([[1.0, 0.0, 0.1], [-0.5, 0.8, -0.1], [-0.5, -0.8, 0.2], [0.0, 0.1, -1.0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rows = [("any", "", 0.03 * d, -d, None) for d in directions]
    return pg.ForceProblem.holding(body, contact_set(rows), mu=0.7, friction=CONE, **{**FREE, **settings})


def within(points, vertices):
    """Whether every point (n, 6) is a mean of the vertices (s, 6): by linear programs."""
    A = np.vstack([vertices.T, np.ones(len(vertices))])
    found = [linprog(np.zeros(len(vertices)), A_eq=A, b_eq=np.append(point, 1.0)).status for point in points]
    return all(status == 0 for status in found)


def promised(reserve, body, rng, count, gravity=9.81):
    """Random loads of the promise (count, 6): mass, a force and a moment that share the disturbance."""
    weight = body.mass * gravity
    mass = 1 + reserve.mass * rng.uniform(-1, 1, size=(count, 1))
    share = rng.uniform(size=(count, 1))
    loads = np.zeros((count, 6))
    unit = rng.normal(size=(2, count, 3))
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    loads[:, :3] = mass * [0, 0, -weight] + share * reserve.disturbance * weight * unit[0]
    loads[:, 3:] = (1 - share) * reserve.disturbance * weight * reserve.arm(body) * unit[1]
    return loads


def test_the_set_contains_every_load_that_is_promised():
    body = pg.Box(size=(0.03, 0.05, 0.11), mass=0.3)
    reserve, rng = Reserve(), np.random.default_rng(0)
    loads = np.array(reserve.load_set(body).loads)
    size = np.array([1, 1, 1, 0.03, 0.03, 0.03])  # one unit for all columns
    assert within(promised(reserve, body, rng, 60) / size, loads / size)
    # And hardly more: no load is further from the weights than the factor says.
    weight = body.mass * 9.81
    beyond = np.array([[0, 0, -weight * 1.2 - reserve.disturbance * weight * CIRCUMSCRIBED * 1.001, 0, 0, 0]])
    assert not within(beyond / size, loads / size)


def test_the_arm_is_the_largest_radius_of_gyration():
    assert Reserve().arm(pg.Sphere(radius=0.03, mass=0.5)) == pytest.approx(0.03 * np.sqrt(0.4))
    rod = pg.Cylinder(radius=0.01, height=0.2, mass=0.1)
    assert Reserve().arm(rod) == pytest.approx(np.sqrt((3 * 0.01**2 + 0.2**2) / 12))
    assert Reserve(moment_arm=0.04).arm(rod) == 0.04


def test_loads_that_lie_between_others_are_left_out():
    body = pg.Sphere(radius=0.03, mass=0.5)
    weight = 0.5 * 9.81
    assert Reserve.none().load_set(body).loads == pytest.approx(np.array([[0, 0, -weight, 0, 0, 0]]))
    masses = replace(Reserve.none(), mass=0.2).load_set(body).loads
    assert masses[:, 2] == pytest.approx([-1.2 * weight, -0.8 * weight]) and len(masses) == 2
    forces = Reserve(moment_arm=0.0).load_set(body).loads
    assert len(forces) == 22 and not forces[:, 3:].any()
    everything = np.array(Reserve().load_set(body).loads)
    assert len(everything) == 46 == len(np.unique(everything.round(9), axis=0))
    size = np.array([1, 1, 1, 0.03, 0.03, 0.03])
    for i, one in enumerate(everything):
        assert not within([one / size], np.delete(everything, i, axis=0) / size)
    weightless = Reserve().load_set(body, gravity_o=(0.0, 0.0, 0.0)).loads
    assert not weightless.any() and len(weightless) == 1


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_the_set_turns_with_body_and_gravity(turn):
    body, gravity = pg.Box(size=(0.03, 0.05, 0.11), mass=0.3), np.array([0.5, -1.0, -9.0])
    R = pin.exp3(np.array(turn))
    pose = np.eye(4)
    pose[:3, :3] = R
    loads = Reserve().load_set(body, gravity).loads
    turned = Reserve().load_set(body.placed(pose), R @ gravity).loads
    assert turned[:, :3] == pytest.approx(loads[:, :3] @ R.T, abs=1e-9)
    assert turned[:, 3:] == pytest.approx(loads[:, 3:] @ R.T, abs=1e-9)


def test_every_load_is_held_within_all_that_is_relied_on(contact_set):
    body, reserve = pg.Sphere(radius=0.03, mass=0.3), Reserve()
    rng = np.random.default_rng(3)
    J = np.zeros((4, 6, 8))
    for i in range(4):
        J[i, :3, 2 * i : 2 * i + 2] = 0.05 * rng.normal(size=(3, 2))
    free = ball_in_four_fingers(contact_set, body)
    squeeze = optimize_reserve(free, reserve, 0.85)
    wide = pg.TorqueLimits(jacobian=J, bias=np.zeros(8), limit=np.full(8, 1e3))

    def torques(found, limits):
        forces_o = np.einsum("kij,kj->ki", found.problem.contacts.rotations_oc, found.forces_c)
        return np.abs(limits.torques(forces_o)).max()

    loads = [*reserve.load_set(body).loads, *promised(reserve, body, rng, 40)]
    limit = max(torques(squeeze.under(load), wide) for load in loads) / 0.9
    limited = squeeze
    while not limited.certificate.at_torque:  # tightened until it binds
        limit *= 0.99
        limits = replace(wide, limit=np.full(8, limit))
        limited = optimize_reserve(replace(free, torques=limits), reserve, 0.85)
    assert squeeze.status is limited.status is Status.OK
    for load in loads:
        found = limited.under(load)
        assert found.residual_norm < 1e-7
        assert np.all(np.linalg.norm(found.forces_c[:, :2], axis=1) <= 0.8 * 0.7 * found.normal_forces * (1 + 1e-6))
        assert torques(found, limits) <= 0.9 * limit * (1 + 1e-6)
    assert limited.under().normal_forces == pytest.approx(limited.normal_forces)
    assert np.all(limited.normal_forces >= 0.05 * 0.3 * 9.81 * (1 - 1e-9))


def test_margins_of_the_squeeze_keep_the_promise(contact_set):
    body, reserve = pg.Sphere(radius=0.03, mass=0.3), Reserve()
    found = optimize_reserve(ball_in_four_fingers(contact_set, body), reserve, 0.85).under()
    margins = pg.grasp_margins(found)
    weight = 0.3 * 9.81
    assert margins.disturbance_force >= 0.5 * weight and margins.load_factor >= 1.2
    assert margins.disturbance_moment >= 0.5 * weight * reserve.arm(body)
    assert np.all(margins.friction_used <= 0.8 * (1 + 1e-6))
    bare = pg.grasp_margins(pg.optimize_forces(ball_in_four_fingers(contact_set, body), 0.85))
    assert bare.disturbance_force < 1e-3 * weight


def test_twice_the_mass_is_twice_the_squeeze(contact_set):
    one, two = (
        optimize_reserve(ball_in_four_fingers(contact_set, pg.Sphere(radius=0.03, mass=mass)), Reserve(), 0.85)
        for mass in (0.3, 0.6)
    )
    assert two.normal_forces == pytest.approx(2 * one.normal_forces, rel=1e-5)


@pytest.mark.parametrize("friction", [pg.Friction(), CONE], ids=["pyramid", "cone"])
def test_no_reserve_is_the_ordinary_optimum(make_problem, friction):
    problem = make_problem(balance="wrench", friction=friction)
    found, plain = optimize_reserve(problem, Reserve.none(), 0.85), pg.optimize_forces(problem, 0.85)
    assert found.certificate.objective == pytest.approx(plain.certificate.objective, rel=1e-6)
    assert found.problem.friction == friction and found.problem.min_normal_force is None


def test_each_part_of_the_reserve_costs(contact_set):
    problem = ball_in_four_fingers(contact_set, pg.Sphere(radius=0.03, mass=0.3))
    none = Reserve.none()
    bare = optimize_reserve(problem, none, 0.85).certificate.objective
    everything = optimize_reserve(problem, Reserve(), 0.85).certificate.objective
    for part in ("disturbance", "mass", "friction", "normal_force"):
        one = optimize_reserve(problem, replace(none, **{part: getattr(Reserve(), part)}), 0.85)
        assert bare * (1 + 1e-6) < one.certificate.objective < everything


def test_the_reserve_of_friction_adds_to_the_safety_factor(make_problem):
    problem = make_problem(friction=pg.Friction(safety=1.5), min_normal_force=2.0)
    kept = Reserve(friction=0.25, normal_force=1e-3).problem(problem)
    assert kept.friction.safety == pytest.approx(2.0) and np.all(kept.mu == problem.mu)
    assert np.all(kept.min_normal_force == 2.0)  # what the problem asked for is more


@pytest.mark.parametrize("solver", ["auto", "newton", "interior", "clarabel"])
def test_least_normal_forces(make_problem, solver):
    problem = make_problem(balance="wrench", friction=CONE, measure="work")
    free = pg.optimize_forces(problem, 0.85, solver=solver)
    floor = free.normal_forces + [0.0, 0.5, 0.0]
    found = pg.optimize_forces(replace(problem, min_normal_force=floor), 0.85, solver=solver)
    assert found.status is Status.OK and np.all(found.normal_forces >= floor - 1e-6)
    assert found.certificate.objective > free.certificate.objective
    assert found.normal_forces[1] == pytest.approx(floor[1], rel=1e-6) and found.certificate.at_least[1]
    below = pg.optimize_forces(replace(problem, min_normal_force=1e-3), 0.85, solver=solver)
    assert below.certificate.objective == pytest.approx(free.certificate.objective, rel=1e-6)


def test_unusable_reserves(make_problem, contacts):
    problem = make_problem()
    for bad in (
        lambda: Reserve(disturbance=-0.1),
        lambda: Reserve(moment_arm=-1.0),
        lambda: Reserve(mass=1.0),
        lambda: Reserve(friction=1.0),
        lambda: Reserve(friction=-0.1),
        lambda: Reserve(normal_force=float("nan")),
        lambda: Reserve(torque="much"),
        lambda: optimize_reserve(
            pg.ForceProblem(contacts=contacts, load=np.ones(6), mu=0.7, friction=pg.Friction(), max_depth=5e-3),
            Reserve(),
            0.85,
        ),
        lambda: optimize_reserve(problem, 0.5, 0.85),
        lambda: Reserve().load_set("ball"),
        lambda: make_problem(min_normal_force=-1.0),
        lambda: make_problem(min_normal_force=[1.0, 2.0]),
        lambda: make_problem(min_normal_force=3.0, max_normal_force=2.0),
        lambda: pg.GraspConditions(mu=0.7, reserve=0.5),
        lambda: pg.grid_search(make_problem(min_normal_force=0.1)),
        lambda: pg.TorqueLimits(jacobian=np.zeros((3, 6, 2)), bias=np.zeros(2), limit=np.ones(2), headroom=1.0),
    ):
        with pytest.raises(InvalidInput):
            bad()
