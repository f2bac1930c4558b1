"""The readable report of a run, as Markdown and as one HTML file, and the tables of the command line."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Mapping
from pathlib import Path

from pinograsp.checks import instance_of, items_of, path_of, shown
from pinograsp.errors import InvalidInput
from pinograsp.storage import Run
from pinograsp.words import (
    disturbance_held,
    does_it_hold,
    friction_model,
    friction_used,
    load_factor,
    number,
    printable,
    shares,
    work,
)
from pinograsp.writing import place_of, write_errors

_LONGEST = 2000  # characters of a line that someone else wrote


def headline(run: Run, check: dict | None = None) -> list[str]:
    """The answer first, a line of Markdown each: does it hold, how hard, how much energy, with which margin, and what
    the referee saw.

    ``check``: ``check.json`` of a simulation of the run, if there was one.
    """
    instance_of("run", run, Run)
    _checked_check(check)
    s = run.summary
    forces = s["normal_forces_N"]
    listed = ", ".join(f"{name} {value:.2f} N" for name, value in forces.items())
    energy = f"{_work(run)}; {s['impulse_Ns']:.3f} N s as impulse (Eq. 11)"
    if s["certificate"] is not None:
        energy += (
            f"; within a share of {max(s['certificate']['relative_gap'], 0.0):.0e} of the least {_objective(s)}, proven"
        )
    margin = f"the squeeze holds {load_factor(s['margins'])}"
    for what, values in friction_used(s):
        used = [value for value in values.values() if value is not None]
        margin += f"; {what}: up to {100 * max(used):.0f} %" if used else ""
    lines = [
        ("Does it hold?", does_it_hold(s, check).text),
        (
            "How hard?",
            f"{sum(forces.values()):.2f} N of normal force in all: {listed}; at most {s['peak_torque_Nm']:.3g} N "
            "m at a joint.",
        ),
        ("How much energy?", f"{energy}."),
        ("Which margin?", f"{margin[0].upper()}{margin[1:]}."),
    ]
    if check is None:
        lines.append(("Simulated?", "Not yet: pinograsp check does it."))
    else:
        verdict = "Held" if check["held"] else "Lost"
        off = f"normal forces at most {100 * check['force_error']:.1f} % off the plan"
        lines.append(("Simulated?", f"{verdict} ({check['engine']}): {check['reason']}; {off}."))
    return [f"**{what}** {_escaped(text)}" for what, text in lines]


def _checked_check(check) -> None:
    if check is not None and not (
        isinstance(check, Mapping) and {"held", "engine", "reason", "force_error"} <= set(check)
    ):
        raise InvalidInput(f"check: expected the check.json of a simulation, got {shown(check)}")


def answer(run: Run, check: dict | None = None) -> list[tuple[str, str]]:
    """The answer in a few lines: (what, value with its unit); ``check`` as for :func:`headline`."""
    instance_of("run", run, Run)
    s = run.summary
    forces = ", ".join(f"{name} {value:.3f}" for name, value in s["normal_forces_N"].items())
    multipliers = ", ".join(f"{name} ({k1:+.3f}, {k2:+.3f})" for name, (k1, k2) in s["multipliers"].items())
    lines = [
        ("does it hold?", does_it_hold(s, check).text),
        ("status", s["status"]),
        ("search", f"{s['search']}, solver {s['solver']}, {s['balance']} balance, least {_objective(s)}"),
        ("friction", friction_model(s["friction"])),
        ("impact time t_I", f"{s['impact_time_s']:g} s"),
        ("normal forces", f"{forces} N"),
        ("multipliers k1, k2", multipliers),
        ("grasp energy (work)", _work(run)),
        ("grasp energy (impulse)", f"{s['impulse_Ns']:.4f} N s by Eq. (11)"),
        ("net force, net moment", f"{s['residual_N']:.2e} N, {s['residual_Nm']:.2e} N m"),
        ("largest penetration", f"{1e3 * s['max_penetration_m']:.3f} mm"),
        ("peak joint torque", f"{s['peak_torque_Nm']:.4f} N m"),
        ("postures tried", ", ".join(f"{name} {count}" for name, count in s["postures_tried"].items())),
        *_proof(s),
        *_safety(s),
        ("planning time", f"{s['elapsed_s']:.3f} s"),
    ]
    return [(printable(what), printable(value, _LONGEST)) for what, value in lines]


def _work(run: Run) -> str:
    law = run.arrays.get("contact_law")
    return work(run.summary["work_J"], None if law is None else float(law[2]))


def _objective(s: dict) -> str:
    weights = s["certificate"]["weights"] if s["certificate"] else {s["measure"]: 1.0}
    parts = [name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items() if weight]
    return " + ".join(parts)


def _proof(s: dict) -> list[tuple[str, str]]:
    certificate = s["certificate"]
    if certificate is None:
        return []
    gap = f"no forces cost less than {number(certificate['lower_bound'], 7)} "
    gap += f"(ours {number(certificate['objective'], 7)}), "
    gap += f"gap {certificate['relative_gap']:.1e}"
    return [("proven", gap), ("active limits", "; ".join(certificate["active"]) or "none")]


def _safety(s: dict) -> list[tuple[str, str]]:
    """The margins: what the grasp bears beyond its load with these normal forces."""
    m = s["margins"]
    return [
        *((what, shares(values)) for what, values in friction_used(s)),
        ("load held by these forces", load_factor(m)),
        ("disturbance held besides", disturbance_held(m, s["friction"]["safety"])),
        (
            "grasp",
            f"{'force closure' if m['force_closure'] else 'no force closure'}, Ferrari-Canny epsilon "
            f"{number(m['ferrari_canny_L1'], 3)}, smallest singular value {number(m['min_singular_value'], 3)}",
        ),
    ]


def failure(run: Run) -> str:
    """``report.md`` of a search that proved that there is no grasp."""
    instance_of("run", run, Run)
    s = run.summary
    first, *rest = s["message"].splitlines() or [""]
    return "\n".join(
        [
            f"# No grasp: {_title(run)}",
            "",
            f"**{s['status']}**: {_escaped(first)}",
            "",
            *(f"- {_escaped(line)}" for line in rest),
            "",
            *_made_with(run),
        ]
    )


def _title(run: Run) -> str:
    return _escaped(run.settings.get("name") or run.layout["hand"], 200)


def _made_with(run: Run) -> list[str]:
    return [f"Made with {_escaped(', '.join(f'{name} {version}' for name, version in run.versions.items()))}.", ""]


def _escaped(text: str, most: int = _LONGEST) -> str:
    """Text that Markdown shows as it is: names come from files of others."""
    text = re.sub(r"[\\`*\[\]<>|~&$]", r"\\\g<0>", printable(text, most).strip())
    text = re.sub(r"(?<![^\W_])_|_(?![^\W_])", r"\\_", text)  # within words it means nothing
    text = re.sub(r"^(?=#|[-+=](?![\d.]))", r"\\", text)  # headings, rules and lists begin so
    return re.sub(r"^(\d+)(?=[.)](\s|$))", r"\1\\", text)


def _code(key: str) -> str:
    return f"`{printable(key).replace('`', chr(39)).strip() or '-'}`"


def markdown(run: Run, figures: list[str] | None = None, check: dict | None = None) -> str:
    """``report.md`` of a run.

    ``figures``: names of the files beside it. ``check``: ``check.json`` of a simulation.
    """
    instance_of("run", run, Run)
    s = run.summary
    lines = [f"# Grasp plan: {_title(run)}", ""]
    lines += [*(f"- {line}" for line in headline(run, check)), "", *_figures(figures, _FIRST), "## In figures", ""]
    lines += _table(("quantity", "value"), answer(run, check))
    if s["remedy"]:
        lines += [f"**{s['status']}**: {_escaped(s['remedy'])}", ""]
    if s["cautions"]:
        lines += ["## Cautions", "", *(f"- {_escaped(caution)}" for caution in s["cautions"]), ""]
    if s["notes"]:
        lines += ["## Notes", "", *(f"- {_escaped(note)}" for note in s["notes"]), ""]
    lines += ["## Contact forces at t_F", ""]
    lines += _table(
        ("contact", "f_x [N]", "f_y [N]", "F_n [N]", "A [m/s2]", "path error [m]"),
        [
            (
                name,
                *(f"{f:.4f}" for f in force),
                f"{s['accelerations_m_s2'][name]:.4f}",
                f"{s['tracking_error_m'][name]:.1e}",
            )
            for name, force in s["contact_forces_N"].items()
        ],
    )
    lines += [
        "Contact frame: z into the object, x against gravity in the tangent plane, y completes it. "
        "Forces act on the object.",
        "",
        "## Joint torque maxima [N m]",
        "",
    ]
    lines += _table(
        ("finger", "phase", "joints, base to tip"),
        [
            (finger, phase, ", ".join(number(value) for value in values))
            for finger, phases in s["joint_torque_max_Nm"].items()
            for phase, values in phases.items()
        ],
    )
    if s["grid"] is None:
        lines += [
            "## Search",
            "",
            f"Branch and bound over t_I: {s['certificate']['branches']} intervals. Left over: "
            f"{s['residual_N']:.1e} N, {s['residual_Nm']:.1e} N m; largest violation of a limit: "
            f"{s['certificate']['violation_N']:.1e} N.",
            "",
        ]
    else:
        lines += _grid_section(s)
    if s.get("comparison"):
        lines += [
            "## Beside the paper",
            "",
            "Planned as the paper does: forces alone in balance, friction used up to its limit.",
            "",
        ]
        lines += _table(("quantity", "unit", "paper", "ours", "difference", "note"), comparison_rows(s["comparison"]))
    if run.settings.get("assumed"):
        lines += [
            "## Assumed inputs",
            "",
            *(f"- {_code(key)}: {_escaped(why)}" for key, why in run.settings["assumed"].items()),
            "",
        ]
    rest = [name for name in figures or () if Path(name).stem not in _FIRST]
    if rest:
        lines += ["## Figures", "", *_figures(rest, None)]
    lines += [*_settings(run.settings), *_made_with(run)]
    return "\n".join(lines)


_FIRST = ("contact_forces",)
_CAPTIONS = {
    "contact_forces": "Normal forces and penetration depths in the grasp phase",
    "joint_angles": "Joint angles, approach and grasp phase (grey)",
    "joint_rates": "Joint rates",
    "grasp_energy": "Grasp energy as it builds up, rho + 1 times the contacts' work",
    "friction_use": "Friction used: each contact's share of Coulomb's cone, mu F_n",
    "wrench_margin": "Forces that may come on top of the load",
    "search_over_time": "The search over the impact time: proven bounds, what was found, and the gap",
}


def _figures(names, only) -> list[str]:
    """Figures with captions: those ``only``, or all."""
    lines = []
    for name in () if names is None else items_of("figures", names, str, Path):
        stem = Path(name).stem
        if only is None or stem in only:
            finger = stem.removeprefix("torques_")
            caption = _CAPTIONS.get(
                stem, f"Joint torques of the {finger}" if finger != stem else stem.replace("_", " ")
            )
            lines += [f"![{caption}]({name})", ""]
    return lines


def _settings(settings: dict) -> list[str]:
    """What was asked for, key by key."""
    rows = [(key, str(value)) for key, value in _flat(settings) if key != "name" and not key.startswith("assumed.")]
    return ["## Settings", "", *_table(("key", "value"), rows)] if rows else []


def _flat(settings, prefix: str = ""):
    for key, value in settings.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", value


_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 0 auto;
  max-width: 60rem; padding: 1rem; }
h1 { font-size: 1.6rem; margin: 0.5rem 0 1rem; }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-bottom: 2px solid #0072B2; }
h1 + ul { list-style: none; padding: 0; display: grid; gap: 0.5rem;
  grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); }
h1 + ul li { border-left: 4px solid #0072B2; background: #f2f6fa; padding: 0.6rem 0.8rem; overflow-wrap: anywhere; }
h1 + ul strong { display: block; }
h1 + ul li:first-child { grid-column: 1 / -1; font-size: 1.15rem; }
h1 + ul li.yes { border-color: #009E73; background: #e3f4ee; }
h1 + ul li.caution { border-color: #E69F00; background: #fdf3dd; }
h1 + ul li.no { border-color: #D55E00; background: #fdeae1; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.9rem; }
th, td { text-align: left; vertical-align: top; padding: 0.25rem 0.7rem 0.25rem 0; border-bottom: 1px solid #ddd; }
td + td { overflow-wrap: anywhere; }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; } figcaption { font-size: 0.9rem; color: #444; }
code { font-size: 0.9em; } pre { overflow-x: auto; background: #f5f5f5; padding: 0.6rem; }
@media screen and (max-width: 40rem) { figure { overflow-x: auto; } figure img { max-width: none; width: 40rem; } }
@media print { body { max-width: none; font-size: 11pt; } figure, tr, h1 + ul li { break-inside: avoid; }
  h2 { break-after: avoid; } }
"""


