"""The compiled solvers: the same answers as the general ones, the same checks, and what they hand over."""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest
from marks import slow_except
from random_grasps import random_grasp
from whole_forces import MODELS

import pinograsp as pg
from pinograsp import core
from pinograsp.contacts import Friction
from pinograsp.errors import ExtraMissing, InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    ForceSolver,
    MultiplierQP,
    TorqueLimits,
    force_sensitivity,
    optimize_forces,
    optimize_grasp,
)


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
@pytest.mark.parametrize(
    "objective",
    ["work", "impulse", "least_squares", "peak", {"work": 1.0, "least_squares": 1e-3}, {"work": 1.0, "peak": 1e-3}],
    ids=str,
)
@pytest.mark.parametrize("k", slow_except([3, 8], 8))
@pytest.mark.parametrize("solver", ["newton", "newton, torque limits", "interior", "interior, torque limits"])
def test_same_optimum_as_the_general_method(contact_set, model, objective, k, solver):
    solver, _, limited = solver.partition(",")
    agreed = 0
    for contacts, load in grasps(contact_set, k, 6, 10 * k):
        torques = joint_limits(k) if limited else None
        problem = ForceProblem(
            contacts=contacts, load=load, mu=0.7, friction=MODELS[model], torques=torques, max_depth=5e-3
        )
        slow = optimize_forces(problem, 0.85, objective=objective, solver="clarabel")
        for fast in (
            optimize_forces(problem, 0.85, objective=objective, solver=solver),
            ForceSolver(problem.with_load(0.5 * load), 0.85, objective=objective, solver=solver).solve(load),
        ):
            assert fast.status is slow.status
            if fast.status is Status.OK:
                agreed += fast.solver == solver
                assert fast.certificate.objective == pytest.approx(slow.certificate.objective, rel=2e-6)
                assert fast.certificate.relative_gap <= 1e-6
                assert fast.certificate.residual_force < 1e-9 and fast.certificate.violation < 1e-8
                if objective != "peak":  # whose forces may not be the only ones
                    assert fast.certificate.at_torque == slow.certificate.at_torque
    if solver == "interior":
        assert agreed >= 6
    else:
        names = {objective} if isinstance(objective, str) else set(objective)
        separates = "peak" not in names and not (model == "soft" and "least_squares" in names)
        assert (agreed >= 6) is separates


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("balance", ["wrench", "force"])
def test_both_paths_write_the_same_record(contact_set, model, balance):
    """Whole compiled calls against the program's path with the same method, field by field."""
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.solution import solution_of
    from pinograsp.forces.solve.program import assemble, energy_terms_at
    from pinograsp.forces.solve.solver_order import SolverOrder

    for contacts, load in grasps(contact_set, 4, 3, 5):
        problem = ForceProblem(
            contacts=contacts,
            load=load,
            mu=[0.7, 0.6, 0.8, 0.7],
            friction=MODELS[model],
            balance=balance,
            max_normal_force=[5.0, 6.0, 7.0, 50.0],
            torques=joint_limits(4),
            max_depth=5e-3,
        )
        objective = {"work": 1.0, "least_squares": 1e-3}
        whole = optimize_forces(problem, 0.85, objective=objective, solver="interior")
        matrices = matrices_of(problem, objective)
        terms = energy_terms_at(problem, objective, 0.85)
        program = assemble(matrices, problem.scaled_load, terms, *problem.normal_force_range(0.85))
        outcome = SolverOrder(matrices, "interior").solve(problem, program)
        parts = solution_of(problem, outcome, impact_time=0.85, weights=objective, started=0.0)
        assert whole.solver == parts.solver == "interior" and whole.status is parts.status is Status.OK
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


def test_another_load(contact_set):
    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=Friction(), max_depth=5e-3)
    changed, made = (
        problem.with_load(2 * load),
        ForceProblem(contacts=contacts, load=2 * load, mu=0.7, friction=Friction(), max_depth=5e-3),
    )
    assert np.array_equal(changed.load, made.load) and np.array_equal(problem.load, load)
    assert optimize_forces(changed, 0.85).certificate.objective == pytest.approx(
        optimize_forces(made, 0.85).certificate.objective, rel=1e-8
    )
    with pytest.raises(InvalidInput, match="load"):
        problem.with_load([1.0, np.nan, 0, 0, 0, 0])


