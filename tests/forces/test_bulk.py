"""One squeeze for many loads: reactions of springs, offsets of friction cones, multiples that are borne."""

import secrets
from dataclasses import replace

import numpy as np
import pytest
from random_grasps import contact_set_of
from scipy.optimize import linprog

from pinograsp.contacts import Friction
from pinograsp.forces import ForceProblem, Reserve
from pinograsp.forces.bulk.elastic import Grips, find_efforts, find_multiples, find_offsets, react, spread
from pinograsp.forces.bulk.squeeze import (
    MOST_MU,
    Holding,
    find_hopeless,
    find_least_mu,
    hold_weight,
    squeeze,
)
from pinograsp.forces.matrices import elastic_reaction
from pinograsp.forces.robust.margins import disturbance_margin
from pinograsp.forces.robust.reserve_search import least_squeeze
from pinograsp.objects import Sphere
from pinograsp.spatial import tangent_frame

MODELS = [Friction(model="cone"), Friction(model="soft", torsion=5e-3), Friction(model="pyramid")]
NAMES = [model.model for model in MODELS]
MU, RADIUS = 0.6, 0.04
BALL = Sphere(radius=RADIUS, mass=0.15)
WEIGHT = np.array([0, 0, -9.81 * 0.15, 0, 0, 0])


def around_a_ball(rng, count, k):
    """Contacts all round a ball (count, k), the last one of every second grasp missing."""
    normals = rng.normal(size=(count, k, 3))
    normals /= np.linalg.norm(normals, axis=2)[..., None]
    frames = np.array([[tangent_frame(normal) for normal in row] for row in normals])
    counts = np.where(np.arange(count) % 2, k - 1, k)
    return Grips(points=-RADIUS * normals, rotations=frames, counts=counts)


def problem_of(grips, i, friction, **changed):
    """Of holding the ball by grasp i, forces as large as they need to be."""
    own = grips.counts[i]
    asked = {"mu": MU, "max_depth": 1.0, "acceleration_range": (1e-9, 1e4)} | changed
    contacts = contact_set_of(grips.points[i, :own], grips.rotations[i, :own, :, 2])
    return ForceProblem(contacts=contacts, load=WEIGHT, friction=friction, object=BALL, **asked)


def wrench_of(grips, local, i):
    """The wrench of forces (k, d) of grasp i, from its definition."""
    total = np.zeros(6)
    for c in range(grips.counts[i]):
        R, p, f = grips.rotations[i, c], grips.points[i, c], local[c]
        force = R[:, 0] * f[0] + R[:, 1] * f[1] + R[:, 2] * f[-1]
        total[:3] += force
        total[3:] += np.cross(p, force) + (R[:, 2] * f[2] if len(f) == 4 else 0.0)
    return total