def page(text: str, figures=(), levels=()) -> str:
    """Markdown as one HTML file: nothing comes from a network, and no file comes in but ``figures``.

    Args:
        figures: paths of PNG files that the text may show by their names.
        levels: "yes", "caution" or "no" of the first list's entries, which take its colour; "" is neutral.
    """
    from markdown_it import MarkdownIt

    made = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens, known = made.parse(text), {Path(path).name: Path(path) for path in figures}
    for token in tokens:
        for child in token.children or ():
            if child.type == "image":
                if child.attrs["src"] in known:
                    picture = known[child.attrs["src"]].read_bytes()
                    child.attrs["src"] = "data:image/png;base64," + base64.b64encode(picture).decode()
                else:
                    child.type, child.tag = "text", ""
    body = made.renderer.render(tokens, made.options, {})
    body = body.replace("<table>", '<div class="wide"><table>').replace("</table>", "</table></div>")
    head, *entries = body.split("<li>")
    for entry, level in zip(entries, [*levels, *[""] * len(entries)]):
        head += f'<li class="{level}">{entry}' if level else f"<li>{entry}"
    # A picture alone in its paragraph is a figure, and its description the caption.
    body = re.sub(r'<p>(<img [^>]*alt="([^"]*)"[^>]*>)</p>', r"<figure>\1<figcaption>\2</figcaption></figure>", head)
    title = html.escape("".join(child.content for child in tokens[1].children)) if len(tokens) > 1 else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, '
        f'initial-scale=1"><title>{title}</title><style>{_STYLE}</style></head>\n<body>\n{body}</body></html>\n'
    )


