"""Shards: processes that write into one folder at once, killed at any moment, make the table of one process."""

import functools
import json
import time

import numpy as np
import pytest
import trimesh
from killing import finish_in_spite_of_kills
from shard_runs import CONDITIONS, certify_into, certify_shard, data_in, sweep_shard

import pinograsp as pg
from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.hands import load_hand
from pinograsp.objects import Box
from pinograsp.sweep import (
    certified,
    certified_store,
    find_missing_grasps,
    find_missing_rows,
    read_certified,
    read_sweep,
    sweep,
)
from pinograsp.sweep.inputs import settings_of_hand
from pinograsp.sweep.shards import FileDeal, Shard, deal_rows, write_numbers

pytest.importorskip("pyarrow")
FORCES = {
    "case": "paper",
    "what": "forces",
    "set": {"forces.search": "hybrid", "motion.samples": 1, "motion.time_step": 0.01, "impact_time": 0.9},
    "over": {"friction.mu": {"from": 0.3, "to": 0.9, "steps": 5}},
}


def fresh_rng():
    seed = int(np.random.SeedSequence().entropy % 2**32)
    print(f"seed {seed}")
    return np.random.default_rng(seed)


def make_data(folder, counts):
    """Files of grasps of a box by a Panda hand, so many in each, in the form of GraspGen's."""
    (folder / "meshes").mkdir(exist_ok=True)
    trimesh.creation.box((0.03, 0.04, 0.08)).export(folder / "meshes" / "box.obj")
    rng, files = np.random.default_rng(3), []
    for i, count in enumerate(counts):
        poses = np.tile(pg.spatial.pose_of([0, 0, 0.13], np.diag([1.0, -1.0, -1.0])), (count, 1, 1))
        poses[:, :3, 3] += rng.normal(size=(count, 3)) * [0.02, 0.01, 0.015]
        grasps = {"transforms": poses.tolist(), "object_in_gripper": [True] * count}
        files.append(folder / f"{i}.json")
        files[-1].write_text(json.dumps({"object": {"file": "box.obj", "scale": 1.0}, "grasps": grasps}))
    return files


def run_and_time(call, shards):
    """The result of all rows in one process, and how long a shard lasts, as far as that tells [s]."""
    call_ends = [time.perf_counter()]
    results = []
    for _ in range(2):  # the second time nothing is left to do
        results.append(call())
        call_ends.append(time.perf_counter())
    first, again = np.diff(call_ends)
    return results[0], again + max(first - again, 0.0) / shards


def entries_of(folder):
    """What is left in a folder beside rows, manifest and folders of shards."""
    return [
        path.name
        for path in folder.rglob("*")
        if not (path.match("part-*-*.parquet") or path.name == "_manifest.json" or path.match("shard-*-of-*"))
    ]


@pytest.mark.parametrize(
    ("counts", "block", "shards", "kills"),
    [((40, 300, 7, 60), 32, 8, 3), ((3000, 100, 100, 12000, 800), 64, 64, 10)],
)
@pytest.mark.slow
def test_grasps_in_shards_that_are_killed_are_those_of_one_process(tmp_path, monkeypatch, counts, block, shards, kills):
    rng, files = fresh_rng(), make_data(tmp_path, counts)
    for name, text in (
        ("cut", files[0].read_text()[:-400]),
        ("cup", files[0].read_text().replace("box.obj", "cup.obj")),
    ):
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(text)
    monkeypatch.setattr(certified_store, "_BLOCK", block)
    data = data_in(tmp_path, files)
    whole, lasts = run_and_time(functools.partial(certify_into, tmp_path / "whole", data), shards)
    target = functools.partial(certify_shard, tmp_path, files, block, shards)
    killed = finish_in_spite_of_kills(target, shards, kills, lasts, rng)
    assert killed == kills
    table = read_certified(tmp_path / "out")
    assert table.num_rows == sum(counts) + 2 == whole.rows + 2 and len(set(table["reason"].to_pylist())) > 3
    assert table.equals(whole.table())
    missing = find_missing_grasps(data, tmp_path / "out", CONDITIONS)
    assert (missing.rows, missing.total, missing.shards) == (0, sum(counts) + counts[0] + 1, {shards: ()})
    again = certify_into(tmp_path / "out", data)
    assert again.counts == whole.counts and again.faults == whole.faults and again.hints == whole.hints
    assert entries_of(tmp_path / "out") == []


