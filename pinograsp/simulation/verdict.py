"""The verdict, held or lost, from the samples of a simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pinograsp.hands.servos import CLOSED
from pinograsp.plan import History, Verdict
from pinograsp.plan.simulation import MOVED, TURNED
from pinograsp.simulation.options import SimulationOptions
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array, BoolArray, rotation_angle

RESTING = 5e-4  # [m] of motion in the last fifth of the hold, of shaken hands whole periods apart
SWINGING = 2e-3  # [m] from one side to the other, of an object that swings on its contacts in the last fifth
GONE = 0.05  # [m] an object that has moved this far is lost
SLIPPED = 1e-4  # [m]
_BEYOND = 1e-3  # [rad or m] past a joint's limit
_PERIODS, _FITS = 60, 0.2  # that are tried of a swing, and what its fit leaves of a line's misfit at most
_SAMPLES = 24  # of a swing, at least: four times what its fit has to choose
AT_LIMIT = 1e-6  # relative distance to a torque limit


class Expected(NamedTuple):
    """What the plan foresees of the parts of the hand.

    Attributes:
        depths: penetration (p,) [m].
        normal_forces: once the object is let go (p,) [N].
    """

    depths: Array
    normal_forces: Array


def judge(
    task: Task, history: History, expected: Expected, release: float | None, *, gone: bool, options: SimulationOptions
) -> Verdict:
    """The verdict on a task.

    Args:
        task: what was simulated.
        history: the samples.
        expected: of the history's parts.
        release: when the object was let go [s]; None: never.
        gone: whether the object was so far away that the simulation ended early.
        options: of the simulation.
    """
    disturbance, support = options.disturbance, options.support
    times, poses, complete, parts = history.times, history.object_poses, history.complete, history.parts
    normal, planned = history.normal_forces, history.planned_forces
    # A hand may close on until a little after t_F, and take the object along.
    closed = complete
    if support not in (None, "fixed"):
        closed = min(int(np.searchsorted(times, times[complete] + CLOSED - 1e-9)), len(times) - 1)
    start, end = poses[closed], poses[-1]
    drift = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    turned = end[:3, :3] @ start[:3, :3].T
    turn = math.degrees(rotation_angle(turned))
    gravity = np.linalg.norm(task.gravity_o)
    up = -task.gravity_o / gravity if gravity > 0 else np.array([0.0, 0.0, 1.0])
    tilt = float(np.degrees(np.arccos(np.clip(up @ turned @ up, -1, 1))))
    shaken = 1.0 / disturbance.shake_frequency if np.any(disturbance.shake) else None
    held, reason = _decide(history, drift, turn, release, task.way, gone, shaken)
    moved = float(np.linalg.norm(poses[closed, :3, 3] - poses[0, :3, 3]))
    if moved > SLIPPED:
        reason += f"; it had moved by {1e3 * moved:.2f} mm until the grasp was complete"

    # Averages over the last tenth of the hold remove small oscillations.
    holding = times.size - int(np.searchsorted(times, times[complete] + task.way))
    last = slice(min(times.size - 1, times.size - max(1, holding // 10)), None)
    should = planned > 0
    # Errors of small forces are relative to a twentieth of the largest force.
    size = np.maximum(planned, 0.05 * planned.max(initial=0.0))[should]
    errors, foreseen = (
        np.abs(normal[last].mean(axis=0) - one)[should] / size for one in (planned, expected.normal_forces)
    )
    labels = [name for name, wanted in zip(parts, should) if wanted]
    missed = np.abs(history.depths[last].mean(axis=0) - expected.depths)[should]
    slipped = history.slips[-1] - history.slips[complete] > SLIPPED
    hand, q = task.hand, history.q
    low, high = hand.travel
    beyond: BoolArray = np.any((q < low - _BEYOND) | (q > high + _BEYOND), axis=0)
    at_limit: BoolArray = np.abs(history.torques[last]).max(axis=0) >= task.torque_limit * (1 - AT_LIMIT)
    touched: BoolArray = np.any(normal > 0, axis=0)
    return Verdict(
        held=held,
        reason=reason,
        drift=drift,
        tilt=tilt,
        turn=turn,
        force_error=float(errors.max(initial=0.0)),
        force_errors=dict(zip(labels, errors.tolist())),
        settled_error=None if release is None else float(foreseen.max(initial=0.0)),
        penetration_error=float(missed.max(initial=0.0)),
        slipped=tuple(name for name, yes in zip(parts, slipped) if yes),
        unplanned=tuple(name for name, wanted, found in zip(parts, should, touched) if found and not wanted),
        limit_hits=tuple(name for name, yes in zip(hand.joint_names, beyond) if yes),
        saturated=tuple(name for name, yes in zip(hand.joint_names, at_limit) if yes),
        energy_error=None if disturbance.accelerates else _audit(history.energies),  # its base's work is not known
    )


def _decide(
    history: History, drift: float, turn: float, release: float | None, way: float, gone: bool, shaken: float | None
) -> tuple[bool, str]:
    """Whether the object was held, and why; ``shaken``: period of the hand's shaking [s], None: it was not shaken."""
    times, poses = history.times, history.object_poses
    if release is None:
        return True, "the object was never let go"
    since = times[-1] - release
    if gone or not drift <= GONE:
        away = float(np.linalg.norm(poses[-1, :3, 3] - poses[0, :3, 3])) if gone else drift
        return False, f"the object was {1e3 * away:.0f} mm away {since:.2f} s after it was let go"
    if not (drift <= MOVED and turn <= TURNED):
        return False, f"the object moved {1e3 * drift:.2f} mm and turned {turn:.1f} deg within {since:.2f} s"
    # A compliant grasp sways with a shaken hand: it creeps where it is elsewhere whole periods later.
    last = 0.2 * max(since - way, 0.0)
    if in_phase := shaken is not None and shaken <= since:
        last = shaken * min(np.ceil(last / shaken), since // shaken)
    late = times >= times[-1] - last - 1e-9
    resting = poses[late, :3, 3]
    still = _creep(times[late], resting, shaken if in_phase else None)
    if not in_phase:
        longer = times >= times[-1] - 2 * last - 1e-9
        besides = _creep_besides_swing(times[longer], poses[longer, :3, 3])
        still = still if besides is None else 0.5 * besides
    if not still <= RESTING:
        return False, f"the object still creeps: {1e3 * still:.2f} mm in the last {last:.2f} s"
    swing = 0.0 if shaken else float(np.linalg.norm(np.ptp(resting, axis=0)))
    if not swing <= SWINGING:
        return False, f"the object still swings by {1e3 * swing:.2f} mm"
    if not history.normal_forces[-1].any():
        return False, f"nothing touched the object {since:.2f} s after it was let go"
    swings = f", swinging by {1e3 * swing:.2f} mm" if swing > RESTING else ""
    return True, f"{1e3 * drift:.3f} mm and {turn:.2f} deg after {since:.2f} s{swings}"


def _creep(times: Array, positions: Array, period: float | None) -> float:
    """How far positions (s, 3) [m] at times (s,) went steadily, besides swings, those of a ``period`` [s] above all."""
    since = times - times[0]
    columns = [np.ones_like(since), since]
    if period is not None:
        columns += [wave(2 * np.pi * since / period) for wave in (np.sin, np.cos)]
    rate = np.linalg.lstsq(np.column_stack(columns), positions, rcond=None)[0][1]
    return float(np.linalg.norm(rate) * since[-1])


def _creep_besides_swing(times: Array, positions: Array) -> float | None:
    """As :func:`_creep` with the period of the swing that fits the positions best; None where none does.

    Without it, a cycle or two of a swing would look like a creep, or hide one.
    """
    since = times - times[0]
    if len(times) < _SAMPLES or not since[-1] > 0:
        return None
    line = np.column_stack([np.ones_like(since), since])
    best, least = None, _FITS * float(np.linalg.norm(_misfit(line, positions)))
    # Two whole swings at least, or a creep that slows down would be one.
    for period in np.geomspace(0.05, 0.5, _PERIODS) * since[-1]:
        waves = [wave(2 * np.pi * since / period) for wave in (np.sin, np.cos)]
        fades = [since * wave for wave in waves]
        left = float(np.linalg.norm(_misfit(np.column_stack([line, *waves, *fades]), positions)))
        if left < least:
            best, least = _creep(times, positions, float(period)), left
    return best


def _misfit(columns: Array, positions: Array) -> Array:
    """What a fit of columns (s, c) leaves of positions (s, 3)."""
    left: Array = positions - columns @ np.linalg.lstsq(columns, positions, rcond=None)[0]
    return left


def _audit(energies: Mapping[str, Array]) -> float:
    """Largest difference between the energy put in and that stored or lost, relative to the largest of all energies."""
    put_in = energies["joint_work"] + energies["load_work"]
    kept = np.sum([energies[name] for name in ("mechanical", "elastic", "damped", "slipped")], axis=0)
    largest = float(np.abs(np.array(list(energies.values()))).max())
    return float(np.abs(put_in - kept).max() / max(largest, 1e-12))
