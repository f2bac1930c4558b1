"""What drives make of their registers, from logs of a hand that moves freely; and what it lifts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.signal import savgol_filter

from pinograsp.checks import array_of, brief, instance_of, mapping_of, number, path_of, read_only
from pinograsp.errors import InvalidInput
from pinograsp.hands import Drive, HandModel, Source
from pinograsp.hands.estimates import Estimate
from pinograsp.identification.estimates import widen
from pinograsp.identification.logs import read_columns
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.spatial import Array, BoolArray, IntArray

_WINDOW = 0.1  # [s] over which positions are smoothed and differentiated
_SLOW = 0.05  # of a joint's largest speed: below, friction takes any value
_LATEST = 0.1  # [s] that efforts may lag behind the motion, or run ahead of it
_BLOCK = 0.4  # [s] that are drawn together in the bootstrap: errors of neighbours are alike
_RESAMPLES = 200
# What no bootstrap has in it: friction that depends on speed, backlash, delays between samples. Half widths are widened
# by a factor and a share of the value, so that intervals of 95 % hold that much of the truths that
# benchmarks/identified_logs.py hides (measured servos, model m6 of Rhoban's BAM).
_DRIVE_WIDER, _DRIVE_SHARE = 3.0, 0.01
_MASS_WIDER, _MASS_SHARE = 1.5, 0.005
_KNOWN = 0.3  # half width of an interval, as a share of its value: more is not identified
_LENGTHS = np.array([1.0, 0.05, 0.05, 0.05])  # units of m [kg] and m c [kg m] that are alike, by lengths of a hand
_CLEAR = 3.0  # times the median error of the fit: torque that tells a constant
_TOLD = 0.95  # share of a figure that the motion tells
_GAP = 0.2  # [s] between two samples of a log of motion, at most
_FEWEST = 50  # samples in motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionLog:
    """Joint positions and drives' efforts over time (s).

    Attributes:
        source: the file, or what else it is.
        times: in equal steps (s,) [s].
        q: of the hand's joints (s, n) [rad or m].
        effort: of the hand's drives in the units of their registers, as current (s, m); NaN: not logged.
    """

    source: str
    times: Array
    q: Array
    effort: Array

    __repr__ = brief("source", "times", "q")

    def __post_init__(self) -> None:
        times = array_of("times of a log", self.times, (None,))
        steps = np.diff(times)
        if len(times) < 2 * _FEWEST or not np.all(steps > 0) or np.ptp(steps) > 0.5 * np.median(steps):
            raise InvalidInput(
                f"log {self.source}: expected {2 * _FEWEST} samples or more in equal steps of time, got {len(times)} "
                f"in steps of {steps.min(initial=0):g} to {steps.max(initial=0):g} s"
            )
        object.__setattr__(self, "times", read_only(times))
        object.__setattr__(self, "q", read_only(array_of("positions of a log", self.q, (len(times), None))))
        effort = np.asarray(self.effort, dtype=float)
        if effort.ndim != 2 or len(effort) != len(times) or np.isinf(effort).any():
            raise InvalidInput(f"efforts of log {self.source}: expected ({len(times)}, m), got {effort.shape}")
        object.__setattr__(self, "effort", read_only(effort))


class DriveFit(NamedTuple):
    """What a drive's register i makes at its joint, s the sign of dq: torque + outer_friction s |torque| = effort_step
    (i - load_friction s |i|) - friction s - viscous dq - armature ddq - offset (as Rhoban's BAM has it, model m5, at
    speeds at which friction does not depend on them).

    Attributes:
        effort_step: torque or force of one unit [N m or N].
        load_friction, outer_friction: shares of the motor's effort and of the load that the gears take [-].
        friction, viscous, armature, offset: [N m, N m s/rad, kg m^2, N m], or with N and m.
        delay: by which the register follows the motion [s]; below 0 it runs ahead.
        error: median error of the torque [N m or N].
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