def test_bounds_that_leave_no_room_go_to_the_general_method(contact_set):
    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=Friction(model="cone"), max_depth=5e-3)
    lo, _hi = problem.normal_force_range(0.85)
    for cap, status in ((lo * 0.5, Status.INFEASIBLE), (lo, Status.INFEASIBLE)):
        found = optimize_forces(replace(problem, max_normal_force=cap), 0.85, solver="interior")
        assert found.status is status


def test_force_balance_and_many_contacts(contact_set):
    for contacts, load in grasps(contact_set, 60, 2, 0):
        for balance in ("force", "wrench"):
            problem = ForceProblem(
                contacts=contacts, load=load, mu=0.5, balance=balance, friction=Friction(model="cone"), max_depth=5e-3
            )
            found = optimize_forces(problem, 0.9, objective="least_squares", solver="newton")
            assert found.status is Status.OK and found.solver == "newton"


def test_auto_uses_them_only_where_they_apply(contact_set):
    contacts, load = next(grasps(contact_set, 5, 1, 1))
    settings = {"contacts": contacts, "load": load, "mu": 0.7}
    problem = ForceProblem(**settings)
    for _ in range(2):
        assert optimize_forces(problem, 0.85).solver == "newton"
        assert optimize_forces(problem, 0.85, objective="least_squares").solver == "newton"
        assert optimize_forces(problem, 0.85, objective="peak").solver == "interior"
        assert optimize_forces(ForceProblem(**settings, friction=Friction(edges=8)), 0.85).solver == "newton"
        limited = ForceProblem(**settings, torques=joint_limits(5))
        assert optimize_forces(limited, 0.85).solver == "newton"
        assert optimize_forces(limited, 0.85, objective="motor_heat").solver == "daqp"  # joints that all contacts load
        # Asked for by name where they cannot work: the general method answers, and the record says so.
        assert optimize_forces(problem, 0.85, objective="peak", solver="newton").solver == "daqp"
        for solver in ("newton", "interior"):
            assert optimize_forces(limited, 0.85, objective="motor_heat", solver=solver).solver == "daqp"


def test_infeasible_loads_are_proven(contact_set):
    for contacts, load in grasps(contact_set, 4, 4, 7):
        problem = ForceProblem(
            contacts=contacts, load=1e3 * load, mu=0.5, friction=Friction(model="cone"), max_depth=5e-3
        )
        for solver in ("newton", "interior"):
            found = optimize_forces(problem, 0.85, solver=solver)
            assert found.status is Status.INFEASIBLE and found.infeasibility.margin > 0


@pytest.mark.parametrize("model", ["cone", "pyramid", "soft"])
@pytest.mark.parametrize("count", [3, 8, 20])
def test_the_cores_proofs_are_those_of_the_general_method(contact_set, monkeypatch, model, count):
    """The same least residual and direction, the same limits; and the load is never looked at by the general method."""
    from pinograsp.forces.infeasibility import prove
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.solve.program import assemble, energy_terms_at, weights_of
    from pinograsp.forces.solve.solver_order import SolverOrder

    friction = Friction(model=model, torsion=0.005) if model == "soft" else Friction(model=model)
    for contacts, load in grasps(contact_set, count, 4, int(np.random.default_rng().integers(10**6))):
        problem = ForceProblem(contacts=contacts, load=1e5 * load, mu=0.5, friction=friction, max_depth=5e-3)
        weights = weights_of(None, problem)
        terms, limits = energy_terms_at(problem, weights, 0.85), problem.normal_force_range(0.85)
        program = assemble(matrices_of(problem, weights), problem.scaled_load, terms, *limits)
        known = prove(problem, program)
        with monkeypatch.context() as patch:
            patch.setattr(SolverOrder, "solve", lambda *_, **__: pytest.fail("the general method was asked"))
            found = optimize_forces(problem, 0.85, solver="newton").infeasibility
        assert found.margin == pytest.approx(known.margin, rel=1e-6)
        assert found.direction == pytest.approx(known.direction, abs=1e-3)
        assert found.residual == pytest.approx(known.residual, rel=1e-3, abs=1e-4 * known.margin)
        for name in ("at_torque", "crossed", "joint_weights"):
            assert np.array_equal(getattr(found, name), getattr(known, name)), name
        # Of a contact whose force hardly matters nobody knows which limit it is at: directions agree to 1e-3.
        clear = np.abs(program.reduce_costs(known.direction @ program.A)) > 5e-3
        for name in ("at_least", "at_most"):
            assert np.array_equal(getattr(found, name)[clear], getattr(known, name)[clear]), name
        assert clear.sum() > count // 2
        assert found.closest_c.shape == (count, 3) and not found.closest_c.flags.writeable


