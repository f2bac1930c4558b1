"""A hundred thousand random problems: feasible, infeasible by little and by much, degenerate, of all sizes."""

from __future__ import annotations

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import Status
from pinograsp.forces.solve.batch import program_of
from pinograsp.forces.solve.conic import ConicMethod, exponents_of
from pinograsp.spatial import tangent_frame

MODELS = {"cone": pg.Friction(model="cone"), "pyramid": pg.Friction(), "soft": pg.Friction(model="soft", torsion=3e-3)}
OBJECTIVES = {"cone": "least_squares", "pyramid": "least_squares", "soft": "work"}
DEGENERATE = ("", "no friction", "duplicates", "parallel normals", "collinear", "no load", "one force")


def random_batch(count: int, seed: int, model: str) -> pg.ForceBatch:
    """Contacts on bodies of 1 mm to 1 m, loads of 1 mN to 1 kN, mu from 0 to 2, 2 to 8 contacts."""
    rng, k = np.random.default_rng(seed), 8
    size = 10 ** rng.uniform(-3, 0, count)
    out = rng.normal(size=(count, k, 3))
    kind = rng.integers(0, 3 * len(DEGENERATE), count)
    kind[kind >= len(DEGENERATE)] = 0
    which = {name: kind == i for i, name in enumerate(DEGENERATE)}
    out[which["parallel normals"]] = out[which["parallel normals"]][:, :1] * np.array([1.0, -1.0] * (k // 2))[:, None]
    out /= np.linalg.norm(out, axis=2, keepdims=True)
    points = size[:, None, None] * out * rng.uniform(0.7, 1.3, (count, k, 1))
    line = which["collinear"]
    points[line] = size[line, None, None] * rng.uniform(-1, 1, (line.sum(), k, 1)) * out[line][:, :1]
    points[which["parallel normals"]] += (
        0.5 * size[which["parallel normals"], None, None] * rng.normal(size=(which["parallel normals"].sum(), k, 3))
    )
    twice = which["duplicates"]
    points[twice, 1::2], out[twice, 1::2] = points[twice, ::2], out[twice, ::2]
    rotations = np.array([[tangent_frame(-n) for n in row] for row in out])
    mu = rng.uniform(0, 2, (count, k))
    mu[which["no friction"]] = 0.0
    force = 10 ** rng.uniform(-3, 3, count)
    loads = np.concatenate(
        [force[:, None] * rng.normal(size=(count, 3)), (force * size)[:, None] * rng.normal(size=(count, 3))], axis=1
    )
    loads[which["no load"]] = 0.0
    high = force[:, None] * 10 ** rng.uniform(-0.5, 1.5, (count, k))
    low = high * 10 ** rng.uniform(-4, -0.3, (count, k))
    low[which["one force"]] = high[which["one force"]]
    return pg.ForceBatch(
        points=points,
        rotations=rotations,
        loads=loads,
        mu=mu,
        low=low,
        high=high,
        counts=rng.integers(2, k + 1, count),
        friction=MODELS[model],
        energies={"work": np.array([[2e-3, 5 / 3]])},
    )


def left_over(batch: pg.ForceBatch, found) -> tuple[np.ndarray, np.ndarray]:
    """What forces leave of the loads, over the larger of load and forces (N,), and the largest violation of limits, by
    plain NumPy.
    """
    used = np.arange(batch.mu.shape[1]) < batch.counts[:, None]
    f = np.einsum("nkij,nkj->nki", batch.rotations, found.forces_c) * used[:, :, None]
    moment = np.cross(batch.points, f) + batch.rotations[:, :, :, 2] * (found.torsion * used)[:, :, None]
    net = batch.loads + np.concatenate([f.sum(axis=1), moment.sum(axis=1)], axis=1)
    net[:, 3:] /= batch.moment_lengths[:, None]
    load = batch.loads.copy()
    load[:, 3:] /= batch.moment_lengths[:, None]
    size = np.maximum(np.linalg.norm(load, axis=1), np.abs(found.forces_c).max(axis=(1, 2)))
    F, friction = found.forces_c[:, :, 2], batch.friction
    x, y = np.abs(found.forces_c[:, :, 0]), np.abs(found.forces_c[:, :, 1])
    if friction.model == "pyramid":
        over = np.maximum(x, y) - batch.mu * F / np.sqrt(2)
    elif friction.model == "cone":
        over = np.hypot(x, y) - batch.mu * F
    else:
        over = np.hypot(np.hypot(x, y), batch.mu * found.torsion / friction.torsion) - batch.mu * F
    over = np.where(used, np.maximum(over, np.maximum(batch.low - F, F - batch.high)), 0.0).max(axis=1)
    return np.linalg.norm(net, axis=1) / np.maximum(size, 1e-300), over / np.maximum(size, 1e-300)


def checked(batch: pg.ForceBatch, objective: str, sample) -> dict:
    found = pg.solve_batch(batch, objective=objective)
    for values in (found.forces_c, found.torsion, found.objective, found.lower_bound):
        assert np.isfinite(values).all()
    net, over = left_over(batch, found)
    assert net[found.ok].max() <= 1e-9 and over[found.ok].max() <= 1e-8
    counts = {
        status: int((found.status == status).sum()) for status in (Status.OK, Status.INFEASIBLE, Status.INACCURATE)
    }
    # A sample against another solver: its optimum, and feasibility a hair's breadth within the limits.
    worst, refused = 0.0, 0
    for i in sample:
        _, program = program_of(batch, int(i), {objective: 1.0})
        other = ConicMethod(program.matrices, exponents_of(program)).solve(program)
        if found.ok[i]:
            if other is not None:
                x = other[0]
                violation, _, residual = program.violations(x)
                if violation <= 1e-9 and np.linalg.norm(residual) <= 1e-9:
                    value = program.value(x) * program.objective_scale
                    worst = max(worst, (found.objective[i] - value) / max(abs(value), 1e-9 * program.objective_scale))
        elif other is not None:
            violation, _, residual = program.violations(other[0])
            refused += violation <= 1e-10 and np.linalg.norm(residual) <= 1e-10
    return counts | {"general": found.general, "worst": worst, "refused": refused}


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.no_cover
def test_random_problems(model):
    report = checked(random_batch(3000, 1, model), OBJECTIVES[model], range(0, 3000, 30))
    assert report["refused"] == 0 and report["worst"] <= 1e-8, report
    assert report[Status.OK] >= 300 and report[Status.INFEASIBLE] >= 300 and report[Status.INACCURATE] <= 3, report


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_a_hundred_thousand_random_problems(model, often):
    count = often(34_000)
    report = checked(random_batch(count, 2, model), OBJECTIVES[model], range(0, count, 34))
    print(model, report)
    assert report["refused"] == 0 and report["worst"] <= 1e-8, report
    assert report[Status.INACCURATE] <= count / 1000, report
