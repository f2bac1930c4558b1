"""Sweeps: rows like single plans, kept whatever happens, on processes and on a cluster."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from killing import start_and_kill

import pinograsp as pg
from pinograsp.cases import case as case_module, load_case
from pinograsp.errors import CaseRejected, InvalidInput, ResultsNotWritten, Status, status_of
from pinograsp.forces import optimize_forces
from pinograsp.sweep import load_sweep, read_sweep, rows as rows_module, run, runner, sweep
from pinograsp.sweep.rows import kind_of
from pinograsp.sweep.store import Store

# A plan of some 20 ms: one posture, coarse time steps.
LIGHT = {"forces.search": "hybrid", "motion.samples": 1, "motion.time_step": 0.01}
BASE = {"case": "paper", "set": LIGHT}
GRID = {**BASE, "over": {"friction.mu": {"from": 0.7, "to": 0.9, "steps": 3}, "object.mass": [0.5, 1.0]}}
TIMES = ("elapsed_s",)  # what differs between runs


def columns(table) -> dict[str, list]:
    return {name: table[name].to_pylist() for name in table.column_names if name not in TIMES}


def same(a, b) -> bool:
    """Whether two tables agree, numbers to rounding."""
    a, b = columns(a), columns(b)
    return a.keys() == b.keys() and all(_same(x, y) for name in a for x, y in zip(a[name], b[name], strict=True))


def _same(x, y) -> bool:
    if isinstance(x, list) and isinstance(y, list):
        return len(x) == len(y) and all(map(_same, x, y))
    if isinstance(x, float) and isinstance(y, float):
        return x == pytest.approx(y, rel=1e-7, abs=1e-9)
    return x == y


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """A sweep of two processes, which later tests find warm."""
    return sweep(GRID, tmp_path_factory.mktemp("grid") / "out", jobs=2, progress=False)


def test_a_grid_is_all_combinations_the_last_key_fastest():
    spec = load_sweep(GRID)
    assert spec.rows == 6
    assert [spec.row(i) for i in range(6)] == [
        {"friction.mu": pytest.approx(mu), "object.mass": mass} for mu in (0.7, 0.8, 0.9) for mass in (0.5, 1.0)
    ]
    logarithmic = load_sweep({**BASE, "over": {"object.mass": {"from": 0.01, "to": 1, "steps": 3, "spacing": "log"}}})
    assert logarithmic.grid["object.mass"] == pytest.approx([0.01, 0.1, 1.0])


def test_draws_are_seeded_and_of_their_distributions():
    draws = {
        "friction.mu": {"uniform": [0.4, 1.0]},
        "object.mass": {"normal": [1.0, 0.1]},
        "friction.edges": {"choice": [4, 6, 8]},
        "compliance.stiffness": {"log_uniform": [1e3, 1e5]},
    }
    many = load_sweep({**BASE, "samples": {"count": 20_000, "seed": 3, **draws}}).random_inputs
    again = load_sweep({**BASE, "samples": {"count": 50, "seed": 3, "object.mass": draws["object.mass"]}}).random_inputs
    other = load_sweep({**BASE, "samples": {"count": 50, "seed": 4, "object.mass": draws["object.mass"]}}).random_inputs
    # More draws, or other inputs, change none of them; another seed does.
    assert again["object.mass"] == many["object.mass"][:50] != other["object.mass"]
    # Mean and standard deviation within five standard errors.
    mu, mass, logs = (np.array(many[key]) for key in ("friction.mu", "object.mass", "compliance.stiffness"))
    logs = np.log10(logs)
    for values, mean, std in ((mu, 0.7, 0.6 / 12**0.5), (mass, 1.0, 0.1), (logs, 4.0, 2 / 12**0.5)):
        assert abs(values.mean() - mean) < 5 * std / 20_000**0.5
        assert values.std() == pytest.approx(std, rel=0.03)
    assert mu.min() >= 0.4 and mu.max() <= 1.0 and logs.min() >= 3 and logs.max() <= 5
    assert all(
        abs(count - 20_000 / 3) < 5 * (20_000 * 2 / 9) ** 0.5 for count in Counter(many["friction.edges"]).values()
    )
    assert abs(np.corrcoef(mu, mass)[0, 1]) < 5 / 20_000**0.5


def test_all_draws_at_every_point_of_a_grid():
    spec = load_sweep(
        {**BASE, "over": {"friction.mu": [0.6, 0.8]}, "samples": {"count": 3, "object.mass": {"uniform": [0.5, 1.0]}}}
    )
    rows = [spec.row(i) for i in range(spec.rows)]
    assert [row["friction.mu"] for row in rows] == [0.6] * 3 + [0.8] * 3
    assert (
        [row["object.mass"] for row in rows[:3]]
        == [row["object.mass"] for row in rows[3:]]
        == spec.random_inputs["object.mass"]
    )


@pytest.mark.slow
def test_rows_are_single_plans(grid):
    table = grid.table()
    assert (grid.rows, grid.done, grid.counts, grid.interrupted) == (6, 6, {"ok": 6}, False)
    assert table["index"].to_pylist() == list(range(6))
    spec = load_sweep(GRID)
    for row in table.to_pylist():
        inputs = spec.row(row["index"])
        assert {key: row[key] for key in inputs} == inputs
        told = load_case("paper", {**LIGHT, **inputs}).plan(progress=False).summary()
        assert row["status"] == told["status"] and row["message"] is None
        for name in ("impact_time_s", "work_J", "impulse_Ns", "peak_torque_Nm", "max_penetration_m"):
            assert row[name] == pytest.approx(told[name], rel=1e-7), name
        assert dict(zip(row["contacts"], row["normal_forces_N"])) == pytest.approx(told["normal_forces_N"])
        assert row["normal_force_sum_N"] == pytest.approx(sum(told["normal_forces_N"].values()))
        assert row["normal_force_max_N"] == pytest.approx(max(told["normal_forces_N"].values()))
        margins = told["margins"]
        assert row["load_factor"] == pytest.approx(margins["load_factor"])
        assert row["least_mu_max"] == pytest.approx(max(margins["least_mu"].values()))
        assert row["slip_distance_min_N"] == pytest.approx(min(margins["slip_distance_N"].values()), abs=1e-9)
        assert row["force_closure"] is margins["force_closure"]
        assert row["elapsed_s"] > 0


@pytest.mark.slow
def test_one_process_finds_the_same(grid, tmp_path):
    assert same(sweep(GRID, tmp_path / "a", jobs=1, progress=False).table(), grid.table())


def test_the_files_are_a_dataset_for_anyone(grid):
    dataset = pytest.importorskip("pyarrow.dataset")
    import pyarrow.compute as pc

    found = dataset.dataset(grid.folder).to_table(
        columns=["friction.mu", "work_J"], filter=pc.field("friction.mu") > 0.75
    )
    assert found.num_rows == 4
    manifest = json.loads((grid.folder / "_manifest.json").read_text())
    assert manifest["rows"] == 6 and manifest["settings"]["of"]["friction"]["mu"] == 0.7
    assert len(list(grid.folder.glob("*.parquet"))) == 1


def test_failures_are_rows_with_status_and_message(tmp_path):
    here = load_case("paper").hand.position_mm
    cases = {
        "ok": {},
        "infeasible": {"object.mass": 30.0},
        "not_reached": {"hand.position_mm": [300.0, 37.0, 50.0]},
        "invalid_input": {"object.mass": -1.0},
    }
    over = {
        "hand.position_mm": [list(here), [300.0, 37.0, 50.0]],
        "hand.limits_deg": [{"thumb_abduction": [-15, 130]}, {"thumb_abduction": [-15, 130], "index_dip": [0, 30.5]}],
        "object.mass": [1.0, 30.0, -1.0],
    }
    done = sweep(
        {**BASE, "set": {**LIGHT, "motion.spread_deg": 0}, "over": over}, tmp_path / "out", jobs=2, progress=False
    )
    rows = done.table().to_pylist()
    assert done.done == 12 and sum(done.counts.values()) == 12
    plain = {
        "hand.position_mm": list(here),
        "hand.limits_deg": json.dumps({"thumb_abduction": [-15, 130]}),
        "object.mass": 1.0,
    }
    words = {
        "ok": None,
        "infeasible": "closest to balance",
        "not_reached": "mm remain",
        "invalid_input": "mass",
    }
    for status, changed in cases.items():
        wanted = {
            **plain,
            **{key: json.dumps(value) if isinstance(value, dict) else value for key, value in changed.items()},
        }
        (row,) = (row for row in rows if all(row[key] == value for key, value in wanted.items()))
        assert row["status"] == status
        assert row["message"] is None if words[status] is None else words[status] in row["message"]
        assert (row["work_J"] is None) == (status != "ok")


@pytest.mark.slow
def test_an_unforeseen_failure_is_a_row_too(tmp_path, monkeypatch):
    from pinograsp.cases import case

    plain, calls = case.plan_grasp, []

    def breaks(*args, **kwargs):
        calls.append(1)
        if len(calls) == 2:
            raise ZeroDivisionError("by nothing")
        return plain(*args, **kwargs)

    monkeypatch.setattr(case, "plan_grasp", breaks)
    done = sweep(GRID, tmp_path / "out", jobs=1, progress=False)
    assert done.counts == {"ok": 5, "failed": 1}
    assert "ZeroDivisionError: by nothing" in done.table()["message"].to_pylist()
    assert status_of(ValueError()) is Status.FAILED and status_of(InvalidInput("x")) is Status.INVALID_INPUT


@pytest.mark.slow
@pytest.mark.parametrize("what", ["plan", "forces"])
def test_rows_that_take_long_are_given_back(tmp_path, monkeypatch, what):
    """Chunks of all rows, and time for one of them at once."""
    monkeypatch.setattr(run, "_CHUNK", 1e9)
    monkeypatch.setattr(rows_module, "_LONGEST", 0.0)
    sent, plain = [], run.run_chunk

    def noted(payload, rows):
        sent.append(len(rows))
        return plain(payload, rows)

    monkeypatch.setattr(run, "run_chunk", noted)
    spec = GRID if what == "plan" else {**GRID, "what": "forces", "set": {"impact_time": 0.9}}
    done = sweep(spec, tmp_path / "out", jobs=1, progress=False)
    assert done.counts == {"ok": 6} and done.table()["index"].to_pylist() == list(range(6))
    assert sum(sent) > len(sent) == 6


def test_kinds_of_columns():
    assert [
        kind_of(v)
        for v in ([1, 2], [1, 2.5], [True, False], ["a"], [[1, 2], [0.5]], [True, 1], [None, 1], [{}], [2**63, 1.0])
    ] == ["whole", "number", "flag", "text", "numbers", "json", "json", "json", "json"]


@pytest.mark.slow
def test_forces_alone_in_bulk(tmp_path):
    spec = {
        "case": "paper",
        "what": "forces",
        "set": {"forces.balance": "wrench", "forces.measure": "work", "friction.torsion_mm": 5},
        "over": {
            "friction.model": ["cone", "pyramid", "soft"],
            "forces.objective": ["work", "least_squares"],
            "impact_time": [0.85, 0.93],
        },
        "samples": {"count": 3, "object.mass": {"uniform": [0.3, 1.0]}, "friction.mu": {"uniform": [0.5, 1.0]}},
    }
    done = sweep(spec, tmp_path / "out", jobs=1, progress=False)
    assert done.rows == done.done == 36 and set(done.counts) <= {"ok", "infeasible"} and done.counts["ok"] > 20
    hand = load_case("paper").load_hand()
    for row in done.table().to_pylist():
        inputs = {key: row[key] for key in ("friction.model", "forces.objective", "object.mass", "friction.mu")}
        problem = load_case("paper", {**spec["set"], **inputs}).make_problem(hand)
        alone = optimize_forces(problem, row["impact_time"], objective=row["forces.objective"])
        assert row["status"] == str(alone.status) and row["impact_time_s"] == row["impact_time"]
        if row["status"] == "ok":
            # Both are within 1e-6 of the least cost; the forces of a smooth cost are sharp, those of work nearly so.
            assert row["objective"] == pytest.approx(alone.certificate.objective, rel=3e-6)
            assert row["lower_bound"] <= row["objective"] * (1 + 1e-9)
            assert row["work_J"] == pytest.approx(alone.work, rel=1e-4)
            assert row["normal_forces_N"] == pytest.approx(alone.normal_forces.tolist(), rel=1e-2)
        else:
            assert row["work_J"] is None and row["message"]


def test_where_the_hand_touches_is_found_once_for_rows_that_have_it_in_common(tmp_path, monkeypatch):
    found = []
    touching = case_module.touching
    monkeypatch.setattr(case_module, "touching", lambda *given: found.append(given) or touching(*given))
    spec = {
        "case": "paper",
        "what": "forces",
        "set": {"impact_time": 0.9, "object.rpy_deg": [0.0, 0.0, 1.25]},
        "over": {
            "object.radius_mm": [9.95, 10.05],
            "gravity": [[0.0, 0.0, -9.81], [0.0, -1.0, -9.7]],
            "object.mass": [0.5, 0.6],
            "friction.mu": [0.7, 0.8],
        },
    }
    rows = sweep(spec, tmp_path / "out", jobs=1, progress=False).table().to_pylist()
    assert len(rows) == 16 and len(found) == 4
    for row in rows[::3]:
        inputs = {key: row[key] for key in spec["over"]}
        case = load_case("paper", {"object.rpy_deg": [0.0, 0.0, 1.25], **inputs})
        alone = optimize_forces(case.make_problem(case.load_hand()), 0.9)
        assert row["status"] == str(alone.status) == "ok"
        assert row["normal_forces_N"] == pytest.approx(alone.normal_forces.tolist(), rel=1e-2)


def test_forces_that_cannot_be_asked_for_are_rows(tmp_path):
    spec = {
        "case": "paper",
        "what": "forces",
        "set": {"impact_time": 0.9},
        "over": {
            "limits.torque_limit": [None, 1.0],
            "limits.max_normal_force": [20.0, 1e-3],
            "forces.objective": ["work", "motor_heat"],
        },
    }
    rows = sweep(spec, tmp_path / "out", jobs=1, progress=False).table().to_pylist()
    assert [row["status"] for row in rows] == ["ok", "invalid_input", "infeasible", "infeasible"] + [
        "invalid_input"
    ] * 4
    for row, words in zip(rows, (None, "TorqueLimits", "no normal force", "no normal force", *["set it to null"] * 4)):
        assert row["message"] is None if words is None else words in row["message"]


@pytest.mark.slow
def test_a_hand_and_an_object(tmp_path):
    spec = {
        "hand": "allegro_right",
        "object": "cylinder:radius=0.02,height=0.12,mass=0.2",
        "set": {"at": [0.08, 0, 0.07], "friction": "cone", "safety": 1.1, "reserve": "none"},
        "over": {"object.mass": [0.1, 0.2, -1], "mu": [0.7]},
    }
    rows = sweep(spec, tmp_path / "out", jobs=1, progress=False).table().to_pylist()
    thing = pg.Cylinder(radius=0.02, height=0.12, mass=0.2).placed(pg.spatial.pose_of([0.08, 0, 0.07]))
    closure = pg.close_hand(pg.load_hand("allegro_right"), thing)
    conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.1), reserve=None)
    told = pg.plan_grasp_on(closure.hand, closure, conditions).summary()
    assert [row["status"] for row in rows][1:] == [told["status"], "invalid_input"]
    for name in ("work_J", "peak_torque_Nm", "impact_time_s"):
        assert rows[1][name] == pytest.approx(told[name], rel=1e-5)
    assert rows[1]["contacts"] == list(told["normal_forces_N"])


@pytest.mark.slow
def test_placements_are_searched_for_a_hand_without_a_place(tmp_path):
    spec = {
        "hand": "allegro_right",
        "object": {"shape": "sphere", "radius": 0.03, "mass": 0.1},
        "over": {"object.radius": [0.6, 0.03]},
    }
    rows = (
        sweep(
            {**spec, "what": "forces", "set": {"impact_time": 0.9, "samples": 8}},
            tmp_path / "out",
            jobs=1,
            progress=False,
        )
        .table()
        .to_pylist()
    )
    assert [row["status"] for row in rows] == ["not_found", "ok"] and "no grasp of 8" in rows[0]["message"]


@pytest.mark.slow
def test_a_reserve_is_swept_and_kept_out_of_forces_alone(tmp_path):
    spec = {
        "hand": "allegro_right",
        "object": "sphere:radius=0.035,mass=0.1",
        "set": {"at": [0.06, 0, 0.06], "wrap": True},
        "over": {"reserve": ["none", "disturbance=0.2", "default", "friction=1"]},
    }
    rows = sweep(spec, tmp_path / "plans", jobs=1, progress=False).table().to_pylist()
    assert [row["status"] for row in rows] == ["ok", "ok", "ok", "invalid_input"]
    assert rows[0]["impulse_Ns"] < rows[1]["impulse_Ns"] < rows[2]["impulse_Ns"]
    alone = {**spec, "what": "forces", "set": {**spec["set"], "impact_time": 0.9}}
    rows = sweep(alone, tmp_path / "forces", jobs=1, progress=False).table().to_pylist()
    assert [row["status"] for row in rows] == ["ok", "invalid_input", "invalid_input", "invalid_input"]
    assert "with what: forces" in rows[1]["message"]


# --- kept whatever happens


def rows_on_disk(folder: Path) -> int:
    try:
        return read_sweep(folder).num_rows
    except InvalidInput:  # not yet
        return 0


SCRIPT = "import sys\nfrom pinograsp.sweep import runner\nrunner._SAVED_EVERY = float(sys.argv.pop(1))\nfrom pinograsp.cli import main\nmain()"


def start(folder: Path, *args, every: float = 0.1) -> subprocess.Popen:
    """The command in a process group of its own, as of a shell."""
    command = [sys.executable, "-c", SCRIPT, str(every), "sweep", "sweep.yaml", "--out", "out", *args]
    return subprocess.Popen(
        command,
        cwd=folder,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def stopped_after(folder: Path, rows: int, how: signal.Signals, *args, **settings) -> tuple[int, str, str]:
    """Start the command, and send a signal to the group when that many rows are on disk: exit code and output."""
    process = start(folder, *args, **settings)
    end = time.monotonic() + 300
    while rows_on_disk(folder / "out") < rows and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(process.pid, how)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def write(folder: Path, spec: dict) -> None:
    with (folder / "sweep.yaml").open("w") as stream:
        yaml.safe_dump(spec, stream)


def draws(count: int) -> dict:
    mixed = {"friction.mu": {"uniform": [0.3, 1.0]}, "object.mass": {"uniform": [0.3, 1.2]}}
    return {**BASE, "samples": {"count": count, **mixed}}


@pytest.mark.slow
def test_killed_twice_and_resumed_nothing_is_lost_or_doubled(tmp_path, often):
    """Two thousand plans, two at a time."""
    count = often(2000)
    write(tmp_path, draws(count))
    first = sweep(tmp_path / "sweep.yaml", tmp_path / "whole", jobs=2, progress=False)
    before = 0
    for share, processes in ((0.2, "2"), (0.5, "1")):
        code, _, _ = stopped_after(
            tmp_path, int(share * count), signal.SIGKILL, "--jobs", processes, every=min(1.0, 5e-4 * count)
        )
        kept = rows_on_disk(tmp_path / "out")
        assert code == -signal.SIGKILL and before < kept < count
        before = kept
    process = start(tmp_path, "--jobs", "2", "--json", every=min(1.0, 5e-4 * count))
    out, err = process.communicate(timeout=1200)
    assert process.returncode == 0 and err == ""
    document = json.loads(out)
    assert document["rows"] == document["done"] == count and document["counts"] == first.counts
    table = read_sweep(tmp_path / "out")
    assert table["index"].to_pylist() == list(range(count))
    assert same(table, first.table())
    assert not list((tmp_path / "out").glob(".part*"))


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_ctrl_c_keeps_what_is_done(tmp_path, jobs):
    write(tmp_path, draws(2000))
    code, out, err = stopped_after(tmp_path, 5, signal.SIGINT, "--jobs", jobs)
    assert code == 130 and "Traceback" not in err, err
    kept = read_sweep(tmp_path / "out")
    assert 5 <= kept.num_rows < 2000 and len(set(kept["index"].to_pylist())) == kept.num_rows
    told = " ".join(out.split())
    assert f"of {kept.num_rows} rows are plans" in told
    assert f"; {2000 - kept.num_rows} of 2000 are left: the same command continues" in told
    assert "interrupted" not in kept["status"].to_pylist()


@pytest.mark.slow
def test_a_lost_worker_is_told_and_what_is_done_is_kept(tmp_path):
    write(tmp_path, draws(2000))
    process = start(tmp_path, "--jobs", "2")
    while rows_on_disk(tmp_path / "out") < 5 and process.poll() is None:
        time.sleep(0.02)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    workers = [int(pid) for pid in children if b"popen_loky" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(workers[0], signal.SIGKILL)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2 and "pinograsp: a worker was lost" in err and "Traceback" not in err
    assert 5 <= rows_on_disk(tmp_path / "out") < 2000


@pytest.mark.slow
def test_a_crash_at_any_moment_of_writing_loses_and_doubles_nothing(tmp_path, monkeypatch):
    """Every call that changes the folder fails once, before or after it is done; another process goes on."""
    kinds, settings = {"a": "number", "status": "text"}, {"x": 1}
    real = {name: getattr(Path, name) for name in ("replace", "unlink")}

    class Crash(BaseException):
        pass

    def crashing(name, at, after):
        def step(self, *args, **kwargs):
            steps.append(name)
            if len(steps) == at + 1 and not after:
                raise Crash
            made = real[name](self, *args, **kwargs)
            if len(steps) == at + 1 and after:
                raise Crash
            return made

        return step

    def go_on(folder):
        with Store(folder, settings, 5, kinds) as store:
            for index in np.flatnonzero(~store.have).tolist():
                store.add_rows([{"index": index, "a": float(index), "status": "ok"}])
                store.save()
            store.merge()
        return store

    crashes = 0
    for at in range(16):
        for after in (False, True):
            folder, steps = tmp_path / f"{at}-{after}", []
            for name in real:
                monkeypatch.setattr(Path, name, crashing(name, at, after))
            try:
                go_on(folder)
            except Crash:
                crashes += 1
            for name in real:
                monkeypatch.setattr(Path, name, real[name])
            if (folder / "_manifest.json").exists():
                partial = read_sweep(folder)["index"].to_pylist()
                assert partial == list(range(len(partial)))
            store = go_on(folder)
            assert store.done == store.counts["ok"] == 5
            assert read_sweep(folder)["a"].to_pylist() == [float(i) for i in range(5)]
            assert len(list(folder.iterdir())) == 2  # one part, the manifest
    assert crashes >= 2 * (1 + 5 + 1 + 5)  # manifest, parts, the merged one, what it takes the place of


def test_many_parts_become_one(tmp_path, monkeypatch):
    from pinograsp.sweep import parts as module

    monkeypatch.setattr(module, "_MERGED", 5)
    with Store(tmp_path / "out", {}, 23, {"status": "text"}) as store:
        for index in range(23):
            store.add_rows([{"index": index, "status": "ok"}])
            store.save()
        assert sorted(path.name for path in store.folder.glob("part*"))[0] == "part-000000-000004.parquet"
        assert len(list(store.folder.glob("part*"))) == 4 + 3
    assert read_sweep(tmp_path / "out")["index"].to_pylist() == list(range(23))


@pytest.mark.slow
def test_an_interruption_while_rows_are_saved_doubles_none(tmp_path, monkeypatch):
    """Ctrl-C right after the rename: the rows are saved again, under the same name."""
    from pinograsp.sweep import parts as module

    plain, hits = module.write_file, []

    def interrupted(path, content):
        plain(path, content)
        if path.name.startswith("part") and not hits:
            hits.append(path)
            raise KeyboardInterrupt

    monkeypatch.setattr(module, "write_file", interrupted)
    monkeypatch.setattr(runner, "_SAVED_EVERY", 0.0)
    done = sweep(GRID, tmp_path / "out", jobs=1, progress=False)
    assert hits and done.interrupted and 0 < done.done < 6
    assert read_sweep(tmp_path / "out").num_rows == done.done
    done = sweep(GRID, tmp_path / "out", jobs=1, progress=False)
    assert done.done == 6 and read_sweep(tmp_path / "out")["index"].to_pylist() == list(range(6))


# --- what is refused


def test_folders_that_are_refused(grid, tmp_path):
    other = {**GRID, "over": {**GRID["over"], "object.mass": [0.5, 1.1]}}
    before = sorted((path.name, path.stat().st_mtime_ns) for path in grid.folder.glob("*.parquet"))
    with pytest.raises(ResultsNotWritten, match=r"holds another sweep \(over.object.mass\): they are not mixed"):
        sweep(other, grid.folder, progress=False)
    with pytest.raises(ResultsNotWritten, match=r"another sweep \(of.friction.safety, set.friction.safety\)"):
        sweep({**GRID, "set": {**LIGHT, "friction.safety": 1.2}}, grid.folder, progress=False)
    assert before == sorted((path.name, path.stat().st_mtime_ns) for path in grid.folder.glob("*.parquet"))
    assert sweep(GRID, grid.folder, progress=False).done == 6  # the same one has nothing left to do
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ResultsNotWritten, match=r"holds files that no sweep wrote \(notes.txt\): give another folder"):
        sweep(GRID, tmp_path, progress=False)
    with pytest.raises(ResultsNotWritten, match="cannot write"):
        sweep(GRID, tmp_path / "notes.txt", progress=False)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with (
        Store(tmp_path / "out", {}, 3, {"status": "text"}),
        pytest.raises(ResultsNotWritten, match="another sweep is writing there"),
    ):
        Store(tmp_path / "out", {}, 3, {"status": "text"})


def test_what_others_have_put_beside_the_rows_stays(tmp_path):
    kinds = {"status": "text"}
    with Store(tmp_path / "out", {}, 4, kinds) as store:
        store.add_rows([{"index": 0, "status": "ok"}])
        store.save()
    theirs = (
        "part-mine-x.parquet",
        "part-1-2-3.parquet",
        "part-000000-.parquet",
        ".part-notes",
        "._manifest.json-old",
        "notes.txt",
    )
    for name in theirs:
        (tmp_path / "out" / name).write_text("mine")
    (tmp_path / "out" / ".pinograsp-dead").write_text("half")  # of a writer that was killed
    for index in (1, 2, 3):
        with Store(tmp_path / "out", {}, 4, kinds) as store:
            assert store.done == index
            store.add_rows([{"index": index, "status": "ok"}])
            store.save()
            store.merge()
    assert read_sweep(tmp_path / "out")["index"].to_pylist() == [0, 1, 2, 3]
    assert {*theirs} < {path.name for path in (tmp_path / "out").iterdir()} and not (
        tmp_path / "out" / ".pinograsp-dead"
    ).exists()


def test_parts_of_other_tables_are_told(tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {"status": "text"}
    Store(tmp_path / "out", {}, 4, kinds).__exit__()
    part = tmp_path / "out" / "part-000000-000000.parquet"
    for columns, message in (
        ({"a": [1]}, "no column index"),
        ({"index": [7], "status": ["ok"]}, "holds rows that this sweep does not have"),
    ):
        parquet.write_table(pa.table(columns), part)
        with pytest.raises(InvalidInput, match=message):
            Store(tmp_path / "out", {}, 4, kinds)
    Store(tmp_path / "other", {}, 4, kinds).__exit__()


@pytest.mark.parametrize("how", ["removed", "replaced", "lock removed"])
def test_a_folder_that_is_taken_away_meanwhile_is_told(tmp_path, how):
    kinds, folder = {"status": "text"}, tmp_path / "out"
    with Store(folder, {}, 3, kinds) as store:
        if how == "lock removed":
            (folder / ".pinograsp-rows.lock").unlink()
        else:
            folder.rename(tmp_path / "moved")
        if how == "replaced":
            Store(folder, {"another": 1}, 3, kinds).__exit__()
        store.add_rows([{"index": 0, "status": "ok"}])
        with pytest.raises(ResultsNotWritten, match="was removed, or another has taken its place"):
            store.save()
    assert not list(tmp_path.rglob("part*"))


STORED = """
import sys
from pathlib import Path
import numpy as np
from pinograsp.errors import ResultsNotWritten
from pinograsp.sweep import parts
from pinograsp.sweep.store import Store
parts._MERGED = 5
print("ready", flush=True)
while True:
    try:
        with Store(Path(sys.argv[1]), {}, 100000, {"status": "text"}) as store:
            for index in np.flatnonzero(~store.have)[:30].tolist():
                store.add_rows([{"index": index, "status": "ok"}])
                store.save()
    except ResultsNotWritten:
        pass
