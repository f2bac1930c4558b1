"""The interior-point method against Clarabel on the whole program, with the time as second-order cones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from whole_carries import by_clarabel, pairs

from pinograsp.carry.elimination import GramSchmidt, Householder, Rows
from pinograsp.carry.interior_point import Program, solve, times
from pinograsp.carry.program import gained_by_times
from pinograsp.contacts import Friction

CONE, SOFT, PYRAMID = Friction(model="cone"), Friction(model="soft", torsion=0.01), Friction(model="pyramid", edges=6)
BOTH = Friction(model="cone", torsion=0.01)


def some_program(seed, friction, *, N=25, k=4, rows=0):
    """A grasp that holds its object at rest, along a path whose loads change smoothly."""
    rng = np.random.default_rng(seed)
    d = friction.d
    A = rng.normal(size=(6, k * d))
    # Equal normal forces hold the weight.
    normal = np.zeros(k * d)
    normal[d - 1 :: d] = 5.0
    s = np.linspace(0, 1, N)[:, None]

    def smooth(width, size):
        return size * (rng.normal(size=width) + rng.normal(size=width) * np.sin(3 * s + rng.uniform(0, 6, width)))

    still = A @ normal + 0.0 * smooth(6, 1.0)
    along_a, along_b = smooth(6, 0.3), smooth(6, 0.3)
    step = 1.0 / N
    R = rng.normal(size=(rows, k * d))
    torque = R @ normal
    row_a, row_b = smooth(rows, 0.1), smooth(rows, 0.1)
    top = rng.uniform(2.0, 9.0, N + 1)
    given = np.full(N + 1, np.nan)
    given[[0, -1]] = 0.0
    C_a, C_b = smooth(3, 0.2), smooth(3, 0.1)
    C = pairs(C_a, C_b, step)
    return Program(
        friction=friction,
        k=k,
        A=A,
        E=pairs(along_a, along_b, step),
        e=still,
        R=R,
        B=pairs(row_a, row_b, step),
        low=np.tile(torque - 2.0, (N, 1)),
        high=np.tile(torque + 2.0, (N, 1)),
        C=np.concatenate([C, -C], axis=1),
        c=np.ones((N, 6)),
        least=np.full(k, 0.1),
        most=np.full(k, 12.0),
        top=top,
        given=given,
        step=step,
    )


@pytest.mark.parametrize("friction", [CONE, SOFT, PYRAMID, BOTH], ids=["cone", "soft", "pyramid", "cone and torsion"])
@pytest.mark.parametrize("rows", [0, 5, 16])
@pytest.mark.parametrize("seed", range(4))
def test_the_least_time_is_clarabels(friction, rows, seed):
    program = some_program(seed, friction, rows=rows)
    found, (status, objective) = solve(program), by_clarabel(program)
    assert status in ("Solved", "AlmostSolved")
    assert found.converged
    assert found.gap < 1e-6
    assert found.objective == pytest.approx(objective, rel=1e-6)
    assert found.lower_bound <= objective * (1 + 1e-6)


@pytest.mark.parametrize("friction", [CONE, SOFT, PYRAMID], ids=["cone", "soft", "pyramid"])
def test_the_solution_keeps_to_the_program(friction):
    program = some_program(9, friction, rows=4)
    found = solve(program)
    N, p = program.count, found.y[program.nodes]
    flat = found.x.reshape(N, -1)
    np.testing.assert_allclose(flat @ program.A.T, np.einsum("nbj,nj->nb", program.E, p) + program.e, atol=1e-6)
    rows = flat @ program.R.T + np.einsum("nrj,nj->nr", program.B, p)
    assert (rows < program.high + 1e-7).all()
    assert (rows > program.low - 1e-7).all()
    assert (np.einsum("nrj,nj->nr", program.C, p) < program.c + 1e-7).all()
    normal = found.x[..., -1]
    assert (friction.gauge(found.x[..., :-1]) <= normal + 1e-7).all()
    assert (normal > program.least - 1e-9).all()
    assert (normal < program.most + 1e-9).all()
    assert (found.y >= 0).all()
    assert (found.y <= program.top + 1e-9).all()
    np.testing.assert_array_equal(found.y[[0, -1]], 0.0)


def test_few_facets_at_their_limits_cost_no_digits():
    """One facet of a contact weighs 1e18 times what others do then: squares of that have no digits left."""
    for seed in range(60):
        found = solve(some_program(seed, Friction(model="pyramid", edges=4), k=3), accuracy=1e-9)
        assert max(found.gap, found.residual) < 1e-8, seed


def test_no_speeds_beat_the_lower_bound():
    """Slower timings of the same forces' program are feasible, and none is below the bound."""
    program = some_program(2, CONE)
    found = solve(program)
    for share in (0.3, 0.7, 0.999):
        slower = times((share * found.y)[program.nodes], program.step).value.sum()
        assert slower > found.lower_bound


def test_derivatives_of_the_time():
    rng = np.random.default_rng(0)
    p, step, h = rng.uniform(0.1, 5.0, (20, 2)), 0.01, 1e-6
    found = times(p, step)
    for j in (0, 1):
        d = h * np.eye(2)[j]
        slope = (times(p + d, step).value - times(p - d, step).value) / (2 * h)
        bend = (times(p + d, step).slope - times(p - d, step).slope) / (2 * h)
        np.testing.assert_allclose(found.slope[:, j], slope, rtol=1e-6)
        np.testing.assert_allclose(found.bend[:, j], bend, rtol=1e-5, atol=1e-9)


