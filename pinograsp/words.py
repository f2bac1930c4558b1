"""Words and numbers for people, the same in reports, figures, on the command line and in the viewer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from pinograsp.errors import Status

_LOAD = "the contact forces hold the load"

# Part of a run's JSON file: its values are of every type that JSON has.
Values: TypeAlias = Mapping[str, Any]


def number(value: float | None, digits: int = 4) -> str:
    """A number for people: plain where that is short, scientific where it is not, a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    return f"{value:.{max(digits - 1 - exponent, 0)}f}" if -4 <= exponent < 6 else f"{value:.{digits - 2}e}"


def escaped(text: str, keep: str = "") -> str:
    """Text with control and direction characters escaped, except those to ``keep``."""
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


def printable(text: str, most: int = 200) -> str:
    """A foreign name as one line of text: control and direction characters escaped, at most ``most`` characters."""
    shown = escaped(str(text))
    return shown if len(shown) <= most else f"{shown[: most - 3]}..."


@dataclass(frozen=True, slots=True)
class Answer:
    """Whether a plan holds: ``level`` says how far to trust it, ``text`` in words, the answer first."""

    level: Literal["yes", "caution", "no"]
    text: str


def does_it_hold(summary: Values, check: Values | None = None) -> Answer:
    """The answer of a plan's summary and of a simulation's (``check``), where there was one.

    What was seen in a simulation counts more than what was planned; a simulation that was not as planned (disturbed)
    speaks for itself alone.
    """
    status = summary["status"]
    if check is not None and not check["held"]:
        reason = printable(check["reason"], 400)
        if check.get("disturbance"):
            return Answer(
                "caution", f"Not with what it was tried with: lost in simulation under disturbances; {reason}."
            )
        return Answer("no", f"No. Lost in simulation: {reason}.")
    tried = "" if check is None else " Held in simulation."
    if status == Status.NOT_TRACKED.value:
        return Answer(
            "caution", f"Not certain: {_LOAD}, but the hand cannot follow their paths. {summary['remedy']}{tried}"
        )
    if status not in (Status.OK.value, Status.UNBALANCED.value):
        text = f"The plan is not complete ({status}): {summary['remedy']}"
        return Answer("no", text) if check is None else Answer("caution", f"{text}{tried}")
    if status == Status.UNBALANCED.value:
        left = f"{number(summary['residual_N'], 3)} N and {number(summary['residual_Nm'], 3)} N m"
        return Answer("caution", f"Almost: {_LOAD} but for {left}.{tried}")
    if summary["balance"] == "force":
        return Answer(
            "caution", f"Not certain: moments are not balanced, a free object turns. Forces alone: {_LOAD}.{tried}"
        )
    if summary.get("cautions"):
        return Answer("caution", f"Yes, with cautions: {_LOAD}, forces and moments in balance.{tried}")
    return Answer("yes", f"Yes. {_LOAD[0].upper()}{_LOAD[1:]}, forces and moments in balance.{tried}")


def friction_model(friction: Values) -> str:
    """Of a summary's ``friction``: the model and its coefficient."""
    low, high = min(friction["mu"]), max(friction["mu"])
    mu = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    model = (
        f"pyramid of {friction['edges']} edges"
        if friction["edges"]
        else {"soft": "soft finger"}.get(friction["model"], "cone")
    )
    torsion = f", torsion up to {1e3 * friction['torsion_m']:g} mm x F_n" if friction["torsion_m"] else ""
    return f"mu {mu}, {model}, safety factor {friction['safety']:g}{torsion}"


def friction_used(summary: Values) -> list[tuple[str, dict[str, float | None]]]:
    """What the contacts use of friction: their share of Coulomb's cone, mu F_n; and of the model's limit where that is
    another.

    Neither counts the safety factor. None: tangential force where there is no friction.
    """
    friction, margins = summary["friction"], summary["margins"]
    cone = {
        name: least / mu if mu > 0 else None if least > 0 else 0.0
        for (name, least), mu in zip(margins["least_mu"].items(), friction["mu"])
    }
    rows: list[tuple[str, dict[str, float | None]]] = [("friction used, of mu F_n", cone)]
    if friction["model"] != "cone" or friction["torsion_m"]:
        limit = {"soft": "soft finger"}.get(friction["model"], friction["model"])
        torsion = " with torsion" if friction["torsion_m"] and friction["model"] != "soft" else ""
        rows.append((f"of the {limit}{torsion}", margins["friction_used"]))
    return rows


def shares(values: dict[str, float | None]) -> str:
    """Shares by name, in percent."""
    return ", ".join(
        f"{printable(name, 60)} {'slips' if v is None else f'{100 * v:.0f} %'}" for name, v in values.items()
    )


def work(joules: float, exponent: float | None) -> str:
    """Grasp energy by Eq. (9), and what of it is work that the contacts do."""
    text = f"{number(1e3 * joules)} mJ by Eq. (9)"
    if exponent is not None:
        text += f", rho + 1 = {1 + exponent:g} times the contacts' {number(1e3 * joules / (1 + exponent))} mJ"
    return text


def disturbance_held(margins: Values, safety: float) -> str:
    """What the grasp bears besides its load, with its normal forces; and why that is nothing in some direction."""
    moment = (
        ""
        if margins["disturbance_moment_Nm"] is None
        else f", {number(margins['disturbance_moment_Nm'], 3)} N m about any axis"
    )
    text = f"{number(margins['disturbance_force_N'], 3)} N in any direction{moment}"
    if margins["disturbance_any_N"] > 0:
        return text
    if not margins["force_closure"]:
        return f"{text} (no force closure: some direction is free, whatever the friction)"
    return text if safety > 1 else f"{text} (friction is at its limit: ask for a friction safety factor above 1)"


def load_factor(margins: Values) -> str:
    """The load that the normal forces hold."""
    return (
        "any multiple of the load" if margins["load_factor"] is None else f"{margins['load_factor']:.3g} times the load"
    )
