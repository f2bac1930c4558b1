"""Grasp quality against oracles that share nothing with it: full convex hulls, linear and conic programs, closed forms,
finite differences."""

from __future__ import annotations

import itertools
import time
from dataclasses import fields, replace

import cvxpy as cp
import numpy as np
import pytest
from conftest import make_contacts as grasp
from hypothesis import given, settings as examples, strategies as st
from marks import slow_except
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from pinograsp.contacts import ContactSet, Friction, MarhefkaOrin
from pinograsp.contacts.edges import past_edges
from pinograsp.contacts.inscribed_ball import Polytope, inscribed_ball
from pinograsp.contacts.quality import (
    ferrari_canny,
    grasp_map_metrics,
    grasp_stiffness,
    grasp_volume,
    manipulability,
)
from pinograsp.errors import InvalidInput
from pinograsp.forces import force_closure, min_weight
from pinograsp.objects import Box, Sphere
from pinograsp.spatial import rotation_rpy, skew

AXES = np.vstack([np.eye(3), -np.eye(3)])
CUBE = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
CONE = Friction(model="cone")
MODELS = {
    "pyramid": Friction(),
    "octagon": Friction(edges=8, safety=1.2),
    "octagon with torsion": Friction(edges=8, torsion=0.01),
    "cone": CONE,
    "cone with torsion": Friction(model="cone", torsion=0.01),
    "soft": Friction(model="soft", torsion=0.01),
}
each_model = pytest.mark.parametrize("friction", MODELS.values(), ids=MODELS)
each_norm = pytest.mark.parametrize("norm", ["L1", "Linf"])


def round_grasp(directions, radius=0.05):
    """Contacts on a ball, pushing towards its centre."""
    directions = np.asarray(directions, dtype=float)
    return grasp(radius * directions / np.linalg.norm(directions, axis=1)[:, None], -directions)


def ellipsoid_grasp(seed, k):
    v = np.random.default_rng(seed).normal(size=(k, 3))
    points = v / np.linalg.norm(v, axis=1)[:, None] * [0.05, 0.04, 0.03]
    return grasp(points, -points / np.array([0.05, 0.04, 0.03]) ** 2)


def edge_wrenches(contacts, mu, edges, *, torsion=0.0, stretch=1.0):
    """Wrenches (k, e, 6) of the pyramids' edges at 1 N, contact by contact, moments in units of the mean arm."""
    arms = contacts.points_o - contacts.com_o
    length = np.linalg.norm(arms, axis=1).mean()
    angles = np.pi / 4 + 2 * np.pi * np.arange(edges) / edges
    found = []
    for arm, R in zip(arms, contacts.rotations_oc):
        rows = []
        for angle, sign in itertools.product(angles, (-1, 1) if torsion else (0,)):
            f = R @ [mu * stretch * np.cos(angle), mu * stretch * np.sin(angle), 1.0]
            rows.append(np.concatenate([f, (np.cross(arm, f) + sign * torsion * R[:, 2]) / length]))
        found.append(rows)
    return np.array(found)


def hull_radius(points):
    """Radius about the origin from the full hull; 0 if the origin is not inside."""
    return max(0.0, -ConvexHull(points).equations[:, -1].max())


def of_points(points):
    points = np.asarray(points, dtype=float)
    return lambda y: points[np.argmax(points @ y)]


# -- the ball in a convex set ------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10_000), d=st.integers(2, 6), extra=st.integers(1, 30))
@examples(max_examples=30)
def test_ball_in_a_random_polytope_matches_the_full_hull(seed, d, extra):
    points = np.random.default_rng(seed).normal(size=(d + extra, d)) + 0.3
    ball = inscribed_ball(of_points(points), d)
    truth = hull_radius(points)
    assert ball.converged and ball.lower <= truth + 1e-14 and truth <= ball.upper + 1e-14
    assert ball.upper == pytest.approx(truth, rel=1e-6, abs=1e-10)
    assert ball.radius == ball.lower
    support = (points @ ball.direction).max()
    assert support <= ball.upper + 1e-14 and np.linalg.norm(ball.direction) == pytest.approx(1)


@pytest.mark.parametrize("d", [1, 2, 3, 4, 5, 6])
def test_ball_in_regular_bodies(d):
    cross, cube = np.vstack([np.eye(d), -np.eye(d)]), np.array(list(itertools.product((-1.0, 1.0), repeat=d)))
    for points, truth in ((cross, d**-0.5), (cube, 1.0), (np.vstack([cube] * 3), 1.0), (1e-9 * cube, 1e-9)):
        ball = inscribed_ball(of_points(points), d)
        assert ball.converged and ball.lower <= truth <= ball.upper
        assert ball.upper - ball.lower <= 1e-10 * truth


def test_ball_in_a_body_with_many_points_in_each_face():
    """Coplanar points, on a grid and off it by rounding, must neither stop the growth nor break the surface."""
    steps = np.linspace(-1, 1, 7)
    grid = np.array([p for p in itertools.product(steps, repeat=3) if max(map(abs, p)) == 1])
    for angle in (0.0, 0.3, 1.1):
        turned = grid @ rotation_rpy(angle, 2 * angle, -angle).T
        ball = inscribed_ball(of_points(turned), 3)
        assert ball.converged and ball.lower <= 1 + 1e-15 and ball.upper == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("d", [2, 3, 4])
