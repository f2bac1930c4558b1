"""A plan tried: approach, grasp, release and hold, with servos and feed-forward torques, on a free object."""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

from pinograsp.checks import array_of, flag, instance_of, number, one_of, read_only
from pinograsp.errors import ExtraMissing, InvalidInput, SimulationDiverged
from pinograsp.objects.body import Body
from pinograsp.referee.law import ContactLaw
from pinograsp.referee.settings import Disturbance, Servo
from pinograsp.referee.simulation import GONE, Simulation
from pinograsp.referee.task import Task
from pinograsp.referee.verdict import verdict_of

ENGINES, MODES = ("mujoco", "pinocchio"), ("servo", "prescribed")
TANGENTIAL = 2e4  # [N/m] of a contact's tangential spring
_SUPPORT = 200.0  # [rad/s] of the object on the support that lets it go
_COARSEST = 0.05  # [s] between samples, which are steps at least
_FEWEST_STEPS = 10  # until the grasp is complete
_MOST_STEPS = 2_000_000  # their samples take half a gigabyte
_FASTEST = 1e3  # [m/s, rad/s] faster than any hand: the simulation has diverged


def simulate(
    plan,
    *,
    hold: float = 1.0,
    engine: str = "mujoco",
    mode: str = "servo",
    disturbance: Disturbance | None = None,
    servo: Servo | None = None,
    time_step: float = 2.5e-4,
    sample: float = 2e-3,
    release: bool = True,
    letting_go: float = 0.2,
    object: Body | None = None,
) -> Simulation:
    """Try a plan with a free object, and say whether it holds.

    The object is fixed until the grasp is complete (t_F, as in the paper), then let go. The hand has the plan's
    geometry (exact primitives and ellipsoids, convex hulls of meshes), its masses and torque limits; every joint
    follows the plan's trajectory by a position servo with the plan's torques on top. Contacts press by the plan's law
    (Eq. 4), written again in :mod:`pinograsp.referee.law`.

    Args:
        plan: a :class:`~pinograsp.plan.GraspPlan`, a run, or the folder of one.
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
        object: what is held, where the plan does not know.

    Raises:
        InvalidInput: a plan without contacts of a hand, or unusable settings.
        SimulationDiverged: speeds beyond reason: take a smaller step or softer servos.
        ExtraMissing: MuJoCo is not installed.
    """
    started = time.perf_counter()
    if isinstance(plan, Task) and object is not None:
        raise InvalidInput("object: expected with a plan that does not know its own, got one with a task, which does")
    task = plan if isinstance(plan, Task) else Task.of(plan, object)
    one_of("engine", engine, ENGINES)
    one_of("mode", mode, MODES)
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
            f"hold, time step: expected at most {_MOST_STEPS} steps, got {duration / dt:.3g} ({duration:g} s in "
            f"steps of {dt:g} s): "
            "hold for less, or take longer steps"
        )
    if release and hold < dt:
        raise InvalidInput(
            f"hold: expected at least a step, {dt:g} s, got {hold:g} s: what is not held for a while is not held"
        )
    every = max(1, round(min(sample / dt, _MOST_STEPS)))
    servo = Servo.of(task.hand) if servo is None else servo
    wrong = Disturbance() if disturbance is None else disturbance
    instance_of("servo", servo, Servo)
    instance_of("disturbance", wrong, Disturbance)
    hand, prescribed = task.hand, mode == "prescribed"
    if prescribed and wrong.start_error is not None:
        raise InvalidInput(
            "start error: expected with servos, joints that move as commanded have none (mode='prescribed')"
        )
    for push in wrong.pushes:
        if push.start + push.duration > hold + 0.5 * dt:
            raise InvalidInput(
                f"hold: expected at least {push.start + push.duration:g} s, the end of a push, got {hold:g} s"
            )

    made = _engine(engine)(task, time_step=dt, servo=servo, mass_factor=wrong.mass_factor)
    law = _law(task, made.parts, wrong.mu)
    steps, let_go = round(duration / dt), round(task.final_time / dt)
    instants = dt * np.arange(min(steps, let_go + 2) + 1)  # from there on the last ones hold
    course, until = CubicHermiteSpline(task.times, task.q, task.dq), np.minimum(instants, task.final_time)
    q_ref, dq_ref = course(until), course(until, 1)
    ddq_ref = np.zeros_like(q_ref)
    torque_ref = np.column_stack([np.interp(instants, task.times, column) for column in task.torques.T])
    held = instants > task.final_time - 0.5 * dt
    dq_ref[held], torque_ref[held] = 0.0, task.holding_torques
    if prescribed:  # as the engines step: what a velocity leads to is the next position
        dq_ref[1:] = np.diff(q_ref, axis=0) / dt
        ddq_ref[:-1], ddq_ref[-1] = np.diff(dq_ref, axis=0) / dt, 0.0

    pose = np.array(task.object.pose)
    pose[:3, 3] += wrong.object_offset
    pose[:3, :3] = pin.exp3(np.array(wrong.object_turn)) @ pose[:3, :3]
    error = 0.0 if wrong.start_error is None else array_of("start error", wrong.start_error, (hand.n,))
    made.place(q_ref[0] + error, dq_ref[0], pose)

    support = _Support(task, pose, wrong.mass_factor, letting_go)
    samples = _Samples(made.parts)
    joint_work = load_work = 0.0
    base = kinetic = last = None
    shaken = bool(np.any(wrong.shake))
    gone = False
    for i in range(steps + 2):  # the last is for what the sample before it lacks
        t = dt * i
        fixed = not release or i < let_go
        now = min(i, len(instants) - 1)
        still = fixed or i == let_go  # it is let go from where it was, at rest
        if still or prescribed:
            made.place(
                q_ref[now] if prescribed else made.q, dq_ref[now] if prescribed else made.dq, pose if still else None
            )
        since = t - task.final_time
        if shaken and not fixed:
            made.set_gravity(task.gravity_o - wrong.shake * np.sin(2 * np.pi * wrong.shake_frequency * since))
        touches = law.counted(made.touches())
        # Velocities are half a step behind positions: energies take the mean of two.
        potential, before = made.potential_energy(), kinetic
        kinetic = made.kinetic_energy()
        if base is None:
            base = potential + kinetic
        if last is not None:
            samples.add(last, 0.5 * (before + kinetic) - base)
            # Of the sample, not of now: the verdict must see that it is gone.
            gone = np.linalg.norm(last[4][:3, 3] - pose[:3, 3]) > GONE
            last = None
            if i > steps or gone:
                break
        pressing = law.press(touches, dt)
        speeds, object_speed = made.dq, made.object_twist
        wrench = np.zeros(6)
        if not fixed:
            wrench = task.load + wrong.wrench(since - letting_go) + support.wrench(since, made, touches, pressing)
        due = i % every == 0 or i in (steps, let_go)
        if due:
            if i == let_go:
                samples.complete = len(samples.rows)
            last = [
                t,
                made.q,
                speeds,
                None,
                made.object_pose,
                touches,
                pressing,
                law.slip.copy(),
                [0.0, 0.0, potential, law.elastic, law.damped, law.slipped, law.normal_work],
            ]
        if prescribed:
            made.step_prescribed(ddq_ref[now], touches, pressing, wrench)
        else:
            made.step(q_ref[now], dq_ref[now], torque_ref[now], touches, pressing, wrench)
        after = dq_ref[min(i + 1, len(instants) - 1)] if prescribed else made.dq
        if not np.abs(after).max(initial=0.0) < _FASTEST or not np.isfinite(made.object_twist).all():
            raise SimulationDiverged(t, dt)
        joint_work += 0.5 * dt * float(made.torques @ speeds)
        load_work += 0.0 if fixed else 0.5 * dt * float(wrench @ object_speed)
        if due:
            last[3], last[-1][:2] = made.torques, (joint_work, load_work)
        joint_work += 0.5 * dt * float(made.torques @ after)
        load_work += 0.0 if fixed else 0.5 * dt * float(wrench @ made.object_twist)
    return _record(task, samples, made, engine, mode, dt, release, wrong, gone, time.perf_counter() - started)


