"""The force problem as other solvers take it: its matrices against their definition, and answers of others judged."""

from __future__ import annotations

from dataclasses import replace

import clarabel
import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp
from marks import slow_except
from random_grasps import FAMILIES, objective_value, optimum, random_grasp, size_of, violations

import pinograsp as pg
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import TOLERANCE, ForceQP, Tolerance, to_qp, to_socp

QUADRATIC = ("least_squares", "peak", "motor_heat", {"least_squares": 1e-2, "peak": 0.2, "motor_heat": 5.0})
OBJECTIVES = (*QUADRATIC, "impulse", "work", {"work": 20.0, "peak": 0.1, "least_squares": 1e-3})


def cases(family, objectives, count=6):
    """Random grasps with torque limits, each with an objective."""
    for i in range(count):
        grasp = random_grasp(1000 * FAMILIES.index(family) + i, family=family, torques=True, k=3 + i, degenerate="")
        yield replace(grasp, objective=objectives[i % len(objectives)])


def anywhere(program, rng):
    """Unknowns x (n,) of no solver, and as (k, d); the largest F_n and powers stand for what they should."""
    components = [column.component for column in program.columns]
    d = components.index("f_n") + 1
    k = components.count("f_n")
    z = np.column_stack([rng.uniform(-2, 2, (k, d - 1)), rng.uniform(0.1, 2, k)])
    rest = [z[:, -1].max()] if "max f_n" in components else []
    powers = [float(name.removeprefix("f_n^")) for name in dict.fromkeys(components) if name.startswith("f_n^")]
    return np.concatenate([z.ravel(), rest, *(exact_power(program, z[:, -1], power) for power in powers)])


def exact_power(program, F, power):
    """F^p with the exponent of the cone, of which the column's name shows but four digits."""
    exponent = min((1 / a for a in program.cones.power), key=lambda own: abs(own - power))
    return F**exponent


def missed_by(cones, s):
    """Largest distance of s from the inequality cones' faces, of power cones left out."""
    at, worst = cones.zero, 0.0
    if cones.nonnegative:
        worst = max(worst, float(-s[at : at + cones.nonnegative].min()))
    at += cones.nonnegative
    for size in cones.second_order:
        worst = max(worst, float(np.linalg.norm(s[at + 1 : at + size]) - s[at]))
        at += size
    return worst


def assert_same_meaning(grasp, program, x, balance, missed):
    """Objective, balance and the largest miss of a limit at any x are those of its forces, by the oracle."""
    p, t, unit = grasp.problem, grasp.impact_time, program.force_scale
    forces, torsion = program.forces(x), program.torsion(x)
    value = program.objective_scale * (0.5 * x @ (program.P @ x) + program.q @ x) + program.constant
    expected = objective_value(p, t, grasp.objective, forces, torsion)
    assert value == pytest.approx(expected, rel=1e-6)  # the oracle integrates numerically
    net = p.residual(forces, torsion)
    net[3:] /= p.moment_length
    assert np.allclose(balance * unit, net[: p.rows], atol=1e-9 * unit)
    own = program.solution(x, settle=False).certificate
    assert own.violation == pytest.approx(max(missed, 0.0) * unit, rel=1e-9, abs=1e-12 * unit)
    wrong = violations(p, t, forces, torsion)
    assert (missed > 1e-9) == any(by > 1e-9 for name, by in wrong.items() if name != "balance")


@pytest.mark.parametrize("family", ["pyramid", "fine pyramid"])
def test_the_matrices_of_a_qp_mean_what_they_say(family):
    rng = np.random.default_rng(1)
    for grasp in cases(family, QUADRATIC):
        qp = to_qp(grasp.problem, grasp.impact_time, objective=grasp.objective)
        x = anywhere(qp, rng)
        missed = max((qp.G @ x - qp.h).max(), (qp.lb - x).max(), (x - qp.ub).max())
        assert_same_meaning(grasp, qp, x, qp.A @ x - qp.b, missed)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_matrices_over_cones_mean_what_they_say(family):
    rng = np.random.default_rng(2)
    for grasp in cases(family, OBJECTIVES, 7):
        socp = to_socp(grasp.problem, grasp.impact_time, objective=grasp.objective)
        x = anywhere(socp, rng)
        s, cones = socp.b - socp.A @ x, socp.cones
        rows = cones.zero + cones.nonnegative + sum(cones.second_order)
        assert len(s) == rows + 3 * len(cones.power)
        for a, (height, one, F) in zip(cones.power, s[rows:].reshape(-1, 3)):
            assert one == 1 and height**a == pytest.approx(F)  # on the cone's boundary
        assert_same_meaning(grasp, socp, x, -s[: cones.zero], missed_by(cones, s))