@pytest.mark.parametrize(
    ("rows", "most", "shards", "kills"),
    [(240, 4, 6, 2), pytest.param(20_000, 40, 64, 10, marks=pytest.mark.slow)],
)
def test_a_sweep_in_shards_that_are_killed_is_that_of_one_process(tmp_path, rows, most, shards, kills):
    rng = fresh_rng()
    spec = {**FORCES, "samples": {"count": rows // 5, "object.mass": {"uniform": [0.3, 1.2]}}}
    whole, lasts = run_and_time(lambda: sweep(spec, tmp_path / "whole", jobs=1, progress=False), shards)
    target = functools.partial(sweep_shard, tmp_path / "out", spec, most, shards)
    killed = finish_in_spite_of_kills(target, shards, kills, lasts, rng, at_once=6)
    assert killed == kills
    table, expected = (one.drop_columns("elapsed_s") for one in (read_sweep(tmp_path / "out"), whole.table()))
    assert table["index"].to_pylist() == list(range(rows)) and table.equals(expected)
    assert find_missing_rows(spec, tmp_path / "out").shards == {shards: ()}
    again = sweep(spec, tmp_path / "out", jobs=1, progress=False)
    assert again.counts == whole.counts and entries_of(tmp_path / "out") == []


def test_files_of_a_grasp_or_two_are_certified_together_as_each_alone(tmp_path, monkeypatch):
    """Also where one of them cannot be read, and one is of another size: the same rows, forces to rounding."""
    files = make_data(tmp_path, (1, 2, 1, 1, 5, 1, 2, 1))
    files[3].write_text("{")
    grasps = json.loads(files[6].read_text())
    grasps["object"]["scale"] = 0.9
    files[6].write_text(json.dumps(grasps))
    data = data_in(tmp_path, files)
    together = certify_into(tmp_path / "together", data)
    monkeypatch.setattr(certified, "_FEW", 0)
    alone = certify_into(tmp_path / "alone", data)
    assert together.counts == alone.counts and together.faults == alone.faults and len(alone.faults) == 1
    assert together.verdicts == alone.verdicts and together.hints == alone.hints
    found, expected = together.table(), alone.table()
    for name in found.column_names:
        if name in ("file", "row", "object", "scale", "reason", "contacts", "links", "labels", "inputs", "possible"):
            assert found[name].equals(expected[name]), name
    for name in ("forces_N", "points_m", "torques_Nm"):
        for one, other in zip(found[name].to_pylist(), expected[name].to_pylist()):
            np.testing.assert_allclose(one or [], other or [], rtol=1e-9, atol=1e-9)


def test_what_shards_have_left_is_done_by_others_or_by_one_and_only_that(tmp_path, monkeypatch):
    """Begun with 5, gone on with 2, ended without: no row is computed twice."""
    files = make_data(tmp_path, (12, 30, 3))
    monkeypatch.setattr(certified_store, "_BLOCK", 4)
    data, out = data_in(tmp_path, files), tmp_path / "out"
    before = find_missing_grasps(data, out, CONDITIONS)
    assert (before.rows, before.total, before.shards) == (45, 45, {}) and not out.exists()
    first = [certify_into(out, data, (i, 5)) for i in (2, 4)]
    there = sum(one.rows for one in first)
    missing = find_missing_grasps(data, out, CONDITIONS)
    assert (missing.rows, missing.shards) == (45 - there, {5: (1, 3, 5)}) and 0 < there < 45
    assert find_missing_grasps(data, out, CONDITIONS, shard="2/5").rows == 0
    own = find_missing_grasps(data, out, CONDITIONS, shard="1/2")
    second = certify_into(out, data, "1/2")
    assert second.rows == own.rows > 0 and own.total > own.rows  # the others of its share were there
    certify_into(out, data)
    parts = [len(_read(path)) for path in out.rglob("part-*")]
    assert sum(parts) == 45 and len(parts) == 4
    assert read_certified(out).equals(certify_into(tmp_path / "whole", data).table())


def _read(path):
    from pyarrow import parquet

    return parquet.ParquetFile(path).read()


def test_rows_of_grasps_that_changed_after_other_shards_had_certified_them_are_removed(tmp_path):
    files = make_data(tmp_path, (9, 8, 7, 6))
    data, out = data_in(tmp_path, files), tmp_path / "out"
    for i in (1, 2, 3):
        certify_into(out, data, (i, 3))
    kept = files[0].read_text()
    make_data(tmp_path, (4, 8, 7, 6))
    changed = json.loads(files[0].read_text())
    assert files[0].read_text() != kept and len(changed["grasps"]["transforms"]) == 4
    missing = find_missing_grasps(data, out, CONDITIONS)
    assert missing.rows >= 4 and missing.total == 25
    seen = [certify_into(out, data, (i, 2)).changed for i in (1, 2)]
    assert str(files[0]) in seen[0] + seen[1]
    assert find_missing_grasps(data, out, CONDITIONS).rows == 0
    assert read_certified(out).equals(certify_into(tmp_path / "fresh", data).table())


def test_who_would_write_the_same_rows_at_once_is_refused(tmp_path, monkeypatch):
    from pinograsp.sweep import parts

    monkeypatch.setattr(parts, "PATIENCE", 0.1)
    files = make_data(tmp_path, (5,))
    data, out = data_in(tmp_path, files), tmp_path / "out"
    certify_into(out, data, "1/3")
    folder = out / "shard-2-of-3"
    with certified_store.CertifiedRows(out, _settings(out), tuple(files), None, Shard(2, 3), False) as rows:
        assert rows.own == folder
        for shard in ("2/3", "1/2", None):
            with pytest.raises(ResultsNotWritten, match=r"is writing there \(shard-2-of-3\): wait for it"):
                certify_into(out, data, shard)
        certify_into(out, data, "3/3")
        assert find_missing_grasps(data, out, CONDITIONS, shard="3/3").rows == 0
    certify_into(out, data)
    with pytest.raises(ResultsNotWritten, match=r"another certification \(conditions.mu\)"):
        certify_into(out, data, "2/3", pg.GraspConditions(mu=0.5))
    with pytest.raises(ResultsNotWritten, match=r"another certification \(conditions.mu\)"):
        find_missing_grasps(data, out, pg.GraspConditions(mu=0.5))


def _settings(out):
    return json.loads((out / "_manifest.json").read_text())["settings"]


@pytest.mark.parametrize("given", ["", "3", "0/3", "4/3", "1/0", "1/2/3", "a/b", "-1/2", "1/100001", 5, (1,), (1.5, 2)])
def test_what_is_no_shard_is_refused(tmp_path, given):
    with pytest.raises(InvalidInput, match="shard: expected I/N, the share I from 1 to N"):
        sweep(FORCES, tmp_path / "out", jobs=1, progress=False, shard=given)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 1000])
