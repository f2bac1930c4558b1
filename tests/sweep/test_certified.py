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
from pinograsp.data import GraspRows, read_grasps, write_grasps
from pinograsp.errors import InvalidInput, ResultsNotWritten, Status
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


@pytest.mark.slow
def test_rows_are_those_of_one_call(world, tmp_path):
    done = certify_files(data_of(world, joints=None), tmp_path / "out", CONDITIONS, jobs=1, progress=False)
    assert not done.faults, done.faults
    table, expected = done.table(), world["expected"]
    assert done.rows == table.num_rows == 30 and not done.interrupted
    assert table["row"].to_pylist() == [*range(18), *range(12)]
    assert table["code"].to_pylist() == expected.reason.tolist()
    assert table["reason"].to_pylist() == [str(Status.from_code(code)) for code in expected.reason]
    assert expected.held.sum() >= 5 and done.counts["held"] == expected.held.sum()
    for i, forces in enumerate(table["forces_N"].to_pylist()):
        own = expected.forces_o[i, : expected.counts[i]]
        assert np.allclose(np.reshape(forces, (-1, 3)), own, atol=2e-3 * max(1.0, np.abs(own).max(initial=0)))
    assert np.allclose(table["least_mu"].to_numpy(), expected.least_mu, atol=0.02)
    summary = json.loads(json.dumps(done.summary(), allow_nan=False))
    assert summary["rows"] == 30 and summary["counts"]["held"] == done.counts["held"]


@pytest.mark.slow
def test_what_files_command_is_a_second_verdict(world, tmp_path):
    """The postures of a file and those that it commands, with another benchmark's loads."""
    found, hand = world["expected"], world["hand"]
    rows = next(read_grasps(world["files"][0]))
    kept = np.flatnonzero(found.held[: rows.n])
    gains = pg.hands.servo_gains(hand)
    harder = np.array(rows.q[kept]) + 3 * found.torques[kept] / gains + 0.05 * np.sign(found.torques[kept])
    given = {"joint_names": rows.joint_names, "squeeze_q": harder, "squeeze_poses": rows.poses[kept]}
    given |= {"pregrasp_q": rows.q[kept], "pregrasp_poses": rows.poses[kept]}
    path = write_grasps(tmp_path / "told.npy", rows_of(hand, rows.poses[kept], rows.q[kept], **given))
    asked = {"jobs": 1, "progress": False, "protocol": "dexgraspbench"}
    done = certify_files(data_of(world, [path], density=None, mass=0.1), tmp_path / "out", CONDITIONS, **asked)
    table = done.table()
    held = table["held_as_commanded"].to_numpy(zero_copy_only=False)
    assert done.verdicts["commanded"] == len(kept) and done.verdicts["held_as_commanded"] == held.sum() > 0.7 * len(
        kept
    )
    assert done.verdicts["possible"] == table["possible"].to_numpy(zero_copy_only=False).sum() >= held.sum()
    assert all("as commanded" in message for message in table["message"].to_pylist())
    untold = certify_files(data_of(world, world["files"][1:]), tmp_path / "untold", CONDITIONS, jobs=1, progress=False)
    assert untold.verdicts["commanded"] == 0 and untold.table()["moved_m"].null_count == 12


@pytest.mark.slow
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
from pinograsp.sweep import certified_store, runner
runner._SAVED_EVERY, certified_store._BLOCK = 0.0, 2
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
    assert "held" in told and "of 30 grasps" in told and "With forces 2 files in" in told
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
            data_of(world), tmp_path / "out", CONDITIONS, executor="dask", scheduler=address, progress=False
        )
    assert not done.faults and done.table()["code"].to_pylist() == world["expected"].reason.tolist()


def panda_files(folder, names=("a", "c"), shift=0.0, count=3):
    """Grasps of a box by a Panda hand, in files as GraspGen writes them, and the box's mesh."""
    (folder / "grasps").mkdir(exist_ok=True)
    (folder / "meshes").mkdir(exist_ok=True)
    if not (folder / "meshes" / "box.obj").exists():
        trimesh.creation.box((0.03, 0.04, 0.08)).export(folder / "meshes" / "box.obj")
    pose = pg.spatial.pose_of([shift, 0, 0.13], np.diag([1.0, -1.0, -1.0]))
    about = {"file": "box.obj", "scale": 1.0}
    grasps = {"transforms": [pose.tolist()] * count, "object_in_gripper": [True] * count}
    for name in names:
        (folder / "grasps" / f"{name}.json").write_text(json.dumps({"object": about, "grasps": grasps}))
    return [folder / "grasps" / f"{name}.json" for name in names]


def certified_by_panda(folder, files, out="out", **more):
    given = {"hand": pg.load_hand("panda"), "objects": folder / "meshes", "mass": 0.1, "convention": "panda_graspgen"}
    return certify_files(DataSet(files=files, **(given | more)), folder / out, CONDITIONS, jobs=1, progress=False)


