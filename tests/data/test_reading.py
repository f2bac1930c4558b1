"""Every format: what a file means is what comes out, and what is written is read back equal."""

from __future__ import annotations

import dataclasses
import json
import math

import grasp_files
import numpy as np
import pytest
import yaml

import pinograsp as pg
from pinograsp.data import FORMATS, join_rows, read_grasps, write_grasps
from pinograsp.errors import ExtraMissing, GraspsNotRead, InvalidInput

JOINTS = [f"joint_{i}.0" for i in range(16)]


def file_of(kind, tmp_path, g):
    path = tmp_path / f"{kind}_0_0622"
    if kind == "dexgraspnet":
        return grasp_files.npy(path.with_suffix(".npy"), grasp_files.dexgraspnet_rows(g))
    if kind in ("bodex", "dexgraspbench", "dexonomy", "get_a_grip"):
        made = getattr(grasp_files, kind)
        return grasp_files.npy(path.with_suffix(".npy"), made(g, JOINTS) if kind == "bodex" else made(g))
    if kind == "graspqp":
        path = tmp_path / "mug.dexgrasp.pt"
        path.write_bytes(grasp_files.torch_bytes(grasp_files.graspqp(g, JOINTS)))
        return path
    if kind == "graspnet":
        path = tmp_path / "003_labels.npz"
        grasp_files.graspnet(path)
        return path
    return getattr(grasp_files, kind)(
        path.with_suffix({"acronym": ".h5", "graspgen": ".json", "isaac": ".yaml"}[kind]), g
    )


def grasps(kind):
    one = kind in ("dexgraspbench", "dexonomy")
    return grasp_files.some_grasps(n=1 if one else 5, d=22 if kind == "dexgraspnet" else 16)


def arrays_of(rows):
    for field in dataclasses.fields(rows):
        value = getattr(rows, field.name)
        if isinstance(value, np.ndarray):
            yield field.name, value
        elif isinstance(value, dict):
            yield from ((f"{field.name}/{name}", array) for name, array in value.items())


def assert_equal(a, b, but=()):
    left, right = dict(arrays_of(a)), dict(arrays_of(b))
    assert left.keys() - set(but) == right.keys() - set(but)
    for name in left.keys() - set(but):
        np.testing.assert_allclose(left[name], right[name], atol=1e-12, rtol=0, err_msg=name)
    for name in ("object_name", "hand_name", "joint_names"):
        assert getattr(a, name) == getattr(b, name), name


@pytest.mark.parametrize("kind", FORMATS)
def test_poses_and_joints_are_what_the_file_means(kind, tmp_path):
    g = grasps(kind)
    rows = join_rows(read_grasps(file_of(kind, tmp_path, g)))
    assert rows.format == kind and rows.first == 0
    if kind == "graspnet":
        return  # below
    tolerance = 2e-7 if kind == "get_a_grip" else 1e-12  # its file has 32 bits
    np.testing.assert_allclose(rows.poses, g.poses, atol=tolerance)
    if kind == "isaac":
        np.testing.assert_array_equal(rows.q[:, 0], 0.01 * np.arange(5))
        np.testing.assert_array_equal(rows.pregrasp_q, np.full((5, 1), 0.04))
    elif kind in ("acronym", "graspgen"):
        assert rows.q.shape == (5, 0)
    else:
        np.testing.assert_array_equal(rows.q, g.q)
    if kind in ("bodex", "dexgraspbench", "dexonomy"):
        np.testing.assert_allclose(rows.object_pose, g.object_pose, atol=1e-12)
        np.testing.assert_allclose(rows.world_poses, g.object_pose @ g.poses, atol=1e-12)
        np.testing.assert_array_equal(rows.pregrasp_q, g.before)
        np.testing.assert_array_equal(rows.squeeze_q, g.after)
        np.testing.assert_allclose(rows.squeeze_poses, g.poses, atol=1e-12)
    scale = {"dexgraspnet": g.scale, "bodex": 0.08, "acronym": 0.02, "graspgen": 0.5, "get_a_grip": 0.0622}
    default = 1.0 if kind in ("graspqp", "isaac") else 0.1
    np.testing.assert_allclose(rows.scale, np.broadcast_to(scale.get(kind, default), rows.n))


