"""Contact laws: what follows of one, a table of measurements, and a law of one's own from the plan to the simulation."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import quad

import pinograsp as pg
from pinograsp.contacts import MEASURES, Compliance, DecelerationShape, MarhefkaOrin, MeasuredCompliance, law_of
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import optimize_forces

TAU = 0.12
DEPTHS = np.array([1e-4, 1e-3, 3e-3, 8e-3])
SHAPES = (
    DecelerationShape.constant(),
    DecelerationShape.linear(1, 0),
    DecelerationShape.from_samples([0.2, 1, 0.5, 0.1]),
)


@dataclass(frozen=True)
class Foam(Compliance):
    """A fingertip that stiffens exponentially, F = scale (exp(depth / length) - 1): four lines, all that a law is."""

    scale_force: float = 2.0
    length: float = 2.5e-3
    loss: float = 0.4

    def force(self, depth):
        return self.scale_force * np.expm1(np.maximum(depth, 0.0) / self.length)

    def depth(self, force):
        return self.length * np.log1p(np.asarray(force) / self.scale_force)

    def slope(self, depth):
        return self.scale_force / self.length * np.exp(np.maximum(depth, 0.0) / self.length)

    def energy(self, depth):
        depth = np.maximum(depth, 0.0)
        return self.scale_force * (self.length * np.expm1(depth / self.length) - depth)


@dataclass(frozen=True)
class Bare(Compliance):
    """The paper's law without what it knows better: what follows of any law has to give the same."""

    law: MarhefkaOrin

    def force(self, depth):
        return self.law.force(depth)

    def depth(self, force):
        return self.law.depth(force)

    def slope(self, depth):
        return self.law.slope(depth)

    def energy(self, depth):
        return self.law.energy(depth)

    @property
    def loss(self):
        return self.law.loss

    @property
    def measure_factor(self):
        return self.law.measure_factor


TABLE = MeasuredCompliance(depths=[0.5e-3, 1e-3, 2e-3, 4e-3, 7e-3], forces=[0.3, 1.0, 3.5, 11.0, 30.0], damping=0.3)
LAWS = {"paper": MarhefkaOrin(), "foam": Foam(), "table": TABLE, "harder": Foam().scale(3.0)}
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


@every_law
def test_a_law_agrees_with_itself(law):
    assert isinstance(law, Compliance)
    force, h = law.force(DEPTHS), 1e-8
    assert np.allclose(law.depth(force), DEPTHS, rtol=1e-9) and law.force(-1e-3) == law.depth(0.0) == 0
    assert np.allclose((law.force(DEPTHS + h) - law.force(DEPTHS - h)) / (2 * h), law.slope(DEPTHS), rtol=1e-4)
    for depth, energy in zip(DEPTHS, law.energy(DEPTHS)):
        assert energy == pytest.approx(quad(law.force, 0, depth, epsabs=0, limit=200)[0], rel=1e-7)
    assert np.allclose(law.normal_force(DEPTHS, 0.5), (1 + 0.5 * law.loss) * force, rtol=1e-12)
    assert np.allclose(law.scale(2.0).force(DEPTHS), 2 * force, rtol=1e-12)
    assert np.allclose(law.scale(2.0).normal_force(DEPTHS, 0.5) - 2 * force, law.normal_force(DEPTHS, 0.5) - force)


@every_law
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
def test_measures_are_integrals_over_time_and_depth(law, shape):
    u = np.linspace(0.0, 1.0, 200_001)
    depth = 4e-3 * shape.depth(u) / shape.depth_factor
    rate = 4e-3 * shape.rate(u) / shape.depth_factor / TAU
    pressed = law.normal_force(depth, rate)
    for measure, integral in (("impulse", TAU * np.trapezoid(pressed, u)), ("work", np.trapezoid(pressed, depth))):
        found = getattr(law, measure)(4e-3, TAU, shape)
        assert found == pytest.approx(law.measure_factor * integral, rel=1e-4)  # a table's slope bends at its points


@pytest.mark.parametrize("rho", [0.7, 1.0, 1.5, 2.2])
def test_what_follows_of_any_law_is_the_papers_closed_form(rho):
    law = MarhefkaOrin(stiffness=2e3, damping=300.0, exponent=rho)
    for shape in SHAPES:
        for measure in MEASURES:
            found = getattr(Bare(law), measure)(DEPTHS, TAU, shape)
            assert np.allclose(found, getattr(law, measure)(DEPTHS, TAU, shape), rtol=1e-8)