def answered(problem, name, objective="work"):
    """Code, x and y (all rows) of a method by itself, and the program."""
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.solve.compiled import arrays_of
    from pinograsp.forces.solve.program import assemble
    from pinograsp.forces.solve.template import Template

    terms = {objective: problem.energy_terms(0.85, objective)}
    program = assemble(
        matrices_of(problem, {objective: 1.0}), problem.scaled_load, terms, *problem.normal_force_range(0.85)
    )
    if name == "newton" and not program.matrices.separates:
        return None
    fixed = Template(program.matrices)
    code, newton, *_, x, y, _, _ = fixed.grasp(problem).answer(name == "newton", *arrays_of(program, fixed))
    return code, newton, x, y, program


def test_interior_points_recognise_infeasible_loads(contact_set):
    """Mostly without the general methods' help: the multipliers end as a certificate, and never as anything else."""
    proven = 0
    for contacts, load in grasps(contact_set, 4, 4, 7):
        for model in MODELS.values():
            problem = ForceProblem(contacts=contacts, load=1e3 * load, mu=0.5, friction=model, max_depth=5e-3)
            code, _, _, y, program = answered(problem, "interior")
            assert code != core.CONVERGED
            if program.farkas_bound(y, np.zeros(0)) > 0:
                proven += 1
    assert proven >= 18  # of 24


def test_dual_newton_recognises_infeasible_loads(contact_set):
    """By itself: its ray is a certificate, whoever checks it, and there is none where there are forces."""
    for factor in (1e3, 1.0):
        for contacts, load in grasps(contact_set, 4, 4, 7):
            for name, model in MODELS.items():
                problem = ForceProblem(contacts=contacts, load=factor * load, mu=0.5, friction=model, max_depth=5e-3)
                found = answered(problem, "newton")
                if found is None:
                    continue
                code, newton, _, y, program = found
                feasible = optimize_forces(problem, 0.85, objective="work", solver="daqp").status is Status.OK
                assert newton, name
                assert (code == core.CONVERGED) == feasible, name
                assert (program.farkas_bound(y, np.zeros(0)) > 0) == (not feasible)


def test_global_search_through_it(make_problem):
    problem = make_problem(balance="wrench", measure="work", friction=Friction(model="cone"))
    slow = optimize_grasp(problem, solver="daqp")
    for solver in ("newton", "interior"):
        fast = optimize_grasp(problem, solver=solver)
        assert fast.certificate.objective == pytest.approx(slow.certificate.objective, rel=2e-6)
        assert fast.certificate.relative_gap <= 1e-6


def test_without_the_core_general_methods_answer(contact_set, monkeypatch):
    """And what has no other method names what is missing."""

    core.load.cache_clear()
    monkeypatch.setitem(sys.modules, "pinograsp.core._core_base", None)
    monkeypatch.setattr(core, "is_installed", lambda: False)
    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=Friction(), max_depth=5e-3)
    try:
        assert optimize_forces(problem, 0.85).solver == "daqp"
        for needs in (
            lambda: optimize_forces(problem, 0.85, solver="newton"),
            lambda: pg.OnlineForces(problem),
            lambda: MultiplierQP(problem, np.ones(4)),
            lambda: pg.solve_batch(pg.ForceBatch.of([problem], 0.85)),
        ):
            with pytest.raises(ExtraMissing, match=r"C\+\+17 compiler"):
                needs()
    finally:
        core.load.cache_clear()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("limited", [False, True])