def test_the_files_own_names_and_numbers_are_kept(tmp_path):
    def read(kind):
        return join_rows(read_grasps(file_of(kind, tmp_path, grasps(kind))))

    net = read("dexgraspnet")
    assert net.joint_names == tuple(grasp_files.SHADOW) and net.object_name == "dexgraspnet_0_0622"
    np.testing.assert_array_equal(net.labels["energy"], np.arange(5))
    bodex = read("bodex")
    assert bodex.joint_names == tuple(JOINTS) and bodex.object_name == "mug/mesh.obj"
    assert bodex.extras["contact_force"].shape == (5, 1, 4, 3) and bodex.labels["grasp_error"].tolist() == [
        0,
        1,
        2,
        3,
        4,
    ]
    dexonomy = read("dexonomy")
    assert (dexonomy.hand_name, dexonomy.object_name) == ("allegro", "scenes/mug.npy")
    assert dexonomy.extras["pregrasp_qpos"].shape == (1, 2, 23) and dexonomy.extras["ho_c/wrench"].shape == (1, 2, 6)
    grip = read("get_a_grip")
    assert grip.object_name == "get_a_grip" and grip.extras["grasp_orientations"].shape == (5, 4, 3, 3)
    np.testing.assert_array_equal(grip.object_pose[:3, :3] @ [0, 1, 0], [0, 0, 1])  # y is up
    qp = read("graspqp")
    assert qp.object_name == "mug" and qp.extras["grasp_velocities"].shape == (5, 16)
    acronym = read("acronym")
    assert acronym.hand_name == "panda" and acronym.object_facts["mass"] == 0.3
    assert acronym.labels["object_in_gripper"].tolist() == [0, 1, 0, 1, 0]
    isaac = read("isaac")
    assert isaac.hand_name == "/World/panda_hand" and isaac.labels["confidence"].tolist() == [0.9] * 5


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind != "graspnet"])
def test_what_is_written_is_read_back_equal(kind, tmp_path):
    g = grasps(kind)
    rows = join_rows(read_grasps(file_of(kind, tmp_path, g)))
    first = write_grasps(tmp_path / "again_0_5000", rows)
    back = join_rows(read_grasps(first))
    assert back.format == kind
    if kind in ("dexgraspnet", "graspqp"):  # the object is called after the file
        back = dataclasses.replace(back, object_name=rows.object_name)
    assert_equal(rows, back)
    # With newtons; forces of a format of its own stay where they are in the second file.
    n = rows.n
    forces, points = np.linspace(-1, 1, 12 * n).reshape(n, 4, 3), np.linspace(0, 0.1, 12 * n).reshape(n, 4, 3)
    second = write_grasps(tmp_path / "newtons_0_5000", rows, forces=forces, points=points, labels={"holds": [True] * n})
    loaded = join_rows(read_grasps(second))
    np.testing.assert_allclose(loaded.extras["contact_force"].reshape(forces.shape), forces, atol=1e-15)
    np.testing.assert_allclose(loaded.extras["contact_point"], points, atol=1e-15)
    assert loaded.labels["holds"].all()
    if kind in ("dexgraspnet", "graspqp"):
        loaded = dataclasses.replace(loaded, object_name=rows.object_name)
    assert_equal(rows, loaded, but=("extras/contact_force", "extras/contact_point", "labels/holds"))


def test_forces_say_their_unit_in_the_formats_own_way(tmp_path):
    g = grasp_files.some_grasps()
    rows = join_rows(read_grasps(file_of("bodex", tmp_path, g)))
    path = write_grasps(tmp_path / "out.npy", rows, forces=g.forces)
    stored = np.load(path, allow_pickle=True).item()
    assert stored["force_unit"] == "N" and stored["force_frame"] == "object"
    assert stored["contact_force"].shape == (1, 5, 1, 4, 3) and stored["robot_pose"].shape == (1, 5, 3, 23)
    net = join_rows(read_grasps(file_of("dexgraspnet", tmp_path, grasp_files.some_grasps(d=22))))
    row = np.load(write_grasps(tmp_path / "net.npy", net, forces=g.forces), allow_pickle=True)[3]
    assert row["force_unit"] == "N"
    np.testing.assert_array_equal(row["contact_force"], g.forces[3])
    import h5py

    jaws = join_rows(read_grasps(file_of("acronym", tmp_path, g)))
    with h5py.File(write_grasps(tmp_path / "out.h5", jaws, forces=g.forces)) as h5:
        assert h5["grasps/contact_force"].attrs["force_unit"] == "N"