def by_clarabel(socp):
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    return clarabel.DefaultSolver(socp.P, socp.q, socp.A, socp.b, socp.cones.clarabel(), settings).solve()


@pytest.mark.slow
@pytest.mark.parametrize("family", slow_except(FAMILIES, "pyramid"))
def test_others_reach_the_oracle_s_optimum_and_are_certified(family):
    solved = 0
    for grasp in cases(family, OBJECTIVES, 7):
        status, expected, _ = optimum(grasp)
        socp = to_socp(grasp.problem, grasp.impact_time, objective=grasp.objective)
        found = by_clarabel(socp)
        for solution in (socp.solution(found.x, z=found.z), socp.solution(found.x)):
            assert solution.problem is grasp.problem and solution.impact_time == grasp.impact_time
            if status == "infeasible":
                assert solution.status is Status.INACCURATE
            elif status == "optimal":
                solved += 1
                size = size_of(grasp.problem, grasp.impact_time, grasp.objective, expected)
                assert solution.status is Status.OK
                assert abs(solution.certificate.objective - expected) <= 1e-6 * size
    assert solved


@pytest.fixture(scope="module")
def pinch():
    ball = pg.Sphere(radius=0.03, mass=0.2)
    return pg.ForceProblem.holding(
        ball,
        pg.contacts_at(None, ball, [[0.03, 0, 0], [-0.03, 0, 0.0]]),
        mu=0.8,
        friction=pg.Friction(),
        max_depth=5e-3,
    )


@pytest.mark.filterwarnings("ignore::UserWarning:qpsolvers")
@pytest.mark.parametrize("solver", sorted({*qpsolvers.available_solvers} - {"ecos", "osqp", "proxqp", "scs"}))
def test_qpsolvers_takes_the_matrices_as_they_are(pinch, solver):
    """In newtons again, by hand: each finger of a pinch bears half the weight, at the pyramid's edge."""
    qp = to_qp(pinch, 0.9, objective="least_squares")
    found = qpsolvers.solve_problem(qpsolvers.Problem(*qp.matrices), solver=solver)
    forces = qp.forces(found.x)
    weight = 0.2 * 9.81
    assert np.allclose(np.linalg.norm(forces[:, :2], axis=1), weight / 2, rtol=1e-3)
    assert np.allclose(forces[:, 2], (weight / 2) / (0.8 / np.sqrt(2)), rtol=1e-3)
    assert qp.solution(found.x, y=found.y, z=found.z).certificate.is_optimal(
        Tolerance(residual=1e-4, violation=1e-4, gap=1e-3)
    )


def test_a_column_says_what_it_means():
    box = pg.Box(size=(0.04, 0.04, 0.04), mass=0.3)
    contacts = pg.contacts_at(None, box, [[0.02, 0, 0], [-0.02, 0, 0]])
    problem = pg.ForceProblem.holding(
        box,
        contacts,
        mu=[0.5, 0.8],
        friction=pg.Friction(torsion=3e-3, safety=2.0),
        max_normal_force=[10.0, 15.0],
        max_depth=5e-3,
    )
    socp = to_socp(problem, 0.9, objective={"peak": 1.0, "work": 1.0})
    unit = socp.force_scale
    assert [column.component for column in socp.columns[:8]] == ["f_x", "f_y", "m_n", "f_n"] * 2
    assert [column.unit for column in socp.columns[:4]] == ["N", "N", "N m", "N"]
    scales = [column.scale for column in socp.columns[:5]]
    assert np.allclose(scales, unit * np.array([0.25, 0.25, 1.5e-3, 1.0, 0.4]))
    assert socp.columns[8] == ("", "max f_n", "N", unit)
    assert socp.columns[9].component == "f_n^1.667" and socp.columns[9].scale == pytest.approx(unit ** (5 / 3))
    assert len(repr(socp)) <= 300 and len(repr(to_qp(problem, 0.9, objective="peak"))) <= 300
    # The caps are bounds, in the same unit.
    qp = to_qp(problem, 0.9, objective="peak")
    assert isinstance(qp, ForceQP) and np.allclose(qp.ub[[3, 7]] * unit, [10.0, 15.0])
    assert not qp.P.flags.writeable and qp.matrices[0].flags.writeable


