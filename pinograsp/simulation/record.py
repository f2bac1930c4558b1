"""The record of a simulation, from what was sampled."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin

from pinograsp.checks import frozen, read_only
from pinograsp.plan import History, Simulation
from pinograsp.simulation.causes import find_causes
from pinograsp.simulation.stepping import Trial
from pinograsp.simulation.task import Task
from pinograsp.simulation.verdict import Expected, judge
from pinograsp.spatial import Array, IntArray, inverse_of

_SUPPORTED: dict[str, tuple[str, ...]] = {
    "fixed": (),
    "table": ("the object stood on a table until the grasp was complete; the hand passes through it",),
    "none": ("nothing but the hand held the object from the impact time on",),
}


def record_trial(trial: Trial, elapsed: float) -> Simulation:
    """The record of a trial that has run, with its verdict; ``elapsed`` [s]."""
    task, schedule, options = trial.task, trial.schedule, trial.options
    joints = [task.joint_of(link) for link in task.links]
    most = np.max([sample.normal_forces for sample in trial.samples], axis=0)
    np.maximum.at(most, joints, task.normal_forces)
    # In the order of the plan's contacts, then parts that touch without a plan.
    every: IntArray = np.array(list(dict.fromkeys([*joints, *range(trial.engine.parts)])))
    parts = every[most[every] > 0]
    of = np.equal.outer(parts, joints)  # (p, k): which contacts belong to which part
    history = _collect(trial, parts, of @ task.normal_forces)
    expected = Expected(depths=np.max(np.where(of, task.depths, 0.0), axis=1), normal_forces=of @ task.settled_forces)
    released = None
    if options.release:
        released = task.impact_time if options.support == "none" else task.final_time
    seen = replace(history, object_poses=task.as_carried(history.q, history.object_poses))
    verdict = judge(task, seen, expected, released, gone=trial.gone, options=options)
    servo = None if schedule.is_prescribed else schedule.servo
    if not verdict.held:
        causes, remedies = find_causes(task, seen, servo, options.disturbance)
        verdict = replace(verdict, causes=causes, remedies=remedies)
    notes = [*trial.engine.notes, *_SUPPORTED[str(options.support)]]
    if schedule.is_shortened:
        what = "light or hard" if options.disturbance.stiffness > 1.0 else "light"
        notes.append(f"steps of {1e3 * schedule.time_step:.2g} ms: a {what} object swings fast on its contacts")
    differences = options.disturbance.summary()
    if options.controller is not None:
        differences["controller_feels"] = list(options.sensors.quantities)
    return Simulation(
        verdict=verdict,
        mode=options.mode,
        servo={} if servo is None else servo.summary(),
        time_step=schedule.time_step,
        release=released,
        disturbance=differences,
        notes=tuple(notes),
        elapsed=elapsed,
        exponent=task.law.exponent,
        com_b=task.body.com_b,
        object_poses=read_only(history.object_poses @ inverse_of(task.body.shape_b)),
        **{one.name: getattr(history, one.name) for one in fields(History) if one.name != "object_poses"},
    )


def _collect(trial: Trial, parts: IntArray, planned: Array) -> History:
    """The samples of the parts (p,), with the sums of their planned forces (p,), as arrays."""
    task, samples = trial.task, trial.samples

    def column(name: str) -> Array:
        return read_only(np.array([getattr(sample, name) for sample in samples]))

    by_part = ("forces_o", "normal_forces", "tangential_forces", "depths", "slips")
    return History(
        complete=trial.complete,
        times=column("time"),
        object_poses=column("object_pose"),
        parts=tuple(_name_part(task, int(part)) for part in parts),
        planned_forces=read_only(planned),
        energies={name: frozen(np.array([one.energies[name] for one in samples])) for name in samples[0].energies},
        **{name: column(name) for name in ("q", "dq", "torques")},
        **{name: read_only(column(name)[:, parts]) for name in by_part},
    )


def _name_part(task: Task, part: int) -> str:
    """Name of a part of the hand: its contact's where it has exactly one, else its link's."""
    planned = [i for i, link in enumerate(task.links) if task.joint_of(link) == part]
    if planned:
        return task.names[planned[0]] if len(planned) == 1 else task.links[planned[0]]
    if part == 0:
        return task.hand.palm
    model = task.hand.model
    own = [frame.name for frame in model.frames if frame.parentJoint == part and frame.type == pin.FrameType.BODY]
    return str(own[0] if own else model.names[part])