@pytest.mark.parametrize("offset", [0.0, 0.3, 0.9])
def test_ball_in_a_moved_ball(d, offset):
    centre = np.full(d, offset / np.sqrt(d))
    ball = inscribed_ball(lambda y: centre + y / np.linalg.norm(y), d, tolerance=1e-2)
    assert ball.converged and ball.lower <= 1 - offset <= ball.upper <= ball.lower / (1 - 1e-2) + 1e-12


@pytest.mark.parametrize("offset", [1.0, 1.0001, 5.0])
def test_no_ball_where_the_origin_is_on_the_boundary_or_outside(offset):
    centre = np.array([0.0, offset, 0.0, 0.0])
    ball = inscribed_ball(lambda y: centre + y / np.linalg.norm(y), 4)
    assert ball.lower == 0 and ball.upper < 1e-9 and ball.converged
    assert centre @ ball.direction + 1 < 1e-9


def test_no_ball_where_only_one_direction_separates():
    """The origin inside a face: the separating direction is isolated."""
    points = np.vstack([np.eye(5), -np.eye(5)])[:-1]
    ball = inscribed_ball(of_points(points), 5)
    assert ball.lower == ball.upper == 0
    assert np.allclose(ball.direction, -np.eye(5)[4])


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((1, 3)),
        np.ones((1, 3)),
        [[1, 0, 0], [-1, 0, 0]],
        [[1, 0, 1], [-1, 0, 1]],
        [[1, 0, 0], [-1, 1, 0], [-1, -1, 0]],
        [[1, 0, 1], [-1, 1, 1], [-1, -1, 1], [3, 3, 1]],
    ],
)
def test_no_ball_in_a_flat_set(points):
    points = np.asarray(points, dtype=float)
    turn = rotation_rpy(0.3, 0.7, 1.1)
    ball = inscribed_ball(of_points(points @ turn.T), 3)
    assert ball.lower == ball.upper == 0 and ball.converged
    assert (points @ turn.T @ ball.direction).max() < 1e-12


def test_ball_in_many_dimensions():
    """A simplex in 16-D with points beyond six of its faces: ridges too long for one integer key."""
    d = 16
    simplex = np.linalg.svd(np.ones((1, d + 1)))[2][1:].T
    points = np.vstack([simplex, -0.5 * simplex[:6]])
    ball = inscribed_ball(of_points(points), d)
    assert ball.converged and ball.upper == pytest.approx(hull_radius(points), rel=1e-6)


def test_the_surface_refuses_points_it_cannot_take_and_bears_facets_without_extent():
    polytope = Polytope(np.vstack([np.zeros(3), np.eye(3)]), 1e-11)
    assert polytope.sound and not polytope.add(np.full(3, 0.2)) and len(polytope) == 4
    normals, offsets = polytope.planes(np.vstack([np.eye(3), np.eye(3)]), np.array([[0, 1, 2], [0, 3, 1]]))
    assert np.allclose(normals[0], 3**-0.5) and np.all(offsets > normals @ polytope.centre)


def test_a_thin_set_is_not_taken_for_a_flat_one():
    thin = CUBE * [1.0, 1.0, 1e-7]
    ball = inscribed_ball(of_points(thin), 3)
    assert ball.converged and ball.upper == pytest.approx(1e-7, rel=1e-3) and ball.lower > 0


def test_the_limit_leaves_bounds_that_hold():
    ball = inscribed_ball(lambda y: y, 6, tolerance=1e-6, limit=2000)
    assert not ball.converged and 0.3 < ball.lower < 1 <= ball.upper


def test_the_ball_is_the_same_every_time():
    contacts = ellipsoid_grasp(3, 9)
    one, two = (ferrari_canny(contacts, 0.5, friction=CONE) for _ in range(2))
    assert (one.lower, one.upper, one.points) == (two.lower, two.upper, two.points)
    assert np.array_equal(one.direction, two.direction) and not one.direction.flags.writeable


@pytest.mark.parametrize(
    "settings",
    [{"tolerance": -1}, {"tolerance": np.nan}, {"limit": 2}, {"limit": 1.5}, {"dimension": 0}, {"dimension": 2.5}],
)
def test_ball_refuses_wrong_settings(settings):
    with pytest.raises(InvalidInput):
        inscribed_ball(lambda y: y, **{"dimension": 3, **settings})


@pytest.mark.parametrize("answer", [[1.0, 2.0], [np.nan] * 3, "no point"])
def test_ball_refuses_support_points_that_are_none(answer):
    with pytest.raises(InvalidInput, match="support point"):
        inscribed_ball(lambda y: answer, 3)


# -- Ferrari and Canny's epsilon ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("k, edges, torsion", [(3, 4, 0), (3, 8, 0), (4, 6, 0.01), (6, 4, 0), (6, 8, 0), (9, 4, 0.01)])
@pytest.mark.parametrize("seed", range(3))
def test_l1_epsilon_matches_the_hull_of_every_edge(k, edges, torsion, seed):
    contacts = ellipsoid_grasp(seed, k)
    truth = hull_radius(edge_wrenches(contacts, 0.8, edges, torsion=torsion).reshape(-1, 6))
    ball = ferrari_canny(contacts, 0.8, friction=Friction(edges=edges, torsion=torsion))
    assert ball.converged and ball.lower <= truth + 1e-13 and truth <= ball.upper + 1e-13
    assert ball.lower == pytest.approx(truth, rel=1e-4, abs=1e-10)


