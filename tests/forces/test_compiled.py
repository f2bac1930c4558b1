"""The compiled solvers: the same answers as the general ones, the same checks, and what they hand over."""

from __future__ import annotations

import builtins
import gc
import importlib
import json
import os
import pickle
import pkgutil
import re
import runpy
import shutil
import subprocess
import sys
import tracemalloc
import typing
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from random_grasps import random_grasp

import pinograsp as pg
from pinograsp.contacts import Friction
from pinograsp.errors import ExtraMissing, InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    ForceSolver,
    TorqueLimits,
    force_sensitivity,
    optimize_forces,
    optimize_grasp,
    warm_up,
)

MODELS = {
    "pyramid": Friction(),
    "pyramid, torsion": Friction(torsion=0.004),
    "fine pyramid": Friction(edges=10),
    "cone": Friction(model="cone", safety=1.1),
    "cone, torsion": Friction(model="cone", torsion=0.004),
    "soft": Friction(model="soft", torsion=0.004),
}


@pytest.fixture(scope="module", autouse=True)
def compiled():
    warm_up()


def grasps(contact_set, k, count, seed):
    """Random contacts on a cylinder under random loads of about half of what they could hold."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        angle = np.linspace(0, 2 * np.pi, k, endpoint=False) + rng.uniform(-0.3, 0.3, k)
        out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(k)])
        points = 0.03 * out + np.column_stack([np.zeros((k, 2)), rng.uniform(-0.03, 0.03, k)])
        contacts = contact_set([(f"c{i}", "", p, -o, None) for i, (p, o) in enumerate(zip(points, out))])
        load = np.append(rng.normal(size=3), 0.01 * rng.normal(size=3)) * rng.uniform(0.3, 2.0)
        yield contacts, load


def joint_limits(k, seed=0):
    """Two joints of each contact's own, two that all contacts load; loose enough for the loads here."""
    rng = np.random.default_rng(seed)
    jacobian = np.zeros((k, 6, 2 * k + 2))
    for i in range(k):
        jacobian[i, :3, 2 * i : 2 * i + 2] = rng.uniform(-0.05, 0.05, (3, 2))
    jacobian[:, :3, -2:] = rng.uniform(-0.05, 0.05, (k, 3, 2))
    return TorqueLimits(jacobian=jacobian, bias=np.full(2 * k + 2, 0.01), limit=np.full(2 * k + 2, 0.15))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("objective", ["work", "impulse", "least_squares", {"work": 1.0, "least_squares": 1e-3}])
