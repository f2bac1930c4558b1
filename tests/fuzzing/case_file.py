"""Case files: mutated ones of the paper and of a sphere in two fingers, read, built and sometimes planned."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fuzzing.material import NAMES, NUMBERS, UNWRITABLE, damage, dump_yaml, list_paths, mutate_values, pick

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
    *NUMBERS,
    *NAMES,
    *UNWRITABLE,
    *"humanoid cone soft convex hybrid wrench force work surface effort constant thumb index_distal".split(),
    *(None, True, False, [], {}, [0, 0, 1], [1, 2, 3, 4], [[1, 2], [3]], {"a": 1}),
    *({"start": 0, "stop": 1, "step": 1e-300}, {"start": 0, "stop": 1, "step": 0.001}),
    *({"start": 1e308, "stop": -1e308, "step": 1}, {"work": 1, "peak": 1}),
    *({"linear": [1, 0]}, {"linear": [0, 0]}, {"polynomial": [1, -1, 0.5]}, {"polynomial": []}, {"sampled": [1, 2, 1]}),
]
# What means something to YAML.
PIECES = [
    *(b"\0", b"\xff", b"\xef\xbb\xbf", b"\t", b"\r", b"&a ", b"*a", b"- ", b": ", b"{", b"[", b"<<: ", b"? ", b"|\n"),
    b"#",
    *(b"!!python/object:os.system ", b"!!binary ", b"!!set {a, b}", b"---\n", b"...\n", b"%YAML 9.9\n", b"'", b'"'),
    b"~",
    *(b"2001-99-99", b"0x", b"1_000", b"1e999"),
]


def make_hostile(rng) -> bytes:
    """Whole files that are made to hurt."""
    deep = pick(rng, [100, 3000, 30_000])
    laughs = b"".join(b"%c: &%c [" % (98 + k, 98 + k) + b"*%c, " % (97 + k) * 9 + b"]\n" for k in range(10))
    return pick(
        rng,
        [
            *(b"[" * deep, b"{a: " * deep, b"- " * deep, b"a: " + b"[" * deep + b"]" * deep, b"? " * deep),
            b"a: &a [" + b"x, " * 9 + b"x]\n" + laughs,
            *(b"name: &a [*a]\nhand: *a", b"&a {a: *a}", b"<<: &a {<<: *a}", b"? [a]\n: 1", b"? {a: 1}\n: 1"),
            *(b"", b"\n" * 5000, b"#" * 5000, b"null", b"\xef\xbb\xbfname: x", b"x" * 1_000_001, rng.bytes(500)),
            *("name: ä".encode("utf-16"), b"name: " + b"9" * 5000, b"1: 2\n2001-01-01: 3\ntrue: 4", b"a: 1\na: 2"),
            *(b"name: !!float x\nhand: !!int y", b"name: 9999-99-99\nhand: 23:61:61"),
        ],
    )


def make(rng: np.random.Generator, folder: Path):
    start = pick(rng, [PAPER, CONVEX, CONVEX, SPHERE])
    changes = []
    how = rng.random()
    if how < 0.08:
        content = make_hostile(rng)
    else:
        content = dump_yaml(start if how < 0.1 else mutate_values(rng, start, VALUES))
        content = damage(rng, content, 0.15, PIECES)
        if rng.random() < 0.15:
            path = ".".join(map(str, pick(rng, list(list_paths(start))[1:])))
            changes = [path + pick(rng, ["=", "==", "", ".x=", ".0=", ".²="]) + str(pick(rng, VALUES))]
    (folder / "case.yaml").write_bytes(content)
    return [change.replace("\0", "?") for change in changes]


def run(case) -> str:
    import pinograsp as pg

    loaded = pg.load_case("case.yaml", texts=case)
    hand = loaded.load_hand()
    loaded.make_problem(hand)
    loaded.make_grid()
    loaded.make_motion()
    loaded.settings()
    if loaded.motion.samples * loaded.limits.final_time / loaded.motion.time_step > 20_000:
        return "read"  # postures and steps that may be asked for, and take their time
    return str(loaded.plan(progress=False).status)
