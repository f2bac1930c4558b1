"""Real taxels against load cells: forces of presses that were not calibrated with.

    python benchmarks/taxels.py [--skins DIR] [--jaws DIR] [--json]

``--skins``: a folder of logs of one taxel each, ``*.txt`` or ``*.txt.gz`` of two columns, raw counts of the load cell
and of the taxel, and ``calibration*.txt`` of the load cell (``no weight: COUNTS``, ``20g weight: COUNTS``), which holds
for the logs whose name begins with its ``resistance`` (``10k``); of the others forces stay in units of 1e6 counts of
their load cell. ``--jaws``: a folder of ``*probe.csv`` or ``.csv.gz``, a gripper's jaws that press on a body at places
told by the ``Probe_*`` columns, with a reference force (``Left``) of no stated unit and three-axis sensors in the body
(``F1-X1`` to ``F5-Z3``); the sensor's axis that tells the force of the calibrated presses best is the taxel.

Every second press calibrates, its lag between load cell and taxel included, the others are told, and the other way
round. Error: root mean square of the told forces of the presses, of counts within the curve; range: force at the end of
the curve, where the taxel is saturated or the log ends; as logged: the error without the lag. Within noise: share of
these forces that are off by less than two of the told standard deviations. Writes taxels.csv beside this file; the last
line is JSON with ``--json``. One to two minutes.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import itertools
import json
import re
from pathlib import Path

import numpy as np
from results import header, table, write_rows

from pinograsp.errors import InvalidInput
from pinograsp.identification import find_lag, identify_taxel
from pinograsp.spatial import Array, BoolArray, IntArray

HERE = Path(__file__).resolve().parent
PRESSED = 0.1  # of the largest force: a press
TOLD = 0.05  # of the range: forces whose error counts
GRAVITY = 9.80665  # [m/s^2]
FEWEST_PRESSES = 4  # fewer are no two halves
MOST_LAG = 12  # [samples]


def read_text(path: Path) -> str:
    return (gzip.open if path.suffix == ".gz" else open)(path, "rt", encoding="utf-8").read()


def number_presses(force: Array) -> IntArray:
    """Which press a sample is of (s,): they are parted in the middle of the rests between."""
    pressed = force > PRESSED * force.max()
    begins, ends = (np.flatnonzero(np.diff(pressed.astype(int)) == way) for way in (1, -1))
    cuts = [0, *((end + begin) // 2 for end, begin in zip(ends, begins[1:])), len(force)]
    return np.repeat(np.arange(len(cuts) - 1), np.diff(cuts))


def choose_taxel(raws: dict[str, Array], force: Array) -> tuple[str, int]:
    """The counts that tell the force best, and the lag."""
    found = []
    for name, raw in raws.items():
        try:
            lag = find_lag(raw, force, most=MOST_LAG)
        except InvalidInput:  # counts that do not follow the force
            continue
        calibration = identify_taxel(raw, force, lag=lag)
        found.append((float(calibration.noise.mean() / calibration.forces[-1]), name, lag))
    if not found:
        raise InvalidInput("expected counts that follow the force, got none")
    return min(found)[1:]


def find_errors(raw: Array, force: Array, chosen: BoolArray, lag: int) -> dict[str, Array]:
    """Of the presses that were not chosen, told by the calibration with those that were."""
    s, early, late = len(raw), max(-lag, 0), max(lag, 0)
    raw, force, chosen = (one[early : s - late] for one in (raw, np.roll(force, -lag), chosen))
    calibration = identify_taxel(raw[chosen], force[chosen])
    told, true = calibration.measure(raw[~chosen]), force[~chosen]
    end = float(calibration.forces[-1])
    rows = ~told.beyond & ~told.dead & (true > TOLD * end)
    off = (told.forces - true)[rows]
    apart = calibration.hysteresis or 0.0
    return {
        "off": off,
        "shares": off / end,
        "inside": np.abs(off) < 2 * told.noise[rows],
        "range": np.array([end]),
        "apart": np.array([apart / end]),
    }


def judge(log: str, unit: str, raws: dict[str, Array], force: Array) -> dict | None:
    """Both halves of the presses, each told by the calibration with the other."""
    presses = number_presses(force)
    if presses[-1] + 1 < FEWEST_PRESSES:
        return None
    halves, logged, names, lags = [], [], [], []
    for half in (0, 1):
        chosen = presses % 2 == half
        name, lag = choose_taxel({key: raw[chosen] for key, raw in raws.items()}, force[chosen])
        halves.append(find_errors(raws[name], force, chosen, lag))
        logged.append(find_errors(raws[name], force, chosen, 0))
        names.append(name)
        lags.append(lag)
    all_of = {key: np.concatenate([half[key] for half in halves]) for key in halves[0]}
    shares = np.concatenate([half["shares"] for half in logged])
    return {
        "log": log,
        "taxel": " or ".join(dict.fromkeys(names)),
        "presses": int(presses[-1]) + 1,
        "lag": " or ".join(dict.fromkeys(map(str, lags))),
        "unit": unit,
        "largest": f"{force.max():.3g}",
        "range": f"{all_of['range'].mean():.3g}",
        "error": f"{np.sqrt(np.mean(all_of['off'] ** 2)):.2g}",
        "of range": f"{100 * np.sqrt(np.mean(all_of['shares'] ** 2)):.1f} %",
        "hysteresis": f"{100 * all_of['apart'].mean():.0f} %",
        "within noise": f"{100 * all_of['inside'].mean():.0f} %",
        "as logged": f"{100 * np.sqrt(np.mean(shares**2)):.1f} %",
    }


def judge_skins(folder: Path) -> list[dict]:
    files = sorted(path for path in folder.iterdir() if re.search(r"\.txt(\.gz)?$", path.name))
    scales = {}
    for path in files:
        if path.name.startswith("calibration"):
            told = dict(re.findall(r"^(.+?): *(\S+)", read_text(path), re.M))
            empty, loaded = float(told["no weight"]), float(told["20g weight"])
            scales[told["resistance"].lower().removesuffix("ohm")] = empty, 0.020 * GRAVITY / (loaded - empty)
    rows = []
    for path in files:
        if path.name.startswith("calibration"):
            continue
        counts, raw = np.loadtxt(path, unpack=True)
        empty, scale = next((one for key, one in scales.items() if path.name.startswith(key)), (counts.min(), None))
        force = (counts - empty) * (1e-6 if scale is None else scale)
        unit = "N" if scale is not None else "1e6 counts"
        rows.append(judge(path.name.partition(".")[0], unit, {"taxel": raw}, force))
    return [row for row in rows if row is not None]


def judge_jaws(folder: Path) -> list[dict]:
    rows = []
    for path in sorted(path for path in folder.iterdir() if re.search(r"probe\.csv(\.gz)?$", path.name)):
        names, *cells = csv.reader(read_text(path).splitlines())
        first = next(i for i, name in enumerate(names) if name.startswith("Probe"))
        sensors = [i for i, name in enumerate(names) if re.fullmatch(r"F\d-[XYZ]\d", name)]
        places = [tuple(row[first:]) for row in cells]
        # A place is told by its columns; where it is taken up again, other presses follow.
        for place, group in itertools.groupby(range(len(cells)), key=places.__getitem__):
            samples = list(group)
            force = np.array([float(cells[i][names.index("Left")]) for i in samples])
            full = [j for j in sensors if all(cells[i][j] for i in samples)]
            raws = {names[j]: np.array([float(cells[i][j]) for i in samples]) for j in full}
            rows.append(judge(f"{path.name.partition('.')[0]} {' '.join(place)}", "not stated", raws, force))
    return [row for row in rows if row is not None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--skins", type=Path)
    parser.add_argument("--jaws", type=Path)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()

    rows = []
    for folder, judged in ((given.skins, judge_skins), (given.jaws, judge_jaws)):
        if folder is None or not folder.is_dir():
            print(f"{judged.__name__.removeprefix('judge_')}: no folder, left out")
            continue
        rows += judged(folder)
    if not rows:
        return
    first = header(["numpy", "scipy"], f"{len(rows)} logs")
    write_rows(HERE / "taxels.csv", first, rows)
    print(first)
    print(table(rows))
    if given.json:
        print(json.dumps({row["log"]: {key: row[key] for key in ("range", "error", "of range")} for row in rows}))


if __name__ == "__main__":
    main()