@pytest.mark.parametrize("k", [3, 8])
@pytest.mark.parametrize("solver", ["newton", "interior", "interior, torque limits"])
def test_same_optimum_as_the_general_method(contact_set, model, objective, k, solver):
    solver, _, limited = solver.partition(",")
    agreed = 0
    for contacts, load in grasps(contact_set, k, 6, 10 * k):
        torques = joint_limits(k) if limited else None
        problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=MODELS[model], torques=torques)
        slow = optimize_forces(problem, 0.85, objective=objective, backend="clarabel")
        for fast in (
            optimize_forces(problem, 0.85, objective=objective, backend=solver),
            ForceSolver(problem.with_load(0.5 * load), 0.85, objective=objective, backend=solver).solve(load),
        ):
            assert fast.status is slow.status
            if fast.status is Status.OK:
                agreed += fast.backend == solver
                assert fast.certificate.objective == pytest.approx(slow.certificate.objective, rel=2e-6)
                assert fast.certificate.relative_gap <= 1e-6
                assert fast.certificate.residual_force < 1e-9 and fast.certificate.violation < 1e-8
                assert fast.certificate.at_torque == slow.certificate.at_torque
    if solver == "interior":
        assert agreed >= 6
    else:
        separates = model != "fine pyramid" and not (model == "soft" and objective not in ("work", "impulse"))
        assert (agreed >= 6) is separates


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("balance", ["wrench", "force"])
def test_both_paths_write_the_same_record(contact_set, model, balance):
    """Whole compiled calls against the program's path with the same method, field by field."""
    from pinograsp.forces.backends import Backends
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.program import assemble, energy_terms_at
    from pinograsp.forces.solution import solution_of

    for contacts, load in grasps(contact_set, 4, 3, 5):
        problem = ForceProblem(
            contacts=contacts,
            load=load,
            mu=[0.7, 0.6, 0.8, 0.7],
            friction=MODELS[model],
            balance=balance,
            max_normal_force=[5.0, 6.0, 7.0, 50.0],
            torques=joint_limits(4),
        )
        objective = {"work": 1.0, "least_squares": 1e-3}
        whole = optimize_forces(problem, 0.85, objective=objective, backend="interior")
        matrices = matrices_of(problem, objective)
        terms = energy_terms_at(problem, objective, 0.85)
        program = assemble(matrices, problem.scaled_load, terms, *problem.normal_force_range(0.85))
        outcome = Backends(matrices, "interior").solve(problem, program)
        parts = solution_of(problem, outcome, impact_time=0.85, weights=objective, started=0.0)
        assert whole.backend == parts.backend == "interior" and whole.status is parts.status is Status.OK
        for name in ("acceleration", "multipliers", "forces_c", "torsion"):
            assert getattr(whole, name) == pytest.approx(getattr(parts, name), rel=1e-5, abs=1e-6), name
            assert not getattr(whole, name).flags.writeable
        assert whole.residual == pytest.approx(parts.residual, abs=1e-9 if balance == "wrench" else 1e-6)
        one, two = whole.certificate, parts.certificate
        for fast, slow in ((whole, parts), (one, two)):  # made without their constructors
            assert all(type(getattr(fast, f.name)) is type(getattr(slow, f.name)) for f in fields(slow))
        for name in ("at_friction", "at_least", "at_most"):
            assert np.array_equal(getattr(one, name), getattr(two, name)), name
        assert one.at_torque == two.at_torque and one.objective_size == pytest.approx(two.objective_size)
        assert (one.objective, one.lower_bound) == pytest.approx((two.objective, two.lower_bound), rel=1e-9)
        assert max(one.residual_norm, one.violation) < 1e-8


def test_nothing_is_compiled_after_warming_up(contact_set):
    """The first real call must not compile: numba compiles once per combination of argument types."""
    from pinograsp.forces import compiled

    known = {name: len(getattr(compiled, name).signatures) for name in ("answer", "solve_one")}
    for model in MODELS.values():
        for contacts, load in grasps(contact_set, 3, 2, 2):
            for torques in (None, joint_limits(3)):
                for cap in (None, 4.0):
                    problem = ForceProblem(
                        contacts=contacts, load=load, mu=0.7, friction=model, torques=torques, max_normal_force=cap
                    )
                    for objective in ("work", "impulse", "least_squares"):
                        for t in (0.85, 0.9):
                            optimize_forces(problem.with_load(0.9 * load), t, objective=objective)
    assert known == {name: len(getattr(compiled, name).signatures) for name in known} == {"answer": 1, "solve_one": 1}


def test_another_load(contact_set):
    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7)
    changed, made = problem.with_load(2 * load), ForceProblem(contacts=contacts, load=2 * load, mu=0.7)
    assert np.array_equal(changed.load, made.load) and np.array_equal(problem.load, load)
    assert optimize_forces(changed, 0.85).certificate.objective == pytest.approx(
        optimize_forces(made, 0.85).certificate.objective, rel=1e-8
    )
    with pytest.raises(InvalidInput, match="load"):
        problem.with_load([1.0, np.nan, 0, 0, 0, 0])


def test_bounds_that_leave_no_room_go_to_the_general_method(contact_set):
    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=Friction(model="cone"))
    lo, _hi = problem.normal_force_range(0.85)
    for cap, status in ((lo * 0.5, Status.INFEASIBLE), (lo, Status.INFEASIBLE)):
        found = optimize_forces(replace(problem, max_normal_force=cap), 0.85, backend="interior")
        assert found.status is status


def test_force_balance_and_many_contacts(contact_set):
    for contacts, load in grasps(contact_set, 60, 2, 0):
        for balance in ("force", "wrench"):
            problem = ForceProblem(
                contacts=contacts, load=load, mu=0.5, balance=balance, friction=Friction(model="cone")
            )
            found = optimize_forces(problem, 0.9, objective="least_squares", backend="newton")
            assert found.status is Status.OK and found.backend == "newton"


