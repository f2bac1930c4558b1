"""The results of a plan in words and numbers: what it answers, and tables of all the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pinograsp.checks import instance_of
from pinograsp.pages import LONGEST
from pinograsp.plan import ComparisonRow, PlanRecord, Simulation
from pinograsp.plan.answer import (
    describe_load_factor,
    describe_robustness,
    describe_trial,
    does_it_hold,
    friction_model,
    friction_used,
    list_forces,
    list_margins,
    planned_reserve,
    where_the_hand_is,
    work,
)
from pinograsp.report.document import Finding
from pinograsp.words import format_number, printable


def answer_questions(plan: PlanRecord, simulation: Simulation | None = None) -> list[Finding]:
    """The main results: holding, forces, energy, margins and simulation."""
    instance_of("plan", plan, PlanRecord)
    instance_of("simulation", simulation, Simulation, type(None))
    forces, certificate = plan.forces, plan.forces.certificate
    each = ", ".join(f"{name} {value:.2f} N" for name, value in _normal_forces(plan).items())
    energy = f"{work(plan)}; {forces.impulse:.3f} N s as impulse (Eq. 11)"
    if certificate is not None:
        share = max(certificate.relative_gap, 0.0)
        energy += f"; proven to be within {share:.0e} (relative) of the least {_objective(plan)}"
    margin = f"the squeeze holds {describe_load_factor(plan.require_margins())}"
    for what, values in friction_used(plan):
        used = [value for value in values.values() if math.isfinite(value)]
        margin += f"; {what}: up to {100 * max(used):.0f} %" if used else ""
    total = sum(_normal_forces(plan).values())
    outcome = does_it_hold(plan, simulation)
    answers = [
        Finding("Does it hold?", outcome.text, outcome.level),
        Finding(
            "What does it withstand?",
            _sentence(f"{describe_robustness(plan)}; reserve planned: {planned_reserve(plan.reserve)}"),
        ),
        *_tolerance(plan),
        Finding(
            "How hard?", f"{total:.2f} N of normal force in total: {each}; at most {plan.peak_efforts()} at a joint."
        ),
        Finding("How much energy?", f"{energy}."),
        Finding("How much margin?", _sentence(margin)),
    ]
    if simulation is None:
        answers.append(Finding("Simulated?", describe_trial(plan) or "Not yet: run pinograsp check."))
    else:
        off = f"normal forces at most {100 * simulation.verdict.force_error:.1f} % off the plan"
        answers += answer_simulated(simulation, off)
    if place := where_the_hand_is(plan):
        answers.append(Finding("Where is the hand?", _sentence(place)))
    return answers


def answer_simulated(simulation: Simulation, remark: str = "") -> list[Finding]:
    """How a simulation ended, and why the object was lost."""
    verdict = simulation.verdict
    text = "; ".join(part for part in (verdict.reason, remark) if part)
    ended, level = ("Held", "") if verdict.held else ("Lost", "no")
    ended = f"{ended} {simulation.describe_controller()}".rstrip()
    answers = [Finding("Simulated?", f"{ended}: {text}.", level)]
    reasons = (("Why lost?", verdict.causes), ("What helps?", verdict.remedies))
    return answers + [Finding(question, f"{'; '.join(texts)}.") for question, texts in reasons if texts]


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _normal_forces(plan: PlanRecord) -> dict[str, float]:
    return dict(zip(plan.contacts.names, plan.forces.normal_forces.tolist()))


def list_results(plan: PlanRecord, simulation: Simulation | None = None) -> list[tuple[str, str]]:
    """The results as pairs of a name and a value with its unit, first those of :func:`summarize`."""
    return [*summarize(plan, simulation), *list_details(plan)]


def summarize(plan: PlanRecord, simulation: Simulation | None = None) -> list[tuple[str, str]]:
    """What a reader asks first, as pairs of a name and a value with its unit."""
    instance_of("plan", plan, PlanRecord)
    lines = [
        ("does it hold?", does_it_hold(plan, simulation).text),
        ("it withstands", describe_robustness(plan)),
        ("reserve planned", planned_reserve(plan.reserve)),
        ("normal forces", f"{', '.join(f'{name} {value:.3f}' for name, value in _normal_forces(plan).items())} N"),
        ("status", str(plan.status)),
    ]
    return [(printable(what), printable(value, LONGEST)) for what, value in lines]


def _tolerance(plan: PlanRecord) -> list[Finding]:
    found = plan.tolerance
    if found is None:
        return []
    asked = (
        f"{format_number(1e3 * found.asked_distance, 2)} mm and {format_number(math.degrees(found.asked_angle), 2)} deg"
    )
    text = f"It is held {found.describe()}; of {found.count} errors of {asked} it keeps {100 * found.kept:.0f} %."
    return [Finding("How precisely must the object be placed?", text, "caution" if found.is_small else "yes")]


def list_details(plan: PlanRecord) -> list[tuple[str, str]]:
    """The other results, likewise."""
    forces, motion, names = plan.forces, plan.motion, plan.contacts.names
    multipliers = ", ".join(f"{name} ({k1:+.3f}, {k2:+.3f})" for name, (k1, k2) in zip(names, forces.multipliers))
    solved = f"{forces.search}, solver {forces.solver or 'none'}, {plan.balance} balance, least {_objective(plan)}"
    lines = [
        ("search", solved),
        ("friction", friction_model(plan.friction)),
        ("hand", where_the_hand_is(plan) or "placed by the plan's poses"),
        ("impact time t_I", f"{forces.impact_time:g} s"),
        ("multipliers k1, k2", multipliers),
        *list_forces(plan),
        ("grasp energy (impulse)", f"{forces.impulse:.4f} N s by Eq. (11)"),
        ("postures tried", ", ".join(f"{name} {count}" for name, count in motion.postures.items())),
        *_proof(plan),
        *list_margins(plan),
        *_on_other_contacts(plan),
        ("planning time", f"{sum(plan.elapsed.values()):.3f} s"),
    ]
    return [(printable(what), printable(value, LONGEST)) for what, value in lines]


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
    gap = f"{where}no forces cost less than {format_number(certificate.lower_bound, 7)} "
    gap += f"(ours {format_number(certificate.objective, 7)}), gap {certificate.relative_gap:.1e}"
    return [("proven", gap), ("active limits", "; ".join(certificate.active) or "none")]


def _on_other_contacts(plan: PlanRecord) -> list[tuple[str, str]]:
    band = plan.require_margins().band
    if band is None:
        return []
    ranges = zip(plan.contacts.names, band.lowest, band.highest)
    forces = ", ".join(f"{name} {format_number(low, 2)} to {format_number(high, 2)}" for name, low, high in ranges)
    lost = [f"not held at {factor:g} times: {why}" for factor, why in zip(band.factors, band.remarks) if why]
    text = f"{forces} N, contacts {band.factors.min():g} to {band.factors.max():g} times as stiff, {band.servos}"
    return [("on other contacts", "; ".join([text, *(lost[:1] or ["held"])]))]


def list_comparison(comparison: Sequence[ComparisonRow]) -> list[tuple[str, ...]]:
    """Rows of the comparison with a publication, as text: quantity, unit, paper, ours, difference, note."""
    return [
        (
            row.quantity,
            row.unit,
            format_number(row.published),
            format_number(row.ours),
            format_number(row.difference, 3),
            row.note,
        )
        for row in comparison
    ]
