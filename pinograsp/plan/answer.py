"""What a plan says, in words and numbers for people: the same in reports, figures, on the command line and in the
viewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pinograsp.checks import instance_of
from pinograsp.errors import Status
from pinograsp.plan.parts import WEAK, PlanFriction, PlanMargins, PlanReserve
from pinograsp.plan.record import PlanRecord
from pinograsp.plan.simulation import Simulation
from pinograsp.words import format_fixed, format_number, printable

Level = Literal["yes", "caution", "no"]

# Every answer of :func:`does_it_hold`, by its first words, and what it means.
ANSWERS: dict[str, str] = {
    "Yes": "forces and moments are in balance with the load, nothing casts doubt on the plan, and the object was held "
    "if the plan was simulated",
    "Yes, with warnings": "the same, but the plan has warnings: what its promise does not cover, each in words",
    "Barely": f"the load is held, but in some direction an additional push of less than {100 * WEAK:g} % of the weight "
    "is too much: plan with a reserve",
    "Almost": "forces balance the load except for a small residual, which the answer gives in newtons: a grid search "
    "with the paper's net-force limit (status unbalanced)",
    "Not certain": "forces hold the load, but it is not certain that the hand can produce them or keep the object: "
    "fingers cannot follow their paths (not_tracked), forces act on edges or the object is easily pushed away "
    "(doubtful), or moments are not balanced; the answer says which",
    "Not with what it was tried with": "lost in a simulation with disturbances or other differences from the plan, "
    "which says nothing about the plan without them",
    "No": "lost in a simulation of the plan as it is; the reason follows",
    "The plan is not complete": "there are forces, but no complete motion, or the search was stopped: the status and "
    "its remedy follow",
    "No grasp": "the search ended without forces; the folder has the proof, or what is known instead",
}

_GRAVITY = 9.80665  # [m/s^2]: one g
_LOAD = "the contact forces hold the load"
_NOT_SIMULATED = "Not simulated yet."
SIMULATED = "simulated ("  # how notes and warnings begin that tell of a simulation


@dataclass(frozen=True, slots=True)
class Answer:
    """Whether a plan holds.

    Attributes:
        level: how far to trust it.
        text: in words, the answer first.
    """

    level: Level
    text: str


def _tell_held(simulation: Simulation) -> str:
    return f"Held in simulation {simulation.describe_controller()}".rstrip()


def does_it_hold(plan: PlanRecord, simulation: Simulation | None = None) -> Answer:
    """The answer of a plan, and of a simulation of it where there was one.

    What was seen in a simulation counts more than what was planned; a simulation that was not as planned (disturbed)
    speaks for itself alone.
    """
    status = plan.status
    instance_of("simulation", simulation, Simulation, type(None))
    if simulation is not None and not simulation.verdict.held:
        reason = printable(simulation.verdict.reason, 400)
        if simulation.disturbance:
            lost = f": lost in simulation under disturbances; {reason}."
            return _answer("caution", "Not with what it was tried with", lost)
        return _answer("no", "No", f". Lost in simulation: {reason}.")
    tried = f" {describe_trial(plan) or _NOT_SIMULATED}" if simulation is None else f" {_tell_held(simulation)}."
    if status is not Status.OK:
        level: Level = "no" if status.answer == "The plan is not complete" and simulation is None else "caution"
        return _answer(level, status.answer, _without_success(plan, status, "" if level == "no" else tried))
    if plan.balance == "force":
        turns = f": moments are not balanced, a free object turns. Forces alone: {_LOAD}.{tried}"
        return _answer("caution", "Not certain", turns)
    if plan.margins is not None and plan.margins.spares_nothing(plan.weight):
        return _answer("caution", "Barely", f": {_LOAD}, and less than {100 * WEAK:g} % of the weight besides.{tried}")
    if plan.cautions:
        return _answer("caution", "Yes, with warnings", f": {_LOAD}, forces and moments in balance.{tried}")
    return _answer("yes", "Yes", f". {_LOAD[0].upper()}{_LOAD[1:]}, forces and moments in balance.{tried}")


def _without_success(plan: PlanRecord, status: Status, tried: str) -> str:
    """What follows the first words of the answer of a plan that is not ``OK``."""
    if status is Status.NOT_TRACKED:
        return f": {_LOAD}, but the hand cannot follow their paths. {plan.remedy.rstrip('.')}.{tried}"
    if status is Status.DOUBTFUL:
        return f": {_LOAD}, but {plan.remedy}.{tried}"
    if status is Status.UNBALANCED:
        left = (
            f"{format_number(plan.forces.residual_force, 3)} N and {format_number(plan.forces.residual_moment, 3)} N m"
        )
        return f": {_LOAD} but for {left}.{tried}"
    return f" ({status}): {plan.remedy}{tried}"


def _answer(level: Level, word: str, text: str) -> Answer:
    return Answer(level, f"{word}{text}")


def no_grasp(status: Status) -> Answer:
    """The answer where there is no plan."""
    return _answer("no", status.answer, f" ({status}).")


def describe_trial(plan: PlanRecord) -> str:
    """What was simulated as the plan was chosen; empty: nothing."""
    told = [one for one in (*plan.cautions, *plan.notes) if one.startswith(SIMULATED)]
    return f"{told[0][0].upper()}{told[0][1:]}." if told else ""


def where_the_hand_is(plan: PlanRecord) -> str:
    """Where the hand's root is in the object's frame, that of its file; empty where it is not known."""
    placed = plan.hand_in_object
    if placed is None:
        return ""
    shift, R = 1e3 * placed[:3, 3], placed[:3, :3]
    angles = (np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(np.clip(R[2, 0], -1.0, 1.0)), np.arctan2(R[1, 0], R[0, 0]))
    at, turned = (", ".join(format_fixed(value, 1) for value in values) for values in (shift, np.degrees(angles)))
    return f"root at {at} mm, roll, pitch, yaw {turned} deg in the object's frame (its file's)"


def friction_model(friction: PlanFriction) -> str:
    """The model and its coefficient."""
    low, high = float(friction.mu.min()), float(friction.mu.max())
    mu = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    model = f"pyramid of {friction.edges} edges" if friction.edges else friction.traits.words
    torsion = f", torsion up to {1e3 * friction.torsion:g} mm x F_n" if friction.torsion else ""
    return f"mu {mu}, {model}, safety factor {friction.safety:g}{torsion}"


def friction_used(plan: PlanRecord) -> list[tuple[str, dict[str, float]]]:
    """What the contacts use of friction: their share of Coulomb's cone, mu F_n; and of the model's limit where that is
    another.

    Neither counts the safety factor. Infinite: tangential force where there is no friction.
    """
    friction, margins, names = plan.friction, plan.require_margins(), plan.contacts.names
    cone = {
        name: least / mu if mu > 0 else np.inf if least > 0 else 0.0
        for name, least, mu in zip(names, margins.least_mu.tolist(), friction.mu.tolist())
    }
    uses = [("friction used, of mu F_n", cone)]
    traits = friction.traits
    if traits.polygon or friction.torsion:
        torsion = " with torsion" if friction.torsion and not traits.elliptic else ""
        uses.append((f"of the {traits.words}{torsion}", dict(zip(names, margins.friction_used.tolist()))))
    return uses


def shares(values: dict[str, float]) -> str:
    """Shares by name, in percent."""
    return ", ".join(
        f"{printable(name, 60)} {f'{100 * value:.0f} %' if np.isfinite(value) else 'slips'}"
        for name, value in values.items()
    )


def work(plan: PlanRecord) -> str:
    """Grasp energy by Eq. (9), and what of it is work that the contacts do."""
    return work_in_words(plan.forces.work, plan.law.exponent)


def work_in_words(joules: float, exponent: float) -> str:
    """An energy by Eq. (9) [J], and what of it is work that contacts of that exponent do; 0: of a law without one."""
    if exponent == 0:
        return f"{format_number(1e3 * joules)} mJ, the contacts' work"
    contacts = format_number(1e3 * joules / (1 + exponent))
    return f"{format_number(1e3 * joules)} mJ by Eq. (9), rho + 1 = {1 + exponent:g} times the contacts' {contacts} mJ"


def disturbance_held(margins: PlanMargins, safety: float) -> str:
    """What the grasp withstands besides its load, with its normal forces; and why if some direction has nothing."""
    moment = ""
    if margins.disturbance_moment is not None:
        moment = f", {format_number(margins.disturbance_moment, 3)} N m about any axis"
    text = f"{format_number(margins.disturbance_force, 3)} N in any direction{moment}"
    if margins.disturbance > 0:
        return text
    if not margins.force_closure:
        return f"{text} (no force closure: some direction is free, whatever the friction)"
    return text if safety > 1 else f"{text} (friction is at its limit: ask for a friction safety factor above 1)"


def describe_robustness(plan: PlanRecord) -> str:
    """What the squeeze as planned withstands besides the load: a push, a shake, more mass; with all of the friction."""
    margins = plan.require_margins()
    text = f"a push of {format_number(margins.disturbance_force, 3)} N in any direction"
    if plan.body_mass == 0:
        return f"{text}; {describe_load_factor(margins)}"
    shake = margins.disturbance_force / plan.body_mass
    held = margins.load_factor
    mass = "any mass" if not np.isfinite(held) else f"{format_number(held, 3)} times its mass"
    return f"{text}, or a shake of {format_number(shake, 3)} m/s2 ({format_number(shake / _GRAVITY, 2)} g), or {mass}"


def planned_reserve(reserve: PlanReserve | None) -> str:
    """What the forces were planned to withstand besides the load."""
    if reserve is None:
        return "none: planned for the load alone"
    parts = [
        (reserve.disturbance, f"{_percent(reserve.disturbance)} of the weight in any direction ({_pushes(reserve)})"),
        (reserve.mass, f"mass +-{_percent(reserve.mass)}"),
        (reserve.friction, f"{_percent(reserve.friction)} of the friction"),
        (reserve.normal_force, f"at least {format_number(reserve.normal_force, 3)} N at each contact"),
        (reserve.torque, f"{_percent(reserve.torque)} of each torque limit"),
        (reserve.softer > 1, f"contacts {reserve.softer:g} times as soft"),
        (reserve.stiffer > 1, f"contacts {reserve.stiffer:g} times as stiff"),
        (reserve.drive, f"drives {_percent(reserve.drive)} weaker or stronger"),
        *((True, task) for task in reserve.tasks),
    ]
    return ", ".join(text for share, text in parts if share) or "none: planned for the weight alone"


def _pushes(reserve: PlanReserve) -> str:
    moment = f", or {format_number(reserve.moment, 3)} N m about any axis" if reserve.moment else ""
    return f"{format_number(reserve.force, 3)} N{moment}"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def describe_load_factor(margins: PlanMargins) -> str:
    """The load that the normal forces hold."""
    held = margins.load_factor
    return f"{held:.3g} times the load" if np.isfinite(held) else "any multiple of the load"


def list_forces(plan: PlanRecord) -> list[tuple[str, str]]:
    """What the forces cost and leave over, as pairs of a name and a value with its unit."""
    forces = plan.forces
    return [
        ("grasp energy (work)", work(plan)),
        ("net force, net moment", f"{forces.residual_force:.2e} N, {forces.residual_moment:.2e} N m"),
        ("largest penetration", f"{1e3 * forces.final_depths.max():.3f} mm"),
        ("peak joint effort", plan.peak_efforts()),
    ]


def list_margins(plan: PlanRecord) -> list[tuple[str, str]]:
    """What the grasp withstands besides its load with these normal forces, likewise."""
    margins = plan.require_margins()
    closure = "force closure" if margins.force_closure else "no force closure"
    quality = (
        f"{closure}, Ferrari-Canny epsilon {format_number(margins.ferrari_canny, 3)}, "
        f"smallest singular value {format_number(margins.min_singular_value, 3)}"
    )
    return [
        *((what, shares(values)) for what, values in friction_used(plan)),
        ("load held by these forces", describe_load_factor(margins)),
        ("disturbance held besides", disturbance_held(margins, plan.friction.safety)),
        ("grasp", quality),
    ]
