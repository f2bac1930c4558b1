"""Trajectories as ROS 2, ROS 1 and MoveIt print them, and files that are none."""

import json
import os

import numpy as np
import pytest
import yaml

from pinograsp.errors import InvalidInput
from pinograsp.handover import JointTrajectory, read_csv, read_ros2

JOINTS = ("shoulder", "elbow")
Q = np.array([[0.1, -0.5], [0.25, -0.45], [0.4, 0.0]])
TIMES = [0.5, 1.0, 2.25]
DQ = [1e-05, 0.0]

ROS2 = """header:
  stamp:
    sec: 1764170000
    nanosec: 12
  frame_id: base
joint_names:
- shoulder
- elbow
points:
""" + "".join(
    f"""- positions:
  - {q[0]}
  - {q[1]}
  velocities:
  - 1.0e-05
  - 0.0
  accelerations: []
  effort: []
  time_from_start:
    sec: {int(t)}
    nanosec: {round(t % 1 * 1e9)}
"""
    for t, q in zip(TIMES, Q.tolist())
)
ROS1 = """header: 
  seq: 3
  stamp: 
    secs: 0
    nsecs:         0
  frame_id: ''
joint_names: 
  - shoulder
  - elbow
points: 
""" + "".join(
    f"""  - 
    positions: [{q[0]}, {q[1]}]
    velocities: [1e-05, 0.0]
    accelerations: []
    effort: []
    time_from_start: 
      secs: {int(t)}
      nsecs: {round(t % 1 * 1e9):>9}
"""
    for t, q in zip(TIMES, Q.tolist())
)
EMPTY = {"header": {}, "joint_names": [], "points": []}
BASE = {"joint_names": ["world"], "points": [{"transforms": [], "time_from_start": {"sec": 0, "nanosec": 0}}]}


def within(text, *keys):
    """The message in another, as YAML."""
    value = yaml.safe_load(text.replace("1e-05", "1.0e-05"))
    for key in reversed(keys):
        value = [value] if key == 0 else {key: value}
    return value


def robot_trajectory(base=EMPTY):
    return {**within(ROS2, "joint_trajectory"), "multi_dof_joint_trajectory": base}


TEXTS = {
    "ros2 topic echo": (".yaml", ROS2 + "---\n"),
    "ros2 topic echo --once, copied": (".yml", "---\n" + ROS2 + "---\n---\n"),
    "rostopic echo": (".yaml", ROS1 + "---\n"),
    "ros2 topic echo --flow-style": (".yaml", yaml.safe_dump(within(ROS2), default_flow_style=True, width=10**6)),
    "RobotTrajectory": (".yaml", yaml.safe_dump(robot_trajectory())),
    "RobotTrajectory of ROS 1": (
        ".json",
        json.dumps({**within(ROS1, "joint_trajectory"), "multi_dof_joint_trajectory": EMPTY}),
    ),
    "DisplayTrajectory": (
        ".yaml",
        yaml.safe_dump({"model_id": "arm", "trajectory": [robot_trajectory()], "trajectory_start": {}}),
    ),
    "FollowJointTrajectory": (
        ".json",
        json.dumps({**within(ROS2, "trajectory"), "multi_dof_trajectory": EMPTY, "path_tolerance": []}),
    ),
    "FollowJointTrajectoryActionGoal": (
        ".yaml",
        yaml.safe_dump({"goal_id": {"id": ""}, **within(ROS1, "goal", "trajectory")}),
    ),
    "GetCartesianPath": (".json", json.dumps({"solution": robot_trajectory(), "fraction": 1.0})),
    "with one zero vector": (".yaml", yaml.dump(within(ROS2) | {"unused": [DQ, DQ]})),
    "a suffix in capitals": (".YAML", ROS2),
}


