"""Frozen records are frozen: no public call writes on one, and no answer depends on what was called before."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import pinograsp as pg
from pinograsp import actuation, forces
from pinograsp.contacts.quality import ferrari_canny, grasp_map_metrics, grasp_stiffness

T_I = 0.9


def state(value, depth: int = 0):
    """Everything that a frozen record holds, private attributes included; other objects by identity."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes(), value.flags.writeable
    if isinstance(value, dict):
        return {key: state(one, depth) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [state(one, depth) for one in value]
    if is_dataclass(value) and type(value).__dataclass_params__.frozen:
        assert depth < 20
        own = {field.name: state(getattr(value, field.name), depth + 1) for field in fields(value)}
        return type(value), own, sorted(getattr(value, "__dict__", ()))
    return value if isinstance(value, str | int | float | bool | None) else id(value)


@pytest.fixture(scope="module")
def world(hand, contacts, cylinder):
    pen = cylinder
    corners = 0.02 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    block = pg.Mesh(vertices=corners, faces=ConvexHull(corners).simplices, convex=True, mass=0.1)
    problem = pg.ForceProblem.holding(pen, contacts, mu=0.7, friction=pg.Friction(model="cone"), max_depth=5e-3)
    paper = pg.ForceProblem.holding(pen, contacts, mu=0.7, friction=pg.Friction(), max_depth=5e-3)
    solution = pg.optimize_forces(problem, T_I, objective="least_squares")
    assert solution.status is pg.Status.OK
    grid = pg.GridSpec(accelerations=np.linspace(0.05, 1, 7), multipliers=np.linspace(-1, 1, 3))
    loads = pg.LoadSet.around(problem.load, mass_range=(0.9, 1.1))
    return {
        "hand": hand,
        "pen": pen,
        "block": block,
        "contacts": contacts,
        "problem": problem,
        "paper": paper,
        "solution": solution,
        "grid": grid,
        "loads": loads,
        "yielding": actuation.CompliantHand(jacobian=np.tile(0.05 * np.eye(3), (3, 1)), gains=np.ones(3)),
        "batch": pg.ForceBatch.of([problem, problem.with_load(0.5 * problem.load)], T_I),
    }


CALLS = {
    "one shot": lambda w: [pg.optimize_forces(w["problem"], T_I, objective=name) for name in forces.OBJECTIVES[:4]],
    "by every solver": lambda w: [pg.optimize_forces(w["problem"], T_I, solver=name) for name in forces.SOLVERS],
    "solver": lambda w: [pg.ForceSolver(w["problem"], T_I).solve(s * w["problem"].load) for s in (0.5, 1.0, 50.0)],
    "global": lambda w: pg.optimize_grasp(w["problem"], gap=1e-3),
    "grid": lambda w: [pg.grid_search(w["paper"], w["grid"], search=name) for name in forces.SEARCHES],
    "multipliers": lambda w: forces.refine_multipliers(w["paper"], w["solution"].normal_forces),
    "many multipliers": lambda w: forces.MultiplierQP(w["paper"], w["solution"].normal_forces).solve(w["paper"].load),
    "diagnosis": lambda w: pg.diagnose(w["problem"].with_load(50 * w["problem"].load), T_I),
    "margins": lambda w: pg.grasp_margins(w["solution"]),
    "load factor": lambda w: pg.forces.load_factor(w["problem"], impact_time=T_I),
    "closure": lambda w: (pg.force_closure(w["contacts"], 0.7), forces.min_weight(w["contacts"], 0.7)),
    "quality": lambda w: (
        ferrari_canny(w["contacts"], 0.7),
        grasp_map_metrics(w["contacts"]),
        grasp_stiffness(w["contacts"], w["problem"].compliance, w["solution"].normal_forces),
    ),
    "robust": lambda w: pg.optimize_robust(w["problem"], w["loads"], 0.82, objective="work").under(),
    "sensitivity": lambda w: forces.force_sensitivity(w["solution"]),
    "better contacts": lambda w: forces.optimize_contacts(
        w["problem"], w["pen"], T_I, objective="least_squares", reach=1e-4, tolerance=0.1
    ),
    "batch": lambda w: pg.solve_batch(w["batch"], objective="work"),
    "probability": lambda w: forces.holding_probability(w["problem"], T_I, count=20),
    "online": lambda w: pg.OnlineForces(w["problem"]).step(w["problem"].load),
    "for other solvers": lambda w: [
        form.solution(np.ones(len(form.q)))
        for form in (forces.to_qp(w["paper"], T_I, objective="peak"), forces.to_socp(w["problem"], T_I))
    ],
    "derived values": lambda w: (
        w["solution"].profile,
        w["solution"].work,
        w["solution"].certificate.is_optimal(),
        w["problem"].support(np.ones(6)),
        w["contacts"].G,
    ),
    "surface": lambda w: [
        (one.project([[0.05, 0.01, 0.004]]), one.collision_geometry, one.bounding_radius)
        for one in (w["pen"], w["block"])
    ],
    "curvature": lambda w: w["block"].curvature([[0.02, 0.001, 0.002]]),
    "bands": lambda w: actuation.gains_within(w["solution"], w["yielding"], 0.2),
    "maps": lambda w: actuation.quasistatic_maps(w["contacts"].G, np.eye(9), w["yielding"]),
    "stability": lambda w: actuation.object_stiffness(
        w["contacts"].G, np.eye(9), w["yielding"], w["solution"].forces_c
    ).is_stable(),
    "motion": lambda w: pg.motion.plan_motion(w["hand"], w["solution"]),
}


@pytest.mark.parametrize("name", CALLS)
def test_public_calls_leave_every_record_as_it_was(world, name):
    before = {key: state(value) for key, value in world.items()}
    CALLS[name](world)
    after = {key: state(value) for key, value in world.items()}
    assert [key for key in before if before[key] != after[key]] == []


@pytest.mark.slow
def test_auto_does_not_depend_on_what_was_called_before():
    """The same methods and the same answer in a fresh process, and after every method was loaded and asked."""
    script = """
import json, numpy as np, pinograsp as pg
from pinograsp import forces
disc = pg.Cylinder(radius=0.03, height=0.1, mass=0.2)
points = [[0.03, 0, 0], [-0.015, 0.026, 0.01], [-0.015, -0.026, -0.01]]
made = lambda: pg.ForceProblem.holding(disc, pg.contacts_at(None, disc, points), mu=0.8)
def asked():
    found = pg.optimize_forces(made(), 0.9)
    return [*pg.ForceSolver(made(), 0.9).solvers, found.solver, found.forces_c.tolist()]
first = asked()
problem = made()
for name in forces.SOLVERS:
    pg.optimize_forces(problem, 0.9, solver=name)
found = pg.optimize_forces(problem, 0.9)
assert found.forces_c.tolist() == first[-1] and found.solver == first[-2], (found, first)
assert asked() == first
print(first[0])
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=900)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split()[-1] == "newton"