def test_auto_uses_them_only_where_they_apply(contact_set):
    contacts, load = next(grasps(contact_set, 5, 1, 1))
    settings = {"contacts": contacts, "load": load, "mu": 0.7}
    problem = ForceProblem(**settings)
    for _ in range(2):
        assert optimize_forces(problem, 0.85).backend == "newton"
        assert optimize_forces(problem, 0.85, objective="least_squares").backend == "newton"
        assert optimize_forces(problem, 0.85, objective="peak").backend == "daqp"
        assert optimize_forces(ForceProblem(**settings, friction=Friction(edges=8)), 0.85).backend == "interior"
        limited = ForceProblem(**settings, torques=joint_limits(5))
        assert optimize_forces(limited, 0.85).backend == "interior"
        assert optimize_forces(limited, 0.85, objective="motor_heat").backend == "daqp"  # joints that all contacts load
        # Asked for by name where they cannot work: the general method answers, and the record says so.
        for solver in ("newton", "interior"):
            assert optimize_forces(problem, 0.85, objective="peak", backend=solver).backend == "daqp"


def test_infeasible_loads_are_proven(contact_set):
    for contacts, load in grasps(contact_set, 4, 4, 7):
        problem = ForceProblem(contacts=contacts, load=1e3 * load, mu=0.5, friction=Friction(model="cone"))
        for solver in ("newton", "interior"):
            found = optimize_forces(problem, 0.85, backend=solver)
            assert found.status is Status.INFEASIBLE and found.infeasibility.margin > 0


def test_interior_points_recognise_infeasible_loads(contact_set):
    """Mostly without the general methods' help: the multipliers end as a certificate, and never as anything else."""
    from pinograsp.forces.compiled import problem_of
    from pinograsp.forces.kernels.interior import interior_point
    from pinograsp.forces.kernels.layouts import CONVERGED, INFEASIBLE
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.program import assemble
    from pinograsp.forces.template import Template

    proven = 0
    for contacts, load in grasps(contact_set, 4, 4, 7):
        for model in MODELS.values():
            problem = ForceProblem(contacts=contacts, load=1e3 * load, mu=0.5, friction=model)
            terms = {"work": problem.energy_terms(0.85, "work")}
            program = assemble(
                matrices_of(problem, {"work": 1.0}), problem.scaled_load, terms, *problem.normal_force_range(0.85)
            )
            x, y = np.empty((4, program.d)), np.empty(6)
            code, _ = interior_point(problem_of(program, Template(program.matrices)), 0.0, x, y)
            assert code != CONVERGED
            if code == INFEASIBLE:
                proven += 1
                assert program.excluded(y, np.zeros(0)) > 0
    assert proven >= 18  # of 24


def test_dual_newton_recognises_infeasible_loads(contact_set):
    """By itself: its ray is a certificate, whoever checks it, and there is none where there are forces."""
    from pinograsp.forces.kernels.layouts import CONVERGED, INFEASIBLE, Balance, Cones, Costs
    from pinograsp.forces.kernels.newton import dual_newton, newton_scratch
    from pinograsp.forces.kernels.powers import powers_of
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.program import assemble
    from pinograsp.forces.template import Template

    codes = {Status.OK: CONVERGED, Status.INFEASIBLE: INFEASIBLE}
    for factor in (1e3, 1.0):
        for contacts, load in grasps(contact_set, 4, 4, 7):
            for name, model in MODELS.items():
                problem = ForceProblem(contacts=contacts, load=factor * load, mu=0.5, friction=model)
                terms = {"work": problem.energy_terms(0.85, "work")}
                program = assemble(
                    matrices_of(problem, {"work": 1.0}), problem.scaled_load, terms, *problem.normal_force_range(0.85)
                )
                fixed, d = Template(program.matrices), program.d
                if not program.matrices.separates:
                    continue
                x, y, q = np.full((d, 4), 0.1), np.zeros(6), np.zeros((d, 4))
                costs = Costs(q, q, powers_of(np.array(program.powers), 1.0, 1.0))
                cones = Cones(program.lo, program.hi, fixed.friction.radii, fixed.friction.n_round)
                balance, work = Balance(fixed.rows.A, program.b, 0.0), np.empty(newton_scratch(d, 4))
                code, _ = dual_newton(balance, costs, cones, x, y, work)
                expected = codes[optimize_forces(problem, 0.85, objective="work", backend="daqp").status]
                assert code == expected, name
                assert (program.excluded(y, np.zeros(0)) > 0) == (expected == INFEASIBLE)


