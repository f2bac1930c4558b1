"""Sweep files: mutated ones over a case and over a hand with an object, read, and the small ones run in this process."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fuzzing import case_file
from fuzzing.material import damage, dump_yaml, mutate_values, pick

SWEEPS = [
    {
        "case": "case.yaml",
        "set": {"forces.search": "convex", "motion.samples": 1},
        "over": {"friction.mu": {"from": 0.4, "to": 1.0, "steps": 3}},
    },
    {
        "case": "paper",
        "what": "forces",
        "set": {"impact_time": 0.9},
        "over": {"friction.mu": [0.5, 0.7], "friction.model": ["cone", "pyramid"]},
        "samples": {"count": 3, "seed": 1, "object.mass": {"normal": [1.0, 0.1]}},
    },
    {
        "case": "case.yaml",
        "what": "forces",
        "over": {"impact_time": {"from": 0.81, "to": 0.94, "steps": 3}},
        "samples": {
            "count": 2,
            "friction.mu": {"uniform": [0.4, 1.0]},
            "object.mass": {"log_uniform": [0.5, 2.0]},
            "gravity.0": {"choice": [0, 1]},
        },
    },
    {
        "hand": "panda",
        "object": "box:size=0.03x0.03x0.08,mass=0.1",
        "set": {"at": [0, 0, 0.11]},
        "over": {"mu": [0.5, 0.9], "friction": ["cone", "soft"]},
    },
    {
        "hand": "panda",
        "object": {"shape": "sphere", "radius": 0.02, "mass": 0.1},
        "what": "forces",
        "set": {"at": [0, 0, 0.105], "impact_time": 0.9},
        "over": {"object.radius": {"from": 0.01, "to": 0.03, "steps": 2, "spacing": "log"}},
        "samples": {"count": 2, "mu": {"normal": [0.7, 0.1]}},
    },
]
VALUES = [
    *case_file.VALUES,
    *("case.yaml", "paper", "panda", "sphere:radius=0.03,mass=0.2", "mesh:path=x.stl,mass=1", "plan", "forces"),
    *({"from": 0, "to": 1, "steps": 2}, {"from": -1e308, "to": 1e308, "steps": 3}),
    {"from": 0, "to": 1, "steps": 10**7},
    *({"from": 1e-320, "to": 1, "steps": 3, "spacing": "log"}, {"log_uniform": [1e-300, 1]}, {"normal": [0, 1e308]}),
    *({"uniform": [0, 1]}, {"uniform": [-1e308, 1e308]}, {"uniform": [1, 0]}, {"uniform": [0, 1], "choice": [1]}),
    *({"choice": [1, "a", None, [1], {"b": 2}]}, {"choice": []}, [0.1] * 5, list(range(400)), ["a", 1, None]),
    *({"impact_time": 0.9}, {"count": 10**7, "object.mass": {"uniform": [0, 1]}}, {"count": 0}),
    {"friction.mu": [0.1], "object.mass": [1]},
]
MOST = 24  # rows of those that are run


def make(rng: np.random.Generator, folder: Path):
    case = mutate_values(rng, case_file.CONVEX, case_file.VALUES) if rng.random() < 0.2 else case_file.CONVEX
    (folder / "case.yaml").write_bytes(dump_yaml(case))
    if rng.random() < 0.06:
        content = case_file.make_hostile(rng)
    else:
        content = damage(rng, dump_yaml(mutate_values(rng, pick(rng, SWEEPS), VALUES)), 0.15, case_file.PIECES)
    (folder / "sweep.yaml").write_bytes(content)
    return {"jobs": int(pick(rng, [1] * 20 + [0, -5, 10**9])), "again": bool(rng.random() < 0.2)}


def run(case) -> str:
    from pinograsp.sweep import load_sweep, read_sweep, sweep

    spec = load_sweep("sweep.yaml")
    for index in {0, spec.rows // 2, spec.rows - 1}:
        spec.row(index)
    # Placements are searched in other processes, and tried by the dozen; so may postures be.
    postures = [{**spec.set, **spec.row(index)}.get("motion.samples", 1) for index in range(min(spec.rows, MOST))]
    if (
        spec.rows > MOST
        or any(isinstance(many, int | float) and many > 20 for many in postures)
        or (spec.hand is not None and spec.base.case(spec.row(0)).at is None)
    ):
        return "read"
    done = sweep("sweep.yaml", "out", jobs=case["jobs"], progress=False)
    table = read_sweep("out")
    if not (done.done == spec.rows == table.num_rows):
        raise AssertionError(f"{done} {table.num_rows}")
    if case["again"]:
        sweep("sweep.yaml", "out", jobs=1, progress=False)
    for message in table["message"].to_pylist():
        if re.match(r"[A-Z]\w*(Error|Exception|Warning): ", message or ""):
            raise AssertionError(f"unforeseen: {message}")
    return "run: " + ", ".join(sorted(done.counts))