def test_compiled_checks_equal_the_plain_ones(contact_set, model, limited):
    """Bound and Farkas bound of the compiled certificate, at points and multipliers that are far from any optimum."""
    from pinograsp.forces.matrices import matrices_of
    from pinograsp.forces.solve.compiled import arrays_of, solve_program
    from pinograsp.forces.solve.program import assemble, weights_of
    from pinograsp.forces.solve.template import Template

    rng, compared = np.random.default_rng(0), 0
    for contacts, load in grasps(contact_set, 4, 3, 3):
        torques = joint_limits(4) if limited else None
        problem = ForceProblem(
            contacts=contacts, load=load, mu=0.7, friction=MODELS[model], torques=torques, max_depth=5e-3
        )
        for objective in ("work", "impulse", "least_squares"):
            weights = weights_of(objective, problem)
            terms = {} if objective == "least_squares" else {objective: problem.energy_terms(0.85, objective)}
            program = assemble(
                matrices_of(problem, weights), problem.scaled_load, terms, *problem.normal_force_range(0.85)
            )
            fixed, k, d, r = Template(program.matrices), program.k, program.d, len(program.R)
            given = arrays_of(program, fixed)
            answer = solve_program(problem, program, fixed, "interior")
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
                bound, excluded = fixed.grasp(problem).bounds(*given, np.ascontiguousarray(x.T), both)
                assert excluded == pytest.approx(program.farkas_bound(y, w), rel=1e-9)
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


def test_problems_go_to_other_processes(contact_set):
    """Without what solvers keep with them, which cannot be pickled, and read-only as before."""
    contacts, load = next(grasps(contact_set, 4, 1, 3))
    problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=Friction(model="cone"), max_depth=5e-3)
    found = [optimize_forces(problem, 0.85, solver=solver) for solver in ("clarabel", "interior", "interior")][-1]
    there = pickle.loads(pickle.dumps(found))
    assert not there.problem.load.flags.writeable
    for _ in range(2):
        again = optimize_forces(there.problem, 0.85, solver="interior")
        assert again.certificate.objective == pytest.approx(found.certificate.objective, rel=1e-8)


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


@pytest.mark.slow
def test_bulk_in_threads_forks_and_pools(tmp_path):
    """What follows several calls at once, or a fork, is what one call gives."""
    assert run_python(IN_PROCESSES, tmp_path).stdout.split() == ["True", "True", "8", "0"]


def test_derivatives_do_not_depend_on_the_solver_whose_answer_it_is():
    """Interior points stop a little short of a limit: it is active all the same."""
    compared, step = 0, 1e-4
    for seed in range(62, 110, 5):
        grasp = random_grasp(seed, family="cone", k=3 + seed % 4, torques=False, degenerate="", load="plain")
        problem = replace(
            grasp.problem, friction=Friction(model="soft", torsion=0.004), moment_length=grasp.problem.moment_length
        )
        solution = optimize_forces(problem, grasp.impact_time, objective="least_squares", solver="interior")
        if not solution.found:
            continue
        own, rng = force_sensitivity(solution), np.random.default_rng(seed)
        way = rng.normal(size=6) * np.repeat([1, problem.moment_length], 3) * np.linalg.norm(problem.load[:3])
        ends = [
            optimize_forces(
                problem.with_load(problem.load + h * way),
                grasp.impact_time,
                objective="least_squares",
                solver="clarabel",
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


@pytest.mark.slow
def test_new_weights_loads_and_limits_leave_nothing_behind(contact_set):
    """What is kept with the contacts is bounded: a loop that tunes its weights runs for days."""
    contacts, load = next(grasps(contact_set, 20, 1, 3))
    rng = np.random.default_rng(0)

    def calls(count):
        for i in range(count):
            jacobian = np.concatenate([rng.uniform(-0.08, 0.08, (20, 3, 9)), rng.normal(size=(20, 3, 9))], axis=1)
            limits = TorqueLimits(jacobian=jacobian, bias=np.zeros(9), limit=np.full(9, 10.0)) if i % 2 else None
            problem = ForceProblem(
                contacts=contacts,
                load=load * rng.uniform(0.9, 1.1),
                mu=0.8,
                torques=limits,
                friction=Friction(),
                max_depth=5e-3,
            )
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
