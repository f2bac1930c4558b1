"""Files of grasps certified: rows as of one call, faults kept apart, interruptions and kills that lose nothing."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh

import pinograsp as pg
from pinograsp.certification import Reason
from pinograsp.data import GraspRows, read_grasps, write_grasps
from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.objects.lookup import object_in
from pinograsp.sweep import DataSet, certify_files, read_certified, written_back

pytest.importorskip("pyarrow")
CONDITIONS = pg.GraspConditions(mu=0.6)
DENSITY = 400.0


def rows_of(hand, poses, q, **more):
    given = {
        "source": "made",
        "format": "bodex",
        "first": 0,
        "object_name": "brick",
        "hand_name": "allegro",
        "joint_names": hand.joint_names,
        "scale": np.ones(len(poses)),
    }
    return GraspRows(poses=poses, q=q, **(given | more))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A folder of objects, grasps of one of them by an Allegro hand in two files, and what one call says of these."""
    folder = tmp_path_factory.mktemp("world")
    objects = folder / "objects"
    objects.mkdir()
    trimesh.creation.box((0.05, 0.05, 0.12)).export(objects / "brick.stl")
    brick, hand = object_in(objects, "brick", density=DENSITY), pg.load_hand("allegro_right")
    found = pg.find_grasps(hand, brick, CONDITIONS, count=8, seed=5, jobs=1)
    rng, q, roots = np.random.default_rng(0), [], []
    for i in range(30):
        closure = found.grasps[i % len(found.grasps)].closure
        q.append(np.clip(closure.q + 0.015 * rng.normal(size=hand.n), hand.lower, hand.upper))
        roots.append(brick.pose @ np.linalg.inv(closure.object.pose) @ closure.hand.pose)
    q, roots = np.array(q), np.array(roots)
    palm = np.linalg.inv(hand.pose) @ hand.frame_placements(hand.resting, ["palm_link"])[0]
    poses = roots @ palm
    files = folder / "files"
    files.mkdir()
    write_grasps(files / "a.npy", rows_of(hand, poses[:18], q[:18]))
    # DexGraspNet's files do not name their object: they are called after it.
    write_grasps(files / "brick.npy", rows_of(hand, poses[18:], q[18:], format="dexgraspnet", hand_name=""))
    return {
        "folder": folder,
        "hand": hand,
        "objects": objects,
        "files": [files / "a.npy", files / "brick.npy"],
        "expected": pg.certify(hand, brick, q, CONDITIONS, roots=roots),
    }


def data_of(world, files=None, **more):
    return DataSet(
        files=world["files"] if files is None else files,
        hand=world["hand"],
        objects=world["objects"],
        **({"density": DENSITY} | more),
    )


