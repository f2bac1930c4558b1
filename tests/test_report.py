"""Reports and figures of a run: the answer first, one file without a network, figures that show what the run says."""

from __future__ import annotations

import base64
import re
from dataclasses import fields, is_dataclass, replace
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure

import pinograsp as pg
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import disturbance_margin
from pinograsp.handover import joint_trajectory
from pinograsp.plan import PlanRecord
from pinograsp.plan.answer import disturbance_held, does_it_hold, friction_used
from pinograsp.planner import save_run
from pinograsp.report import Finding, Picture, Report, answer_questions, list_results, report_plan, write_report
from pinograsp.simulation import simulate
from pinograsp.storage import newest_check
from pinograsp.viz import figures
from pinograsp.viz.figures import save_figures
from pinograsp.viz.scene import make_scene
from pinograsp.words import format_fixed, format_number, printable

CHANGES = {"forces.search": "convex", "forces.balance": "wrench", "friction.safety": 1.2}


@pytest.fixture(scope="module")
def run():
    return pg.load_case("paper", CHANGES).plan().with_margins().with_reach()


@pytest.fixture(scope="module")
def simulated(run):
    """Simulations that held, that lost, and that lost with less friction than planned."""
    real = simulate(run, hold=0.01, time_step=1e-3, letting_go=0.01)
    held = replace(real, verdict=replace(real.verdict, held=True, reason="0.1 mm"))
    lost = replace(held, verdict=replace(real.verdict, held=False, reason="it fell"))
    return {"held": held, "lost": lost, "disturbed": replace(lost, disturbance={"mu": 0.1}), None: None}


def ended(plan: PlanRecord, status: Status, remedy: str = "") -> PlanRecord:
    """The same plan with another end of its motion, or of its forces."""
    if status is Status.UNBALANCED:
        return replace(plan, forces=replace(plan.forces, status=status))
    return replace(plan, motion=replace(plan.motion, status=status, remedy=remedy))


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


def answers(plan, simulation=None) -> dict[str, str]:
    """The main results by question, in their order."""
    return {one.question: one.text for one in answer_questions(plan, simulation)}


@pytest.mark.parametrize("judged", [does_it_hold, lambda run, simulation: report_plan(run, (), simulation)])
def test_what_is_no_simulation_is_refused(run, judged):
    with pytest.raises(InvalidInput, match="simulation: expected a Simulation or None"):
        judged(run, run)


def test_the_answer_comes_first(run, simulated):
    told = answers(run)
    assert list(told) == [
        "Does it hold?",
        "What does it withstand?",
        "How hard?",
        "How much energy?",
        "How much margin?",
        "Simulated?",
        "Where is the hand?",
    ]
    assert "Barely: " in told["Does it hold?"] and f"{run.forces.normal_forces.sum():.2f} N" in told["How hard?"]
    bears = told["What does it withstand?"]
    assert f"A push of {format_number(run.margins.disturbance_force, 3)} N" in bears and "m/s2" in bears
    assert "none: planned for the load alone" in bears
    millijoules = f"{1e3 * run.forces.work:.2f} mJ by Eq. (9), rho + 1 = 2.5 times the contacts' "
    assert f"{millijoules}{format_number(1e3 * run.forces.work / 2.5)} mJ" in told["How much energy?"]
    assert "proven" in told["How much energy?"] and f"{run.margins.load_factor:.3g} times" in told["How much margin?"]
    assert "pinograsp check" in told["Simulated?"]
    assert "Lost: it fell" in answers(run, simulated["lost"])["Simulated?"]
    for changed, expected in (
        (replace(run, balance="force"), "moments are not balanced"),
        (ended(run, Status.UNBALANCED), "Almost"),
        (ended(run, Status.JOINT_LIMIT, "Move it."), "not complete (joint_limit): Move it."),
    ):
        assert expected in answers(changed)["Does it hold?"]
    with pytest.raises(InvalidInput, match=r"with its margins.*plan.with_margins\(\)"):
        answer_questions(replace(run, margins=None))


