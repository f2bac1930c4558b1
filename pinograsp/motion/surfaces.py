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
from scipy.interpolate import CubicSpline, PchipInterpolator

from pinograsp.checks import frozen, instance_of
from pinograsp.contacts import ContactSet, PenetrationProfile
from pinograsp.forces import ForceSolution
from pinograsp.hands import Finger, HandModel, servo_gains
from pinograsp.motion.approach import JointPath
from pinograsp.motion.chains import points_at
from pinograsp.motion.contact_ik import ContactPostures
from pinograsp.motion.grasp_ik import FingerMotion
from pinograsp.motion.letting_go import LetGo, friction_built_up, let_go
from pinograsp.motion.press_solver import TRACKED, Before, PressedContacts, PressSolver
from pinograsp.motion.rounds import PRESS
from pinograsp.spatial import Array, BoolArray

# Surfaces of closed fingers are as deep as planned to this share of the largest depth: 1.5 % of the largest force.
_SHARE = 0.01
_ROUNDED = 0.1  # share of its depth that a contact keeps where others need less of it
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
    on_the_way: tuple[PressedContacts, ...]

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
    solver, final = PressSolver(hand, solution, posture, gains), solution.profile.final_depth
    planned = solution.problem.compliance.normal_force(final)
    best = _press(solver, final, np.zeros(6))
    if not (corrected and best.rest.balanced):
        best = _press_with_shifts(solver, final, planned, best)
    return _press_to_depths(solver, final, planned, best) if corrected else best


def normal_at_rest(hand: HandModel, solution: ForceSolution) -> Array | None:
    """Predict the normal forces (k,) [N] of a closed hand after the object is let go, with the hand's own servos; None
    if they cannot be predicted.
    """
    instance_of("hand", hand, HandModel)
    posture = instance_of("solution", solution, ForceSolution).problem.contacts.posture
    if posture is None:
        return None
    rest = press_closed(hand, solution, posture, servo_gains(hand)).rest
    return rest.normal if rest.balanced else None


def _press_with_shifts(solver: PressSolver, final: Array, planned: Array, best: ClosedPress) -> ClosedPress:
    """A press that has the object shift as friction makes it: forces at rest are nearer the ``planned`` (k,) [N]."""
    off, share = best.off(planned), 1.0
    for _ in range(PRESS.shifts):
        if off < PRESS.as_planned:
            break
        # Newton's step to joints that make the object shift as they assume: what they press deeper for it, the
        # normals alone would give back; friction keeps the rest.
        rest, shift, units = best.rest, best.shift[-1], 1.0 / solver.shift_costs
        grip = units[:, None] * (rest.gripping + _STIFF * rest.stiffness) * units
        step = units * np.linalg.lstsq(grip, units * (rest.stiffness @ (rest.shift - shift)), rcond=1e-9)[0]
        share *= min(1.0, PRESS.furthest / max(float(np.linalg.norm(share * step / units)), 1e-300))
        tried = _press(solver, final, shift + share * step, best)
        if tried.off(planned) < off:
            gained, best, off, share = off - tried.off(planned), tried, tried.off(planned), 1.0
            if gained < PRESS.shift_gain * off:
                break
        else:
            share /= PRESS.shorter
    return best


def _press_to_depths(solver: PressSolver, final: Array, planned: Array, best: ClosedPress) -> ClosedPress:
    """A press to other depths than ``final`` (k,) [m], with forces at rest that are nearer the ``planned`` (k,) [N]."""
    law, towards, depths, astray = solver.problem.compliance, best.shift[-1], final, 0
    reached, off = max(TRACKED, float(np.abs(best.missing).max())), best.off(planned)
    lacking, seen, longest = final - law.depth(best.rest.normal), list[tuple[Array, Array]](), np.inf
    for _ in range(PRESS.depths):
        if off < PRESS.as_planned or not best.rest.balanced:
            break
        step = np.asarray(np.linalg.lstsq(_as_seen(best.rest.response, seen), lacking, rcond=_STIFF)[0], dtype=float)
        step *= min(1.0, longest / max(float(np.linalg.norm(step)), 1e-300))
        tried_depths = np.maximum(depths + step, _ROUNDED * final)
        tried = _press(solver, tried_depths, towards, best)
        step, left, gained = tried_depths - depths, final - law.depth(tried.rest.normal), 0.0
        seen.append((step, lacking - left))
        longest = PRESS.longer * float(np.linalg.norm(step))
        if tried.rest.balanced and tried.off(planned) < off and np.abs(tried.missing).max() <= reached:
            gained, best, depths, lacking = off - tried.off(planned), tried, tried_depths, left
            off -= gained
        astray += gained < PRESS.depth_gain * off
        if astray == PRESS.astray:
            break
    return best