_REGRESSED = ("effort_step", "load_friction", "outer_friction", "friction", "viscous", "armature", "offset")


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifiedMotion:
    """What a log of motion tells.

    Attributes:
        drives: by name.
        unknown: by drive, why it cannot be told, and the experiment that would tell it.
    """

    drives: Mapping[str, DriveFit]
    unknown: Mapping[str, str]

    __repr__ = brief()


def read_motion(
    path: str | Path,
    hand: HandModel,
    *,
    time: str = "time",
    position: str = "{}/position",
    effort: str = "{}/effort",
    position_step: float = 1.0,
) -> MotionLog:
    """Read a log of joints and drives, a column for each: CSV, Parquet or a bag of ROS.

    Args:
        path: the file.
        hand: whose joints and drives these are.
        time: column of the time [s].
        position, effort: columns of the joints' positions and of the drives' registers, ``{}`` for the name; joints
            without a column stay where the hand rests, drives without one are not identified.
        position_step: radians or metres of one unit of position.

    Raises:
        InvalidInput: no such table, no column of a joint or drive, time that does not rise or has gaps of 0.2 s.
    """
    path = path_of("log", path)
    step = number("position_step", position_step)
    joints = {position.format(name): name for name in hand.joint_names}
    drives = {effort.format(drive.name): drive.name for drive in hand.drives}
    table = read_columns(path, [time, *joints, *drives], needed=[time])
    if not table.keys() & joints.keys() or not table.keys() & drives.keys():
        raise InvalidInput(
            f"log {path}: expected columns as '{next(iter(joints))}' and '{next(iter(drives), '')}', got none of them: "
            "say how they are called, position='{}_pos', effort='{}_current'"
        )
    times = table[time]
    q = np.tile(hand.resting, (len(times), 1))
    for column, name in joints.items():
        if column in table:
            q[:, hand.joint_names.index(name)] = step * table[column]
    blank = np.full(len(times), np.nan)
    registers = np.column_stack([table.get(column, blank) for column in drives])
    even = _even_out(path, times)
    evened = [np.column_stack([np.interp(even, times, one) for one in values.T]) for values in (q, registers)]
    return MotionLog(source=str(path), times=even, q=evened[0], effort=evened[1])


def _even_out(path: Path, times: Array) -> Array:
    """Times in equal steps over a log whose own are not quite equal, as those of buses are."""
    steps = np.diff(times)
    step = float(np.median(steps))
    if not np.all(steps > 0) or steps.max() > _GAP:
        row = int(np.argmax(~(steps > 0) | (steps > _GAP)))
        raise InvalidInput(
            f"log {path}: expected time that rises by at most {_GAP:g} s, got {times[row]:g} s and then "
            f"{times[row + 1]:g} s in sample {row + 2}: cut the log there"
        )
    return np.asarray(times[0] + step * np.arange(int((times[-1] - times[0]) / step + 1e-9) + 1))


