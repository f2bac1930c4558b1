"""The compiled Newton method: the same answers as the general solvers, and what it hands over to them."""

from __future__ import annotations

import builtins
import sys

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.contacts import Friction
from pinograsp.errors import ExtraMissing, Status
from pinograsp.forces import ForceProblem, TorqueLimits, optimize_forces, optimize_grasp, warm_up

MODELS = {
    "pyramid": Friction(),
    "pyramid, torsion": Friction(torsion=0.004),
    "cone": Friction(model="cone", safety=1.1),
    "cone, torsion": Friction(model="cone", torsion=0.004),
    "soft": Friction(model="soft", torsion=0.004),
}


@pytest.fixture(scope="module", autouse=True)
def compiled():
    warm_up()
    yield
    # "auto" uses it only once it is loaded: leave the other tests as they are without it.
    sys.modules.pop("pinograsp.forces.dual_newton", None)


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


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("objective", ["work", "impulse", "least_squares", {"work": 1.0, "least_squares": 1e-3}])
@pytest.mark.parametrize("k", [3, 8])
def test_same_optimum_as_the_interior_point_method(contact_set, model, objective, k):
    agreed = 0
    for contacts, load in grasps(contact_set, k, 6, 10 * k):
        problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=MODELS[model])
        fast = optimize_forces(problem, 0.85, objective=objective, solver="newton")
        slow = optimize_forces(problem, 0.85, objective=objective, solver="clarabel")
        assert fast.status is slow.status
        if fast.status is Status.OK:
            agreed += fast.solver == "newton"
            assert fast.certificate.primal == pytest.approx(slow.certificate.primal, rel=2e-6)
            assert fast.certificate.relative_gap <= 1e-6
            assert fast.certificate.balance_force < 1e-9 and fast.certificate.limit_violation < 1e-8
    applies = not (model == "soft" and objective not in ("work", "impulse"))
    assert (agreed >= 3) is applies


def test_force_balance_and_many_contacts(contact_set):
    for contacts, load in grasps(contact_set, 60, 2, 0):
        for balance in ("force", "wrench"):
            problem = ForceProblem(contacts=contacts, load=load, mu=0.5, balance=balance, friction=Friction(model="cone"))
            found = optimize_forces(problem, 0.9, objective="least_squares", solver="newton")
            assert found.status is Status.OK and found.solver == "newton"


def test_auto_uses_it_only_where_it_applies(contact_set):
    contacts, load = next(grasps(contact_set, 5, 1, 1))
    settings = {"contacts": contacts, "load": load, "mu": 0.7}
    assert optimize_forces(ForceProblem(**settings), 0.85).solver == "newton"
    assert optimize_forces(ForceProblem(**settings, friction=Friction(edges=8)), 0.85).solver == "daqp"
    assert optimize_forces(ForceProblem(**settings), 0.85, objective="peak").solver == "daqp"
    J = np.random.default_rng(0).normal(size=(5, 6, 4)) * 0.05
    torques = TorqueLimits(jacobian=J, bias=np.zeros(4), limit=np.full(4, 50.0))
    assert optimize_forces(ForceProblem(**settings, torques=torques), 0.85).solver == "daqp"
    # Asked for by name where it cannot work: the general method answers, and the record says so.
    assert optimize_forces(ForceProblem(**settings), 0.85, objective="peak", solver="newton").solver == "daqp"


def test_infeasible_loads_are_proven(contact_set):
    for contacts, load in grasps(contact_set, 4, 4, 7):
        problem = ForceProblem(contacts=contacts, load=1e3 * load, mu=0.5, friction=Friction(model="cone"))
        found = optimize_forces(problem, 0.85, solver="newton")
        assert found.status is Status.INFEASIBLE and found.infeasibility.margin > 0


def test_global_search_through_it(make_problem):
    problem = make_problem(balance="wrench", measure="work", friction=Friction(model="cone"))
    fast, slow = optimize_grasp(problem, solver="newton"), optimize_grasp(problem, solver="daqp")
    assert fast.certificate.primal == pytest.approx(slow.certificate.primal, rel=2e-6)
    assert fast.certificate.relative_gap <= 1e-6


def test_missing_numba_names_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "pinograsp.forces.dual_newton", raising=False)
    monkeypatch.delattr("pinograsp.forces.dual_newton", raising=False)
    plain = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "numba" or name.startswith("numba."):
            raise ImportError("No module named 'numba'")
        return plain(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ExtraMissing, match=r"pinograsp\[fast\]"):
        pg.warm_up()


@pytest.mark.parametrize("model", MODELS)
def test_compiled_checks_equal_the_plain_ones(contact_set, model):
    """The certificate's compiled twin, at answers and at points that are far from any."""
    from pinograsp.forces.dual_newton import _derivative, applies, check, solve_structured
    from pinograsp.forces.program import assemble, weights_of

    rng = np.random.default_rng(0)
    compared = 0
    for contacts, load in grasps(contact_set, 4, 6, 3):
        problem = ForceProblem(contacts=contacts, load=load, mu=0.7, friction=MODELS[model])
        for objective in ("work", "impulse", "least_squares"):
            weights = weights_of(objective, problem)
            terms = {} if objective == "least_squares" else {objective: problem.energy_terms(0.85, objective)}
            program = assemble(problem, weights, terms, *problem.normal_force_range(0.85))
            if not applies(program) or solve_structured(program) is None:
                continue
            fixed, k, d = program.cache["structured"], program.k, program.d
            p = np.zeros((k, d)) if program.P is None else program.P.diagonal().reshape(k, d)
            for _ in range(3):
                x, y = rng.normal(size=(k, d)), rng.normal(size=6)
                x[:, -1] = np.exp(rng.normal(size=k))
                x[:, -1] = np.clip(x[:, -1], program.lo, program.hi)
                gauge, residual = np.empty(k), np.empty(6)
                violation, value, bound = check(
                    y, fixed.AT, program.b, program.q.reshape(k, d), p, program.lo, program.hi,
                    *_derivative(program.powers), fixed.radii, fixed.n_round, x, gauge, residual,
                )  # fmt: skip
                plain = program.violations(x.ravel())
                assert violation == pytest.approx(plain[0]) and gauge == pytest.approx(plain[1])
                assert residual == pytest.approx(plain[2])
                assert value == pytest.approx(program.value(x.ravel()))
                assert bound == pytest.approx(program.lower_bound(x.ravel(), y, np.zeros(0), refine=False), rel=1e-9)
                compared += 1
    assert compared >= 9