"""


@pytest.mark.slow
@pytest.mark.parametrize("rounds", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_writers_of_rows_that_are_killed_lose_and_double_none(tmp_path, rounds, often):
    rng, before = np.random.default_rng(rounds), 0
    for _ in range(often(rounds)):
        start_and_kill([[STORED, tmp_path / "out"]] * 2, rng.uniform(0, 0.3))
        with Store(tmp_path / "out", {}, 100000, {"status": "text"}) as store:
            found = read_sweep(tmp_path / "out")["index"].to_pylist()
            assert found == list(range(len(found))) and store.done == len(found) >= before
            before = len(found)
        assert all(
            path.name == "_manifest.json" or path.match("part-*-*.parquet") for path in (tmp_path / "out").iterdir()
        )


def test_on_a_full_disk_the_rows_are_kept_and_resumed(small_disk):
    folder, kinds = small_disk(64) / "out", {"status": "text"}
    with pytest.raises(ResultsNotWritten, match="No space left"), Store(folder, {}, 100, kinds) as store:
        for index in range(100):
            store.add_rows([{"index": index, "status": "ok"}])
            store.save()
    kept = read_sweep(folder)["index"].to_pylist()
    assert kept == list(range(len(kept))) and 0 < len(kept) < 100
    with Store(folder, {}, 100, kinds) as store:
        assert store.done == len(kept)
    with pytest.raises(ResultsNotWritten, match="cannot write"):
        Store(folder.parent / ("n" * 300), {}, 100, kinds)


def test_folders_that_cannot_be_read(grid, tmp_path):
    with pytest.raises(InvalidInput, match="holds no sweep: expected a folder that 'pinograsp sweep' has written"):
        read_sweep(tmp_path)
    (tmp_path / "_manifest.json").write_text('{"schema": "other"}')
    with pytest.raises(InvalidInput, match="no sweep of schema pinograsp.sweep/1"):
        read_sweep(tmp_path)
    (tmp_path / "_manifest.json").write_text("{")
    with pytest.raises(InvalidInput, match="no readable sweep"):
        read_sweep(tmp_path)
    (tmp_path / "_manifest.json").write_bytes((grid.folder / "_manifest.json").read_bytes())
    assert read_sweep(tmp_path).num_rows == 0 and "work_J" in read_sweep(tmp_path).column_names
    (tmp_path / "part-000000-000000.parquet").write_bytes(b"PAR1")
    with pytest.raises(InvalidInput, match="remove it, and its rows are computed again"):
        read_sweep(tmp_path)


MASS = {"object.mass": [0.5, 1.0]}
# What is wrong | the sweep | what the message says.
BAD = """
no source | {over: {object.mass: [0.5, 1.0]}} | expected either case, or hand and object
hand without object | {hand: allegro_right, over: {object.mass: [0.5, 1.0]}} | expected either case, or hand and object
case and hand | {case: paper, hand: x, object: y, over: {object.mass: [0.5, 1.0]}} | expected either case, or hand and object
nothing to vary | {case: paper} | nothing to vary: expected inputs under over or under samples
count alone | {case: paper, samples: {count: 3}} | nothing to vary
unknown section | {case: paper, ovr: {object.mass: [0.5, 1.0]}, over: {object.mass: [0.5, 1.0]}} | ovr: unknown key; did you mean 'over'?
unknown word of a range | {case: paper, over: {friction.mu: {from: 0, to: 1, step: 3}}} | over.friction.mu.step: unknown key; did you mean 'steps'?
one step | {case: paper, over: {friction.mu: {from: 0, to: 1, steps: 1}}} | steps: Input should be greater than or
log of zero | {case: paper, over: {friction.mu: {from: 0, to: 1, steps: 3, spacing: log}}} | spacing 'log' needs from and to above 0
a number for a list | {case: paper, over: {object.mass: 0.5}} | over.object.mass: expected a list of values, or {from, to, steps} (got 0.5)
an empty list | {case: paper, over: {object.mass: []}} | over.object.mass: Tuple should have at least 1 item
no count | {case: paper, samples: {object.mass: {normal: [1, 0.1]}}} | samples.count: Field required
unknown distribution | {case: paper, samples: {count: 3, object.mass: {uniforn: [0, 1]}}} | samples.object.mass.uniforn: unknown key; did you mean 'uniform'?
no distribution | {case: paper, samples: {count: 3, object.mass: 1.0}} | samples.object.mass: expected a distribution, for example {uniform: [0.4, 1.0]} (got 1.0)
two distributions | {case: paper, samples: {count: 3, object.mass: {uniform: [0, 1], normal: [0, 1]}}} | give one of uniform, log_uniform, normal and choice
ends swapped | {case: paper, samples: {count: 3, friction.mu: {uniform: [1, 0.4]}}} | expected the lower end first, got 1, 0.4
twice | {case: paper, set: {object.mass: 1}, over: {object.mass: [0.5, 1.0]}} | expected every input once, got object.mass under set and over
unknown case | {case: papper, over: {object.mass: [0.5, 1.0]}} | no case 'papper'
unknown input | {case: paper, over: {friction.mue: [1]}} | friction.mue: unknown key; did you mean 'mu'?
unknown section of the case | {case: paper, over: {frction.mu: [1]}} | did you mean 'friction'?
unknown fixed input | {case: paper, set: {object.mas: 1}, over: {object.mass: [0.5, 1.0]}} | did you mean
no such contact | {case: paper, over: {contacts.3.point_mm: [[0, 0, 0]]}} | 'contacts.3' has no further keys
a fixed value | {case: paper, set: {friction.mu: -1}, over: {object.mass: [0.5, 1.0]}} | friction.mu: Input should be greater than or equal to 0
no value of use | {case: paper, over: {object.mass: [-1, -2]}} | none of the first rows can be used: object.mass
unknown finger | {case: paper, over: {contacts.0.finger: [thump]}} | none of the first rows can be used
forces without a time | {case: paper, what: forces, over: {object.mass: [0.5, 1.0]}} | what: forces needs impact_time [s]
a plan with a time | {case: paper, set: {impact_time: 0.9}, over: {object.mass: [0.5, 1.0]}} | what: plan has no impact_time
a time too late | {case: paper, what: forces, set: {impact_time: 1.5}, over: {object.mass: [0.5, 1.0]}} | expected below the final time 1 s, got 1.5 s
torque limits | {case: paper, what: forces, set: {impact_time: 0.9, limits.torque_limit: 1}, over: {object.mass: [0.5, 1.0]}} | limits.torque_limit: expected none with what: forces
unknown hand | {hand: allegro_rigth, object: 'sphere:radius=0.03,mass=0.1', over: {mu: [1]}} | did you mean 'allegro_right'
unknown field of an object | {hand: allegro_right, object: 'sphere:radius=0.03,mass=0.1', over: {object.radios: [1]}} | did you mean 'radius'
unknown option | {hand: allegro_right, object: 'sphere:radius=0.03,mass=0.1', over: {wrp: [true]}} | wrp: unknown key; did you mean 'wrap'?
a folder | {case: paper, over: {object.mass: [0.5, 1.0]}, folder: /} | folder: unknown key
"""
MANY = {f"contacts.{i}.point_mm.{j}": {"from": 0, "to": 1, "steps": 9} for i in range(3) for j in range(3)}
BAD_SWEEPS = {
    **{
        name: (yaml.safe_load(spec), message)
        for name, spec, message in (row.split(" | ") for row in BAD.split("\n") if row)
    },
    "too many rows": ({"case": "paper", "over": MANY}, "expected at most 10000000 rows, got 387420489"),
    "not plain": (
        {"case": "paper", "over": {"object.mass": [1, {2}]}},
        "expected numbers, texts, lists and mappings as values",
    ),
}


@pytest.mark.parametrize(("spec", "message"), BAD_SWEEPS.values(), ids=BAD_SWEEPS)
def test_bad_sweeps_say_what_was_expected(tmp_path, spec, message):
    with pytest.raises(CaseRejected) as caught:
        sweep(spec, tmp_path / "out", progress=False)
    assert message in str(caught.value), str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        *(
            ({"jobs": jobs}, "jobs: expected a number of processes from 1 to 1000, or -1 for all cores")
            for jobs in (0, -2, -5, 1001, 10**9, 10**400, True, 1.5, "2", None)
        ),
        ({"executor": "dusk"}, "did you mean 'dask'"),
        ({"executor": "dask"}, "scheduler: expected the address"),
        ({"scheduler": "tcp://x:1"}, "and only there"),
    ],
)
def test_bad_settings(tmp_path, settings, message):
    with pytest.raises(InvalidInput, match=message):
        sweep(GRID, tmp_path / "out", progress=False, **settings)
    assert list(tmp_path.iterdir()) == []


# --- the command line


def test_the_command_prints_a_table_and_goes_on(command, tmp_path):
    write(tmp_path, {**BASE, "over": {"object.mass": [0.5, 1.0, 30.0]}})
    code, out, err = command("sweep", "sweep.yaml", "--jobs", "2")
    assert code == 0 and err == ""
    assert [line.split() for line in out.splitlines()[:4]] == [
        ["status", "rows", "share"],
        ["ok", "2", "66.7", "%"],
        ["infeasible", "1", "33.3", "%"],
        [],
    ]
    assert "2 of 3 rows are plans that hold" in out and "runs/sweep" in out
    code, out, err = command("sweep", "sweep.yaml", "--json")
    document = json.loads(out)
    assert code == 0 and err == "" and document["folder"] == os.path.join("runs", "sweep")
    assert document["counts"] == {"ok": 2, "infeasible": 1} and document["rows"] == document["done"] == 3


@pytest.mark.slow
def test_exit_codes_and_errors_for_machines(command, tmp_path):
    write(tmp_path, {**BASE, "over": {"object.mass": [30.0, 31.0]}})
    code, out, _ = command("sweep", "sweep.yaml", "--jobs", "1")
    assert code == 3 and "infeasible" in out
    write(tmp_path, {**BASE, "over": {"object.mas": [1.0]}})
    code, out, err = command("sweep", "sweep.yaml")
    assert (
        code == 2
        and out == ""
        and err.startswith("pinograsp: sweep 'sweep.yaml': object.mas")
        and "Traceback" not in err
    )
    code, out, _ = command("sweep", "sweep.yaml", "--json")
    assert code == 2 and json.loads(out)["error"] == "CaseRejected"
    assert command("sweep", "nothing.yaml")[0] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("over: [1", "not valid YAML"),
        ("- 1", "expected a mapping"),
        ("", "expected a mapping"),
        ("\x00", "not valid YAML"),
    ],
)
def test_broken_files(command, tmp_path, text, message):
    (tmp_path / "sweep.yaml").write_text(text)
    code, _, err = command("sweep", "sweep.yaml")
    assert code == 2 and message in err and not (tmp_path / "runs").exists()


def test_a_case_beside_the_sweep(tmp_path, monkeypatch):
    """Paths start where the sweep file is; another text of the case is another sweep."""
    lab = tmp_path / "lab"
    lab.mkdir()
    settings = load_case("paper", LIGHT).settings()
    with (lab / "mine.yaml").open("w") as stream:
        yaml.safe_dump(settings, stream)
    write(lab, {"case": "mine.yaml", "over": MASS})
    monkeypatch.chdir(tmp_path)
    assert sweep("lab/sweep.yaml", "out", jobs=1, progress=False).counts == {"ok": 2}
    settings["friction"]["mu"] = 0.8
    with (lab / "mine.yaml").open("w") as stream:
        yaml.safe_dump(settings, stream)
    with pytest.raises(ResultsNotWritten, match=r"another sweep \(of.friction.mu\)"):
        sweep("lab/sweep.yaml", "out", jobs=1, progress=False)


# --- a cluster, and extras that are missing


@pytest.mark.slow
def test_a_dask_cluster_finds_the_same(grid, tmp_path, command):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        done = sweep(GRID, tmp_path / "a", executor="dask", scheduler=cluster.scheduler_address, progress=False)
        assert done.counts == {"ok": 6} and same(done.table(), grid.table())
        write(tmp_path, draws(16))
        args = (
            "sweep",
            "sweep.yaml",
            "--executor",
            "dask",
            "--scheduler",
            cluster.scheduler_address,
            "--json",
            "--out",
            "b",
        )
        code, out, _ = command(*args)
        assert code == 0 and json.loads(out)["done"] == 16
    again = sweep(tmp_path / "sweep.yaml", tmp_path / "c", jobs=1, progress=False)
    assert same(read_sweep(tmp_path / "b"), again.table())


@pytest.mark.slow
def test_no_dask_scheduler_there(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(runner, "_CONNECTED_WITHIN", 0.5)
    with pytest.raises(InvalidInput, match="expected the address of a running Dask scheduler, got 'tcp://127.0.0.1:1'"):
        sweep(GRID, tmp_path / "out", executor="dask", scheduler="tcp://127.0.0.1:1", progress=False)


@pytest.mark.parametrize(
    "address", ["nonsense", "tcp://x:0", "tcp://127.0.0.1:99999", ":5", "tcp://127.0.0.1:", "tcp://h:²"]
)
def test_an_address_without_host_and_port_is_refused(tmp_path, address):
    pytest.importorskip("distributed")
    with pytest.raises(InvalidInput, match=r"scheduler: expected an address with a port from 1 to 65535"):
        sweep(GRID, tmp_path / "out", executor="dask", scheduler=address, progress=False)


def test_a_port_where_somebody_else_listens_is_refused(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(runner, "_ANSWERED_WITHIN", 0.2)
    wanted = "expected the address of a running Dask scheduler"
    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(InvalidInput, match=wanted):
        sweep(
            GRID,
            tmp_path / "out",
            executor="dask",
            scheduler=f"tcp://127.0.0.1:{silent.getsockname()[1]}",
            progress=False,
        )


@pytest.mark.slow
def test_missing_extras_are_named(tmp_path):
    """Without pyarrow, distributed or the core: one line that says what to install, from a process that cannot import
    them.
    """
    write(tmp_path, {**BASE, "over": MASS})
    code = (
        "import sys\n"
        "for name in sys.argv[1].split(','): sys.modules[name] = None\n"
        "import pinograsp.sweep as s\n"
        "def tried(call):\n"
        "    try:\n        call()\n"
        "    except s.runner.PinograspError as error:\n        print(type(error).__name__, error)\n"
        "tried(lambda: s.sweep('sweep.yaml', 'out', jobs=1))\n"
        "tried(lambda: s.sweep('sweep.yaml', 'out', executor='dask', scheduler='tcp://127.0.0.1:1'))\n"
        "tried(lambda: s.sweep({'case': 'paper', 'what': 'forces', 'set': {'impact_time': 0.9}, 'over': "
        "{'object.mass': [1]}}, 'b', jobs=1))\n"
    )

    def without(names):
        done = subprocess.run(
            [sys.executable, "-c", code, names], cwd=tmp_path, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    lines = without("pyarrow")
    assert len(lines) == 3 and all(
        line.startswith("ExtraMissing") and "pip install 'pinograsp[sweep]'" in line for line in lines
    )
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.yaml"]
    lines = without("distributed,pinograsp.core._core_base")
    assert len(lines) == 2, lines
    assert "pip install 'pinograsp[dask]'" in lines[0] and "the compiled core is missing" in lines[1]


HAND = """<robot name="h"><link name="palm"/>{}</robot>"""
FINGER = """<link name="f{0}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0"
iyz="0"/></inertial><collision><geometry><mesh filename="finger.stl"/></geometry></collision></link><joint name="j{0}"
type="revolute"><parent link="palm"/><child link="f{0}"/><origin xyz="{0} 0 0.05"/><axis xyz="0 1 0"/><limit lower="-1"
upper="1" effort="{1}" velocity="1"/></joint>"""


def two_fingers(folder, effort=1, width=0.01):
    import trimesh

    (folder / "hand.urdf").write_text(HAND.format("".join(FINGER.format(i, effort) for i in range(2))))
    trimesh.creation.box((width, 0.01, 0.04)).export(folder / "finger.stl")
    trimesh.creation.box((0.03, 0.03, 0.03)).export(folder / "cube.stl")


@pytest.mark.parametrize("change", ["hand.urdf", "finger.stl", "cube.stl"])
def test_a_sweep_of_changed_files_is_another_one_and_names_them(tmp_path, change):
    import trimesh

    two_fingers(tmp_path)
    (tmp_path / "sweep.yaml").write_text(
        'hand: hand.urdf\nobject: "mesh:path=cube.stl,mass=0.1"\nset: {at: [0, 0, 2.0]}\nover: {mu: [0.5, 0.6]}\n'
    )
    done = pg.sweep.sweep(tmp_path / "sweep.yaml", tmp_path / "out", jobs=1, progress=False)
    assert done.done == 2
    two_fingers(tmp_path)  # the same content once more
    assert pg.sweep.sweep(tmp_path / "sweep.yaml", tmp_path / "out", jobs=1, progress=False).done == 2
    if change == "cube.stl":
        trimesh.creation.box((0.03, 0.03, 0.031)).export(tmp_path / "cube.stl")
    else:
        two_fingers(tmp_path, **({"effort": 7} if change == "hand.urdf" else {"width": 0.011}))
    with pytest.raises(ResultsNotWritten, match=f"another sweep.*{change}"):
        pg.sweep.sweep(tmp_path / "sweep.yaml", tmp_path / "out", jobs=1, progress=False)


def test_a_hand_is_loaded_again_when_one_of_its_files_has_changed(tmp_path):
    from pinograsp.cases.object_case import ObjectCase

    two_fingers(tmp_path)
    case = ObjectCase.of(hand="hand.urdf", object="sphere:radius=0.02,mass=0.1", folder=tmp_path)
    first = case.load_hand()
    assert case.load_hand() is first
    two_fingers(tmp_path)
    assert case.load_hand() is first, "the same content"
    two_fingers(tmp_path, effort=7)
    assert case.load_hand().model.effortLimit.tolist() == [7, 7]
    two_fingers(tmp_path, effort=7, width=0.02)
    shape = case.load_hand().geometry.geometryObjects[0].geometry
    shape.computeLocalAABB()
    assert shape.aabb_local.width() == pytest.approx(0.02)
