"""Plans and simulations on disk: they come back equal, strangers' files are safe, what is broken is told."""

from __future__ import annotations

import json
import pickle
import shutil
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Annotated, Protocol

import numpy as np
import pytest
from marks import slow_except
from shipped_hands import loaded

import pinograsp as pg
from pinograsp.errors import HandNotLoaded, InvalidInput, Status
from pinograsp.hands import HandModel
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.hands.record import hand_record
from pinograsp.objects import Sphere
from pinograsp.objects.body import Body
from pinograsp.objects.record import object_record
from pinograsp.plan import PlanFailure, Proof
from pinograsp.planner import load_run, save_run
from pinograsp.simulation import simulate
from pinograsp.spatial import Array
from pinograsp.storage import newest_check, read_check, read_run, write_simulation
from pinograsp.storage.schema import read_record, write_record


def differences(value, other, at="plan"):
    """Where two values differ, field by field; hands and objects by their own records."""
    record = hand_record if isinstance(value, HandModel) else object_record if isinstance(value, Body) else None
    if record is not None:
        value, other = record(value), record(other)
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        yield from () if value.keys() == other.keys() else (f"{at}: {value.keys()} {other.keys()}",)
        for key in value.keys() & other.keys():
            yield from differences(value[key], other[key], f"{at}.{key}")
    elif type(value) is not type(other):
        yield f"{at}: {type(value)} {type(other)}"
    elif isinstance(value, np.ndarray):
        if value.dtype != other.dtype or not np.array_equal(value, other):
            yield at
    elif is_dataclass(value):
        for one in fields(value):
            yield from differences(getattr(value, one.name), getattr(other, one.name), f"{at}.{one.name}")
    elif isinstance(value, tuple | list):
        yield from () if len(value) == len(other) else (f"{at}: {len(value)} {len(other)}",)
        for i, pair in enumerate(zip(value, other)):
            yield from differences(*pair, f"{at}.{i}")
    elif isinstance(value, str | int | float | None):
        if value != other:
            yield f"{at}: {value!r} {other!r}"
    else:  # scipy's polynomials
        yield from differences([value.c, value.x], [other.c, other.x], at)


def check_same(plan, tmp_path):
    back = load_run(save_run(plan, tmp_path / "run"))
    whole = plan.with_margins().with_reach()
    assert type(back) is type(plan) and list(differences(whole, back)) == []
    assert back.problem is back.solution.problem and back.problem.object is back.body
    return back


def planned(name):
    """A plan of a catalogue hand for a sphere."""
    conditions = pg.GraspConditions(mu=0.8, max_normal_force=30.0)
    ball = Sphere(radius=0.02, mass=0.05)
    return pg.plan_best(pg.find_grasps(loaded(name), ball, conditions, count=8, seed=1, jobs=1), conditions)


@pytest.mark.parametrize("name", slow_except(["panda", "allegro_right"], "panda"))
def test_plans_come_back_equal(name, tmp_path):
    plan = planned(name)
    back = check_same(plan, tmp_path)
    assert back.conditions.max_normal_force == 30.0 and list(back.problem.max_normal_force) == [30.0] * back.problem.k
    assert back.closure.hand is back.hand and back.closure.object is back.body
    again = pg.plan_grasp_on(back.hand, back.closure, back.conditions)  # all that a plan is made of came back
    np.testing.assert_allclose(again.forces.forces_c, plan.forces.forces_c, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_plans_of_every_hand_come_back_equal(name, tmp_path):
    check_same(planned(name), tmp_path)


@pytest.fixture(scope="module")
def plan(paper_plan):
    return paper_plan.with_margins().with_reach()


@pytest.mark.slow
def test_a_plan_of_a_grid_comes_back_equal(plan, tmp_path):
    """With a problem that was given: friction of the paper, no closure."""
    back = check_same(plan, tmp_path)
    assert back.solution.grid.rejections == plan.solution.grid.rejections and back.closure is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{"limits.deceleration": {"polynomial": [1.0, -0.5, 0.2]}}, {"friction.model": "soft", "friction.torsion_mm": 5.0}],
)
def test_other_shapes_and_friction_come_back_equal(changes, tmp_path):
    settings = {"motion.time_step": 0.02, "motion.samples": 3, "forces.search": "convex", "friction.safety": 1.1}
    check_same(pg.load_case("paper", settings | changes).plan(), tmp_path)