@pytest.mark.parametrize("edges", [4, 6])
@pytest.mark.parametrize("seed, mu, holds", [(2, 1.2, True), (5, 1.2, True), (11, 0.9, True), (8, 0.3, False)])
def test_linf_epsilon_matches_the_hull_of_every_sum(edges, seed, mu, holds):
    contacts = ellipsoid_grasp(seed, 3)
    choices = [np.vstack([np.zeros(6), rows]) for rows in edge_wrenches(contacts, mu, edges)]
    truth = hull_radius(np.array([sum(choice) for choice in itertools.product(*choices)]))
    ball = ferrari_canny(contacts, mu, friction=Friction(edges=edges), norm="Linf")
    assert (ball.lower > 0) == holds
    assert ball.converged and ball.lower <= truth + 1e-13 and truth <= ball.upper + 1e-13
    assert ball.lower == pytest.approx(truth, rel=1e-4, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("seed", slow_except(range(4), 0))
def test_epsilon_of_the_cone_lies_between_inner_and_outer_pyramids(seed):
    contacts, edges = ellipsoid_grasp(seed, 5), 32
    inner = hull_radius(edge_wrenches(contacts, 0.6, edges).reshape(-1, 6))
    outer = hull_radius(edge_wrenches(contacts, 0.6, edges, stretch=1 / np.cos(np.pi / edges)).reshape(-1, 6))
    ball = ferrari_canny(contacts, 0.6, friction=CONE, tolerance=1e-5)
    assert ball.converged and ball.upper >= inner - 1e-13 and ball.lower <= outer + 1e-13
    assert 0 <= outer - inner < 2e-3


@pytest.mark.parametrize("friction, norm, truth", [(CONE, "L1", 3**-0.5), (Friction(), "Linf", 1.0)])
def test_epsilon_of_six_frictionless_contacts_on_the_axes(friction, norm, truth):
    """Forces alone: an octahedron, 1/sqrt(3), or the cube [-1, 1]^3."""
    ball = ferrari_canny(round_grasp(AXES), 0.0, friction=friction, norm=norm, balance="force")
    assert ball.lower <= truth <= ball.upper and ball.upper - ball.lower < 1e-12
    assert ball.direction.shape == (3,)


@pytest.mark.parametrize("mu", [0.2, 0.5, 0.9, 1.5])
def test_epsilon_of_two_opposed_cones_in_force_balance(mu):
    """L1: a cylinder of half-length 1 and radius mu. Linf: the sum of two cones with apex to apex.

    With y at an angle t to the axis, c = cos t, s = sin t, the sum's support is max(c + mu s, 2 mu s), least at t = 0
    (where it is 1) or where both agree, tan t = 1 / mu.
    """
    contacts = round_grasp([[1, 0, 0], [-1, 0, 0]])
    for norm, truth in (("L1", min(1.0, mu)), ("Linf", min(1.0, 2 * mu / np.hypot(1, mu)))):
        ball = ferrari_canny(contacts, mu, friction=CONE, norm=norm, balance="force")
        assert ball.converged and ball.lower <= truth <= ball.upper


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.3, 0.5, 1.0])
def test_epsilon_of_two_opposed_soft_fingers(mu):
    """Antipodal at distance r with torsion = mu r: epsilon = mu / sqrt(2 + mu^2).

    Per newton contact s = +-1 on the x axis supports -s y1 + q_s, where q_s is mu times the norm of (a + s b, y4),
    a = (y2, y3), b = (y6, -y5); so q_+^2 + q_-^2 = 2 mu^2 (1 - y1^2). The larger of the two supports is at least
    their mean (q_+ + q_-) / 2, least for |q_+ - q_-| = 2 |y1|: then its square is mu^2 - y1^2 (1 + mu^2), as long as no
    q is negative, which ends at y1^2 = mu^2 / (2 + mu^2); beyond, |y1| itself is a bound.
    """
    contacts = round_grasp([[1, 0, 0], [-1, 0, 0]])
    friction = Friction(model="soft", torsion=0.05 * mu)
    ball = ferrari_canny(contacts, mu, friction=friction, tolerance=1e-3)
    truth = mu / np.sqrt(2 + mu**2)
    assert ball.converged and ball.lower <= truth <= ball.upper
    without = ferrari_canny(contacts, mu, friction=CONE)
    assert without.lower == without.upper == 0  # hard fingers cannot turn the object about the line between them


def test_two_opposed_hard_fingers_leave_the_turn_about_their_line():
    ball = ferrari_canny(round_grasp([[1, 0, 0], [-1, 0, 0]]), 0.5)
    assert np.allclose(np.abs(ball.direction), [0, 0, 0, 1, 0, 0])


