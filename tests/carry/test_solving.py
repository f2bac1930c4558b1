"""Programs of carrying: their solutions against another solver's, and against what is asked of them."""

from dataclasses import replace

import numpy as np
import pytest
from whole_carries import by_ecos, pairs

from pinograsp.carry.program import CarryProgram, measure_times
from pinograsp.carry.solving import solve_carry
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
    return CarryProgram(
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
@pytest.mark.parametrize("rows", [0, 16])
@pytest.mark.parametrize("seed", range(2))
def test_the_least_time_is_that_of_another_solver(friction, rows, seed):
    program = some_program(seed, friction, rows=rows)
    found, objective = solve_carry(program), by_ecos(program)
    assert found.is_solution
    assert found.gap < 1e-6
    assert found.objective == pytest.approx(objective, rel=1e-6)
    assert found.lower_bound <= objective * (1 + 1e-6)


@pytest.mark.parametrize("friction", [CONE, SOFT, PYRAMID], ids=["cone", "soft", "pyramid"])
def test_the_solution_keeps_to_the_program(friction):
    program = some_program(9, friction, rows=4)
    found = solve_carry(program)
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
    """One facet of a contact weighs 1e18 times what others do then."""
    for seed in range(15):
        found = solve_carry(some_program(seed, Friction(model="pyramid", edges=4), k=3), accuracy=1e-9)
        assert max(found.gap, found.residual) < 1e-8, seed


def test_no_speeds_beat_the_lower_bound():
    """Slower timings of the same forces' program are feasible, and none is below the bound."""
    program = some_program(2, CONE)
    found = solve_carry(program)
    for share in (0.3, 0.7, 0.999):
        slower = measure_times((share * found.y)[program.nodes], program.step).sum()
        assert slower > found.lower_bound


def test_given_speeds_cost_forces_alone():
    """With all speeds known the least squared forces are those of each interval by itself."""
    program = some_program(5, CONE, N=6)
    y = 0.5 * solve_carry(program).y
    weights = np.ones(program.k * program.friction.d)
    whole = solve_carry(replace(program, step=None, given=y, weights=weights))
    assert whole.is_solution
    for i in range(program.count):
        part = replace(
            program,
            **{name: getattr(program, name)[i : i + 1] for name in ("E", "e", "B", "low", "high", "C", "c")},
            top=program.top[i : i + 2],
            given=y[i : i + 2],
            step=None,
            weights=weights,
        )
        np.testing.assert_allclose(solve_carry(part).x[0], whole.x[i], atol=2e-4)


@pytest.mark.parametrize("seed", range(2))
def test_rows_that_are_put_back(seed):
    """At rest no forces reach the limits; loads of the way do."""
    program = some_program(seed, CONE, rows=4)
    rows = program.R.reshape(4, program.k, 3)
    reach = 12.0 * (np.abs(rows[..., -1]) + np.linalg.norm(rows[..., :-1], axis=2)).sum(axis=1)
    ends = np.tile(1.01 * reach, (program.count, 1))
    program = replace(program, B=400 * program.B, low=-ends, high=ends)
    found, objective = solve_carry(program), by_ecos(program)
    assert (found.rows > 1e-6).any()
    assert found.is_solution
    assert found.objective == pytest.approx(objective, rel=1e-6)
    assert found.lower_bound <= objective * (1 + 1e-6)
    free = solve_carry(
        replace(program, low=np.full_like(program.low, -np.inf), high=np.full_like(program.high, np.inf))
    )
    assert free.objective < found.objective * (1 - 1e-4)
