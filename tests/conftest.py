from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
from zlib import crc32

import numpy as np
import pytest
from hypothesis import settings
from matplotlib.figure import Figure
from PIL import Image
from test_architecture import ROOMS, TESTS

from pinograsp.cases import load_case
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.cli import run as command_line
from pinograsp.contacts import Contact, ContactSet, Friction, contacts_at
from pinograsp.forces import ForceProblem
from pinograsp.hands.humanoid import FINAL_ANGLES_DEG
from pinograsp.objects import Cylinder
from pinograsp.spatial import pose_of, tangent_frame
from pinograsp.viz.raster import render_bands

# The same examples every time, and no clock in the verdict.
settings.register_profile("deterministic", derandomize=True, deadline=None)
settings.load_profile("deterministic")

# Where tests run in the background Ctrl-C is ignored, and processes that they start would ignore it as well.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Processes that tests start import the package that is tested, not the sources in the folder where they happen to run:
# these would be compiled once more, and counted twice.
os.environ["PYTHONSAFEPATH"] = "1"

# In parallel tests every process has one core to itself: that is what "all cores" means there.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")


def _part(text: str) -> tuple[int, int]:
    part, parts = map(int, text.split("/"))
    if not 0 <= part < parts:
        raise ValueError(text)
    return part, parts


def pytest_addoption(parser):
    parser.addoption(
        "--fuzz-seed",
        type=int,
        default=secrets.randbelow(10**9),
        help="seed of the hostile inputs (default: a fresh one)",
    )
    parser.addoption("--fuzz-count", type=int, default=3000, help="hostile inputs of each kind")
    parser.addoption("--share", type=float, default=1.0, help="share of what slow tests repeat")
    parser.addoption("--part", type=_part, default=(0, 1), metavar="I/N", help="of slow tests, part I of N (from 0)")


def pytest_report_header(config):
    return (
        f"hostile inputs: --fuzz-seed {config.getoption('--fuzz-seed')} --fuzz-count {config.getoption('--fuzz-count')}"
    )


def height(item) -> int:
    """Where the room of a test stands in the order of rooms; tests of no single room stand above all."""
    place = item.path.relative_to(TESTS).parts[0]
    room = place.removeprefix("test_").removesuffix(".py")
    return ROOMS.index(room) if room in ROOMS else len(ROOMS)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """The upper rooms first: their tests take longest. Of slow tests, those of the part that is asked for."""
    part, parts = config.getoption("--part")
    items[:] = [
        item for item in items if not item.get_closest_marker("slow") or crc32(item.nodeid.encode()) % parts == part
    ]
    items.sort(key=height, reverse=True)


# The paper's printed contact points, written out again: tests do not share the package's tables.
POINTS = {"thumb": (-2.6e-3, -9.6e-3, 61.5e-3), "index": (4.7e-3, 8.8e-3, 71.0e-3), "middle": (1.7e-3, 9.7e-3, 50.0e-3)}
PUBLISHED_FORCES = (9.873, 6.35, 4.7)


def around_cylinder(rng, k: int, radius: float, jitter: float = 0.3) -> np.ndarray:
    """Points (k, 3) around a cylinder of that radius, at irregular distances and heights."""
    angle = np.linspace(0, 2 * np.pi, k, endpoint=False) + rng.uniform(-jitter, jitter, k)
    return radius * np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.7, 0.7, k)])


@pytest.fixture
def often(request):
    """How often a slow test repeats itself: its own number, times ``--share``."""
    return lambda count: max(1, round(count * request.config.getoption("--share")))


@pytest.fixture(scope="session")
def paper_case():
    """The case study with the paper's own choices: forces alone in balance, friction up to its limit."""
    return load_case("paper", AS_PUBLISHED)


@pytest.fixture(scope="session")
def paper_plan(paper_case):
    return paper_case.plan()


@pytest.fixture(scope="session")
def hand(paper_case):
    return paper_case.load_hand()


@pytest.fixture(scope="session")
def cylinder():
    return Cylinder(radius=0.01, height=0.12, mass=1.02, pose=pose_of([0, 0, 0.06]))


@pytest.fixture(scope="session")
def contacts(hand, cylinder):
    return contacts_at(hand, cylinder, POINTS)


@pytest.fixture(scope="session")
def make_problem(cylinder, contacts):
    def make(**settings):
        paper = {
            "mu": 0.7,
            "balance": "force",
            "friction": Friction(),
            "max_depth": 5e-3,
            "acceleration_range": (0.01, 1.0),
        }
        return ForceProblem.holding(cylinder, contacts, **{**paper, **settings})

    return make


@pytest.fixture(scope="session")
def final_angles():
    return {finger: np.radians(angles) for finger, angles in FINAL_ANGLES_DEG.items()}


def make_contacts(points, frames, com=(0.0, 0.0, 0.0), fingers=None, links=None, lengths=None) -> ContactSet:
    """Contacts at points (k, 3) with frames (k, 3, 3), or the inward normals (k, 3) that tell them; of no hand."""
    count = len(points)
    return ContactSet(
        contacts=tuple(
            Contact(
                finger=finger,
                link=link,
                point_o=np.asarray(point, dtype=float),
                rotation_oc=tangent_frame(frame) if np.ndim(frame) == 1 else frame,
                length=length,
                distance=0.0,
            )
            for point, frame, finger, link, length in zip(
                points,
                frames,
                fingers or [f"finger {i + 1}" for i in range(count)],
                links or [""] * count,
                lengths or [None] * count,
            )
        ),
        com_o=np.asarray(com, dtype=float),
    )


@pytest.fixture(scope="session")
def contact_set():
    """Build contacts from (finger, link, point, inward normal, length) tuples."""

    def make(rows, com=(0.0, 0.0, 0.0)):
        fingers, links, points, normals, lengths = zip(*rows)
        return make_contacts(points, normals, com, fingers, links, lengths)

    return make


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """The command line in this process and an empty folder: arguments -> (exit code, stdout, stderr)."""

    def run(*args):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["pinograsp", *args])
        code = command_line()
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    return run


@pytest.fixture
def no_rendering(monkeypatch):
    """Figures are put together, and saved as one dot: for commands of which only the answer is looked at.

    In pictures of grasps no surface is drawn.
    """
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: Image.new("1", (1, 1)).save(path))
    monkeypatch.setattr("pinograsp.viz.still.render_bands", lambda surfaces, *others: render_bands([], *others))


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own that is soon full: size in KiB -> its folder."""
    made = []

    def make(size: int):
        disk = tmp_path / f"disk{len(made)}"
        disk.mkdir()
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}k", "none", str(disk)], capture_output=True, text=True
        )
        if done.returncode:
            pytest.skip(f"file systems cannot be mounted here: {done.stderr.strip()}")
        made.append(disk)
        return disk

    yield make
    for disk in made:
        subprocess.run(["umount", "-l", str(disk)], check=True)
