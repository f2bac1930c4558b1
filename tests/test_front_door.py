"""The front door: what the pages use of it is there in a fresh interpreter, and slips of the pen are told."""

from __future__ import annotations

import doctest
import inspect
import operator
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pinograsp as pg

ROOT = Path(__file__).resolve().parent.parent


def names_in_pages() -> list[str]:
    """Everything that README, docs and examples call by ``pg.``."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.py")]
    texts = [page.read_text(encoding="utf-8") for page in pages if "build" not in page.parts]
    return sorted({name for text in texts for name in re.findall(r"\bpg\.([A-Za-z]\w*(?:\.[A-Za-z]\w*)?)", text)})


def fresh(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def test_what_the_pages_use_is_there_in_a_fresh_interpreter():
    """Names within rooms first: nothing else has loaded their rooms then."""
    rooms = {path.name.partition(".")[0] for path in (ROOT / "pinograsp").iterdir()}
    names = sorted(names_in_pages(), key=lambda name: name.partition(".")[0] not in rooms)
    assert len(names) >= 30 and "spatial.pose_of" in names
    done = fresh(
        f"""
import functools
import pinograsp as pg
for name in {names}:
    functools.reduce(getattr, name.split("."), pg)
"""
    )
    assert done.returncode == 0, done.stderr


def test_every_room_is_there():
    rooms = [path.stem for path in (ROOT / "pinograsp").glob("*.py") if path.stem[0] != "_"]
    rooms += [path.parent.name for path in (ROOT / "pinograsp").glob("*/__init__.py")]
    done = fresh(f"import pinograsp as pg; print([pg.__name__ + getattr(pg, name).__name__ for name in {rooms}])")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "slip, meant",
    [("find_grasp", "find_grasps"), ("Spere", "Sphere"), ("load_hands", "load_hand"), ("spacial", "spatial")],
)
def test_a_slip_of_the_pen_is_told(slip, meant):
    with pytest.raises(AttributeError, match=f"'{slip}': did you mean '{meant}'"):
        getattr(pg, slip)


def test_the_reference_lists_every_name():
    page = (ROOT / "docs" / "reference" / "names.md").read_text(encoding="utf-8")
    listed = re.findall(r"^   ~(pinograsp\.[\w.]+)$", page, re.M)
    assert sorted(path.rpartition(".")[2] for path in listed) == pg.__all__
    for path in listed:
        assert operator.attrgetter(path.removeprefix("pinograsp."))(pg) is getattr(pg, path.rpartition(".")[2]), path


SLOW = {"plan_pick"}  # searches for grasps and paths


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in SLOW)) for one in pg.__all__])
def test_the_example_of_a_name_prints_what_it_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(getattr(pg, name))
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples
    assert "See Also:" in text
    told: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.REPORT_NDIFF).run(example, out=told.append)
    assert not told, "".join(told)


def test_what_a_name_points_to_is_there():
    for name in pg.__all__:
        _, _, also = inspect.getdoc(getattr(pg, name)).partition("See Also:")
        targets = re.findall(r":(?:class|func|meth|mod):`~?pinograsp\.([\w.]+)`", also)
        assert targets, name
        for target in targets:
            operator.attrgetter(target)(pg)
