"""The readable report of a carry plan."""

from __future__ import annotations

from collections.abc import Sequence

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.record import CarryRecord
from pinograsp.plan import Simulation
from pinograsp.report import Finding, Picture, Report, Section, answer_simulated, list_section
from pinograsp.words import format_number

_CAPTIONS = {
    "carry_speed": "Speed along the path, the limit at each place by itself, and what binds",
    "carry_forces": "Normal forces along the path",
    "carry_friction": "Friction used: each contact's share of the friction that the plan relies on",
    "carry_torques": "Joint torques as shares of their limits",
    "carry_motion": "Speeds and accelerations of the joints",
}


def report_carry(plan: CarryPlan, figures: Sequence[str] = (), simulation: Simulation | None = None) -> Report:
    """The report: the answers first, then what binds, forces and torques, figures."""
    stretches = [
        (f"{plan.times[first]:.3f} to {plan.times[last + 1]:.3f}", what) for what, first, last in plan.stretches()
    ]
    torques, speeds = abs(plan.torques).max(axis=0), abs(plan.dq).max(axis=0)
    joints = [
        (name, format_number(torques[i]), format_number(speeds[i])) for i, name in enumerate(plan.robot.joint_names)
    ]
    stems = {name: name.rpartition(".")[0] for name in figures}
    shown = [Picture(name, _CAPTIONS.get(stem, stem.replace("_", " "))) for name, stem in stems.items()]
    return Report(
        title=f"Carrying with {plan.robot.name}",
        answers=_answer(plan, simulation),
        figures=shown,
        sections=[
            *list_section("Warnings", plan.cautions),
            *list_section("Notes", plan.notes),
            Section(title="Limits that bind along the path", columns=("time [s]", "limit"), rows=stretches),
            list_contacts(plan),
            Section(
                title="Joints",
                columns=("joint", "largest torque [N m or N]", "largest speed [rad/s or m/s]"),
                rows=joints,
            ),
        ],
    )


def list_contacts(plan: CarryRecord) -> Section:
    """What each contact presses with on the way, and how much of its friction is used."""
    low, high, used = plan.normal_forces.min(axis=0), plan.normal_forces.max(axis=0), plan.friction_use.max(axis=0)
    return Section(
        title="Contacts",
        columns=("contact", "least F_n [N]", "largest F_n [N]", "largest share of friction"),
        rows=[
            (name, format_number(low[i]), format_number(high[i]), f"{100 * used[i]:.0f} %")
            for i, name in enumerate(plan.contacts)
        ],
    )


def _answer(plan: CarryPlan, simulation: Simulation | None) -> list[Finding]:
    free = f"{100 * plan.reserve:g} % of friction, caps, torques and speeds are kept free."
    if plan.fastest is None:
        fast = f"Along the trajectory of {plan.duration:.4g} s; {plan.factor:.3g} times as fast would also hold."
    else:
        fast = (
            f"In {plan.duration:.4g} s; {plan.fastest:.4g} s with accelerations that jump, and no timing of this path "
            f"takes less than {plan.lower_bound:.4g} s."
        )
    binds = "; ".join(f"{what} ({100 * share:.0f} % of the time)" for what, share in plan.shares()[:3])
    level = "yes" if simulation is None or simulation.verdict.held else "no"
    answers = [
        Finding("How fast?", f"{fast} {free}", level),
        Finding("How hard?", f"{plan.squeeze.min():.3g} to {plan.squeeze.max():.3g} N of normal force in total."),
        Finding("What binds?", f"{binds}."),
        Finding(
            "How much friction?",
            f"Up to {100 * plan.friction_use.max():.0f} % of the friction that the plan relies on.",
        ),
    ]
    if plan.cautions:
        answers.append(Finding("Doubtful?", f"{'; '.join(plan.cautions)}."))
    if simulation is None:
        return [*answers, Finding("Simulated?", "Not yet: --check.")]
    return answers + answer_simulated(simulation)
