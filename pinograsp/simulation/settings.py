"""Settings of a simulation: the control of the joints, and the disturbances."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from pinograsp.checks import (
    array_of,
    at_least_zero,
    brief,
    each_of,
    floats_of,
    instance_of,
    items_of,
    number,
    one_of,
    shorten,
)
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel, servo_gains
from pinograsp.hands.servos import SETTLING
from pinograsp.spatial import Array, BoolArray

_ROTOR = 1e-4  # [kg m^2]
_MOST_MU = 1e6
_LATEST = 2.0  # [s]
_STIFFNESSES = (1e-3, 1e4)  # ratios of real to planned contact stiffness: foam for plastic to steel for rubber
_LIMP = 0.1  # torque control is damped as servos with this share of the default stiffness

Control = Literal["torque", "position", "impedance"]
CONTROLS: tuple[Control, ...] = ("torque", "position", "impedance")
Support = Literal["fixed", "table", "none"]
SUPPORTS: tuple[Support, ...] = ("fixed", "table", "none")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Servo:
    """Drives of the joints: torque = stiffness (q* - q) + damping (dq* - dq) + the plan's torque, within the limits.

    Attributes:
        stiffness: kp (n,) [N m/rad or N/m]; 0 with torque control.
        damping: (n,) [N m s/rad or N s/m].
        rotor: inertia of the motors, reflected to the joints (n,) [kg m^2 or kg].
        control: ``"impedance"``: servos, with the plan's torques as feed-forward; ``"position"``: servos alone;
            ``"torque"``: the plan's torques alone, with the joints' damping.
        closing: stiffness while the hand closes (n,) [N m/rad or N/m], damped in the ratio of the roots; a tenth of a
            second after t_F the joints are held where they are, with ``stiffness``. None: ``stiffness`` all the time.
        pressing: joints (n,) that press with no more than the plan's torques, like jaws with a force limit: from t_I on
            they continue to close until they press, and nothing pushes them back; only with ``"impedance"``. None: no
            joint.

    Raises:
        InvalidInput: values that are negative, torque control with a stiffness, or position control without one.
    """

    stiffness: Array
    damping: Array
    rotor: Array
    control: Control = "impedance"
    closing: Array | None = None
    pressing: BoolArray | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        n = floats_of("servo stiffness", self.stiffness).size
        if self.pressing is not None:
            pressing = np.array(self.pressing)
            if pressing.shape != (n,) or pressing.dtype != np.bool_:
                raise InvalidInput(f"pressing joints: expected {n} of true and false, got {shorten(self.pressing)}")
            object.__setattr__(self, "pressing", pressing)
        if self.closing is not None:
            closing = array_of("servo stiffness while closing", self.closing, (n,))
            if np.any(closing <= 0) or self.control == "torque":
                raise InvalidInput(
                    "servo stiffness while closing: expected values > 0, and none with control='torque', got "
                    f"{shorten(closing.tolist())}"
                )
            object.__setattr__(self, "closing", closing)
        control = one_of("servo control", self.control, CONTROLS)
        object.__setattr__(self, "control", control)
        for name in ("stiffness", "damping", "rotor"):
            values = array_of(f"servo {name}", getattr(self, name), (n,))
            if np.any(values < 0) or (name == "stiffness" and control != "torque" and np.any(values == 0)):
                hint = "; torque alone is control='torque'" if name == "stiffness" else ""
                raise InvalidInput(f"servo {name}: expected values > 0, got {shorten(values.tolist())}{hint}")
            object.__setattr__(self, name, values)
        if control == "torque" and np.any(self.stiffness):
            raise InvalidInput(
                f"servo stiffness: expected 0 with control='torque', got {shorten(self.stiffness.tolist())}: leave it "
                "out, or take control='impedance'"
            )

    @classmethod
    def of(
        cls,
        hand: HandModel,
        stiffness: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        control: Control = "impedance",
    ) -> Servo:
        """Return gains for a hand's servos.

        Rotor inertias are those of the hand's description. If joints are coupled, they are at least 1e-4 kg m^2 (0.11
        kg for sliding joints), and the default damping is critical: MuJoCo's couplings are accurate only with damping
        that need not be implicit.

        Args:
            hand: the hand with these servos.
            stiffness: kp, one number or (n,); default: those of the hand's own drives, else 50 N m/rad, 55.6 kN/m for
                sliding joints; none with torque control.
            damping: one number or (n,); default: 10 ms times the stiffness, with torque control times a tenth of the
                default stiffness.
            control: of the joints, see :class:`Servo`.

        Raises:
            InvalidInput: unusable gains, or a stiffness with torque control.
        """
        model = instance_of("hand", hand, HandModel).model
        slides = hand.slides
        torque = one_of("servo control", control, CONTROLS) == "torque"
        chosen = servo_gains(hand)
        if stiffness is not None and torque:
            raise InvalidInput(
                f"servo stiffness: expected none with control='torque', got {shorten(stiffness)}: leave it out, or "
                "take control='impedance'"
            )
        if stiffness is not None:
            chosen = _each("servo stiffness", stiffness, hand.n)
        felt = _LIMP * chosen if torque else chosen
        rotor = np.array(model.armature)
        if hand.couplings:
            rotor = np.maximum(rotor, np.where(slides, _ROTOR / 0.03**2, _ROTOR))
        if damping is not None:
            damped = _each("servo damping", damping, hand.n)
        elif hand.couplings:
            inertia = np.diag(hand.joint_inertia(np.clip(hand.resting, hand.lower, hand.upper)))
            damped = 2 * np.sqrt(felt * (inertia - model.armature + rotor))
        else:
            damped = SETTLING * felt
        return cls(stiffness=0.0 * chosen if torque else chosen, damping=damped, rotor=rotor, control=control)

    def scale_gains(self, factor: ArrayLike) -> Servo:
        """Return servos with ``factor`` times the stiffness and damping, one number or (n,); torque control has no
        gains, and its damping is the joints'.

        Raises:
            InvalidInput: a factor that is not above 0.
        """
        factor = each_of("servo gain", factor, len(self.stiffness))
        if np.any(factor <= 0):
            raise InvalidInput(f"servo gain: expected factors > 0, got {shorten(factor.tolist())}")
        if self.control == "torque":
            return self
        closing = None if self.closing is None else factor * self.closing
        return replace(self, stiffness=factor * self.stiffness, damping=factor * self.damping, closing=closing)

    def while_closing(self) -> Servo:
        """Return the same servos with the gains for closing."""
        if self.closing is None:
            return self
        ratio = np.sqrt(self.closing / self.stiffness)
        return replace(self, stiffness=self.closing, damping=ratio * self.damping, closing=None)

    def summary(self) -> dict[str, Any]:
        """Control and stiffness as plain values; one number if all joints have the same."""
        kp = self.stiffness.tolist()
        return {"control": self.control, "stiffness": kp[0] if len(set(kp)) == 1 else kp}


def _each(name: str, value: object, n: int) -> Array:
    values = each_of(name, value, n)
    if np.any(values <= 0):
        raise InvalidInput(f"{name}: expected values > 0, got {shorten(values.tolist())}")
    return values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Push:
    """A constant wrench on the object for a limited time.

    Attributes:
        wrench_o: about the object's centre of mass, world axes, linear first (6,) [N, N m].
        start: time after the object's support is gone [s].
        duration: [s].
    """

    wrench_o: Array
    start: float = 0.2
    duration: float = 0.1

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(self, *, wrench_o: ArrayLike, start: float = ..., duration: float = ...) -> None: ...

    __repr__ = brief()

    def __post_init__(self) -> None:
        object.__setattr__(self, "wrench_o", array_of("push", self.wrench_o, (6,)))
        object.__setattr__(self, "start", number("start of the push", self.start, at_least=0, unit="s"))
        object.__setattr__(self, "duration", number("duration of the push", self.duration, above=0, unit="s"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BaseMotion:
    """A motion of the hand's base, by its acceleration: the base does not turn.

    The simulation moves along with the base: hand and object feel inertial forces. Between these times the acceleration
    is linear; before the first and after the last one it is zero.

    Attributes:
        times: increasing, counted from t_F (m,) [s].
        accelerations: of the base at these times (m, 3) [m/s^2], world axes, as gravity's.

    Raises:
        InvalidInput: fewer than two times, times that are negative or do not increase, or accelerations that do not
            match.
    """

    times: Array
    accelerations: Array

    __repr__ = brief()

    def __post_init__(self) -> None:
        times = array_of("times of the base's motion [s]", self.times, (None,))
        if times.size < 2 or times[0] < 0 or np.any(np.diff(times) <= 0):
            raise InvalidInput(
                "times of the base's motion: expected two or more that grow, from t_F on (0), got "
                f"{shorten(times.tolist())}"
            )
        name = "accelerations of the base's motion [m/s^2]"
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "accelerations", array_of(name, self.accelerations, (times.size, 3)))

    @classmethod
    def through(cls, times: ArrayLike, positions: ArrayLike) -> BaseMotion:
        """Return the motion through given positions: the cubic spline, at rest at both ends.

        Args:
            times: increasing, counted from t_F (m,) [s].
            positions: of the base at these times (m, 3) [m], world axes.

        Raises:
            InvalidInput: as for the class.
        """
        instants = array_of("times of the base's motion [s]", times, (None,))
        resting = cls(times=instants, accelerations=np.zeros((instants.size, 3)))
        path = array_of("positions of the base [m]", positions, (resting.times.size, 3))
        try:
            with np.errstate(all="ignore"):
                spline = CubicSpline(instants, path, bc_type="clamped")
                accelerations = spline(instants, 2)  # linear between the times, as a cubic spline's are
        except ValueError as error:
            raise InvalidInput(
                f"positions of the base [m]: expected a path with finite accelerations ({error})"
            ) from error
        return replace(resting, accelerations=accelerations)

    def at(self, since: float) -> Array:
        """Return the acceleration (3,) [m/s^2] at a time after t_F [s]."""
        since = number("time since t_F", since, unit="s")
        columns = self.accelerations.T
        return np.array([np.interp(since, self.times, column, left=0.0, right=0.0) for column in columns])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbance:
    """Differences between the simulation and the plan.

    With another contact stiffness, the damping of the contacts changes so that an object on contacts with the planned
    forces is damped as planned (the same damping ratio: lambda grows with the factor to the power of 1 + 1 / (2 rho)),
    and the tangential stiffness changes as the normal one does at these forces (to the power of 1 / rho).

    Attributes:
        pushes: wrenches on the object.
        shake: amplitude of a sinusoidal acceleration of the whole hand from t_F on (3,) [m/s^2].
        shake_frequency: [Hz].
        base_motion: further accelerations of the whole hand from t_F on.
        mu: friction coefficient of all contacts [-]; None: the plan's.
        mass_factor: ratio of the object's mass to the planned mass.
        stiffness: ratio of the contact law's K to the planned one: above 1 hand and object are harder than assumed.
        object_offset: displacement of the object before the hand moves (3,) [m]; it shifts the contact points.
        object_turn: rotation vector of the object before the hand moves (3,) [rad].
        start_error: of the joints at t = 0 (n,) [rad or m]; None: no error.
        joint_offset: reading of the joints' encoders minus the true positions, one number or (n,) [rad or m].
        joint_friction: dry friction of the joints, one number or (n,) [N m or N].
        servo_gain: ratio of the servos' stiffness and damping to those of :class:`Servo`; with torque control, which
            has no servos, of the motors' torques to the plan's.
        drive_gain: ratio of the drives' efforts to the commanded ones, for servos and torques alike, one number or
            (n,): errors of torque constants, and losses to friction.
        command_delay: delay with which the drives follow a command, one number or (n,) [s]; the object's support waits
            for the slowest of them.
    """

    pushes: tuple[Push, ...] = ()
    shake: Array = field(default_factory=lambda: np.zeros(3))
    shake_frequency: float = 3.0
    base_motion: BaseMotion | None = None
    mu: float | None = None
    mass_factor: float = 1.0
    stiffness: float = 1.0
    object_offset: Array = field(default_factory=lambda: np.zeros(3))
    object_turn: Array = field(default_factory=lambda: np.zeros(3))
    start_error: Array | None = None
    joint_offset: float | Array = 0.0
    joint_friction: float | Array = 0.0
    servo_gain: float = 1.0
    drive_gain: float | Array = 1.0
    command_delay: float | Array = 0.0

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self,
            *,
            pushes: tuple[Push, ...] = ...,
            shake: ArrayLike = ...,
            shake_frequency: float = ...,
            base_motion: BaseMotion | None = ...,
            mu: float | None = ...,
            mass_factor: float = ...,
            stiffness: float = ...,
            object_offset: ArrayLike = ...,
            object_turn: ArrayLike = ...,
            start_error: ArrayLike | None = ...,
            joint_offset: ArrayLike = ...,
            joint_friction: ArrayLike = ...,
            servo_gain: float = ...,
            drive_gain: ArrayLike = ...,
            command_delay: ArrayLike = ...,
        ) -> None: ...

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("pushes", (self.pushes,) if isinstance(self.pushes, Push) else items_of("pushes", self.pushes, Push))
        for name, unit in (("shake", "m/s^2"), ("object_offset", "m"), ("object_turn", "rad")):
            put(name, array_of(f"{name} [{unit}]", getattr(self, name), (3,)))
        put("shake_frequency", number("shake frequency", self.shake_frequency, above=0, unit="Hz"))
        instance_of("base motion", self.base_motion, BaseMotion, type(None))
        if self.mu is not None:
            put("mu", number("mu", self.mu, at_least=0, at_most=_MOST_MU))
        put("mass_factor", number("mass factor", self.mass_factor, above=0))
        low, high = _STIFFNESSES
        put("stiffness", number("stiffness factor", self.stiffness, at_least=low, at_most=high))
        put("servo_gain", number("servo gain", self.servo_gain, above=0))
        if self.start_error is not None:
            put("start_error", array_of("start error", self.start_error, (None,)))
        for name, text in (
            ("joint_offset", "joint offset [rad or m]"),
            ("joint_friction", "joint friction [N m or N]"),
            ("drive_gain", "drive gain"),
            ("command_delay", "command delay [s]"),
        ):
            value = getattr(self, name)
            put(name, array_of(text, value, (None,)) if floats_of(text, value).ndim else number(text, value))
        at_least_zero("joint friction [N m or N]", self.joint_friction)
        at_least_zero("command delay [s]", self.command_delay)
        if np.any(np.asarray(self.command_delay) > _LATEST):
            raise InvalidInput(
                f"command delay [s]: expected at most {_LATEST:g} s, got "
                f"{shorten(np.asarray(self.command_delay).tolist())}: are these milliseconds?"
            )
        if np.any(np.asarray(self.drive_gain) <= 0):
            raise InvalidInput(f"drive gain: expected factors > 0, got {shorten(np.asarray(self.drive_gain).tolist())}")

    @property
    def accelerates(self) -> bool:
        """Whether the hand's base moves."""
        return bool(np.any(self.shake)) or self.base_motion is not None

    def acceleration(self, since: float) -> Array:
        """Of the hand's base (3,) [m/s^2] at a time after t_F [s]."""
        since = number("time since t_F", since, unit="s")
        swing: Array = self.shake * np.sin(2 * np.pi * self.shake_frequency * since)
        return swing if self.base_motion is None else swing + self.base_motion.at(since)

    def wrench(self, since_release: float) -> Array:
        """Sum of the pushes (6,) [N, N m] at a time after the object's support is gone [s]."""
        since_release = number("time since the release", since_release, unit="s")
        total = np.zeros(6)
        for push in self.pushes:
            if push.start <= since_release < push.start + push.duration:
                total += push.wrench_o
        return total

    def summary(self) -> dict[str, Any]:
        """The differences from the plan, as plain values."""
        values: dict[str, Any] = {}
        if self.pushes:
            values["pushes"] = [
                {"wrench_N_Nm": push.wrench_o.tolist(), "start_s": push.start, "duration_s": push.duration}
                for push in self.pushes
            ]
        if np.any(self.shake):
            values |= {"shake_m_s2": self.shake.tolist(), "shake_Hz": self.shake_frequency}
        if self.base_motion is not None:
            motion = self.base_motion
            values["base_motion"] = {"times_s": motion.times.tolist(), "m_s2": motion.accelerations.tolist()}
        if self.mu is not None:
            values["mu"] = self.mu
        for name in ("mass_factor", "stiffness", "servo_gain"):
            if getattr(self, name) != 1.0:
                values[name] = getattr(self, name)
        for name in ("object_offset", "object_turn"):
            if np.any(getattr(self, name)):
                values[name + ("_m" if name.endswith("offset") else "_rad")] = getattr(self, name).tolist()
        if self.start_error is not None:
            values["start_error"] = np.asarray(self.start_error).tolist()
        for name in ("joint_offset", "joint_friction", "command_delay"):
            if np.any(getattr(self, name)):
                values[name] = np.asarray(getattr(self, name)).tolist()
        if np.any(np.asarray(self.drive_gain) != 1.0):
            values["drive_gain"] = np.asarray(self.drive_gain).tolist()
        return values
