"""Why a simulated grasp was lost: what went wrong first, and what to change."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinograsp.plan import History
from pinograsp.plan.simulation import MOVED, TURNED
from pinograsp.simulation.settings import Disturbance, Servo
from pinograsp.simulation.task import Task
from pinograsp.simulation.verdict import AT_LIMIT, SLIPPED
from pinograsp.spatial import Array, BoolArray

_MOST = 3  # causes told
_LASTING = 0.02  # [s] at its limit: shorter is no cause
_WEAK, _STRONG = 0.8, 1.25  # simulated over planned normal forces that are told
_YIELDED = 2.0, 1e-3  # [deg], [m] of a joint after the grasp is complete: the hand gives way
_FIRMER = 1.2  # times the pushes: an object that is shaken swings beyond
_TOUCHING = 0.01  # share of the planned force below which a contact is open


class _Event(NamedTuple):
    """What went wrong with a joint or a contact, when [s]."""

    time: float
    kind: str
    name: str
    text: str


def find_causes(
    task: Task, history: History, servo: Servo | None, disturbance: Disturbance
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The causes of a loss in the order of time, and what to change, in words.

    Args:
        task: what was simulated.
        history: the samples.
        servo: control of the joints; None: they followed the commands exactly.
        disturbance: differences from the plan.
    """
    until = _lost_at(history)
    events = [] if servo is None else _find_saturated(task, history, until)
    events = sorted([*events, *_find_slipped_or_opened(task, history, until), *_find_yielded(task, history, until)])[
        :_MOST
    ]
    first = min((event.time for event in events if event.kind in ("slipped", "opened")), default=history.times[until])
    # On a way after the release planned forces are other ones than at its end.
    ratio = 1.0 if task.way else _compare_pressing(history, float(first))
    causes = [event.text for event in events]
    if not _WEAK <= ratio <= _STRONG:
        causes.append(
            f"from {task.final_time:.3f} s on the contacts pressed with {100 * ratio:.0f} % of the planned forces"
        )
    if not causes:
        causes.append(
            f"no contact slipped or opened until {history.times[until]:.3f} s: the hand carried the object off"
        )
    return tuple(causes), tuple(_remedies(task, events, ratio, servo, disturbance))


def _lost_at(history: History) -> int:
    """The sample from which on the object counts as lost."""
    poses, complete = history.object_poses, history.complete
    moved = np.linalg.norm(poses[:, :3, 3] - poses[complete, :3, 3], axis=1) > MOVED
    turned = [np.linalg.norm(pin.log3(pose[:3, :3] @ poses[complete, :3, :3].T)) > np.radians(TURNED) for pose in poses]
    return _first(moved | np.array(turned), complete, len(poses) - 1)


def _first(what: BoolArray, start: int, otherwise: int) -> int:
    """The first sample from ``start`` on at which ``what`` (s,) is true."""
    found = np.flatnonzero(what[start:])
    return start + int(found[0]) if found.size else otherwise


def _find_saturated(task: Task, history: History, until: int) -> list[_Event]:
    """Motors that were at their torque limits for a while, from the touch on until the object was lost."""
    times, events = history.times, []
    at_limit: BoolArray = np.abs(history.torques[: until + 1]) >= task.torque_limit * (1 - AT_LIMIT)
    for j, name in enumerate(task.hand.joint_names):
        changes = np.flatnonzero(np.diff(at_limit[:, j].astype(int), prepend=0, append=0))
        for begin, end in changes.reshape(-1, 2):
            since, last = float(times[begin]), float(times[end - 1])
            if last - since < _LASTING or last < task.impact_time:
                continue
            unit = "N" if task.hand.is_prismatic(task.hand.model.getJointId(name)) else "N m"
            when = f"from {since:.3f} s on" if end > until else f"from {since:.3f} to {last:.3f} s"
            text = f"motor '{name}' at its torque limit, {task.torque_limit[j]:.3g} {unit}, {when}"
            events.append(_Event(since, "motor", name, text))
            break
    return events


def _find_slipped_or_opened(task: Task, history: History, until: int) -> list[_Event]:
    """Planned contacts that slipped or opened before the object was lost."""
    times, complete, events = history.times, history.complete, []
    for part, name in enumerate(history.parts):
        planned = history.planned_forces[part]
        if planned <= 0:
            continue
        touching = history.normal_forces[:, part] > _TOUCHING * planned
        if not touching[: complete + 1].any():
            text = f"contact '{name}' never touched until the grasp was complete, at {task.final_time:.3f} s"
            events.append(_Event(float(task.final_time), "opened", name, text))
            continue
        slipped = _first(history.slips[:, part] - history.slips[complete, part] > SLIPPED, complete, until + 1)
        opened = _first(~touching, complete, until + 1)
        if slipped <= min(until, opened):
            text = f"contact '{name}' slipped from {times[slipped]:.3f} s on"
            events.append(_Event(float(times[slipped]), "slipped", name, text))
        elif opened <= until:
            text = f"contact '{name}' opened at {times[opened]:.3f} s"
            events.append(_Event(float(times[opened]), "opened", name, text))
    return events


