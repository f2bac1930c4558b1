"""The readable report of a run, as Markdown and as one HTML file, and the tables of the command line."""

from __future__ import annotations

import base64
import html
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pinograsp.checks import instance_of, items_of, path_of
from pinograsp.plan import ComparisonRow, PlanFailure, PlanRecord, Simulation
from pinograsp.plan.answer import (
    bears,
    disturbance_held,
    does_it_hold,
    friction_model,
    friction_used,
    load_factor,
    planned_reserve,
    shares,
    where_the_hand_is,
    work,
    work_in_words,
)
from pinograsp.words import fixed, number, printable
from pinograsp.writing import place_of, write_errors

_LOST = 1e-3  # share of the energy that couplings cost: worth a sentence
_LONGEST = 2000  # characters of a line from a file


def headline(plan: PlanRecord, simulation: Simulation | None = None) -> list[str]:
    """The main results, one line of Markdown each: holding, forces, energy, margins and simulation."""
    instance_of("plan", plan, PlanRecord)
    instance_of("simulation", simulation, Simulation, type(None))
    forces, certificate = plan.forces, plan.forces.certificate
    listed = ", ".join(f"{name} {value:.2f} N" for name, value in _normal_forces(plan).items())
    energy = f"{work(plan)}; {forces.impulse:.3f} N s as impulse (Eq. 11)"
    if certificate is not None:
        share = max(certificate.relative_gap, 0.0)
        energy += f"; proven to be within {share:.0e} (relative) of the least {_objective(plan)}"
    margin = f"the squeeze holds {load_factor(plan.require_margins())}"
    for what, values in friction_used(plan):
        used = [value for value in values.values() if math.isfinite(value)]
        margin += f"; {what}: up to {100 * max(used):.0f} %" if used else ""
    borne = bears(plan)
    total = sum(_normal_forces(plan).values())
    lines = [
        ("Does it hold?", does_it_hold(plan, simulation).text),
        ("What does it bear?", f"{borne[0].upper()}{borne[1:]}; reserve planned: {planned_reserve(plan.reserve)}."),
        ("How hard?", f"{total:.2f} N of normal force in all: {listed}; at most {plan.peak_efforts()} at a joint."),
        ("How much energy?", f"{energy}."),
        ("Which margin?", f"{margin[0].upper()}{margin[1:]}."),
    ]
    if simulation is None:
        lines.append(("Simulated?", "Not yet: run pinograsp check."))
    else:
        verdict = simulation.verdict
        off = f"normal forces at most {100 * verdict.force_error:.1f} % off the plan"
        ended = "Held" if verdict.held else "Lost"
        lines.append(("Simulated?", f"{ended} ({simulation.engine}): {verdict.reason}; {off}."))
        if verdict.causes:
            lines.append(("Why lost?", f"{'; '.join(verdict.causes)}."))
        if verdict.remedies:
            lines.append(("What helps?", f"{'; '.join(verdict.remedies)}."))
    if placed := where_the_hand_is(plan):
        lines.append(("Where is the hand?", f"{placed[0].upper()}{placed[1:]}."))
    return [f"**{what}** {escaped(text)}" for what, text in lines]


def _normal_forces(plan: PlanRecord) -> dict[str, float]:
    return dict(zip(plan.contacts.names, plan.forces.normal_forces.tolist()))


def answer(plan: PlanRecord, simulation: Simulation | None = None) -> list[tuple[str, str]]:
    """The results as pairs of a name and a value with its unit, first those of :func:`summary`."""
    return [*summary(plan, simulation), *details(plan)]


def summary(plan: PlanRecord, simulation: Simulation | None = None) -> list[tuple[str, str]]:
    """What a reader asks first, as pairs of a name and a value with its unit."""
    instance_of("plan", plan, PlanRecord)
    lines = [
        ("does it hold?", does_it_hold(plan, simulation).text),
        ("it bears", bears(plan)),
        ("reserve planned", planned_reserve(plan.reserve)),
        ("normal forces", f"{', '.join(f'{name} {value:.3f}' for name, value in _normal_forces(plan).items())} N"),
        ("status", str(plan.status)),
    ]
    return [(printable(what), printable(value, _LONGEST)) for what, value in lines]