def test_global_search_through_it(make_problem):
    problem = make_problem(balance="wrench", measure="work", friction=Friction(model="cone"))
    slow = optimize_grasp(problem, backend="daqp")
    for solver in ("newton", "interior"):
        fast = optimize_grasp(problem, backend=solver)
        assert fast.certificate.objective == pytest.approx(slow.certificate.objective, rel=2e-6)
        assert fast.certificate.relative_gap <= 1e-6


def test_every_kernel_is_compiled():
    """A decorator that is lost changes no result, only the time."""
    from numba.core.registry import CPUDispatcher

    plain = {
        name for name, one in kernel_functions() if not isinstance(one, CPUDispatcher) and not isinstance(one, type)
    }
    assert plain == {
        "tick_in",  # for Python; compiled it has another name
        "tick_memory",
        "box_in",  # as well
        "box_memory",
        "pack_grasp",
        "pack_stage",
        "pack_chains",
        "results_in",  # as well
        "room_for_results",
        "_joined",
    }


def kernel_functions():
    """Names and values of what the files of the kernels define and may be called."""
    from pinograsp.forces import kernels

    for found in pkgutil.iter_modules(kernels.__path__, f"{kernels.__name__}."):
        module = importlib.import_module(found.name)
        for name, one in vars(module).items():
            if callable(one) and getattr(one, "__module__", "") == found.name and not name.startswith("__"):
                yield name, one


def holds_arrays(hint):
    """Whether values of a type of an annotation hold arrays."""
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
        return any(map(holds_arrays, typing.get_type_hints(hint).values()))
    return typing.get_origin(hint) is np.ndarray or any(map(holds_arrays, typing.get_args(hint)))


def test_arrays_are_returned_among_functions_that_count_references_alike():
    """An array that is handed from a function that counts none to one that does would be given back too often.

    Functions that become part of their caller are of its kind."""
    from numba.core.registry import CPUDispatcher

    functions = [one for _, one in kernel_functions() if isinstance(one, CPUDispatcher)]
    inlined = [one for one in functions if one.targetoptions.get("inline") == "always"]
    counts = {one: one.targetoptions.get("_nrt", True) for one in functions}
    called = {one: [one.py_func.__globals__.get(name) for name in one.py_func.__code__.co_names] for one in functions}
    called = {one: [name for name in names if isinstance(name, CPUDispatcher)] for one, names in called.items()}
    compared = 0
    for one in functions:
        if one in inlined:
            continue
        known = list(called[one])
        for other in known:
            known += called[other] if other in inlined else []
        for other in known:
            if other not in inlined and holds_arrays(typing.get_type_hints(other.py_func)["return"]):
                compared += 1
                assert counts[other] == counts[one], (one, other)
    assert compared >= 8


def test_missing_numba_names_the_extra(monkeypatch):
    for name in [name for name in sys.modules if re.match(r"pinograsp\.forces\.(compiled|kernels|jit)\b", name)]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("compiled", "kernels", "jit"):
        monkeypatch.delattr(f"pinograsp.forces.{name}", raising=False)
    plain = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "numba" or name.startswith("numba."):
            raise ImportError("No module named 'numba'")
        return plain(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ExtraMissing, match=r"pinograsp\[fast\]"):
        pg.warm_up()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("limited", [False, True])