def test_rows_are_those_of_one_call(world, tmp_path):
    done = certify_files(data_of(world, joints=None), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    assert not done.faults, done.faults
    table, expected = done.table(), world["expected"]
    assert done.rows == table.num_rows == 30 and not done.interrupted
    assert table["row"].to_pylist() == [*range(18), *range(12)]
    assert table["code"].to_pylist() == expected.reason.tolist()
    assert table["reason"].to_pylist() == [Reason(code).name.lower() for code in expected.reason]
    assert expected.held.sum() >= 5 and done.counts["held"] == expected.held.sum()
    for i, forces in enumerate(table["forces_N"].to_pylist()):
        own = expected.forces_o[i, : expected.counts[i]]
        assert np.allclose(np.reshape(forces, (-1, 3)), own, atol=2e-3 * max(1.0, np.abs(own).max(initial=0)))
    assert np.allclose(table["least_mu"].to_numpy(), expected.least_mu, atol=0.02)
    summary = json.loads(json.dumps(done.summary(), allow_nan=False))
    assert summary["rows"] == 30 and summary["counts"]["held"] == done.counts["held"]


def test_objects_whose_grasps_are_all_misplaced_come_with_a_hint(world, tmp_path):
    """As if the file counted from somewhere 60 mm off; said in Python, on the screen, in JSON, and by the second run."""
    from typer.testing import CliRunner

    from pinograsp.cli import app

    rows = next(read_grasps(world["files"][0]))
    off = np.array(rows.poses)
    off[:, :3, 3] += [0.0, 0.0, 0.06]
    off[:, :3, 3] += [0.03, 0.03, 0.0]
    path = write_grasps(tmp_path / "off.npy", rows_of(world["hand"], off, rows.q, joint_names=rows.joint_names))
    for _ in range(2):
        done = certify_files(data_of(world, [path]), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
        assert list(done.hints) == ["brick"] and "'brick'" in done.hints["brick"] and "median" in done.hints["brick"]
    right = certify_files(data_of(world, [world["files"][0]]), tmp_path / "r", CONDITIONS, jobs=1, progress=False)
    assert right.hints == {} and right.summary()["hints"] == {}
    for json_ in ([], ["--json"]):
        given = [str(path), "--hand", "allegro_right", "--objects", str(world["objects"]), "--density", "400"]
        shown = CliRunner().invoke(
            app, ["certify", *given, "--out", str(tmp_path / f"c{len(json_)}"), "--jobs", "1", *json_]
        )
        assert "frames, units and the order of the joints" in " ".join(shown.output.split())


def test_a_pose_in_the_world_turns_gravity_and_nothing_else(world, tmp_path):
    """The same grasps with the object in a world: in its own frame all stays, but for the weight's direction."""
    rows = next(read_grasps(world["files"][0]))
    turned = pg.spatial.pose_of(
        [0.4, 0.1, 0.7], pg.spatial.rotation_rpy(0.0, 0.0, 2.1)
    )  # about gravity: the same weight
    path = write_grasps(
        tmp_path / "turned.npy",
        rows_of(world["hand"], rows.poses, rows.q, joint_names=rows.joint_names, object_pose=turned),
    )
    plain = certify_files(data_of(world, [world["files"][0]]), tmp_path / "p", CONDITIONS, jobs=1, progress=False)
    moved = certify_files(data_of(world, [path]), tmp_path / "m", CONDITIONS, jobs=1, progress=False)
    assert not moved.faults, moved.faults
    one, other = plain.table(), moved.table()
    assert one["code"].to_pylist() == other["code"].to_pylist()
    held = np.array(one["code"].to_pylist()) == 0
    for name in ("forces_N", "points_m"):
        for a, b in zip(np.array(one[name].to_pylist(), dtype=object)[held], other[name].filter(held).to_pylist()):
            assert np.allclose(a, b, atol=5e-3 * np.abs(a).max())


def test_faults_are_rows_and_what_was_read_before_them_is_kept(world, tmp_path):
    whole = world["files"][0].read_bytes()
    (tmp_path / "cut.npy").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npy").write_text("no grasps")
    rows = next(read_grasps(world["files"][0]))
    names = {"joint_names": rows.joint_names}
    elsewhere = write_grasps(
        tmp_path / "cup.npy", rows_of(world["hand"], rows.poses, rows.q, object_name="cup", **names)
    )
    q = np.array(rows.q)
    q[5, 0] = 5e3
    spoilt = np.load(world["files"][0], allow_pickle=True)[()]  # written by this test
    spoilt["robot_pose"][0, 5, :, 7:] = 5e3
    np.save(tmp_path / "spoilt.npy", np.array(spoilt, dtype=object), allow_pickle=True)
    files = [tmp_path / name for name in ("cut.npy", "text.npy")] + [elsewhere, tmp_path / "spoilt.npy"]
    files += [world["files"][1], tmp_path / "nowhere.npy"]
    done = certify_files(data_of(world, files), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    assert set(done.faults) == {str(path) for path in files if path != world["files"][1]}
    assert "cup" in done.faults[str(elsewhere)] and "no such file" in done.faults[str(files[-1])]
    table = done.table()
    good = [(file, row) for file, row in zip(table["file"].to_pylist(), table["row"].to_pylist()) if row >= 0]
    assert good.count((str(tmp_path / "spoilt.npy"), 4)) == 1 and done.rows == len(good) == 12 + 5
    # Again: nothing is left to do, and the faults are known.
    again = certify_files(data_of(world, files), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    assert again.faults == done.faults and again.counts == done.counts


def test_an_object_that_is_not_there_is_one_fault_of_a_file(world, tmp_path):
    """Not one of each block: here grasps of two sizes."""
    rows = next(read_grasps(world["files"][1]))
    several = rows_of(
        world["hand"],
        rows.poses,
        rows.q,
        format="dexgraspnet",
        joint_names=rows.joint_names,
        scale=np.repeat([1.0, 1.2], rows.n // 2),
    )
    path = write_grasps(tmp_path / "cup.npy", several)
    done = certify_files(data_of(world, [path]), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    assert list(done.faults) == [str(path)] and done.counts == {"refused": 1} and done.table().num_rows == 1


def test_another_certification_is_not_mixed_in(world, tmp_path):
    certify_files(data_of(world), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    with pytest.raises(ResultsNotWritten, match="holds another certification"):
        certify_files(data_of(world), tmp_path / "out", pg.GraspConditions(mu=0.5), jobs=1, progress=False)
    with pytest.raises(InvalidInput, match="holds no sweep"):
        pg.sweep.read_sweep(tmp_path / "out")
    with pytest.raises(InvalidInput, match="expected mass"):
        data_of(world, density=None)
    with pytest.raises(InvalidInput, match="expected mass"):
        data_of(world, mass=0.1)


def test_newtons_come_back_in_the_files_own_formats(world, tmp_path):
    certify_files(data_of(world), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    paths, refused = written_back(data_of(world), tmp_path / "out", tmp_path / "back")
    assert not refused and [path.name for path in paths] == ["a.npy", "brick.npy"]
    for before, after in zip(world["files"], paths):
        old, new = next(read_grasps(before)), next(read_grasps(after))
        assert np.allclose(old.poses, new.poses) and np.allclose(old.q, new.q)
        assert "contact_force" in new.extras and "held" in new.labels
        table = read_certified(tmp_path / "out")
        own = [
            np.reshape(forces, (-1, 3)).sum(axis=0)
            for file, forces, code in zip(*(table[name].to_pylist() for name in ("file", "forces_N", "code")))
            if file == str(before) and code == 0
        ]
        held = np.asarray(new.labels["held"]).astype(bool)
        forces = np.asarray(new.extras["contact_force"], dtype=float)
        forces = forces.reshape(len(held), -1, 3)[held].sum(axis=1)
        assert np.allclose(forces, own, atol=1e-4)
        weight = 0.05 * 0.05 * 0.12 * DENSITY * 9.81
        assert np.allclose(forces, [0, 0, weight], atol=1e-4)


def test_jaws_of_files_without_openings_close(tmp_path):
    pytest.importorskip("h5py")
    hand, objects = pg.load_hand("panda"), tmp_path / "objects"
    objects.mkdir()
    trimesh.creation.box((0.03, 0.03, 0.03)).export(objects / "cube.obj")
    down = pg.spatial.rotation_rpy(np.pi, 0, 0)
    poses = np.array([pg.spatial.pose_of([x, 0, 0.1034], down) for x in (0.0, 0.005, 0.2)])
    rows = rows_of(
        hand, poses, np.zeros((3, 0)), joint_names=(), format="acronym", object_name="cube.obj", hand_name="panda"
    )
    path = write_grasps(tmp_path / "cube.h5", rows, labels={"object_in_gripper": np.array([1, 1, 0])})
    data = DataSet(files=[path], hand=hand, objects=objects, mass=0.1)
    done = certify_files(data, tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    assert not done.faults, done.faults
    table = done.table()
    assert table["reason"].to_pylist()[:2] == ["held", "held"]
    # Jaws that meet nothing close until they meet each other.
    assert table["reason"].to_pylist()[2] in ("no_contact", "self_collision")
    assert json.loads(table["labels"].to_pylist()[2])


SCRIPT = """
import sys
from pinograsp.sweep import certified
certified._SAVED_EVERY, certified._BLOCK = 0.0, 2
from pinograsp.cli import main
main()
"""


def arguments(world, out, *more):
    paths = [str(path) for path in world["files"]]
    return [
        *("certify", *paths, "--hand", "allegro_right", "--out", str(out)),
        *("--objects", str(world["objects"]), "--density", str(DENSITY), "--jobs", "1", *more),
    ]


def started(world, out, *more):
    """The command line of a process of its own, which saves often."""
    return [sys.executable, "-c", SCRIPT, *arguments(world, out, *more)]


@pytest.mark.slow
def test_kill_minus_nine_loses_and_doubles_nothing(world, tmp_path):
    out, kills = tmp_path / "out", 0
    for _ in range(12):
        process = subprocess.Popen(started(world, out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        begun, before = time.monotonic(), len(list(out.glob("part-*")))
        while process.poll() is None and time.monotonic() - begun < 60:
            if len(list(out.glob("part-*"))) > before + 2:
                os.kill(process.pid, signal.SIGKILL)
                kills += 1
                break
            time.sleep(0.002)
        process.wait(timeout=60)
        if process.returncode == 0:
            break
        table = read_certified(out)
        rows = list(zip(table["file"].to_pylist(), table["row"].to_pylist()))
        assert len(set(rows)) == len(rows)
    assert process.returncode == 0 and kills
    table = read_certified(out)
    assert table["code"].to_pylist() == world["expected"].reason.tolist()


@pytest.mark.slow
def test_the_command_prints_counts_draws_and_speaks_json(world, command, tmp_path):
    out, picture = tmp_path / "out", tmp_path / "seen.png"
    more = ("--picture", str(picture), "--back", str(tmp_path / "back"))
    done = subprocess.run(started(world, out, *more), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    told = " ".join(done.stdout.split())
    assert "held" in told and "of 30 grasps" in told and "With newtons 2 files in" in told
    assert picture.read_bytes()[:4] == b"\x89PNG" and len(list((tmp_path / "back").glob("*.npy"))) == 2
    # Once more, in this process: nothing is left to do.
    code, told, _ = command(*arguments(world, out, "--json"))
    assert code == 0 and json.loads(told)["rows"] == 30


@pytest.mark.slow
def test_a_cluster_does_the_same(world, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        address = cluster.scheduler_address
        done = certify_files(
            data_of(world), tmp_path / "out", CONDITIONS, backend="dask", scheduler=address, progress=False
        )
    assert not done.faults and done.table()["code"].to_pylist() == world["expected"].reason.tolist()