@pytest.mark.parametrize("friction", MODELS[:2], ids=NAMES[:2])
def test_springs_balance_what_is_added_and_press_as_the_packages_own(friction):
    rng = np.random.default_rng(1)
    grips, wrenches = around_a_ball(rng, 6, 5), rng.normal(size=(7, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
    reacted = react(grips, friction, wrenches)
    assert reacted.borne.all()
    change = np.concatenate([reacted.tangential, reacted.normal[:, :, None]], axis=2)
    for i in range(6):
        own = grips.counts[i]
        for m, wrench in enumerate(wrenches):
            assert np.allclose(wrench_of(grips, change[i, :, :, m], i), -wrench, atol=1e-9)
        assert not change[i, own:].any()
        contacts = contact_set_of(grips.points[i, :own], grips.rotations[i, :own, :, 2])
        problem = ForceProblem(contacts=contacts, load=WEIGHT, mu=MU, friction=friction, max_depth=5e-3)
        scaled = wrenches / np.repeat([1.0, problem.moment_length], 3)
        assert np.allclose(reacted.normal[i, :own], elastic_reaction(problem) @ scaled.T, atol=1e-9)


@pytest.mark.parametrize("friction", MODELS[:2], ids=NAMES[:2])
def test_reactions_are_least_squares(friction):
    """Of numpy's pseudo-inverse: all components alike, and tangential ones by what the contacts can bear."""
    rng = np.random.default_rng(secrets.randbelow(10**9))
    grips, wrenches = around_a_ball(rng, 19, 4), rng.normal(size=(11, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
    grips.counts[3:6] = 2, 1, 3  # fewer wrenches can be balanced
    capacities = rng.uniform(0.0, 3.0, size=(19, 4))
    whole = react(grips, friction, wrenches)
    apart = spread(grips, friction, wrenches, whole, capacities)
    units = np.array([1.0, 1.0, friction.torsion, 1.0])[[0, 1, 2, 3] if friction.d == 4 else [0, 1, 3]]
    for i, own in enumerate(grips.counts):
        scale = np.repeat([1.0, 1.0 / np.linalg.norm(grips.points[i, :own], axis=1).mean()], 3)
        G = np.zeros((6, own, friction.d))
        for c in range(own):
            for j, unit in enumerate(units):
                one = np.zeros((grips.points.shape[1], friction.d))
                one[c, j] = unit
                G[:, c, j] = wrench_of(grips, one, i) * scale
        lefts = wrenches * scale
        found = -np.linalg.pinv(G.reshape(6, -1), rcond=1e-6) @ lefts.T
        found = found.reshape(own, friction.d, -1)
        missed = np.linalg.norm(np.einsum("rcj,cjm->mr", G, found) + lefts, axis=1)
        lost = missed > 1e-6 * np.linalg.norm(lefts, axis=1)
        assert np.array_equal(whole.borne[i], ~lost)
        assert np.allclose(whole.normal[i, :own], found[:, -1], atol=1e-9)
        assert np.allclose(whole.tangential[i, :own], found[:, :-1] * units[:-1, None], atol=1e-9)
        weights = np.maximum(capacities[i, :own], 1e-3 * capacities[i].max())
        lefts = lefts + np.einsum("rc,cm->mr", G[:, :, -1], found[:, -1])
        T = (G[:, :, :-1] * weights[:, None]).reshape(6, -1)
        found = -np.linalg.pinv(T, rcond=1e-6) @ lefts.T
        lost |= np.linalg.norm(T @ found + lefts.T, axis=0) > 1e-6 * np.linalg.norm(lefts, axis=1)
        found = found.reshape(own, friction.d - 1, -1) * weights[:, None, None]
        assert np.array_equal(apart.borne[i], ~lost)
        assert np.allclose(apart.tangential[i, :own], found * units[:-1, None], atol=1e-7)
        assert np.array_equal(apart.normal[i, :own], whole.normal[i, :own])


@pytest.mark.parametrize("friction", MODELS[:2], ids=NAMES[:2])
def test_efforts_are_those_of_the_worst_load(friction):
    """The torques of all forces and moments, each by its Jacobian."""
    rng = np.random.default_rng(6)
    grips, wrenches = around_a_ball(rng, 7, 3), rng.normal(size=(5, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
    reacted = react(grips, friction, wrenches)
    jacobians, bias = rng.normal(size=(7, 3, 6, 4)), rng.normal(size=(7, 4))
    local = rng.normal(size=(7, 3, friction.d))
    tau, most = find_efforts(jacobians, grips.rotations, bias, local, reacted)
    change = np.concatenate([reacted.tangential, reacted.normal[:, :, None]], axis=2)
    for i in range(7):
        torques = []
        for added in (0.0, *np.moveaxis(change[i], 2, 0)):
            total = bias[i].copy()
            for c in range(grips.counts[i]):
                R, f = grips.rotations[i, c], (local[i] + added)[c]
                total += jacobians[i, c, :3].T @ (R @ f[[0, 1, -1]])
                total += jacobians[i, c, 3:].T @ R[:, 2] * (f[2] if len(f) == 4 else 0.0)
            torques.append(total)
        assert np.allclose(tau[i], torques[0]) and np.allclose(most[i], np.abs(torques).max(axis=0))


@pytest.mark.parametrize("friction", [*MODELS, Friction(model="pyramid", torsion=4e-3)], ids=[*NAMES, "twisting"])
def test_results_do_not_depend_on_the_number_of_threads(friction):
    rng, reserve = np.random.default_rng(8), Reserve()
    grips, holding = around_a_ball(rng, 200, 4), Holding(friction=friction, mu=MU, weight=WEIGHT, cap=20.0)
    wrenches = reserve.load_set(BALL).loads - WEIGHT
    (one, ways), (three, others) = (squeeze(grips, holding, reserve, wrenches, threads) for threads in (1, 3))
    assert np.array_equal(one.local, three.local) and np.array_equal(one.status, three.status)
    for way, other in zip(ways, others):
        assert np.array_equal(way.change, other.change)
        multiples = [find_multiples(one.local, way, friction, MU, threads=threads) for threads in (1, 3)]
        assert np.array_equal(*multiples)
    assert np.array_equal(*(find_least_mu(grips, holding, threads) for threads in (1, 3)))


@pytest.mark.parametrize("torsion", [0.0, 5e-3])
def test_the_least_friction_of_pyramids_is_that_of_linear_programs(torsion):
    friction = Friction(model="pyramid", torsion=torsion, safety=1.3)
    seed = secrets.randbelow(10**9)
    grips = around_a_ball(np.random.default_rng(seed), 40, 4)
    least = find_least_mu(grips, Holding(friction=friction, mu=MU, weight=WEIGHT, cap=np.inf), 1)
    assert np.isfinite(least).sum() > 5, seed

    def holds(i, mu):
        G, rows = [], []
        own, limits = grips.counts[i], friction.scale(np.array([mu]))[0]
        for c in range(own):
            for j in range(friction.d):
                one = np.zeros((4, friction.d))
                one[c, j] = 1.0
                G.append(wrench_of(grips, one, i))
            block = np.hstack([friction.facets / limits, -np.ones((len(friction.facets), 1))])
            rows.append(np.hstack([np.zeros((len(block), friction.d * c)), block]))
            rows[-1] = np.pad(rows[-1], ((0, 0), (0, friction.d * (own - c - 1))))
        bounds = ([(None, None)] * (friction.d - 1) + [(0, 100 * 9.81 * 0.15)]) * own  # F_n comes last
        A, scale = np.array(G).T, np.repeat([1.0, 1.0 / RADIUS], 3)[:, None]
        rows = np.vstack(rows)
        found = linprog(np.zeros(A.shape[1]), rows, np.zeros(len(rows)), A * scale, -WEIGHT * scale[:, 0], bounds)
        return found.status == 0

    for i in range(40):
        if np.isfinite(least[i]):
            assert holds(i, least[i] + 1e-6) and not (least[i] > 0.01 and holds(i, least[i] - 0.01)), (seed, i)
        else:
            assert not holds(i, MOST_MU - 1e-6), (seed, i)


def test_wrenches_that_contacts_cannot_balance_are_told():
    """Two plain contacts do not resist turning about their line; with torsion they do."""
    normals = np.array([[[1.0, 0, 0], [-1.0, 0, 0]]])
    frames = np.array([[tangent_frame(normal) for normal in normals[0]]])
    wrenches = np.array([[0, 0, 1.0, 0, 0, 0], [0, 0, 0, 0.1, 0, 0]])
    grips = Grips(points=-RADIUS * normals, rotations=frames, counts=np.array([2]))
    plain, soft = (react(grips, friction, wrenches) for friction in MODELS[:2])
    assert plain.borne.tolist() == [[True, False]] and soft.borne.tolist() == [[True, True]]


@pytest.mark.parametrize("friction", MODELS, ids=NAMES)
def test_a_squeeze_bears_every_load_it_is_for(friction):
    """Balance and friction under every load, written out from their definitions."""
    rng, reserve = np.random.default_rng(3), Reserve()
    grips = around_a_ball(rng, 24, 5)
    wrenches = reserve.load_set(BALL).loads - WEIGHT
    holding = Holding(friction=friction, mu=MU, weight=WEIGHT, cap=np.inf)
    found, ways = squeeze(grips, holding, reserve, wrenches, 1)
    assert found.found.sum() >= 12
    kept = holding.kept_back(reserve).friction
    both = np.maximum(*(find_multiples(found.local, way, kept, MU) for way in ways))
    assert both[found.found].min() > 1 - 1e-6
    for i in np.flatnonzero(found.found)[:8]:
        own, local = grips.counts[i], found.local[i]
        assert np.allclose(wrench_of(grips, local, i), -WEIGHT, atol=1e-7)
        problem = problem_of(grips, i, friction)
        # With its own springs and friction free to react, within what the reserve relies on.
        strict = replace(problem, friction=kept)
        for wrench in wrenches[:: 3 if i else 1]:
            borne = disturbance_margin(strict, wrench, normal_forces=local[:own, -1], reaction="elastic")
            assert borne > 1 - 1e-5
        least = least_squeeze(problem, reserve)
        assert least is not None and local[:own, -1].max() >= least.max() * (1 - 1e-6)
        assert (local[:own, -1] >= 0.05 * 9.81 * 0.15 * (1 - 1e-6)).all()


@pytest.mark.parametrize("friction", MODELS, ids=NAMES)
def test_what_is_proven_hopeless_has_no_squeeze(friction):
    """By the full program; and what is told hopeless by it, at a high enough limit of F_n, is not all proven so."""
    seed = secrets.randbelow(10**9)
    rng, reserve, mu = np.random.default_rng(seed), Reserve(), 0.35
    grips = around_a_ball(rng, 60, 4)
    holding = Holding(friction=friction, mu=mu, weight=WEIGHT, cap=12.0)
    wrenches = reserve.load_set(BALL, np.array([0, 0, -9.81])).loads - WEIGHT
    changes = react(grips, friction, wrenches).normal
    hopeless = find_hopeless(grips, holding, reserve, wrenches, changes, 1)
    assert 3 < hopeless.sum() < 60, seed
    assert not squeeze(grips, holding, reserve, wrenches, 1)[0].found[hopeless].any(), seed
    for i in np.flatnonzero(hopeless)[:6]:
        problem = problem_of(grips, i, friction, mu=mu, max_normal_force=12.0)
        assert least_squeeze(problem, reserve) is None, seed


@pytest.mark.parametrize("friction", MODELS, ids=NAMES)
def test_multiples_that_are_borne_are_where_a_contact_leaves_its_cone(friction):
    rng = np.random.default_rng(4)
    grips, wrenches = around_a_ball(rng, 8, 4), rng.normal(size=(5, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
    reacted = react(grips, friction, wrenches)
    local = rng.normal(size=(8, 4, friction.d))
    local[..., -1] = rng.uniform(2.0, 5.0, size=(8, 4))
    limits = friction.scale(np.array([MU]))[0]
    local[..., :-1] *= 0.4 * limits * local[..., -1:]
    found = find_multiples(local, reacted, friction, MU)
    change = np.concatenate([reacted.tangential, reacted.normal[:, :, None]], axis=2)

    def room(i, m, s):
        own = grips.counts[i]
        f = local[i, :own] + s * change[i, :own, :, m]
        return (f[:, -1] - friction.gauge(f[:, :-1] / limits)).min()

    tried = 0
    for i in range(8):
        for m in range(5):
            if room(i, m, 0.0) < 0 or not np.isfinite(found[i, m]):
                continue
            tried += 1
            assert abs(room(i, m, found[i, m])) < 1e-9 * max(1.0, found[i, m])
            assert all(room(i, m, share * found[i, m]) > 0 for share in np.linspace(0.0, 0.999, 25))
    assert tried > 20


def test_offsets_are_enough_for_any_tangential_force_and_exact_for_one():
    rng, friction = np.random.default_rng(5), MODELS[0]
    grips, wrenches = around_a_ball(rng, 4, 4), rng.normal(size=(6, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
    reacted = react(grips, friction, wrenches)
    above = find_offsets(reacted, friction, MU)
    for _ in range(20):
        t = rng.normal(size=(4, 4, 2))
        F = above + np.linalg.norm(t, axis=2) / MU
        local = np.concatenate([t, F[..., None]], axis=2)
        ahead = t[..., None] + reacted.tangential
        assert (np.linalg.norm(ahead, axis=2) <= MU * (F[..., None] + reacted.normal) + 1e-12)[grips.used].all()
        exact = find_offsets(reacted, friction, MU, local)
        assert (exact <= above + 1e-12).all()
        F = exact + np.linalg.norm(t, axis=2) / MU
        slack = (MU * (F[..., None] + reacted.normal) - np.linalg.norm(ahead, axis=2)).min(axis=2)
        assert (slack[grips.used] > -1e-12).all() and (slack[(exact > 0) & grips.used] < 1e-9).all()


@pytest.mark.parametrize("angle", [0.05, 0.2, 0.35, 0.5])
def test_two_soft_fingers_need_the_friction_of_their_line(angle):
    """Nguyen's theorem: the line through both lies in both cones, so mu = tan of the larger angle."""
    normals = np.array([[[1.0, 0, 0], [-np.cos(angle), np.sin(angle), 0.0]]])
    frames = np.array([[tangent_frame(normal) for normal in normals[0]]])
    grips = Grips(points=np.array([[[-RADIUS, 0, 0], [RADIUS, 0, 0]]]), rotations=frames, counts=np.array([2]))
    holding = Holding(friction=MODELS[1], mu=MU, weight=1e-3 * WEIGHT, cap=np.inf)
    found = find_least_mu(grips, holding, 1)[0]
    # The weight, a thousandth, takes a little more; halving the range ends at a hundredth above.
    assert np.tan(angle) - 1e-3 <= found <= np.tan(angle) + 0.03


def test_no_friction_helps_contacts_on_one_side():
    normals = np.array([[[0, 0, -1.0], [0, 0.1, -1.0]]])
    normals /= np.linalg.norm(normals, axis=2)[..., None]
    frames = np.array([[tangent_frame(normal) for normal in normals[0]]])
    grips = Grips(points=-RADIUS * normals, rotations=frames, counts=np.array([2]))
    holding = Holding(friction=MODELS[1], mu=MOST_MU, weight=WEIGHT, cap=np.inf)
    assert np.isinf(find_least_mu(grips, holding, 1)).all() and not hold_weight(grips, holding, 1).found.any()
