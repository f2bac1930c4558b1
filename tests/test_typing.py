"""What a type checker finds in a user's script: misspelt arguments and options, and nothing where there is nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pinograsp as pg
from pinograsp.cases import Case, CaseChanges

RIGHT = """
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import pinograsp as pg
from pinograsp.carry import CarryPlan, plan_carry
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.forces import ConvexSolution, GlobalSolution, Objective, RobustForces
from pinograsp.motion import effort_of
from pinograsp.plan import Simulation
from pinograsp.planner import plan_best
from pinograsp.simulation import Disturbance, Push
from pinograsp.synthesis import FoundGrasp, GraspSearch

version: str = pg.__version__
case = pg.load_case("paper", {"object.mass": 1.1, "forces.search": "convex", "hand.limits_deg": {"a": (0, 90)}})
case = pg.load_case("paper", AS_PUBLISHED | {"forces.measure": "work"})
case = pg.load_case("paper", texts=["contacts.0.point_mm=[1, 2, 3]"])
hand: pg.HandModel = pg.load_hand("hand.xacro", xacro_args={"density": 580}, masses="file", pose=np.eye(4))
hand = pg.load_hand("panda", fingers={"left": "panda_leftfinger"}, exclude=["cover"], hulls=False)
box = pg.Box(size=[0.04, 0.04, 0.06], mass=0.2)
pushed = Disturbance(pushes=(Push(wrench_o=[1, 0, 0, 0, 0, 0]),), mass_factor=1.1)
mug = pg.Cylinder(radius=0.03, height=0.12, mass=0.25, pose=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
mesh: pg.Mesh = pg.Mesh.load("mug.stl", scale=1e-3, density=600)
conditions = pg.GraspConditions(
    mu=0.7, gravity_o=[0, 0, -1.62], friction=pg.Friction(model="cone", safety=1.2), torque_limit="effort", reserve=pg.Reserve(disturbance=0.3)
)
found: GraspSearch = pg.find_grasps(hand, mug, conditions, count=24, wishes=pg.Wishes(within=[[0, 0, 0], [1, 1, 1]]))
best: FoundGrasp = found.best
closure = pg.close_hand(hand, mug, wrap=True)
plan: pg.GraspPlan = pg.plan_grasp_on(closure.hand, closure, conditions, pg.PlanOptions(search="convex", objective={"work": 1.0}))
plan = plan_best(found, conditions, pg.PlanOptions(solver="newton"))
objective: Objective = {"work": 1.0, "least_squares": 1e-4}
solution: ConvexSolution = pg.optimize_forces(plan.problem, 0.9, objective=objective, solver="clarabel")
optimum: GlobalSolution = pg.optimize_grasp(plan.problem, objective="impulse")
common: RobustForces = pg.optimize_robust(plan.problem, pg.LoadSet.around(plan.problem.load), 0.9, reaction="elastic")
forces: NDArray[np.float64] = solution.normal_forces
peak: float = plan.motion.peak_torque
names: tuple[str, ...] = plan.contacts.names
simulation: Simulation = pg.simulate(plan, mode="servo", support="table", disturbance=Disturbance())
held: bool = simulation.verdict.held
carried: CarryPlan = plan_carry(hand, plan, {"joint": [0.0, 1.0]}, timing="fastest", squeeze=2.0)
duration: float = carried.duration
plan.to_csv("grasp.csv", rate=500.0, command="impedance", stiffness=5.0)
message: dict[str, object] = plan.to_ros2("grasp.yaml", goal=True)
plan.to_mujoco("grasp.xml", scene=True, hold=2.0)
problem = pg.ForceProblem.holding(mug, pg.contacts_at(None, mug, [[0.03, 0, 0]]), mu=[0.7], balance="force", measure="work")
grid = pg.grid_search(problem, search="paper+qp", method="brute", solver="daqp")
limits = pg.torque_limits(hand, problem.contacts, closure.q, limit="effort")
closed: bool = pg.force_closure(problem.contacts, 0.7).closed
"""

# By entry point, a line with a mistake, and what the checker has to name.
WRONG = [
    ('pg.load_case("paper", {"object.mas": 1.1})', '"object.mas"'),
    ('pg.load_case("paper", {"forces.search": "convx"})', '"convx"|Literal'),
    ('pg.load_case("paper", {"object.mass": "heavy"})', '"object.mass"'),
    ('pg.load_case("paper", change={})', '"change" for "load_case"'),
    ('pg.load_hand("panda", hull=False)', '"hull" for "load_hand"'),
    ('pg.load_hand("panda", masses="guess")', '"masses" to "load_hand"'),
    ('pg.Mesh.load("mug.stl", scal=1e-3)', '"scal" for "load"'),
    ("pg.Cylinder(radius=0.03, heigth=0.12, mass=0.25)", '"heigth" for "Cylinder"'),
    ("pg.GraspConditions(mu=0.7, maesure=1)", '"maesure" for "GraspConditions"'),
    ('pg.GraspConditions(mu=0.7, balance="forces")', '"balance" to "GraspConditions"'),
    ('pg.GraspConditions(mu=0.7, torque_limit="efort")', '"torque_limit" to "GraspConditions"'),
    ("pg.Reserve(disturbence=0.5)", '"disturbence" for "Reserve"'),
    ('pg.Friction(model="cones")', '"model" to "Friction"'),
    ("pg.Friction(safty=1.2)", '"safty" for "Friction"'),
    ("pg.find_grasps(hand, mug, conditions, counts=3)", '"counts" for "find_grasps"'),
    ('pg.find_grasps(hand, mug, conditions, count="many")', '"count" to "find_grasps"'),
    ("pg.close_hand(hand, mug, warp=True)", '"warp" for "close_hand"'),
    ('pg.PlanOptions(search="hybird")', '"search" to "PlanOptions"'),
    ('pg.PlanOptions(objective="peek")', '"objective" to "PlanOptions"'),
    ("pg.plan_grasp_on(hand, mug, conditions, object=1)", '"object" for "plan_grasp_on"'),
    ('pg.PlanOptions(serch="convex")', '"serch" for "PlanOptions"'),
    ('pg.optimize_forces(plan.problem, 0.9, objective="wrok")', '"objective" to "optimize_forces"'),
    ('pg.optimize_forces(plan.problem, 0.9, objective={"wrok": 1.0})', '"str": "float"|Dict entry 0|"wrok"'),
    ('pg.optimize_grasp(plan.problem, solvers="auto")', '"solvers" for "optimize_grasp"'),
    ('pg.optimize_robust(plan.problem, loads, 0.9, reaction="elastc")', '"reaction" to "optimize_robust"'),
    ('pg.solve_batch(batch, objective="last_squares")', '"objective" to "solve_batch"'),
    ('pg.grid_search(plan.problem, method="brutal")', '"method" to "grid_search"'),
    ('pg.ForceProblem.holding(mug, contacts, mu=0.7, balence="force")', '"balence" for "holding"'),
    ('pg.ForceProblem.holding(mug, contacts, mu=0.7, measure="works")', '"measure" to "holding"'),
    ("pg.ForceProblem(contacts=contacts, load=[0.0] * 6, mu=0.7, max_dept=1.0)", '"max_dept" for "ForceProblem"'),
    ('pg.simulate(plan, support="tabel")', '"support" to "simulate"'),
    ("pg.simulate(plan, holds=1.0)", '"holds" for "simulate"'),
    ('plan_carry(hand, plan, {}, timing="fast")', '"timing" to "plan_carry"'),
    ('plan_carry(hand, plan, {}, squeeze="most")', '"squeeze" to "plan_carry"'),
    ("plan_carry(hand, plan, {}, speeds=1.0)", '"speeds" for "plan_carry"'),
    ("monte_carlo(plan, counts=3)", '"counts" for "monte_carlo"'),
    ('plan.to_csv("a.csv", command="torqe")', '"command" to "to_csv"'),
    ('plan.to_csv("a.csv", rat=500)', '"rat" for "to_csv"'),
    ('plan.to_ros2("a.yaml", goals=True)', '"goals" for "to_ros2"'),
    ('plan.to_mujoco("a.xml", scenes=True)', '"scenes" for "to_mujoco"'),
    ('pg.torque_limits(hand, contacts, [0.0], limit="efort")', '"limit" to "torque_limits"'),
    ("pg.no_such_name", '"no_such_name"'),
    ("plan.normal_force", '"normal_force"'),
    ('count: int = pg.load_hand("panda")', '"HandModel"'),
    ("text: str = plan.forces.normal_forces", r"ndarray\[.*float"),
]
GIVEN = """
import pinograsp as pg
from pinograsp.carry import plan_carry
from pinograsp.planner import plan_best
from pinograsp.simulation import monte_carlo
from pinograsp.synthesis import GraspSearch


def script(
    hand: pg.HandModel,
    mug: pg.Cylinder,
    conditions: pg.GraspConditions,
    plan: pg.GraspPlan,
    found: GraspSearch,
    loads: pg.LoadSet,
    batch: pg.ForceBatch,
    contacts: pg.contacts.ContactSet,
) -> None:
"""


@pytest.mark.slow
def test_a_type_checker_finds_what_is_wrong_and_nothing_else(tmp_path):
    """One run for both scripts: most of it goes into reading the package."""
    (tmp_path / "right.py").write_text(RIGHT, encoding="utf-8")
    wrong = GIVEN + "".join(f"    {line}\n" for line, _ in WRONG)
    (tmp_path / "wrong.py").write_text(wrong, encoding="utf-8")
    root, environment = Path(pg.__file__).parent.parent, dict(os.environ)
    if root.name != "site-packages":  # a checkout: to be found, and as silent as what is installed
        environment["MYPYPATH"] = str(root)
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "right.py", "wrong.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, env=environment)
    said = [re.match(r"(\w+)\.py:(\d+): (error|note): (.*)", line) for line in done.stdout.splitlines()]
    told = [one for one in said if one]
    assert not [one[0] for one in told if one[1] == "right"], done.stdout + done.stderr
    first = len(GIVEN.splitlines()) + 1
    missed = {
        line: about
        for i, (line, named) in enumerate(WRONG)
        if not re.search(named, about := " ".join(one[4] for one in told if int(one[2]) == first + i))
    }
    assert not missed, done.stdout + done.stderr
    assert {int(one[2]) for one in told} == set(range(first, first + len(WRONG)))


def keys_of(section, before=""):
    """Keys of a case file, from the sections that read it."""
    for name, field in section.model_fields.items():
        if name in ("folder", "schema_"):
            continue
        yield before + name
        if hasattr(field.annotation, "model_fields"):
            yield from keys_of(field.annotation, f"{before}{name}.")


def test_every_key_of_a_case_is_known_to_type_checkers():
    assert CaseChanges.__annotations__.keys() == set(keys_of(Case))
