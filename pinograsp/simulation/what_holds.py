"""What would have held an object that was lost: the simulation again, with one change at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pinograsp.checks import brief, instance_of, number
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanMargins, PlanRecord
from pinograsp.simulation.options import SimulationOptions, StudySettings
from pinograsp.simulation.schedule import choose_servo
from pinograsp.simulation.settings import BaseMotion, Disturbance, Servo
from pinograsp.simulation.simulate import simulate_task
from pinograsp.simulation.task import Task
from pinograsp.simulation.thresholds import Threshold, bracket
from pinograsp.simulation.trials import prepare_trials, run_trial
from pinograsp.storage import read_run

if TYPE_CHECKING:
    from typing_extensions import Unpack

_FRICTION, _SQUEEZE = [2.0, 4.0, 8.0], [2.0, 4.0, 8.0, 16.0]  # factors tried until one holds
_SOFTER = 4.0  # times softer and stiffer servos


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhatHolds:
    """What would have held a lost object, each change alone.

    Attributes:
        changes: changes in words, and whether the object was held: each difference from the plan undone, other drives.
        friction: least factor on the friction coefficients that held, see :class:`Threshold` [-].
        squeeze: least factor on the squeeze that held [-].
        mu: largest friction coefficient of the simulation that was lost [-].
        weak: joints for which the least squeeze that held would exceed the torque limits.
        margins: the plan's own; None: it has none.
    """

    changes: tuple[tuple[str, bool], ...]
    friction: Threshold
    squeeze: Threshold
    mu: float
    weak: tuple[str, ...]
    margins: PlanMargins | None

    __repr__ = brief("changes", "mu", "weak")

    def __str__(self) -> str:
        return self.describe()

    def summary(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "changes": dict(self.changes),
            "friction_factor": self.friction.summary(),
            "squeeze_factor": self.squeeze.summary(),
            "beyond_torque_limits": list(self.weak),
        }

    def describe(self) -> str:
        """As readable text."""
        lines = ["what would have held, each change alone:"]
        lines += [f"  {what}: {'held' if held else 'lost'}" for what, held in self.changes]
        friction, squeeze = self.friction, self.squeeze
        if friction.held is None:
            lines.append(f"  more friction: lost, with mu = {friction.tried[-1][0] * self.mu:.3g}, too")
        else:
            mu, too_little = self.mu * friction.held, self.mu * cast(float, friction.lost)
            lines.append(f"  {friction.held:.2f} times the friction, mu = {mu:.3g}: held (mu = {too_little:.3g}: lost)")
        if squeeze.held is None:
            lines.append(f"  more squeeze: lost, with {squeeze.tried[-1][0]:g} times as much, too")
        else:
            beyond = f", beyond the torque limits of {', '.join(self.weak)}" if self.weak else ""
            lines.append(
                f"  {squeeze.held:.2f} times the squeeze ({squeeze.lost:.2f} times: lost), as with a friction safety "
                f"factor larger by as much: held{beyond}"
            )
        if self.margins is not None:
            least, most = float(self.margins.least_mu.max()), self.margins.load_factor
            load = f"up to {most:.3g} times its load" if np.isfinite(most) else "any multiple of its load"
            lines.append(f"  the plan's own margins: it holds with mu from {least:.3g} on, and {load}")
        return "\n".join(lines)


def what_holds(
    plan: PlanRecord | Task | str | Path,
    *,
    disturbance: Disturbance | None = None,
    tolerance: float = 0.05,
    **settings: Unpack[StudySettings],
) -> WhatHolds:
    """Simulate a plan that is lost again, with one change at a time, some 10 to 25 times.

    It undoes each difference from the plan, removes the torque limits of motors that reached them, adds servos to
    joints under torque control, and makes servos four times softer, four times stiffer, and adds the plan's torques as
    feed-forward. Then it searches by bisection for the least friction and the least squeeze. A grasp that squeezes s
    times as hard is simulated by dividing all loads of the object by s, its weight included: by Coulomb's law, with
    rigid contacts, the one holds if the other does. With errors that do not grow with the squeeze, such as those of the
    encoders, this is on the safe side. Torque limits are compared with s times the holding torques.

    Args:
        plan: as for :func:`~pinograsp.simulation.simulate`.
        disturbance: differences from the plan.
        tolerance: of the least friction and squeeze, relative [-].
        **settings: of :func:`~pinograsp.simulation.simulate`.

    Raises:
        InvalidInput: unusable settings, or a plan that holds.
        SimulationDiverged: the plan's own simulation diverges.
    """
    tolerance = number("tolerance", tolerance, above=0)
    base = Disturbance() if disturbance is None else instance_of("disturbance", disturbance, Disturbance)
    record = cast(PlanRecord, read_run(plan)) if isinstance(plan, str | Path) else plan
    task, options = prepare_trials(record, settings)
    verdict = simulate_task(task, replace(options, disturbance=base)).verdict
    if verdict.held:
        raise InvalidInput("what_holds: expected a plan that is lost, got one that holds with this disturbance")

    def holds(task: Task = task, disturbance: Disturbance = base, servo: Servo | None = options.servo) -> bool:
        return run_trial((task, replace(options, servo=servo)), disturbance).held

    changes = [
        *((f"without {name}", holds(disturbance=undone)) for name, undone in _undo_each(base)),
        *((what, holds(servo=servo)) for what, servo in _other_drives(task, options)),
    ]
    if any("torque limit" in cause for cause in verdict.causes):
        without = replace(task, torque_limit=np.full(task.hand.n, np.inf))
        changes.append(("without torque limits", holds(without)))

    def holds_with_friction(factor: float) -> bool:
        mu = None if base.mu is None else factor * base.mu
        return holds(replace(task, mu=factor * task.mu), replace(base, mu=mu))

    friction = _find_least(holds_with_friction, _FRICTION if task.mu.any() else [], tolerance)
    squeeze = _find_least(lambda factor: holds(*_relieve(task, base, factor)), _SQUEEZE, tolerance)
    needed = np.abs(task.holding_torques) * (squeeze.held or 1.0) > task.torque_limit
    return WhatHolds(
        changes=tuple(changes),
        friction=friction,
        squeeze=squeeze,
        mu=float(task.mu.max()) if base.mu is None else base.mu,
        weak=tuple(name for name, beyond in zip(task.hand.joint_names, needed) if beyond),
        margins=record.margins if isinstance(record, PlanRecord) else None,
    )


def _undo_each(disturbance: Disturbance) -> Iterator[tuple[str, Disturbance]]:
    """Each difference from the plan by name, and the disturbance without it."""
    plain = Disturbance()
    for field in fields(Disturbance):
        name, usual = field.name, getattr(plain, field.name)
        given = getattr(disturbance, name)
        differs = given is not None if usual is None else given != () if name == "pushes" else np.any(given != usual)
        if differs and name != "shake_frequency":
            yield name, replace(disturbance, **{name: usual})


def _other_drives(task: Task, options: SimulationOptions) -> Iterator[tuple[str, Servo]]:
    """Other drives, in words."""
    servo = options.servo
    if options.mode == "prescribed" or servo is None:
        return
    if servo.control == "torque":
        yield "the default servos besides the torques, control='impedance'", choose_servo(task)
    else:
        if servo.control == "position":
            yield (
                "the plan's torques as feed-forward, control='impedance'",
                replace(servo, control="impedance"),
            )
        yield f"servos {_SOFTER:g} times softer, kp", servo.scale_gains(1 / _SOFTER)
        yield f"servos {_SOFTER:g} times stiffer, kp", servo.scale_gains(_SOFTER)


def _relieve(task: Task, disturbance: Disturbance, factor: float) -> tuple[Task, Disturbance]:
    """The same grasp of an object on which all loads are that many times smaller, its inertia the same."""
    weight = disturbance.mass_factor * task.body.mass * task.gravity_o
    load = task.load / factor
    load[:3] -= (1 - 1 / factor) * weight
    motion = disturbance.base_motion
    if motion is not None:
        motion = BaseMotion(times=motion.times, accelerations=motion.accelerations / factor)
    pushes = tuple(replace(push, wrench_o=push.wrench_o / factor) for push in disturbance.pushes)
    lighter = replace(disturbance, pushes=pushes, shake=disturbance.shake / factor, base_motion=motion)
    return replace(task, load=load), lighter


def _find_least(holds: Callable[[float], bool], factors: list[float], tolerance: float) -> Threshold:
    """The least factor that holds, where 1 is known to lose."""

    def hold(values: list[float]) -> list[bool]:
        return [value != 1.0 and holds(value) for value in values]

    found = bracket(hold, 1.0, [], factors, tolerance, 1)
    return Threshold(lost=found.lost, held=found.held, tried=tuple(found.tried))
