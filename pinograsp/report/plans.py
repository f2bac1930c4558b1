"""Reports of plans, and of searches that found none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import instance_of, items_of
from pinograsp.plan import PlanFailure, PlanRecord, Simulation
from pinograsp.report.document import Finding, Picture, Report, Section, list_section
from pinograsp.report.results import answer_questions, list_comparison, list_results
from pinograsp.words import few, format_fixed, format_number

_LOST = 1e-3  # share of the energy that couplings cost: worth a sentence
_NOISE = 1e-3  # of the largest torque: smaller ones are not told
_FIRST = (
    "grasp",
    "contact_forces",
    "wrench_margin",
    "friction_use",
    "joint_angles",
    "grasp_energy",
)  # with the answers
_CAPTIONS = {
    "grasp": "The grasp at t_F: forces on the object, its weight and load in black",
    "contact_forces": "Normal forces and penetration depths in the grasp phase",
    "joint_angles": "Joint angles, approach and grasp phase (grey)",
    "joint_rates": "Joint rates",
    "grasp_energy": "Grasp energy over time, rho + 1 times the contacts' work",
    "friction_use": "Friction used: each contact's share of Coulomb's cone, mu F_n",
    "wrench_margin": "Forces that the grasp withstands besides its load",
    "search_over_time": "The search over the impact time: lower bounds, the best found, and the gap",
}


def report_plan(plan: PlanRecord, figures: Sequence[str] = (), simulation: Simulation | None = None) -> Report:
    """The report of a plan; ``figures``: names of image files in the same folder."""
    instance_of("plan", plan, PlanRecord)
    shown = [Picture(name, _caption(name)) for name in items_of("figures", figures, str)]
    stems = [Path(figure.name).stem for figure in shown]
    first = [shown[stems.index(name)] for name in _FIRST if name in stems]
    rest = [figure for figure in shown if figure not in first]
    sections = [
        *([Section(title="", text=f"{plan.status}: {plan.remedy}")] if plan.remedy else []),
        *list_section("Warnings", plan.cautions),
        *list_section("Notes", plan.notes),
        _contacts(plan),
        _torques(plan),
        Section(title="All results", columns=("quantity", "value"), rows=list_results(plan, simulation), folded=True),
        *_search(plan),
    ]
    if rest:
        sections.append(Section(title="More figures: joint rates, torques over time", figures=rest, folded=True))
    if plan.comparison:
        comparison = Section(
            title="Comparison with the paper",
            text="Planned with the paper's choices: balance of forces only, no safety factor for friction.",
            columns=("quantity", "unit", "paper", "ours", "difference", "note"),
            rows=list_comparison(plan.comparison),
            folded=True,
        )
        sections.append(comparison)
    if assumed := plan.settings.get("assumed"):
        rows = list(assumed.items())
        sections.append(Section(title="Assumed inputs", columns=("input", "why"), rows=rows, folded=True))
    settings = [(key, str(value)) for key, value in _flatten(plan.settings)]
    settings = [(key, value) for key, value in settings if key != "name" and not key.startswith("assumed.")]
    if settings:
        sections.append(Section(title="Settings", columns=("key", "value"), rows=settings, folded=True))
    return Report(
        title=f"Grasp plan: {plan.name[:200]}",
        answers=answer_questions(plan, simulation),
        figures=first,
        sections=[*sections, _versions(plan.versions)],
    )


def report_failure(failure: PlanFailure) -> Report:
    """The report of a search that found no grasp."""
    instance_of("failure", failure, PlanFailure)
    first, *rest = failure.message.splitlines() or [""]
    return Report(
        title=f"No grasp: {failure.name[:200]}",
        answers=[Finding(str(failure.status), first, "no")],
        sections=[*list_section("", rest), _versions(failure.versions)],
    )


def _contacts(plan: PlanRecord) -> Section:
    forces = plan.forces
    rows: list[tuple[str, ...]] = [
        (name, format_fixed(f[2], 3), format_fixed(f[0], 3), format_fixed(f[1], 3), format_fixed(slowed, 3))
        for name, f, slowed in zip(plan.contacts.names, forces.forces_c, forces.acceleration)
    ]
    columns: tuple[str, ...] = ("contact", "F_n [N]", "f_x [N]", "f_y [N]", "A [m/s2]")
    remark = (
        "F_n presses into the object; f_x points against gravity in the tangent plane, f_y completes the "
        "contact's frame. Forces act on the object. A is the deceleration after the impact."
    )
    if (places := plan.contacts_on_links) is not None:
        at = [", ".join(format_fixed(1e3 * value, 1) for value in point) for point in places.points_l.tolist()]
        rows = [(*row, link, place) for row, link, place in zip(rows, places.links, at)]
        columns, remark = (*columns, "link", "place on it [mm]"), f"{remark} Places are in the links' own frames."
    return Section(title="Contact forces at t_F", columns=columns, rows=rows, remark=remark)


def _torques(plan: PlanRecord) -> Section:
    """Of joints whose torque is more than noise; the others in a sentence."""
    count = len(plan.layout.joints)
    slides = np.zeros(count, dtype=bool) if plan.hand is None else plan.hand.slides
    limits = np.full(count, np.inf) if plan.hand is None else plan.hand.effort_or_infinity
    least, rows, idle = _NOISE * np.abs(plan.motion.torques).max(initial=0.0), [], []
    for finger, phases in plan.torque_maxima().items():
        for j, approach, grasp in zip(plan.layout.fingers[finger], phases["approach"], phases["grasp"]):
            name, largest = plan.layout.joints[j], max(approach, grasp)
            if largest <= least:
                idle.append(name)
                continue
            used = f"{100 * largest / limits[j]:.0f} %" if np.isfinite(limits[j]) else "-"
            told = (format_fixed(value, 4) for value in (approach, grasp))
            rows.append((finger, name, *told, format_number(limits[j], 3), used, "N" if slides[j] else "N m"))
    return Section(
        title="Largest joint torques",
        columns=("finger", "joint", "approach", "grasp", "limit", "of limit", "unit"),
        rows=rows,
        remark=f"Below {100 * _NOISE:g} % of the largest: {few(idle, 12)}." if idle else "",
    )


def _search(plan: PlanRecord) -> list[Section]:
    certificate, grid, reserve = plan.forces.certificate, plan.forces.grid, plan.reserve
    if certificate is None:
        if grid is None:
            return []
        text = f"{grid.points:.4g} grid points, {grid.cells} cells in (t_I, A), {grid.qp_solves} QPs solved."
        rows = [(reason, str(count)) for reason, count in grid.rejections.items()]
        columns = ("cells rejected by", "count")
        return [Section(title="Search", text=text, columns=columns, rows=rows, folded=True)]
    residual = f"Residual: {plan.forces.residual_force:.1e} N, {plan.forces.residual_moment:.1e} N m"
    if reserve is None:
        text = (
            f"Branch and bound over t_I: {len(certificate.branches)} intervals. {residual}; largest violation of a "
            f"limit: {certificate.violation:.1e} N."
        )
        return [Section(title="Search", text=text, folded=True)]
    text = (
        f"One squeeze for {reserve.loads} loads. {reserve.impact_times} impact times were tried; at the chosen one no "
        f"squeeze costs less (proven); it is not proven for other impact times. {residual}; largest violation of a "
        f"limit under any of the loads: {certificate.violation:.1e} N."
    )
    if reserve.above_unrestricted > _LOST:
        text += (
            f" The energy is at most {100 * reserve.above_unrestricted:.2g} % above the least of a hand whose contacts "
            "and joints could all be chosen one by one."
        )
    return [Section(title="Search", text=text, folded=True)]


def _caption(name: str) -> str:
    stem = Path(name).stem
    finger = stem.removeprefix("torques_")
    return _CAPTIONS.get(stem, f"Joint torques of the {finger}" if finger != stem else stem.replace("_", " "))


def _versions(versions: Mapping[str, str]) -> Section:
    made = ", ".join(f"{name} {version}" for name, version in versions.items())
    return Section(title="", text=f"Made with {made}.")


def _flatten(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in settings.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", value