@each_model
@each_norm
def test_epsilon_is_below_the_support_in_every_direction(friction, norm):
    """The set's support written out once more, with a fine polygon for round limits (from inside: never above)."""
    contacts, mu = ellipsoid_grasp(1, 6), 0.7
    ball = ferrari_canny(contacts, mu, friction=friction, norm=norm, tolerance=1e-3)
    y = np.random.default_rng(0).normal(size=(20_000, 6))
    y[:2000] = ball.direction + 0.05 * y[:2000]
    y[0] = ball.direction
    y /= np.linalg.norm(y, axis=1)[:, None]
    arms = contacts.points_o
    length = np.linalg.norm(arms, axis=1).mean()
    found = []
    for arm, R in zip(arms, contacts.rotations_oc):
        across = (y[:, :3] + np.cross(y[:, 3:], arm) / length) @ R
        tangential = across[:, :2] * mu / friction.safety
        torsional = y[:, 3:] @ R[:, 2] * friction.torsion / friction.safety / length
        if friction.model == "soft":
            u = np.linalg.norm(np.column_stack([tangential, torsional]), axis=1)
        else:
            n = friction.edges if friction.model == "pyramid" else 3600
            angles = np.pi / 4 + 2 * np.pi * np.arange(n) / n
            if n == 3600:
                u = np.linalg.norm(tangential, axis=1)
            else:
                u = (tangential @ [np.cos(angles), np.sin(angles)]).max(axis=1)
            u = u + np.abs(torsional)
        found.append(across[:, 2] + u)
    support = np.max(found, axis=0) if norm == "L1" else np.maximum(found, 0).sum(axis=0)
    assert ball.converged and 0 < ball.lower <= support.min() + 1e-13
    assert support[0] == pytest.approx(ball.upper, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_linear_program_finds_forces_for_the_ball_and_none_beyond(seed):
    contacts = ellipsoid_grasp(seed, 7)
    edges = edge_wrenches(contacts, 0.5, 4)
    ball = ferrari_canny(contacts, 0.5)
    rng = np.random.default_rng(seed)
    W = edges.reshape(-1, 6).T

    def makes(wrench):
        cost = np.ones(W.shape[1])
        return linprog(cost, A_ub=[cost], b_ub=[1], A_eq=W, b_eq=wrench).status == 0

    directions = rng.normal(size=(30, 6))
    assert ball.lower > 0
    for y in directions / np.linalg.norm(directions, axis=1)[:, None]:
        assert makes(y * ball.lower * (1 - 1e-7))
    assert not makes(ball.direction * ball.upper * (1 + 1e-5))


@each_norm
def test_conic_program_agrees_about_the_exact_cone(norm):
    """Largest wrench along a direction, by a second-order cone program; its least over directions is epsilon."""
    contacts, mu = ellipsoid_grasp(0, 5), 0.6
    ball = ferrari_canny(contacts, mu, friction=CONE, norm=norm)
    length = np.linalg.norm(contacts.points_o, axis=1).mean()
    G = np.array(contacts.G)
    G[3:] /= length
    f, reach, y = cp.Variable((5, 3)), cp.Variable(), cp.Parameter(6)
    limits = [cp.norm(f[i, :2]) <= mu * f[i, 2] for i in range(5)]
    limits.append(cp.sum(f[:, 2]) <= 1 if norm == "L1" else f[:, 2] <= 1)
    problem = cp.Problem(cp.Maximize(reach), [G @ cp.vec(f, order="C") == reach * y, *limits])
    directions = np.random.default_rng(0).normal(size=(15, 6))
    for direction in np.vstack([ball.direction, directions / np.linalg.norm(directions, axis=1)[:, None]]):
        y.value = direction
        problem.solve(solver=cp.CLARABEL)
        assert reach.value >= ball.lower * (1 - 1e-6)
        if np.array_equal(direction, ball.direction):
            assert reach.value <= ball.upper * (1 + 1e-6)  # the support bounds what lies along its direction


@each_model
@each_norm
def test_epsilon_moves_with_the_object_and_ignores_the_order(friction, norm):
    contacts, mu = ellipsoid_grasp(4, 5), np.linspace(0.4, 0.8, 5)
    settings = {"friction": friction, "norm": norm, "tolerance": 1e-3}
    ball = ferrari_canny(contacts, mu, **settings)
    R, t = rotation_rpy(0.4, -1.2, 2.0), np.array([0.3, -0.1, 0.7])
    moved = grasp(contacts.points_o @ R.T + t, R @ contacts.rotations_oc, t)
    order = [3, 0, 4, 2, 1]
    turned = ContactSet(contacts=tuple(contacts[i] for i in order), com_o=contacts.com_o)
    scaled = grasp(contacts.points_o * 10, contacts.rotations_oc)
    more = Friction(model=friction.model, edges=friction.edges, torsion=10 * friction.torsion, safety=friction.safety)
    assert ball.lower > 0
    for other in (
        ferrari_canny(moved, mu, **settings),
        ferrari_canny(turned, mu[order], **settings),
        ferrari_canny(scaled, mu, **{**settings, "friction": more}),
    ):
        assert other.converged and other.lower <= ball.upper and ball.lower <= other.upper


@each_norm
def test_epsilon_grows_with_friction_edges_and_contacts(norm):
    contacts = ellipsoid_grasp(4, 6)
    length = 0.04

    def epsilon(contacts=contacts, mu=0.5, **friction):
        return ferrari_canny(contacts, mu, friction=Friction(**friction), norm=norm, moment_length=length)

    few = ContactSet(contacts=contacts.contacts[:5], com_o=contacts.com_o)
    for chain in (
        [epsilon(mu=mu) for mu in (0.0, 0.1, 0.2, 0.4, 0.8)],
        [epsilon(edges=4), epsilon(edges=8), epsilon(edges=16), epsilon(model="cone")],
        [epsilon(safety=2.0), epsilon(safety=1.5), epsilon()],
        [epsilon(few), epsilon()],
    ):
        assert all(a.lower <= b.upper for a, b in itertools.pairwise(chain))
        assert chain[-1].lower > chain[0].upper
    assert epsilon().lower <= ferrari_canny(contacts, 0.5, norm="Linf", moment_length=length).upper
    same = ferrari_canny(contacts, 1.0, friction=Friction(safety=2.0), norm=norm, moment_length=length)
    assert same.lower == pytest.approx(epsilon().lower, rel=1e-12)


def test_a_contact_twice_changes_the_sum_only():
    contacts = ellipsoid_grasp(4, 5)
    twice = ContactSet(contacts=contacts.contacts * 2, com_o=contacts.com_o)
    one, two = ferrari_canny(contacts, 0.6), ferrari_canny(twice, 0.6)
    assert one.lower == pytest.approx(two.lower, rel=1e-10)
    one, two = ferrari_canny(contacts, 0.6, norm="Linf"), ferrari_canny(twice, 0.6, norm="Linf")
    assert 2 * one.lower == pytest.approx(two.lower, rel=1e-4)
    assert grasp_volume(contacts, 0.6) == pytest.approx(grasp_volume(twice, 0.6), rel=1e-9)


DEGENERATE = {
    "one contact": grasp([[0.05, 0, 0]], [[-1, 0, 0]]),
    "one contact at the centre of mass": grasp([[0, 0, 0]], [[-1, 0, 0]]),
    "one contact three times": grasp([[0.05, 0, 0]] * 3, [[-1, 0, 0]] * 3),
    "collinear": grasp([[x, 0, 0] for x in (-0.05, 0.01, 0.04)], [[0, 0, 1], [0, 0, -1], [0, 0, 1]]),
    "parallel normals": grasp(CUBE * 0.05, [[0, 0, 1]] * 8),
    "one side": grasp(0.05 * CUBE[:4], -CUBE[:4]),
}


@each_model
@each_norm
@pytest.mark.parametrize("contacts", DEGENERATE.values(), ids=DEGENERATE)
@pytest.mark.parametrize("balance", ["wrench", "force"])
def test_no_epsilon_without_force_closure(contacts, friction, norm, balance):
    for mu in (0.0, 0.5):
        if balance == "force" and mu > 0 and contacts is DEGENERATE["collinear"]:
            continue  # opposed contacts with friction do hold forces
        ball = ferrari_canny(contacts, mu, friction=friction, norm=norm, balance=balance)
        assert ball.lower == 0 and ball.upper < 1e-12 and ball.converged
        assert np.linalg.norm(ball.direction) == pytest.approx(1)


@each_model
@each_norm
@pytest.mark.parametrize("shape", [CUBE, AXES], ids=["cube", "axes"])
def test_no_epsilon_on_a_ball_without_friction(friction, norm, shape):
    """Frictionless contacts cannot turn a ball; only soft fingers can."""
    ball = ferrari_canny(round_grasp(shape), 0.0, friction=friction, norm=norm, tolerance=1e-2)
    assert (ball.lower > 0) == (friction.torsion > 0)
    assert ball.upper > 0 or ball.lower == 0


def test_separating_direction_has_no_wrench_beyond_it():
    contacts = ellipsoid_grasp(8, 3)
    ball = ferrari_canny(contacts, 0.3)
    assert ball.lower == ball.upper == 0
    assert (edge_wrenches(contacts, 0.3, 4).reshape(-1, 6) @ ball.direction).max() < 1e-12


@pytest.mark.parametrize("friction", [Friction(), Friction(edges=8), CONE], ids=["4", "8", "cone"])
def test_sixty_contacts_take_a_moment(friction):
    start = time.perf_counter()
    ball = ferrari_canny(ellipsoid_grasp(0, 60), 0.5, friction=friction, tolerance=1e-3)
    assert ball.converged and ball.lower > 0.4
    assert time.perf_counter() - start < 20  # hundredths of a second, unless the growth went wrong


# -- volume ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("edges, torsion", [(4, 0), (8, 0), (4, 0.01)])
@pytest.mark.parametrize("k", [3, 6])
def test_volume_matches_the_hull_and_its_simplices(k, edges, torsion):
    contacts = ellipsoid_grasp(1, k)
    points = np.vstack([np.zeros(6), edge_wrenches(contacts, 0.6, edges, torsion=torsion).reshape(-1, 6)])
    centre = points.mean(axis=0)
    simplices = points[ConvexHull(points).simplices] - centre
    truth = np.abs(np.linalg.det(simplices)).sum() / 720
    assert grasp_volume(contacts, 0.6, friction=Friction(edges=edges, torsion=torsion)) == pytest.approx(truth)


def test_volume_closed_forms():
    """Forces alone: the octahedron 4/3; two opposed square pyramids, a bar of length 2 with half-diagonal mu."""
    assert grasp_volume(round_grasp(AXES), 0.0, balance="force") == pytest.approx(4 / 3)
    two = round_grasp([[1, 0, 0], [-1, 0, 0]])
    assert grasp_volume(two, 0.6, balance="force") == pytest.approx(2 * 2 * 0.6**2)
    assert grasp_volume(two, 0.6, balance="force", friction=Friction(safety=2.0)) == pytest.approx(4 * 0.3**2)


def test_volume_scales_with_the_moment_length():
    contacts = ellipsoid_grasp(1, 5)
    base = grasp_volume(contacts, 0.5, moment_length=0.04)
    assert grasp_volume(contacts, 0.5, moment_length=0.04e3) == pytest.approx(base * 1e-9, rel=1e-9)


@pytest.mark.parametrize("contacts", [*DEGENERATE.values(), round_grasp(CUBE)], ids=[*DEGENERATE, "cube"])
def test_volume_of_a_flat_set_is_zero(contacts):
    assert grasp_volume(contacts, 0.0) == 0
    assert grasp_volume(contacts, 0.5) >= 0


def test_volume_of_nearly_flat_and_of_symmetric_sets_does_not_fail():
    for mu in (1e-11, 1e-8, 1e-4):
        assert 0 <= grasp_volume(round_grasp(CUBE), mu) < 1
    for shape, friction in itertools.product((CUBE, AXES), (Friction(), Friction(edges=8, torsion=0.02))):
        assert grasp_volume(round_grasp(shape), 0.5, friction=friction) > 0


def test_volume_needs_a_polytope():
    with pytest.raises(InvalidInput, match="pyramid with more edges"):
        grasp_volume(round_grasp(AXES), 0.5, friction=CONE)


# -- grasp map ---------------------------------------------------------------------------------------------------------


def test_grasp_map_metrics_of_a_random_grasp():
    contacts = ellipsoid_grasp(2, 5)
    found = grasp_map_metrics(contacts, moment_length=0.03)
    G = np.array(contacts.G)
    G[3:] /= 0.03
    eigenvalues = np.linalg.eigvalsh(G @ G.T)
    assert found.min_singular_value == pytest.approx(np.sqrt(eigenvalues[0]))
    assert found.isotropy == pytest.approx(np.sqrt(eigenvalues[0] / eigenvalues[-1]))
    assert found.volume == pytest.approx(np.sqrt(np.linalg.det(G @ G.T)))
    assert found.moment_length == 0.03
    assert grasp_map_metrics(contacts).moment_length == pytest.approx(np.linalg.norm(contacts.points_o, axis=1).mean())


def test_grasp_map_metrics_of_symmetric_contacts():
    """Six on the axes of a ball: force rows sum to 6 in each direction, moments, without the radial part, to 4."""
    found = grasp_map_metrics(round_grasp(AXES))
    assert np.allclose(found.singular_values**2, [6, 6, 6, 4, 4, 4])
    force = grasp_map_metrics(round_grasp(AXES), balance="force")
    assert np.allclose(force.singular_values**2, 6) and force.isotropy == pytest.approx(1)


@pytest.mark.parametrize("name", ["one contact", "one contact at the centre of mass", "one contact three times"])
def test_grasp_map_metrics_of_missing_directions_are_zero(name):
    found = grasp_map_metrics(DEGENERATE[name])
    assert found.singular_values.shape == (6,)
    assert found.min_singular_value == found.isotropy == found.volume == 0


# -- stiffness ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [MarhefkaOrin(), MarhefkaOrin(stiffness=2e3, exponent=1.0), MarhefkaOrin(exponent=2.2)])
@pytest.mark.parametrize("ratio", [2 / 3, 0.3, 0.0])
def test_stiffness_is_the_slope_of_the_contact_forces(law, ratio):
    """Springs at each contact: the law along the normal, linear along the tangents, for an object that moved."""
    contacts, com = ellipsoid_grasp(3, 4), np.array([0.004, -0.002, 0.003])
    contacts = grasp(contacts.points_o, contacts.rotations_oc, com)
    force = np.array([3.0, 1.0, 0.5, 8.0])
    found = grasp_stiffness(contacts, law, force, tangential_ratio=ratio)

    def wrench(move):
        total = np.zeros(6)
        for contact, F in zip(contacts, force):
            arm = contact.point_o - com
            shift = contact.rotation_oc.T @ (move[:3] + np.cross(move[3:], arm))
            depth = (F / law.stiffness) ** (1 / law.exponent)
            slope = (law.normal_force(depth + 1e-9) - law.normal_force(depth - 1e-9)) / 2e-9
            f = [-ratio * slope * shift[0], -ratio * slope * shift[1], law.normal_force(depth - shift[2])]
            h = contact.rotation_oc @ f
            total += np.concatenate([h, np.cross(arm, h)])
        return total

    step = 1e-8
    slopes = np.column_stack([(wrench(step * e) - wrench(-step * e)) / (2 * step) for e in np.eye(6)])
    assert np.allclose(found.matrix, -slopes, rtol=0, atol=1e-5 * np.abs(slopes).max())
    assert np.array_equal(found.matrix, found.matrix.T)


def test_stiffness_of_six_contacts_on_the_axes():
    """Along each axis two normals and four tangents; about each axis four tangents at the radius."""
    found = grasp_stiffness(round_grasp(AXES), MarhefkaOrin(exponent=1.0, stiffness=1000.0), 5.0, tangential_ratio=0.5)
    assert np.allclose(found.normal_stiffness, 1000) and np.allclose(found.tangential_stiffness, 500)
    assert np.allclose(found.matrix, np.diag([4000] * 3 + [2000 * 0.05**2] * 3), atol=1e-9)
    assert np.allclose(found.eigenvalues, [2000] * 3 + [4000] * 3)
    assert found.rank == 6 and found.moment_length == pytest.approx(0.05)
    assert np.allclose(found.compliance @ found.matrix, np.eye(6), atol=1e-12)


def test_stiffness_eigenvectors_are_scaled_displacements():
    found = grasp_stiffness(ellipsoid_grasp(1, 4), MarhefkaOrin(), [1.0, 2.0, 3.0, 4.0], moment_length=0.02)
    units = np.diag([1, 1, 1, 50, 50, 50])
    scaled = units @ found.matrix @ units
    assert np.allclose(scaled @ found.eigenvectors, found.eigenvectors * found.eigenvalues, atol=1e-6)
    assert np.allclose(found.compliance, np.linalg.inv(found.matrix), rtol=1e-8, atol=0)


def test_stiffness_follows_the_contact_law():
    contacts = round_grasp(AXES)
    law = MarhefkaOrin()
    one, eight = grasp_stiffness(contacts, law, 1.0), grasp_stiffness(contacts, law, 8.0)
    assert np.allclose(eight.matrix, 2 * one.matrix)  # k_n grows with F^(1/3) where rho = 3/2
    assert one.normal_stiffness[0] == pytest.approx(1.5 * 5e4 ** (2 / 3))
    assert np.allclose(one.tangential_stiffness, one.normal_stiffness * 2 / 3)


def test_stiffness_of_a_grasp_that_does_not_hold():
    contacts = round_grasp([[1, 0, 0], [-1, 0, 0]])
    found = grasp_stiffness(contacts, MarhefkaOrin(), 2.0)
    assert found.rank == 5 and found.eigenvalues[0] == 0
    assert np.allclose(np.abs(found.eigenvectors[:, 0]), [0, 0, 0, 1, 0, 0])
    A, C = found.matrix, found.compliance
    assert np.allclose(A @ C @ A, A, atol=1e-9 * np.abs(A).max()) and np.allclose(C @ A @ C, C)
    slack = grasp_stiffness(contacts, MarhefkaOrin(), 0.0)
    assert slack.rank == 0 and not slack.matrix.any() and not slack.compliance.any()


def test_stiffness_turns_with_the_object():
    contacts = ellipsoid_grasp(5, 4)
    R = rotation_rpy(0.3, 1.0, -2.0)
    turned = grasp(contacts.points_o @ R.T, R @ contacts.rotations_oc)
    turn = np.kron(np.eye(2), R)
    one, two = (grasp_stiffness(c, MarhefkaOrin(), 3.0) for c in (contacts, turned))
    assert np.allclose(two.matrix, turn @ one.matrix @ turn.T, atol=1e-8)
    assert np.allclose(two.eigenvalues, one.eigenvalues)


# -- manipulability ----------------------------------------------------------------------------------------------------


def test_manipulability_is_the_root_of_the_gram_determinant():
    J = np.random.default_rng(0).normal(size=(4, 3, 7))
    found = manipulability(J)
    assert np.allclose(found.values, [np.sqrt(np.linalg.det(j @ j.T)) for j in J])
    assert np.allclose(found.singular_values, [np.linalg.svd(j, compute_uv=False) for j in J])


def test_manipulability_of_a_turned_planar_finger():
    """Base yaw, then two links in a vertical plane: |l1 l2 sin q2| times the reach from the axis."""
    l1, l2, q1, q2 = 0.04, 0.03, 0.5, 0.9
    elbow = np.array([l1 * np.cos(q1), 0, l1 * np.sin(q1)])
    tip = elbow + np.array([l2 * np.cos(q1 + q2), 0, l2 * np.sin(q1 + q2)])
    axes = np.array([[0, 0, 1.0], [0, -1.0, 0], [0, -1.0, 0]])
    J = np.column_stack([skew(a) @ r for a, r in zip(axes, (tip, tip, tip - elbow))])
    assert manipulability([J]).values[0] == pytest.approx(abs(l1 * l2 * np.sin(q2) * tip[0]))


@pytest.mark.parametrize(
    "J",
    [np.zeros((2, 3, 4)), np.ones((2, 3, 4)), np.ones((2, 3, 2)), np.zeros((2, 3, 0)), np.zeros((0, 3, 3))],
)
def test_manipulability_is_zero_where_a_direction_is_missing(J):
    found = manipulability(J)
    assert found.values.shape == (len(J),) and found.singular_values.shape == (len(J), 3)
    assert np.array_equal(found.values, np.zeros(len(J)))


# -- what is refused ---------------------------------------------------------------------------------------------------

GRASP = ellipsoid_grasp(0, 4)


@pytest.mark.parametrize(
    "call",
    [
        lambda: ferrari_canny(GRASP, -0.1),
        lambda: ferrari_canny(GRASP, np.nan),
        lambda: ferrari_canny(GRASP, [0.5] * 3),
        lambda: ferrari_canny(GRASP, [0.5, 0.5, 0.5, -0.5]),
        lambda: ferrari_canny(GRASP, "much"),
        lambda: ferrari_canny(GRASP, 0.5, norm="L2"),
        lambda: ferrari_canny(GRASP, 0.5, balance="moment"),
        lambda: ferrari_canny(GRASP, 0.5, moment_length=0),
        lambda: ferrari_canny(GRASP, 0.5, friction="cone"),
        lambda: ferrari_canny(GRASP, 0.5, tolerance=-1),
        lambda: ContactSet(contacts=(), com_o=np.zeros(3)),
        lambda: ferrari_canny(GRASP.points_o, 0.5),
        lambda: grasp_volume(GRASP, -0.1),
        lambda: grasp_volume(GRASP, 0.5, balance="moment"),
        lambda: grasp_map_metrics(GRASP, moment_length=-1),
        lambda: grasp_map_metrics(GRASP, balance="moment"),
        lambda: grasp_stiffness(GRASP, MarhefkaOrin(), -1.0),
        lambda: grasp_stiffness(GRASP, MarhefkaOrin(), [1.0] * 5),
        lambda: grasp_stiffness(GRASP, MarhefkaOrin(), np.inf),
        lambda: grasp_stiffness(GRASP, MarhefkaOrin(exponent=0.5), [1.0, 1.0, 0.0, 1.0]),
        lambda: grasp_stiffness(GRASP, 5e4, 1.0),
        lambda: grasp_stiffness(GRASP, MarhefkaOrin(), 1.0, tangential_ratio=-0.1),
        lambda: grasp_stiffness(GRASP, MarhefkaOrin(), 1.0, moment_length=0),
        lambda: manipulability(np.zeros((3, 4))),
        lambda: manipulability(np.zeros((1, 6, 4))),
        lambda: manipulability(np.full((1, 3, 4), np.nan)),
        lambda: manipulability([np.zeros((3, 2)), np.zeros((3, 4))]),
    ],
)
def test_wrong_input_is_refused(call):
    with pytest.raises(InvalidInput):
        call()


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e-30, 1e30, 1e160, 1e300])
def test_numbers_out_of_all_proportion_give_numbers_or_are_refused(contacts, size):
    spread = replace_points(contacts, size)
    calls = [
        lambda: grasp_map_metrics(contacts, moment_length=size),
        lambda: grasp_map_metrics(spread),
        lambda: grasp_volume(contacts, size),
        lambda: ferrari_canny(contacts, size, tolerance=0.1),
        lambda: ferrari_canny(spread, 0.5, tolerance=0.1),
        lambda: grasp_stiffness(contacts, MarhefkaOrin(), size),
        lambda: grasp_stiffness(contacts, MarhefkaOrin(stiffness=size, exponent=3.0), 1.0),
        lambda: min_weight(spread, 0.5),
        lambda: force_closure(contacts, size),
    ]
    answered = 0
    for call in calls:
        try:
            found = call()
        except InvalidInput as error:
            assert "expected" in str(error)
            continue
        answered += 1
        for value in [found] if isinstance(found, float) else [getattr(found, field.name) for field in fields(found)]:
            assert not np.any(np.isnan(np.asarray(value, dtype=float)))
    assert answered < len(calls)


