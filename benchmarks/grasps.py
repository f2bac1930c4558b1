"""Every hand on a can, a ball, a box, a mug with a handle and a bottle: found, planned, shaken.

    python benchmarks/grasps.py --seed 7 [--hands NAME ...] [--samples 16] [--jobs 2]

The can is 66 x 120 mm and 350 g, the ball 75 mm and 180 g, the box 50 x 50 x 120 mm and 300 g, the mug 80 x 95 mm and
300 g, the bottle 65 x 200 mm and 500 g. What is wider than 0.9 of the hand's opening (between the fingertips' surfaces;
of one finger: to the palm) is scaled to that, at 800 kg/m^3. Friction is 0.6, all else as the package chooses it.
Hands are names of the catalogue or files (with ``--root`` for one of these).

A pair counts where the plan is ok, its contacts have force closure, and a simulation holds the object as planned, fixed
until t_F and then free, shaken with 3 m/s^2 at 2 Hz along x, y and z, with 1.2 times the mass, and with 0.8 times the
friction. Writes grasps.csv beside this file, and prints a table by hand and the reasons of what failed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import trimesh
from joblib import Parallel, delayed
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import PinograspError
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.planner import plan_best
from pinograsp.simulation.settings import Disturbance
from pinograsp.synthesis.preshapes import measure_opening

HERE = Path(__file__).resolve().parent
MU, DENSITY, SCALED = 0.6, 300.0, 800.0  # [kg/m^3]; the last: of what is scaled to a hand
_FITS = 0.9  # of the opening
SHAPES = ("cylinder", "sphere", "box", "mug", "bottle")
SHAKE, FREQUENCY, HOLD = 3.0, 2.0, 1.0
TRIALS = {
    "held": Disturbance(),
    "x": Disturbance(shake=[SHAKE, 0, 0], shake_frequency=FREQUENCY),
    "y": Disturbance(shake=[0, SHAKE, 0], shake_frequency=FREQUENCY),
    "z": Disturbance(shake=[0, 0, SHAKE], shake_frequency=FREQUENCY),
    "mass": Disturbance(mass_factor=1.2),
    "mu": Disturbance(mu=0.8 * MU),
}
COLUMNS = (
    *(
        "hand",
        "object",
        "width_mm",
        "size_mm",
        "mass_g",
        "tried",
        "found",
        "status",
        "closure",
        "quality",
        "contacts",
        "force_N",
    ),
    *("push_N", "hit_N", "error", "foreseen", *TRIALS, "search_s", "plan_s", "good", "why"),
)


def width(hand: pg.HandModel) -> float:
    """How far the open hand's fingertips are apart, between their surfaces [m]; of one finger, from the palm."""
    return measure_opening(hand)


def mug() -> trimesh.Trimesh:
    """A beaker with a bottom, and a ring as its handle."""
    radius, height = 0.04, 0.095
    outer, inner = (trimesh.creation.cylinder(radius=r, height=height, sections=48) for r in (radius, 0.88 * radius))
    inner.apply_translation([0, 0, 0.1 * height])
    ring = trimesh.creation.torus(0.3 * height, 0.15 * radius, major_sections=32, minor_sections=12)
    ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    ring.apply_translation([1.05 * radius, 0, 0])
    core = trimesh.creation.cylinder(radius=0.9 * radius, height=2 * height, sections=48)
    parts = [trimesh.boolean.difference(pair, engine="manifold") for pair in ([outer, inner], [ring, core])]
    return trimesh.boolean.union(parts, engine="manifold")


def bottle() -> trimesh.Trimesh:
    r, h = 0.0325, 0.2
    profile = np.array([[0, 0], [r, 0], [r, 0.6 * h], [0.4 * r, 0.8 * h], [0.4 * r, h], [0, h]])
    return trimesh.creation.revolve(profile, sections=48)


MESHES = {"mug": mug, "bottle": bottle}
# What a hand opens for [m], and mass [kg].
SIZES = {
    "cylinder": (0.066, 0.35),
    "sphere": (0.075, 0.18),
    "box": (0.05, 0.3),
    "mug": (0.08, 0.3),
    "bottle": (0.065, 0.5),
}


def objects(w: float) -> dict:
    """Simple ones whose size goes with a hand's width w [m], for other benchmarks."""
    return {
        "cylinder": pg.Cylinder(radius=0.18 * w, height=0.9 * w, density=DENSITY),
        "sphere": pg.Sphere(radius=0.2 * w, density=DENSITY),
        "box": pg.Box(size=(0.3 * w, 0.3 * w, 0.8 * w), density=DENSITY),
    }


def scale_of(shape: str, w: float) -> float:
    """Of an object of that shape for a hand that opens by w [m]: 1, or less."""
    return min(1.0, _FITS * w / SIZES[shape][0])


def thing(shape: str, w: float) -> pg.objects.body.Body:
    """An object of that shape that a hand which opens by w [m] can hold; or the one that a text describes."""
    if ":" in shape:
        return pg.object_from(shape)
    mass, scale = SIZES[shape][1], scale_of(shape, w)
    how = {"mass": mass} if scale == 1.0 else {"density": SCALED}
    if shape in MESHES:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{shape}.stl"
            MESHES[shape]().export(path)
            return pg.Mesh.load(path, scale=scale, **how)
    if shape == "cylinder":
        return pg.Cylinder(radius=0.033 * scale, height=0.12 * scale, **how)
    if shape == "sphere":
        return pg.Sphere(radius=0.0375 * scale, **how)
    return pg.Box(size=scale * np.array([0.05, 0.05, 0.12]), **how)


