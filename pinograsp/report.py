"""The readable report of a run, and the tables of the command line."""

from __future__ import annotations

import math

from pinograsp.storage import Run


def number(value: float | None, digits: int = 4) -> str:
    """A number for people: plain where that is short, scientific where it is not, a dash where there is none."""
    if value is None:
        return "-"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    return f"{value:.{max(digits - 1 - exponent, 0)}f}" if -4 <= exponent < 6 else f"{value:.{digits - 2}e}"


def answer(run: Run) -> list[tuple[str, str]]:
    """The answer in a few lines: (what, value with its unit)."""
    s = run.summary
    forces = ", ".join(f"{name} {value:.3f}" for name, value in s["normal_forces_N"].items())
    multipliers = ", ".join(f"{name} ({k1:+.3f}, {k2:+.3f})" for name, (k1, k2) in s["multipliers"].items())
    return [
        ("status", s["status"]),
        ("search", f"{s['search']}, solver {s['solver']}, {s['balance']} balance, least {_objective(s)}"),
        ("friction", _friction(s["friction"])),
        ("impact time t_I", f"{s['impact_time_s']:g} s"),
        ("normal forces", f"{forces} N"),
        ("multipliers k1, k2", multipliers),
        ("grasp energy", f"{1e3 * s['work_J']:.3f} mJ (work), {s['impulse_Ns']:.4f} N s (impulse)"),
        ("net force, net moment", f"{s['net_force_N']:.2e} N, {s['net_moment_Nm']:.2e} N m"),
        ("largest penetration", f"{1e3 * s['max_penetration_m']:.3f} mm"),
        ("peak joint torque", f"{s['peak_torque_Nm']:.4f} N m"),
        ("postures tried", ", ".join(f"{name} {count}" for name, count in s["postures_tried"].items())),
        *_proof(s),
        *_safety(s["margins"]),
        ("planning time", f"{s['elapsed_s']:.3f} s"),
    ]


def _objective(s: dict) -> str:
    weights = s["certificate"]["objective"] if s["certificate"] else {s["measure"]: 1.0}
    parts = [name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items() if weight]
    return " + ".join(parts)


def _friction(f: dict) -> str:
    low, high = min(f["mu"]), max(f["mu"])
    mu = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    model = f"pyramid of {f['edges']} edges" if f["edges"] else {"cone": "cone", "soft": "soft finger"}[f["model"]]
    torsion = f", torsion up to {1e3 * f['torsion_m']:g} mm x F_n" if f["torsion_m"] else ""
    return f"mu {mu}, {model}, safety factor {f['safety']:g}{torsion}"


def _proof(s: dict) -> list[tuple[str, str]]:
    certificate = s["certificate"]
    if certificate is None:
        return []
    gap = f"no forces cost less than {number(certificate['dual'], 7)} (ours {number(certificate['primal'], 7)}), "
    gap += f"gap {certificate['relative_gap']:.1e}"
    return [("proven", gap), ("active limits", "; ".join(certificate["active"]) or "none")]


def _safety(m: dict) -> list[tuple[str, str]]:
    """The margins: what the grasp bears beyond its load with these normal forces."""
    used = ", ".join(f"{name} {'slips' if v is None else format(v, '.1%')}" for name, v in m["friction_used"].items())
    factor = "any" if m["load_factor"] is None else f"{m['load_factor']:.4g} times"
    moment = "" if m["disturbance_moment_Nm"] is None else f", {number(m['disturbance_moment_Nm'], 3)} N m about any axis"
    held = f"{number(m['disturbance_force_N'], 3)} N in any direction{moment}"
    if m["disturbance_any_N"] == 0:
        held = "nothing in the weakest direction: forces on their limits; ask for a friction safety factor above 1"
    return [
        ("friction used", used),
        ("load held by these forces", f"{factor} the load"),
        ("disturbance held besides", held),
        ("grasp", f"{'force closure' if m['force_closure'] else 'no force closure'}, Ferrari-Canny epsilon "
                  f"{number(m['ferrari_canny_L1'], 3)}, smallest singular value {number(m['min_singular_value'], 3)}"),
    ]  # fmt: skip


def failure(run: Run) -> str:
    """``report.md`` of a search that proved that there is no grasp."""
    s = run.summary
    first, _, rest = s["message"].partition("\n")
    return "\n".join(
        [
            f"# No grasp: {run.settings.get('name', run.layout['hand'])}",
            "",
            f"**{s['status']}**: {first}",
            "",
            *(f"- {line.strip()}" for line in rest.splitlines()),
            "",
            "Made with " + ", ".join(f"{name} {version}" for name, version in run.versions.items()) + ".",
            "",
        ]
    )