def test_rows_of_changed_grasps_are_computed_again_and_those_of_others_kept(tmp_path):
    files = panda_files(tmp_path)
    first = certified_by_panda(tmp_path, files)
    assert first.counts == {"held": 6} and not first.changed
    # The same content: no change.
    files[0].write_bytes(files[0].read_bytes())
    (tmp_path / "copy").write_bytes((tmp_path / "meshes" / "box.obj").read_bytes())
    (tmp_path / "copy").replace(tmp_path / "meshes" / "box.obj")
    assert certified_by_panda(tmp_path, files).changed == ()
    panda_files(tmp_path, names=["a"], shift=0.2, count=2)
    again = certified_by_panda(tmp_path, files)
    assert again.changed == (str(files[0]),)
    fresh = certified_by_panda(tmp_path, files, "fresh")
    assert again.counts == fresh.counts and again.counts["held"] == 3 and again.rows == 5
    assert again.table().equals(fresh.table())


@pytest.mark.parametrize("kind", ["mesh", "decomposition", "urdf"])
def test_rows_of_a_changed_object_are_computed_again(tmp_path, kind):
    """Also in one process, which keeps objects; of a box too wide for the jaws no grasp holds."""
    files = panda_files(tmp_path, names=["a"], count=2)
    meshes = tmp_path / "meshes"
    path = meshes / "box.obj"
    if kind == "decomposition":
        path.unlink()
        path = meshes / "box" / "coacd" / "decomposed.obj"
        path.parent.mkdir(parents=True)
    elif kind == "urdf":
        path.rename(path := meshes / "part.obj")
        text = '<robot name="b"><link name="b"><collision><geometry><mesh filename="part.obj"/></geometry></collision>'
        (meshes / "box.urdf").write_text(f"{text}</link></robot>")
        files[0].write_text(files[0].read_text().replace("box.obj", "box.urdf"))
    trimesh.creation.box((0.03, 0.04, 0.08)).export(path)
    assert certified_by_panda(tmp_path, files).counts == {"held": 2}
    trimesh.creation.box((0.15, 0.04, 0.08)).export(path)
    again = certified_by_panda(tmp_path, files)
    assert again.changed == (str(files[0]),) and "held" not in again.counts and again.rows == 2


def test_a_fault_is_tried_again_once_its_file_or_its_object_is_there(tmp_path):
    files = panda_files(tmp_path)
    whole = files[0].read_bytes()
    files[0].write_bytes(whole[:40])
    (tmp_path / "meshes" / "box.obj").rename(tmp_path / "box.obj")
    assert set(certified_by_panda(tmp_path, files).faults) == {str(file) for file in files}
    (tmp_path / "box.obj").rename(tmp_path / "meshes" / "box.obj")
    done = certified_by_panda(tmp_path, files)
    assert done.counts["held"] == 3 and list(done.faults) == [str(files[0])]
    files[0].write_bytes(whole)
    done = certified_by_panda(tmp_path, files)
    assert done.counts == {"held": 6} and not done.faults


@pytest.mark.parametrize("change", ["hand", "mass", "conditions", "version"])
def test_what_all_rows_rest_on_makes_another_certification_which_is_named(tmp_path, change):
    files = panda_files(tmp_path, names=["a"])
    certified_by_panda(tmp_path, files)
    hand = pg.load_hand("panda")
    if change == "version":
        path = tmp_path / "out" / "_manifest.json"
        path.write_text(path.read_text().replace('"pinograsp": "', '"pinograsp": "0.0.1+'))
        change = "0.0.1"
    if change == "hand":
        joint = hand.joint_names[0]
        hand = hand.with_limits({joint: (0.0, 0.9 * float(hand.upper[0]))})
    with pytest.raises(ResultsNotWritten, match=f"holds another certification.*{change}"):
        data = DataSet(
            files=files,
            hand=hand,
            objects=tmp_path / "meshes",
            mass=0.2 if change == "mass" else 0.1,
            convention="panda_graspgen",
        )
        mu = 0.5 if change == "conditions" else 0.6
        certify_files(data, tmp_path / "out", pg.GraspConditions(mu=mu), jobs=1, progress=False)


def test_newtons_are_not_written_into_grasps_that_have_changed(tmp_path):
    files = panda_files(tmp_path)
    certified_by_panda(tmp_path, files)
    panda_files(tmp_path, names=["c"], shift=0.01)
    data = DataSet(
        files=files, hand=pg.load_hand("panda"), objects=tmp_path / "meshes", mass=0.1, convention="panda_graspgen"
    )
    paths, refused = written_back(data, tmp_path / "out", tmp_path / "back")
    assert [path.name for path in paths] == ["a.json"] and "changed" in refused[str(files[1])]