def replace_points(contacts, size):
    return ContactSet(
        contacts=tuple(replace(c, point_o=size * c.point_o) for c in contacts), com_o=size * contacts.com_o
    )


def test_deeper_than_an_edge_is_near():
    """Of a plate: the middle of a face, and 3 mm from an edge; half of the plate is 5 mm."""
    plate = Box(size=[0.1, 0.1, 0.01], mass=0.1)
    points, normals = [(0, 0, 0.005), (0.047, 0, 0.005)], [(0, 0, -1), (0, 0, -1)]
    alone = grasp(points, normals)
    alone = replace(alone, contacts=tuple(replace(one, link=f"tip {i}") for i, one in enumerate(alone)))
    for depth, expected in ((0.0, [0, 0]), (2e-3, [0, 0]), (4e-3, [0, 1]), (6e-3, [1, 1])):
        assert past_edges(plate, alone, np.full(2, depth)).tolist() == [bool(one) for one in expected], depth
    assert past_edges(plate, alone, np.array([2e-3, 4e-3])).tolist() == [False, True]
    # Corners of one link that lies flat.
    assert not past_edges(plate, grasp(points, normals), np.full(2, 6e-3)).any()
    # A ball's surface stays the nearest until the centre.
    ball = round_grasp(AXES, radius=0.03)
    assert not past_edges(Sphere(radius=0.03, mass=0.1), ball, np.full(6, 0.025)).any()
