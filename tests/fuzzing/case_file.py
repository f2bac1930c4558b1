"""Case files: mutated ones of the paper and of a sphere in two fingers, read, built and sometimes planned."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import yaml

PAPER = {
    "schema": 1,
    "name": "paper",
    "hand": {
        "source": "humanoid",
        "position_mm": [99.011302071622, 37.583207446350, 50.0],
        "rpy_deg": [-90, 0, 94],
        "limits_deg": {"thumb_abduction": [-15, 130]},
    },
    "object": {"shape": "cylinder", "radius_mm": 10, "height_mm": 120, "mass": 1.02, "position_mm": [0, 0, 60]},
    "contacts": [
        {"finger": "thumb", "point_mm": [-2.6, -9.6, 61.5]},
        {"finger": "index", "point_mm": [4.7, 8.8, 71.0]},
        {"finger": "middle", "point_mm": [1.7, 9.7, 50.0]},
    ],
    "friction": {"mu": 0.7},
    "gravity": [0, 0, -9.81],
    "compliance": {"stiffness": 5e4, "damping": 100, "exponent": 1.5},
    "limits": {
        "final_time": 1.0,
        "impact_time": [0.8, 0.95],
        "acceleration": [0.01, 1.0],
        "max_speed": 2.0,
        "max_depth_mm": 5.0,
    },
    "forces": {"search": "hybrid", "balance": "force", "measure": "impulse", "solver": "auto"},
    "grid": {
        "impact_times": {"start": 0.8, "stop": 0.95, "step": 0.05},
        "accelerations": {"start": 0.01, "stop": 1.0, "step": 0.05},
        "multipliers": {"start": -1.0, "stop": 1.0, "step": 0.5},
        "residual_limit": 0.1,
    },
    "motion": {
        "posture_deg": {"thumb": [130, 72, 50, 30], "index": [10, 82, 30, 30], "middle": [0, 71, 50, 30]},
        "spread_deg": 0,
        "samples": 1,
        "time_step": 0.005,
        "acceleration_at_start": "rest",
    },
    "assumed": {"friction.mu": "0.7"},
}
CONVEX = {
    **PAPER,
    "name": "convex",
    "friction": {"mu": 0.7, "model": "cone", "safety": 1.1},
    "forces": {
        "search": "convex",
        "balance": "wrench",
        "measure": "work",
        "objective": {"work": 1.0, "least_squares": 1e-4},
    },
    "limits": {
        **PAPER["limits"],
        "max_normal_force": 40.0,
        "torque_limit": "effort",
        "deceleration": {"linear": [1.0, 0.5]},
    },
}
SPHERE = {
    "name": "ball",
    "hand": {
        "source": "humanoid",
        "position_mm": [99, 37.6, 50],
        "rpy_deg": [-90, 0, 94],
        "limits_deg": {"thumb_abduction": [-15, 130]},
    },
    "object": {"shape": "sphere", "radius_mm": 10, "mass": 0.2, "position_mm": [0, 0, 60]},
    "contacts": [
        {"finger": "thumb", "point_mm": [0, -10, 60]},
        {"finger": "index", "point_mm": [0, 10, 60], "link": "index_distal", "length_mm": 20},
    ],
    "friction": {"mu": 0.9, "model": "soft", "torsion_mm": 5},
    "forces": {"search": "convex"},
    "motion": {
        "posture_deg": {"thumb": [130, 72, 50, 30], "index": [10, 82, 30, 30]},
        "samples": 1,
        "spread_deg": 0,
        "time_step": 0.01,
    },
}
VALUES = [
    0,
    -0.0,
    1,
    -1,
    2,
    3.5,
    0.5,
    1e-3,
    1e3,
    1e-6,
    1e6,
    1e9,
    -1e9,
    1e308,
    -1e308,
    1e-320,
    1e-300,
    1e-11,
    1e11,
    float("nan"),
    float("inf"),
    -float("inf"),
    2**31,
    2**63,
    2**64,
    10**30,
    10**400,
    None,
    True,
    False,
    "",
    " ",
    "0",
    "x",
    "nan",
    "1e5",
    "humanoid",
    "cone",
    "soft",
    "convex",
    "hybrid",
    "wrench",
    "force",
    "work",
    "surface",
    "effort",
    "constant",
    "thumb",
    "index_distal",
    "../up",
    "..",
    ".",
    "nothing.urdf",
    "ä☃\u202e",
    "\0",
    "\x1b[2J",
    "a" * 300,
    "a/" * 3000,
    "=1+1",
    [],
    {},
    [0, 0, 1],
    [1, 2, 3, 4],
    [[1, 2], [3]],
    {"a": 1},
    {"start": 0, "stop": 1, "step": 1e-300},
    {"start": 0, "stop": 1, "step": 0.001},
    {"start": 1e308, "stop": -1e308, "step": 1},
    {"linear": [1, 0]},
    {"polynomial": [1, -1, 0.5]},
    {"sampled": [1, 2, 1]},
    {"linear": [0, 0]},
    {"polynomial": []},
    {"work": 1, "peak": 1},
]
DAMAGE = [
    b"\0",
    b"\xff",
    b"&a ",
    b"*a",
    b"- ",
    b": ",
    b"{",
    b"[",
    b"!!python/object:os.system ",
    b"!!binary ",
    b"<<: ",
    b"? ",
    b"|\n",
    b"\t",
    b"\r",
    b"---\n",
    b"...\n",
    b"%YAML 9.9\n",
    b"\xef\xbb\xbf",
    b"2001-99-99",
    b"0x",
    b"1_000",
    b"1e999",
    b"#",
    b"'",
    b'"',
    b"~",
    b"!!set {a, b}",
]


def places(value, path=()):
    """The paths of all values within plain ones, their own first."""
    yield path
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield from places(value[key], (*path, key))


def at(value, path):
    for key in path:
        value = value[key]
    return value


def mutated(rng: np.random.Generator, data: dict, values: list) -> dict:
    """A copy of plain values with one to six of them changed, removed, doubled, renamed, or nested deeper."""
    data, mild = copy.deepcopy(data), rng.random() < 0.5  # numbers alone, and not by much
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 6]))):
        path = pick(rng, list(places(data))[1:] or [()])
        if not path:
            return data
        *above, key = path
        holder = at(data, above)
        how = rng.random()
        old = holder[key]
        if mild:
            if isinstance(old, int | float) and not isinstance(old, bool):
                holder[key] = old * float(pick(rng, [0.5, 0.9, 0.99, 1.01, 1.1, 2, 10, 1e3, 1e-3, -1]))
        elif how < 0.35:
            holder[key] = copy.deepcopy(pick(rng, values))
        elif how < 0.65 and isinstance(old, int | float) and not isinstance(old, bool):
            factor = float(pick(rng, [0, -1, 0.5, 0.9, 1.1, 2, 10, 1e3, 1e-3, 1e6, 1e-6, 1e12, rng.normal(), 1 + 1e-9]))
            holder[key] = old * factor
        elif how < 0.75:
            del holder[key]
        elif how < 0.82 and isinstance(holder, list):
            holder[key:key] = [copy.deepcopy(old)] * int(rng.choice([1, 2, 30, 300]))
        elif how < 0.9 and isinstance(holder, dict):
            holder[pick(rng, ["x", "", "Mass", "folder", "name", 1, "a.b", "é", str(key).upper(), str(key) + " "])] = (
                holder.pop(key)
            )
        elif how < 0.97:
            holder[key] = copy.deepcopy(at(data, pick(rng, list(places(data)))))  # another part in its place
        else:
            for _ in range(int(rng.choice([1, 20, 60]))):  # six times over, still what the writer of YAML can bear
                old = [old] if rng.random() < 0.5 else {"a": old}
            holder[key] = old
    return data


def pick(rng, values: list):
    return values[int(rng.integers(len(values)))]


def text_of(data) -> bytes:
    text: str = yaml.safe_dump(data, allow_unicode=bool(len(str(data)) % 2))
    return text.encode("utf-8", "surrogatepass")


def damaged(rng, content: bytes) -> bytes:
    """Bytes cut, doubled, replaced, or with what means something to YAML between them."""
    for _ in range(int(rng.integers(1, 6))):
        i, j = sorted(int(k) for k in rng.integers(0, len(content) + 1, 2))
        j = min(j, i + 40)
        how = rng.random()
        if how < 0.5:
            content = content[:i] + pick(rng, DAMAGE) + content[i:]
        elif how < 0.7:
            content = content[:i] + content[j:]
        elif how < 0.85:
            content = content[:i] + rng.bytes(int(rng.integers(1, 5))) + content[i:]
        else:
            content = content[:j] + content[i:]
    return content


def hostile(rng) -> bytes:
    """Whole files that are made to hurt."""
    deep = int(rng.choice([100, 3000, 30000]))
    return pick(
        rng,
        [
            b"[" * deep,
            b"{a: " * deep,
            b"- " * deep,
            b"a: " + b"[" * deep + b"]" * deep,
            b"? " * deep,
            b"a: &a ["
            + b"x, " * 9
            + b"x]\n"
            + b"".join(b"%c: &%c [" % (98 + k, 98 + k) + b"*%c, " % (97 + k) * 9 + b"]\n" for k in range(10)),
            b"name: &a [*a]\nhand: *a",
            b"&a {a: *a}",
            b"<<: &a {<<: *a}",
            b"",
            b"\n" * 5000,
            b"#" * 5000,
            b"null",
            b"\xef\xbb\xbfname: x",
            rng.bytes(500),
            "name: ä".encode("utf-16"),
            b"name: " + b"9" * 5000,
            b"? [a]\n: 1",
            b"? {a: 1}\n: 1",
            b"1: 2\n2001-01-01: 3\ntrue: 4",
            b"a: 1\na: 2",
            b"name: !!float x\nhand: !!int y",
            b"name: 9999-99-99\nhand: 23:61:61",
            b"x" * 1_000_001,
        ],
    )


def make(rng: np.random.Generator, folder: Path):
    start = pick(rng, [PAPER, CONVEX, CONVEX, SPHERE])
    changes = []
    how = rng.random()
    if how < 0.08:
        content = hostile(rng)
    else:
        data = start if how < 0.1 else mutated(rng, start, VALUES)
        content = text_of(data)
        if rng.random() < 0.15:
            content = damaged(rng, content)
        if rng.random() < 0.15:
            path = ".".join(map(str, pick(rng, list(places(start))[1:])))
            changes = [path + pick(rng, ["=", "==", "", ".x=", ".0=", ".²="]) + str(pick(rng, VALUES))]
    (folder / "case.yaml").write_bytes(content)
    return [change.replace("\0", "?") for change in changes]


def run(case) -> str:
    import pinograsp as pg

    loaded = pg.load_case("case.yaml", case)
    hand = loaded.load_hand()
    loaded.make_problem(hand)
    loaded.make_grid()
    loaded.make_motion()
    loaded.settings()
    if loaded.motion.samples * loaded.limits.final_time / loaded.motion.time_step > 20_000:
        return "read"  # postures and steps that may be asked for, and take their time
    return str(loaded.plan(progress=False).status)