def test_compiled_checks_equal_the_plain_ones(contact_set, model, limited):
    """Bound and Farkas bound of the compiled certificate, at points and multipliers that are far from any optimum."""
    from pinograsp.forces.compiled import problem_of, solve_program
    from pinograsp.forces.kernels.bounds import bound_of, excluded
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.program import assemble, weights_of
    from pinograsp.forces.template import Template

    rng, compared = np.random.default_rng(0), 0
    for contacts, load in grasps(contact_set, 4, 3, 3):
        torques = joint_limits(4) if limited else None
        problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=MODELS[model], torques=torques)
        for objective in ("work", "impulse", "least_squares"):
            weights = weights_of(objective, problem)
            terms = {} if objective == "least_squares" else {objective: problem.energy_terms(0.85, objective)}
            program = assemble(
                matrices_of(problem, weights), problem.scaled_load, terms, *problem.normal_force_range(0.85)
            )
            fixed, k, d, r = Template(program.matrices), program.k, program.d, len(program.R)
            compiled_problem, scratch = problem_of(program, fixed), np.empty(d)
            answer = solve_program(program, Template(program.matrices), "interior")
            if answer is None:  # infeasible
                continue
            compared += 1
            x, y, w, (violation, gauge, residual, value, bound) = answer
            plain = program.violations(x)
            assert violation == pytest.approx(plain[0], abs=1e-12) and gauge == pytest.approx(plain[1])
            assert residual == pytest.approx(plain[2], abs=1e-12)
            assert value == pytest.approx(program.value(x)) and bound <= program.lower_bound(x, y, w) + 1e-6 * value
            for _ in range(3):
                x, y, w = rng.normal(size=(k, d)), rng.normal(size=6), rng.normal(size=r)
                x[:, -1] = np.clip(np.exp(rng.normal(size=k)), program.lo, program.hi)
                both = np.concatenate([y, w[fixed.order]])
                assert excluded(compiled_problem, both, scratch) == pytest.approx(program.excluded(y, w), rel=1e-9)
                bound, _ = bound_of(compiled_problem, x, both, scratch)
                if not program.powers:  # with them the tangents are each method's own choice
                    assert bound == pytest.approx(program.lower_bound(x.ravel(), y, w), rel=1e-9)
                for _ in range(20):
                    x[:, -1] = rng.uniform(program.lo, np.minimum(program.hi, 3.0))
                    u = rng.normal(size=(k, d - 1))
                    x[:, :-1] = u * (rng.uniform(0, 1, k) * x[:, -1] / program.friction.gauge(u))[:, None]
                    flat = x.ravel()
                    lagrangian = program.value(flat) + y @ (program.A @ flat - program.b) + w @ (program.R @ flat)
                    assert bound <= lagrangian - program.rows_at_their_limits(w) + 1e-9 * abs(bound)
    assert compared >= 3


INTERPRETED = """
import json, sys
import numpy as np
import pinograsp as pg
from pinograsp.forces import TorqueLimits
pg.warm_up()
rng = np.random.default_rng(5)
primal = []
for model in (pg.Friction(), pg.Friction(torsion=0.004), pg.Friction(edges=8), pg.Friction(model="cone"),
              pg.Friction(model="cone", torsion=0.004), pg.Friction(model="soft", torsion=0.004)):
    angle = np.linspace(0, 2 * np.pi, 4, endpoint=False) + rng.uniform(-0.3, 0.3, 4)
    points = 0.03 * np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.5, 0.5, 4)])
    contacts = pg.contacts_at(None, pg.Cylinder(radius=0.03, height=0.2, mass=0.2), points)
    jacobian = np.zeros((4, 6, 6))
    for i in range(4):
        jacobian[i, :3, i] = rng.uniform(-0.05, 0.05, 3)
    jacobian[:, :3, 4:] = rng.uniform(-0.05, 0.05, (4, 3, 2))
    limits = TorqueLimits(jacobian=jacobian, bias=np.full(6, 0.01), limit=np.full(6, 0.3))
    for torques in (None, limits):
        problem = pg.ForceProblem(contacts=contacts, load=[0.3, 0.1, -1.0, 0.002, 0.0, 0.001], mu=0.7, friction=model,
                                  torques=torques)
        for objective in ("work", "impulse", "least_squares"):
            for solver in ("interior", "newton"):
                for _ in range(2):
                    found = pg.optimize_forces(problem, 0.85, objective=objective, backend=solver)
                primal.append([found.backend, found.certificate.objective if found.certificate else None])
    heavy = problem.with_load([300.0, 0, -1000.0, 0, 0, 0])
    primal.append([str(pg.optimize_forces(heavy, 0.85, backend="interior").status), None])
print(json.dumps(primal))
"""


