"""Duration and steps of a simulation, and what the joints are commanded at every step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from pinograsp.checks import each_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.servos import CLOSED, find_pressing
from pinograsp.plan.felt import Command
from pinograsp.simulation.options import COARSEST, SimulationOptions
from pinograsp.simulation.settings import Servo
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array, BoolArray

TANGENTIAL = 2e4  # [N/m] of a contact's tangential spring
_RESOLVED = 0.6  # [rad] at most, of the object's swings on its contacts, in one step
_SHORTER = 20  # times at most, for that; it is enough for grams in steps of a millisecond
_FEWEST_STEPS = 10  # until the grasp is complete
_MOST_STEPS = 2_000_000  # their samples take half a gigabyte


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Schedule:
    """Duration and steps of a simulation.

    Attributes:
        options: how the task is simulated.
        servo: control of the joints, without the error of its gains.
        time_step: that of the options, or a shorter one [s].
        duration: of the simulation [s].
        every: number of steps between samples.
    """

    options: SimulationOptions
    servo: Servo
    time_step: float
    duration: float
    every: int

    @property
    def is_shortened(self) -> bool:
        """Whether the time step is shorter than that of the options."""
        return self.time_step < self.options.time_step

    @property
    def is_prescribed(self) -> bool:
        """Whether joints follow the commands exactly, whatever torque that takes."""
        return self.options.mode == "prescribed"

    @property
    def pressing(self) -> BoolArray | None:
        """Joints (n,) that press with an effort; None: none do."""
        pressing = self.servo.pressing
        if pressing is None or not pressing.any() or self.is_prescribed or self.servo.control != "impedance":
            return None
        return pressing


def choose_servo(task: Task) -> Servo:
    """The servos of a task's hand: as its plan has them while it closes; jaws press with an effort."""
    return replace(Servo.of(task.hand), closing=task.closing_stiffness, pressing=find_pressing(task.hand))


def choose_support(task: Task, options: SimulationOptions) -> SimulationOptions:
    """The options with what supports the object until it is let go."""
    if options.support is not None:
        return options
    return replace(options, support=task.support if options.release else "fixed")


def plan_schedule(task: Task, options: SimulationOptions) -> Schedule:
    """The steps of a task; :class:`InvalidInput` where its times do not fit the options."""
    options = choose_support(task, options)
    disturbance, dt = options.disturbance, options.time_step
    longest = min(COARSEST, task.final_time / _FEWEST_STEPS)
    if dt > longest:
        raise InvalidInput(f"time step: expected at most {longest:g} s, got {dt:g} s")
    after = options.hold + (options.letting_go if options.release else 0.0)
    duration = float(task.times[-1]) + after
    if options.release:
        stiffest = _find_stiffest(task, disturbance.stiffness)
        swinging = float(np.sqrt(len(task.names) * stiffest / task.body.mass))  # [rad/s]
        dt = min(dt, max(dt / _SHORTER, _RESOLVED / swinging))
    if not duration / dt <= _MOST_STEPS:
        raise InvalidInput(
            f"hold, time step: expected at most {_MOST_STEPS} steps, got {duration / dt:.3g} "
            f"({duration:g} s in steps of {dt:g} s): hold for less, or take longer steps"
        )
    motion = disturbance.base_motion
    if motion is not None and motion.times[-1] > task.way + after + 1e-9:
        raise InvalidInput(
            f"hold: expected the base's motion to end within {task.way + after:g} s of t_F (letting go and hold), got "
            f"{motion.times[-1]:g} s: hold for longer"
        )
    for push in disturbance.pushes:
        end = push.start + push.duration
        if end > task.way + options.hold + 0.5 * dt:
            raise InvalidInput(f"hold: expected at least {end:g} s, the end of a push, got {options.hold:g} s")
    every = max(1, round(min(options.sample / dt, _MOST_STEPS)))
    servo = choose_servo(task) if options.servo is None else options.servo
    return Schedule(options=options, servo=servo, time_step=dt, duration=duration, every=every)


def _find_stiffest(task: Task, factor: float) -> float:
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


def _limit_pressing(way: Array, effort: Array) -> Array:
    """What joints that press one way or the other (n,) make at least and at most, by efforts (m, n): (m, 2, n)."""
    return np.stack([np.where(way < 0, -effort, -np.inf), np.where(way > 0, effort, np.inf)], axis=1)


