"""The readable report of a carry plan."""

from __future__ import annotations

from collections.abc import Sequence

from pinograsp.carry.record import CarryPlan
from pinograsp.plan import Simulation
from pinograsp.report import escaped, table
from pinograsp.words import number

_CAPTIONS = {
    "carry_speed": "Speed along the path, with the limit that each place has by itself, and what binds",
    "carry_forces": "Normal forces on the way",
    "carry_friction": "Friction used: each contact's share of what it is relied on for",
    "carry_torques": "Joint torques over their limits",
    "carry_motion": "Speeds and accelerations of the joints",
}


def carry_report(plan: CarryPlan, figures: Sequence[str] = (), simulation: Simulation | None = None) -> str:
    """``carry.md``: the answer first, then what binds, forces and torques, figures, and the simulation."""
    lines = [
        f"# Carrying with {escaped(plan.robot.name)}",
        "",
        *(f"- {line}" for line in _headline(plan, simulation)),
        "",
    ]
    lines += ["## What binds on the way", ""]
    rows = [(f"{plan.times[first]:.3f} to {plan.times[last + 1]:.3f}", what) for what, first, last in plan.stretches()]
    lines += table(("time [s]", "limit"), rows)
    lines += ["## Contacts", ""]
    lines += table(
        ("contact", "least F_n [N]", "largest F_n [N]", "largest share of friction"),
        [
            (name, number(float(low)), number(float(high)), f"{100 * use:.0f} %")
            for name, low, high, use in zip(
                plan.contacts,
                plan.normal_forces.min(axis=0),
                plan.normal_forces.max(axis=0),
                plan.friction_use.max(axis=0),
            )
        ],
    )
    lines += ["## Joints", ""]
    lines += table(
        ("joint", "largest torque [N m or N]", "largest speed [rad/s or m/s]"),
        [
            (name, number(float(torque)), number(float(speed)))
            for name, torque, speed in zip(
                plan.robot.joint_names, abs(plan.torques).max(axis=0), abs(plan.dq).max(axis=0)
            )
        ],
    )
    if plan.cautions:
        lines += ["## Cautions", "", *(f"- {escaped(one)}" for one in plan.cautions), ""]
    if plan.notes:
        lines += ["## Notes", "", *(f"- {escaped(note)}" for note in plan.notes), ""]
    if figures:
        lines += ["## Figures", ""]
        for name in figures:
            stem = name.rpartition(".")[0]
            lines += [f"![{_CAPTIONS.get(stem, stem.replace('_', ' '))}]({name})", ""]
    return "\n".join(lines)


def levels_of(simulation: Simulation | None) -> list[str]:
    """Colours of the headline's entries."""
    return ["yes" if simulation is None or simulation.verdict.held else "no"]


def _headline(plan: CarryPlan, simulation: Simulation | None) -> list[str]:
    kept = f"{100 * plan.reserve:g} % of friction, caps, torques and speeds are kept free"
    if plan.fastest is None:
        fast = f"Along the trajectory of {plan.duration:.4g} s; {plan.factor:.3g} times as fast could be held."
    else:
        fast = (
            f"In {plan.duration:.4g} s; {plan.fastest:.4g} s with accelerations that jump, and no timing of this path "
            f"takes less than {plan.lower_bound:.4g} s."
        )
    lines = [
        ("How fast?", f"{fast} {kept[0].upper()}{kept[1:]}."),
        ("How hard?", f"{plan.squeeze.min():.3g} to {plan.squeeze.max():.3g} N of normal force in all."),
        (
            "What binds?",
            "; ".join(f"{what} ({100 * share:.0f} % of the time)" for what, share in plan.shares()[:3]) + ".",
        ),
        ("How much friction?", f"Up to {100 * plan.friction_use.max():.0f} % of what is relied on."),
    ]
    if plan.cautions:
        lines.append(("Doubtful?", f"{'; '.join(plan.cautions)}."))
    if simulation is None:
        lines.append(("Simulated?", "Not yet: --check."))
    else:
        verdict = simulation.verdict
        lines.append(("Simulated?", f"{'Held' if verdict.held else 'Lost'} ({simulation.engine}): {verdict.reason}."))
        if verdict.causes:
            lines.append(("Why lost?", f"{'; '.join(verdict.causes)}."))
    return [f"**{what}** {escaped(text)}" for what, text in lines]