@pytest.mark.slow
def test_interpreted_kernels_give_the_same(tmp_path):
    """Compiled code checks no index: the same functions, interpreted, do, and must agree."""
    answers = {}
    for interpreted in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-c", INTERPRETED],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=500,
            env={**os.environ, "NUMBA_DISABLE_JIT": interpreted},
        )
        assert done.returncode == 0, done.stderr
        answers[interpreted] = json.loads(done.stdout)
    assert len(answers["0"]) == len(answers["1"]) == 78
    assert sum(solver == "interior" for solver, _ in answers["1"]) >= 30
    assert sum(solver == "newton" for solver, _ in answers["1"]) >= 10
    for (one, a), (two, b) in zip(*answers.values()):
        assert one == two and (a == b if a is None else a == pytest.approx(b, rel=1e-7))


def test_problems_go_to_other_processes(contact_set):
    """Without what solvers keep with them, which cannot be pickled, and read-only as before: nothing is compiled anew."""
    from pinograsp.forces import compiled

    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=Friction(model="cone"))
    found = [optimize_forces(problem, 0.85, backend=solver) for solver in ("clarabel", "interior", "interior")][-1]
    there = pickle.loads(pickle.dumps(found))
    assert not there.problem.load.flags.writeable
    known = len(compiled.solve_one.signatures)
    for _ in range(2):
        again = optimize_forces(there.problem, 0.85, backend="interior")
        assert again.certificate.objective == pytest.approx(found.certificate.objective, rel=1e-8)
    assert len(compiled.solve_one.signatures) == known


COMPILING = """
import numpy as np
from pinograsp.forces.kernels.layouts import Balance, Cones
from pinograsp.forces.kernels.powers import phi
from pinograsp.forces.kernels.rows import judge
for _ in range(2):
    assert phi(1.0, np.ones(1), np.ones(2))[0] == 0.5
    judge(Balance(np.ones((3, 3)), np.ones(3), 0.0), Cones(np.ones(1), np.ones(1), np.ones(2), 2), np.ones((3, 1)))
"""


def run_python(script, folder, **environment):
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=500,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr
    return done


def test_compiling_is_said_once(tmp_path):
    """Where functions are not in the cache yet; loading them from there says nothing."""
    for told in (1, 0):
        done = run_python(COMPILING, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        assert done.stderr.count("compiling solvers") == told and done.stdout == ""


def test_damaged_caches_are_made_again(tmp_path):
    """Files that were cut off, are empty, or are no such file."""
    module = tmp_path / "kernel.py"
    module.write_text("from pinograsp.forces.jit import jit\n\n\n@jit()\ndef twice(x):\n    return 2.0 * x\n")

    def from_cache():
        twice = runpy.run_path(str(module))["twice"]
        assert twice(1.5) == 3.0
        return sum(twice.stats.cache_hits.values())

    assert [from_cache(), from_cache()] == [0, 1]
    for damage in (
        lambda data: data[:-9],
        lambda data: data[: len(data) // 2],
        lambda data: b"",
        lambda data: b"nothing",
    ):
        for kind in ("nbi", "nbc"):
            (file,) = (tmp_path / "__pycache__").glob(f"*.{kind}")
            file.write_bytes(damage(file.read_bytes()))
            assert [from_cache(), from_cache()] == [0, 1]


@pytest.mark.slow
def test_caches_notice_what_other_files_of_the_folder_say(tmp_path):
    """A function's code contains that of the functions that it calls: numba alone would look at its own file."""
    (tmp_path / "inner.py").write_text(
        "from pinograsp.forces.jit import jit\n\n\n@jit()\ndef inner(x):\n    return 2.0 * x\n"
    )
    (tmp_path / "outer.py").write_text(
        "from inner import inner\nfrom pinograsp.forces.jit import jit\n\n\n@jit()\ndef outer(x):\n    return inner(x) + 1.0\n"
    )
    script = "from outer import outer; print(outer(1.5), sum(outer.stats.cache_hits.values()))"
    environment = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]), "PYTHONDONTWRITEBYTECODE": "1"}

    def told():
        return run_python(script, tmp_path, **environment).stdout.split()

    assert [told(), told()] == [["4.0", "0"], ["4.0", "1"]]
    text = (tmp_path / "inner.py").read_text()
    (tmp_path / "inner.py").write_text(text.replace("2.0", "4.0"))
    assert [told(), told()] == [["7.0", "0"], ["7.0", "1"]]
    (tmp_path / "inner.py").write_text(text)
    assert told() == ["4.0", "0"]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("k, joints, rows", [(1, 0, 3), (3, 16, 6), (15, 2, 6)])
