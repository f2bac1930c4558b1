"""Command lines: words, options and values of all commands, mixed, on small runs, cases and files; a few as real
processes.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np

from fuzzing import case_file, sweep_file
from fuzzing.harness import import_public_names
from fuzzing.material import NAMES, NUMBER_TEXTS, damage, dump_yaml, pick

EXIT_CODES = (0, 2, 3)
OBJECT, AT = "sphere:radius=0.02,mass=0.1", "0,0,0.105"
PLACED = ["--hand", "panda", "--object", OBJECT, "--at", AT]
CHECK = "check run --hold 0.02 --time-step 0.002".split()
STARTS = [
    *(["plan", *PLACED], ["close", *PLACED], CHECK, [*CHECK, "--push", "0,0,-1@0+0.01"]),
    *(
        line.split()
        for line in (
            "plan case.yaml",
            "plan case.yaml --set object.mass=1.1 --json",
            "hands panda",
            "hands panda --root panda_leftfinger --json",
            "report run",
            "view run --html page.html",
            "sweep sweep.yaml --jobs 1",
            "export run --csv out.csv --ros2 out.json --rate 100",
            "new new.yaml",
            "--version",
            "--help",
            "--quiet hands panda",
        )
    ),
]
OPTIONS = [
    "",
    *"""
    --json --csv --ros2 --mujoco --start --lead --goal --compare --sweep --quiet -q --verbose -v -h --help --version
    --force --wrap --hulls --prescribed --no-browser -- - --hold --push --shake --mu --mass --offset --turn
    --start-error --time-step --seed --out --set --safety --friction --search --balance --measure --solver --hand
    --object --at --root --jobs --executor --scheduler --contacts --port --html --check --samples --monte-carlo
    --nothing run case.yaml sweep.yaml paper
    """.split(),
]
VALUES = [
    *(*NUMBER_TEXTS, *NAMES, "\x1b[2J", "\udcff", OBJECT, AT),
    *"""
    0,0,0 0,0,1 1,2 nan,0,0 0,0,1e308 1e308,1e308,1e308 0,0,-1@0.5+0.2 0,0,-1@nan+1 @ 0,0,1@ 0,0,1@1e308 ,,
    0,0,0.1,0,0,45 a=1 a.b=1 = object.mass=nan object.mass=1e308 friction.mu=[ contacts.0.point_mm=[1,2]
    mujoco pinocchio cone soft pyramid glue convex hybrid paper paper+qp wrench force work impulse
    daqp clarabel quadprog gurobi panda humanoid nobody joblib dask nonsense tcp://127.0.0.1:99999
    run run/check case.yaml new new/deep/er pipe empty damaged page.html
    sphere:radius=nan,mass=1 sphere:radius=1e-300,mass=1 box:size=1x2,mass=1 box:size=0.03x0.03x0.05,mass=0.1
    mesh:path=nothing.stl,mass=1 cylinder:radius=0.02,height=1e308,mass=0.1 sphere: :
    """.split(),
]
_KEPT: dict[str, Path] = {}


def prepare() -> None:
    """A run and a check of it, made once and copied for every input."""
    import tempfile

    import_public_names()
    folder = Path(tempfile.mkdtemp(prefix="fuzzing-run-"))
    (folder / "case.yaml").write_bytes(dump_yaml(case_file.CONVEX))
    before = os.getcwd()
    os.chdir(folder)
    for line in (["plan", "case.yaml", "--out", "run", "--quiet"], [*CHECK, "--quiet"]):
        capture(line)
    os.chdir(before)
    _KEPT["run"] = folder / "run"


def make(rng: np.random.Generator, folder: Path):
    if _KEPT:
        shutil.copytree(_KEPT["run"], folder / "run")
    (folder / "case.yaml").write_bytes(dump_yaml(case_file.CONVEX))
    (folder / "sweep.yaml").write_bytes(dump_yaml(sweep_file.SWEEPS[1]))
    (folder / "empty").mkdir()
    (folder / "damaged").write_bytes(rng.bytes(100))
    os.mkfifo(folder / "pipe")
    if rng.random() < 0.15 and (folder / "run").is_dir():  # a run that is damaged
        path = pick(rng, sorted(path for path in (folder / "run").rglob("*") if path.is_file()))
        path.write_bytes(damage(rng, path.read_bytes()))
    line = list(pick(rng, STARTS))
    for _ in range(int(rng.choice([0, 1, 1, 1, 2, 3, 5]))):
        at, how = int(rng.integers(len(line) + 1)), rng.random()
        if how < 0.4:
            line[at:at] = [pick(rng, OPTIONS), pick(rng, VALUES)]
        elif how < 0.55:
            line.insert(at, pick(rng, OPTIONS))
        elif how < 0.85 and line:
            line[at % len(line)] = pick(rng, VALUES)
        elif line:
            del line[at % len(line)]
    return [word.replace("\0", "?") for word in line]


def _long(line: list[str]) -> bool:
    """Whether a line starts other processes, serves a page, or plans the whole case of the paper: not for here."""
    words = set(line)
    places = "--hand" in words and "--at" not in words
    return bool(
        places
        or words & {"--monte-carlo", "--thresholds", "--install-completion", "--show-completion"}
        or ("view" in words and "--html" not in words)
        or ("sweep" in words and "--jobs" not in words)
        or "--scheduler" in words
    )


def run(case) -> str:
    if _long(case):
        return "left out"
    code, out, err = capture(case)
    Path("pipe").unlink(missing_ok=True)  # folders of inputs that fail are copied
    if code not in EXIT_CODES or ("Traceback" in err and not {"-v", "--verbose"} & set(case)):
        raise AssertionError(f"exit code {code}: {err[-3000:]}")
    if "--json" in case and out.strip() and not {"-h", "--help", "--version"} & set(case):
        json.loads(out, parse_constant=lambda name: 1 / 0)
    if code and not err and not out and not (code == 3 and {"-q", "--quiet"} & set(case)):  # the code alone says it
        raise AssertionError(f"exit code {code} without a word")
    return f"exit {code}"


def capture(line: list[str]) -> tuple[int, str, str]:
    """Exit code, output and errors of a command line, run in this process."""
    from pinograsp import cli

    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    before, sys.argv = sys.argv, ["pinograsp", *line]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cli.run()
    finally:
        sys.argv = before
    told = []
    for stream in (out, err):
        stream.flush()
        told.append(stream.buffer.getvalue().decode("utf-8", "replace"))
    return code, *told