def _engine(name: str):
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


class _Support:
    """What has held the object until t_F: its force and its stiffness fade away together."""

    def __init__(self, task: Task, pose: np.ndarray, mass_factor: float, duration: float):
        self.task, self.pose, self.duration = task, pose, duration
        mass = mass_factor * task.object.mass
        inertia = float(np.linalg.eigvalsh(mass_factor * task.object.inertia_b)[0])
        self.spring = np.repeat([mass, inertia], 3) * _SUPPORT**2
        self.damper = 2 * np.repeat([mass, inertia], 3) * _SUPPORT
        self.weight = np.concatenate([mass * task.gravity_o, np.zeros(3)])
        self.carried = None

    def wrench(self, since: float, made, touches, pressing) -> np.ndarray:
        """On the object (6,) [N, N m], so long after t_F [s]."""
        if since >= self.duration:
            return np.zeros(6)
        pose = made.object_pose
        if self.carried is None:  # at t_F: all that keeps the object where it is
            moments = np.cross(touches.point_o - pose[:3, 3], pressing.force_o) + pressing.moment_o
            self.carried = -(
                np.concatenate([pressing.force_o.sum(axis=0), moments.sum(axis=0)]) + self.weight + self.task.load
            )
        moved = np.concatenate([pose[:3, 3] - self.pose[:3, 3], pin.log3(pose[:3, :3] @ self.pose[:3, :3].T)])
        return (1 - since / self.duration) * (self.carried - self.spring * moved - self.damper * made.object_twist)