def test_other_formats_can_be_written(tmp_path):
    g = grasp_files.some_grasps()
    rows = join_rows(read_grasps(file_of("bodex", tmp_path, g)))
    for kind in ("graspgen", "acronym", "get_a_grip", "dexgraspnet"):
        back = join_rows(read_grasps(write_grasps(tmp_path / "other_0_0800.x", rows, format=kind)))
        assert back.format == kind
        np.testing.assert_allclose(back.poses, g.poses, atol=1e-12)


@pytest.mark.parametrize("kind", ["dexgraspnet", "bodex", "acronym", "graspgen", "graspnet", "isaac"])
def test_blocks_are_the_same_rows(kind, tmp_path):
    path = file_of(kind, tmp_path, grasp_files.some_grasps(n=7, d=22 if kind == "dexgraspnet" else 16))
    whole = join_rows(read_grasps(path))
    blocks = list(read_grasps(path, block=3))
    assert all(one.n <= 3 for one in blocks)
    assert [one.first for one in blocks] == list(np.cumsum([0, *(one.n for one in blocks)])[:-1])
    assert_equal(whole, join_rows(blocks))
    some = list(read_grasps(path, block=3, most=5))
    assert sum(one.n for one in some) == 5
    np.testing.assert_array_equal(join_rows(some).poses, whole.poses[:5])
    assert not list(read_grasps(path, most=0))


def test_some_rows_and_other_postures(tmp_path):
    g = grasp_files.some_grasps()
    rows = next(read_grasps(file_of("bodex", tmp_path, g)))
    for which in ([1, 3], [False, True, False, True, False]):
        some = rows.only(which)
        assert some.n == 2 and some.first == 1 and some.labels["grasp_error"].tolist() == [1, 3]
        np.testing.assert_array_equal(some.squeeze_q, g.after[[1, 3]])
    assert rows.only([]).n == 0
    for which in ([5], [-1], [True], [0.5], [[0]]):
        with pytest.raises(InvalidInput, match="which"):
            rows.only(which)
    np.testing.assert_array_equal(rows.at("squeeze").q, g.after)
    np.testing.assert_array_equal(rows.at("pregrasp").q, g.before)
    assert rows.at("grasp") is rows
    jaws = next(read_grasps(file_of("acronym", tmp_path, g)))
    with pytest.raises(InvalidInput, match="no squeeze posture"):
        jaws.at("squeeze")


def test_the_formats_own_keys_are_not_overwritten(tmp_path):
    g = grasp_files.some_grasps(n=1)
    rows = next(read_grasps(file_of("dexonomy", tmp_path, g)))  # several pregrasps, under DexGraspBench's key for one
    back = next(read_grasps(write_grasps(tmp_path / "out.npy", rows, format="dexgraspbench")))
    np.testing.assert_array_equal(back.pregrasp_q, g.before)
    for name in ("transforms", "qpos", "a/b", "", "contact_force"):
        with pytest.raises(InvalidInput, match="that no format uses"):
            write_grasps(tmp_path / "out.npy", rows, labels={name: [1.0]})


def test_records_do_not_change(tmp_path):
    rows = next(read_grasps(file_of("bodex", tmp_path, grasp_files.some_grasps())))
    for name, array in arrays_of(rows):
        assert not array.flags.writeable, name
    with pytest.raises(dataclasses.FrozenInstanceError):
        rows.first = 3


# -- GraspNet's grid


