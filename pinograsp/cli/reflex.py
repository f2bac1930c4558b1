"""Options of ``pinograsp check`` for a squeeze that follows what is felt, and what its controller believed."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any

from pinograsp.cli.options import read_numbers, read_settings
from pinograsp.cli.session import option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.plan import Verdict
    from pinograsp.planner import GraspPlan
    from pinograsp.reflex import GripController
    from pinograsp.simulation import Disturbance, Sensors, Servo

_FELT = ("forces", "slips")

_reflex = partial(option, "Reaction to touch and slip")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReflexOptions:
    """The plan's grip controller in the loop."""

    reflex: bool = _reflex(
        "From t_F on, the plan's grip_controller commands the squeeze; the result is shown beside that of the "
        "plan's own squeeze.",
        "--reflex",
        default=False,
    )
    feels: str | None = _reflex(
        "What the hand's sensors measure: forces (vectors), normal_forces, slips, torques (of joints, by "
        "their currents), wrench, acceleration; default: forces,slips.",
        metavar="NAME,...",
    )
    sensors: str | None = _reflex(
        "How well the sensors measure, in SI units, by the names in pinograsp.simulation.Sensors: noise, "
        "offset, delay, loss, resolution, period, seed.",
        metavar="NAME=VALUE,...",
    )

    def read(self) -> Sensors | None:
        """What is felt, and how well; None: nothing, the squeeze is the plan's."""
        from pinograsp.simulation import Sensors

        if not self.reflex:
            for name in ("feels", "sensors"):
                if getattr(self, name) is not None:
                    raise InvalidInput(f"--{name}: expected with --reflex, whose controller uses the sensors")
            return None
        known = [field.name for field in fields(Sensors) if field.name != "quantities"]
        given: dict[str, Any] = {}
        told = {} if self.sensors is None else read_settings("--sensors", self.sensors, known)
        for name, value in told.items():
            number = read_numbers("--sensors", value, (1,))[0]
            given[name] = int(number) if name == "seed" and number == int(number) else number
        return Sensors(quantities=_FELT if self.feels is None else tuple(self.feels.split(",")), **given)


def make_controller(plan: GraspPlan, sensors: Sensors, disturbance: Disturbance, servo: Servo | None) -> GripController:
    """The plan's, which knows how late its sensors and drives are; servos that take positions alone get references."""
    import numpy as np

    return plan.grip_controller(
        latency=sensors.delay + float(np.max(disturbance.command_delay)),
        period=sensors.period,
        stiffness=servo.stiffness if servo is not None and servo.control == "position" else None,
    )


@dataclass(frozen=True, slots=True)
class Believed:
    """What a grip controller believed at the end, and how the same ended with the plan's own squeeze."""

    controller: GripController
    sensors: Sensors
    without: Verdict

    def summary(self) -> dict[str, Any]:
        """As plain JSON values, units in the names; None: not bounded."""
        grip = self.controller
        bounds = {name: getattr(grip, name).tolist() for name in ("mu", "mu_low", "mu_high")}
        finite = {name: [one if math.isfinite(one) else None for one in values] for name, values in bounds.items()}
        return {
            "feels": list(self.sensors.quantities),
            "object_mass_kg": grip.object_mass,
            "load_N_Nm": grip.load.tolist(),
            "load_bound_N": grip.load_bound if math.isfinite(grip.load_bound) else None,
            **{name: dict(zip(grip.names, values)) for name, values in finite.items()},
            "wanted_forces_N": dict(zip(grip.names, grip.forces[:, 2].tolist())),
            "reflexes": grip.reflexes,
            "blind": grip.blind,
            "status": str(grip.status),
            "without_reflex": self.without.summary(),
        }

    def list_answers(self) -> list[tuple[str, str]]:
        """By question."""
        grip, v = self.controller, self.without
        mass = f"{grip.object_mass:.3g} kg"
        if not math.isfinite(grip.load_bound):
            mass = f"no load measured, {mass} as planned"
        each = []
        for name, mu, low, high in zip(grip.names, grip.mu, grip.mu_low, grip.mu_high):
            bounds = f"{low:.2f} to {high:.2f}" if math.isfinite(high) else f"at least {low:.2f}"
            each.append(f"{name} {mu:.2f} ({bounds})")
        jumps = f"{grip.reflexes} reflex{'' if grip.reflexes == 1 else 'es'}"
        blind = ", blind" if grip.blind else ""
        return [
            ("Without reflex?", f"{'HELD' if v.held else 'LOST'}: {v.reason}"),
            ("Believed", f"{mass}; {jumps}; {grip.status}{blind}; friction {', '.join(each)}"),
        ]

    def describe(self) -> str:
        """The answers as lines."""
        return "\n".join(f"{what} {text}" for what, text in self.list_answers())