def test_parts_of_a_loop_memory_fill_it(model, k, joints, rows):
    """Side by side, none within another, and scratch is as large as Newton's method needs."""
    from pinograsp.forces.kernels.layouts import TickSettings
    from pinograsp.forces.kernels.memory import tick_memory
    from pinograsp.forces.kernels.newton import newton_scratch

    d, n_round = MODELS[model].d, MODELS[model].round_dimensions
    memory, tick = tick_memory(TickSettings(k, d, joints, rows, n_round, 0.0, 1.0, 1.0, 9, 0.5, joints // 8))
    room = tick.room
    parts = [*tick.inputs, *tick.outputs, room.multipliers, *room.balance[:2], *room.quadratic, *room.cones[:3]]
    parts += [room.x, room.y, room.widths, room.slip, room.work]
    assert tick.settings == (k, d, joints, rows, n_round, 0.0, 1.0, 1.0, 9, 0.5, joints // 8)
    for number, part in enumerate(parts, 1):
        assert np.shares_memory(part, memory) or not part.size
        assert not part.any()
        part[:] = number
    assert all((part == number).all() for number, part in enumerate(parts, 1))
    assert len(room.work) == newton_scratch(d, k)


def test_nowhere_to_keep_compiled_code(tmp_path):
    """Neither the package's folder nor the user's can be written, not even by root: their places are taken by files."""
    package = tmp_path / "pinograsp"
    shutil.copytree(Path(pg.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "forces" / "kernels" / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    places = {name: str(tmp_path / "home") for name in ("HOME", "XDG_CACHE_HOME", "IPYTHONDIR")}
    done = run_python(
        COMPILING, tmp_path, PYTHONPATH=str(tmp_path), PYTHONDONTWRITEBYTECODE="1", NUMBA_CACHE_DIR="", **places
    )
    assert done.stderr.count("compiling solvers") == 1 == done.stderr.count("set NUMBA_CACHE_DIR")


IN_PROCESSES = """
import multiprocessing, os, threading
import numpy as np
import pinograsp as pg

rng, n = np.random.default_rng(0), 3000
angle = 2 * np.pi * np.arange(3) / 3 + rng.uniform(-0.3, 0.3, (n, 3))
out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=2)
frames = np.stack([np.stack([-out[..., 1], out[..., 0], out[..., 2]], axis=2), 0 * out + [0, 0, 1], -out], axis=3)
frames[..., 0] *= np.sign(np.linalg.det(frames))[..., None]
batch = pg.ForceBatch(points=0.03 * out, rotations=frames, loads=np.tile([0, 0, -1.0, 0, 0, 0], (n, 1)), mu=0.8, low=0.01, high=30.0,
                      friction=pg.Friction(model="cone"))

def held(_=None):
    return int(pg.solve_batch(batch, threads=2).ok.sum())

if __name__ == "__main__":
    here, found = held(), []
    threads = [threading.Thread(target=lambda: found.append(held())) for _ in range(4)]
    [one.start() for one in threads]
    [one.join() for one in threads]
    child = os.fork()
    if child == 0:
        os._exit(0 if held() == here else 1)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found += pool.map_async(held, range(4)).get(timeout=100)
    print(here > 1000, set(found) == {here}, len(found), os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_bulk_in_threads_forks_and_pools(tmp_path):
    """No threading layer of numba's: what follows several calls at once, or a fork, is what one call gives."""
    assert run_python(IN_PROCESSES, tmp_path).stdout.split() == ["True", "True", "8", "0"]


def test_nothing_is_left_to_compile_after_warming_up(contact_set):
    """Loops and bulk as they are used: any kind of array, any model, with and without limits of torques."""
    from numba.core import event

    from pinograsp.forces import MultiplierQP

    warm_up()
    with event.install_recorder("numba:compile") as compiled:
        for _name, model in MODELS.items():
            for contacts, load in grasps(contact_set, 3, 1, 2):
                problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=model)
                batch = pg.ForceBatch.of([problem, problem], 0.9)
                for one in (batch, pickle.loads(pickle.dumps(batch))):
                    for objective in ("work", {"impulse": 1, "least_squares": 1}):
                        pg.solve_batch(one, objective=objective)
                if model.edges == 4:
                    online = pg.OnlineForces(problem)
                    for wrench in (problem.load, np.array(load), list(load), np.tile(load, (2, 1)).T[:, 0]):
                        online.step(wrench, mu=0.5, poses=np.tile(np.eye(4), (3, 1, 1)))
                MultiplierQP(problem, np.ones(3)).solve(list(load))
    assert [done.data["dispatcher"].py_func.__name__ for _, done in compiled.buffer] == []


def test_derivatives_do_not_depend_on_the_solver_whose_answer_it_is():
    """Interior points stop a little short of a limit: it is active all the same."""
    compared, step = 0, 1e-4
    for seed in range(62, 110, 5):
        grasp = random_grasp(seed, family="cone", k=3 + seed % 4, torques=False, degenerate="", load="plain")
        problem = replace(
            grasp.problem, friction=Friction(model="soft", torsion=0.004), moment_length=grasp.problem.moment_length
        )
        solution = optimize_forces(problem, grasp.impact_time, objective="least_squares", backend="interior")
        if not solution.found:
            continue
        own, rng = force_sensitivity(solution), np.random.default_rng(seed)
        way = rng.normal(size=6) * np.repeat([1, problem.moment_length], 3) * np.linalg.norm(problem.load[:3])
        ends = [
            optimize_forces(
                problem.with_load(problem.load + h * way),
                grasp.impact_time,
                objective="least_squares",
                backend="clarabel",
            )
            for h in (step, -step)
        ]
        if not (own.unique and all(end.found for end in ends)):
            continue
        one, other = (end.certificate for end in ends)
        if any(np.any(getattr(one, name) != getattr(other, name)) for name in ("at_friction", "at_least", "at_most")):
            continue
        compared += 1
        slope = (ends[0].forces_c - ends[1].forces_c) / (2 * step)
        assert own.forces_load @ way == pytest.approx(slope, abs=2e-3 * np.abs(slope).max()), grasp
        assert own.cost_load @ way == pytest.approx(
            (one.objective - other.objective) / (2 * step), rel=2e-3, abs=2e-3 * one.objective
        )
    assert compared >= 4


def test_new_weights_loads_and_limits_leave_nothing_behind(contact_set):
    """What is kept with the contacts is bounded: a loop that tunes its weights runs for days."""
    contacts, load = next(grasps(contact_set, 20, 1, 3))
    rng = np.random.default_rng(0)

    def calls(count):
        for i in range(count):
            jacobian = np.concatenate([rng.uniform(-0.08, 0.08, (20, 3, 9)), rng.normal(size=(20, 3, 9))], axis=1)
            limits = TorqueLimits(jacobian=jacobian, bias=np.zeros(9), limit=np.full(9, 10.0)) if i % 2 else None
            problem = ForceProblem(contacts=contacts, load=load * rng.uniform(0.9, 1.1), mu=0.8, torques=limits)
            weights = {"work": 1.0, "least_squares": rng.uniform(1e-4, 1e-3)}
            assert optimize_forces(problem, rng.uniform(0.8, 0.9), objective=weights).found

    def size():
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        calls(40)  # until everything that is kept is full
        before = size()
        calls(40)
        assert size() - before < 4e5  # one set of matrices takes about 50 kB
    finally:
        tracemalloc.stop()