def test_each_row_is_dealt_to_one_shard_and_all_get_as_many(count):
    dealt = deal_rows(1000, count)
    sizes = np.bincount(dealt, minlength=count + 1)
    assert sizes[0] == 0 and len(sizes) == count + 1 and sizes[1:].max() - sizes[1:].min() <= 1
    # What one of them leaves is as much for each of two others: within five standard deviations.
    left = deal_rows(100_000, count) == 1
    halves = deal_rows(100_000, 2)[left]
    assert count == 2 or abs((halves == 1).mean() - 0.5) < 2.5 / len(halves) ** 0.5 + 1e-9


def test_rows_are_dealt_alike_whatever_the_machine():
    """Or some would be done twice and others by nobody: the numbers are those of NumPy's first generator."""
    assert deal_rows(8, 3).tolist() == [2, 2, 3, 1, 1, 3, 2, 1]


def test_blocks_of_files_are_dealt_evenly_and_few_read_a_file():
    rng = fresh_rng()
    for count in (2, 5, 32):
        blocks = rng.lognormal(1.5, 1.0, size=12 * count).astype(int) + 1
        deal = FileDeal([10_000 * int(one) for one in blocks], count)
        shares, reads = np.zeros(count + 1, dtype=int), 0
        for file, number in enumerate(blocks.tolist()):
            dealt = [deal.number_of(file, block) for block in range(number)]
            readers = [i for i in range(1, count + 1) if deal.is_of(file, i)]
            assert set(dealt) <= set(readers)
            shares += np.bincount(dealt, minlength=count + 1)
            reads += number * len(readers)
        assert shares[0] == 0 and shares[1:].max() < 1.5 * blocks.sum() / count
        assert reads < 2.5 * blocks.sum()
    one = FileDeal([7_000_000], 64)
    assert sorted(one.number_of(0, block) for block in range(64)) == list(range(1, 65))