# -- the schema --------------------------------------------------------------------------------------------------------


class Law(Protocol):
    """What a field may be of several kinds of."""


@dataclass(frozen=True)
class Power(Law):
    exponent: float


@dataclass(frozen=True)
class Table(Law):
    depths: Annotated[Array, "d"]
    forces: Annotated[Array, "d"]


@dataclass(frozen=True, kw_only=True)
class Thing:
    law: Law
    limit: float | Array | None = None
    pair: tuple[int, float] = (1, 2.0)
    notes: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    derived: float = field(init=False, default=3.0)


@pytest.mark.parametrize(
    "thing",
    [
        Thing(law=Power(1.5), limit=float("inf"), numbers={"a": 1.0}),
        Thing(law=Table(np.arange(3.0), np.arange(3.0) ** 2), limit=np.ones(4), notes=("a", "b"), pair=(2, 0.5)),
    ],
)
def test_a_new_kind_of_law_needs_no_code_here(thing):
    written = write_record(thing)
    back = read_record(Thing, json.loads(json.dumps(written.plain)), written.arrays, None)
    assert list(differences(thing, back)) == [] and type(back.law) is type(thing.law)


@pytest.mark.parametrize(
    "plain, arrays, message",
    [
        ([], {}, "expected a mapping"),
        ({}, {}, "law: expected a value, got none"),
        ({"law": {"class": "Power", "exponent": "2"}}, {}, "law.exponent: expected a number"),
        ({"law": {"class": "Power", "exponent": True}}, {}, "law.exponent: expected a number"),
        ({"law": {"class": "Power", "exponent": 1e308}}, {}, "law.exponent: expected a number up to"),
        ({"law": {"class": "Thing"}}, {}, "law.class: expected one of"),
        ({"law": {"class": "Table"}}, {"law.depths": np.ones(2)}, "law.forces"),
        ({"law": {"class": "Table"}}, {"law.depths": np.ones(2), "law.forces": np.ones(3)}, r"expected sizes \(2\)"),
        ({"law": {"class": "Table"}}, {"law.depths": np.ones(2), "law.forces": np.array([1, np.inf])}, "finite"),
        ({"law": {"class": "Table"}}, {"law.depths": np.ones(2, "i8"), "law.forces": np.ones(2)}, "got int64"),
        ({"law": {"class": "Power", "exponent": 1}, "pair": [1]}, {}, "pair: expected a list of 2"),
        ({"law": {"class": "Power", "exponent": 1}, "pair": [1.5, 1]}, {}, "pair.0: expected a whole number"),
        ({"law": {"class": "Power", "exponent": 1}, "notes": "a"}, {}, "notes: expected a list"),
        ({"law": {"class": "Power", "exponent": 1}, "numbers": {"a": None}}, {}, "numbers.a: expected a number"),
        ({"law": {"class": "Power", "exponent": 1}, "limit": "x"}, {}, "limit"),
        ({"law": {"class": "Power", "exponent": 1}}, {"limit": np.array([np.nan])}, "limit"),
    ],
)
def test_values_are_checked_against_the_types_of_fields(plain, arrays, message):
    with pytest.raises(InvalidInput, match=message):
        read_record(Thing, plain, arrays, None)


# -- folders -----------------------------------------------------------------------------------------------------------


