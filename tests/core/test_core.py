"""The compiled core: its methods against NumPy's, on every kind of processor that this one is."""

import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

import numpy as np
import pytest
import reference_methods as reference
from marks import slow_except
from whole_forces import MODELS, problem_with

from pinograsp import core
from pinograsp.forces import MultiplierQP
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.solve.compiled import arrays_of
from pinograsp.forces.solve.program import assemble, energy_terms_at
from pinograsp.forces.solve.template import Template
from pinograsp.motion import OnlineForces

SOME_OBJECTIVES = slow_except(
    ["work", "impulse", "least_squares", {"work": 1.0, "least_squares": 1e-3}], "work", "least_squares"
)


def programs(model, objective, k, seed, **limits):
    problem = problem_with(model, k, seed, **limits)
    weights = {objective: 1.0} if isinstance(objective, str) else objective
    terms = energy_terms_at(problem, weights, 0.85)
    program = assemble(matrices_of(problem, weights), problem.scaled_load, terms, *problem.normal_force_range(0.85))
    return problem, program, Template(program.matrices)


def answer(problem, program, fixed, name):
    code, newton, _, value, bound, x, y, *_ = fixed.grasp(problem).answer(name == "newton", *arrays_of(program, fixed))
    return code, newton, value, bound, x, y


def as_reference(program, fixed):
    """A, P and q of a program, contact by contact, and its torque rows."""
    b, lo, hi, _, _, P, q, powers, _ = arrays_of(program, fixed)
    A = program.A.reshape(-1, program.k, program.d)
    return A, b, np.einsum("jjk->kj", P), q.T, powers, lo, hi


@pytest.mark.parametrize("k", slow_except([1, 3, 8, 9], 3, 9))
@pytest.mark.parametrize("objective", SOME_OBJECTIVES, ids=str)
@pytest.mark.parametrize("model", [name for name, one in MODELS.items() if one.separates])
def test_the_dual_newton_method(model, objective, k):
    gave_up = 0
    for seed in range(3):
        problem, program, fixed = programs(model, objective, k, seed)
        if not program.matrices.separates:
            continue
        friction = problem.friction
        code, newton, value, bound, x, y = answer(problem, program, fixed, "newton")
        status, expected, _ = reference.dual_newton(*as_reference(program, fixed), friction)
        assert (code == core.CONVERGED) == (status == "converged"), seed
        if code != core.CONVERGED:
            assert (program.farkas_bound(y, np.zeros(0)) > 0) == (status == "infeasible")
            continue
        gave_up += not newton  # interior points follow
        own = program.value(expected.ravel())
        # The reference is a little short of its optimum.
        assert value == pytest.approx(own, rel=1e-6, abs=1e-9) and bound <= own * (1 + 1e-6) + 1e-9
        assert value - bound <= 1e-7 * abs(value) + 1e-9
        if program.matrices.P is not None and objective == "least_squares":
            np.testing.assert_allclose(x.reshape(-1, k).T, expected, atol=1e-6)
    assert gave_up <= 1


@pytest.mark.parametrize("objective", SOME_OBJECTIVES, ids=str)
@pytest.mark.parametrize("limited", slow_except([False, True], True))
@pytest.mark.parametrize("model", MODELS)
def test_interior_points(model, limited, objective):
    compared = 0
    for seed in range(3):
        problem, program, fixed = programs(model, objective, 4, seed, limited=limited)
        code, _, value, bound, _, _ = answer(problem, program, fixed, "interior")
        if code != core.CONVERGED:
            continue
        R = program.R[fixed.order]
        ranges = R, program.R_lo[fixed.order], program.R_hi[fixed.order]
        status, x, _, _ = reference.interior_point(*as_reference(program, fixed), problem.friction, *ranges)
        assert status == "converged"
        own = program.value(x.ravel())
        assert value == pytest.approx(own, rel=1e-6) and bound <= own * (1 + 1e-6)
        compared += 1
    assert compared


@pytest.mark.slow
@pytest.mark.parametrize("balance", ["wrench", "force"])
def test_least_squares_in_a_box(balance):
    for seed in range(6):
        problem = problem_with("pyramid", 3 + 2 * seed, seed, balance=balance)
        normal = np.random.default_rng(seed).uniform(0.5, 3.0, problem.k)
        method = MultiplierQP(problem, normal)
        columns = problem.scaled_columns
        H = (columns[:, :, :2] * (problem.pyramid * normal)[None, :, None]).reshape(problem.rows, -1)
        scale = np.linalg.norm(H, axis=0).max()
        for load in (problem.load, 5.0 * problem.load):
            b = (columns[:, :, 2] @ normal + problem.with_load(load).scaled_load) / scale
            k, own = reference.box_least_squares(H / scale, b, 1e-9), method.solve(load).ravel()
            ours, best = (np.linalg.norm(H / scale @ one + b) for one in (own, k))
            # Coordinate descent ends slowly: it is an upper bound, near the least.
            assert ours <= best + 1e-9 and best - ours < 1e-3 and np.abs(own).max() <= 1.0


