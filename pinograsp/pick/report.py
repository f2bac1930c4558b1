"""The readable report of a pick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinograsp.carry.report import list_contacts
from pinograsp.pick.record import PickRecord
from pinograsp.pick.simulation import PickSimulation
from pinograsp.report import Finding, Picture, Report, Section, list_section

_WHAT = {
    "reach": "to the object, around obstacles, then straight ahead",
    "close": "the hand closes, the squeeze builds up",
    "carry": "straight up, along the path, straight down",
    "open": "the squeeze is released, the hand opens",
    "leave": "straight back",
}


def report_pick(plan: PickRecord, figures: Sequence[str] = (), simulation: PickSimulation | None = None) -> Report:
    """The report: the answers first, then phase by phase, the contacts on the way, the joints."""
    return Report(
        title=f"Picking with {plan.robot.name}",
        answers=_answer(plan, simulation),
        figures=[Picture(name, "The middle of the path with the object") for name in figures],
        sections=[
            *list_section("Warnings", plan.cautions),
            Section(
                title="Phase by phase",
                columns=("phase", "what", "time [s]", "total normal force [N]", "largest share of torque", "of speed"),
                rows=_list_phases(plan),
            ),
            list_contacts(plan.carry),
        ],
    )


def _list_phases(plan: PickRecord) -> list[tuple[str, ...]]:
    robot = plan.robot
    effort, velocity = (np.where(limit > 0, limit, np.inf) for limit in (robot.effort, robot.velocity))
    squeeze = plan.carry.squeeze
    forces = {
        "close": f"0 to {squeeze[0]:.3g}",
        "carry": f"{squeeze.min():.3g} to {squeeze.max():.3g}",
        "open": f"{squeeze[-1]:.3g} to 0",
    }
    return [
        (
            phase.name,
            _WHAT[phase.name],
            f"{phase.duration:.2f}",
            forces.get(phase.name, "0"),
            f"{100 * (abs(phase.torques) / effort).max():.0f} %",
            f"{100 * (abs(phase.dq) / velocity).max():.0f} %",
        )
        for phase in plan.phases
    ]


def _answer(plan: PickRecord, simulation: PickSimulation | None) -> list[Finding]:
    squeeze = plan.carry.squeeze
    answers = [
        Finding(
            "Is it possible?",
            f"{plan.status}: {plan.duration:.3g} s, after {plan.tried} grasps.",
            "caution" if plan.cautions else "yes",
        ),
        Finding("How hard?", f"{squeeze.min():.3g} to {squeeze.max():.3g} N of normal force in total along the path."),
        Finding(
            "How much friction?",
            f"Up to {100 * plan.carry.friction_use.max():.0f} % of the friction that the plan relies on.",
        ),
    ]
    if simulation is None:
        return [*answers, Finding("Simulated?", "Not yet: --check.")]
    return [*answers, Finding("Did it work?", f"{simulation.tell()}.", "yes" if simulation.done else "no")]
