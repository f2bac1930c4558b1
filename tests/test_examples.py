"""The examples, run as a reader would: from a folder of their own, by themselves."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
GALLERY = sorted((ROOT / "examples" / "gallery").glob("*/*.py"))
# What a reader looks for in what they print.
EXPECTED = {
    "00": ("ok t_I = 0.9167", "57.09 mJ", "peak torque"),
    "01": ("hand pincer: 4 joints, 2 fingers", "ok ["),
    "02": ("samples hold", "ok (", "peak torque"),
    "03": ("closed:", "mJ"),
    "04": ("hybrid     56.163", "convex     55.777"),
    "05": ("samples, the best of every 4", "ok ", "contacts"),
    "06": ("least motor heat", "the largest load that could be held"),
    "07": ("a step takes", "three times the load: infeasible"),
    "08": ("as planned: held", "mu 0.3 instead of 0.7: lost"),
    "09": ("36 plans", "ok"),
}
SLOW = ("01", "02", "03", "04", "05", "06", "08", "09")


def run(path: Path, folder: Path) -> str:
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, str(path)], cwd=folder, env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def test_the_sweep_file_runs(command):
    code, out, err = command("sweep", str(ROOT / "examples" / "sweep.yaml"), "--out", "rows", "--jobs", "1", "--json")
    told = json.loads(out)
    assert code == 0 and told["rows"] == told["done"] == told["counts"]["ok"] == 12, (out, err)
    assert "examples/sweep.yaml" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_examples_are_numbered_short_and_said_to_be_what_they_are():
    assert [path.name[:2] for path in EXAMPLES] == [f"{i:02d}" for i in range(10)]
    for path in EXAMPLES:
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) < 60 and lines[0].startswith('"""'), path.name


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.name[:2] in SLOW else []) for path in EXAMPLES],
)
def test_example_runs(path, tmp_path):
    told = run(path, tmp_path)
    for words in EXPECTED[path.name[:2]]:
        assert words in told, told
    if path.name.startswith("05"):  # the palm presses, or several links of a finger do: which, the optimum says
        assert "palm: " in told or "/" in told, told


def test_the_gallery_is_of_short_scripts():
    assert len(GALLERY) >= 35 and len({path.stem for path in GALLERY}) == len(GALLERY)
    for path in GALLERY:
        lines = path.read_text(encoding="utf-8").splitlines()
        assert 10 <= len(lines) <= 50 and max(map(len, lines)) <= 88, path.name
        assert lines[0] == '"""' and lines[2] == "=" * len(lines[1]) and lines[4].strip(), path.name


@pytest.mark.slow  # searches, plans, simulations and films
@pytest.mark.parametrize("path", GALLERY, ids=lambda path: path.stem)
def test_the_gallerys_scripts_draw_what_they_are_called_after(path, tmp_path):
    told = run(path, tmp_path).split()
    assert not {"doubtful", "infeasible", "lost"} & set(told), told
    (drawn,) = tmp_path.iterdir()
    assert drawn.stem == path.stem
    with Image.open(drawn) as image:
        assert min(image.size) >= 350
        assert len(image.convert("RGB").getcolors(image.width * image.height) or ()) > 20
