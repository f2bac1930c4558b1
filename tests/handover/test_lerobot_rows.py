"""Data sets for LeRobot: what is in them by pyarrow and by the readers of others, where these are installed."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import ExtraMissing, InvalidInput, ResultsNotWritten
from pinograsp.handover import write_lerobot
from pinograsp.identification import read_log

RATE = 50


@pytest.fixture(scope="module")
def plan():
    return pg.load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"}).plan()


@pytest.fixture(scope="module")
def simulation(plan):
    return pg.simulate(plan, hold=0.1)


def read_rows(folder):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(folder / "data/chunk-000/file-000.parquet")
    return {name: np.array(table.column(name).to_pylist()) for name in table.column_names}


def test_frames_are_those_of_plan_and_simulation(plan, simulation, tmp_path):
    folder = write_lerobot([plan, (plan, simulation)], tmp_path / "set", rate=RATE, task="hold it", action="torque")
    rows, info = read_rows(folder), json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["total_episodes"] == 2 and info["fps"] == RATE
    assert info["features"]["observation.state"]["names"] == list(plan.layout.joints)
    assert info["total_frames"] == len(rows["index"]) and list(rows["index"]) == list(range(info["total_frames"]))
    for episode, moved in enumerate((plan.motion, simulation)):
        own = rows["episode_index"] == episode
        times = rows["timestamp"][own]
        assert len(times) == int((moved.times[-1] - moved.times[0]) * RATE + 1e-6) + 1
        np.testing.assert_allclose(times, np.arange(len(times)) / RATE, rtol=1e-6)
        for i in range(len(plan.layout.joints)):
            expected = np.interp(moved.times[0] + times, moved.times, moved.q[:, i])
            np.testing.assert_allclose(rows["observation.state"][own][:, i], expected, atol=1e-5)
        torques = np.interp(moved.times[0] + times[:-1], moved.times, moved.torques[:, 0])
        size = np.abs(moved.torques).max()
        np.testing.assert_allclose(rows["action"][own][:-1, 0], torques, atol=1e-3 * size)
    statistics = json.loads((folder / "meta/stats.json").read_text())
    np.testing.assert_allclose(statistics["action"]["mean"], rows["action"].mean(axis=0), atol=1e-5)


def test_positions_to_go_to_are_those_of_the_next_frame(plan, tmp_path):
    rows = read_rows(write_lerobot([plan], tmp_path / "set", rate=RATE))
    np.testing.assert_array_equal(rows["action"][:-1], rows["observation.state"][1:])
    np.testing.assert_allclose(rows["action"][-1], plan.motion.q[-1], rtol=1e-6)


def test_the_identification_reads_it(plan, tmp_path):
    folder = write_lerobot([plan], tmp_path / "set", rate=RATE, action="torque")
    moving = int(np.ptp(plan.motion.q, axis=0).argmax())
    log = read_log(
        folder / "data/chunk-000/file-000.parquet",
        columns={"time": "timestamp", "position": f"observation.state[{moving}]", "force": f"action[{moving}]"},
        units={"position": "rad", "force": "N"},
    )
    assert np.ptp(log.position) == pytest.approx(np.ptp(plan.motion.q[:, moving]), rel=1e-2)


def test_readers_of_others_read_it(plan, simulation, tmp_path):
    experimental = pytest.importorskip("rerun.experimental", reason="the extra rerun is not installed")
    folder = write_lerobot([plan, (plan, simulation)], tmp_path / "set", rate=RATE, task="hold it")
    reader, rows = experimental.LeRobotReader(folder), read_rows(folder)
    assert reader.version == "v3" and reader.episodes() == [0, 1]
    columns = {}
    for chunk in reader.stream(1):
        if not chunk.is_static:
            (values,) = (name for name in chunk.to_record_batch().schema.names if ":" in name)
            columns[str(chunk.entity_path)] = chunk.to_record_batch().column(values).to_pylist()
    own = rows["episode_index"] == 1
    np.testing.assert_allclose(columns["/observation.state"], rows["observation.state"][own], rtol=1e-6)
    np.testing.assert_allclose(columns["/action"], rows["action"][own], rtol=1e-6)
    assert {text for cell in columns["/task"] for text in cell} == {"hold it"}


def test_tasks_are_an_index_of_pandas(plan, tmp_path):
    pandas = pytest.importorskip("pandas")
    folder = write_lerobot([plan], tmp_path / "set", task="hold it")
    assert pandas.read_parquet(folder / "meta/tasks.parquet").task_index.to_dict() == {"hold it": 0}


def test_what_is_no_data_set_is_refused(plan, simulation, tmp_path, monkeypatch):
    other = replace(plan, layout=replace(plan.layout, joints=plan.layout.joints[::-1]))
    for episodes, message in (([], "one hand"), ([plan, other], "2 hands"), ([simulation], "expected a PlanRecord")):
        with pytest.raises(InvalidInput, match=message):
            write_lerobot(episodes, tmp_path / "set")
    for wrong in ({"rate": 0}, {"action": "effort"}, {"task": 3}):
        with pytest.raises(InvalidInput):
            write_lerobot([plan], tmp_path / "set", **wrong)
    write_lerobot([plan], tmp_path / "set")
    with pytest.raises(ResultsNotWritten, match="exists"):
        write_lerobot([plan], tmp_path / "set")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ExtraMissing, match=r"pinograsp\[logs\]"):
        write_lerobot([plan], tmp_path / "set", force=True)