def same(read):
    assert read.names == JOINTS
    np.testing.assert_allclose(read.times, TIMES, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(read.q, Q)
    np.testing.assert_array_equal(read.dq, [DQ] * 3)
    assert not read.ddq.any() and not read.effort.any()


@pytest.mark.parametrize("name", TEXTS)
def test_messages_as_tools_print_them(name, tmp_path):
    suffix, text = TEXTS[name]
    (tmp_path / f"way{suffix}").write_text(text, encoding="utf-8")
    same(read_ros2(tmp_path / f"way{suffix}"))


@pytest.mark.parametrize("goal", [False, True])
@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_what_is_read_is_written_and_read_again(suffix, goal, tmp_path):
    (tmp_path / "way.yaml").write_text(ROS1)
    read = read_ros2(tmp_path / "way.yaml")
    read.to_ros2(tmp_path / f"again{suffix}", goal=goal)
    same(read_ros2(tmp_path / f"again{suffix}"))


def changed(**values):
    message = within(ROS2) | values
    return ".json", json.dumps({key: value for key, value in message.items() if value is not None})


def point(**values):
    points = within(ROS2)["points"]
    points[1] = {key: value for key, value in (points[1] | values).items() if value is not None}
    return changed(points=points)


REFUSED = {
    "two messages": (".yaml", f"{ROS2}---\n{ROS2}---\n", "2 in 2 messages.*--once"),
    "two pieces": (
        ".json",
        json.dumps({"trajectory": [robot_trajectory(), robot_trajectory()]}),
        "one trajectory, got 2",
    ),
    "a base": (".json", json.dumps(robot_trajectory(BASE)), "multi_dof_joint_trajectory"),
    "a base alone": (".json", json.dumps({"joint_trajectory": EMPTY, "multi_dof_joint_trajectory": BASE}), "multi_dof"),
    "nothing found": (".json", json.dumps({"joint_trajectory": EMPTY}), "without joints and points"),
    "cut off": (".yaml", f"{ROS2}- '...'\n---\n", "cut off after 3.*--full-length"),
    "joint states": (".yaml", "name: [a]\nposition: [0.0]\n", "joint_names and points, got the keys name, position"),
    "no positions": (*point(positions=[]), "positions.*none at 1"),
    "positions left out": (*point(positions=None), "positions.*none at 1"),
    "one too few": (*point(positions=[0.0]), "positions"),
    "texts": (*point(velocities=["a", "b"]), "velocities"),
    "no time": (*point(time_from_start=None), "time_from_start of point 1"),
    "no seconds": (*point(time_from_start={"s": 1}), "time_from_start of point 1.*sec and nanosec"),
    "too many seconds": (*point(time_from_start={"sec": 10**390, "nanosec": 0}), "sec of time_from_start of point 1"),
    "back in time": (*point(time_from_start=0.25), "later than the one before"),
    "no names": (*changed(joint_names=[None, True]), "joint_names"),
    "points that are none": (*changed(points=[1, 2]), "points"),
    "deep": (".json", "[" * 100_000, "levels|lists"),
    "deep YAML": (".yaml", "{a: " * 100_000, "within each other"),
    "printed by Python": (".yaml", "trajectory_msgs.msg.JointTrajectory(header=std_msgs.msg.Header())", "got"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_messages_that_cannot_be_read_are_told(name, tmp_path):
    suffix, text, message = REFUSED[name]
    (tmp_path / f"way{suffix}").write_text(text)
    with pytest.raises(InvalidInput, match=message):
        read_ros2(tmp_path / f"way{suffix}")


def test_seconds_may_be_a_number(tmp_path):
    suffix, text = point(time_from_start=1)
    (tmp_path / f"way{suffix}").write_text(text)
    same(read_ros2(tmp_path / f"way{suffix}"))


@pytest.mark.parametrize("read", [read_csv, read_ros2])
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "gap", "nothing"])
def test_only_regular_files_are_opened(read, kind, tmp_path):
    """A pipe would wait for ever, a device never end."""
    path = tmp_path / "way.json"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "gap":
        path.touch()
        os.truncate(path, 2**40)
    with pytest.raises(InvalidInput, match="way.json"):
        read(path)


def test_long_trajectories_come_back(tmp_path):
    """Four seconds of ten joints at a kilohertz."""
    rng = np.random.default_rng(2)
    times, names = np.arange(4_000) / 1000, tuple(f"joint{i}" for i in range(10))
    q = rng.normal(size=(len(times), 10)).round(6)
    written = JointTrajectory(names=names, times=times, q=q, dq=q, ddq=q, effort=q)
    written.to_ros2(tmp_path / "way.json")
    np.testing.assert_array_equal(read_ros2(tmp_path / "way.json").q, q)
    written.to_csv(tmp_path / "way.csv")
    np.testing.assert_array_equal(read_csv(tmp_path / "way.csv").effort, q)