def details(plan: PlanRecord) -> list[tuple[str, str]]:
    """The other results, likewise."""
    forces, motion, names = plan.forces, plan.motion, plan.contacts.names
    multipliers = ", ".join(f"{name} ({k1:+.3f}, {k2:+.3f})" for name, (k1, k2) in zip(names, forces.multipliers))
    solved = f"{forces.search}, solver {forces.backend or 'none'}, {plan.balance} balance, least {_objective(plan)}"
    lines = [
        ("search", solved),
        ("friction", friction_model(plan.friction)),
        ("hand", where_the_hand_is(plan) or "placed as the plan's poses tell"),
        ("impact time t_I", f"{forces.impact_time:g} s"),
        ("multipliers k1, k2", multipliers),
        ("grasp energy (work)", work(plan)),
        ("grasp energy (impulse)", f"{forces.impulse:.4f} N s by Eq. (11)"),
        ("net force, net moment", f"{forces.residual_force:.2e} N, {forces.residual_moment:.2e} N m"),
        ("largest penetration", f"{1e3 * forces.final_depths.max():.3f} mm"),
        ("peak joint effort", plan.peak_efforts()),
        ("postures tried", ", ".join(f"{name} {count}" for name, count in motion.postures.items())),
        *_proof(plan),
        *_safety(plan),
        ("planning time", f"{sum(plan.elapsed.values()):.3f} s"),
    ]
    return [(printable(what), printable(value, _LONGEST)) for what, value in lines]


def _objective(plan: PlanRecord) -> str:
    certificate = plan.forces.certificate
    weights = {plan.measure: 1.0} if certificate is None else certificate.weights
    parts = [name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items() if weight]
    return " + ".join(parts)


def _proof(plan: PlanRecord) -> list[tuple[str, str]]:
    certificate = plan.forces.certificate
    if certificate is None:
        return []
    where = "at this t_I " if plan.reserve is not None else ""
    gap = f"{where}no forces cost less than {number(certificate.lower_bound, 7)} "
    gap += f"(ours {number(certificate.objective, 7)}), gap {certificate.relative_gap:.1e}"
    return [("proven", gap), ("active limits", "; ".join(certificate.active) or "none")]


def _safety(plan: PlanRecord) -> list[tuple[str, str]]:
    """The margins: what the grasp bears besides its load with these normal forces."""
    margins = plan.require_margins()
    closure = "force closure" if margins.force_closure else "no force closure"
    quality = (
        f"{closure}, Ferrari-Canny epsilon {number(margins.ferrari_canny, 3)}, "
        f"smallest singular value {number(margins.min_singular_value, 3)}"
    )
    return [
        *((what, shares(values)) for what, values in friction_used(plan)),
        ("load held by these forces", load_factor(margins)),
        ("disturbance held besides", disturbance_held(margins, plan.friction.safety)),
        ("grasp", quality),
        *_on_other_contacts(plan),
    ]


def _on_other_contacts(plan: PlanRecord) -> list[tuple[str, str]]:
    band = plan.require_margins().band
    if band is None:
        return []
    ranges = zip(plan.contacts.names, band.lowest, band.highest)
    forces = ", ".join(f"{name} {number(low, 2)} to {number(high, 2)}" for name, low, high in ranges)
    lost = [f"not held at {factor:g} times: {why}" for factor, why in zip(band.factors, band.remarks) if why]
    text = f"{forces} N, contacts {band.factors.min():g} to {band.factors.max():g} times as stiff, {band.servos}"
    return [("on other contacts", "; ".join([text, *(lost[:1] or ["held"])]))]


def failure(found: PlanFailure) -> str:
    """``report.md`` of a search that found no grasp."""
    instance_of("found", found, PlanFailure)
    first, *rest = found.message.splitlines() or [""]
    return "\n".join(
        [
            f"# No grasp: {escaped(found.name, 200)}",
            "",
            f"**{found.status}**: {escaped(first)}",
            "",
            *(f"- {escaped(line)}" for line in rest),
            "",
            *_made_with(found.versions),
        ]
    )