def gripper(view, angle):
    """graspnetAPI's gripper, one at a time: rotation (3, 3) from a unit vector and an angle."""
    x = [-one for one in view]
    length = math.hypot(x[0], x[1])
    y = [-x[1] / length, x[0] / length, 0.0]
    z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    turn = np.array([[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]])
    return np.array([x, y, z]).T @ turn


def test_graspnets_grid_becomes_grippers(tmp_path):
    arrays = grasp_files.graspnet(tmp_path / "003_labels.npz")
    rows = join_rows(read_grasps(tmp_path / "003_labels.npz"))
    valid = (arrays["scores"] > 0) & ~arrays["collision"]
    assert rows.n == valid.sum() > 100 and rows.object_name == "003"
    np.testing.assert_allclose(rows.labels["least_friction"], arrays["scores"][valid])
    np.testing.assert_allclose(rows.widths, arrays["offsets"][valid][:, 2])
    for i in range(0, rows.n, 17):
        point, view = rows.labels["point"][i], rows.labels["view"][i]
        angle, depth, _ = arrays["offsets"][point, view, rows.labels["angle_index"][i], rows.labels["depth_index"][i]]
        z = (2 * view + 1) / 300 - 1
        around = 2 * view * math.pi * (math.sqrt(5) - 1) / 2
        ring = math.sqrt(1 - z**2)
        direction = [ring * math.cos(around), ring * math.sin(around), z]
        # The labels' views were made in 32 bits: at 1100 rad these tell 1e-4 rad.
        np.testing.assert_allclose(rows.poses[i, :3, :3], gripper(direction, float(angle)), atol=3e-4)
        np.testing.assert_allclose(rows.poses[i, :3, 3], arrays["points"][point], atol=1e-7)
        assert rows.labels["depth"][i] == depth
    everything = sum(one.n for one in read_grasps(tmp_path / "003_labels.npz", keep="all"))
    assert everything == 2 * 300 * 12 * 4


def test_a_grid_is_not_written(tmp_path):
    grasp_files.graspnet(tmp_path / "003_labels.npz")
    rows = join_rows(read_grasps(tmp_path / "003_labels.npz", most=3))
    with pytest.raises(InvalidInput, match="grid"):
        write_grasps(tmp_path / "out.npz", rows)
    back = join_rows(read_grasps(write_grasps(tmp_path / "out.json", rows, format="graspgen")))
    np.testing.assert_allclose(back.poses, rows.poses, atol=1e-12)


# -- arguments


def test_writing_refuses_what_a_format_cannot_hold(tmp_path):
    net = join_rows(read_grasps(file_of("dexgraspnet", tmp_path, grasp_files.some_grasps(d=22))))
    cases = {
        "several": dict(format="graspgen"),
        "one grasp a file": dict(format="dexgraspbench"),
        "expected one of": dict(format="dexgraspnett"),
        "forces: expected": dict(forces=np.zeros((2, 1, 3))),
        "expected forces": dict(points=np.zeros((5, 1, 3))),
        "finite numbers": dict(labels={"holds": [math.nan] * 5}),
    }
    for message, arguments in cases.items():
        with pytest.raises(InvalidInput, match=message):
            write_grasps(tmp_path / "out", net, **arguments)
    bench = join_rows(read_grasps(file_of("dexgraspbench", tmp_path, grasp_files.some_grasps(n=1))))
    with pytest.raises(InvalidInput, match="names the joints"):
        write_grasps(tmp_path / "out", bench, format="bodex")
    with pytest.raises(InvalidInput, match="of one file"):
        join_rows([net, bench])
    named = dataclasses.replace(bench, joint_names=tuple(f"j{i}" for i in range(bench.q.shape[1])))
    with pytest.raises(InvalidInput, match="no scale"):
        write_grasps(tmp_path / "out", named, format="graspqp")
    assert not (tmp_path / "out").exists()


def test_reading_refuses_wrong_arguments_at_once(tmp_path):
    for arguments in ({"block": 0}, {"most": -1}, {"format": "graspnett"}, {"keep": "some"}):
        with pytest.raises(InvalidInput, match=next(iter(arguments))):
            read_grasps(tmp_path / "any", **arguments)