def test_the_commands_tell_what_is_missing(tmp_path, command):
    files = make_data(tmp_path, (5, 5, 5))
    given = ["certify", *map(str, files), "--hand", "panda", "--objects", str(tmp_path / "meshes"), "--mass", "0.1"]
    given += ["--convention", "panda_graspgen", "--out", str(tmp_path / "out"), "--jobs", "1"]
    code, told, _ = command(*given, "--missing")
    assert code == 3 and "15 of 15 rows" in told and not (tmp_path / "out").exists()
    code, told, _ = command(*given, "--shard", "1/3")
    assert code == 0 and "of 5 grasps of shard 1/3" in told
    code, told, _ = command(*given, "--missing")
    assert code == 3 and "10 of 15 rows" in told and told.split()[-4:] == ["Of", "3", "shards", "2-3"]
    code, told, _ = command(*given, "--missing", "--json")
    assert code == 3 and json.loads(told) | {"folder": ""} == {
        "missing": 10,
        "rows": 15,
        "shards": {"3": [2, 3]},
        "folder": "",
    }
    assert command(*given, "--missing", "--shard", "1/3")[0] == 0
    assert command(*given, "--shard", "2/3", "--back", str(tmp_path / "back"))[0] == 2
    assert command(*given)[0] == 0 and command(*given, "--missing")[0] == 0
    (tmp_path / "sweep.yaml").write_text(json.dumps({**FORCES, "over": {"friction.mu": [0.5, 0.6, 0.7]}}))
    code, told, _ = command("sweep", "sweep.yaml", "--jobs", "1", "--shard", "3/3")
    assert code == 0 and "1 of 1 rows of shard 3/3 are plans that hold" in told
    code, told, _ = command("sweep", "sweep.yaml", "--missing")
    assert code == 3 and "2 of 3 rows in runs/sweep" in told and told.split()[-1] == "1-2"


def test_numbers_are_written_as_job_arrays_take_them():
    assert write_numbers([3, 17, 40, 41, 42]) == "3,17,40-42" and write_numbers([]) == "" and write_numbers([1]) == "1"


@pytest.mark.parametrize("name", ["panda", "g1_left"])
def test_what_a_hand_was_used_for_makes_it_no_other(name):
    """Coal keeps boxes and hulls of meshes as they are asked for: what identifies a run has none of these."""
    hand = load_hand(name)
    before = settings_of_hand(hand)
    pg.find_grasps(hand, Box(size=(0.03, 0.03, 0.05), mass=0.1), pg.GraspConditions(mu=0.6), count=4, jobs=1)
    assert settings_of_hand(hand) == before == settings_of_hand(load_hand(name))