def test_what_is_no_file_is_one_fault_each_and_the_others_are_certified(tmp_path, command):
    files = panda_files(tmp_path)
    grasps = tmp_path / "grasps"
    os.mkfifo(grasps / "b.json")
    (grasps / "d.json").symlink_to(grasps / "d.json")
    (grasps / "e.json").symlink_to(tmp_path / "nowhere")
    empty = np.array({"robot_pose": np.zeros((1, 5, 3, 0)), "joint_names": [], "world_cfg": [], "manip_name": "a"})
    np.save(grasps / "f.npy", empty, allow_pickle=True)
    arguments = ["certify", str(grasps), "--hand", "panda", "--objects", str(tmp_path / "meshes"), "--mass", "0.1"]
    arguments += ["--convention", "panda_graspgen", "--out", str(tmp_path / "out"), "--jobs", "1", "--json"]
    for _ in range(2):
        code, out, err = command(*arguments)
        told = json.loads(out)
        assert code == 2 and told["status"] == "invalid_input" and told["remedy"] and err == ""
        assert told["counts"] == {"held": 6, "refused": 4}
        assert {os.path.basename(file)[0] for file in told["faults"]} == set("bdef")
    assert "pipe" in told["faults"][str(grasps / "b.json")] and files


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("no more")])
def test_any_error_in_a_file_is_a_fault_of_it_alone(tmp_path, monkeypatch, error):
    from pinograsp.sweep import certified_store

    files = panda_files(tmp_path)

    def read(path, **more):
        if path == files[0]:
            raise error
        return read_grasps(path, **more)

    monkeypatch.setattr(certified_store, "read_grasps", read)
    done = certified_by_panda(tmp_path, files)
    assert list(done.faults) == [str(files[0])] and done.counts["held"] == 3


def test_a_block_that_cannot_be_certified_keeps_no_other_away(tmp_path, monkeypatch):
    """Whichever comes first: the process may be killed in between. Its file is not written with newtons."""
    from pinograsp.sweep import certified, certified_store, find_missing_grasps

    files, place = panda_files(tmp_path, names=["a"], count=9), certified.place_block

    def refuse_one(grasps, rows, hand, **meant):
        if rows[0] == 4:
            raise InvalidInput("no such grasp")
        return place(grasps, rows, hand, **meant)

    monkeypatch.setattr(certified_store, "_BLOCK", 1)
    monkeypatch.setattr(certified, "place_block", refuse_one)
    data = DataSet(
        files=files, hand=pg.load_hand("panda"), objects=tmp_path / "meshes", mass=0.1, convention="panda_graspgen"
    )
    shards = [find_missing_grasps(data, tmp_path / "out", CONDITIONS, shard=(i, 3)).rows for i in (1, 2, 3)]
    assert sum(shards) == 9 and min(shards) > 0
    for i in (2, 1, 3):
        certify_files(data, tmp_path / "out", CONDITIONS, jobs=1, progress=False, shard=(i, 3))
    done = certified_by_panda(tmp_path, files)
    assert done.counts == {"held": 8, "refused": 1} and done.faults == {str(files[0]): "no such grasp"}
    assert done.table()["row"].to_pylist() == [-1, 0, 1, 2, 3, 5, 6, 7, 8]
    assert find_missing_grasps(data, tmp_path / "out", CONDITIONS).rows == 0
    paths, refused = written_back(data, tmp_path / "out", tmp_path / "back")
    assert paths == [] and "8 of its 9 grasps" in refused[str(files[0])]


@pytest.mark.parametrize("name", ["part-000001-000001.parquet", "_manifest.json"])
def test_a_pipe_in_the_folder_of_rows_is_told(tmp_path, name):
    files = panda_files(tmp_path, names=["a"])
    certified_by_panda(tmp_path, files)
    (tmp_path / "out" / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / "out" / name)
    with pytest.raises(InvalidInput, match="expected a file"):
        certified_by_panda(tmp_path, files)
    with pytest.raises(InvalidInput, match="expected a file"):
        read_certified(tmp_path / "out")


def test_grasps_that_name_no_object_are_of_one_of_their_own_name_or_of_the_one_that_is_given(tmp_path):
    files = panda_files(tmp_path, names=["box", "other"])
    for file in files:
        file.write_text(file.read_text().replace('"file": "box.obj", ', ""))
    done = certified_by_panda(tmp_path, files)
    assert done.counts["held"] == 3 and "give its file instead of the folder" in done.faults[str(files[1])]
    done = certified_by_panda(tmp_path, files, "one", objects=tmp_path / "meshes" / "box.obj")
    assert done.counts == {"held": 6} and not done.faults


@pytest.mark.parametrize("files", [5, None, "a.json", [], [3], {}])
def test_files_of_another_kind_are_refused(world, files):
    with pytest.raises(InvalidInput, match="files"):
        data_of(world, files=files) if files is not None else DataSet(
            files=files, hand=world["hand"], objects=world["objects"], mass=1.0
        )