def _made_with(versions: Mapping[str, str]) -> list[str]:
    return [f"Made with {escaped(', '.join(f'{name} {version}' for name, version in versions.items()))}.", ""]


def escaped(text: str, most: int = _LONGEST) -> str:
    """Text that Markdown shows unchanged: names come from files and may hold any characters."""
    text = re.sub(r"[\\`*\[\]<>|~&$]", r"\\\g<0>", printable(text, most).strip())
    text = re.sub(r"(?<![^\W_])_|_(?![^\W_])", r"\\_", text)  # within words it has no meaning
    text = re.sub(r"^(?=#|[-+=](?![\d.]))", r"\\", text)  # headings, rules and lists
    return re.sub(r"^(\d+)(?=[.)](\s|$))", r"\1\\", text)


def _code(key: str) -> str:
    return f"`{printable(key).replace('`', chr(39)).strip() or '-'}`"


def markdown(plan: PlanRecord, figures: Sequence[str] | None = None, simulation: Simulation | None = None) -> str:
    """``report.md`` of a plan; ``figures``: names of image files in the same folder."""
    instance_of("plan", plan, PlanRecord)
    lines = [f"# Grasp plan: {escaped(plan.name, 200)}", ""]
    lines += [
        *(f"- {line}" for line in headline(plan, simulation)),
        "",
        *_figures(figures, _FIRST),
        "## Results",
        "",
    ]
    lines += table(("quantity", "value"), answer(plan, simulation))
    if plan.remedy:
        lines += [f"**{plan.status}**: {escaped(plan.remedy)}", ""]
    lines += _listed("Cautions", plan.cautions) + _listed("Notes", plan.notes)
    lines += [*_contact_section(plan), *_torque_section(plan), *_search_section(plan)]
    if plan.comparison:
        lines += ["## Comparison with the paper", ""]
        lines += ["Planned with the paper's choices: balance of forces only, no safety factor for friction.", ""]
        lines += table(("quantity", "unit", "paper", "ours", "difference", "note"), comparison_rows(plan.comparison))
    if assumed := plan.settings.get("assumed"):
        lines += ["## Assumed inputs", "", *(f"- {_code(key)}: {escaped(why)}" for key, why in assumed.items()), ""]
    rest = [name for name in figures or () if Path(name).stem not in _FIRST]
    if rest:
        lines += ["## Figures", "", *_figures(rest, None)]
    lines += [*_settings(plan.settings), *_made_with(plan.versions)]
    return "\n".join(lines)


def _listed(title: str, texts: Sequence[str]) -> list[str]:
    return [f"## {title}", "", *(f"- {escaped(text)}" for text in texts), ""] if texts else []


def _contact_section(plan: PlanRecord) -> list[str]:
    forces = plan.forces
    rows = [
        (name, *(fixed(f, 4) for f in force), fixed(deceleration, 4), f"{missed:.1e}")
        for name, force, deceleration, missed in zip(
            plan.contacts.names, forces.forces_c, forces.acceleration, plan.motion.tracking_error
        )
    ]
    return [
        "## Contact forces at t_F",
        "",
        *table(("contact", "f_x [N]", "f_y [N]", "F_n [N]", "A [m/s2]", "path error [m]"), rows),
        "Contact frame: z into the object, x against gravity in the tangent plane, y completes it. "
        "Forces act on the object.",
        "",
    ]


def _torque_section(plan: PlanRecord) -> list[str]:
    slides = [False] * len(plan.layout.joints) if plan.hand is None else plan.hand.slides.tolist()
    maxima = plan.torque_maxima()
    nothing = _ROUNDING * max(
        (values.max(initial=0.0) for one in maxima.values() for values in one.values()), default=0
    )
    rows = [
        (finger, plan.layout.joints[j], *(number(v if v > nothing else 0.0) for v in both), "N" if slides[j] else "N m")
        for finger, phases in maxima.items()
        for j, *both in zip(plan.layout.fingers[finger], phases["approach"].tolist(), phases["grasp"].tolist())
    ]
    return ["## Joint torque maxima", "", *table(("finger", "joint", "approach", "grasp", "unit"), rows)]