def write_report(run: Run, folder: str | Path, figures=(), check: dict | None = None) -> None:
    """``report.md`` and ``report.html`` into a folder that has the figures already.

    ``figures``: their names there, as :func:`~pinograsp.viz.figures.save_figures` gave them; no other file comes into
    the page.
    """
    instance_of("run", run, Run)
    _checked_check(check)
    folder, names = path_of("folder", folder), [Path(name).name for name in items_of("figures", figures, str, Path)]
    levels = []
    if run.arrays:
        text = markdown(run, names, check)
        levels = [
            does_it_hold(run.summary, check).level,
            "",
            "",
            "",
            "no" if check is not None and not check["held"] else "",
        ]
    else:
        text = failure(run)
    with write_errors(folder):
        place_of(folder)  # refuses names that no file system takes
        (folder / "report.md").write_text(text, encoding="utf-8")
        (folder / "report.html").write_text(page(text, [folder / name for name in names], levels), encoding="utf-8")


def _grid_section(s: dict) -> list[str]:
    lines = [
        "## Search",
        "",
        f"{s['grid']['points']:.4g} grid points, {s['grid']['cells']} cells in (t_I, A), "
        f"{s['grid']['qp_solves']} QPs solved.",
        "",
    ]
    return lines + _table(
        ("cells rejected by", "count"), [(reason, str(count)) for reason, count in s["grid"]["rejections"].items()]
    )


