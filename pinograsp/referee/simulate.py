"""A plan tried: approach, grasp, release and hold, with servos and feed-forward torques, on a free object."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin

from pinograsp.checks import flag, instance_of, number, one_of, read_only
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.referee.law import ContactLaw
from pinograsp.referee.sample import Energies, History
from pinograsp.referee.settings import Disturbance, Servo
from pinograsp.referee.stepping import Engine, Schedule, Trial
from pinograsp.referee.task import Task
from pinograsp.referee.verdict import verdict_of

EngineName = Literal["mujoco", "pinocchio"]
Mode = Literal["servo", "prescribed"]

ENGINES: tuple[EngineName, ...] = ("mujoco", "pinocchio")
MODES: tuple[Mode, ...] = ("servo", "prescribed")
TANGENTIAL = 2e4  # [N/m] of a contact's tangential spring
_COARSEST = 0.05  # [s] between samples, which are steps at least
_FEWEST_STEPS = 10  # until the grasp is complete
_MOST_STEPS = 2_000_000  # their samples take half a gigabyte


# Eleven options beside the plan: every one is a thing that a trial may differ in.
def simulate(
    plan: PlanRecord | Task | str | Path,
    *,
    hold: float = 1.0,
    engine: EngineName = "mujoco",
    mode: Mode = "servo",
    disturbance: Disturbance | None = None,
    servo: Servo | None = None,
    time_step: float = 2.5e-4,
    sample: float = 2e-3,
    release: bool = True,
    letting_go: float = 0.2,
    body: Body | None = None,
) -> Simulation:
    """Try a plan with a free object, and say whether it holds.

    The object is fixed until the grasp is complete (t_F, as in the paper), then let go. The hand has the plan's
    geometry (exact primitives and ellipsoids, convex hulls of meshes), its masses and torque limits; every joint
    follows the plan's trajectory by a position servo with the plan's torques on top. Contacts press by the plan's law
    (Eq. 4), written again in :mod:`pinograsp.referee.law`.

    Args:
        plan: fresh or read back, the folder of one, or a task.
        hold: how long after the support is gone [s]; with the release at least a step.
        engine: ``"mujoco"`` (extra ``sim``), or ``"pinocchio"``: a second opinion with nothing else installed.
        mode: ``"servo"``; or ``"prescribed"``: the joints are moved as commanded, whatever it takes (the paper's Adams
            set-up).
        disturbance: what is not as planned.
        servo: gains; default :meth:`Servo.of`.
        time_step: at most 0.05 s, and two million steps in all [s].
        sample: interval between samples of the record [s].
        release: False keeps the object fixed to the end.
        letting_go: how long the support that has held the object takes to give way after t_F [s]; 0: it is gone at
            once, which doubles the load for a moment.
        body: what is held, where the plan does not know.

    Raises:
        InvalidInput: a plan without contacts of a hand, or unusable settings.
        SimulationDiverged: speeds beyond reason: take a smaller step or softer servos.
        ExtraMissing: MuJoCo is not installed.
    """
    started = time.perf_counter()
    if isinstance(plan, Task) and body is not None:
        raise InvalidInput("body: expected with a plan that does not know its own, got one with a task, which does")
    task = plan if isinstance(plan, Task) else Task.of(plan, body)
    one_of("engine", engine, ENGINES)
    one_of("mode", mode, MODES)
    servo = Servo.of(task.hand) if servo is None else instance_of("servo", servo, Servo)
    disturbance = Disturbance() if disturbance is None else disturbance
    instance_of("disturbance", disturbance, Disturbance)
    schedule = _schedule(task, hold, time_step, sample, release, letting_go, mode == "prescribed", disturbance)
    kind = _engine(engine)
    built: Engine = kind(task, time_step=schedule.time_step, servo=servo, mass_factor=disturbance.mass_factor)
    trial = Trial(task, built, _law(task, built.parts, disturbance.mu), schedule)
    trial.run()
    return _record(trial, engine, mode, time.perf_counter() - started)


def _schedule(
    task: Task,
    hold: float,
    time_step: float,
    sample: float,
    release: bool,
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
            f"sample: expected at most {_COARSEST:g} s, got {sample:g} s: the verdict is read from the samples"
        )
    longest = min(_COARSEST, task.final_time / _FEWEST_STEPS)
    if dt > longest:
        raise InvalidInput(f"time step: expected at most {longest:g} s, got {dt:g} s")
    duration = task.final_time + hold + (letting_go if release else 0.0)
    if not duration / dt <= _MOST_STEPS:
        raise InvalidInput(
            f"hold, time step: expected at most {_MOST_STEPS} steps, got {duration / dt:.3g} "
            f"({duration:g} s in steps of {dt:g} s): hold for less, or take longer steps"
        )
    if release and hold < dt:
        raise InvalidInput(
            f"hold: expected at least a step, {dt:g} s, got {hold:g} s: what is not held for a while is not held"
        )
    if prescribed and disturbance.start_error is not None:
        raise InvalidInput(
            "start error: expected with servos, joints that move as commanded have none (mode='prescribed')"
        )
    for push in disturbance.pushes:
        if push.start + push.duration > hold + 0.5 * dt:
            raise InvalidInput(
                f"hold: expected at least {push.start + push.duration:g} s, the end of a push, got {hold:g} s"
            )
    return Schedule(
        time_step=dt,
        duration=duration,
        every=max(1, round(min(sample / dt, _MOST_STEPS))),
        release=release,
        letting_go=letting_go,
        prescribed=prescribed,
        disturbance=disturbance,
    )


def _engine(name: EngineName) -> Callable[..., Engine]:
    if name == "pinocchio":
        from pinograsp.referee.pinocchio_engine import PinocchioEngine

        return PinocchioEngine
    try:
        from pinograsp.referee.mujoco_engine import MujocoEngine
    except ImportError as error:
        raise ExtraMissing(
            "the simulation needs MuJoCo: pip install 'pinograsp[sim]', or use engine='pinocchio' (--engine pinocchio)"
        ) from error
    return MujocoEngine


def _law(task: Task, parts: int, mu: float | None) -> ContactLaw:
    """The law for every part of the hand: friction of its planned contacts, the mean where there are none."""
    joints = np.array([task.joint_of(link) for link in task.links])
    counts = np.bincount(joints, minlength=parts)
    each = np.full(parts, task.mu.mean())
    for joint in set(joints.tolist()):
        each[joint] = task.mu[joints == joint].mean()
    K, damping, exponent = task.law
    return ContactLaw(
        K, damping, exponent, each if mu is None else np.full(parts, mu), task.torsion, TANGENTIAL, counts
    )


def _record(trial: Trial, engine: str, mode: str, elapsed: float) -> Simulation:
    task, schedule, samples = trial.task, trial.schedule, trial.samples
    joints = [task.joint_of(link) for link in task.links]
    planned = np.bincount(joints, weights=task.normal_forces, minlength=trial.engine.parts)

    def column(name: str) -> np.ndarray:
        return np.array([getattr(sample, name) for sample in samples])

    normal = column("normal_forces")
    shown = np.flatnonzero((planned > 0) | (normal > 0).any(axis=0))
    energies = {
        one.name: read_only([getattr(sample.energies, one.name) for sample in samples]) for one in fields(Energies)
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
    released = task.final_time if schedule.release else None
    return Simulation(
        verdict=verdict_of(task, history, np.array(depths), released, gone=trial.gone, audited=not trial.shaken),
        engine=engine,
        mode=mode,
        time_step=schedule.time_step,
        release=released,
        disturbance=schedule.disturbance.summary(),
        notes=trial.engine.notes,
        elapsed=elapsed,
        exponent=task.law[2],
        **{one.name: getattr(history, one.name) for one in fields(History)},
    )


def _label(task: Task, part: int, joints: list[int]) -> str:
    """The contact's name where a part has one, else the link's."""
    planned = [i for i, joint in enumerate(joints) if joint == part]
    if len(planned) == 1:
        return task.names[planned[0]]
    if planned:
        return task.links[planned[0]]
    model = task.hand.model
    own = [frame.name for frame in model.frames if frame.parentJoint == part and frame.type == pin.FrameType.BODY]
    return task.hand.palm if part == 0 else own[0] if own else model.names[part]