def _search_section(plan: PlanRecord) -> list[str]:
    certificate, grid = plan.forces.certificate, plan.forces.grid
    if certificate is not None and plan.reserve is not None:
        text = (
            f"One squeeze for {plan.reserve.loads} loads. {plan.reserve.impact_times} impact times were tried; at the "
            f"one taken no squeeze costs less (proven), that no other impact time does is not proven. Residual: "
            f"{plan.forces.residual_force:.1e} N, {plan.forces.residual_moment:.1e} N m; largest violation of a limit "
            f"under any of the loads: {certificate.violation:.1e} N."
        )
        if plan.reserve.above_unrestricted > _LOST:
            text += (
                f" The energy is at most {100 * plan.reserve.above_unrestricted:.2g} % above the least of a hand whose "
                "contacts and joints could all be chosen one by one."
            )
        return ["## Search", "", text, ""]
    if certificate is not None:
        text = (
            f"Branch and bound over t_I: {len(certificate.branches)} intervals. Residual: "
            f"{plan.forces.residual_force:.1e} N, {plan.forces.residual_moment:.1e} N m; largest violation of a limit: "
            f"{certificate.violation:.1e} N."
        )
        return ["## Search", "", text, ""]
    if grid is None:
        return []
    text = f"{grid.points:.4g} grid points, {grid.cells} cells in (t_I, A), {grid.qp_solves} QPs solved."
    rows = [(reason, str(count)) for reason, count in grid.rejections.items()]
    return ["## Search", "", text, "", *table(("cells rejected by", "count"), rows)]


_ROUNDING = 1e-9  # of the largest torque: smaller ones are rounding
_FIRST = ("grasp", "contact_forces")
_CAPTIONS = {
    "grasp": "The grasp at t_F: forces on the object, its weight and load in black",
    "contact_forces": "Normal forces and penetration depths in the grasp phase",
    "joint_angles": "Joint angles, approach and grasp phase (grey)",
    "joint_rates": "Joint rates",
    "grasp_energy": "Grasp energy over time, rho + 1 times the contacts' work",
    "friction_use": "Friction used: each contact's share of Coulomb's cone, mu F_n",
    "wrench_margin": "Forces that the grasp bears besides its load",
    "search_over_time": "The search over the impact time: lower bounds, the best found, and the gap",
}


def _figures(names: Sequence[str] | None, only: Sequence[str] | None) -> list[str]:
    """Figures with captions; ``only``: which, by name; None: all."""
    lines = []
    for name in () if names is None else items_of("figures", names, str, Path):
        stem = Path(str(name)).stem
        if only is None or stem in only:
            finger = stem.removeprefix("torques_")
            caption = _CAPTIONS.get(
                stem, f"Joint torques of the {finger}" if finger != stem else stem.replace("_", " ")
            )
            lines += [f"![{caption}]({name})", ""]
    return lines


def _settings(settings: Mapping[str, Any]) -> list[str]:
    """The settings of the plan, by key."""
    rows = [(key, str(value)) for key, value in _flat(settings) if key != "name" and not key.startswith("assumed.")]
    return ["## Settings", "", *table(("key", "value"), rows)] if rows else []


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in settings.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", value


