"""Many problems at once: the same answers as one by one, with their checks made by other arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import around_cylinder
from marks import slow_except

import pinograsp as pg
from pinograsp.errors import InvalidInput, Status

MODELS = {
    "pyramid": pg.Friction(safety=1.1),
    "cone": pg.Friction(model="cone"),
    "soft": pg.Friction(model="soft", torsion=4e-3),
    "cone, torsion": pg.Friction(model="cone", torsion=4e-3),
    "8 edges": pg.Friction(edges=8),
}
IMPACT = 0.9


def problems_of(friction, count, seed, balance="wrench"):
    """Ragged grasps under loads of which some cannot be held."""
    rng, made = np.random.default_rng(seed), []
    for _ in range(count):
        k = int(rng.integers(2, 8))
        radius = 10 ** rng.uniform(-2.5, 0.0)
        points = around_cylinder(rng, k, radius)
        contacts = pg.contacts_at(None, pg.Cylinder(radius=radius, height=4 * radius, mass=0.2), points)
        load = np.append(rng.normal(size=3), radius * rng.normal(size=3)) * 10 ** rng.uniform(-2, 1)
        made.append(
            pg.ForceProblem(
                contacts=contacts,
                load=load,
                mu=rng.uniform(0.2, 1.2, k),
                friction=friction,
                balance=balance,
                max_depth=5e-3,
            )
        )
    return made


@pytest.mark.parametrize(
    "objective", slow_except(["work", "impulse", "least_squares", {"work": 1.0, "least_squares": 1e-3}], "work")
)
@pytest.mark.parametrize("name", MODELS)
def test_as_one_by_one(name, objective):
    problems = problems_of(MODELS[name], 60, 3)
    batch = pg.ForceBatch.of(problems, IMPACT)
    found = pg.solve_batch(batch, objective=objective)
    counts = {Status.OK: 0, Status.INFEASIBLE: 0}
    for i, problem in enumerate(problems):
        one = pg.optimize_forces(problem, IMPACT, objective=objective, solver="clarabel")
        assert found.status[i] is one.status
        counts[one.status] += 1
        if one.status is not Status.OK:
            assert not found.forces_c[i].any()
            continue
        forces, torsion = found.forces_c[i, : problem.k], found.torsion[i, : problem.k]
        assert found.objective[i] == pytest.approx(one.certificate.objective, rel=3e-6)
        assert (
            found.lower_bound[i] <= found.objective[i] * (1 + 1e-12)
            and found.objective[i] - found.lower_bound[i] <= 1e-6 * found.objective[i]
        )
        left = problem.scaled_norm(problem.residual(forces, torsion if problem.friction.d == 4 else None))
        assert left <= 1e-9 * problem.scaled_norm(problem.load) and left == pytest.approx(
            found.residual_norm[i], abs=1e-9 * problem.scaled_norm(problem.load)
        )
        gauge = problem.friction.gauge(
            np.column_stack([forces[:, :2], torsion])[:, : problem.friction.d - 1] / problem.friction.scale(problem.mu)
        )
        low, high = problem.normal_force_range(IMPACT)
        size = forces[:, 2].max()
        assert (
            np.all(gauge <= forces[:, 2] + 1e-8 * size)
            and np.all(forces[:, 2] >= low - 1e-8 * size)
            and np.all(forces[:, 2] <= high + 1e-8 * size)
        )
    assert min(counts.values()) >= 5
    if not (name == "8 edges" or (name == "soft" and objective not in ("work", "impulse"))):
        assert found.general <= 3


def test_force_balance_and_threads():
    problems = problems_of(MODELS["cone"], 40, 4, balance="force")
    batch = pg.ForceBatch.of(problems, np.linspace(0.85, 0.95, 40))
    one, two = pg.solve_batch(batch, threads=1), pg.solve_batch(batch)
    assert np.array_equal(one.forces_c, two.forces_c) and list(one.status) == list(two.status) and one.ok.sum() >= 10
    with pytest.raises(InvalidInput, match="threads"):
        pg.solve_batch(batch, threads=10_000)


def test_arrays_need_no_problems():
    """Limits, loads and contacts as arrays; numbers apply to all."""
    (problem,) = problems_of(MODELS["cone"], 1, 9)
    n, rng = 500, np.random.default_rng(0)
    base = problem.contacts
    batch = pg.ForceBatch(
        points=np.tile(base.points_o - base.com_o, (n, 1, 1)),
        rotations=np.tile(base.rotations_oc, (n, 1, 1, 1)),
        loads=np.array(problem.load) * rng.uniform(0.01, 2.0, (n, 1)),
        mu=0.8,
        low=0.01,
        high=30.0,
        friction=MODELS["cone"],
    )
    found = pg.solve_batch(batch)
    assert len(batch) == n and found.ok.sum() >= 100
    squares = (found.forces_c**2).sum(axis=(1, 2))
    assert found.objective[found.ok] == pytest.approx(squares[found.ok], rel=1e-9)
    with pytest.raises(InvalidInput, match="energies"):
        pg.solve_batch(batch, objective="work")


def test_unusable_batches_are_refused():
    problems = problems_of(MODELS["cone"], 3, 5)
    batch = pg.ForceBatch.of(problems, IMPACT)
    bad_frame = np.array(batch.rotations)
    bad_frame[1, 0] *= 2
    for change, message in (
        ({"points": np.zeros((3, 4))}, "points"),
        ({"rotations": bad_frame}, "problem 1, contact 0"),
        ({"mu": -0.1}, "mu"),
        ({"low": 2.0, "high": 1.0}, "low <= high"),
        ({"counts": [1, 2, 99]}, "counts"),
        ({"counts": [0, 2, 2]}, "counts"),
        ({"loads": np.full((3, 6), np.nan)}, "loads"),
        ({"balance": "none"}, "balance"),
        ({"moment_lengths": 0.0}, "moment lengths"),
        ({"energies": {"heat": np.ones((1, 2))}}, "energy"),
        ({"energies": {"work": -np.ones((1, 2))}}, "coefficients"),
        ({"friction": 0.5}, "Friction"),
    ):
        with pytest.raises(InvalidInput, match=message):
            replace(batch, **change)
    with pytest.raises(InvalidInput, match="differ"):
        pg.ForceBatch.of([problems[0], *problems_of(MODELS["soft"], 1, 5)], IMPACT)
    with pytest.raises(InvalidInput, match="at least one"):
        pg.ForceBatch.of([], IMPACT)
    with pytest.raises(InvalidInput, match="below the final time"):
        pg.ForceBatch.of(problems, 2.0)
    with pytest.raises(InvalidInput, match="ForceBatch"):
        pg.solve_batch(problems)
    with pytest.raises(InvalidInput, match="objective"):
        pg.solve_batch(batch, objective="beauty")


@pytest.mark.parametrize("balance", ["force", "wrench"])
def test_multiplier_qp_is_the_refinement(balance):
    """The same residual as the certified refinement's, under loads that can and cannot be balanced."""
    from pinograsp.forces import MultiplierQP, refine_multipliers

    rng, balanced = np.random.default_rng(1), 0
    for problem in problems_of(MODELS["pyramid"], 20, 7, balance):
        normal = rng.uniform(0.2, 2.0, problem.k)
        qp = MultiplierQP(problem, normal)
        for size in (0.0, 0.3, 3.0):
            multipliers = rng.uniform(-0.9, 0.9, (problem.k, 2))
            load = -problem.with_load(np.zeros(6)).residual(problem.forces(normal, multipliers)) + size * rng.normal(
                size=6
            ) * [1, 1, 1, 0.01, 0.01, 0.01]
            known = problem.with_load(load)
            found, exact = qp.solve(load), refine_multipliers(known, normal)
            left = known.scaled_norm(known.residual(known.forces(normal, found)))
            assert np.abs(found).max() <= 1.0
            assert (
                left == pytest.approx(exact.certificate.residual_norm, abs=1e-7 * normal.sum())
                and left >= exact.certificate.lower_bound - 1e-7 * normal.sum()
            )
            balanced += left < 1e-6
    assert balanced >= 20
    whole = np.array(qp.solve(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])))
    strided = np.zeros((6, 2))
    strided[2] = -1.0
    for same in ([0, 0, -1, 0, 0, 0], np.array([0, 0, -1, 0, 0, 0]), strided[:, 0]):  # any load of six numbers
        assert np.array_equal(qp.solve(same), whole)
    with pytest.raises(InvalidInput, match="load"):
        qp.solve(np.array(["much"] * 6))
    with pytest.raises(InvalidInput, match="load"):
        qp.solve(np.full(6, np.nan))
    with pytest.raises(InvalidInput, match="load"):
        qp.solve([1.0, 2.0])
    with pytest.raises(InvalidInput, match="normal forces"):
        MultiplierQP(problem, np.zeros(problem.k))


@pytest.mark.parametrize("measure", ["work", "impulse"])
def test_damping_may_be_missing_in_some_of_the_problems(make_problem, measure):
    problems = [
        make_problem(balance="wrench", compliance=pg.MarhefkaOrin(damping=damping))
        for damping in (0.0, 100.0, 0.0, 400.0)
    ]
    found = pg.solve_batch(pg.ForceBatch.of(problems, 0.85), objective=measure)
    for i, problem in enumerate(problems):
        alone = pg.optimize_forces(problem, 0.85, objective=measure)
        assert found.status[i] is Status.OK and found.objective[i] == pytest.approx(
            alone.certificate.objective, rel=1e-6
        )
        by_integral = problem.energy(found.forces_c[i, :, 2], 0.85, measure).sum()
        assert found.objective[i] == pytest.approx(by_integral, rel=1e-6)
