"""A MuJoCo model's actuators, asked for their forces: what they need so that a hand follows a trajectory.

MuJoCo itself says what the model needs: its inverse dynamics, with springs, dampers, dry friction, fluid and
compensated weight, and what each actuator makes of its control and its activation, whatever its type. So no list of
types is kept here. In the end MuJoCo says what the controls make.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from pinograsp.handover.samples import JointSamples
from pinograsp.spatial import Array, BoolArray, IntArray

SLACK = 1e-6  # beyond a range, in its unit
_FAINT = 1e-6  # weight of the forces' own squares beside what they make
_NUDGE = 1e-3  # of a control: how an activation answers; within the range of muscles, whose answer up and down differs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """A trajectory in a model's own coordinates.

    Attributes:
        qpos, qvel, qacc: (m, nq), (m, nv), (m, nv).
        leads: velocities of the model by those of the trajectory's joints (nv, n).
        place: the model's joints by name, coupled ones included.
    """

    qpos: Array
    qvel: Array
    qacc: Array
    leads: Array
    place: dict[str, int]


@dataclass(slots=True, kw_only=True, eq=False)
class Played:
    """What was found for a path.

    Attributes:
        ctrl, act: controls (m, nu), activations (m, na).
        used: actuators that move the hand (nactuator,).
        idle: actuators without an effect of their control at some sample (nactuator,).
        moved: joints of the trajectory that some actuator moves (n,).
        bound: actuators that are at their limits where the efforts differ (nactuator,).
        largest: of the efforts needed [N m or N].
        off: largest effort that the actuators make too much or too little: its size, joint, acceleration, and sample.
    """

    ctrl: Array
    act: Array
    used: BoolArray
    idle: BoolArray
    moved: BoolArray
    bound: BoolArray
    largest: float = 0.0
    off: tuple[float, int, float, int] = (0.0, 0, 0.0, 0)


class Actuators:
    """A model's actuators, asked for their forces. Contacts, limits and equalities do not act: couplings are exact.

    Forces are taken to be affine in the control or, without an effect of it, in the (last) activation; whatever is not
    shows in the comparison with the model itself.
    """

    def __init__(self, model: Any):
        off, on = mujoco.mjtDisableBit, mujoco.mjtEnableBit
        self.model, self.free = copy.copy(model), copy.copy(model)  # the second one without any bounds
        for one in (self.model, self.free):
            one.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT) | int(off.mjDSBL_EQUALITY)
            one.opt.enableflags &= ~(int(on.mjENBL_INVDISCRETE) | int(on.mjENBL_SLEEP))
            one.actuator_actearly[:], one.actuator_history[:, 0] = False, 0
        self.free.opt.disableflags |= int(off.mjDSBL_CLAMPCTRL)
        for bounded in ("actuator_forcelimited", "tendon_actfrclimited", "jnt_actfrclimited"):
            getattr(self.free, bounded)[:] = False
        self.data = mujoco.MjData(model)
        # Those of one force, which is not adhesion's, and where their control and their (last) activation are.
        self.force: IntArray = np.array(model.actuator_outadr, dtype=int)
        self.sole: BoolArray = (model.actuator_outnum == 1) & (model.actuator_trntype != mujoco.mjtTrn.mjTRN_BODY)
        self.input: IntArray = np.array(model.actuator_ctrladr, dtype=int)
        self.stateful: BoolArray = np.array(model.actuator_actnum) > 0
        self.state: IntArray = (model.actuator_actadr + model.actuator_actnum - 1)[self.stateful]
        limited = np.array(model.actuator_actlimited, dtype=bool)[:, None]
        self.range: Array = np.where(limited, model.actuator_actrange, [-np.inf, np.inf])
        self.range[model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE] = 0.0, 1.0

    def play(self, path: Path, own: JointSamples, feed_forward: bool) -> Played:
        """Controls and activations along a path, and what the model makes of them."""
        (m, n), count = own.q.shape, self.model.nactuator
        values, states = np.zeros((m, count)), np.zeros((m, count))  # control, activation of each actuator
        answers = np.zeros((m, 3, count))  # rates of the activations at a control less, equal, and more
        ahead: BoolArray = np.zeros(count, dtype=bool)  # driven by their activations alone
        played = Played(
            ctrl=np.zeros((m, self.model.nu)),
            act=np.zeros((m, self.model.na)),
            used=np.zeros(count, dtype=bool),
            idle=np.zeros(count, dtype=bool),
            moved=np.zeros(n, dtype=bool),
            bound=np.zeros(count, dtype=bool),
        )
        steps = np.diff(own.times, append=own.times[-1] + 1.0)[:, None]
        for i in range(m):
            needed, moments, constant = self._demand(path, own, i)
            target = needed - constant @ path.leads if feed_forward else np.zeros(n)
            bias, by_control, by_state = self._laws()
            ahead = self.stateful & (by_control == 0)
            gain = np.where(by_control != 0, by_control, by_state)
            usable = self.sole & (gain != 0)
            pulls = np.where(usable[:, None], (moments @ path.leads)[self.force], 0.0)
            rest = bias + np.where(ahead, 0.0, by_state * states[i])
            bounds = self._bounds(ahead, rest, gain)
            forces = _shares(pulls, target, bounds)
            value = np.where(usable, (forces - rest) / np.where(usable, gain, 1.0), 0.0)
            states[i] = np.where(ahead, np.clip(value, *self.range.T), states[i])
            values[i] = np.where(ahead, 0.0, value)
            if self.stateful.any():
                answers[i] = self._rates(np.where(ahead, states[i], values[i]), states[i])
                if i + 1 < m:
                    states[i + 1] = np.clip(states[i] + steps[i] * answers[i, 1], *self.range.T)
            played.used |= pulls.any(axis=1)
            played.idle |= ~usable
            played.moved |= pulls.any(axis=0)
            played.largest = max(played.largest, float(np.abs(needed).max(initial=0.0)))
            if self._compare(path, i, needed, values[i], states[i], played):
                played.bound |= pulls.any(axis=1) & ((forces <= bounds[0] + SLACK) | (forces >= bounds[1] - SLACK))
        rates = np.diff(states, axis=0, append=states[-1:]) / steps - answers[:, 1]
        slope = np.where(rates > 0, answers[:, 2] - answers[:, 1], answers[:, 1] - answers[:, 0]) / _NUDGE
        played.idle |= ahead & ((slope == 0) & (rates != 0)).any(axis=0)
        values += np.where(ahead, states + rates / np.where(slope == 0, 1.0, slope), 0.0)
        played.ctrl[:, self.input] = np.where(played.idle & ahead, 0.0, values)
        played.act[:, self.state] = states[:, self.stateful]
        return played

    def _demand(self, path: Path, own: JointSamples, i: int) -> tuple[Array, Array, Array]:
        """Efforts of the trajectory's joints at a sample (n,), the actuators' moments (nout, nv), and what they make
        without any force of theirs, such as compensated weight (nv,).
        """
        free, data, leads = self.free, self.data, path.leads
        data.qpos[:], data.qvel[:], data.qacc[:] = path.qpos[i], path.qvel[i], path.qacc[i]
        data.ctrl[:], data.act[:] = 0.0, 0.0
        mujoco.mj_inverse(free, data)
        if own.contact_effort is None:  # the model's own masses are then taken for the hand's
            moving = np.zeros(free.nv)
            mujoco.mj_mulM(free, data, moving, data.qacc)
            pressing = own.effort[i] - (moving + data.qfrc_bias) @ leads
        else:
            pressing = own.contact_effort[i]
        needed = data.qfrc_inverse @ leads + pressing
        moments = np.zeros((free.nout, free.nv))
        mujoco.mju_sparse2dense(
            moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        mujoco.mj_fwdActuation(free, data)
        return needed, moments, data.qfrc_actuator - data.actuator_force @ moments

    def _forces(self, model: Any, values: Array, states: Array) -> Array:
        """Of the actuators (nactuator,) by their controls and activations (nactuator,) at the present state."""
        self.data.ctrl[self.input], self.data.act[self.state] = values, states[self.stateful]
        mujoco.mj_fwdActuation(model, self.data)
        forces: Array = self.data.actuator_force[self.force]
        return forces

    def _bounds(self, ahead: BoolArray, rest: Array, gain: Array) -> tuple[Array, Array]:
        """Least and largest forces of the actuators (nactuator,): by their controls or activations, and themselves."""
        model, unbounded = self.model, [-np.inf, np.inf]
        clamped = model.actuator_ctrllimited[self.input] & ~(
            model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        )
        by_control = np.where(clamped[:, None], model.actuator_ctrlrange[self.input], unbounded)
        ends = np.where(gain[:, None] == 0, 0.0, np.where(ahead[:, None], self.range, by_control))
        reached = np.sort(rest[:, None] + gain[:, None] * ends, axis=1)
        limited = np.array(model.actuator_forcelimited, dtype=bool)[:, None]
        own = np.where(limited, model.actuator_forcerange, unbounded)
        return np.maximum(reached[:, 0], own[:, 0]), np.minimum(reached[:, 1], own[:, 1])

    def _laws(self) -> tuple[Array, Array, Array]:
        """Forces without control and activation, and what one unit of either adds (nactuator,) each."""
        none, one = np.zeros(self.model.nactuator), np.ones(self.model.nactuator)
        bias = self._forces(self.free, none, none)
        by_state = self._forces(self.free, none, one) - bias if self.stateful.any() else none
        return bias, self._forces(self.free, one, none) - bias, by_state

    def _rates(self, values: Array, states: Array) -> Array:
        """Of the activations (3, nactuator) [1/s] at controls a bit less, equal, and more."""
        rates = np.zeros((3, values.size))
        for row, nudge in enumerate((-_NUDGE, 0.0, _NUDGE)):
            self._forces(self.free, values + nudge, states)
            rates[row, self.stateful] = self.data.act_dot[self.state]
        return rates

    def _compare(self, path: Path, i: int, needed: Array, values: Array, states: Array, played: Played) -> bool:
        """Compare the efforts of the model itself, with its bounds, with those needed; whether they differ."""
        self._forces(self.model, values, states)
        wrong = self.data.qfrc_actuator @ path.leads - needed
        worst = int(np.abs(wrong).argmax())
        if abs(wrong[worst]) <= 1e-9 * max(played.largest, 1.0):
            return False
        mass = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, mass)
        acceleration = np.abs(np.linalg.solve(path.leads.T @ mass @ path.leads, wrong)).max()
        if abs(wrong[worst]) > played.off[0]:
            played.off = (float(abs(wrong[worst])), worst, float(acceleration), i)
        return True


def _shares(pulls: Array, target: Array, bounds: tuple[Array, Array]) -> Array:
    """Forces (nactuator,) that make the efforts ``target`` (n,) by their moments (nactuator, n): of those within their
    bounds that come nearest, the ones of least squares.
    """
    forces: Array = target @ np.linalg.pinv(pulls) if pulls.size else np.zeros(len(pulls))
    pulling = pulls.any(axis=1)
    low, high = (bound[pulling] for bound in bounds)
    if np.all((forces[pulling] >= low - SLACK) & (forces[pulling] <= high + SLACK)):
        return forces
    rows = np.vstack([pulls[pulling].T, _FAINT * np.abs(pulls).max() * np.eye(int(pulling.sum()))])
    wanted = np.concatenate([target, np.zeros(int(pulling.sum()))])
    forces[pulling] = lsq_linear(rows, wanted, (low, np.maximum(high, low + SLACK)), method="bvls").x
    return forces
