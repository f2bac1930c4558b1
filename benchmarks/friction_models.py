"""The price of friction pyramids: energy and rejected grasps with 4, 8 and 16 edges against the exact cone.

    python benchmarks/friction_models.py [--quick]

Writes friction_models.csv and friction_models.png beside this file. Seeded random grasps of a cylinder's side or a
sphere, mu uniform in 0.4 to 0.8, redrawn until the cone holds 0.2 N of the load's direction. Two kinds of grasp:

- scattered: contacts uniform on the surface. With three of them most that hold anything just do.
- opposed: one contact against the others, which lie opposite to it within 35 degrees, as a thumb against fingers.

Two kinds of load:

- weight: a force along gravity, the body in any orientation. The contact frames, and with them the pyramids, are
  oriented by gravity, as the package does it: four edges lie diagonally, so they give least straight up.
- wrench: a force of any direction, and a moment of any direction of up to that force times the body's radius.

The load's size is uniform between zero and the largest that the cone holds. So the expected share of loads that the
cone holds and the pyramid rejects is the mean loss of largest load. "rejected" counts such loads, "rejected_expected"
measures that loss (more accurate: no sampling of sizes), "holds_none" counts grasps whose pyramids hold no load of that
direction at all. Energy is the work of Eq. (9) at t_I = 0.9 s, its least value with each model, compared where both
hold the load. Least decelerations are negligible (1e-6 m/s^2): contacts may idle. Every answer is certified, every
rejection proven.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg

HERE = Path(__file__).resolve().parent
SEED = 21
IMPACT_TIME = 0.9
CONTACTS = (3, 5, 10)
EDGES = (4, 8, 16)
LOADS = ("weight", "wrench")
PLACEMENTS = ("scattered", "opposed")
SPREAD = np.radians(35)  # of the opposed contacts
UNIT_LOAD = 0.02  # size of the force whose largest multiple is sought [N]: less counts as nothing
LEAST_HELD = 0.2  # grasps whose cones hold less of a load are redrawn [N]
GRASPS, GRASPS_QUICK = 500, 100


def unit(rng) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def rotation(rng) -> np.ndarray:
    """A uniformly distributed rotation (3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def largest_load(problem: pg.ForceProblem) -> float:
    """Largest multiple of the problem's load that can be held; 0 where not even the load itself is."""
    return pg.forces.load_factor(problem, impact_time=IMPACT_TIME)


def surface_points(rng, k: int, placement: str, size: float, cylinder: bool) -> np.ndarray:
    """Contact points (k, 3) in the body's frame [m]."""
    if cylinder:
        angle, along = rng.uniform(0, 2 * np.pi, k), np.clip(rng.uniform(-2, 2, k) * size, -0.07, 0.07)
        if placement == "opposed":
            angle[0], angle[1:] = 0.0, np.pi + rng.uniform(-SPREAD, SPREAD, k - 1)
        return np.column_stack([size * np.cos(angle), size * np.sin(angle), along])
    outward = np.array([unit(rng) for _ in range(k)])
    if placement == "opposed":
        thumb = outward[0]
        for i in range(1, k):
            while outward[i] @ thumb > -np.cos(SPREAD):
                outward[i] = unit(rng)
    return size * outward


def grasp(rng, k: int, placement: str, kind: str) -> tuple[pg.ForceProblem, float]:
    """A random grasp with exact cones under a load of UNIT_LOAD, and the largest multiple of it that it holds."""
    while True:
        size, pose = rng.uniform(0.015, 0.04), np.eye(4)
        pose[:3, :3] = rotation(rng)
        cylinder = rng.random() < 0.5
        body = pg.Sphere(radius=size, mass=0.3, pose=pose)
        if cylinder:
            body = pg.Cylinder(radius=size, height=0.15, mass=0.3, pose=pose)
        points = surface_points(rng, k, placement, size, cylinder)
        load = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
        if kind == "wrench":
            load = np.concatenate([unit(rng), rng.uniform(0, 1) * size * unit(rng)])
        problem = pg.ForceProblem(
            contacts=pg.contacts_at(None, body, points @ pose[:3, :3].T),
            load=UNIT_LOAD * load,
            mu=rng.uniform(0.4, 0.8, k),
            acceleration_range=(1e-6, 1.0),
            friction=pg.Friction(model="cone"),
            max_depth=5e-3,
        )
        largest = largest_load(problem)
        if largest * UNIT_LOAD > LEAST_HELD:
            return problem, largest


def compared(problem: pg.ForceProblem, largest: float, share: float) -> list[tuple[float, float, str]] | None:
    """Per number of edges: energy over the cone's, largest load over the cone's, status. None: no certified optimum."""

    def least(friction):
        return pg.optimize_forces(
            replace(problem, load=share * largest * problem.load, friction=friction), IMPACT_TIME, objective="work"
        )

    cone = least(problem.friction)
    if cone.status is not pg.Status.OK:
        return None
    result = []
    for edges in EDGES:
        pyramid = pg.Friction(edges=edges)
        found = least(pyramid)
        held = largest_load(replace(problem, friction=pyramid)) / largest
        ratio = found.work / cone.work if found.status is pg.Status.OK else np.nan
        result.append((ratio, held, str(found.status)))
    return result


def rows_of(placement: str, kind: str, k: int, results: list) -> list[dict]:
    """Table rows, one per number of edges."""
    rows = []
    for j, edges in enumerate(EDGES):
        ratio, held = (np.array([r[j][column] for r in results]) for column in (0, 1))
        status = [r[j][2] for r in results]
        rejected = np.mean([s == "infeasible" for s in status])
        low, middle, high, tail = np.nanpercentile(ratio, [25, 50, 75, 95])
        rows.append(
            {
                "placement": placement,
                "load": kind,
                "contacts": k,
                "edges": edges,
                "grasps": len(results),
                "rejected": f"{rejected:.4f}",
                "rejected_standard_error": f"{np.sqrt(rejected * (1 - rejected) / len(results)):.4f}",
                "rejected_expected": f"{1 - held.mean():.4f}",
                "rejected_expected_standard_error": f"{held.std() / np.sqrt(len(results)):.4f}",
                "holds_none": f"{np.mean(held == 0):.4f}",
                "undecided": sum(s not in ("ok", "infeasible") for s in status),
                "energy_ratio_least": f"{np.nanmin(ratio):.6f}",
                "energy_ratio_quartile_1": f"{low:.4f}",
                "energy_ratio_median": f"{middle:.4f}",
                "energy_ratio_quartile_3": f"{high:.4f}",
                "energy_ratio_p95": f"{tail:.4f}",
                "energy_ratio_mean": f"{np.nanmean(ratio):.4f}",
            }
        )
    return rows


COLOURS = {4: "#D55E00", 8: "#0072B2", 16: "#009E73"}  # Okabe and Ito: told apart in every kind of colour vision
MARKERS = {4: "s", 8: "o", 16: "^"}


def draw(rows: list[dict], path: Path) -> None:
    """Energy ratio (median, quartiles, 95th percentile) and rejected share (with two standard errors) by contacts."""
    figure = Figure(figsize=(18, 9), layout="constrained")
    panels = figure.subplots(len(LOADS), 2 * len(PLACEMENTS), sharex=True)
    for line, kind in zip(panels, LOADS):
        for column, placement in enumerate(PLACEMENTS):
            energy, rejection = line[column], line[len(PLACEMENTS) + column]
            _panels(energy, rejection, [r for r in rows if (r["load"], r["placement"]) == (kind, placement)])
            energy.set_title(f"energy, {placement} contacts, load: {kind}")
            rejection.set_title(f"rejections, {placement} contacts, load: {kind}")
            energy.set_ylim(0.95, 2.6)
            rejection.set_ylim(0, 45)
        line[0].set_ylabel("least energy, pyramid / cone")
        line[len(PLACEMENTS)].set_ylabel("rejected though the cone holds it [%]")
    figure.suptitle(
        "What pyramids of 4, 8 and 16 edges cost. Energy: median, quartiles and 95th percentile (clipped). Rejections: "
        "loads uniform up to the cone's largest, two standard errors."
    )
    figure.savefig(path, dpi=90)


def _panels(energy, rejection, rows: list[dict]) -> None:
    for j, edges in enumerate(EDGES):
        own = [r for r in rows if r["edges"] == edges]
        x = np.arange(len(own)) + 0.25 * (j - 1)
        style = {"color": COLOURS[edges], "marker": MARKERS[edges], "linestyle": "none", "markersize": 8}
        style["label"] = f"{edges} edges"
        low, middle, high, tail = (
            np.array([float(r[f"energy_ratio_{name}"]) for r in own])
            for name in ("quartile_1", "median", "quartile_3", "p95")
        )
        energy.vlines(x, low, tail, color=COLOURS[edges], linewidth=1)
        energy.errorbar(x, middle, [middle - low, high - middle], elinewidth=5, markeredgecolor="white", **style)
        share = 100 * np.array([float(r["rejected_expected"]) for r in own])
        error = 200 * np.array([float(r["rejected_expected_standard_error"]) for r in own])
        rejection.errorbar(x, share, error, capsize=3, **style)
        for axes, values, digits in ((energy, middle, 2), (rejection, share, 1)):
            for a, b in zip(x, values):
                axes.annotate(f"{b:.{digits}f}", (a, b), (6, 0), textcoords="offset points", fontsize=8, va="center")
    energy.axhline(1.0, color="black", linewidth=0.8)
    for axes in (energy, rejection):
        axes.set_xticks(range(len(CONTACTS)), [f"{k} contacts" for k in CONTACTS])
        axes.set_xlim(-0.5, len(CONTACTS) - 0.4)
        axes.grid(alpha=0.3, axis="y")
        axes.legend(loc="upper right")


LIMITATIONS = """Known limitations:
- Random contacts on cylinders and spheres, not grasps that a hand or a planner chose.
- Shares depend on the distribution of loads; here uniform up to the largest load that the cone holds.
- One contact law, one impact time; mu uniform in 0.4 to 0.8."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the grasps")
    parser.add_argument("--out", type=Path, default=HERE / "friction_models.csv", help="table, and figure beside it")
    options = parser.parse_args()
    count = GRASPS_QUICK if options.quick else GRASPS
    groups = [(placement, kind, k) for placement in PLACEMENTS for kind in LOADS for k in CONTACTS]
    rows, uncertified = [], 0
    with tqdm(total=count * len(groups), unit="grasp", mininterval=1.0) as bar:
        for seed, (placement, kind, k) in enumerate(groups):
            bar.set_description(f"{placement}, {kind}, {k} contacts")
            rng = np.random.default_rng([SEED, seed])
            results = []
            for _ in range(count):
                problem, largest = grasp(rng, k, placement, kind)
                found = compared(problem, largest, rng.uniform(0, 1))
                bar.update()
                if found is None:
                    uncertified += 1
                else:
                    results.append(found)
            rows += rows_of(placement, kind, k, results)
    first_line = header(("numpy", "daqp", "clarabel", "qpsolvers"), "quick run" if options.quick else "full run")
    write_rows(options.out, first_line, rows)
    draw(rows, options.out.with_suffix(".png"))
    print(first_line)
    shown = []
    for r in rows:
        percent = {name: 100 * float(r[name]) for name in r if name.startswith("rejected")}
        rejected, error = percent["rejected"], percent["rejected_standard_error"]
        expected, its_error = percent["rejected_expected"], percent["rejected_expected_standard_error"]
        quartiles = f"({r['energy_ratio_quartile_1']} to {r['energy_ratio_quartile_3']})"
        shown.append(
            {
                **{name: r[name] for name in ("placement", "load", "contacts", "edges")},
                "rejected [%]": f"{rejected:.1f} +- {error:.1f}",
                "expected [%]": f"{expected:.2f} +- {its_error:.2f}",
                "energy ratio (quartiles)": f"{r['energy_ratio_median']} {quartiles}",
                "undecided": r["undecided"],
            }
        )
    print(table(shown))
    print(f"{uncertified} grasps left out: no certified optimum with the cone")
    print(LIMITATIONS)


if __name__ == "__main__":
    main()
