"""Grasp phase of a closed hand: the surfaces of its links, not the points that touched first, go in as planned.

At a few depths on the way the joints, and the shift of the object as it is let go, are solved for together, so that
every surface is as deep as planned; between them the joints follow a curve over the depth. The object shifts because
joints cannot press to all depths by themselves, and because friction has built up; the latter is worked out at the end,
and made up for in a few rounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.linalg import lapack

from pinograsp.checks import frozen, instance_of
from pinograsp.contacts import PALM, ContactSet, PenetrationProfile
from pinograsp.contacts.penetration import Penetration
from pinograsp.forces import ForceSolution
from pinograsp.hands import Finger, HandModel, servo_gains
from pinograsp.motion.approach import JointPath
from pinograsp.motion.contact_ik import ContactPostures
from pinograsp.motion.contact_springs import Servos, object_motion
from pinograsp.motion.grasp_ik import FingerMotion, points_along
from pinograsp.motion.jacobian import point_jacobians
from pinograsp.motion.letting_go import LetGo, friction_built_up, let_go
from pinograsp.spatial import Array

# Contact points must follow their path to this [m]; a thousandth of a typical penetration.
TRACKED = 1e-6
# Those of closed fingers to this share of their depth, which is 1.5 % of their force.
_SHARE = 0.01
_WELL = 2e-4  # share of their depth to which surfaces are brought
_KNOTS = 5  # depths at which the joints are solved for: their course over the depth is smooth
_ROUNDS, _HALVINGS = 15, 3
# The share of the forces that is well. Rounds by other depths, what one has to gain of what is left, how many may gain
# less, and how much longer a step may be than the one before; and rounds by another shift of the object, what one has
# to gain, the furthest that it moves the object, in shifts that cost 1, and how much shorter the next one is where it
# led astray.
_AS_PLANNED = 0.01
_DEPTHS, _DEPTH_GAIN, _ASTRAY, _LONGER = 6, 0.1, 2, 2.0
_SHIFTS, _SHIFT_GAIN, _FURTHEST, _SHORTER = 2, 0.5, 10.0, 3.0
_AT_LIMIT = 1e-9  # [rad or m]
_ROUNDED = 0.1  # share of its depth that a contact keeps where others need less of it
# What the joints' freedom is used for: contacts that slide by 1 mm cost as much as joints that turn by 1 rad (or slide
# by 30 mm), and as an object that shifts by 0.1 mm. Depths come first: they are off by 0.1 um at that cost.
_SLIDING, _SHIFTING, _DEPTH, _STROKE = 1e-3, 1e-4, 1e-7, 0.03
_STIFF = 0.03  # share of the stiffness below which friction is taken for none


class ClosedPress(NamedTuple):
    """How a closed hand's joints, and the object as it is let go, move while its k contacts go in.

    Attributes:
        course: share of the final depth (c,) [-].
        q: postures there (c, n) [rad or m].
        shift: of the object (c, 6): twist about its centre of mass, linear first [m, rad].
        depths: of the surfaces (c, k) [m].
        missing: depths less than planned, once the object has shifted (c, k) [m].
        limited: indices of the joints that were stopped by their limits.
        rest: the contacts after the object is let go.
        on_the_way: how they are pressed (c,).
    """

    course: Array
    q: Array
    shift: Array
    depths: Array
    missing: Array
    limited: frozenset[int]
    rest: LetGo
    on_the_way: tuple[_Pressed, ...]

    def off(self, planned: Array) -> float:
        """The largest error of a normal force at rest, as a share of those ``planned`` (k,) [N]."""
        return float(np.abs(self.rest.normal / planned - 1.0).max())


def press_closed(
    hand: HandModel, solution: ForceSolution, posture: Array, gains: Array | None = None, *, corrected: bool = True
) -> ClosedPress:
    """Joint positions at which the surfaces of a closed hand are as deep as planned, once the object has shifted.

    Args:
        hand: the hand.
        solution: forces of k contacts; where it is not known what is held, the points that touched first go in.
        posture: of the closed hand (n,) [rad or m].
        gains: of the servos that follow the joint positions, sent the torques of the planned forces besides (n,)
            [N m/rad or N/m]; None: joints do not give way.
        corrected: whether other depths are pressed to where friction and servos leave other forces at rest.
    """
    solver, final = _Solver(hand, solution, posture, gains), solution.profile.final_depth
    planned = solution.problem.compliance.normal_force(final)
    best = _press(solver, final, np.zeros(6))
    if not (corrected and best.rest.balanced):
        best = _shifted(solver, final, planned, best)
    return _corrected(solver, final, planned, best) if corrected else best


def normal_at_rest(hand: HandModel, solution: ForceSolution) -> Array | None:
    """Normal forces (k,) [N] that a closed hand leaves of a solution once the object is let go, with the hand's own
    servos; None where that is not foreseen.
    """
    instance_of("hand", hand, HandModel)
    posture = instance_of("solution", solution, ForceSolution).problem.contacts.posture
    if posture is None:
        return None
    rest = press_closed(hand, solution, posture, servo_gains(hand)).rest
    return rest.normal if rest.balanced else None


def _shifted(solver: _Solver, final: Array, planned: Array, best: ClosedPress) -> ClosedPress:
    """A press that has the object shift as friction makes it: forces at rest are nearer the ``planned`` (k,) [N]."""
    off, share = best.off(planned), 1.0
    for _ in range(_SHIFTS):
        if off < _AS_PLANNED:
            break
        # Newton's step to joints that make the object shift as they assume: what they press deeper for it, the
        # normals alone would give back; friction keeps the rest.
        rest, shift, units = best.rest, best.shift[-1], 1.0 / solver.shift_costs
        grip = units[:, None] * (rest.gripping + _STIFF * rest.stiffness) * units
        step = units * np.linalg.lstsq(grip, units * (rest.stiffness @ (rest.shift - shift)), rcond=1e-9)[0]
        share *= min(1.0, _FURTHEST / max(float(np.linalg.norm(share * step / units)), 1e-300))
        tried = _press(solver, final, shift + share * step, best)
        if tried.off(planned) < off:
            gained, best, off, share = off - tried.off(planned), tried, tried.off(planned), 1.0
            if gained < _SHIFT_GAIN * off:
                break
        else:
            share /= _SHORTER
    return best


def _corrected(solver: _Solver, final: Array, planned: Array, best: ClosedPress) -> ClosedPress:
    """A press to other depths than ``final`` (k,) [m], with forces at rest that are nearer the ``planned`` (k,) [N]."""
    law, towards, depths, astray = solver.problem.compliance, best.shift[-1], final, 0
    reached, off = max(TRACKED, float(np.abs(best.missing).max())), best.off(planned)
    lacking, seen, longest = final - law.depth(best.rest.normal), list[tuple[Array, Array]](), np.inf
    for _ in range(_DEPTHS):
        if off < _AS_PLANNED or not best.rest.balanced:
            break
        step = np.asarray(np.linalg.lstsq(_as_seen(best.rest.response, seen), lacking, rcond=_STIFF)[0], dtype=float)
        step *= min(1.0, longest / max(float(np.linalg.norm(step)), 1e-300))
        tried_depths = np.maximum(depths + step, _ROUNDED * final)
        tried = _press(solver, tried_depths, towards, best)
        step, left, gained = tried_depths - depths, final - law.depth(tried.rest.normal), 0.0
        seen.append((step, lacking - left))
        longest = _LONGER * float(np.linalg.norm(step))
        if tried.rest.balanced and tried.off(planned) < off and np.abs(tried.missing).max() <= reached:
            gained, best, depths, lacking = off - tried.off(planned), tried, tried_depths, left
            off -= gained
        astray += gained < _DEPTH_GAIN * off
        if astray == _ASTRAY:
            break
    return best


def _as_seen(response: Array, seen: Sequence[tuple[Array, Array]]) -> Array:
    """A ``response`` (k, k) changed so that steps (k,) give what was ``seen`` of them, the last ones best.

    Friction changes it more than it tells (C. G. Broyden, Mathematics of Computation 19(92), 1965).
    """
    for step, gain in seen:
        response = response + np.outer(gain - response @ step, step / max(float(step @ step), 1e-300))
    return response


def _press(solver: _Solver, final: Array, towards: Array, since: ClosedPress | None = None) -> ClosedPress:
    """To the depths ``final`` (k,) [m], with an object that shifts ``towards`` (6,) or near to it.

    ``since``: a press that was much the same.
    """
    course = np.linspace(0.0, 1.0, _KNOTS)
    q, shift = np.tile(solver.posture, (_KNOTS, 1)), np.zeros((_KNOTS, 6))
    depths, missing = np.zeros((_KNOTS, len(final))), np.zeros((_KNOTS, len(final)))
    slid = np.zeros((_KNOTS, len(final), 4))
    limited: set[int] = set()
    now = solver.start
    on_the_way = [now]
    for i in range(1, _KNOTS):
        before, wanted, shifted = _Before(q[i - 1], slid[i - 1], now), course[i] * final, course[i] * towards
        if since is None:  # on from where the last steps led
            ahead = np.clip(2 * q[i - 1] - q[i - 2] if i > 1 else q[0], solver.lower, solver.upper)
            near, gone = now, shift[i - 1] * course[i] / course[i - 1] if i > 1 else shifted
        else:
            near = since.on_the_way[i]
            ahead, gone, _ = solver.step(since.q[i], since.shift[i], near, wanted, shifted, before)
        q[i], shift[i], now, stopped = solver.solve(ahead, gone, wanted, shifted, before, near)
        slid[i], depths[i] = before.slid_at(q[i], now.across), now.depth
        missing[i] = wanted + solver.shifts @ shift[i] - now.depth
        limited |= stopped
        on_the_way.append(now)
    servos = solver.servos(on_the_way, course)
    pressed = friction_built_up(solver.problem, depths, slid, servos)
    rest = let_go(solver.problem, depths[-1], pressed, None if servos is None else servos[-1], solver.motion)
    return ClosedPress(course, q, shift, depths, missing, frozenset(limited), rest, tuple(on_the_way))


class _Pressed(NamedTuple):
    """k contacts at a posture.

    Attributes:
        depth: of the surfaces (k,) [m].
        normals: into the object, where the surfaces are deepest (k, 3).
        deepening: how joints change the depths (k, n) [m/rad or m/m].
        across: how they move the links where they touch the object's surface, across the normals, and turn them about
            these (k, 4, n).
    """

    depth: Array
    normals: Array
    deepening: Array
    across: Array


class _Before(NamedTuple):
    """Where links came from: posture (n,), how far they had slid and turned (k, 4), and how they pressed."""

    q: Array
    slid: Array
    pressed: _Pressed

    def slid_at(self, q: Array, across: Array) -> Array:
        """How far links have slid and turned (k, 4) [m, rad] at the posture ``q`` (n,), moved by ``across``."""
        slid: Array = self.slid + 0.5 * ((self.pressed.across + across) @ (q - self.q))
        return slid


class _Solver:
    """Depths of a closed hand's contacts as functions of its joints and of the object's shift, and their solution."""

    def __init__(self, hand: HandModel, solution: ForceSolution, posture: Array, gains: Array | None):
        self.hand, self.problem, self.posture, self.gains = hand, solution.problem, np.array(posture), gains
        contacts, body = self.problem.contacts, self.problem.object
        self.data = hand.model.createData()
        self.surfaces = None if body is None or contacts.posture is None else Penetration(hand, body, contacts)
        self.normals = np.array([contact.normal_o for contact in contacts])
        self.origins = np.array([contact.point_o for contact in contacts])
        self.joints = [0 if c.finger == PALM else hand.finger(c.finger).joint_of(c.link) for c in contacts]
        pin.forwardKinematics(hand.model, self.data, self.posture)
        self.points_l = [self.data.oMi[j].actInv(p) for j, p in zip(self.joints, self.origins)]
        arms = self.origins - contacts.com_o
        self.shifts = np.column_stack([self.normals, np.cross(arms, self.normals)])
        # Rigid motions of the object by the displacements of its contacts that they cause.
        arm = max(1e-3, float(np.sqrt((arms**2).sum(axis=1).mean())))
        self.motion = object_motion(self.problem)
        self.joint_costs = np.where(hand.slides, 1.0 / _STROKE, 1.0)
        self.shift_costs = np.repeat([1.0, arm], 3) / _SHIFTING
        # Joints of no finger, of a wrist, stay.
        self.planned = solution
        self.moving = np.zeros(hand.n, dtype=bool)
        self.moving[np.concatenate([finger.dofs for finger in hand.fingers])] = True
        self.lower, self.upper = np.minimum(hand.lower, posture), np.maximum(hand.upper, posture)
        self.rows = self._costs()
        self.start = self.at(self.posture)

    def at(self, q: Array, near: _Pressed | None = None) -> _Pressed:
        """How deep the contacts are, and how joints move them; ``near``: at a posture that is not far."""
        model = self.hand.model
        pin.computeJointJacobians(model, self.data, q)
        if self.surfaces is None:
            material = np.array([self.data.oMi[j].act(p) for j, p in zip(self.joints, self.points_l)])
            depth, normals = ((material - self.origins) * self.normals).sum(axis=1), self.normals
            on_object = material - depth[:, None] * normals
        else:
            depth, normals, on_object = self.surfaces.at(q, near=None if near is None else (near.normals, near.depth))
        J = point_jacobians(model, self.data, self.joints, on_object)  # the depth's are the same all along the normal
        along = (normals[:, None, None] @ J.reshape(len(depth), 2, 3, model.nv))[:, :, 0]
        deepening = along[:, 0]
        J[:, :3] -= normals[:, :, None] * deepening[:, None]
        across = np.concatenate([J[:, :3], along[:, 1:]], axis=1)
        return _Pressed(depth, normals, deepening, across)

    def _pressing(self, course: Array) -> Array:
        """Share of the final normal forces (c,) where depths are so far on their ``course`` (c,) to the final ones."""
        law, final = self.problem.compliance, self.planned.profile.final_depth
        pressed = law.force(course[:, None] * final).sum(axis=1)
        share: Array = pressed / law.force(final).sum()
        return share

    def servos(self, on_the_way: Sequence[_Pressed], course: Array) -> tuple[Servos, ...] | None:
        """Of the joints where the contacts are so far on their ``course`` (c,); None where they do not give way."""
        if self.gains is None:
            return None
        forces_o = np.einsum("kij,kj->ki", self.problem.contacts.rotations_oc, self.planned.forces_c)
        normal = (forces_o * self.normals).sum(axis=1)
        turning = self.planned.torsion if self.planned.torsion.size else np.zeros(len(normal))
        across = np.column_stack([forces_o - normal[:, None] * self.normals, turning])
        found = []
        for now, share in zip(on_the_way, self._pressing(course)):
            torques = now.deepening.T @ normal + np.einsum("kin,ki->n", now.across, across)
            found.append(
                Servos(deepening=now.deepening, across=now.across, stiffness=self.gains, torques=share * torques)
            )
        return tuple(found)

    def solve(
        self, q: Array, shift: Array, wanted: Array, towards: Array, before: _Before, near: _Pressed
    ) -> tuple[Array, Array, _Pressed, set[int]]:
        """Joints and shift with the depths ``wanted`` (k,), from a guess (Gauss and Newton), and joints at limits.

        ``near``: how the contacts are pressed at a posture that is not far.
        """
        well = np.maximum(TRACKED, _WELL * wanted)
        best: tuple[float, Array, Array, _Pressed] | None = None
        stopped, halved = set[int](), 0
        for _ in range(_ROUNDS):
            now = self.at(q, near)
            missing = wanted + self.shifts @ shift - now.depth
            off = float(np.abs(missing / well).max())
            if best is None or off < best[0]:
                best, halved, near = (off, q, shift, now), 0, now
                to_q, to_shift, at_limit = self.step(q, shift, now, wanted, towards, before)
                stopped |= at_limit
                if off < 1.0 and np.abs(now.deepening @ (to_q - q)).max() < TRACKED:
                    break
            elif halved < _HALVINGS:  # too far
                halved += 1
                to_q, to_shift = 0.5 * (best[1] + q), 0.5 * (best[2] + shift)
            else:
                break
            q, shift = to_q, to_shift
        assert best is not None
        _, q, shift, now = best
        return q, shift, now, {j for j in stopped if min(q[j] - self.lower[j], self.upper[j] - q[j]) < _AT_LIMIT}

    def _costs(self) -> Array:
        """The least-squares rows (4k + n + 6, n + 6), as far as they are the same for all steps."""
        n, k = self.hand.n, len(self.normals)
        rows = np.zeros((4 * k + n + 6, n + 6))
        rows[:k, n:] = -self.shifts / _DEPTH
        rows[4 * k : 4 * k + n, :n] = np.diag(self.joint_costs)
        rows[4 * k + n :, n:] = np.diag(self.shift_costs)
        return rows

    def step(
        self, q: Array, shift: Array, now: _Pressed, wanted: Array, towards: Array, before: _Before
    ) -> tuple[Array, Array, set[int]]:
        """Where the least-squares step leads joints and shift, and which joints meet their limits on it."""
        n, k = len(q), len(wanted)
        rows, left = self.rows.copy(), np.empty(len(self.rows))
        rows[:k, :n] = now.deepening / _DEPTH
        rows[k : 4 * k, :n] = now.across[:, :3].reshape(3 * k, n) / _SLIDING
        left[:k] = (wanted + self.shifts @ shift - now.depth) / _DEPTH
        left[k : 4 * k] = before.slid_at(q, now.across)[:, :3].ravel() / -_SLIDING
        left[4 * k : 4 * k + n] = self.joint_costs * (self.posture - q)
        left[4 * k + n :] = self.shift_costs * (towards - shift)
        step, stopped = np.zeros(n + 6), set[int]()
        free = np.concatenate([self.moving, np.ones(6, dtype=bool)])
        while True:
            if free.all():
                step = _least_squares(rows, left)
            else:
                step[free] = _least_squares(rows[:, free], left - rows[:, ~free] @ step[~free])
            after = np.clip(q + step[:n], self.lower, self.upper)
            beyond = free[:n] & (np.abs(after - q - step[:n]) > _AT_LIMIT)
            step[:n] = after - q
            if not beyond.any():
                return after, shift + step[n:], stopped
            # A joint that meets its limit stays there; the others do what they can.
            stopped |= set(np.flatnonzero(beyond).tolist())
            free[:n] &= ~beyond


def _least_squares(rows: Array, right: Array) -> Array:
    """The x (p,) with the least |rows x - right|, of independent columns: every unknown has a cost of its own."""
    found: Array = lapack.dgels(rows, right)[1][: rows.shape[1]]
    return found


class Pressing(NamedTuple):
    """The grasp phase of a closed hand, at m times.

    Attributes:
        path: of all joints (m, n).
        missing: what the surfaces of k contacts miss of their depths (m, k) [m].
        limited: indices of the joints that were stopped by their limits.
    """

    path: JointPath
    missing: Array
    limited: frozenset[int]


def pressing_along(pressed: ClosedPress, profile: PenetrationProfile, times: Array) -> Pressing:
    """How a closed hand's joints go at ``times`` (m,) [s] from t_I to t_F, with the penetration of all contacts."""
    first = int(np.argmax(profile.final_depth))  # all contacts take the same course
    course, rate = (of(times)[:, first] / profile.final_depth[first] for of in (profile.depth, profile.rate))
    along = CubicSpline(pressed.course, pressed.q)
    q, dq = along(course), along(course, 1) * rate[:, None]
    if stopped := sorted(pressed.limited):
        # Within the limits between these depths, too.
        within = PchipInterpolator(pressed.course, pressed.q[:, stopped])
        q[:, stopped], dq[:, stopped] = within(course), within(course, 1) * rate[:, None]
    ddq = np.array(np.gradient(dq, float(times[1] - times[0]), axis=0, edge_order=2))
    missing = np.column_stack([np.interp(course, pressed.course, one) for one in np.abs(pressed.missing).T])
    return Pressing(JointPath(q=q, dq=dq, ddq=ddq), missing, pressed.limited)