@every_law
@pytest.mark.parametrize("measure", MEASURES)
def test_powers_are_near_the_measure(law, measure):
    largest = float(law.force(8e-3))
    powers = law.powers(measure, TAU, largest=largest)
    forces = np.linspace(0.05, 1.0, 30) * largest
    found = sum(c * forces**e for c, e in powers)
    assert all(c > 0 and e >= 1 for c, e in powers)
    exact = getattr(law, measure)(law.depth(forces), TAU)
    assert np.allclose(found, exact, rtol=0, atol=0.1 * exact.max())  # what a fit may be off
    for far in (1e12, 2e301):
        with contextlib.suppress(InvalidInput):  # no power of the force is near some laws so far away
            assert np.isfinite(law.powers(measure, TAU, largest=far)).all()


def test_an_energy_that_is_no_sum_of_powers_is_refused():
    rigid = MeasuredCompliance(depths=[0.0, 5e-3, 5.01e-3], forces=[0.0, 1.0, 100.0])
    with pytest.raises(InvalidInput, match="'impulse' that is nearly convex"):
        rigid.powers("impulse", TAU, largest=100.0)


@every_law
def test_laws_are_kept_by_their_numbers(law):
    kept = law_of(law.numbers(10e-3))
    depths = np.linspace(1e-4, 20e-3, 50)
    assert np.allclose(kept.force(depths), law.force(depths), rtol=1e-3)
    assert np.allclose(kept.normal_force(depths, 0.3), law.normal_force(depths, 0.3), rtol=1e-3)
    assert np.array_equal(law_of(kept.numbers(10e-3)).force(depths), kept.force(depths))


@pytest.mark.parametrize(
    ("depths", "forces"),
    [
        ([1e-3, 1e-3], [1.0, 2.0]),
        ([1e-3, 2e-3], [1.0, 0.5]),
        ([1e-3], [1.0, 2.0]),
        ([0.0, 1e-3], [0.1, 1.0]),
        ([], []),
        ([0.0], [0.0]),
        ([1e-3, np.nan], [1.0, 2.0]),
    ],
)
def test_tables_that_are_no_law_are_refused(depths, forces):
    with pytest.raises(InvalidInput, match="expected"):
        MeasuredCompliance(depths=depths, forces=forces)


@pytest.mark.slow
@pytest.mark.parametrize("law", [Foam(), TABLE], ids=["foam", "table"])
def test_a_law_of_ones_own_plans_is_stored_and_is_simulated(law, paper_case, hand, make_problem, tmp_path):
    friction = pg.Friction(model="cone", safety=1.3)  # forces on the edge of friction would creep
    problem = make_problem(balance="wrench", compliance=law, friction=friction, measure="impulse")
    for objective in ("least_squares", "impulse", "work"):
        found = optimize_forces(problem, 0.9, objective=objective)
        assert found.status is Status.OK and found.certificate.is_optimal()
        assert np.allclose(law.force(found.profile.final_depth), found.normal_forces, rtol=1e-9)
        assert found.impulse == pytest.approx(law.impulse(law.depth(found.normal_forces), 0.1).sum())
    plan = pg.plan_grasp(hand, problem, pg.PlanOptions(search="convex"))
    assert plan.status in (Status.OK, Status.DOUBTFUL)
    assert np.allclose(law.force(plan.forces.final_depths), plan.forces.normal_history[-1], rtol=1e-9)
    pg.save_run(plan, tmp_path / "run")
    loaded = pg.load_run(tmp_path / "run")
    assert np.array_equal(loaded.law.table, plan.law.table) and loaded.law.damping == law.loss
    read = loaded.problem.compliance
    assert type(read) is type(law) and np.array_equal(read.force(DEPTHS), law.force(DEPTHS))
    if law is TABLE:
        return  # how a table is simulated, the other law shows, which is kept as one
    simulated = pg.simulate(loaded, hold=0.1)
    assert simulated.verdict.held
    pressed = simulated.normal_forces[simulated.complete]
    assert np.allclose(np.sort(pressed), np.sort(plan.forces.normal_history[-1]), rtol=0.1)


def test_a_stiffer_law_is_planned_with_less_depth(make_problem):
    soft, hard = (
        optimize_forces(make_problem(balance="wrench", compliance=law, friction=pg.Friction(model="cone")), 0.9)
        for law in (Foam(), replace(Foam(), length=1e-3))
    )
    assert hard.profile.final_depth.max() < soft.profile.final_depth.max()


@pytest.mark.parametrize("law", [MarhefkaOrin(), Foam()], ids=["paper", "foam"])
@pytest.mark.parametrize("shape", ["constant", None, DecelerationShape.constant])
def test_shapes_that_are_none_are_refused(law, shape):
    measured = (
        lambda: law.impulse(1e-3, TAU, shape),
        lambda: law.work(1e-3, TAU, shape),
        lambda: law.powers("work", TAU, shape, largest=10.0),
    )
    for measure in measured:
        with pytest.raises(InvalidInput, match="shape: expected a DecelerationShape"):
            measure()