def test_a_run_folder_holds_hand_and_object(plan, tmp_path):
    folder = save_run(plan, tmp_path / "run")
    names = ["plan.json", "plan.npz", "record.json", "scene.json"]
    assert (folder / "files.txt").read_text().splitlines()[1:] == names
    assert "description" not in (folder / "record.json").read_text()
    back = load_run(folder)
    files = {name: (folder / name).read_bytes() for name in names if name.endswith(".json")}
    save_run(back, folder, force=True)
    assert {name: (folder / name).read_bytes() for name in files} == files
    figures = json.loads(files["plan.json"])
    assert figures["schema"] == "pinograsp.plan/3" and figures["work_J"] == plan.forces.work


class Potato(Sphere):
    """A shape that no file knows."""


def test_what_cannot_be_written_down_is_left_out(plan, tmp_path):
    own = replace(plan, hand=replace(plan.hand, description=""), body=Potato(radius=0.01, mass=1.02))
    folder = save_run(own, tmp_path / "own")
    back = read_run(folder)
    assert back.hand is None and back.body is None
    assert back.summary() == {**plan.summary(), "hand_in_object": None, "contacts_on_links": None}
    for read in (load_run, simulate):
        with pytest.raises(InvalidInput, match="did not keep it: load it from its description"):
            read(folder)
    (folder / "scene.json").unlink()
    assert read_run(folder).hand is None


def changed(folder, name, change):
    document = json.loads((folder / name).read_text())
    change(document)
    (folder / name).write_text(json.dumps(document))


def test_reports_need_no_meshes(plan, tmp_path):
    """A plan is read without its hand, whose mesh files may be elsewhere."""
    folder, mesh = (
        save_run(plan, tmp_path / "run"),
        {"kind": "mesh", "size": [1.0, 1.0, 1.0], "path": "/nowhere/tip.stl"},
    )
    changed(folder, "scene.json", lambda scene: scene["hands"][0]["geometry"][0].update(mesh))
    with pytest.raises(HandNotLoaded, match="tip.stl"):
        load_run(folder)
    assert read_run(folder, with_scene=False).hand is None


def test_failures_come_back_as_they_were(tmp_path):
    proof = Proof(margin=0.5, direction=np.arange(6.0), at_torque_limit=("a",), residual=np.ones(6))
    failed = PlanFailure(
        status=Status.INFEASIBLE, search="convex", message="none", proof=proof, hand="humanoid", contacts=("thumb",)
    )
    folder = save_run(failed, tmp_path / "run")
    assert not (folder / "scene.json").exists()
    assert list(differences(failed, read_run(folder))) == []
    with pytest.raises(InvalidInput, match="its search found none"):
        load_run(folder)


@pytest.mark.parametrize("version", [1, 2])
def test_runs_of_older_versions_are_refused_with_a_way_on(version, tmp_path):
    (tmp_path / "plan.json").write_text(json.dumps({"schema": f"pinograsp.plan/{version}", "settings": {}}))
    np.savez(tmp_path / "plan.npz", times=np.arange(3.0))
    with pytest.raises(InvalidInput, match=f"pinograsp.plan/{version}.*plan it again.*'settings'"):
        load_run(tmp_path)


def test_checks_of_older_versions_are_refused_with_a_way_on(whole, tmp_path):
    """Version 0.2 stored poses of the centre of mass."""
    folder = shutil.copytree(whole / "check", tmp_path / "check")
    (folder / "record.json").unlink()
    with pytest.raises(InvalidInput, match=r"version 0\.2 or earlier: simulate it again"):
        read_check(folder)