def identify_motion(
    hand: HandModel,
    log: MotionLog,
    *,
    masses: Mapping[str, float] | None = None,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
    seed: int = 0,
) -> IdentifiedMotion:
    """Torque constants and friction of drives from free motion: by linear regression of the hand's inverse dynamics.

    The torque that the motion takes (RNEA) is known from the description's masses; so a figure is off by what these
    are off. Move each joint slowly and fast, up and down, against gravity.

    Args:
        hand: with the drives that were logged, one joint each.
        log: of free motion.
        masses: known masses that were fixed to links, ``{link: kg}``, at the origins of their frames.
        gravity_o: (3,) [m/s^2] in the world in which the hand stood.
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
    path = _differentiate(log)
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
    """Drives with the effort steps and the friction that were identified, and where these come from."""
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


def identify_load(
    hand: HandModel,
    log: MotionLog,
    drives: IdentifiedMotion,
    link: str,
    *,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
    seed: int = 0,
) -> tuple[Estimate, Array | None]:
    """Mass that a link carries besides its own [kg], and its centre of mass in the link's frame (3,) [m]; None where
    the motion does not tell it: joints with parallel axes do not tell where it is along them.

    Where the motion does not tell the mass from where it is, as of the last joint alone, it is taken to be at the
    link's origin.

    Args:
        hand, gravity_o, seed: as for :func:`identify_motion`.
        log: of the hand that moves with it.
        drives: identified without it.
        link: that carries it.

    Raises:
        InvalidInput: a link that there is not, joints that move together, no drive that is known.
    """
    if hand.model.njoints - 1 != hand.n:
        raise InvalidInput("load: expected a hand whose joints move one by one, got one with coupled joints")
    frame = hand.model.frames[hand.frame_id(link)]
    path = _differentiate(log)
    torques = inverse_dynamics(hand, *path, gravity_o=gravity_o)
    model = hand.model.copy()
    model.gravity.linear = array_of("gravity", gravity_o, (3,))
    data, first = model.createData(), 10 * (int(frame.parentJoint) - 1)
    known = [(i, drive) for i, drive in enumerate(hand.drives) if drive.name in drives.drives]
    if not known:
        raise InvalidInput("drives: expected one or more that are known, got none")
    rows = range(0, len(log.times), max(1, len(log.times) // 2000))
    regressors = np.array(
        [
            pin.computeJointTorqueRegressor(model, data, *(one[s] for one in path))[:, first : first + 4].copy()
            for s in rows
        ]
    )
    blocks, wanted = [], []
    for i, drive in known:
        j, fit = hand.joint_names.index(drive.joints[0]), drives.drives[drive.name]
        made = drive.arms[0] * _make_torque(fit, log, i, path[1][:, j], path[2][:, j])
        moving = _find_moving(path[1][:, j], _window(log))[rows] & np.isfinite(made[rows])
        blocks.append(np.where(moving[:, None], regressors[:, j], 0.0))
        wanted.append(np.where(moving, made[rows] - torques[rows, j], 0.0))
    A, y = np.stack(blocks, axis=1), np.stack(wanted, axis=1)  # (s, drives, 4), (s, drives)
    # What the motion tells of m and m c, lengths in 50 mm: directions of large singular values.
    values, directions = np.linalg.svd(A.reshape(-1, 4) * _LENGTHS, full_matrices=False)[1:]
    told = directions[values > 0.02 * values[0]]
    share = np.sum(told**2, axis=0)
    if share[0] < _TOLD:  # the mass alone is not: taken as if it were at the link's origin
        lever = frame.placement.translation
        A, told, share = A[..., :1] + A[..., 1:] @ lever[:, None], np.ones((1, 1)), np.zeros(4)

    def solve(chosen: IntArray) -> Array:
        columns = A[chosen].reshape(-1, A.shape[-1]) * _LENGTHS[: A.shape[-1]] @ told.T
        found = told.T @ np.linalg.lstsq(columns, y[chosen].ravel(), rcond=None)[0]
        return np.asarray(found * _LENGTHS[: A.shape[-1]])

    best = solve(np.arange(len(A)))
    dt = float(np.median(np.diff(log.times))) * rows.step
    drawn = np.array([solve(chosen) for chosen in _draw_blocks(len(A), dt, np.random.default_rng(seed))])
    mass = widen(best[0], drawn[:, 0], _MASS_WIDER, _MASS_SHARE)
    if share.min() < _TOLD or best[0] <= 0:
        return mass, None
    return mass, np.asarray(frame.placement.actInv(best[1:] / best[0]))


def identify_friction(
    normal: ArrayLike, tangential: ArrayLike, slips: ArrayLike, *, seed: int = 0
) -> tuple[Estimate | None, float]:
    """Friction coefficient of a contact that slipped, and the largest ratio of forces while it stuck: a lower bound.

    Args:
        normal, tangential: forces (s,) [N], or in one unit.
        slips: whether it slips (s,).
        seed: of the bootstrap.

    Returns:
        The coefficient, None where it never slipped for ten samples, and the lower bound.

    Raises:
        InvalidInput: arrays of other sizes, a normal force that is nowhere above 0.
    """
    fn, ft = array_of("normal", normal, (None,)), np.abs(array_of("tangential", tangential, (None,)))
    slipping = np.asarray(slips)
    if fn.shape != ft.shape or slipping.shape != fn.shape or slipping.dtype != bool:
        raise InvalidInput("normal, tangential, slips: expected (s,), (s,) and booleans (s,)")
    pressed = fn > 0.05 * fn.max(initial=0.0)
    if not pressed.any():
        raise InvalidInput("normal: expected forces above 0, got none")
    ratio = np.where(pressed, ft / np.where(pressed, fn, 1.0), 0.0)
    stuck = float(np.quantile(ratio[pressed & ~slipping], 0.99)) if (pressed & ~slipping).any() else 0.0
    found = ratio[pressed & slipping]
    if len(found) < 10:
        return None, stuck
    rng = np.random.default_rng(seed)
    drawn = np.median(found[rng.integers(len(found), size=(_RESAMPLES, len(found)))], axis=1)
    return widen(float(np.median(found)), drawn), stuck


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


def _window(log: MotionLog) -> int:
    """Samples that are smoothed together, odd."""
    return max(5, int(_WINDOW / np.median(np.diff(log.times))) | 1)


def _differentiate(log: MotionLog) -> tuple[Array, Array, Array]:
    """q, dq and ddq (s, n), by polynomials of third degree through neighbours."""
    dt, width = float(np.median(np.diff(log.times))), _window(log)
    q, dq, ddq = (savgol_filter(log.q, width, 3, deriv=k, delta=dt, axis=0) for k in range(3))
    return q, dq, ddq


def _find_moving(dq: Array, width: int) -> BoolArray:
    """Samples (s,) that are fast enough, and so are all that were smoothed together with them."""
    slow = np.abs(dq) <= max(_SLOW * float(np.quantile(np.abs(dq), 0.95)), 1e-6)
    slow[:width] = slow[-width:] = True
    near: BoolArray = np.convolve(slow, np.ones(width), mode="same") < 0.5
    return near


def _columns(register: Array, torque: Array, dq: Array, ddq: Array) -> Array:
    """By which a drive's torque is linear in what :class:`DriveFit` has, load_friction times effort_step."""
    sign = np.sign(dq)
    friction = [-sign * np.abs(register), -sign * np.abs(torque), -sign]
    return np.column_stack([register, *friction, -dq, -ddq, -np.ones_like(dq)])


