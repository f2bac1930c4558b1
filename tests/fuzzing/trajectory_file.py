"""Messages with trajectories, as ROS, ROS 2 and MoveIt write them, in JSON and YAML: mutated, damaged and hostile, read,
and the sound ones planned for an arm that holds a box.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import yaml

from fuzzing import case_file, path_file
from fuzzing.material import damage, mutate_values, pick, write_odd_file

TIME_LIMIT = 10.0
prepare = path_file.prepare
VALUES = [
    *case_file.VALUES,
    *("...", ["..."], [0.1, 0.2], {"sec": 1, "nanosec": 5}, {"secs": 1}, {"sec": 10**30, "nanosec": -1}),
    *({"transforms": []}, {"joint_names": ["turn"], "points": []}, ["turn", "tilt"], ["robot1/turn"], [["turn"]]),
    *([True], [1, 2], [0] * 3000, [None] * 3),
]


def make(rng: np.random.Generator, folder: Path) -> dict:
    name = "way" + pick(rng, [".json"] * 12 + [".yaml"] * 12 + [".yml", ".YAML", ".csv", ""])
    how = rng.random()
    if how < 0.06:
        name = write_odd_file(rng, folder, pick(rng, [".json", ".yaml"]))
    else:
        if how < 0.2:
            content = _hostile(rng)
        else:
            documents = [_message(rng) for _ in range(pick(rng, [1] * 12 + [2, 3, 0]))]
            if rng.random() < 0.75:
                documents = [mutate_values(rng, one, VALUES) for one in documents]
            content = damage(rng, _write(rng, documents, name), 0.2, case_file.PIECES)
        (folder / name).write_bytes(content)
    return {
        "path": name,
        "reader": pick(rng, ["path", "path", "path", "ros2"]),
        "timing": pick(rng, ["fastest", "fastest", "given"]),
    }


def run(case: dict) -> str:
    """Read the file, look at what is there, and plan it."""
    from pinograsp.carry import ArmPath
    from pinograsp.handover import read_ros2

    if case["reader"] == "path":
        return path_file.plan_path(ArmPath.read(case["path"]), case["timing"])
    read = read_ros2(case["path"])
    read.to_ros2("again.json")
    again = read_ros2("again.json")
    assert again.names == read.names, f"{again.names}"
    # Whole nanoseconds are what a message holds.
    assert np.abs(again.times - read.times).max() <= 1e-9 * max(1.0, np.abs(read.times).max()), "other times"
    assert all(np.array_equal(getattr(again, name), getattr(read, name)) for name in ("q", "dq", "ddq", "effort"))
    return "read and written"


# -- the files ---------------------------------------------------------------------------------------------------------


def _message(rng: np.random.Generator) -> dict:
    """A sound message, of one of the kinds that there are."""
    whole, fraction = pick(rng, [("sec", "nanosec"), ("sec", "nanosec"), ("secs", "nsecs")])
    m, joints = int(rng.choice([1, 2, 3, 6, 40])), list(path_file.JOINTS)
    q = np.cumsum(rng.uniform(-0.2, 0.2, (m, 2)), axis=0) * [4.0, 0.3] + 0.1
    points = []
    for i, row in enumerate(q.tolist()):
        t = int((i + 1) * 1e9 * 0.7)
        points.append(
            {
                "positions": row,
                "velocities": pick(rng, [[], [0.0, 0.0]]),
                "accelerations": [],
                "effort": pick(rng, [[], [0, 1e-5]]),
                "time_from_start": {whole: t // 10**9, fraction: t % 10**9},
            }
        )
    header = {"stamp": {whole: 0, fraction: 0}, "frame_id": ""}
    inner = {"header": header, "joint_names": joints, "points": points}
    empty = {"header": header, "joint_names": [], "points": []}
    robot = {"joint_trajectory": inner, "multi_dof_joint_trajectory": empty}
    return pick(
        rng,
        [
            inner,
            inner,
            {"trajectory": inner, "goal_tolerance": []},
            {"header": header, "goal_id": {"id": ""}, "goal": {"trajectory": inner}},
            robot,
            {"model_id": "arm", "trajectory": [robot], "trajectory_start": {"joint_state": {"name": joints}}},
            {"solution": robot, "fraction": 1.0, "error_code": {"val": 1}},
        ],
    )


def _write(rng: np.random.Generator, documents: list, name: str) -> bytes:
    if name.endswith(".json"):
        text = "\n".join(json.dumps(one, ensure_ascii=bool(rng.random() < 0.5)) for one in documents)
        return text.encode("utf-8", "surrogatepass")
    flow = pick(rng, [None, True, False])
    try:
        texts = [yaml.safe_dump(one, default_flow_style=flow, allow_unicode=True) for one in documents]
    except yaml.YAMLError:  # what it cannot write down, JSON can
        texts = [json.dumps(one) for one in documents]
    return ("---\n".join(texts) + pick(rng, ["", "---\n", "---\n---\n", "...\n"])).encode("utf-8", "surrogatepass")


def _hostile(rng: np.random.Generator) -> bytes:
    """Whole files that are made to hurt."""
    many = int(rng.choice([3000, 200_000, 1_100_000]))
    merge = b"a: &a {x: 1}\n" + b"".join(
        b"%c: &%c {<<: [*%c, *%c], %c1: 1}\n" % ((98 + i,) * 2 + (97 + i,) * 2 + (98 + i,)) for i in range(22)
    )
    point = b'{"positions": [%d], "time_from_start": {"sec": %d, "nanosec": 0}}'
    laughs = b"a: &a [0,0,0,0,0,0,0,0,0]\n" + b"".join(
        b"%c: &%c [%s]\n" % (98 + i, 98 + i, b",".join([b"*%c" % (97 + i)] * 9)) for i in range(9)
    )
    return pick(
        rng,
        [
            case_file.make_hostile(rng),
            merge,
            laughs + b"joint_names: [x]\npoints:\n  - {positions: *j, time_from_start: {sec: 0, nanosec: 0}}\n",
            b"[" * many,
            b"[],"[:2] * many,
            b'{"a":' * many,
            b"[" + b"[]," * many + b"0]",
            b"- 0\n" * many,
            b"---\n" * many,
            b"? " * many,
            b"".join(b"k%d: 1\n" % i for i in range(min(many, 300_000))),
            b"".join(b"- &a%d x\n" % i for i in range(min(many, 300_000))),
            b'{"joint_names": ["turn"], "points": [' + b",".join(point % (i % 3, i) for i in range(20_000)) + b"]}",
            b'{"joint_names": ["turn"], "points": [' + b"9" * many + b"]}",
            b'{"joint_names": ["' + b"a" * many + b'"], "points": [{}]}',
            b'{"joint_names": ["turn"], "points": [], "points": []}',
            b'{"joint_names": ["\\ud800"], "points": []}',
            b'{"joint_names": NaN, "points": [Infinity]}',
            b"joint_names: !!python/object/apply:os.system ['touch ran']\npoints: []\n",
            b"trajectory_msgs.msg.JointTrajectory(header=std_msgs.msg.Header(), joint_names=['turn'], points=[])",
            b"WARNING: topic [/way] does not appear to be published yet\n",
            b"x" * (2**24 + 1),
        ],
    )
