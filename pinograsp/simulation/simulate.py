"""Simulation of a plan: approach, grasp, release and hold, with the joints' control, on a free object."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pinograsp.checks import each_of
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.plan.felt import Controller
from pinograsp.simulation.law import ContactForces
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.options import Mode, SimulationOptions, SimulationSettings
from pinograsp.simulation.record import record_trial
from pinograsp.simulation.schedule import TANGENTIAL, plan_schedule
from pinograsp.simulation.sensing import Sensors
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.stepping import Trial
from pinograsp.simulation.task import Task

if TYPE_CHECKING:
    from typing_extensions import Unpack


def simulate(
    plan: PlanRecord | Task | str | Path,
    *,
    mode: Mode = "servo",
    disturbance: Disturbance | None = None,
    release: bool = True,
    body: Body | None = None,
    controller: Controller | None = None,
    sensors: Sensors | None = None,
    **settings: Unpack[SimulationSettings],
) -> Simulation:
    """Simulate a plan with a free object, and judge whether the grasp holds.

    The object is fixed until the grasp is complete (t_F, as in the paper), or stands on the plan's table; then it is
    let go. The hand has the plan's geometry (exact primitives and ellipsoids, convex hulls of meshes), masses and
    torque limits. The object has its own shape; for a mesh that is not convex, its triangles. A position servo at every
    joint follows the plan's trajectory, softer while the hand closes, with the plan's torques as feed-forward, or
    either of the two alone (:class:`Servo`). The contact forces follow the plan's law (Eq. 4), implemented again in
    :mod:`pinograsp.simulation.law`.

    Args:
        plan: a plan, the folder of a run, or a task.
        mode: ``"servo"``; or ``"prescribed"``: joints follow the commands exactly, with any torque (as in the paper's
            Adams model).
        disturbance: differences from the plan.
        release: False: the object stays fixed to the end.
        body: the object, if the plan has none.
        controller: called from t_F on with the measurements (:class:`~pinograsp.reflex.Felt`); it returns the commands
            of the drives (:class:`~pinograsp.reflex.Command`). If it has a method ``reset``, that is called first.
            None: as planned.
        sensors: what they measure, how late, and with what noise; None: the defaults of :class:`Sensors`.
        **settings: hold, servo, time_step, sample, support and letting_go, as for
            :class:`~pinograsp.simulation.options.SimulationOptions`.

    Raises:
        InvalidInput: a plan without contacts of a hand, or unusable settings.
        SimulationDiverged: velocities beyond reason: use a smaller time step or softer servos.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> ball = pg.Sphere(radius=0.02, mass=0.1).placed(up)
        >>> plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.6))
        >>> seen = pg.simulate(plan, hold=0.05, time_step=1e-3)
        >>> print(seen.verdict.held)
        True

    See Also:
        :class:`~pinograsp.simulation.Disturbance`, :func:`~pinograsp.simulation.monte_carlo`.
    """
    task = Task.of(plan, body)
    disturbance = Disturbance() if disturbance is None else disturbance
    options = SimulationOptions(
        mode=mode,
        disturbance=disturbance,
        release=release,
        controller=controller,
        sensors=Sensors() if sensors is None else sensors,
        **settings,
    )
    return simulate_task(task, options)


def simulate_task(task: Task, options: SimulationOptions) -> Simulation:
    """Simulate a task, as :func:`simulate`."""
    started = time.perf_counter()
    disturbance = options.disturbance
    task = task.delay_commands(each_of("command delay", disturbance.command_delay, task.hand.n))
    schedule = plan_schedule(task, options)
    engine = MujocoEngine(
        task,
        time_step=schedule.time_step,
        servo=schedule.servo.scale_gains(disturbance.servo_gain).scale_gains(disturbance.drive_gain),
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
