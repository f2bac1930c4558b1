"""Moving pictures: the fingers close, the forces grow, and the last picture stays."""

from __future__ import annotations

import shutil
import sys
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from pinograsp.cases import load_case
from pinograsp.errors import ExtraMissing, InvalidInput, ResultsNotWritten
from pinograsp.planner import GraspPlan, save_run
from pinograsp.viz.film import choose_frames
from pinograsp.viz.scene import make_scene
from pinograsp.viz.scene_meshes import rgb


@pytest.fixture(scope="module")
def plan() -> GraspPlan:
    return load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"}).plan()


@pytest.fixture(scope="module")
def film(plan, tmp_path_factory):
    return plan.film(tmp_path_factory.mktemp("film") / "grasp.gif", seconds=1.0, progress=False)


def pictures(path) -> list[np.ndarray]:
    with Image.open(path) as film:
        found = []
        for i in range(film.n_frames):
            film.seek(i)
            found.append(np.asarray(film.convert("RGB")) / 255)
        return found


@pytest.mark.slow
def test_films_show_all_of_the_motion_and_most_of_the_squeeze(plan):
    scene = make_scene(plan)
    frames = choose_frames(scene, 60)
    touch, last = scene.frame_at(scene.touch), len(scene.times) - 1
    assert len(frames) == 60 and frames[0] == 0 and np.all(np.diff(frames) >= 0)
    assert 11 <= (frames == last).sum() <= 14
    # The squeeze takes a tenth of the plan, and a third of what moves.
    assert scene.times[last] - scene.touch < 0.15 * scene.times[last]
    assert 0.3 < (frames[frames < last] >= touch).mean() < 0.5


@pytest.mark.slow
def test_a_film_moves_and_its_arrows_grow(plan, film):
    with Image.open(film) as made:
        assert made.size == (480, 360) and made.info["loop"] == 0
        durations = []
        for i in range(made.n_frames):
            made.seek(i)
            durations.append(made.info["duration"])
    assert sum(durations) == pytest.approx(1000, abs=80) and film.stat().st_size < 5e5
    found = pictures(film)
    moved = [(np.abs(a - b).max(axis=2) > 0.1).mean() for a, b in pairwise(found)]
    assert moved[0] < 0.2 and max(moved) > 5e-3
    colours = [rgb(colour) / 255 for colour in make_scene(plan).colours]

    def coloured(picture) -> int:
        return sum(int((np.abs(picture - colour).max(axis=2) < 0.12).sum()) for colour in colours)

    assert coloured(found[-1]) > 2 * coloured(found[0])
    border = np.concatenate([found[-1][0], found[-1][-1]])
    assert border.min() > 0.6  # nothing is cut off


@pytest.mark.slow
def test_films_say_what_they_expect(plan, tmp_path, monkeypatch):
    with pytest.raises(InvalidInput, match=r"\.gif or \.mp4.*picture"):
        plan.film(tmp_path / "grasp.png")
    for seconds in (0.1, 1e3, np.nan, "long"):
        with pytest.raises(InvalidInput, match="seconds"):
            plan.film(tmp_path / "grasp.gif", seconds=seconds)
    with pytest.raises(InvalidInput, match="view"):
        plan.film(tmp_path / "grasp.gif", view="left")
    with pytest.raises(ResultsNotWritten):
        plan.film("/proc/nothing/here.gif", seconds=0.5, progress=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ExtraMissing, match="ffmpeg"):
        plan.film(tmp_path / "grasp.mp4")


@pytest.mark.slow
def test_films_are_written_as_mp4_where_ffmpeg_is(plan, tmp_path):
    if shutil.which("ffmpeg") is None:
        pytest.importorskip("imageio_ffmpeg", reason="films as .mp4 need ffmpeg: pip install 'pinograsp[viz]'")
    path = plan.film(tmp_path / "grasp.mp4", seconds=0.5, progress=False)
    content = path.read_bytes()
    assert content[4:8] == b"ftyp" and b"avc1" in content and len(content) < 1e6


@pytest.mark.slow
def test_a_film_of_four_seconds_is_small(plan, tmp_path):
    assert plan.film(tmp_path / "grasp.gif", progress=False).stat().st_size < 2e6


@pytest.mark.slow
def test_view_writes_pictures_by_their_suffix(command, plan, tmp_path):
    save_run(plan.with_margins().with_reach(), tmp_path / "a")
    code, out, err = command("view", "a", "--png", "grasp.png", "--from", "side")
    assert code == 0 and "written to grasp.png" in out, err
    first = (tmp_path / "grasp.png").read_bytes()
    code, _, err = command("view", "a", "--png", "grasp.png")
    assert code == 2 and "--png" in err and "--force" in err
    assert command("view", "a", "--png", "grasp.png", "--from", "1,0.2,0.3", "--force")[0] == 0
    assert (tmp_path / "grasp.png").read_bytes() != first
    for arguments, word in (
        (("--png", "grasp.jpg"), ".svg"),
        (("--png", "b.png", "--from", "left"), "front"),
        (("--png", "b.png", "--from", "1,x"), "--from"),
        (("--from", "top"), "--png"),
    ):
        code, _, err = command("view", "a", *arguments)
        assert code == 2 and word in err