def markdown(run: Run, comparison=(), figures: list[str] | None = None) -> str:
    """``report.md`` of a run. ``comparison`` holds rows of :mod:`pinograsp.cases.published`."""
    s = run.summary
    lines = [f"# Grasp plan: {run.settings.get('name', run.layout['hand'])}", ""]
    lines += _table(("", ""), answer(run))
    if s["remedy"]:
        lines += [f"**{s['status']}**: {s['remedy']}", ""]
    if s["cautions"]:
        lines += ["## Cautions", "", *(f"- {caution}" for caution in s["cautions"]), ""]
    if s["notes"]:
        lines += ["## Notes", "", *(f"- {note}" for note in s["notes"]), ""]
    lines += ["## Contact forces at t_F", ""]
    lines += _table(
        ("contact", "f_x [N]", "f_y [N]", "F_n [N]", "A [m/s2]", "path error [m]"),
        [
            (name, *(f"{f:.4f}" for f in force), f"{s['accelerations_m_s2'][name]:.4f}", f"{s['tracking_error_m'][name]:.1e}")
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
    if s["grid"]["points"] == 0:
        lines += ["## Search", "", f"Branch and bound over t_I: {s['certificate']['branches']} intervals. Net wrench left: "
                  f"{s['certificate']['balance_N']:.1e} N; largest violation of a limit: "
                  f"{s['certificate']['limit_violation_N']:.1e} N.", ""]  # fmt: skip
    else:
        lines += _grid_section(s)
    if comparison:
        lines += ["## Beside the paper", ""]
        lines += _table(("quantity", "unit", "paper", "ours", "difference", "note"), comparison_rows(comparison))
    if run.settings.get("assumed"):
        lines += ["## Assumed inputs", "", *(f"- `{key}`: {why}" for key, why in run.settings["assumed"].items()), ""]
    if figures:
        lines += ["## Figures", "", *(f"![{name}]({name})" for name in figures), ""]
    lines += ["Made with " + ", ".join(f"{name} {version}" for name, version in run.versions.items()) + ".", ""]
    return "\n".join(lines)


def _grid_section(s: dict) -> list[str]:
    lines = ["## Search", "", f"{s['grid']['points']:.4g} grid points, {s['grid']['cells']} cells in (t_I, A), "
             f"{s['grid']['qp_solves']} QPs solved.", ""]  # fmt: skip
    return lines + _table(
        ("cells rejected by", "count"), [(reason, str(count)) for reason, count in s["grid"]["rejections"].items()]
    )


def comparison_rows(comparison) -> list[tuple[str, ...]]:
    """Rows of a comparison as text: quantity, unit, paper, ours, difference, note."""
    return [
        (row.quantity, row.unit, number(row.published), number(row.ours), number(row.difference, 3), row.note)
        for row in comparison
    ]


def _table(header, rows) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def checked(summary: dict, figures: list[str] | None = None, studies: list[str] | None = None) -> str:
    """``check.md`` of a simulation: the verdict first; ``studies``: what else was tried, as text."""
    s = summary
    lines = [f"# {'Held' if s['held'] else 'Lost'}", "", f"{s['reason']}.", ""]
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
        ("grasp energy, Eq. (9)", f"{s['grasp_energy_mJ']:.3f} mJ"),
        ("energy audit closes to", audit),
        ("engine", f"{s['engine']}, {s['mode']}, step {1e3 * s['time_step_s']:g} ms, {s['elapsed_s']:.2f} s"),
    ]
    lines += _table(("", ""), rows)
    if s["disturbance"]:
        lines += ["## Not as planned", "", *(f"- {name}: {value}" for name, value in s["disturbance"].items()), ""]
    lines += ["## Forces at the end", ""]
    lines += _table(
        ("part of the hand", "planned F_n [N]", "simulated F_n [N]"),
        [(name, number(planned), number(s["final_forces_N"][name])) for name, planned in s["planned_forces_N"].items()],
    )
    if studies:
        lines += ["## Further trials", "", "```text", *studies, "```", ""]
    if s["notes"]:
        lines += ["## Notes", "", *(f"- {note}" for note in s["notes"]), ""]
    if figures:
        lines += ["## Figures", "", *(f"![{name}]({name})" for name in figures), ""]
    return "\n".join(lines)

