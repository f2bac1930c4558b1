"""Reports and figures of a run: the answer first, one file without a network, figures that show what the run says."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.report import headline, markdown, page, write_report
from pinograsp.storage import newest_check, run_of, save_run
from pinograsp.viz import figures
from pinograsp.viz.figures import save_figures

CHANGES = {"forces.search": "convex", "forces.balance": "wrench", "friction.safety": 1.2}


@pytest.fixture(scope="module")
def run():
    case = pg.load_case("paper", CHANGES)
    return run_of(case.plan(), case.settings())


class Page(HTMLParser):
    """Tags, what they refer to, and the text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.texts = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.texts.append(data)


def test_the_answer_comes_first(run):
    lines = headline(run)
    assert [re.match(r"\*\*(.*?)\*\*", line).group(1) for line in lines] == [
        "Does it hold?", "How hard?", "How much energy?", "Which margin?", "Simulated?",
    ]  # fmt: skip
    assert "Yes" in lines[0] and f"{sum(run.summary['normal_forces_N'].values()):.2f} N" in lines[1]
    assert f"{1e3 * run.summary['work_J']:.2f} mJ" in lines[2] and "proven" in lines[2]
    assert f"{run.summary['margins']['load_factor']:.3g} times" in lines[3] and "pinograsp check" in lines[4]
    lost = {"held": False, "engine": "mujoco", "reason": "it fell", "force_error": 0.5}
    assert "Lost (mujoco): it fell" in headline(run, lost)[4]
    for changes, expected in (
        ({"balance": "force"}, "moments are not balanced"),
        ({"status": "unbalanced"}, "Almost"),
        ({"status": "joint_limit", "remedy": "Move it."}, "not complete (joint_limit): Move it."),
    ):
        assert expected in headline(replace(run, summary=run.summary | changes))[0]


def test_the_page_needs_nothing_else(run, tmp_path):
    names = [path.name for path in save_figures(run, tmp_path)]
    write_report(run, tmp_path, names)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    made = Page(text)
    assert made.links and all(link.startswith("data:image/png;base64,") for link in made.links)
    assert made.tags.count("img") == made.tags.count("figure") == made.tags.count("figcaption") == len(names) >= 10
    assert "script" not in made.tags and text.count("<table>") >= 4 and "width=device-width" in text and "@media print" in text
    # All that the Markdown says, the page says.
    told = " ".join(made.texts)
    for words in re.findall(r"\| ([a-z][\w ,.()-]+) \|", (tmp_path / "report.md").read_text()):
        assert words.strip() in told, words


def test_what_a_user_typed_is_text_in_the_page(run, tmp_path):
    wicked = replace(run, settings={"name": "<script>alert(1)</script>", "note": "a | b"})
    text = page(markdown(wicked), tmp_path)
    assert "<script>" not in text


def test_report_again_with_the_newest_check(run, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from pinograsp.cli import app

    folder = save_run(run, tmp_path / "run")
    assert newest_check(folder) is None
    result = CliRunner().invoke(app, ["report", str(folder)])
    assert result.exit_code == 0 and (folder / "report.html").is_file() and "report.html" in (folder / "files.txt").read_text().split()
    save_run(run, folder, force=True)  # it knows the files as its own
    result = CliRunner().invoke(app, ["check", str(folder), "--hold", "0.3", "--out", str(folder / "check")])
    assert result.exit_code in (0, 3)
    assert newest_check(folder) == folder / "check"
    assert CliRunner().invoke(app, ["report", str(folder)]).exit_code == 0
    assert re.search(r"Simulated\?\*\* (Held|Lost) \(mujoco\)", (folder / "report.md").read_text())
    assert not list(folder.glob(".new-*"))


def test_energy_figure_ends_at_the_plans_energy(run):
    """Trapezoids over 100 samples: within a thousandth."""
    work, impulse = figures.grasp_energy(run).axes
    for axes, expected in ((work, 1e3 * run.summary["work_J"]), (impulse, run.summary["impulse_Ns"])):
        ends = [line.get_ydata()[-1] for line in axes.get_lines()]
        assert ends[-1] == pytest.approx(expected, rel=2e-3) and sum(ends[:-1]) == pytest.approx(ends[-1])


def test_friction_figure_agrees_with_the_forces(run):
    axes = figures.friction_use(run).axes[0]
    for line, (name, force), mu in zip(axes.get_lines(), run.summary["contact_forces_N"].items(), run.arrays["mu"]):
        assert line.get_label() == name
        assert line.get_ydata()[-1] == pytest.approx(100 * np.hypot(*force[:2]) / (mu * force[2]), rel=1e-6)


def test_margin_figure_shows_what_load_margin_says(run):
    case = pg.load_case("paper", CHANGES)
    plan = case.plan()
    problem = replace(plan.problem, friction=replace(plan.problem.friction, safety=1.0))
    directions, margins = run.arrays["margin_directions"], run.arrays["margin_forces"]
    assert directions.shape == (*margins.shape, 3) and np.linalg.norm(directions, axis=2) == pytest.approx(1.0)
    for plane in range(3):
        for i in (0, 7, 20):
            wrench = np.append(directions[plane, i], np.zeros(3))
            held = pg.load_margin(problem, wrench, normal_forces=plan.forces.normal_forces)
            assert margins[plane, i] == pytest.approx(max(0.0, held), abs=1e-6)
    panels = figures.wrench_margin(run).axes
    assert len(panels) == 3 and np.hypot(*panels[0].get_lines()[0].get_data()).max() == pytest.approx(margins[0].max())
    old = replace(run, arrays={name: value for name, value in run.arrays.items() if not name.startswith("margin")})
    with pytest.raises(InvalidInput, match="plan it again"):
        figures.wrench_margin(old)


def test_search_figure_brackets_the_optimum(run):
    map_, gap = figures.search_over_time(run).axes
    assert gap.get_lines()[0].get_ydata()[-1] == pytest.approx(run.summary["certificate"]["primal"], rel=1e-6)
    with pytest.raises(InvalidInput, match="convex"):
        figures.search_over_time(replace(run, arrays=run.arrays | {"branches": np.zeros((0, 4))}))


def test_rates_are_the_angles_derivatives(run):
    angles, rates = figures.joint_angles(run), figures.joint_rates(run)
    for a, r in zip(angles.axes, rates.axes):
        for angle, rate in zip(a.get_lines(), r.get_lines()):
            if len(angle.get_xdata()) > 10:
                slope = np.gradient(angle.get_ydata(), angle.get_xdata())
                assert np.abs(slope - rate.get_ydata())[5:-5].max() <= 0.02 * max(1.0, np.abs(rate.get_ydata()).max())


def test_sweep_maps():
    mu, mass = (grid.ravel() for grid in np.meshgrid([0.5, 0.6, 0.7], [0.8, 1.0]))
    columns = {"friction.mu": mu, "object.mass": mass, "work_J": [1.0, None, 3.0, 4.0, 5.0, float("nan")]}
    figure = figures.sweep_map(columns, "work_J", "friction.mu", "object.mass")
    assert isinstance(figure, Figure)
    drawn = np.ma.filled(figure.axes[0].collections[0].get_array().reshape(2, 3), -1.0)
    assert drawn.tolist() == [[1.0, -1.0, 3.0], [4.0, 5.0, -1.0]]
    line = figures.sweep_map(columns, "work_J", "friction.mu").axes[0].get_lines()[0]
    assert np.all(np.diff(line.get_xdata()) >= 0)
    with pytest.raises(InvalidInput, match="did you mean"):
        figures.sweep_map(columns, "work", "friction.mu")