def _fit_drive(
    log: MotionLog, dq: Array, ddq: Array, torque: Array, register: Array, rng: np.random.Generator
) -> DriveFit | str:
    """The regression of one drive, or why there is none."""
    width, dt = _window(log), float(np.median(np.diff(log.times)))
    moving = _find_moving(dq, width)
    if moving.sum() < _FEWEST or np.ptp(dq) < 1e-3:
        return "its joint hardly moves: move it slowly up and down, and once fast"
    if min(np.mean(dq[moving] > 0), np.mean(dq[moving] < 0)) < 0.1:
        return "its joint moves one way alone, and friction looks like load: move it back as slowly, too"
    y = torque[moving]
    smooth = savgol_filter(register, width, 3)

    def fit(delay: float) -> tuple[float, Array, Array, Array]:
        A = _columns(_shift(log.times, smooth, delay), torque, dq, ddq)[moving]
        Z = A.copy()
        Z[:, 0], Z[:, 1] = y, Z[:, 2]
        for _ in range(2):  # the first instruments are those of gears without friction by the load
            x = _solve(A, y, Z)
            Z[:, 0] = _predict_register(x, y, A)
            Z[:, 1] = np.sign(A[:, 3]) * np.abs(Z[:, 0])
        return float(np.sqrt(np.mean((A @ x - y) ** 2))), x, A, Z

    delay = min(np.arange(-_LATEST, _LATEST, _LATEST / 20), key=lambda one: fit(one)[0])
    delay = min(delay + np.arange(-_LATEST / 20, _LATEST / 20, _LATEST / 200), key=lambda one: fit(one)[0])
    _, x, A, Z = fit(delay)
    samples = np.array([_solve(A[rows], y[rows], Z[rows]) for rows in _draw_blocks(len(y), dt, rng)])
    if x[0] < 0 and np.mean(samples[:, 0] < 0) > 0.95:
        return "its register counts against its joint: log it with the other sign, or give the drive the arm -1"
    if x[0] == 0 or not np.all(samples[:, 0]):
        return "its register does not follow its torque: is it another drive's, or not switched on?"
    samples[:, 1] /= samples[:, 0]
    values = [x[0], x[1] / x[0], *x[2:]]
    fitted = {
        name: widen(value, drawn, _DRIVE_WIDER, _DRIVE_SHARE)
        for name, value, drawn in zip(_REGRESSED, values, samples.T)
    }
    step, error = fitted["effort_step"], float(np.median(np.abs(A @ x - y)))
    # What of the torque no friction, inertia or offset explains tells the torque constant, and nothing else does.
    others = A[:, 2:] * _scales(A[:, 2:])
    telling = float(np.std(y - others @ np.linalg.lstsq(others, y, rcond=None)[0]))
    if telling < _CLEAR * error or step.low <= 0 or (step.high - step.low) / 2 > _KNOWN * step.value:
        return (
            f"the torque that its motion takes, {np.ptp(y):.2g} N m or N from end to end, is lost in friction: mount "
            "the hand so that the joint lifts against gravity, or fix a known mass to the link (masses=)"
        )
    return DriveFit(**fitted, delay=float(delay), error=error)


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


