"""A controller in the loop of a simulation: what its sensors tell, and when what it sends comes about."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import array_of, brief, each_of, integer, items_of, number, one_of, share_of
from pinograsp.plan.felt import Command, Controller, Felt, Measured
from pinograsp.simulation.law import ContactForces, Pressing, Touches
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.sample import sum_by_part
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array, cross

QUANTITIES = Felt._fields[1:]  # all but the time
_ROUNDING = 1e-9  # [s] of times that are sums of steps
_SLIPS = 1e-3  # [m/s] slower than that a sensor of slip does not tell


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensors:
    """The sensors of a simulated hand: what they measure, and how well.

    Attributes:
        quantities: measured quantities, of those of :class:`~pinograsp.reflex.Felt`.
        noise: standard deviation of forces, torques and wrenches, as a share of each contact's or joint's own [-].
        offset: constant error of the same quantities [N or N m].
        delay: how long a measurement takes to arrive [s].
        loss: share of the measurements that are lost [-].
        resolution: resolution of normal forces and forces [N]; 0: not rounded.
        period: between ticks [s].
        seed: of noise and losses.
    """

    quantities: tuple[str, ...] = ("forces", "slips", "torques", "joint_positions")
    noise: float = 0.0
    offset: float = 0.0
    delay: float = 0.0
    loss: float = 0.0
    resolution: float = 0.0
    period: float = 1e-3
    seed: int = 0

    __repr__ = brief()

    def __post_init__(self) -> None:
        names = items_of("quantities", self.quantities, str)
        for name in names:
            one_of("quantity", name, QUANTITIES)
        object.__setattr__(self, "quantities", tuple(names))
        for name in ("noise", "offset", "delay", "resolution"):
            object.__setattr__(self, name, number(name, getattr(self, name), at_least=0))
        object.__setattr__(self, "loss", share_of("loss", self.loss))
        object.__setattr__(self, "period", number("period", self.period, above=0, unit="s"))
        object.__setattr__(self, "seed", integer("seed", self.seed, at_least=0))


class ControlLoop:
    """Calls a controller from t_F on, as its sensors tell and its drives follow."""

    def __init__(self, task: Task, controller: Controller, sensors: Sensors, disturbance: Disturbance):
        self.task, self.controller, self.sensors = task, controller, sensors
        if callable(reset := getattr(controller, "reset", None)):  # of what it felt in another simulation
            reset()
        self.delay = each_of("command delay", disturbance.command_delay, task.hand.n)
        self.drive_gain = each_of("drive gain", disturbance.drive_gain, task.hand.n)
        self.latest = float(self.delay.max(initial=0.0))
        self.rng = np.random.default_rng(sensors.seed)
        joints = np.array([task.joint_of(link) for link in task.links])
        # A part's force is told for each of its contacts by the share that each is planned to have.
        self.parts: Array = joints
        whole = np.bincount(joints, weights=task.normal_forces)[joints]
        self.shares: Array = task.normal_forces / np.maximum(whole, 1e-12)
        self.waiting: deque[tuple[float, dict[str, Measured]]] = deque()
        self.sent: deque[tuple[float, Command]] = deque()
        self.slipped: Array | None = None
        self.measured = self.next = task.final_time - self.latest  # the task's commands are delayed already

    def tick(self, time: float, engine: MujocoEngine, law: ContactForces, touches: Touches, pressing: Pressing) -> None:
        """At a step: measure, and call the controller, where it is time for it."""
        if time < self.next - _ROUNDING:
            return
        self.next += self.sensors.period
        if self.rng.random() >= self.sensors.loss:
            self.waiting.append((time, self._measure(time, engine, law, touches, pressing)))
        told = dict[str, Measured]()
        while self.waiting and self.waiting[0][0] <= time - self.sensors.delay + _ROUNDING:
            told = self.waiting.popleft()[1]
        command = self.controller(Felt(time=time, **told))
        torques = array_of("controller: torques", command.torques, (self.task.hand.n,))
        references = command.references
        if references is not None:
            references = array_of("controller: references", references, (self.task.hand.n,))
        self.sent.append((time, Command(torques, references)))

    def command(self, time: float) -> Command | None:
        """What the drives follow at a time [s]; None: the plan still."""
        n, until = self.task.hand.n, time - self.latest + _ROUNDING
        while len(self.sent) > 1 and self.sent[1][0] <= until:
            self.sent.popleft()
        if not self.sent or self.sent[0][0] > until:
            return None
        if np.ptp(self.delay) == 0.0:
            return self.sent[0][1]
        own = [next(c for t, c in reversed(self.sent) if t <= time - self.delay[j] + _ROUNDING) for j in range(n)]
        torques = np.array([command.torques[j] for j, command in enumerate(own)])
        references = [command.references for command in own]
        told = [one[j] for j, one in enumerate(references) if one is not None]
        return Command(torques, np.array(told) if len(told) == n else None)

    def _measure(
        self, time: float, engine: MujocoEngine, law: ContactForces, touches: Touches, pressing: Pressing
    ) -> dict[str, Measured]:
        """What there is to be told of a step."""
        task, parts, told = self.task, self.parts, dict[str, Array]()
        sums = sum_by_part(touches, pressing, engine.parts)
        forces_o = self.shares[:, None] * sums["forces_o"][parts]
        told["forces"] = self._blur(np.einsum("kji,kj->ki", task.rotations_oc, forces_o), norm=True)
        told["normal_forces"] = self._blur(self.shares * sums["normal_forces"][parts])
        since = max(time - self.measured, self.sensors.period)
        speeds = np.zeros(engine.parts) if self.slipped is None else (law.slip - self.slipped) / since
        self.slipped, self.measured = law.slip.copy(), time
        told["slips"] = np.where(speeds > _SLIPS, speeds, 0.0)[parts]
        told["torques"] = self._blur(engine.torques / self.drive_gain)
        told["joint_positions"] = engine.q
        moments = cross(touches.point_o - task.com_o, pressing.force_o) + pressing.moment_o
        told["wrench"] = self._blur(np.concatenate([pressing.force_o.sum(axis=0), moments.sum(axis=0)]))
        told["acceleration"] = task.gravity_o - engine.model.opt.gravity
        return {name: Measured(told[name], time) for name in self.sensors.quantities}

    def _blur(self, values: Array, norm: bool = False) -> Array:
        """Values as a sensor with noise tells them."""
        sensors = self.sensors
        size = np.linalg.norm(values, axis=-1, keepdims=True) if norm else np.abs(values)
        values = values + (sensors.noise * size + sensors.offset) * self.rng.standard_normal(values.shape)
        return values if not sensors.resolution else sensors.resolution * np.round(values / sensors.resolution)
