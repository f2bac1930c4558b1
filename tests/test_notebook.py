"""How records read: in one line, as a text, and in a notebook."""

from __future__ import annotations

import base64
import dataclasses
import importlib
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import trimesh
from grasp_files import dexgraspnet_rows, npy, some_grasps
from panda_path import JOINTS, START, WAYPOINTS
from PIL import Image
from test_architecture import ROOMS

import pinograsp as pg
from pinograsp.carry import CarryScenario, plan_carry
from pinograsp.cases.object_case import ObjectCase
from pinograsp.contacts import DecelerationShape, contacts_of
from pinograsp.data import read_grasps
from pinograsp.forces import force_sensitivity
from pinograsp.handover import jaw_commands, joint_trajectory
from pinograsp.hands.catalogue import file_of
from pinograsp.hands.humanoid import humanoid_hand
from pinograsp.notebook import render_record
from pinograsp.plan import PlanRecord
from pinograsp.planner import plan_best
from pinograsp.simulation import Disturbance, Errors, Servo, monte_carlo
from pinograsp.storage import read_run
from pinograsp.viz.style import contact_colours

LONGEST = 500  # characters of a repr
DRAWN = {"HandModel", "GraspPlan", "Closure", "FoundGrasp", "GraspSearch", "CarryPlan"}
AS_TABLES = {"ForceProblem", "GlobalSolution", "ConvexSolution", "GridSolution", "Certificate", "Simulation"}


@pytest.fixture(scope="module")
def records(paper_case, paper_plan, tmp_path_factory):
    """One of each public record, made as a user makes them."""
    conditions = pg.GraspConditions(mu=0.6)
    panda = pg.load_hand("panda")
    box = pg.Box(size=[0.04, 0.04, 0.06], mass=0.2)
    found = pg.find_grasps(panda, box, conditions, count=8, jobs=1, progress=False)
    plan = plan_best(found, conditions).with_margins().with_reach()
    problem = plan.problem
    optimum = pg.optimize_grasp(dataclasses.replace(problem, torques=None))
    impossible = pg.optimize_forces(dataclasses.replace(problem, mu=0.01), 0.9)
    loads = pg.LoadSet.around(problem.load, mass_range=(0.9, 1.1), box=[0.1, 0.1, 0.1, 0, 0, 0])
    arm = pg.load_hand(file_of("panda"), posture=dict(zip(JOINTS, START)))
    at = np.eye(4)
    at[2, 3] = 0.1034
    held = box.placed(arm.frame_placements(arm.resting, ["panda_hand"])[0] @ at)
    carried = plan_carry(arm, pg.plan_grasp_on(arm, held, conditions), WAYPOINTS, intervals=40)
    closure = found.best.closure
    (rows,) = read_grasps(npy(tmp_path_factory.mktemp("rows") / "a.npy", dexgraspnet_rows(some_grasps())))
    errors = Errors(position=1e-3, rotation=0, friction=0, mass=0, posture=0, push=0)
    batch = pg.ForceBatch.of([dataclasses.replace(problem, torques=None)], [0.9])
    simulation = pg.simulate(plan, hold=0.05)
    return [
        # Hands, objects, conditions.
        *(panda, panda.fingers[0], *panda.drives[:1], humanoid_hand(), box, pg.Sphere(radius=0.03, mass=0.2)),
        *(pg.Cylinder(radius=0.03, height=0.1, mass=0.2), pg.Capsule(radius=0.02, length=0.1, mass=0.2)),
        *(pg.Ellipsoid(semi_axes=[0.02, 0.03, 0.04], mass=0.2), ball_mesh(), pg.Friction(), pg.MarhefkaOrin()),
        *(conditions, pg.Reserve(), pg.GridSpec(), pg.MotionSpec(), DecelerationShape.constant()),
        *(paper_case, ObjectCase.of(hand="panda", object="sphere:radius=0.02,mass=0.1"), rows),
        # Grasps and contacts.
        *(found, found.best, closure, *closure.touches, closure.path, closure.contacts(), *closure.contacts()),
        contacts_of(closure.hand, closure.object, closure.q),
        # Forces.
        *(problem, problem.torques, loads, optimum, optimum.certificate, optimum.branches[0], optimum.profile),
        *(impossible, impossible.infeasibility, paper_plan.solution, paper_plan.solution.grid),
        *(force_sensitivity(optimum), pg.optimize_robust(problem, loads, 0.85), pg.diagnose(problem, 0.9)),
        *(pg.grasp_margins(optimum), pg.force_closure(problem.contacts, 0.6), batch, pg.solve_batch(batch)),
        pg.certify(panda, box, closure.q[None], conditions, roots=found.best.pose[None]),
        # Plans and their parts.
        *(plan, paper_plan, plan.motion, plan.forces, plan.margins, plan.reach, plan.layout, plan.contacts),
        *(plan.force_band(), plan.gains_within(), plan.object_stiffness(), plan.reserve, plan.friction, plan.law),
        *(joint_trajectory(plan), *jaw_commands(plan), carried, carried.path, carried.timing, CarryScenario()),
        # Simulations.
        *(Disturbance(), Servo.of(panda), errors, simulation, simulation.verdict),
        monte_carlo(plan, errors=errors, count=1, hold=0.05, jobs=1, progress=False),
    ]


