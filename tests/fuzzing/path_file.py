"""Files of an arm's path: tables of waypoints and of trajectories, mutated and hostile, read, and the sound ones planned
for an arm that holds a box.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import own_hands

from fuzzing.harness import import_public_names
from fuzzing.material import NAMES, NUMBER_TEXTS, UNWRITABLE, pick, translate, write_odd_file

TIME_LIMIT = 10.0
JOINTS = ["turn", "tilt"]
WORDS = [
    *NAMES,
    *UNWRITABLE,
    *"time Time turn tilt turm left robot1/turn turn/position tilt/velocity time,time".split(),
]
_HELD: list = []


def prepare() -> None:
    """An arm with a continuous joint that holds a box."""
    import tempfile

    import pinograsp as pg

    import_public_names()
    jaw = "0 0.04 40 0.2"
    text = own_hands.robot(
        "arm",
        own_hands.link("base"),
        own_hands.link("post", 0.4, "box 0.05 0.05 0.1", "0 0 -0.2"),
        own_hands.link("body", 0.4, "box 0.06 0.1 0.04", "0 0 -0.02"),
        own_hands.link("left", 0.05, "box 0.016 0.008 0.04", "0 0.004 0.06"),
        own_hands.link("right", 0.05, "box 0.016 0.008 0.04", "0 -0.004 0.06"),
        own_hands.joint("turn", "base", "post", "0 0 0", "0 0 1", "-100 100 100 2", kind="continuous"),
        own_hands.joint("tilt", "post", "body", "0 0 0", "0 1 0", "-1.5 1.5 40 0.2"),
        own_hands.joint("l", "body", "left", "0 0 0", "0 1 0", jaw, kind="prismatic"),
        own_hands.joint("r", "body", "right", "0 0 0", "0 -1 0", jaw, kind="prismatic", mimic="l 1 0"),
    )
    path = Path(tempfile.mkdtemp(prefix="fuzzing-arm-")) / "arm.urdf"
    path.write_text(text)
    arm = pg.load_hand(path)
    box = pg.Box(size=(0.03, 0.03, 0.06), mass=0.2).placed(translate(0, 0, 0.06))
    conditions = pg.GraspConditions(mu=0.6, reserve=None)
    _HELD[:] = [arm, pg.plan_grasp_on(arm, box, conditions, progress=False)]


def make(rng: np.random.Generator, folder: Path) -> dict:
    name = "way" + pick(rng, [".csv"] * 30 + [".CSV", ".txt", "", ".json", ".yaml"])
    if rng.random() < 0.08:
        name = write_odd_file(rng, folder, ".csv")
    else:
        (folder / name).write_bytes(_hostile(rng) if rng.random() < 0.2 else _table(rng))
    return {
        "path": name,
        "reader": pick(rng, ["path", "path", "path", "csv"]),
        "timing": pick(rng, ["fastest", "fastest", "given"]),
    }


def run(case: dict) -> str:
    """Read the file, look at what is there, and plan it."""
    from pinograsp.carry import ArmPath
    from pinograsp.handover import read_csv

    if case["reader"] == "csv":
        return f"a trajectory of {min(len(read_csv(case['path']).times), 9)} samples"
    return plan_path(ArmPath.read(case["path"]), case["timing"])


def plan_path(path, timing: str) -> str:
    """The path is a smooth one of finite numbers, and so is its plan."""
    from pinograsp.carry import plan_carry

    point = path.at(np.linspace(0.0, 1.0, 7))
    assert all(np.isfinite(part).all() for part in point), "a path that is not finite"
    arm, grasp = _HELD
    plan = plan_carry(arm, grasp, path, timing=timing, intervals=10, ramp=0)
    for name in ("times", "loads", "torques", "squeeze", "q"):
        assert np.isfinite(getattr(plan, name)).all(), f"{name} of the plan are not finite"
    return "planned"


# -- the files ---------------------------------------------------------------------------------------------------------


def _table(rng: np.random.Generator) -> bytes:
    """A path of some waypoints, or a trajectory, most of it sound."""
    joints = [*JOINTS] if rng.random() < 0.8 else [pick(rng, [*JOINTS, "l", "other"])]
    n, m = len(joints), int(rng.choice([0, 1, 2, 3, 3, 8, 8, 200]))
    times = np.cumsum(rng.uniform(0.2, 1.0, m))
    q = np.cumsum(rng.uniform(-0.2, 0.2, (m, n)), axis=0) * [4.0, 0.3][:n] + 0.1
    how = rng.random()
    if how < 0.3:
        header, rows = joints, q
    elif how < 0.7:
        header, rows = ["time", *joints], np.column_stack([times, q])
    else:
        kinds = ("position", "velocity", "acceleration", "effort", "stiffness", "damping")[: pick(rng, [4, 4, 4, 6, 1])]
        header = ["time", *(f"{joint}/{kind}" for kind in kinds for joint in joints)]
        rows = np.column_stack([times, q, *(np.zeros((m, n)) for _ in kinds[1:])])
    cells = [header, *([repr(value) for value in row] for row in rows.tolist())]
    for _ in range(int(rng.choice([0, 0, 0, 1, 1, 2, 5]))):
        line = cells[int(rng.integers(len(cells)))]
        how, at = rng.random(), int(rng.integers(len(line) + 1))
        if how < 0.6 and line:
            number = [*NUMBER_TEXTS, '"1"', *([repr(float(rng.normal()))] * 12)]
            line[at % len(line)] = pick(rng, WORDS if line is header else number)
        elif how < 0.7:
            line.insert(at, pick(rng, NUMBER_TEXTS))
        elif how < 0.8 and line:
            del line[at % len(line)]
        elif how < 0.9:
            cells.insert(int(rng.integers(len(cells) + 1)), list(line))
        else:
            cells.insert(int(rng.integers(len(cells) + 1)), pick(rng, [[], [""], ["# a remark"], [" "], line * 50]))
    between, end = pick(rng, [","] * 40 + [";", "\t", ", ", " "]), pick(rng, ["\n"] * 6 + ["\r\n", "\r", "\n\n"])
    content = end.join(between.join(line) for line in cells).encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:
        at = int(rng.integers(len(content) + 1))
        content = content[:at] + pick(rng, [b"\0", b"\xff", b'"', b"\xef\xbb\xbf", b"\r", b"\x1a"]) + content[at:]
    return pick(rng, [b""] * 9 + [b"\xef\xbb\xbf"]) + content + pick(rng, [b"", b"\n"])


def _hostile(rng: np.random.Generator) -> bytes:
    """Whole tables that are made to hurt."""
    many = int(rng.choice([3000, 200_000, 1_100_000]))
    return pick(
        rng,
        [
            b"",
            b"\n" * many,
            b"," * many,
            b"turn,tilt\n" + b"," * many,
            b"turn\n" + b"0\n1\n" * (many // 2),
            b"turn,tilt\n" + b"0," * many + b"0\n",
            b"1" * many + b",2\n0,1\n",
            b"turn,tilt\n" + b"1" * many + b",2\n",
            b'"' + b"a\n" * many,
            b"a," * many + b"a\n0\n",
            b"time\n0\n1\n",
            b"time,turn\n" + b"".join(b"%d,0.1\n" % i for i in range(min(many, 50_000))),
            b"turn\n0\n" + b"\n" * many + b"1\n",
            b"\xff\xfe" + "turn\n0\n1\n".encode("utf-16-le"),
            b"\x1f\x8b" + rng.bytes(300),
            b"\x93NUMPY" + rng.bytes(300),
            b"PK\x03\x04" + rng.bytes(300),
            rng.bytes(2000),
            b"turn\n" + b"0x1p3\n" * 3,
            b"x" * (2**24 + 1),
        ],
    )