LEVELS = """
import json, sys
import numpy as np
sys.path[:0] = sys.argv[1:]
from whole_forces import MODELS, problem_with
from pinograsp import core
import pinograsp as pg
found = []
for model in MODELS:
    for k in (1, 3, 4, 8, 9):
        problem = problem_with(model, k, k)
        one = pg.optimize_forces(problem, 0.85, objective="work")
        found.append(one.certificate.objective if one.found else str(one.status))
        if problem.friction.separates:
            online = pg.OnlineForces(problem)
            found.append(online.step(problem.load)[0].ravel().tolist())
            batch = pg.ForceBatch.of([problem] * 11, 0.85)
            found.append(pg.solve_batch(batch, objective="work").objective.tolist())
print(json.dumps([core.load().__name__, core.load().width, found]))
"""


@pytest.mark.slow
def test_every_level_gives_the_same(tmp_path):
    best = core.load().__name__.rpartition("_")[2]
    known = ["base", "v3", "v4"]
    answers = {}
    for level in [*known[: known.index(best) + 1], "unknown"]:
        done = subprocess.run(
            [sys.executable, "-c", LEVELS, *sys.path],
            cwd=tmp_path,
            env={**os.environ, "PINOGRASP_CORE_LEVEL": level},
            capture_output=True,
            text=True,
            timeout=200,
        )
        assert done.returncode == 0, done.stderr
        name, width, answers[level] = json.loads(done.stdout)
        assert name.endswith(level if level in known else best) and width in (1, 2, 4, 8)
    for level, found in answers.items():
        for own, base in zip(found, answers["base"]):
            assert own == base if isinstance(own, str) else own == pytest.approx(base, rel=1e-6, abs=1e-7), level


def test_a_checkout_takes_what_is_installed(tmp_path):
    """Python that is started in a checkout finds its sources first, and they have no compiled modules."""
    sources = Path(core.__file__).parents[1]
    shutil.copytree(sources, tmp_path / "pinograsp", ignore=shutil.ignore_patterns("_core_*", "__pycache__"))
    try:
        expected = any(Path(distribution("pinograsp").locate_file("pinograsp/core")).glob("_core_base.*"))
    except PackageNotFoundError:
        expected = False
    script = "from pinograsp import core; print(core.__file__, core.is_installed())"
    env = {name: value for name, value in os.environ.items() if name not in ("PYTHONSAFEPATH", "PYTHONPATH")}
    there = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=env, capture_output=True, text=True, check=True
    )
    assert there.stdout.split() == [str(tmp_path / "pinograsp" / "core" / "__init__.py"), str(expected)]


def test_sizes_that_do_not_fit_are_refused():
    problem, program, fixed = programs("cone", "work", 4, 0)
    grasp = fixed.grasp(problem)
    given = arrays_of(program, fixed)
    for i in range(7):
        wrong = [np.zeros(99) if j == i else one for j, one in enumerate(given)]
        with pytest.raises(ValueError):
            grasp.answer(True, *wrong)
    with pytest.raises(ValueError):
        grasp.answer(
            True, *given[:7], np.ones((9, 2)) * np.arange(9)[:, None], 0.0
        )  # more powers than there is room for
    within = dict.fromkeys(("residual", "violation", "gap", "vanishing", "negligible"), 1e-6)
    prepared = core.load().Prepared(grasp, True, program.lo, program.hi, np.zeros((0, 2)), **within)
    with pytest.raises(ValueError):
        prepared.solve(np.zeros(6), np.zeros(3), np.zeros(3, dtype=bool))
    with pytest.raises(TypeError):
        prepared.solve(np.zeros(5), np.zeros(22), np.zeros(12, dtype=bool))


def test_the_memory_of_a_loop_outlives_it():
    problem = problem_with("cone", 5, 1)
    online = OnlineForces(problem)
    forces = online.step(problem.load)[0]
    kept = forces.copy()
    del online
    assert np.array_equal(forces, kept)


def test_headers_and_cmake_package_are_where_they_are_said_to_be():
    assert (Path(core.get_include()) / "pinograsp" / "core.hpp").is_file()
    folder = Path(core.get_cmake_dir())
    assert (folder / "pinograsp-core-config.cmake").is_file()
    told = (folder / "pinograsp-core-config-version.cmake").read_text()
    assert f"set(PACKAGE_VERSION {version('pinograsp')})" in told