def test_what_is_wrong_with_an_answer_is_in_its_certificate(pinch):
    qp = to_qp(pinch, 0.9, objective="least_squares")
    right = qpsolvers.solve_problem(qpsolvers.Problem(*qp.matrices), solver="daqp")
    assert qp.solution(right.x, y=right.y, z=right.z).status is Status.OK

    dear = qp.solution(1.5 * right.x, settle=False)  # half the load too much
    assert dear.status is Status.INACCURATE
    assert dear.certificate.residual_norm == pytest.approx(0.5 * dear.certificate.load_size)

    stronger = right.x.copy()
    stronger[2::3] *= 1.2  # admissible, and not cheapest
    found = qp.solution(stronger).certificate
    assert found.violation <= 1e-9 and found.residual_norm <= 1e-9 and found.relative_gap > 0.1

    beyond = right.x.copy()
    beyond[2::3] *= 0.9  # too weak for friction; less than the optimum, which is no merit
    assert qp.solution(beyond).certificate.violation > 0.05 * qp.force_scale

    # Multipliers that are wrong weaken the bound, and never raise it above the optimum.
    best = qp.solution(right.x).certificate.objective
    rng = np.random.default_rng(3)
    for _ in range(20):
        bound = qp.solution(stronger, y=rng.normal(size=6), z=rng.uniform(0, 1, len(qp.h))).certificate.lower_bound
        assert bound <= best * (1 + 1e-9)


def test_settling_removes_the_residual_of_a_loose_solver(pinch):
    qp = to_qp(pinch, 0.9, objective="least_squares")
    right = qpsolvers.solve_problem(qpsolvers.Problem(*qp.matrices), solver="daqp")
    loose = right.x + 1e-5 * np.random.default_rng(4).normal(size=len(right.x))
    as_it_is, settled = (qp.solution(loose, settle=settle).certificate for settle in (False, True))
    assert as_it_is.residual_norm > 1e-7 * qp.force_scale
    assert settled.residual_norm <= TOLERANCE.residual * qp.force_scale


def test_what_no_qp_says_is_refused_with_what_does(pinch):
    with pytest.raises(InvalidInput, match="'cone'.*to_socp"):
        to_qp(replace(pinch, friction=pg.Friction(model="cone")), 0.9, objective="least_squares")
    with pytest.raises(InvalidInput, match=r"'impulse'.*F_n\^1.667.*to_socp"):
        to_qp(pinch, 0.9)
    with pytest.raises(InvalidInput, match="motor_heat.*torques"):
        to_socp(pinch, 0.9, objective="motor_heat")
    with pytest.raises(InvalidInput, match="final time"):
        to_socp(pinch, 1.5)
    qp = to_qp(pinch, 0.9, objective="peak")
    with pytest.raises(InvalidInput, match="x: expected shape"):
        qp.forces([1.0, 2.0])
    with pytest.raises(InvalidInput, match="finite"):
        qp.solution(np.full(len(qp.q), np.nan))
    with pytest.raises(InvalidInput, match="multipliers z"):
        qp.solution(np.zeros(len(qp.q)), z=[1.0])
    # A contact law of exponent 1 makes the impulse quadratic.
    linear = replace(pinch, compliance=pg.MarhefkaOrin(stiffness=4e3, exponent=1.0))
    assert np.count_nonzero(to_qp(linear, 0.9, objective="impulse").P) == 2


def test_scs_takes_the_cones_in_their_order(pinch):
    scs = pytest.importorskip("scs")
    problem = replace(pinch, friction=pg.Friction(model="soft", torsion=4e-3))
    socp = to_socp(problem, 0.9, objective="work")
    data = {"P": sp.csc_matrix(sp.triu(socp.P)), "A": socp.A, "b": socp.b, "c": socp.q}
    options = {"eps_abs": 1e-9, "eps_rel": 0.0, "verbose": False, "max_iters": 100_000}
    found = scs.SCS(data, socp.cones.scs(), **options).solve()
    solution = socp.solution(found["x"], z=found["y"])
    expected = pg.optimize_forces(problem, 0.9, objective="work").certificate.objective
    assert solution.certificate.objective == pytest.approx(expected, rel=1e-6)
    assert solution.certificate.relative_gap <= 1e-5