def _as_seen(response: Array, seen: Sequence[tuple[Array, Array]]) -> Array:
    """A ``response`` (k, k) changed so that steps (k,) give what was ``seen`` of them, the last ones best.

    Friction changes it more than it tells (C. G. Broyden, Mathematics of Computation 19(92), 1965).
    """
    for step, gain in seen:
        response = response + np.outer(gain - response @ step, step / max(float(step @ step), 1e-300))
    return response


def _press(solver: PressSolver, final: Array, towards: Array, since: ClosedPress | None = None) -> ClosedPress:
    """To the depths ``final`` (k,) [m], with an object that shifts ``towards`` (6,) or near to it.

    ``since``: a press that was much the same.
    """
    course = np.linspace(0.0, 1.0, PRESS.knots)
    q, shift = np.tile(solver.posture, (PRESS.knots, 1)), np.zeros((PRESS.knots, 6))
    depths, missing = np.zeros((PRESS.knots, len(final))), np.zeros((PRESS.knots, len(final)))
    slid = np.zeros((PRESS.knots, len(final), 4))
    limited: set[int] = set()
    now = solver.start
    on_the_way = [now]
    for i in range(1, PRESS.knots):
        before, wanted, shifted = Before(q[i - 1], slid[i - 1], now), course[i] * final, course[i] * towards
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


class GraspPhase(NamedTuple):
    """The grasp phase of a closed hand, at m times.

    Attributes:
        path: of all joints (m, n).
        missing: what the surfaces of k contacts miss of their depths (m, k) [m].
        limited: indices of the joints that were stopped by their limits.
    """

    path: JointPath
    missing: Array
    limited: frozenset[int]


def follow_press(pressed: ClosedPress, profile: PenetrationProfile, times: Array) -> GraspPhase:
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
    return GraspPhase(JointPath(q=q, dq=dq, ddq=ddq), missing, pressed.limited)


def press_surfaces(
    hand: HandModel,
    finger: Finger,
    contacts: ContactSet,
    which: Sequence[int],
    found: ContactPostures,
    phase: GraspPhase,
    profile: PenetrationProfile,
) -> FingerMotion:
    """The grasp phase of a closed finger.

    Args:
        hand: the closed hand.
        finger: its finger that moves.
        contacts: all contacts, with the posture of the closed hand.
        which: those of the finger.
        found: the finger's contact points.
        phase: how the hand's joints go.
        profile: penetration of all contacts.
    """
    own = [contacts[i] for i in which]
    path = phase.path.of(finger.dofs)
    joints = [finger.joint_of(contact.link) for contact in own]
    posture = hand.resting if contacts.posture is None else contacts.posture
    points, jacobians = points_at(hand, finger, joints, found.points_l[0], path.q, posture)
    normals = np.array([contact.normal_o for contact in own])
    moved = points - np.array([contact.point_o for contact in own])
    slid = moved - np.einsum("mcx,cx->mc", moved, normals)[:, :, None] * normals
    motion = FingerMotion(
        q=frozen(path.q),
        dq=frozen(path.dq),
        ddq=frozen(path.ddq),
        jacobians=frozen(jacobians),
        errors=frozen(phase.missing[:, list(which)]),
        slips=frozen(np.sqrt((slid * slid).sum(axis=2))),
        limited=tuple(name for name, dof in zip(finger.actuated, finger.dofs.tolist()) if dof in phase.limited),
    )
    return replace(motion, surfaces=bool(off_path(motion, profile).any()))


def off_path(motion: FingerMotion, profile: PenetrationProfile) -> BoolArray:
    """Which contacts (c,) of a closed finger miss their depths by more than is negligible: what a light one lacks is
    little beside what the deepest presses.
    """
    allowed = max(TRACKED, _SHARE * float(profile.final_depth.max()))
    return np.asarray(motion.errors.max(axis=0) > allowed)
