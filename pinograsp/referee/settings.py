"""Settings of a simulation: the servos' gains and the disturbances."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, each_of, floats_of, instance_of, items_of, number, shown
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.spatial import Array

# Stiffness of a small servo [N m/rad]; a sliding joint is as stiff as that servo 30 mm from its axis [N/m].
_TURNING, _SLIDING = 50.0, 50.0 / 0.03**2
_ROTOR = 1e-4  # [kg m^2]
_MOST_MU = 1e6
_SETTLING = 0.01  # [s] ratio of damping to stiffness

Support = Literal["fixed", "table", "none"]
SUPPORTS: tuple[Support, ...] = ("fixed", "table", "none")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Servo:
    """Position servos of the joints: torque = stiffness (q* - q) + damping (dq* - dq) + the plan's torque, within the
    limits.

    Attributes:
        stiffness: (n,) [N m/rad or N/m].
        damping: (n,) [N m s/rad or N s/m].
        rotor: inertia of the motors, reflected to the joints (n,) [kg m^2 or kg].
    """

    stiffness: Array
    damping: Array
    rotor: Array

    __repr__ = brief()

    def __post_init__(self) -> None:
        n = floats_of("servo stiffness", self.stiffness).size
        for name in ("stiffness", "damping", "rotor"):
            values = array_of(f"servo {name}", getattr(self, name), (n,))
            if np.any(values < 0) or (name == "stiffness" and np.any(values == 0)):
                raise InvalidInput(f"servo {name}: expected values > 0, got {shown(values.tolist())}")
            object.__setattr__(self, name, values)

    @classmethod
    def of(cls, hand: HandModel, stiffness: ArrayLike | None = None, damping: ArrayLike | None = None) -> Servo:
        """Gains for a hand's servos.

        Rotor inertias are those of the hand's description. Where joints are coupled, they are at least 1e-4 kg m^2
        (0.11 kg for sliding joints), and the default damping is critical: MuJoCo's couplings are accurate only with
        damping that need not be implicit.

        Args:
            hand: whose joints the servos move.
            stiffness: one number or (n,); default: 50 N m/rad, 55.6 kN/m for sliding joints.
            damping: one number or (n,); default: 10 ms times the stiffness.
        """
        model = instance_of("hand", hand, HandModel).model
        slides = np.array([hand.is_prismatic(model.getJointId(name)) for name in hand.joint_names])
        chosen = (
            np.where(slides, _SLIDING, _TURNING) if stiffness is None else _each("servo stiffness", stiffness, hand.n)
        )
        rotor = np.array(model.armature)
        if hand.couplings:
            rotor = np.maximum(rotor, np.where(slides, _ROTOR / 0.03**2, _ROTOR))
        if damping is not None:
            damped = _each("servo damping", damping, hand.n)
        elif hand.couplings:
            inertia = np.diag(pin.crba(model, model.createData(), np.clip(np.zeros(hand.n), hand.lower, hand.upper)))
            damped = 2 * np.sqrt(chosen * (inertia - model.armature + rotor))
        else:
            damped = _SETTLING * chosen
        return cls(stiffness=chosen, damping=damped, rotor=rotor)


def _each(name: str, value: object, n: int) -> Array:
    values = each_of(name, value, n)
    if np.any(values <= 0):
        raise InvalidInput(f"{name}: expected values > 0, got {shown(values.tolist())}")
    return values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Push:
    """A constant wrench on the object for a limited time.

    Attributes:
        wrench_o: about the object's centre of mass, world axes, linear first (6,) [N, N m].
        start: counted from when the object's support is gone [s].
        duration: [s].
    """

    wrench_o: Array
    start: float = 0.2
    duration: float = 0.1

    __repr__ = brief()

    def __post_init__(self) -> None:
        object.__setattr__(self, "wrench_o", array_of("push", self.wrench_o, (6,)))
        object.__setattr__(self, "start", number("start of the push", self.start, at_least=0, unit="s"))
        object.__setattr__(self, "duration", number("duration of the push", self.duration, above=0, unit="s"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbance:
    """Differences between the simulation and the plan.

    Attributes:
        pushes: wrenches on the object.
        shake: amplitude of a sinusoidal acceleration of the whole hand from t_F on (3,) [m/s^2].
        shake_frequency: [Hz].
        mu: friction coefficient of all contacts [-]; None: the plan's.
        mass_factor: ratio of the object's mass to the planned mass.
        object_offset: displacement of the object before the hand moves (3,) [m]; it shifts the contact points.
        object_turn: rotation vector of the object before the hand moves (3,) [rad].
        start_error: of the joints at t = 0 (n,) [rad or m]; None: no error.
    """

    pushes: tuple[Push, ...] = ()
    shake: Array = field(default_factory=lambda: np.zeros(3))
    shake_frequency: float = 3.0
    mu: float | None = None
    mass_factor: float = 1.0
    object_offset: Array = field(default_factory=lambda: np.zeros(3))
    object_turn: Array = field(default_factory=lambda: np.zeros(3))
    start_error: Array | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("pushes", (self.pushes,) if isinstance(self.pushes, Push) else items_of("pushes", self.pushes, Push))
        for name, unit in (("shake", "m/s^2"), ("object_offset", "m"), ("object_turn", "rad")):
            put(name, array_of(f"{name} [{unit}]", getattr(self, name), (3,)))
        put("shake_frequency", number("shake frequency", self.shake_frequency, above=0, unit="Hz"))
        if self.mu is not None:
            put("mu", number("mu", self.mu, at_least=0, at_most=_MOST_MU))
        put("mass_factor", number("mass factor", self.mass_factor, above=0))
        if self.start_error is not None:
            put("start_error", array_of("start error", self.start_error, (None,)))

    def wrench(self, since_release: float) -> Array:
        """Sum of the pushes (6,) [N, N m] at a time after the object's support is gone [s]."""
        since_release = number("time since the release", since_release, unit="s")
        total = np.zeros(6)
        for push in self.pushes:
            if push.start <= since_release < push.start + push.duration:
                total += push.wrench_o
        return total

    def summary(self) -> dict[str, Any]:
        """What differs from the plan, as plain values."""
        values: dict[str, Any] = {}
        if self.pushes:
            values["pushes"] = [
                {"wrench_N_Nm": push.wrench_o.tolist(), "start_s": push.start, "duration_s": push.duration}
                for push in self.pushes
            ]
        if np.any(self.shake):
            values |= {"shake_m_s2": self.shake.tolist(), "shake_Hz": self.shake_frequency}
        if self.mu is not None:
            values["mu"] = self.mu
        if self.mass_factor != 1.0:
            values["mass_factor"] = self.mass_factor
        for name in ("object_offset", "object_turn"):
            if np.any(getattr(self, name)):
                values[name + ("_m" if name.endswith("offset") else "_rad")] = getattr(self, name).tolist()
        if self.start_error is not None:
            values["start_error"] = np.asarray(self.start_error).tolist()
        return values