@pytest.mark.slow
def test_the_page_needs_nothing_else(run, tmp_path, no_rendering):
    names = [path.name for path in save_figures(run, tmp_path)]
    write_report(run, tmp_path, names)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    made = Page(text)
    assert made.links and all(link.startswith("data:image/png;base64,") for link in made.links)
    assert made.tags.count("img") == made.tags.count("figure") == made.tags.count("figcaption") == len(names) >= 10
    assert (
        "script" not in made.tags
        and text.count("<table>") >= 4
        and "width=device-width" in text
        and "@media print" in text
    )
    # All that the Markdown says, the page says.
    told = " ".join(made.texts)
    for words in re.findall(r"\| ([a-z][\w ,.()-]+) \|", (tmp_path / "report.md").read_text()):
        assert words.strip() in told, words


@pytest.mark.slow
@pytest.mark.usefixtures("no_rendering")
def test_report_again_with_the_newest_check(run, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from pinograsp.cli import app

    folder = save_run(run, tmp_path / "run")
    assert newest_check(folder) is None
    result = CliRunner().invoke(app, ["report", str(folder)])
    assert (
        result.exit_code == 0
        and (folder / "report.html").is_file()
        and "report.html" in (folder / "files.txt").read_text().split()
    )
    save_run(run, folder, force=True)  # it knows the files as its own
    result = CliRunner().invoke(app, ["check", str(folder), "--hold", "0.3", "--out", str(folder / "check")])
    assert result.exit_code in (0, 3)
    assert newest_check(folder) == folder / "check"
    result = CliRunner().invoke(app, ["report", str(folder)])
    assert result.exit_code == 0 and re.search(r"^Does it hold\?\s+(Yes|No|Barely)", result.output, re.M)
    assert re.search(r"Simulated\?\*\* (Held|Lost): ", (folder / "report.md").read_text())
    assert not list(folder.glob(".new-*"))


def sure(plan):
    """The plan as one that bears something besides its load, and has no warnings."""
    return replace(plan, cautions=(), margins=replace(plan.margins, disturbance=1.0))


def test_the_answer_heeds_moments_cautions_and_the_newest_simulation(run, simulated):
    plain = sure(run)
    not_tracked = ended(plain, Status.NOT_TRACKED, "Smaller steps.")
    for changed, check, level, words in (
        (plain, None, "yes", "Yes. The"),
        (plain, "held", "yes", "Held in simulation"),
        (plain, "lost", "no", "No. Lost in simulation: it fell."),
        (plain, "disturbed", "caution", "under disturbances"),
        (replace(plain, cautions=("thumb slides",)), None, "caution", "Yes, with warnings"),
        (replace(plain, margins=run.margins), None, "caution", "Barely: "),
        (replace(plain, margins=run.margins), "held", "caution", "besides. Held in simulation."),
        (replace(plain, balance="force"), None, "caution", "Not certain: moments are not balanced"),
        (replace(plain, balance="force"), "lost", "no", "No. Lost in simulation"),
        (ended(plain, Status.UNBALANCED), None, "caution", "Almost"),
        (
            not_tracked,
            None,
            "caution",
            "Not certain: the contact forces hold the load, but the hand cannot follow their paths. Smaller steps.",
        ),
        (not_tracked, "held", "caution", "Smaller steps. Held in simulation."),
        (not_tracked, "lost", "no", "No. Lost in simulation: it fell."),
        (
            ended(plain, Status.DOUBTFUL, "On edges"),
            None,
            "caution",
            "Not certain: the contact forces hold the load, but",
        ),
    ):
        told = does_it_hold(changed, simulated[check])
        assert told.level == level and words in told.text and told.text.startswith("Yes. ") == (level == "yes")
        assert answers(changed, simulated[check])["Does it hold?"] == told.text
        assert dict(list_results(changed, simulated[check]))["does it hold?"] == told.text


def test_the_page_shows_the_answer_in_its_colour(run, simulated, tmp_path):
    for check, level in ((None, "yes"), ("held", "yes"), ("lost", "no")):
        write_report(sure(run), tmp_path, (), simulated[check])
        text = (tmp_path / "report.html").read_text()
        assert re.search(rf'<h1>.*</h1>\s*<ul>\s*<li class="{level}">\s*<strong>Does it hold', text)
        assert text.count('<li class="no">') == (2 if level == "no" else 0)
    for level in ("yes", "caution", "no"):
        assert f"li.{level} {{ border-color" in text


WICKED = (
    "tip ![x](secret.png)",
    "[x](http://a.example)",
    "a|b",
    "<img src=x>",
    "**b**",
    "_b_",
    "`c`",
    "$x$",
    "a\nb\n# h",
    "# h",
    "1. x",
    "- x",
    "&lt;",
    "a\\",
    "\u202eb",
    "~~s~~",
    "<http://a.example>",
    "\\|",
    "http://a.example",
    "+ x",
    "=1+1",
    "---",
    "<script>alert(1)</script>",
    "{{ 7 * 7 }}",
    "{% raw %}",
)


def with_thumb(plan: PlanRecord, name: str) -> PlanRecord:
    """The same plan whose thumb, and its contact, have another name."""
    fingers = {name if key == "thumb" else key: dofs for key, dofs in plan.layout.fingers.items()}
    contacts = replace(plan.contacts, names=(name, *plan.contacts.names[1:]))
    return replace(plan, layout=replace(plan.layout, fingers=fingers), contacts=contacts)


@pytest.mark.parametrize("name", WICKED)
def test_names_of_others_are_text_wherever_they_stand(run, simulated, tmp_path, name):
    (tmp_path / "secret.png").write_bytes(b"secret")

    wicked = replace(
        with_thumb(run, name),
        motion=replace(run.motion, status=Status.JOINT_LIMIT, remedy=name),
        notes=(name,),
        cautions=(name,),
        settings={name: name, "assumed": {name: name}, "name": name},
        versions={name: name},
    )
    lost = simulated["lost"]
    write_report(wicked, tmp_path, (), replace(lost, verdict=replace(lost.verdict, reason=name)))
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    made = Page(text)
    assert made.links == []
    assert not {"img", "a", "em", "s", "ol", "hr", "script", "code"} & set(made.tags)
    assert made.tags.count("h1") == 1 and base64.b64encode(b"secret").decode() not in text
    shown = printable(name)
    cells = [piece.strip() for piece in made.texts]
    assert cells.count(shown) >= 4, [cell for cell in cells if shown[:2] in cell]
    rows = re.findall("<tr>(.*?)</tr>", text, re.S)
    assert {row.count("<t") for row in rows} <= {2, 5, 7}
    assert "\n" not in shown and "\u202e" not in shown


@pytest.mark.parametrize("name", WICKED)
def test_markdown_shows_names_as_they_are(name):
    """Another library reads it: one paragraph, with the text alone."""
    markdown_it = pytest.importorskip("markdown_it")
    tokens = markdown_it.MarkdownIt("commonmark").enable("table").parse(Report(title=name).to_markdown())
    assert [token.type for token in tokens] == ["heading_open", "inline", "heading_close"]
    assert {child.type for child in tokens[1].children} <= {"text", "text_special"}
    assert "".join(child.content for child in tokens[1].children) == printable(name)


def test_the_page_takes_in_its_own_figures_alone(tmp_path):
    (tmp_path / "mine.png").write_bytes(b"mine")
    shown = [Picture(name, "a") for name in ("mine.png", "gone.png", "/etc/hostname", "../mine.png")]
    text = Report(title="t", answers=[Finding("?", "!")], figures=shown).to_html(tmp_path)
    assert Page(text).links == ["data:image/png;base64," + base64.b64encode(b"mine").decode()]


@pytest.mark.slow
def test_figures_show_names_as_they_are(run, tmp_path, no_rendering):
    for name in ("$\\frac{1}{0}$", "_left_out", "../../up", "a\x00b", "x" * 3000, "", "\u202egnp"):
        changed = with_thumb(run, name)
        for figure in (figures.contact_forces(changed), figures.joint_torques(changed, name)):
            figure.canvas.draw()
        legend = figures.friction_use(changed).axes[0].get_legend()
        first = legend.get_texts()[0].get_text().strip().replace("\\$", "$")
        assert len(legend.get_texts()) == 3 and first == printable(name, 40)
    (path,) = (
        path
        for path in save_figures(changed, tmp_path)
        if path.stem.startswith("torques_") and "index" not in path.stem and "middle" not in path.stem
    )
    assert path.parent == tmp_path and re.fullmatch(r"torques_[A-Za-z0-9_]*\.png", path.name)


def test_friction_used_means_the_same_in_table_figure_and_viewer(run):
    from pinograsp.viz.scene import make_scene

    (what, cone), (limit, model) = friction_used(run)
    drawn = figures.friction_use(run).axes[0]
    assert what == "friction used, of mu F_n" and f"{what} [%]" == drawn.get_ylabel()
    assert 100 * np.array(list(cone.values())) == pytest.approx(
        [line.get_ydata()[-1] for line in drawn.get_lines()[:3]], rel=1e-6
    )
    scene = make_scene(run)
    assert scene.used[scene.frame_at(scene.closed)] == pytest.approx(list(cone.values()), rel=1e-6)
    assert limit == "of the pyramid" and list(model.values()) == run.margins.friction_used.tolist()
    told, facts = dict(list_results(run)), dict(scene.facts)
    for same in (
        what,
        limit,
        "load held by these forces",
        "disturbance held besides",
        "grasp energy (work)",
        "friction",
    ):
        assert told[same].split()[0] == facts[same].split()[0], same
    exact = replace(run, friction=replace(run.friction, model="cone", edges=None))
    assert len(friction_used(exact)) == 1


def test_forces_on_other_contacts_are_told(run):
    band = run.margins.band
    assert band.factors.min() == 0.2 and band.factors.max() == 20 and band.servos.startswith("servos of ")
    as_planned = band.factors.tolist().index(1.0)
    assert band.normal_forces[as_planned] == pytest.approx(run.forces.normal_forces, rel=1e-6)
    assert np.all(band.lowest <= run.forces.normal_forces * (1 + 1e-6)) and np.all(band.highest >= band.lowest)
    told = dict(list_results(run))["on other contacts"]
    assert f"contacts 0.2 to 20 times as stiff, {band.servos}" in told and "thumb" in told
    assert ("not held at" in told) == any(band.remarks) and told.endswith("held") == (not any(band.remarks))
    lost = replace(band, remarks=("", "thumb slips", *band.remarks[2:]))
    told = dict(list_results(replace(run, margins=replace(run.margins, band=lost))))["on other contacts"]
    assert "not held at 0.5 times: thumb slips" in told
    older = replace(run, margins=replace(run.margins, band=None))
    assert "on other contacts" not in dict(list_results(older))


def test_advice_that_was_taken_is_not_given_again(run):
    margins = replace(run.margins, disturbance=0.0, disturbance_force=0.0)
    for safety, closed, advice in ((1.0, True, True), (1.3, True, False), (1.3, False, False), (1.0, False, False)):
        told = disturbance_held(replace(margins, force_closure=closed), safety)
        assert ("safety factor above 1" in told) == advice and ("no force closure" in told) != closed
    from pinograsp.viz.scene import make_scene

    slipping = replace(run.margins, slip_distance=np.full(3, -1e-14))
    assert dict(make_scene(replace(run, margins=slipping)).facts)["least slip margin"] == "0 N"


def drawn(figure: Figure) -> Figure:
    figure.canvas.draw()
    return figure


def figures_of(run) -> dict[str, Figure]:
    """All figures of a plan, drawn."""
    made = {name: getattr(figures, name)(run) for name in ("joint_angles", "joint_rates", "contact_forces")}
    made |= {name: getattr(figures, name)(run) for name in ("grasp_energy", "friction_use", "wrench_margin")}
    made |= {"search_over_time": figures.search_over_time(run), "torques": figures.joint_torques(run, "thumb")}
    return {name: drawn(figure) for name, figure in made.items()}


def test_figures_can_be_read(run):
    """Legends are clear of the curves, and numbers at the axes are what they say: no offset, no factor."""
    for name, figure in figures_of(run).items():
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                assert axis.get_offset_text().get_text() == "", name
            if (legend := axes.get_legend()) is not None:
                box = legend.get_window_extent()
                assert box.y0 >= axes.get_window_extent().y1 - 1 and box.x1 <= figure.bbox.x1 + 1, name


def test_a_finger_has_the_same_colour_in_every_figure(run):
    colours = dict(zip(run.contacts.names, make_scene(run).colours))
    for figure in (figures.contact_forces(run), figures.grasp_energy(run), figures.friction_use(run)):
        for axes in figure.axes:
            lines = {line.get_label(): line.get_color() for line in axes.lines}
            assert {name: lines[name] for name in colours} == colours
    titles = {
        legend.get_title().get_text(): legend.get_title().get_color()
        for axes in figures.joint_angles(run).axes
        if (legend := axes.get_legend()) is not None
    }
    assert {name: titles[name] for name in colours} == colours


def test_energy_figure_ends_at_the_plans_energy(run):
    """Trapezoids over 100 samples: within a thousandth."""
    work, impulse = figures.grasp_energy(run).axes
    for axes, expected in ((work, 1e3 * run.forces.work), (impulse, run.forces.impulse)):
        ends = [line.get_ydata()[-1] for line in axes.get_lines()]
        assert ends[-1] == pytest.approx(expected, rel=2e-3) and sum(ends[:-1]) == pytest.approx(ends[-1])


def test_friction_figure_agrees_with_the_forces(run):
    axes = figures.friction_use(run).axes[0]
    forces = zip(run.contacts.names, run.forces.forces_c, run.friction.mu)
    for line, (name, force, mu) in zip(axes.get_lines(), forces):
        assert line.get_label() == name
        assert line.get_ydata()[-1] == pytest.approx(100 * np.hypot(*force[:2]) / (mu * force[2]), rel=1e-6)


def test_margin_figure_shows_what_disturbance_margin_says(run):
    problem = replace(run.problem, friction=replace(run.problem.friction, safety=1.0))
    directions, margins = run.reach.directions, run.reach.forces
    assert directions.shape == (*margins.shape, 3) and np.linalg.norm(directions, axis=2) == pytest.approx(1.0)
    for plane in range(3):
        for i in (0, 7, 20):
            wrench = np.append(directions[plane, i], np.zeros(3))
            held = disturbance_margin(problem, wrench, normal_forces=run.forces.normal_forces)
            assert margins[plane, i] == pytest.approx(max(0.0, held), abs=1e-6)
    panels = figures.wrench_margin(run).axes
    assert len(panels) == 3 and np.hypot(*panels[0].get_lines()[0].get_data()).max() == pytest.approx(margins[0].max())
    with pytest.raises(InvalidInput, match="with_reach"):
        figures.wrench_margin(replace(run, reach=None))


def test_search_figure_brackets_the_optimum(run):
    _, gap = figures.search_over_time(run).axes
    assert gap.get_lines()[0].get_ydata()[-1] == pytest.approx(run.forces.certificate.objective, rel=1e-6)
    with pytest.raises(InvalidInput, match="convex"):
        figures.search_over_time(replace(run, forces=replace(run.forces, certificate=None)))


def test_rates_are_the_angles_derivatives(run):
    angles, rates = figures.joint_angles(run), figures.joint_rates(run)
    for a, r in zip(angles.axes, rates.axes):
        for angle, rate in zip(a.get_lines(), r.get_lines()):
            if len(angle.get_xdata()) > 10:
                slope = np.gradient(angle.get_ydata(), angle.get_xdata())
                assert np.abs(slope - rate.get_ydata())[5:-5].max() <= 0.02 * max(1.0, np.abs(rate.get_ydata()).max())


@pytest.mark.slow
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


# -- records on a terminal ---------------------------------------------------------------------------------------------


def records_of(thing, found: dict) -> dict:
    """One record of each class that can be reached from ``thing`` by fields and properties."""
    if is_dataclass(thing) and type(thing) not in found:
        found[type(thing)] = thing
        names = [field.name for field in fields(thing)]
        names += [name for name, value in vars(type(thing)).items() if isinstance(value, property)]
        for name in names:
            records_of(getattr(thing, name), found)
    elif isinstance(thing, dict | list | tuple):
        for one in thing.values() if isinstance(thing, dict) else thing:
            records_of(one, found)
    return found


@pytest.mark.slow
def test_records_print_on_a_few_lines(hand, cylinder):
    from pinograsp.viz.scene import make_scene

    case = pg.load_case("paper", {**CHANGES, "motion.time_step": 0.02})
    plan = case.plan()
    closure = pg.close_hand(hand, cylinder)
    simulation = simulate(plan, hold=0.01, time_step=1e-3, letting_go=0.01)
    found = {}
    for thing in (
        plan,
        closure,
        simulation,
        make_scene(plan),
        pg.grasp_margins(plan.solution),
        plan.with_margins().margins,
        joint_trajectory(plan, rate=50),
    ):
        records_of(thing, found)
    assert len(found) > 25
    for kind, record in [*found.items(), (type(case), case)]:
        told = repr(record)
        assert len(told) <= 300 and "\n" not in told and told.startswith(kind.__name__), told[:400]
    assert "status=ok" in repr(plan) and "humanoid_hand" in repr(plan) and "thumb" in repr(plan.contacts)
    assert simulation.verdict.reason[:20] in repr(simulation.verdict) and "mujoco" not in repr(simulation)


def test_torque_maxima_have_names_and_no_noise(run):
    """A joint of which nothing is asked is named below the table, however the sums came out."""
    torques = np.array(run.motion.torques)
    torques[:, 0] = 1e-15
    quiet = replace(run, motion=replace(run.motion, torques=torques))
    text = report_plan(quiet).to_markdown()
    rows = text.partition("## Largest joint torques")[2].partition("<details>")[0].replace("\\", "")
    told = {row.split("|")[2].strip(): row.split("|")[3:7] for row in rows.splitlines() if row.count("|") == 8}
    idle = rows.partition("Below 0.1 % of the largest: ")[2]
    limits = quiet.hand.effort_or_infinity
    for i, name in enumerate(run.layout.joints):
        largest = np.abs(torques[:, i]).max()
        assert (name in told) == (largest > 1e-3 * np.abs(torques).max()) and (name in told or name in idle)
        if name in told:
            approach, grasp, limit, used = (one.strip() for one in told[name])
            assert max(float(approach), float(grasp)) == pytest.approx(largest, abs=6e-5)
            assert float(limit) == limits[i] and used == f"{100 * largest / limits[i]:.0f} %"
    assert run.layout.joints[0] not in told and "e-15" not in rows


@pytest.mark.parametrize(
    ("value", "text"), [(-1e-9, "0.0"), (-0.0, "0.0"), (-0.04, "0.0"), (-0.06, "-0.1"), (2.0, "2.0")]
)
def test_zeros_have_no_sign(value, text):
    assert format_fixed(value, 1) == text