def test_a_strangers_folder_is_safe_to_read(plan, tmp_path):
    folder = save_run(plan, tmp_path / "run")
    np.savez(tmp_path / "pickled.npz", q=np.array([{"a": 1}], dtype=object))
    good = {name: (folder / name).read_bytes() for name in ("record.json", "plan.npz", "scene.json")}
    for name, content in (
        ("scene.json", b"{"),
        ("scene.json", b"[" * 100000),
        ("scene.json", b"[]"),
        ("scene.json", b"\xff\xfe\x00"),
        ("scene.json", b'{"schema": "pinograsp.scene/99"}'),
        ("scene.json", b'{"schema": "pinograsp.scene/2", "hands": [[1]], "objects": [3]}'),
        ("scene.json", pickle.dumps({"hands": 1})),
        ("record.json", b"[]"),
        ("record.json", b'{"schema": "pinograsp.plan/3"}'),
        ("record.json", b'{"schema": "pinograsp.plan/99"}'),
        ("record.json", b"[" * 100_000),
        ("record.json", b'{"schema": "pinograsp.plan/3", "a": ' + b"[" * 60 + b"]" * 60 + b"}"),
        ("record.json", b'{"a": 1, "a": 2}'),
        ("record.json", b"1" * 10_000),
        ("plan.npz", b""),
        ("plan.npz", good["plan.npz"][:200]),
        ("plan.npz", pickle.dumps([1])),
        ("plan.npz", (tmp_path / "pickled.npz").read_bytes()),
    ):
        (folder / name).write_bytes(content)
        with pytest.raises(InvalidInput, match="no readable run"):
            load_run(folder)
        (folder / name).write_bytes(good[name])
    assert load_run(folder).hand.n == 20


@pytest.fixture(scope="module")
def whole(plan, tmp_path_factory):
    """A run and a simulation of it, on disk."""
    folder = save_run(plan, tmp_path_factory.mktemp("whole") / "run")
    simulation = simulate(plan, hold=0.01, time_step=1e-3, letting_go=0.01, sample=0.02)
    (folder / "check").mkdir()
    write_simulation(simulation, folder / "check", {})
    assert list(differences(simulation, read_check(folder / "check"))) == []
    load_run(folder)
    return folder


def refused(folder, file: str) -> None:
    """Reading the folder tells what is wrong with the file, in one line of its own."""
    with pytest.raises(InvalidInput) as told:
        (read_check if "/" in file else load_run)((folder / file).parent)
    message = str(told.value)
    assert len(message) < 700 and "\n" not in message, message
    assert "Traceback" not in message and "object has no attribute" not in message and "argument" not in message


MISSING = object()


@pytest.mark.parametrize(
    "file, path, value",
    [
        ("record.json", "forces.status", MISSING),
        ("record.json", "motion.status", "fine"),
        ("record.json", "balance", 3),
        ("record.json", "forces.work", 1e308),
        ("record.json", "forces.residual_force", -1.0),
        ("record.json", "forces.impact_time", 0.2),
        ("record.json", "forces.grid", None),
        ("record.json", "cautions", "none"),
        ("record.json", "friction.edges", 5),
        ("record.json", "friction.model", "soft"),
        ("record.json", "friction.safety", 0.5),
        ("record.json", "law.exponent", -1.0),
        ("record.json", "margins", None),
        ("record.json", "margins.band.remarks", [""]),
        ("record.json", "motion.impact", 10**6),
        ("record.json", "contacts.names", ["a", "a", "b"]),
        ("record.json", "contacts.links", ["a", "b", "c"]),
        ("record.json", "layout.fingers.thumb", [99]),
        ("record.json", "layout.fingers.thumb", [-1]),
        ("record.json", "layout.joints", ["one"]),
        ("record.json", "settings", 7),
        ("record.json", "settings.name", ["a"]),
        ("record.json", "hand", 7),
        ("record.json", "solution.problem.object", "x"),
        ("record.json", "solution.class", "GraspPlan"),
        ("record.json", "solution.problem.final_time", -1.0),
        ("check/record.json", "verdict.held", "yes"),
        ("check/record.json", "verdict.drift", MISSING),
        ("check/record.json", "parts", ["a"]),
        ("check/record.json", "complete", 10**6),
        ("check/record.json", "release", "never"),
        ("check/record.json", "disturbance", None),
    ],
    ids=lambda value: "missing" if value is MISSING else f"{value!r:.30}",
)
def test_documents_are_checked_when_they_are_read(whole, tmp_path, file, path, value):
    folder = shutil.copytree(whole, tmp_path / "run")

    def put(document):
        *holders, last = ("record", *path.split("."))
        for key in holders:
            document = document[key]
        if value is MISSING:
            del document[last]
        else:
            document[last] = value

    changed(folder, file, put)
    refused(folder, file)