def test_given_speeds_cost_forces_alone():
    """With all speeds known the least squared forces are those of each interval by itself."""
    program = some_program(5, CONE, N=6)
    y = 0.5 * solve(program).y
    weights = np.ones(program.k * program.friction.d)
    whole = solve(replace(program, step=None, given=y, weights=weights))
    assert whole.converged
    for i in range(program.count):
        part = replace(
            program,
            **{name: getattr(program, name)[i : i + 1] for name in ("E", "e", "B", "low", "high", "C", "c")},
            top=program.top[i : i + 2],
            given=y[i : i + 2],
            step=None,
            weights=weights,
        )
        np.testing.assert_allclose(solve(part).x[0], whole.x[i], atol=2e-4)


@pytest.mark.parametrize("seed", range(3))
def test_rows_that_are_put_back(seed):
    """At rest no forces reach the limits; loads of the way do."""
    program = some_program(seed, CONE, rows=4)
    rows = program.R.reshape(4, program.k, 3)
    reach = 12.0 * (np.abs(rows[..., -1]) + np.linalg.norm(rows[..., :-1], axis=2)).sum(axis=1)
    ends = np.tile(1.01 * reach, (program.count, 1))
    program = replace(program, B=400 * program.B, low=-ends, high=ends)
    found, (_, objective) = solve(program), by_clarabel(program)
    assert (found.rows > 1e-6).any()
    assert found.converged
    assert found.objective == pytest.approx(objective, rel=1e-6)
    assert found.lower_bound <= objective * (1 + 1e-6)
    free = solve(replace(program, low=np.full_like(program.low, -np.inf), high=np.full_like(program.high, np.inf)))
    assert free.objective < found.objective * (1 - 1e-4)


def test_orthogonal_factors():
    """Both ways of them, where columns are all but parallel."""
    rng = np.random.default_rng(0)
    T = rng.normal(size=(6, 15, 20))
    T[1] = T[0] + 1e-7 * rng.normal(size=(15, 20))
    v, w = rng.normal(size=(15, 20)), rng.normal(size=(6, 20))
    for factors in (GramSchmidt(T.copy()), Householder(T)):
        # Q^T Q = 1, Q U = T, and both inverses.
        np.testing.assert_allclose(factors.across(factors.along(w)), w, atol=1e-13)
        rows = np.einsum("rin,in->rn", T, factors.along(w))
        np.testing.assert_allclose(factors.transposed(rows), w, atol=1e-6)
        np.testing.assert_allclose(np.einsum("rin,rn->in", T, factors.divided(w)), factors.along(w), atol=1e-6)
        np.testing.assert_allclose(factors.across(v - factors.along(factors.across(v))), 0.0, atol=1e-13)


def test_factors_with_weighted_rows():
    """Rows of very different weights: U^T U is the unit matrix and what they add."""
    rng = np.random.default_rng(0)
    Z, B = rng.normal(size=(5, 9, 130)), rng.normal(size=(5, 2, 130))
    weights = 10.0 ** rng.uniform(-4, 4, (5, 1, 130))
    rows, v = Rows(weights * Z, weights * B), rng.normal(size=(9, 130))
    for i in (0, 99, 129):
        z, b = weights[..., i] * Z[..., i], weights[..., i] * B[..., i]
        H = np.eye(9) + z.T @ z
        np.testing.assert_allclose(H @ rows.divided(rows.transposed(v))[:, i], v[:, i], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(H @ rows.divided(rows.across[0])[:, i], z.T @ b[:, 0], rtol=1e-5)
        left = np.linalg.inv(np.eye(5) + z @ z.T)
        expected = b.T @ left @ b
        np.testing.assert_allclose(rows.left[:, i], expected[[0, 0, 1], [0, 1, 1]], rtol=1e-4)


@pytest.mark.parametrize("seed", range(8))
def test_what_times_gain_beside_a_tangent(seed):
    """Never less than the true minimum, and near it: of a minimiser that does not know the bound."""
    rng = np.random.default_rng(seed)
    y, step = rng.uniform(0.05, 4.0, 7), 0.1
    free = np.ones(7, dtype=bool)
    if seed % 2:
        y[[0, -1]], free[[0, -1]] = 0.0, False

    def ends(z):
        return np.column_stack([z[:-1], z[1:]])

    slope, own = np.zeros(7), times(ends(y), step).slope
    slope[:-1] += own[:, 0]
    slope[1:] += own[:, 1]
    left = np.where(free, rng.normal(size=7) * 1e-4 * np.abs(slope), 0.0)

    def lagrangian(z):
        full = np.array(y)
        full[free] = np.exp(z)
        change = times(ends(full), step).value - times(ends(y), step).value
        return float(change.sum() + (left - np.where(free, slope, 0.0)) @ (full - y))

    least = minimize(lagrangian, np.log(y[free]), method="BFGS", options={"gtol": 1e-12}).fun
    gained = gained_by_times(y, left, free, step)
    assert gained is not None and gained[0] <= least + 1e-13
    assert gained[0] > 300 * least - 1e-13
    assert gained_by_times(y, 1e4 * left, free, step) is None