_STYLE = """
:root { color-scheme: light dark; --text: #1a1a1a; --soft: #4a5560; --ground: #fff; --card: #f2f6fa; --line: #d9dee3;
  --blue: #0072B2; --yes: #e3f4ee; --caution: #fdf3dd; --no: #fdeae1; }
@media screen and (prefers-color-scheme: dark) { :root { --text: #e6e9ec; --soft: #a9b4bf; --ground: #15191d;
  --card: #1f262d; --line: #39424b; --blue: #56B4E9; --yes: #12382d; --caution: #42330f; --no: #47240f; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--ground); margin: 0 auto;
  max-width: 68rem; padding: 1rem; }
h1 { font-size: 1.6rem; margin: 0.5rem 0; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-bottom: 2px solid var(--blue); }
h1 + ul { list-style: none; padding: 0; display: grid; gap: 0.5rem;
  grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); }
h1 + ul li { border-left: 4px solid var(--blue); background: var(--card); padding: 0.6rem 0.8rem;
  overflow-wrap: anywhere; }
h1 + ul strong { display: block; }
h1 + ul li:first-child { grid-column: 1 / -1; font-size: 1.15rem; }
h1 + ul li.yes { border-color: #009E73; background: var(--yes); }
h1 + ul li.caution { border-color: #E69F00; background: var(--caution); }
h1 + ul li.no { border-color: #D55E00; background: var(--no); }
/* The picture of the grasp stands beside the answer; on phones between the answer and what follows. */
.top { display: grid; gap: 0.5rem; }
.top ul { display: contents; } .top h1, .top li:first-child { order: -2; } .top figure { order: -1; margin: 0; }
.top figure img { width: 100%; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.9rem; }
th, td { text-align: left; vertical-align: top; padding: 0.25rem 0.7rem 0.25rem 0; min-width: 4.5em;
  border-bottom: 1px solid var(--line); font-variant-numeric: tabular-nums; }
td + td { overflow-wrap: anywhere; }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; background: #fff; border-radius: 6px; }
figcaption { font-size: 0.9rem; color: var(--soft); }
code { font-size: 0.9em; } pre { overflow-x: auto; background: var(--card); padding: 0.6rem; }
@media (min-width: 52rem), print { .top { grid-template-columns: 1fr 1fr; }
  .top h1 { grid-column: 1 / -1; } h1 + ul li:first-child { grid-column: auto; }
  .top figure { grid-column: 2; grid-row: 2 / span 3; } }
@media screen and (max-width: 40rem) { figure { overflow-x: auto; } figure img { max-width: none; width: 40rem; }
  .top figure { overflow-x: visible; } }
@media print { body { max-width: none; font-size: 11pt; } figure, tr, h1 + ul li { break-inside: avoid; }
  h2 { break-after: avoid; } .wide { overflow-x: visible; } th, td { min-width: 0; overflow-wrap: anywhere; } }
"""


def page(text: str, figures: Sequence[str | Path] = (), levels: Sequence[str] = ()) -> str:
    """Markdown as one HTML file, which loads nothing from a network or from other files.

    Args:
        text: Markdown.
        figures: paths of PNG files that the text may show by their names; they are embedded.
        levels: "yes", "caution", "no" or "" (neutral) for the entries of the first list, which sets their colour.
    """
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens, known = parser.parse(text), {Path(path).name: Path(path) for path in figures}
    for token in tokens:
        for child in token.children or ():
            if child.type == "image":
                if child.attrs["src"] in known:
                    picture = known[child.attrs["src"]].read_bytes()
                    child.attrs["src"] = "data:image/png;base64," + base64.b64encode(picture).decode()
                else:
                    child.type, child.tag = "text", ""
    body = parser.renderer.render(tokens, parser.options, {})
    body = body.replace("<table>", '<div class="wide"><table>').replace("</table>", "</table></div>")
    head, *entries = body.split("<li>")
    for entry, level in zip(entries, [*levels, *[""] * len(entries)]):
        head += f'<li class="{level}">{entry}' if level else f"<li>{entry}"
    # An image alone in its paragraph becomes a figure, with its description as caption.
    body = re.sub(r'<p>(<img [^>]*alt="([^"]*)"[^>]*>)</p>', r"<figure>\1<figcaption>\2</figcaption></figure>", head)
    # The picture right below the first list stands beside it.
    body = re.sub(
        r"\A(<h1>.*?</h1>\s*<ul>.*?</ul>\s*<figure>.*?</figure>)", r'<div class="top">\1</div>', body, flags=re.S
    )
    title = html.escape("".join(child.content for child in tokens[1].children or ())) if len(tokens) > 1 else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, '
        f'initial-scale=1"><title>{title}</title><style>{_STYLE}</style></head>\n<body>\n{body}</body></html>\n'
    )