def press_surfaces(
    hand: HandModel,
    finger: Finger,
    contacts: ContactSet,
    which: Sequence[int],
    found: ContactPostures,
    pressing: Pressing,
    profile: PenetrationProfile,
) -> FingerMotion:
    """The grasp phase of a closed finger.

    Args:
        hand: the closed hand.
        finger: its finger that moves.
        contacts: all contacts, with the posture of the closed hand.
        which: those of the finger.
        found: the finger's contact points.
        pressing: how the hand's joints go.
        profile: penetration of all contacts.
    """
    own = [contacts[i] for i in which]
    path = pressing.path.of(finger.dofs)
    points, jacobians = points_along(hand, finger, own, found.points_l[0], path.q, contacts.posture)
    normals = np.array([contact.normal_o for contact in own])
    moved = points - np.array([contact.point_o for contact in own])
    slid = moved - np.einsum("mcx,cx->mc", moved, normals)[:, :, None] * normals
    motion = FingerMotion(
        q=frozen(path.q),
        dq=frozen(path.dq),
        ddq=frozen(path.ddq),
        jacobians=frozen(jacobians),
        errors=frozen(pressing.missing[:, list(which)]),
        slips=frozen(np.sqrt((slid * slid).sum(axis=2))),
        limited=tuple(name for name, dof in zip(finger.actuated, finger.dofs.tolist()) if dof in pressing.limited),
    )
    return replace(motion, surfaces=bool(off_path(motion, profile, which).any()))


def off_path(motion: FingerMotion, profile: PenetrationProfile, which: Sequence[int]) -> NDArray[np.bool_]:
    """Which contacts (c,) of a closed finger miss their depths by more than is negligible."""
    allowed = np.maximum(TRACKED, _SHARE * profile.final_depth[list(which)])
    return np.asarray(motion.errors.max(axis=0) > allowed)
