"""What drives make of their registers, from logs of a hand that moves freely."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.signal import savgol_filter

from pinograsp.checks import brief, instance_of, mapping_of, number
from pinograsp.errors import InvalidInput
from pinograsp.hands import Drive, HandModel, Source
from pinograsp.hands.estimates import Estimate
from pinograsp.identification.estimates import widen
from pinograsp.identification.motion_log import FEWEST, MotionLog, differentiate, find_moving, find_window
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.spatial import Array, IntArray

_LATEST = 0.1  # [s] that efforts may lag behind the motion, or run ahead of it
_BLOCK = 0.4  # [s] that are drawn together in the bootstrap: errors of neighbours are alike
_RESAMPLES = 200
# What no bootstrap has in it: friction that depends on speed, backlash, delays between samples. Half widths are widened
# by a factor and a share of the value, so that intervals of 95 % hold that much of the truths that
# benchmarks/identified_logs.py hides (measured servos, model m6 of Rhoban's BAM).
_DRIVE_WIDER, _DRIVE_SHARE = 3.0, 0.01
_KNOWN = 0.3  # half width of an interval, as a share of its value: more is not identified
_DEVIATIONS = 1.96  # standard deviations on either side in 95 %
_MISFIT = 0.5  # half width, as a share, per median error of the fit over the torque that tells the constant
_ROUNDS = 6  # of fits: by which gears' friction, and the register that the motion asks for, settle


class DriveFit(NamedTuple):
    """The torque of a drive at its joint for a register value i, with the sign s of dq: torque = effort_step i - s
    |load_friction effort_step i + outer_friction torque| - friction s - viscous dq - armature ddq - offset (as in
    Rhoban's BAM, model m5, at speeds at which friction does not depend on speed).

    Attributes:
        effort_step: torque or force per unit [N m or N].
        load_friction, outer_friction: shares of the motor's effort and of the load that are lost in the gears [-].
        friction, viscous, armature, offset: [N m, N m s/rad, kg m^2, N m], or with N and m.
        delay: delay of the register after the motion [s]; below 0 it is ahead.
        error: median error of the torque [N m or N].
        covariance: of the first seven figures, in their order (7, 7).
    """

    effort_step: Estimate
    load_friction: Estimate
    outer_friction: Estimate
    friction: Estimate
    viscous: Estimate
    armature: Estimate
    offset: Estimate
    delay: float
    error: float
    covariance: Array


_REGRESSED = ("effort_step", "load_friction", "outer_friction", "friction", "viscous", "armature", "offset")


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifiedMotion:
    """The results from a log of motion.

    Attributes:
        drives: by name.
        unknown: by drive, why it cannot be identified, and the experiment that would identify it.
    """

    drives: Mapping[str, DriveFit]
    unknown: Mapping[str, str]

    __repr__ = brief()


def identify_motion(
    hand: HandModel,
    log: MotionLog,
    *,
    masses: Mapping[str, float] | None = None,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
    seed: int = 0,
) -> IdentifiedMotion:
    """Identify torque constants and friction of drives from free motion, by linear regression of the hand's inverse
    dynamics.

    The torque of the motion (RNEA) follows from the description's masses, so errors of these are errors of the results.
    Move each joint slowly and fast, up and down, against gravity.

    Args:
        hand: hand with the logged drives, one joint each.
        log: log of free motion.
        masses: known masses that were fixed to links, ``{link: kg}``, at the origins of their frames.
        gravity_o: gravity (3,) [m/s^2] in the hand's world during the log.
        seed: of the bootstrap.

    Raises:
        InvalidInput: a log of another hand; drives of several joints.
    """
    instance_of("log", log, MotionLog)
    if log.q.shape[1] != hand.n or log.effort.shape[1] != len(hand.drives):
        raise InvalidInput(
            f"log {log.source}: expected {hand.n} joints and {len(hand.drives)} drives, got {log.q.shape[1]} and "
            f"{log.effort.shape[1]}"
        )
    loaded = _add_masses(hand, mapping_of("masses", {} if masses is None else masses, "{link: kg}"))
    path = differentiate(log)
    torques = inverse_dynamics(loaded, *path, gravity_o=gravity_o)
    rng = np.random.default_rng(seed)
    drives, unknown = {}, {}
    for i, drive in enumerate(hand.drives):
        register = log.effort[:, i]
        if np.isnan(register).any():
            unknown[drive.name] = "its register is not in the log"
            continue
        if len(drive.joints) != 1:
            raise InvalidInput(f"drive {drive.name}: expected one joint, got {len(drive.joints)}: log its joints alone")
        j = hand.joint_names.index(drive.joints[0])
        fit = _fit_drive(log, path[1][:, j], path[2][:, j], torques[:, j] / drive.arms[0], register, rng)
        if isinstance(fit, str):
            unknown[drive.name] = fit
        else:
            drives[drive.name] = fit
    return IdentifiedMotion(drives=drives, unknown=unknown)


def apply_fits(drives: Sequence[Drive], fits: Mapping[str, DriveFit], source: str) -> tuple[Drive, ...]:
    """Return the drives with the identified effort steps and friction, and their source."""
    found = []
    for drive in drives:
        if fit := fits.get(drive.name):
            figures = {"effort_step": fit.effort_step, "friction": fit.friction}
            told = tuple(
                Source(figure=name, text=source, interval=(max(one.low, 0.0), max(one.high, 0.0)))  # type: ignore[arg-type]
                for name, one in figures.items()
            )
            kept = tuple(one for one in drive.sources if one.figure not in figures)
            drive = replace(
                drive,
                effort_step=fit.effort_step.value,
                friction=max(fit.friction.value, 0.0),
                sources=(*kept, *told),
            )
        found.append(drive)
    return tuple(found)


def _add_masses(hand: HandModel, masses: Mapping[str, float]) -> HandModel:
    if not masses:
        return hand
    model = hand.model.copy()
    for link, mass in masses.items():
        kilograms = number(f"mass at link '{link}'", mass, at_least=0, unit="kg")
        frame = model.frames[hand.frame_id(link)]
        model.appendBodyToJoint(
            frame.parentJoint, pin.Inertia(kilograms, np.zeros(3), np.zeros((3, 3))), frame.placement
        )
    return replace(hand, model=model)


def _columns(register: Array, torque: Array, dq: Array, ddq: Array, gears: Array) -> Array:
    """By which a drive's torque is linear in what :class:`DriveFit` has, load_friction times effort_step;
    ``gears``: the sign of dq (s,), times that of what friction's absolute value is taken of.
    """
    friction = [-gears * register, -gears * torque, -np.sign(dq)]
    return np.column_stack([register, *friction, -dq, -ddq, -np.ones_like(dq)])


def _fit_drive(
    log: MotionLog, dq: Array, ddq: Array, torque: Array, register: Array, rng: np.random.Generator
) -> DriveFit | str:
    """The regression of one drive, or why there is none."""
    width, dt = find_window(log), float(np.median(np.diff(log.times)))
    moving = find_moving(dq, width)
    if moving.sum() < FEWEST or np.ptp(dq) < 1e-3:
        return "its joint hardly moves: move it slowly up and down, and once fast"
    if min(np.mean(dq[moving] > 0), np.mean(dq[moving] < 0)) < 0.1:
        return "its joint moves in one direction only, so friction looks like load: move it back just as slowly"
    y, dq, ddq = torque[moving], dq[moving], ddq[moving]
    smooth = savgol_filter(register, width, 3)

    def fit_from(seen: Array, pressing: Array) -> tuple[float, Array, Array, Array]:
        gears = np.sign(dq) * np.sign(pressing)
        A = _columns(seen, y, dq, ddq, gears)
        Z = A.copy()
        Z[:, 0], Z[:, 1] = y, Z[:, 2]  # the first instruments are those of gears without friction by the load
        for _ in range(_ROUNDS):
            x = _solve(A, y, Z)
            made = _predict_register(x, y, A, gears)
            gears = np.sign(dq) * np.sign(x[1] * made + x[2] * y if x[1:3].any() else made)
            A, Z = (_columns(one, y, dq, ddq, gears) for one in (seen, made))
        return float(np.sqrt(np.mean((A @ x - y) ** 2))), x, A, Z

    def fit(delay: float) -> tuple[float, Array, Array, Array]:
        seen = _shift(log.times, smooth, delay)[moving]
        # As if the motor pressed on the gears harder than the load, and the other way round.
        return min((fit_from(seen, seen), fit_from(seen, y)), key=lambda one: one[0])

    delay = min(np.arange(-_LATEST, _LATEST, _LATEST / 20), key=lambda one: fit(one)[0])
    delay = min(delay + np.arange(-_LATEST / 20, _LATEST / 20, _LATEST / 200), key=lambda one: fit(one)[0])
    _, x, A, Z = fit(delay)
    samples = np.array([_solve(A[rows], y[rows], Z[rows]) for rows in draw_blocks(len(y), dt, rng)])
    if x[0] < 0 and np.mean(samples[:, 0] < 0) > 0.95:
        return "its register counts against its joint: log it with the other sign, or give the drive the arm -1"
    if x[0] == 0 or not np.all(samples[:, 0]):
        return "its register does not follow its torque: does it belong to another drive, or is the drive off?"
    samples[:, 1] /= samples[:, 0]
    values = [x[0], x[1] / x[0], *x[2:]]
    error = float(np.median(np.abs(A @ x - y)))
    # What of the motor's effort no friction, inertia or offset explains tells the torque constant, and nothing else
    # does: friction by the load, for one, looks like it where the load never drives the motor.
    others = Z[:, 1:] * _scales(Z[:, 1:])
    telling = abs(x[0]) * float(np.std(Z[:, 0] - others @ np.linalg.lstsq(others, Z[:, 0], rcond=None)[0]))
    shares = {"effort_step": math.hypot(_DRIVE_SHARE, _MISFIT * error / telling) if telling > 0 else math.inf}
    fitted = {
        name: widen(value, drawn, _DRIVE_WIDER, shares.get(name, _DRIVE_SHARE))
        for name, value, drawn in zip(_REGRESSED, values, samples.T)
    }
    step = fitted["effort_step"]
    if step.low <= 0 or (step.high - step.low) / 2 > _KNOWN * step.value:
        return (
            f"the torque that its motion takes, {np.ptp(y):.2g} N m or N from end to end, is lost in friction: mount "
            "the hand so that the joint lifts against gravity, or fix a known mass to the link (masses=); where no "
            "load drives the motor back through its gears, no motion shows it: press on a scale instead"
        )
    spread = np.array([(fitted[name].high - fitted[name].low) / (2 * _DEVIATIONS) for name in _REGRESSED])
    deviations = np.std(samples, axis=0, ddof=1)
    covariance = np.cov(samples.T) * np.outer(*2 * [spread / np.where(deviations > 0, deviations, 1.0)])
    return DriveFit(**fitted, delay=float(delay), error=error, covariance=covariance)


def _solve(A: Array, y: Array, Z: Array) -> Array:
    """Z^T A x = Z^T y: instruments Z, made of the torque that the motion takes in place of the register, leave no bias
    by the register's noise (instrumental variables, as in Janot, Vandanjon, Gautier 2014). Friction by the load is not
    below 0: where it comes out so, it is left out.
    """
    scale, free = _scales(A), list(range(A.shape[1]))
    G, b, x = Z.T @ (A * scale), Z.T @ y, np.zeros(A.shape[1])
    while True:
        x[:] = 0.0
        x[free] = np.linalg.lstsq(G[np.ix_(free, free)], b[free], rcond=1e-10)[0]
        worst = min((1, 2), key=lambda column: x[column])
        if x[worst] >= 0:
            return np.asarray(x * scale)
        free.remove(worst)


def _predict_register(x: Array, y: Array, A: Array, gears: Array) -> Array:
    """The register that makes the torques y (s,) by a fit x; A: its columns for ``gears``, of which the first two are
    not read.
    """
    step = x[0] if x[0] != 0 else np.finfo(float).eps
    driven = (y - A[:, 2:] @ x[2:]) / step  # i - load_friction s |i|
    share = min(max(x[1] / step, 0.0), 0.9)
    register: Array = driven / (1 - share * gears)
    return register


def _shift(times: Array, values: Array, delay: float) -> Array:
    """What came ``delay`` [s] later (s,)."""
    later: Array = np.interp(times + delay, times, values)
    return later


def _scales(A: Array) -> Array:
    """By which columns become alike in size."""
    sizes = np.sqrt(np.mean(A**2, axis=0))
    return 1 / np.where(sizes > 0, sizes, 1.0)


def draw_blocks(count: int, dt: float, rng: np.random.Generator) -> list[IntArray]:
    """Samples of the bootstrap: blocks of neighbours, drawn with replacement."""
    size = max(1, min(count // 5, round(_BLOCK / dt)))
    starts = rng.integers(0, count - size + 1, size=(_RESAMPLES, -(-count // size)))
    return [(one[:, None] + np.arange(size)).ravel()[:count] for one in starts]


def make_torque(fit: DriveFit, log: MotionLog, drive: int, dq: Array, ddq: Array) -> Array:
    """Effort that a drive's register makes at its coordinate (s,)."""
    register = _shift(log.times, savgol_filter(log.effort[:, drive], find_window(log), 3), fit.delay)
    inner, outer, effort = fit.load_friction.value, fit.outer_friction.value, fit.effort_step.value * register
    others = np.array([0.0, 0.0, 0.0, *(getattr(fit, name).value for name in _REGRESSED[3:])])
    free = effort + _columns(register, register, dq, ddq, dq) @ others  # without friction by the load
    sign = np.sign(dq)
    # Which sign of what the friction's absolute value is taken of is its own.
    one, other = ((free - s * inner * effort) / (1 + s * outer) for s in (sign, -sign))
    torque: Array = np.where(inner * effort + outer * one >= 0, one, other)
    return torque