def write_report(
    run: PlanRecord | PlanFailure,
    folder: str | Path,
    figures: Sequence[str | Path] = (),
    simulation: Simulation | None = None,
) -> None:
    """Write ``report.md`` and ``report.html`` into a folder that already holds the figures.

    Args:
        run: a plan, or a search that found none.
        folder: to write to.
        figures: names of the image files there, as from :func:`~pinograsp.viz.figures.save_figures`.
        simulation: of the plan.
    """
    instance_of("run", run, PlanRecord, PlanFailure)
    folder = path_of("folder", folder)
    names = [Path(str(name)).name for name in items_of("figures", figures, str, Path)]
    levels: list[str] = []
    if isinstance(run, PlanRecord):
        text = markdown(run, names, simulation)
        lost = simulation is not None and not simulation.verdict.held
        levels = [does_it_hold(run, simulation).level, "", "", "", "", "no" if lost else ""]
    else:
        text = failure(run)
    with write_errors(folder):
        place_of(folder)  # refuses names that no file system takes
        (folder / "report.md").write_text(text, encoding="utf-8")
        (folder / "report.html").write_text(page(text, [folder / name for name in names], levels), encoding="utf-8")


def comparison_rows(comparison: Sequence[ComparisonRow]) -> list[tuple[str, ...]]:
    """Rows of the comparison with a publication, as text: quantity, unit, paper, ours, difference, note."""
    return [
        (row.quantity, row.unit, number(row.published), number(row.ours), number(row.difference, 3), row.note)
        for row in comparison
    ]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return [*lines, *("| " + " | ".join(map(escaped, row)) + " |" for row in rows), ""]


def checked(simulation: Simulation, figures: Sequence[str] = (), studies: Sequence[str] = ()) -> str:
    """``check.md`` of a simulation, with the verdict first; ``studies``: results of further trials, as text."""
    instance_of("simulation", simulation, Simulation)
    verdict = simulation.verdict
    lines = [f"# {'Held' if verdict.held else 'Lost'}", "", f"{escaped(verdict.reason)}.", ""]
    lines += _listed("Why", verdict.causes) + _listed("What helps", verdict.remedies)
    lines += table(("", ""), _verdict_rows(simulation))
    if simulation.disturbance:
        differences = [f"{name}: {value}" for name, value in simulation.disturbance.items()]
        lines += _listed("Differences from the plan", differences)
    lines += ["## Forces at the end", ""]
    rows = zip(simulation.parts, simulation.planned_forces, simulation.normal_forces[-1])
    lines += table(
        ("part of the hand", "planned F_n [N]", "simulated F_n [N]"),
        [(name, number(planned), number(found)) for name, planned, found in rows],
    )
    if studies:
        texts = (study.replace("```", "'''") for study in studies)
        lines += ["## Further trials", "", "```text", *texts, "```", ""]
    lines += _listed("Notes", simulation.notes)
    if figures:
        lines += ["## Figures", "", *(f"![{name}]({name})" for name in figures), ""]
    return "\n".join(lines)


def _verdict_rows(simulation: Simulation) -> list[tuple[str, str]]:
    verdict = simulation.verdict
    errors = ", ".join(f"{name} {100 * value:.2f} %" for name, value in verdict.force_errors.items())
    control = simulation.servo.get("control", simulation.mode)
    run = f"{simulation.engine}, {control}, step {1e3 * simulation.time_step:g} ms, {simulation.elapsed:.2f} s"
    return [
        ("drift since the release", f"{1e3 * verdict.drift:.3f} mm"),
        ("tilt, turn about any axis", f"{verdict.tilt:.3f} deg, {verdict.turn:.3f} deg"),
        ("errors of the normal forces", errors or "-"),
        ("penetration error", f"{1e3 * verdict.penetration_error:.4f} mm"),
        ("slipped by more than 0.1 mm", ", ".join(verdict.slipped) or "none"),
        ("unplanned contacts", ", ".join(verdict.unplanned) or "none"),
        ("joints beyond their limits", ", ".join(verdict.limit_hits) or "none"),
        ("motors at their limits at the end", ", ".join(verdict.saturated) or "none"),
        ("grasp energy at t_F", work_in_words(simulation.grasp_energy, simulation.exponent)),
        ("error of the energy balance", "-" if verdict.energy_error is None else f"{verdict.energy_error:.1e}"),
        ("engine", run),
    ]