def name_of(source: str) -> str:
    """Of a hand of the catalogue, or of a file."""
    return source if source in CATALOGUE else Path(source).stem


def row(source: str, root: str | None, shape: str, samples: int, seed: int) -> dict:
    """What came of one hand and one object."""
    found: dict = dict.fromkeys(COLUMNS, "") | {"hand": name_of(source), "object": shape, "good": False}
    try:
        return found | _row(pg.load_hand(source, root=root), shape, samples, seed, found)
    except PinograspError as error:
        return found | {"status": type(error).__name__, "why": " ".join(str(error).split())[:300]}


def _row(hand: pg.HandModel, shape: str, samples: int, seed: int, found: dict) -> dict:
    w = width(hand)
    body = thing(shape, w)
    size = scale_of(shape, w) * SIZES[shape][0] if shape in SIZES else 2 * body.bounding_radius
    found |= {"width_mm": f"{1e3 * w:.1f}", "size_mm": f"{1e3 * size:.0f}", "mass_g": f"{1e3 * body.mass:.1f}"}
    conditions = pg.GraspConditions(mu=MU)
    started = time.perf_counter()
    search = pg.find_grasps(hand, body, conditions, count=samples, seed=seed, jobs=1, progress=False)
    found |= {"tried": search.tried, "found": len(search.grasps), "search_s": f"{time.perf_counter() - started:.2f}"}
    started = time.perf_counter()
    plan = plan_best(search, conditions)
    found |= {"plan_s": f"{time.perf_counter() - started:.2f}", "status": str(plan.status)}
    margins = plan.with_margins().require_margins()
    found |= {
        "closure": margins.force_closure,
        "quality": f"{margins.ferrari_canny:.3g}",
        "contacts": plan.problem.k,
        "force_N": f"{plan.forces.normal_forces.sum():.3g}",
        "push_N": f"{margins.disturbance_force:.3g}",
        "why": "; ".join([*plan.motion.notes[-1:], *plan.cautions])[:300],
    }
    for trial, disturbance in TRIALS.items():
        seen = pg.simulate(plan, hold=HOLD, support="fixed", disturbance=disturbance)
        found[trial] = bool(seen.verdict.held)
        if trial == "held":
            before = seen.times < plan.forces.impact_time - 5e-3
            found["hit_N"] = f"{seen.normal_forces[before].max():.3g}"
            found["error"] = f"{seen.verdict.force_error:.3g}"
            found["foreseen"] = f"{seen.verdict.settled_error:.3g}"
            found["why"] = "; ".join(filter(None, [found["why"], seen.verdict.reason]))[:300]
    good = plan.status == "ok" and margins.force_closure and all(found[trial] for trial in TRIALS)
    return found | {"good": good}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--samples", type=int, default=16, help="of the search")
    parser.add_argument("--hands", nargs="+", default=list(CATALOGUE), help="names of the catalogue, or files")
    parser.add_argument("--root", help="link where the hand begins, of files with an arm")
    parser.add_argument(
        "--objects", nargs="+", default=SHAPES, help=f"{', '.join(SHAPES)}, or as mesh:path=can.obj,mass=0.35"
    )
    parser.add_argument("--jobs", type=int, default=-1, help="pairs at the same time; -1: all cores")
    parser.add_argument("--out", type=Path, default=HERE / "grasps.csv")
    options = parser.parse_args()
    pairs = [(hand, shape) for hand in options.hands for shape in options.objects]
    work = (delayed(row)(hand, options.root, shape, options.samples, options.seed) for hand, shape in pairs)
    rows: list[dict] = []
    notes = (f"{options.samples} samples a pair", f"seed {options.seed}")
    for one in tqdm(Parallel(options.jobs, return_as="generator")(work), total=len(pairs), unit="pair"):
        rows.append(one)
        write_rows(options.out, header(("numpy", "pin", "coal", "mujoco-core"), *notes), rows)
    print(summary(rows))
    seconds = [float(one["search_s"]) + float(one["plan_s"]) for one in rows if one["plan_s"]]
    good = sum(one["good"] for one in rows)
    print(
        f"\n{good} of {len(rows)} pairs ({100 * good / len(rows):.1f} %); median {np.median(seconds):.1f} s to a plan"
    )


def summary(rows: list[dict]) -> str:
    """Hands down, objects across; what failed, with its reason, below."""
    shapes = list(dict.fromkeys(one["object"] for one in rows))
    hands = []
    for name in dict.fromkeys(one["hand"] for one in rows):
        of = {one["object"]: one for one in rows if one["hand"] == name}
        hands.append({"hand": name, **{shape: _cell(of[shape]) for shape in shapes}})
    failed = [one for one in rows if not one["good"]]
    lines = [table(hands), "", *(f"{one['hand']}, {one['object']}: {_cell(one)}: {one['why']}" for one in failed)]
    lines += [f"{count} {what}" for what, count in Counter(_cell(one) for one in failed).most_common()]
    return "\n".join(lines)


_SAID = {"GraspInfeasible": "infeasible", "GraspUndecided": "undecided", "GraspNotFound": "not found"}


def _cell(one: dict) -> str:
    if one["good"]:
        return f"{one['force_N']} N"
    if one["status"] != "ok":
        return _SAID.get(one["status"], str(one["status"]))
    if not one["closure"]:
        return "no force closure"
    return "lost: " + ", ".join(trial for trial in TRIALS if one[trial] is False)


if __name__ == "__main__":
    main()