def ball_mesh():
    shape = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    return pg.Mesh(vertices=shape.vertices, faces=shape.faces, mass=0.2)


@pytest.mark.slow
def test_every_record_is_short_in_a_list(records):
    for record in records:
        assert len(repr(record)) <= LONGEST and "\n" not in repr(record), type(record)


@pytest.mark.slow
def test_texts_of_records_are_readable(records):
    for record in records:
        lines = str(record).splitlines()
        assert len(lines) <= 40 and all(line.strip() for line in lines), type(record)


def public():
    """Dataclasses that rooms offer by name."""
    for room in ROOMS:
        module = importlib.import_module(f"pinograsp.{room}")
        for name in getattr(module, "__all__", ()):
            kind = getattr(module, name)
            if isinstance(kind, type) and dataclasses.is_dataclass(kind):
                yield kind


def test_no_public_record_prints_its_arrays():
    """The repr that dataclasses bring shows all of every field: for numbers and names alone."""
    plain = re.compile(r"(float|int|bool|str|None|Literal\[.*\]|FrictionModel|Control|Measure|Status|[| ])+")
    found = {
        kind.__name__
        for kind in public()
        if kind.__repr__.__qualname__ == f"{kind.__qualname__}.__repr__"
        and not all(plain.fullmatch(str(field.type)) for field in dataclasses.fields(kind))
    }
    assert not found


@pytest.mark.slow
def test_texts_say_the_answer_first(records, paper_plan):
    plan = next(one for one in records if isinstance(one, pg.GraspPlan))
    first, second, *rest = str(plan).splitlines()
    assert str(plan.status) in first
    for name, force in zip(plan.contacts.names, plan.forces.normal_forces):
        assert f"{name} {force:.3g}" in second
    assert any("N in any direction" in line for line in rest)
    assert all(any(caution in line for line in rest) for caution in plan.cautions)
    assert str(paper_plan.solution).splitlines()[1:2] == str(paper_plan).splitlines()[1:2]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["HandModel", "Closure", "Simulation", "CarryPlan"])
def test_a_record_has_one_text(records, kind):
    record = next(one for one in records if type(one).__name__ == kind)
    assert str(record) == record.describe()


class Page(HTMLParser):
    """What a browser would show: texts, pictures; and whether every element is closed."""

    def __init__(self, html):
        super().__init__()
        self.texts, self.pictures, self.open, self.kinds = [], [], [], set()
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.kinds.add(tag)
        if tag == "img":
            self.pictures.append(base64.b64decode(dict(attrs)["src"].partition("base64,")[2]))
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self):
        return " ".join(self.texts)


@pytest.mark.slow
def test_notebooks_show_pictures_and_figures(records, paper_plan):
    shown = {type(one).__name__: Page(one._repr_html_()) for one in records if hasattr(one, "_repr_html_")}
    shown["GridSolution"] = Page(paper_plan.solution._repr_html_())
    assert shown.keys() == DRAWN | AS_TABLES
    for name, page in shown.items():
        assert page.kinds <= {"div", "b", "span", "table", "thead", "tbody", "tr", "th", "td", "img"}
        assert len(page.pictures) == (name in DRAWN), name
        for content in page.pictures:
            assert len(content) < 60_000
            image = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=float)
            assert image.std(axis=(0, 1)).min() > 5, f"{name}: an empty picture"


def test_figures_of_a_plan_are_those_of_the_plan(paper_plan):
    page = Page(paper_plan._repr_html_())
    for name, force in zip(paper_plan.contacts.names, paper_plan.forces.normal_forces):
        assert any(name in text for text in page.texts) and f"{force:.3g}" in page.texts


def test_a_plan_without_its_hand_shows_its_figures(tmp_path, paper_plan):
    folder = pg.save_run(paper_plan, tmp_path / "run")
    record = read_run(folder, with_scene=False)
    assert isinstance(record, PlanRecord) and record.hand is None
    page = Page(record._repr_html_())
    assert not page.pictures and record.contacts.names[0] in page.text


def test_names_of_others_stay_text(paper_plan):
    hand = dataclasses.replace(paper_plan.hand, name="<script>alert(1)</script>", source="a&b\x1b[31m")
    html = hand._repr_html_()
    assert "<script" not in html and "&lt;script&gt;" in html and "\x1b" not in html


def test_showing_never_fails(paper_plan, monkeypatch):
    broken = dataclasses.replace(paper_plan, forces=None)
    assert broken._repr_html_() is None  # the text stands for it
    lost = dataclasses.replace(paper_plan, hand=dataclasses.replace(paper_plan.hand, geometry=None))
    assert Page(lost._repr_html_()).pictures == []


def test_the_version_is_that_of_the_package():
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", pg.__version__)


@pytest.mark.slow
def test_a_finger_has_the_colour_that_it_has_in_figures():
    plan = pg.load_case("paper").plan()
    told = render_record(plan)
    colours = contact_colours(plan.contacts.names, plan.layout.fingers)
    assert len(set(colours)) == 3
    places = [told.index(f"background:{colour}") for colour in colours]
    assert places == sorted(places)