ARRAYS = {
    "plan.npz": {
        "motion.times": lambda a: a[::-1],
        "motion.q": lambda a: a[:, :3],
        "motion.dq": lambda a: a.astype("f4"),
        "motion.torques": lambda a: a[:5],
        "motion.forces_o": lambda a: a[..., 0],
        "motion.holding_torques": lambda a: np.array("x"),
        "contacts.rotations_oc": lambda a: 2 * a,
        "contacts.com_o": lambda a: np.full(3, np.inf),
        "contacts.points_o": lambda a: a.astype(complex),
        "friction.mu": lambda a: -a,
        "load": lambda a: np.full(6, np.nan),
        "gravity_o": lambda a: np.array([b"x"] * 3),
        "forces.normal_history": lambda a: 1e200 + a,
        "forces.forces_c": lambda a: 1.01 * a,
        "margins.weakest_direction": lambda a: np.zeros(4),
        "torque_limit": None,
        "reach.forces": None,
        "solution.problem.mu": lambda a: -a,
        "solution.problem.contacts.com_o": lambda a: a[:2],
    },
    "check/check.npz": {
        "times": lambda a: 0 * a,
        "q": lambda a: a[0],
        "object_poses": lambda a: 0 * a,
        "forces_o": lambda a: a[:, :1],
        "slips": None,
        "energies.damped": lambda a: a[:2],
        "planned_forces": lambda a: np.append(a, 1.0),
    },
}


@pytest.mark.parametrize("file, name", [(file, name) for file, changes in ARRAYS.items() for name in changes])
def test_arrays_are_checked_when_they_are_read(whole, tmp_path, file, name):
    folder = shutil.copytree(whole, tmp_path / "run")
    with np.load(folder / file) as stored:
        arrays = dict(stored)
    change = ARRAYS[file][name]
    array = arrays.pop(name) if change is None else change(arrays[name])
    np.savez(folder / file, **(arrays if change is None else arrays | {name: array}))
    refused(folder, file)


@pytest.mark.parametrize("kind, content", [("lzma", b""), ("bomb", bytes(10**6)), ("twice", b"")])
def test_archives_that_unpack_without_end_are_refused(whole, tmp_path, kind, content):
    """Before anything is unpacked: a file of a few bytes may say that it holds gigabytes."""
    folder = shutil.copytree(whole, tmp_path / kind)
    how = zipfile.ZIP_LZMA if kind == "lzma" else zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(folder / "plan.npz", "w", how) as archive:
        archive.writestr("motion.times.npy", content)
    data = (folder / "plan.npz").read_bytes()
    if kind == "bomb":
        at = data.rfind(b"PK\x01\x02") + 24
        (folder / "plan.npz").write_bytes(data[:at] + (2**31).to_bytes(4, "little") + data[at + 4 :])
    refused(folder, "plan.npz")


def test_the_scene_must_be_of_the_plan(whole, tmp_path):
    folder = shutil.copytree(whole, tmp_path / "run")
    changed(folder, "scene.json", lambda scene: scene.update(hands=[hand_record(loaded("allegro_right"))]))
    for read in (load_run, lambda folder: simulate(folder, hold=0.01)):
        with pytest.raises(InvalidInput, match="hand of the plan"):
            read(folder)


def test_a_link_that_leads_nowhere_is_no_check(whole, tmp_path):
    folder = shutil.copytree(whole, tmp_path / "run")
    (folder / "a").mkdir()
    (folder / "a" / "check.json").symlink_to("nowhere")
    assert newest_check(folder) == folder / "check"
