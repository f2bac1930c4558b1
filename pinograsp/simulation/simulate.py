"""Simulation of a plan: approach, grasp, release and hold, with the joints' control, on a free object."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from pinograsp import defaults
from pinograsp.checks import each_of
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.simulation.law import ContactForces
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.options import Mode, SimulationOptions
from pinograsp.simulation.record import record_trial
from pinograsp.simulation.schedule import TANGENTIAL, plan_schedule
from pinograsp.simulation.settings import Disturbance, Servo, Support
from pinograsp.simulation.stepping import Trial
from pinograsp.simulation.task import Task


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
    task = Task.of(plan, body)
    options = SimulationOptions(
        hold=hold,
        mode=mode,
        disturbance=Disturbance() if disturbance is None else disturbance,
        servo=servo,
        time_step=time_step,
        sample=sample,
        release=release,
        support=support,
        letting_go=letting_go,
    )
    return simulate_task(task, options)


def simulate_task(task: Task, options: SimulationOptions) -> Simulation:
    """Simulate a task, as :func:`simulate`."""
    started = time.perf_counter()
    schedule, disturbance = plan_schedule(task, options), options.disturbance
    engine = MujocoEngine(
        task,
        time_step=schedule.time_step,
        servo=schedule.servo.scale_gains(disturbance.servo_gain),
        mass_factor=disturbance.mass_factor,
        joint_friction=each_of("joint friction", disturbance.joint_friction, task.hand.n),
    )
    trial = Trial(task, engine, make_forces(task, engine.parts, disturbance), schedule)
    with without_callbacks():
        trial.run()
    return record_trial(trial, time.perf_counter() - started)


def make_forces(task: Task, parts: int, disturbance: Disturbance) -> ContactForces:
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
    other = replace(law, stiffness=factor * law.stiffness, damping=damping)
    return ContactForces(other, each, task.torsion, tangential, counts, places)