def comparison_rows(comparison) -> list[tuple[str, ...]]:
    """``summary["comparison"]`` as text: quantity, unit, paper, ours, difference, note."""
    return [
        (
            row["quantity"],
            row["unit"],
            number(row["published"]),
            number(row["ours"]),
            number(row["difference"], 3),
            row["note"],
        )
        for row in comparison
    ]


def _table(header, rows) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return [*lines, *("| " + " | ".join(map(_escaped, row)) + " |" for row in rows), ""]


def checked(summary: dict, figures: list[str] | None = None, studies: list[str] | None = None) -> str:
    """``check.md`` of a simulation: the verdict first; ``studies``: what else was tried, as text."""
    s = summary
    lines = [f"# {'Held' if s['held'] else 'Lost'}", "", f"{_escaped(s['reason'])}.", ""]
    errors = ", ".join(f"{name} {100 * value:.2f} %" for name, value in s["force_errors"].items())
    audit = "-" if s["energy_error"] is None else f"{s['energy_error']:.1e}"
    rows = [
        ("drift since the release", f"{s['drift_mm']:.3f} mm"),
        ("tilt, turn about any axis", f"{s['tilt_deg']:.3f} deg, {s['turn_deg']:.3f} deg"),
        ("normal forces off the plan", errors or "-"),
        ("penetration off the plan at t_F", f"{s['penetration_error_mm']:.4f} mm"),
        ("slipped by more than 0.1 mm", ", ".join(s["slipped"]) or "none"),
        ("touching without a plan", ", ".join(s["unplanned_contacts"]) or "none"),
        ("joints beyond their limits", ", ".join(s["joint_limit_hits"]) or "none"),
        ("motors at their limits at the end", ", ".join(s["saturated"]) or "none"),
        ("grasp energy at t_F", work(1e-3 * s["grasp_energy_mJ"], s["contact_exponent"])),
        ("energy audit closes to", audit),
        ("engine", f"{s['engine']}, {s['mode']}, step {1e3 * s['time_step_s']:g} ms, {s['elapsed_s']:.2f} s"),
    ]
    lines += _table(("", ""), rows)
    if s["disturbance"]:
        lines += [
            "## Not as planned",
            "",
            *(f"- {_escaped(f'{name}: {value}')}" for name, value in s["disturbance"].items()),
            "",
        ]
    lines += ["## Forces at the end", ""]
    lines += _table(
        ("part of the hand", "planned F_n [N]", "simulated F_n [N]"),
        [(name, number(planned), number(s["final_forces_N"][name])) for name, planned in s["planned_forces_N"].items()],
    )
    if studies:
        lines += ["## Further trials", "", "```text", *(study.replace("```", "'''") for study in studies), "```", ""]
    if s["notes"]:
        lines += ["## Notes", "", *(f"- {_escaped(note)}" for note in s["notes"]), ""]
    if figures:
        lines += ["## Figures", "", *(f"![{name}]({name})" for name in figures), ""]
    return "\n".join(lines)