def _predict_register(x: Array, y: Array, A: Array) -> Array:
    """The register that makes the torques y (s,) by a fit x; A: its columns, of which the first two are not read."""
    step = x[0] if x[0] != 0 else np.finfo(float).eps
    driven = (y - A[:, 2:] @ x[2:]) / step  # i - load_friction s |i|
    share = min(max(x[1] / step, 0.0), 0.9)
    register: Array = driven / (1 - share * np.sign(-A[:, 3] * driven))
    return register


def _shift(times: Array, values: Array, delay: float) -> Array:
    """What came ``delay`` [s] later (s,)."""
    later: Array = np.interp(times + delay, times, values)
    return later


def _scales(A: Array) -> Array:
    """By which columns become alike in size."""
    sizes = np.sqrt(np.mean(A**2, axis=0))
    return 1 / np.where(sizes > 0, sizes, 1.0)


def _draw_blocks(count: int, dt: float, rng: np.random.Generator) -> list[IntArray]:
    """Samples of the bootstrap: blocks of neighbours, drawn with replacement."""
    size = max(1, min(count // 5, round(_BLOCK / dt)))
    starts = rng.integers(0, count - size + 1, size=(_RESAMPLES, -(-count // size)))
    return [(one[:, None] + np.arange(size)).ravel()[:count] for one in starts]


def _make_torque(fit: DriveFit, log: MotionLog, drive: int, dq: Array, ddq: Array) -> Array:
    """Effort that a drive's register makes at its coordinate (s,)."""
    register = _shift(log.times, savgol_filter(log.effort[:, drive], _window(log), 3), fit.delay)
    k, outer = fit.effort_step.value, fit.outer_friction.value
    x = [k, k * fit.load_friction.value, 0.0, *(getattr(fit, name).value for name in _REGRESSED[3:])]
    inner: Array = _columns(register, np.zeros_like(dq), dq, ddq) @ np.array(x)
    return inner / (1 + outer * np.sign(dq * inner))