def test_the_extra_is_named_where_it_is_missing(tmp_path, monkeypatch):
    path = file_of("acronym", tmp_path, grasp_files.some_grasps())
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(ExtraMissing, match=r"pinograsp\[data\]"):
        next(read_grasps(path))


def test_pytorch_reads_what_is_written_and_the_other_way_round(tmp_path):
    torch = pytest.importorskip("torch")
    g = grasp_files.some_grasps()
    rows = join_rows(read_grasps(file_of("graspqp", tmp_path, g)))
    path = write_grasps(tmp_path / "out.dexgrasp.pt", rows, forces=g.forces)
    stored = torch.load(path, weights_only=True)
    np.testing.assert_array_equal(stored["parameters"]["joint_3.0"].numpy(), g.q[:, 3])
    np.testing.assert_array_equal(stored["contact_force"].numpy(), g.forces)
    tensors = grasp_files.graspqp(g, JOINTS)
    tensors["parameters"] = {name: torch.from_numpy(one).half() for name, one in tensors["parameters"].items()}
    torch.save(tensors, tmp_path / "half.dexgrasp.pt")
    half = join_rows(read_grasps(tmp_path / "half.dexgrasp.pt"))
    np.testing.assert_allclose(half.q, g.q, atol=1e-3)


def test_a_folder_an_empty_file_and_no_file_are_told(tmp_path):
    (tmp_path / "empty.npy").write_bytes(b"")
    for path, message in (
        (tmp_path, "folder"),
        (tmp_path / "empty.npy", "empty"),
        (tmp_path / "no.npy", "no such file"),
    ):
        with pytest.raises(GraspsNotRead, match=message) as caught:
            next(read_grasps(path))
        assert isinstance(caught.value, pg.PinograspError) and caught.value.source == str(path)


@pytest.mark.parametrize(
    ("more", "object_name", "hand_name", "scale"),
    [
        ({"object_frame": "/World/mug", "gripper_frame": "/World/hand"}, "/World/mug", "/World/hand", 1.0),
        ({"object_frame_link": "/World/mug", "gripper_frame_link": "/W/h"}, "/World/mug", "/W/h", 1.0),
        (
            {"object_file": "objects/mug.obj", "object_scale": 0.5, "gripper_file": "h.usd"},
            "objects/mug.obj",
            "h.usd",
            0.5,
        ),
        ({"format_version": "1.0"}, "", "", 1.0),
        ({"object_frame": None}, "", "", 1.0),
    ],
)
def test_the_spellings_of_isaac_grasp_files(more, object_name, hand_name, scale, tmp_path):
    """As of Isaac ROS, Isaac Sim's Grasp Editor, GraspDataGen and GraspGen."""
    g = grasp_files.some_grasps(n=3)
    document = grasp_files.isaac_document(g)
    for name in ("object_frame", "gripper_frame"):
        del document[name]
    document |= more
    for grasp in document["grasps"].values():
        grasp.pop("confidence")
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    rows = join_rows(read_grasps(tmp_path / "a.yaml"))
    assert (rows.object_name, rows.hand_name, rows.scale.tolist()) == (object_name, hand_name, [scale] * 3)
    np.testing.assert_allclose(rows.poses, g.poses, atol=1e-12)
    again = join_rows(read_grasps(write_grasps(tmp_path / "b.yaml", rows)))
    assert again.scale.tolist() == [scale] * 3 and again.object_name == object_name


def test_graspgen_files_of_the_published_data_set(tmp_path):
    """They name no object, and have a column of truth values."""
    g = grasp_files.some_grasps(n=4)
    grasps = {"transforms": g.poses.tolist(), "object_in_gripper": [[True], [False], [True], [True]]}
    (tmp_path / "7a321a5d.json").write_text(json.dumps({"object": {"scale": 0.7}, "grasps": grasps}))
    rows = join_rows(read_grasps(tmp_path / "7a321a5d.json"))
    assert rows.object_name == "" and rows.labels["object_in_gripper"].tolist() == [True, False, True, True]
    assert join_rows(read_grasps(write_grasps(tmp_path / "b.json", rows))).object_name == ""