def _find_yielded(task: Task, history: History, until: int) -> list[_Event]:
    """The first joint that left its place after the grasp was complete and before the object was lost."""
    turn, shift = _YIELDED
    slides = task.hand.slides
    off = history.q - task.command_at(history.times)
    moved = np.abs(off - off[history.complete]) / np.where(slides, shift, np.radians(turn))
    when = _first((moved > 1.0).any(axis=1), history.complete, until + 1)
    if when > until:
        return []
    joint = int(moved[when].argmax())
    size = f"{1e3 * shift:g} mm" if slides[joint] else f"{turn:g} deg"
    name, time = task.hand.joint_names[joint], float(history.times[when])
    return [_Event(time, "joint", name, f"joint '{name}' gave way, by more than {size} from {time:.3f} s on")]


def _compare_pressing(history: History, until: float) -> float:
    """Simulated over planned normal forces in all, from the grasp's completion to a time [s]."""
    planned, complete = history.planned_forces, history.complete
    last = max(int(np.searchsorted(history.times, until)), complete + 1)
    mean: Array = history.normal_forces[complete:last][:, planned > 0].mean(axis=0)
    return float(mean.sum() / max(planned.sum(), 1e-12))


def _remedies(
    task: Task, events: list[_Event], ratio: float, servo: Servo | None, disturbance: Disturbance
) -> list[str]:
    """What to change, in words."""
    remedies = []
    for event in events:
        if event.kind == "motor":
            remedies.append(
                f"a higher effort limit of joint '{event.name}', or more torque kept free: Reserve(torque=...)"
            )
            break
    if servo is not None and servo.control == "position" and ratio < _WEAK:
        remedies.append("the plan's torques as feed-forward (control='impedance'), or stiffer servos: kp")
    elif servo is not None and servo.control != "torque" and not _WEAK <= ratio <= _STRONG:
        rubbing = bool(np.any(disturbance.joint_friction))
        if rubbing:
            remedies.append("stiffer servos, higher kp: dry friction of the joints takes less of the forces")
        if not rubbing or disturbance.stiffness != 1.0 or np.any(disturbance.joint_offset):
            remedies.append(
                "softer servos, lower kp: the forces depend less on the stiffness of the contacts, and on errors of "
                "positions"
            )
    elif servo is not None and servo.control == "torque":
        remedies.append("soft servos besides the torques, which keep the fingers in place: control='impedance'")
    elif servo is not None and any(event.kind == "joint" for event in events):
        remedies.append("stiffer servos, higher kp: they keep the fingers in place")
    if any(event.kind in ("slipped", "opened") for event in events) or not remedies:
        remedies.append(_planned_for(task, disturbance))
    return remedies


def _planned_for(task: Task, disturbance: Disturbance) -> str:
    """A plan for the mass and the friction that there were, with a reserve for the pushes and the shaking."""
    body, factor, mu = task.body, disturbance.mass_factor, disturbance.mu
    mass = factor * body.mass
    changes = [f"mass={mass:.3g} kg, not {body.mass:.3g} kg"] if factor != 1.0 else []
    changes += [f"mu={mu:.3g}, not {task.mu.min():.3g}"] if mu is not None and mu < task.mu.min() else []
    arm = float(np.sqrt(np.linalg.eigvalsh(body.inertia_b)[-1] / body.mass))  # by which its mass resists turning
    forces = [np.linalg.norm(one.wrench_o[:3]) + np.linalg.norm(one.wrench_o[3:]) / arm for one in disturbance.pushes]
    carried = 0.0 if disturbance.base_motion is None else np.abs(disturbance.base_motion.accelerations).max(initial=0.0)
    force = max(forces, default=0.0) + mass * float(np.linalg.norm(disturbance.shake) + carried)
    weight = mass * float(np.linalg.norm(task.gravity_o))
    share = max(1.0, np.ceil(10 * _FIRMER * force / weight) / 10) if weight > 0 else 1.0
    remedies = [f"a plan for the real values: {', '.join(changes)}"] if changes else []
    if force > 0 or not changes:
        remedies.append(f"more squeeze: plan with --reserve disturbance={share:g} (Reserve(disturbance={share:g}))")
    return "; and ".join(remedies)
