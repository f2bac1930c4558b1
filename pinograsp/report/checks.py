"""Reports of simulations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pinograsp.checks import instance_of
from pinograsp.plan import Simulation
from pinograsp.plan.answer import work_in_words
from pinograsp.report.document import Picture, Report, Section, list_section
from pinograsp.report.results import answer_simulated
from pinograsp.words import format_number

_CAPTIONS = {
    "forces": "Normal forces, simulated and (dashed) planned",
    "object": "How far the object moves and turns",
    "energy": "Where the energy goes",
}


def report_check(simulation: Simulation, figures: Sequence[str] = (), studies: Sequence[str] = ()) -> Report:
    """The report of a simulation, with the verdict first; ``studies``: results of further trials, as text."""
    instance_of("simulation", simulation, Simulation)
    verdict = simulation.verdict
    rows = zip(simulation.parts, simulation.planned_forces, simulation.normal_forces[-1])
    differences = [f"{name}: {value}" for name, value in simulation.disturbance.items()]
    sections = [
        Section(title="Measured", columns=("quantity", "value"), rows=_list_measured(simulation)),
        *list_section("Differences from the plan", differences),
        Section(
            title="Forces at the end",
            columns=("part of the hand", "planned F_n [N]", "simulated F_n [N]"),
            rows=[(name, format_number(planned), format_number(simulated)) for name, planned, simulated in rows],
        ),
    ]
    if studies:
        sections.append(Section(title="Further trials", outputs=["\n".join(studies)]))
    sections += list_section("Notes", simulation.notes)
    return Report(
        title="Held" if verdict.held else "Lost",
        answers=answer_simulated(simulation),
        figures=[Picture(name, _CAPTIONS.get(Path(name).stem, name)) for name in figures],
        sections=sections,
    )


def _list_measured(simulation: Simulation) -> list[tuple[str, str]]:
    verdict = simulation.verdict
    errors = ", ".join(f"{name} {100 * value:.2f} %" for name, value in verdict.force_errors.items())
    control = simulation.servo.get("control", simulation.mode)
    run = f"{control}, step {1e3 * simulation.time_step:g} ms, {simulation.elapsed:.2f} s"
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
        ("run", run),
    ]