class _Samples:
    """What is recorded on the way, by part of the hand."""

    def __init__(self, parts: int):
        self.parts, self.rows, self.complete = parts, [], 0  # the sample at t_F

    def add(self, sample: list, kinetic: float) -> None:
        t, q, dq, torques, pose, touches, pressing, slip, energies = sample
        energies[2] += kinetic
        p = self.parts
        force = np.zeros((p, 3))
        normal = np.bincount(touches.part, weights=pressing.normal, minlength=p)
        depth = np.zeros(p)
        np.add.at(force, touches.part, pressing.force_o)
        across = np.zeros((p, 3))
        np.add.at(across, touches.part, pressing.force_o - pressing.normal[:, None] * touches.normal_o)
        np.maximum.at(depth, touches.part, touches.depth)
        self.rows.append(
            (t, q, dq, torques, pose, force, normal, np.linalg.norm(across, axis=1), depth, slip, energies)
        )

    def columns(self) -> list[np.ndarray]:
        return [np.array(column) for column in zip(*self.rows)]


def _record(task, samples, made, engine, mode, dt, release, wrong, gone, elapsed) -> Simulation:
    times, q, dq, torques, poses, forces, normal, across, depths, slips, energies = samples.columns()
    joints = [task.joint_of(link) for link in task.links]
    planned = np.bincount(joints, weights=task.normal_forces, minlength=made.parts)
    shown = np.flatnonzero((planned > 0) | (normal > 0).any(axis=0))
    labels = tuple(_label(task, int(part), joints) for part in shown)
    names = ("joint_work", "load_work", "mechanical", "elastic", "damped", "slipped", "normal_work")
    values = {name: read_only(column) for name, column in zip(names, energies.T)}
    common = {
        "times": read_only(times),
        "q": read_only(q),
        "torques": read_only(torques),
        "object_poses": read_only(poses),
        "parts": labels,
        "normal_forces": read_only(normal[:, shown]),
        "depths": read_only(depths[:, shown]),
        "slips": read_only(slips[:, shown]),
        "planned_forces": read_only(planned[shown]),
        "energies": values,
    }
    audited = not np.any(wrong.shake)
    released = task.final_time if release else None
    return Simulation(
        verdict=verdict_of(task, joints, shown, released, audited, samples.complete, gone, common),
        engine=engine,
        mode=mode,
        time_step=dt,
        release=released,
        complete=samples.complete,
        dq=read_only(dq),
        forces_o=read_only(forces[:, shown]),
        tangential_forces=read_only(across[:, shown]),
        disturbance=wrong.summary(),
        notes=made.notes,
        elapsed=elapsed,
        exponent=task.law[2],
        **common,
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
