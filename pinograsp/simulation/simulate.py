"""Simulation of a plan: approach, grasp, release and hold, with the joints' control, on a free object."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Literal, TypedDict

import numpy as np
import pinocchio as pin

from pinograsp import defaults
from pinograsp.checks import each_of, flag, frozen, instance_of, number, one_of, read_only
from pinograsp.errors import InvalidInput
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.simulation.causes import causes_of
from pinograsp.simulation.law import ContactLaw
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.sample import Energies, History
from pinograsp.simulation.settings import SUPPORTS, BaseMotion, Disturbance, Servo, Support
from pinograsp.simulation.stepping import Schedule, Trial
from pinograsp.simulation.task import Task
from pinograsp.simulation.verdict import verdict_of
from pinograsp.spatial import Array, inverse_of

Mode = Literal["servo", "prescribed"]

MODES: tuple[Mode, ...] = ("servo", "prescribed")
TANGENTIAL = 2e4  # [N/m] of a contact's tangential spring
_SUPPORTED: dict[Support, tuple[str, ...]] = {
    "fixed": (),
    "table": ("the object stood on a table until the grasp was complete; the hand passes through it",),
    "none": ("nothing but the hand held the object from the impact time on",),
}
_COARSEST = 0.05  # [s] largest time step, and largest interval between samples
_RESOLVED = 0.6  # [rad] at most, of the object's swings on its contacts, in one step
_SHORTER = 20  # times at most, for that; it is enough for grams in steps of a millisecond
_FEWEST_STEPS = 10  # until the grasp is complete
_MOST_STEPS = 2_000_000  # their samples take half a gigabyte


class SimulationSettings(TypedDict, total=False):
    """Keyword arguments of :func:`simulate` that series of simulations share."""

    hold: float
    servo: Servo | None
    time_step: float
    sample: float
    support: Support
    letting_go: float


# Eleven options beside the plan: simulations may differ in each of them.
def simulate(
    plan: PlanRecord | Task | str | Path,
    *,
    hold: float = defaults.HOLD,
    mode: Mode = "servo",
    disturbance: Disturbance | None = None,
    servo: Servo | None = None,
    time_step: float = defaults.TIME_STEP,
    sample: float = 2e-3,
    release: bool = True,
    support: Support = "fixed",
    letting_go: float = 0.2,
    body: Body | None = None,
) -> Simulation:
    """Simulate a plan with a free object, and judge whether the grasp holds.

    The object is fixed until the grasp is complete (t_F, as in the paper), then let go. The hand has the plan's
    geometry (exact primitives and ellipsoids, convex hulls of meshes), masses and torque limits; the object has its own
    shape, of a mesh that is not convex its triangles. A position servo at every joint follows the plan's trajectory,
    with the plan's torques as feed-forward, or either of the two alone (:class:`Servo`). The contact forces follow the
    plan's law (Eq. 4), implemented again in :mod:`pinograsp.simulation.law`.

    Args:
        plan: a plan, the folder of a run, or a task.
        hold: time after the object's support is gone [s]; with a release, at least one step.
        mode: ``"servo"``; or ``"prescribed"``: joints follow the commands exactly, whatever torque that takes (as in
            the paper's Adams model).
        disturbance: differences from the plan.
        servo: control of the joints and gains; default :meth:`Servo.of`.
        time_step: at most 0.05 s, and two million steps in all [s]. An object that swings too fast on its contacts
            for it, since it is light or harder than planned, gets one up to 20 times shorter, with a note.
        sample: interval between samples of the record [s].
        release: False: the object stays fixed to the end.
        support: what bears the object until then: ``"fixed"``: it cannot move until t_F (as in the paper);
            ``"table"``: it stands freely on a table under it, so that whatever hits it on the way moves it (the hand
            itself passes through the table); ``"none"``: from t_I on nothing but the hand holds it.
        letting_go: time that the support takes to fade after t_F [s]; 0: the support vanishes at once, which
            doubles the load for a moment.
        body: the object, where the plan has none.

    Raises:
        InvalidInput: a plan without contacts of a hand, or unusable settings.
        SimulationDiverged: velocities beyond reason: take a smaller time step or softer servos.
    """
    started = time.perf_counter()
    task = task_of(plan, body)
    one_of("mode", mode, MODES)
    servo = Servo.of(task.hand) if servo is None else instance_of("servo", servo, Servo)
    disturbance = Disturbance() if disturbance is None else instance_of("disturbance", disturbance, Disturbance)
    one_of("support", support, SUPPORTS)
    schedule = _schedule(task, hold, time_step, sample, release, support, letting_go, mode == "prescribed", disturbance)
    friction = each_of("joint friction", disturbance.joint_friction, task.hand.n)
    made = MujocoEngine(
        task,
        time_step=schedule.time_step,
        servo=servo.scaled(disturbance.servo_gain),
        mass_factor=disturbance.mass_factor,
        joint_friction=friction,
    )
    share = {"torque": disturbance.servo_gain, "position": 0.0, "impedance": 1.0}[servo.control]
    commanded = task if mode == "prescribed" or share == 1.0 else _with_torques(task, share)
    trial = Trial(commanded, made, _law(task, made.parts, disturbance), schedule)
    with without_callbacks():
        trial.run()
    return _record(trial, mode, servo, time.perf_counter() - started)


def _with_torques(task: Task, share: float) -> Task:
    """A task with a share of its feed-forward torques."""
    return replace(task, torques=share * task.torques, holding_torques=share * task.holding_torques)


def task_of(plan: PlanRecord | Task | str | Path, body: Body | None = None) -> Task:
    """The task of a plan, or ``plan`` itself where it is one; ``body``: the object, where the plan has none."""
    if not isinstance(plan, Task):
        return Task.of(plan, body)
    if body is not None:
        raise InvalidInput("body: expected with a plan that has no object, got one with a task, which has its own")
    return plan


def _schedule(
    task: Task,
    hold: float,
    time_step: float,
    sample: float,
    release: bool,
    support: Support,
    letting_go: float,
    prescribed: bool,
    disturbance: Disturbance,
) -> Schedule:
    """The checked times of a simulation."""
    hold = number("hold", hold, at_least=0, unit="s")
    dt = number("time step", time_step, above=0, unit="s")
    letting_go = number("letting go", letting_go, at_least=0, unit="s")
    sample = number("sample", sample, above=0, unit="s")
    flag("release", release)
    if sample > _COARSEST:
        raise InvalidInput(
            f"sample: expected at most {_COARSEST:g} s, got {sample:g} s: the verdict depends on the samples"
        )
    longest = min(_COARSEST, task.final_time / _FEWEST_STEPS)
    if dt > longest:
        raise InvalidInput(f"time step: expected at most {longest:g} s, got {dt:g} s")
    asked, duration = dt, float(task.times[-1]) + hold + (letting_go if release else 0.0)
    if release:
        swinging = float(np.sqrt(len(task.names) * _stiffest(task, disturbance.stiffness) / task.body.mass))  # [rad/s]
        dt = min(dt, max(dt / _SHORTER, _RESOLVED / swinging))
    if not duration / dt <= _MOST_STEPS:
        raise InvalidInput(
            f"hold, time step: expected at most {_MOST_STEPS} steps, got {duration / dt:.3g} "
            f"({duration:g} s in steps of {dt:g} s): hold for less, or take longer steps"
        )
    if support != "fixed" and not release:
        raise InvalidInput(f"support: expected 'fixed' with release=False, got '{support}', which lets the object go")
    if release and hold < asked:
        raise InvalidInput(
            f"hold: expected at least one step, {asked:g} s, got {hold:g} s: without a hold there is nothing to judge"
        )
    if prescribed:
        _check_exact(disturbance)
    if disturbance.base_motion is not None:
        _check_base_motion(disturbance.base_motion, task.way + hold + letting_go, release)
    for push in disturbance.pushes:
        if push.start + push.duration > task.way + hold + 0.5 * dt:
            raise InvalidInput(
                f"hold: expected at least {push.start + push.duration:g} s, the end of a push, got {hold:g} s"
            )
    return Schedule(
        time_step=dt,
        shortened=dt < asked,
        duration=duration,
        every=max(1, round(min(sample / dt, _MOST_STEPS))),
        release=release,
        support=support,
        letting_go=letting_go,
        prescribed=prescribed,
        disturbance=disturbance,
    )


def _check_exact(disturbance: Disturbance) -> None:
    """Refuse errors of joints that follow the commands exactly."""
    named = {
        "start error": disturbance.start_error is not None,
        "joint offset": np.any(disturbance.joint_offset),
        "joint friction": np.any(disturbance.joint_friction),
        "servo gain": disturbance.servo_gain != 1.0,
    }
    for name, given in named.items():
        if given:
            raise InvalidInput(
                f"{name}: expected only with mode='servo', got one with mode='prescribed': those joints have no error"
            )


def _check_base_motion(motion: BaseMotion, longest: float, release: bool) -> None:
    """Refuse a motion of the base that the simulation would not show."""
    if not release:
        raise InvalidInput("base motion: expected with release=True, got release=False, which fixes the object")
    if motion.times[-1] > longest + 1e-9:
        raise InvalidInput(
            f"hold: expected the base's motion to end within {longest:g} s of t_F (letting go and hold), got "
            f"{motion.times[-1]:g} s: hold for longer"
        )


def _stiffest(task: Task, factor: float) -> float:
    """Of the springs at a contact whose K is ``factor`` times the planned one [N/m]."""
    law, rho = task.law, task.law.exponent or 1.0
    tangential = float(TANGENTIAL * factor ** (1 / rho))
    if factor <= 1.0:  # the plan's own contacts take the steps that are asked for
        return tangential
    depth = float(np.max(task.depths, initial=0.0))
    if len(law.table):
        steps = np.diff(law.table, axis=0)
        return max(tangential, factor * law.stiffness * float((steps[:, 1] / steps[:, 0]).max()))
    return max(tangential, float(factor * law.stiffness * rho * depth ** (rho - 1)))


def _law(task: Task, parts: int, disturbance: Disturbance) -> ContactLaw:
    """The law for every part of the hand: mu of its planned contacts, or their mean for parts without any."""
    joints = np.array([task.joint_of(link) for link in task.links])
    counts = np.bincount(joints, minlength=parts)
    each = np.full(parts, task.mu.mean())
    for joint in set(joints.tolist()):
        each[joint] = task.mu[joints == joint].mean()
    if disturbance.mu is not None:
        each = np.full(parts, disturbance.mu)
    law, factor = task.law, disturbance.stiffness
    rho = law.exponent or 1.0  # of a measured law, as if it were linear
    # At one force F, the normal stiffness rho K^(1/rho) F^(1 - 1/rho) grows with factor^(1/rho), and the damping
    # coefficient lambda F / K is to grow with its root.
    tangential, damping = TANGENTIAL * factor ** (1 / rho), law.damping * factor ** (1 + 1 / (2 * rho))
    inverse = np.linalg.inv(task.body.shape_pose)
    points = task.points_o @ inverse[:3, :3].T + inverse[:3, 3]
    places = [points[joints == joint] for joint in range(parts)]
    return ContactLaw(
        factor * law.stiffness, damping, law.exponent, each, task.torsion, tangential, counts, places, law.table
    )


def _record(trial: Trial, mode: Mode, servo: Servo, elapsed: float) -> Simulation:
    task, schedule, samples = trial.task, trial.schedule, trial.samples
    light = f"steps of {1e3 * schedule.time_step:.2g} ms: a light object swings fast on its contacts"
    if schedule.disturbance.stiffness > 1.0:
        light = light.replace("a light object swings", "a light or hard object swings")
    joints = [task.joint_of(link) for link in task.links]
    planned, settled = np.zeros((2, trial.engine.parts))
    np.add.at(planned, joints, task.normal_forces)
    np.add.at(settled, joints, task.settled_forces)

    def column(name: str) -> Array:
        return np.array([getattr(sample, name) for sample in samples])

    normal = column("normal_forces")
    present = (planned > 0) | (normal > 0).any(axis=0)
    by_contact = dict.fromkeys([*joints, *range(trial.engine.parts)])  # parts in the order of the plan's contacts
    shown = np.array([part for part in by_contact if present[part]], dtype=int)
    energies = {
        one.name: frozen(np.array([getattr(sample.energies, one.name) for sample in samples], dtype=float))
        for one in fields(Energies)
    }
    history = History(
        complete=trial.complete,
        times=read_only(column("time")),
        q=read_only(column("q")),
        dq=read_only(column("dq")),
        torques=read_only(column("torques")),
        object_poses=read_only(column("object_pose")),
        parts=tuple(_label(task, int(part), joints) for part in shown),
        forces_o=read_only(column("forces_o")[:, shown]),
        normal_forces=read_only(normal[:, shown]),
        tangential_forces=read_only(column("tangential_forces")[:, shown]),
        depths=read_only(column("depths")[:, shown]),
        slips=read_only(column("slips")[:, shown]),
        planned_forces=read_only(planned[shown]),
        energies=energies,
    )
    depths = [max((d for d, joint in zip(task.depths, joints) if joint == part), default=0.0) for part in shown]
    free = task.impact_time if schedule.support == "none" else task.final_time
    released = free if schedule.release else None
    disturbance = schedule.disturbance
    period = 1.0 / disturbance.shake_frequency if np.any(disturbance.shake) else None
    seen = replace(history, object_poses=task.as_carried(history.q, history.object_poses))
    verdict = verdict_of(
        task,
        seen,
        np.array(depths),
        settled[shown],
        released,
        gone=trial.gone,
        shaken=period,
        support=schedule.support,
        audited=not trial.moved,
    )
    if not verdict.held:
        causes, remedies = causes_of(task, seen, servo if mode == "servo" else None, disturbance)
        verdict = replace(verdict, causes=causes, remedies=remedies)
    return Simulation(
        verdict=verdict,
        mode=mode,
        servo=servo.summary() if mode == "servo" else {},
        time_step=schedule.time_step,
        release=released,
        disturbance=disturbance.summary(),
        notes=(*trial.engine.notes, *_SUPPORTED[schedule.support], *([light] if schedule.shortened else [])),
        elapsed=elapsed,
        exponent=task.law.exponent,
        com_b=task.body.com_b,
        **{one.name: getattr(history, one.name) for one in fields(History)}
        | {"object_poses": read_only(history.object_poses @ inverse_of(task.body.shape_b))},
    )


def _label(task: Task, part: int, joints: list[int]) -> str:
    """Name of a part of the hand: its contact's where it has exactly one, else its link's."""
    planned = [i for i, joint in enumerate(joints) if joint == part]
    if len(planned) == 1:
        return task.names[planned[0]]
    if planned:
        return task.links[planned[0]]
    model = task.hand.model
    own = [frame.name for frame in model.frames if frame.parentJoint == part and frame.type == pin.FrameType.BODY]
    if part == 0:
        return task.hand.palm
    return str(own[0] if own else model.names[part])
