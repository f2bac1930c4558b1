"""The front door: what the pages use of it is there in a fresh interpreter, and slips of the pen are told."""

from __future__ import annotations

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
