"""The interior-point method against Clarabel on the whole program, with the time as second-order cones."""

from dataclasses import replace

import clarabel
import numpy as np
import pytest
from scipy import sparse

from pinograsp.carry.interior_point import Program, solve, times
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


def pairs(along_a, along_b, step):
    return np.stack([along_b / 2 - along_a / (2 * step), along_b / 2 + along_a / (2 * step)], axis=2)


def by_clarabel(program):
    """The least time, from all forces, squared speeds, their roots and the times of the intervals as unknowns."""
    N, k, d = program.count, program.k, program.friction.d
    nodes, size = N + 1, N * k * d
    y, root, time = size, size + nodes, size + 2 * nodes
    total = time + N
    blocks, ends, cones = [], [], []

    def add(rows, right, cone):
        blocks.append(sparse.coo_matrix(rows) if not sparse.issparse(rows) else rows)
        ends.append(np.asarray(right, dtype=float))
        cones.append(cone)

    def of(entries, count):
        r, c, v = (np.array(part) for part in zip(*entries))
        return sparse.coo_matrix((v, (r, c)), shape=(count, total))

    def linear(M, pair, i, sign=1.0):
        rows = np.zeros((len(M), total))
        rows[:, i * k * d : (i + 1) * k * d] = M
        rows[:, y + i : y + i + 2] = sign * pair
        return rows

    for j in (0, N):
        add(of([(0, y + j, 1.0)], 1), [program.given[j]], clarabel.ZeroConeT(1))
        # By itself: a root of the solver's tolerance is no longer small.
        add(of([(0, root + j, 1.0)], 1), [np.sqrt(program.given[j])], clarabel.ZeroConeT(1))
    for i in range(N):
        add(linear(program.A, program.E[i], i, -1.0), program.e[i], clarabel.ZeroConeT(6))
        for sign, end in ((1.0, program.high[i]), (-1.0, -program.low[i])):
            if len(program.R):
                rows = sign * linear(program.R, program.B[i], i)
                add(rows, end, clarabel.NonnegativeConeT(len(program.R)))
        rows = np.zeros((program.C.shape[1], total))
        rows[:, y + i : y + i + 2] = program.C[i]
        add(rows, program.c[i], clarabel.NonnegativeConeT(len(rows)))
        for c in range(k):
            first = (i * k + c) * d
            add(of([(0, first + d - 1, -1.0)], 1), [-program.least[c]], clarabel.NonnegativeConeT(1))
            add(of([(0, first + d - 1, 1.0)], 1), [program.most[c]], clarabel.NonnegativeConeT(1))
            if n := program.friction.round_dimensions:
                cone = of([(0, first + d - 1, -1.0), *((1 + j, first + j, -1.0) for j in range(n))], n + 1)
                add(cone, np.zeros(n + 1), clarabel.SecondOrderConeT(n + 1))
            if len(facets := program.friction.facets):
                rows = np.zeros((len(facets), total))
                rows[:, first : first + d - 1], rows[:, first + d - 1] = facets, -1.0
                add(rows, np.zeros(len(facets)), clarabel.NonnegativeConeT(len(facets)))
        # time (root_i + root_i+1) >= 1
        both = [(0, root + i), (0, root + i + 1)]
        cone = [(r, c, -1.0) for r, c in both] + [(2, c, -1.0) for _, c in both]
        add(of([*cone, (0, time + i, -1.0), (2, time + i, 1.0)], 3), [0, 2, 0], clarabel.SecondOrderConeT(3))
    for j in range(nodes):
        add(of([(0, y + j, -1.0)], 1), [0.0], clarabel.NonnegativeConeT(1))
        add(of([(0, y + j, 1.0)], 1), [program.top[j]], clarabel.NonnegativeConeT(1))
        if np.isnan(program.given[j]):
            cone = [(0, y + j, -1.0), (1, root + j, -2.0), (2, y + j, -1.0)]
            add(of(cone, 3), [1, 0, -1], clarabel.SecondOrderConeT(3))
    q = np.zeros(total)
    q[time:] = 2 * program.step
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    A = sparse.csc_matrix(sparse.vstack(blocks))
    found = clarabel.DefaultSolver(
        sparse.csc_matrix((total, total)), q, A, np.concatenate(ends), cones, settings
    ).solve()
    return str(found.status), found.obj_val


@pytest.mark.parametrize("friction", [CONE, SOFT, PYRAMID, BOTH], ids=["cone", "soft", "pyramid", "cone and torsion"])
@pytest.mark.parametrize("rows", [0, 5])
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
