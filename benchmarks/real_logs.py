"""A real finger's closings on a stop: peaks of conditions that were not logged, and the touch under a cap.

    python benchmarks/real_logs.py --train DIR [--test DIR] [--newtons 0.006452 0.018] [--caps 1 2 4 6] [--json]

A folder has files ``speedS_forceL.csv`` or ``.csv.gz``: closings at the commanded speed S until the force limit L, in
the registers of an Inspire RH56 hand, with columns ``Experiment_Elapsed_s``, ``Middle_Angle``, ``Middle_Force_g``,
``Commanded_Speed`` and ``Force_Limit_g``. Without ``--test`` each condition whose neighbours were logged is left out
once and predicted from the others. The touch advised for a cap is judged by the fastest measured condition that is no
faster and has its limit. Writes real_logs.csv beside this file; the last line is JSON with ``--json``.
"""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from results import header, table, write_rows

from pinograsp.errors import InvalidInput
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.identification import Log, identify_closings, read_log

HERE = Path(__file__).resolve().parent
COLUMNS = {
    "time": "Experiment_Elapsed_s",
    "position": "Middle_Angle",
    "force": "Middle_Force_g",
    "speed": "Commanded_Speed",
    "limit": "Force_Limit_g",
}
NAME = re.compile(r"speed(\d+)_force(\d+)\.csv(\.gz)?$")
SAFE = 0.95  # of the trials under a cap


def read_folder(folder: Path) -> list[Log]:
    files = sorted(file for file in folder.iterdir() if NAME.match(file.name))
    if not files:
        raise InvalidInput(f"{folder}: expected files speedS_forceL.csv or .csv.gz, got none")
    return [read_log(file, columns=COLUMNS, units={"position": "count", "force": "count"}) for file in files]


def leave_out(whole: ClosingTable, i: int) -> ClosingTable:
    columns = {field.name: getattr(whole, field.name) for field in fields(whole) if field.name != "unit"}
    return replace(whole, **{name: values[:i] + values[i + 1 :] for name, values in columns.items()})


def compare(trained: ClosingTable, measured: ClosingTable, leaving_out: bool) -> list[dict]:
    rows = []
    for i, (speed, limit, peak) in enumerate(zip(measured.speeds, measured.limits, measured.peaks)):
        try:
            told = (leave_out(trained, i) if leaving_out else trained).predict(speed, limit)
        except InvalidInput:  # at the edge of what was tried
            continue
        rows.append(
            {
                "speed": f"{speed:g}",
                "limit": f"{limit:g}",
                "measured": f"{peak:.4g}",
                "told": f"{told.value:.4g}",
                "low": f"{told.low:.4g}",
                "high": f"{told.high:.4g}",
                "error": f"{100 * abs(told.value / peak - 1):.1f} %",
                "inside": told.low <= peak <= told.high,
            }
        )
    return rows


def judge_touches(trained: ClosingTable, caps: list[float], peaks: dict[tuple[float, float], np.ndarray]) -> dict:
    """By cap: what is advised, and what all that was measured says of it."""
    judged = {}
    for cap in caps:
        keeping = {pair: float(np.mean(values <= cap)) for pair, values in peaks.items()}
        fastest = max((speed for (speed, _), share in keeping.items() if share >= SAFE), default=None)
        try:
            touch = trained.find_touch(cap)
        except InvalidInput as error:
            judged[f"{cap:g}"] = {"speed": None, "why": str(error), "fastest_measured": fastest}
            continue
        slower = max(pair for pair in peaks if pair[0] <= touch.speed and pair[1] == touch.limit)
        judged[f"{cap:g}"] = {
            "speed": touch.speed,
            "limit": touch.limit,
            "kept": keeping[slower],
            "fastest_measured": fastest,
        }
    return judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", type=Path, required=True)
    parser.add_argument("--test", type=Path)
    parser.add_argument("--newtons", type=float, nargs=2, default=(0.006452, 0.018), metavar=("SLOPE", "OFFSET"))
    parser.add_argument("--caps", type=float, nargs="*", default=[1.0, 2.0, 4.0, 6.0])
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()

    train = read_folder(given.train)
    found = identify_closings(train, newtons=given.newtons)
    tested = None if given.test is None else identify_closings(read_folder(given.test), newtons=given.newtons)
    rows = compare(found.table, (tested or found).table, leaving_out=tested is None)
    errors = np.array([float(row["error"].removesuffix(" %")) / 100 for row in rows])
    inside = float(np.mean([row["inside"] for row in rows]))
    peaks = {**found.peaks, **(tested.peaks if tested else {})}
    touches = judge_touches(found.table, given.caps, peaks)

    first = header(["numpy", "scipy"], f"{len(train)} logs, newtons {given.newtons[0]:g} r {given.newtons[1]:+g}")
    write_rows(HERE / "real_logs.csv", first, rows)
    print(first)
    print(table(rows))
    print(
        f"\n{len(rows)} conditions: median error {100 * np.median(errors):.1f} %, worst {100 * errors.max():.1f} %, ",
        end="",
    )
    print(f"{100 * inside:.0f} % of the medians inside the told interval")
    for cap, touch in touches.items():
        print(f"cap {cap} N: " + ", ".join(f"{key} {value}" for key, value in touch.items()))
    if given.json:
        figures = {
            "conditions": len(rows),
            "median_error": round(float(np.median(errors)), 4),
            "worst_error": round(float(errors.max()), 4),
            "inside_interval": round(inside, 4),
            "touches": touches,
        }
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
