"""The optimal forces in PyTorch and JAX: their gradients by each library's own check, at kinks to one side."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from conftest import around_cylinder

import pinograsp as pg
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.forces import force_sensitivity, to_jax, to_torch

MODELS = {
    "cone": pg.Friction(model="cone", safety=1.1),
    "pyramid": pg.Friction(),
    "soft": pg.Friction(model="soft", torsion=4e-3),
}
IMPACT = 0.9
BOTH = {"least_squares": 1.0, "work": 0.1}
# The solver's forces are right to 1e-9 of the largest, a newton here: differences over 2e-5 N to 1e-4 of a newton.
STEP, TOLERANCE = 1e-5, 2e-3


def make_problem(friction, seed=1, **changes):
    rng = np.random.default_rng(seed)
    body = pg.Cylinder(radius=0.03, height=0.3, mass=0.2)
    contacts = pg.contacts_at(None, body, around_cylinder(rng, 4, 0.03, jitter=0.4))
    load, mu = [0.3, 0.2, -1.5, 2e-3, 1e-3, 3e-3], [0.8, 0.7, 0.6, 0.75]
    settings = dict(load=load, mu=mu, friction=friction, moment_length=0.03, max_depth=5e-3) | changes
    return pg.ForceProblem(contacts=contacts, **settings)


def inputs_of(problem, seed=2):
    """Of the function, away from the problem's own."""
    rng = np.random.default_rng(seed)
    return [
        problem.load * rng.uniform(0.9, 1.1, 6),
        problem.mu * rng.uniform(0.95, 1.05, problem.k),
        problem.contacts.points_o + rng.uniform(-1e-3, 1e-3, (problem.k, 3)),
        rng.uniform(-0.1, 0.1, (problem.k, 3)),
    ]


def two_jaws(weight):
    """Which press with 2 N each or more, and hold 2 mu times as much across."""
    box = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
    return pg.ForceProblem(
        contacts=pg.contacts_at(None, box, [[0.02, 0, 0], [-0.02, 0, 0]]),
        load=[0, 0, -weight, 0, 0, 0],
        mu=0.5,
        friction=pg.Friction(model="cone"),
        balance="force",
        min_normal_force=2.0,
        max_depth=5e-3,
    )


def needs(name):
    return pytest.importorskip(name, reason=f"the extra {name} is not installed")


@pytest.fixture
def jax():
    jax = needs("jax")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield jax
    jax.config.update("jax_enable_x64", before)


@pytest.mark.parametrize("objective", ["least_squares", BOTH], ids=["least squares", "and work"])
@pytest.mark.parametrize("name", MODELS)
def test_torch_agrees_with_differences(name, objective):
    torch = needs("torch")
    problem = make_problem(MODELS[name])
    solve = to_torch(problem, IMPACT, objective=objective)
    inputs = [torch.tensor(one, requires_grad=True) for one in inputs_of(problem)]
    assert torch.autograd.gradcheck(solve, inputs, eps=STEP, atol=TOLERANCE, rtol=TOLERANCE)


@pytest.mark.parametrize("name", MODELS)
def test_jax_agrees_with_differences_forwards_and_backwards(jax, name):
    from jax.test_util import check_grads

    problem = make_problem(MODELS[name])
    solve = to_jax(problem, IMPACT, objective=BOTH)
    check_grads(solve, inputs_of(problem), order=1, modes=("fwd", "rev"), eps=STEP, atol=TOLERANCE, rtol=TOLERANCE)


def test_torch_and_jax_find_what_the_solver_finds(jax):
    torch = needs("torch")
    problem = make_problem(MODELS["cone"])
    solution = pg.optimize_forces(problem, IMPACT, objective=BOTH)
    load = torch.tensor(problem.load, dtype=torch.float32, requires_grad=True)  # as networks have it
    forces, cost = to_torch(problem, IMPACT, objective=BOTH)(load=load)
    cost.backward()
    assert forces.detach().numpy() == pytest.approx(solution.forces_c, abs=1e-6)
    assert load.grad.numpy() == pytest.approx(force_sensitivity(solution).cost_load, rel=1e-5)
    solve = to_jax(problem, IMPACT, objective=BOTH)
    assert float(solve()[1]) == pytest.approx(solution.certificate.objective, rel=1e-9)
    slope = jax.jit(jax.grad(lambda load: solve(load=load)[1]))(problem.load)
    assert np.asarray(slope) == pytest.approx(force_sensitivity(solution).cost_load, rel=1e-9)
    loads = np.outer([0.8, 1.0], problem.load)
    costs = jax.vmap(lambda load: solve(load=load)[1])(loads)
    assert np.asarray(costs) == pytest.approx([float(solve(load=load)[1]) for load in loads], rel=1e-12)


@pytest.mark.parametrize(("weight", "slopes"), [(1.9, (0.0,)), (2.0, (0.0, 1.0)), (2.1, (1.0,))])
def test_at_a_kink_the_gradient_is_a_derivative_to_one_side(weight, slopes):
    """Each jaw's normal force is max(2, weight / (2 mu)) newtons, mu = 0.5."""
    torch = needs("torch")
    problem = two_jaws(weight)
    load = torch.tensor(problem.load, requires_grad=True)
    forces, _ = to_torch(problem, IMPACT)(load=load)
    forces[0, 2].backward()
    assert min(abs(-load.grad[2] - slope) for slope in slopes) < 1e-6


def test_what_has_no_gradient_is_refused():
    torch = needs("torch")
    problem = make_problem(MODELS["cone"])
    with pytest.raises(InvalidInput, match="least_squares"):
        to_torch(problem, IMPACT, objective="work")
    with pytest.raises(InvalidInput, match="hold the load"):
        to_torch(problem, IMPACT)(load=1e4 * problem.load)
    with pytest.raises(InvalidInput, match="4 edges"):
        to_torch(make_problem(pg.Friction(edges=8)), IMPACT)(mu=torch.tensor(0.8, requires_grad=True))


@pytest.mark.parametrize(("make", "name"), [(to_torch, "torch"), (to_jax, "jax")])
def test_without_the_library_the_message_names_the_extra(make, name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ExtraMissing, match=rf"pip install 'pinograsp\[{name}\]'"):
        make(make_problem(MODELS["cone"]), IMPACT)