Commands: TypeAlias = tuple[Array, Array, Array, Array | None]


class Course:
    """The commands of the joints at every step; at their end, t_F as a rule, the last one is held.

    Attributes:
        steps: of the simulation.
        complete: the step at which the grasp is complete, t_F.
        free: the first step at which the object can move.
        stiff: the step from which on the joints are held where they are, with servos that were softer before.
        q, dq, ddq, torques: of the joints at each step, up to the last one that differs (m, n).
        limits: the least and the most that servos and torques together make, by step (m, 2, n) [N m or N]; None: no
            joint presses with an effort.
    """

    def __init__(self, task: Task, schedule: Schedule):
        dt, options = schedule.time_step, schedule.options
        self.stiff = round((task.final_time + CLOSED) / dt)
        self.steps, self.complete = round(schedule.duration / dt), round(task.final_time / dt)
        self.free = {"fixed": self.complete, "table": 0, "none": round(task.impact_time / dt)}[str(options.support)]
        end = float(task.times[-1])
        closed = task.final_time + options.letting_go + CLOSED
        last = end if schedule.pressing is None else max(end, closed)
        instants: Array = dt * np.arange(min(self.steps, round(last / dt) + 2) + 1, dtype=float)
        spline, until = CubicHermiteSpline(task.times, task.q, task.dq), np.minimum(instants, end)
        # Servos bring what the encoders read to the plan's positions.
        self.q: Array = spline(until) - each_of("joint offset", options.disturbance.joint_offset, task.hand.n)
        self.dq: Array = spline(until, 1)
        self.ddq: Array = np.zeros_like(self.q)
        torques = np.column_stack([np.interp(instants, task.times, column) for column in task.torques.T])
        resting = instants > end - 0.5 * dt
        self.dq[resting], torques[resting] = 0.0, task.holding_torques
        share = {"torque": options.disturbance.servo_gain, "position": 0.0, "impedance": 1.0}[schedule.servo.control]
        self.share: Array = share * each_of("drive gain", options.disturbance.drive_gain, task.hand.n)
        self.torques: Array = self.share * torques
        if schedule.is_prescribed:  # the engine integrates a step's velocity to the next position
            self.dq[1:] = np.diff(self.q, axis=0) / dt
            self.ddq[:-1], self.ddq[-1] = np.diff(self.dq, axis=0) / dt, 0.0
        self.way: Array = np.zeros(task.hand.n)  # in which joints press with an effort
        self.limits = None if schedule.pressing is None else self._press_on(task, schedule.pressing, instants, closed)

    def _press_on(self, task: Task, pressing: BoolArray, instants: Array, until: float) -> Array:
        """Let joints close on from t_I, as fast as they are then; returns limits, the efforts of the plan."""
        longest = until - task.impact_time
        ahead = np.clip(instants - task.impact_time, 0.0, longest)[:, None]
        impact = int(np.searchsorted(task.times, task.impact_time))
        squeezed = task.q[int(np.searchsorted(task.times, task.final_time - 1e-9))] - task.q[impact]
        way = np.where(pressing, np.sign(squeezed), 0.0)
        speed = way * np.abs(task.dq[impact])
        self.q += ahead * speed
        self.dq += ((ahead > 0.0) & (ahead < longest)) * speed
        self.way = way
        effort, early = way * self.torques, instants < task.impact_time
        # What is in the way of a jaw before is pressed no harder than in the end.
        effort[early] = np.maximum(effort[early], effort[min(self.complete, len(effort) - 1)])
        return _limit_pressing(way, effort)

    def row_commands(self, row: int) -> Commands:
        """Positions, velocities, torques and limits (2, n) at a row."""
        return self.q[row], self.dq[row], self.torques[row], None if self.limits is None else self.limits[row]

    def follow(self, row: int, command: Command, moved: Array) -> Commands:
        """The same where a controller sends a command; ``moved``: where servos are held, from their references (n,)."""
        q, dq, _, limits = self.row_commands(row)
        torques = self.share * command.torques
        if limits is not None:
            limits = _limit_pressing(self.way, np.maximum(self.way * torques, 0.0)[None])[0]
        if command.references is not None:
            free = self.way == 0.0
            q, dq = np.where(free, command.references - moved, q), np.where(free, 0.0, dq)
        return q, dq, torques, limits

    def row(self, step: int) -> int:
        """The row of a step."""
        return min(step, len(self.q) - 1)
