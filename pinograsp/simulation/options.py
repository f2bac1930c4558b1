"""How a task is simulated: what a simulation takes beside the plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, TypedDict

import numpy as np

from pinograsp import defaults
from pinograsp.checks import brief, flag, instance_of, number, one_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.plan.felt import Controller
from pinograsp.simulation.sensing import Sensors
from pinograsp.simulation.settings import SUPPORTS, Disturbance, Servo, Support

Mode = Literal["servo", "prescribed"]
MODES: tuple[Mode, ...] = ("servo", "prescribed")
COARSEST = 0.05  # [s] largest time step, and largest interval between samples


class SimulationSettings(TypedDict, total=False):
    """Keyword arguments of :func:`~pinograsp.simulation.simulate` that series of simulations share."""

    hold: float
    servo: Servo | None
    time_step: float
    sample: float
    support: Support | None
    letting_go: float


class StudySettings(SimulationSettings, total=False):
    """Keyword arguments of a study: those that its trials share, and the object where the plan has none."""

    mode: Mode
    body: Body | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulationOptions:
    """The checked arguments of :func:`~pinograsp.simulation.simulate`.

    Attributes:
        hold: time after the object's support is gone [s]; with a release, at least one step.
        mode: ``"servo"``; or ``"prescribed"``: joints follow the commands exactly.
        disturbance: differences from the plan.
        servo: control of the joints and gains; None: the hand's own servos, :meth:`Servo.of`, with the plan's gains
            while it closes.
        time_step: at most 0.05 s, and two million steps in all [s]. An object that swings too fast on its contacts
            for it, since it is light or harder than planned, gets one up to 20 times shorter, with a note.
        sample: interval between samples of the record [s].
        release: False: the object stays fixed to the end.
        support: of the object until then: ``"fixed"``: it cannot move until t_F (as in the paper);
            ``"table"``: it stands freely on a table under it, so that whatever hits it on the way moves it (the hand
            itself passes through the table); ``"none"``: from t_I on nothing but the hand holds it. None: a table where
            the plan has one; none of plans that have a reserve; fixed of others, and of objects that are not let
            go.
        letting_go: time that the support takes to fade after t_F [s]; 0: the support vanishes at once, which
            doubles the load for a moment.
        controller: called from t_F on at each period of its sensors: what the drives are sent.
        sensors: what it feels.
    """

    hold: float = defaults.HOLD
    mode: Mode = "servo"
    disturbance: Disturbance = field(default_factory=Disturbance)
    servo: Servo | None = None
    time_step: float = defaults.TIME_STEP
    sample: float = 2e-3
    release: bool = True
    support: Support | None = None
    letting_go: float = 0.2
    controller: Controller | None = None
    sensors: Sensors = field(default_factory=Sensors)

    __repr__ = brief("hold", "mode", "disturbance", "time_step", "support")

    def __post_init__(self) -> None:
        one_of("mode", self.mode, MODES)
        if self.support is not None:
            one_of("support", self.support, SUPPORTS)
        instance_of("servo", self.servo, Servo, type(None))
        instance_of("disturbance", self.disturbance, Disturbance)
        flag("release", self.release)
        for name, value in (
            ("hold", number("hold", self.hold, at_least=0, unit="s")),
            ("time_step", number("time step", self.time_step, above=0, unit="s")),
            ("letting_go", number("letting go", self.letting_go, at_least=0, unit="s")),
            ("sample", number("sample", self.sample, above=0, unit="s")),
        ):
            object.__setattr__(self, name, value)
        self._check_together()

    def _check_together(self) -> None:
        """Refuse what does not go together, whatever the plan."""
        disturbance, hold = self.disturbance, self.hold
        if self.sample > COARSEST:
            raise InvalidInput(
                f"sample: expected at most {COARSEST:g} s, got {self.sample:g} s: the verdict depends on the samples"
            )
        if not self.release:
            if self.support not in (None, "fixed"):
                raise InvalidInput(
                    f"support: expected 'fixed' with release=False, got '{self.support}', which lets the object go"
                )
            if disturbance.base_motion is not None:
                raise InvalidInput("base motion: expected with release=True, got release=False, which fixes the object")
        elif hold < self.time_step:
            raise InvalidInput(
                f"hold: expected at least one step, {self.time_step:g} s, got {hold:g} s: without a hold there is "
                "nothing to judge"
            )
        errors = {
            "start error": disturbance.start_error is not None,
            "joint offset": np.any(disturbance.joint_offset),
            "joint friction": np.any(disturbance.joint_friction),
            "servo gain": disturbance.servo_gain != 1.0,
            "command delay": np.any(disturbance.command_delay),
            "drive gain": np.any(np.asarray(disturbance.drive_gain) != 1.0),
        }
        instance_of("sensors", self.sensors, Sensors)
        if self.controller is not None:
            if not callable(self.controller):
                raise InvalidInput(f"controller: expected a function of the measurements, got {self.controller!r}")
            if self.mode == "prescribed" or not self.release:
                raise InvalidInput("controller: expected with mode='servo' and release=True: drives hold the object")
        for name, given in errors.items():
            if given and self.mode == "prescribed":
                raise InvalidInput(
                    f"{name}: expected only with mode='servo', got one with mode='prescribed': those joints have no "
                    "error"
                )

    def summary(self) -> dict[str, Any]:
        """As plain JSON values, without the disturbance, and all that the simulation of a servo hangs on."""
        servo: dict[str, Any] | None = None
        if self.servo is not None:
            servo = {name: getattr(self.servo, name).tolist() for name in ("stiffness", "damping", "rotor")}
            servo |= {} if self.servo.control == "impedance" else {"control": self.servo.control}
        names = ("hold", "mode", "time_step", "sample", "support", "letting_go")
        return {**{name: getattr(self, name) for name in names}, "servo": servo}
