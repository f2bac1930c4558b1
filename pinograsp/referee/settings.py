"""What a simulation can be told: the servos' gains, and what goes wrong."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of, brief, each_of, floats_of, instance_of, items_of, number, shown
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel

# Stiffness of a small servo [N m/rad]; sliding joints as stiff as that one is 30 mm from its axis [N/m].
_TURNING, _SLIDING = 50.0, 50.0 / 0.03**2
_ROTOR = 1e-4  # [kg m^2]
_MOST_MU = 1e6
_SETTLING = 0.01  # [s] damping over stiffness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Servo:
    """Position servos of the joints: torque = stiffness (q* - q) + damping (dq* - dq) + the plan's torque, within the
    limits.

    Attributes:
        stiffness: (n,) [N m/rad or N/m].
        damping: (n,) [N m s/rad or N s/m].
        rotor: the motors' own inertia, seen at the joints (n,) [kg m^2 or kg]; zero: none.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    rotor: np.ndarray

    __repr__ = brief()

    def __post_init__(self):
        n = floats_of("servo stiffness", self.stiffness).size
        for name in ("stiffness", "damping", "rotor"):
            values = array_of(f"servo {name}", getattr(self, name), (n,))
            if np.any(values < 0) or (name == "stiffness" and np.any(values == 0)):
                raise InvalidInput(f"servo {name}: expected values > 0, got {shown(values.tolist())}")
            object.__setattr__(self, name, values)

    @classmethod
    def of(cls, hand: HandModel, stiffness=None, damping=None) -> Servo:
        """Gains of a hand's servos: one number or (n,) each.

        Rotors are the description's. Default: 50 N m/rad (55.6 kN/m where joints slide), settling in 10 ms. Where
        joints are coupled, motors have a rotor (1e-4 kg m^2, 0.11 kg) and are critically damped: MuJoCo couples joints
        well only if damping need not be implicit.
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


def _each(name: str, value, n: int) -> np.ndarray:
    values = each_of(name, value, n)
    if np.any(values <= 0):
        raise InvalidInput(f"{name}: expected values > 0, got {shown(values.tolist())}")
    return values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Push:
    """A wrench on the object for a while.

    Attributes:
        wrench_o: about its centre of mass, world axes, linear first (6,) [N, N m].
        start: after the support of the object is gone [s].
        duration: [s].
    """

    wrench_o: np.ndarray
    start: float = 0.2
    duration: float = 0.1

    __repr__ = brief()

    def __post_init__(self):
        object.__setattr__(self, "wrench_o", array_of("push", self.wrench_o, (6,)))
        object.__setattr__(self, "start", number("start of the push", self.start, at_least=0, unit="s"))
        object.__setattr__(self, "duration", number("duration of the push", self.duration, above=0, unit="s"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbance:
    """What is not as planned.

    Attributes:
        pushes: wrenches on the object.
        shake: amplitude of a sinusoidal acceleration of the whole hand from t_F on (3,) [m/s^2], at
            ``shake_frequency`` [Hz].
        mu: friction coefficient of all contacts [-]; None: the plan's.
        mass_factor: the object weighs this many times as much.
        object_offset: displacement of the object (3,) [m], and object_turn: its rotation vector (3,) [rad], before the
            hand comes: so the contact points are off by as much.
        start_error: of the joints at t = 0 (n,) [rad or m]; None: none.
    """

    pushes: tuple[Push, ...] = ()
    shake: np.ndarray = field(default_factory=lambda: np.zeros(3))
    shake_frequency: float = 3.0
    mu: float | None = None
    mass_factor: float = 1.0
    object_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    object_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    start_error: np.ndarray | None = None

    __repr__ = brief()

    def __post_init__(self):
        def put(name, value):
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

    def wrench(self, since_release: float) -> np.ndarray:
        """On the object (6,) [N, N m], so long after its support is gone [s]."""
        since_release = number("time since the release", since_release, unit="s")
        total = np.zeros(6)
        for push in self.pushes:
            if push.start <= since_release < push.start + push.duration:
                total += push.wrench_o
        return total

    def summary(self) -> dict:
        """What differs from the plan, as plain values."""
        told = {}
        if self.pushes:
            told["pushes"] = [
                {"wrench_N_Nm": push.wrench_o.tolist(), "start_s": push.start, "duration_s": push.duration}
                for push in self.pushes
            ]
        if np.any(self.shake):
            told |= {"shake_m_s2": self.shake.tolist(), "shake_Hz": self.shake_frequency}
        if self.mu is not None:
            told["mu"] = self.mu
        if self.mass_factor != 1.0:
            told["mass_factor"] = self.mass_factor
        for name in ("object_offset", "object_turn"):
            if np.any(getattr(self, name)):
                told[name + ("_m" if name.endswith("offset") else "_rad")] = getattr(self, name).tolist()
        if self.start_error is not None:
            told["start_error"] = np.asarray(self.start_error).tolist()
        return told
