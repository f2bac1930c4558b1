"""The whole motion, approach and grasp phase, for the contact-phase posture with the least peak torque (step 15)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from pinograsp.checks import brief, instance_of, integer, mapping_of, number, one_of, read_only
from pinograsp.contacts import PALM
from pinograsp.contacts.penetration import Penetration
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import ForceSolution, RobustForces
from pinograsp.hands import HandModel
from pinograsp.motion.approach import STARTS, approach
from pinograsp.motion.contact_ik import MOST_SAMPLES, contact_postures, moving_groups
from pinograsp.motion.grasp_ik import FingerMotion, press
from pinograsp.motion.torques import contact_torques, inverse_dynamics

# Contact points must follow their path to this [m]; a thousandth of a typical penetration.
_TRACKED = 1e-6
# Rounds that make up for links that turn as they press, and times at which they are looked at: the turn is smooth.
_SURFACE_ROUNDS, _KNOTS = 8, 5
# Surfaces may miss their depth by this between those times [m]: half a per cent of a force of 5 N.
_SURFACE = 1e-5
_HARDLY = 1e-4  # [m] per radian: joints that move contacts less than this do not move them
# Peak torques closer than this [N m] are a tie: the first posture wins.
_TIE = 1e-9
_MOST_TIMES = 200_000  # steps of a motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionSpec:
    """How the motion is built.

    Attributes:
        posture: ``{finger: joint angles at contact}`` [rad], around which redundant joints are sampled; a finger that
            does not touch moves there on a path of its own. Missing fingers: see ``contact_postures``, or they stay.
        start: ``{finger: joint angles at t = 0}`` [rad]; default all 0.
        spread: half-width of the sampling [rad].
        samples: number of samples.
        time_step: largest step between samples [s].
        acceleration_at_start: ``"rest"`` (ddq = 0) or ``"paper"`` (ddq = -ddq at impact).
    """

    posture: dict[str, np.ndarray] | None = None
    start: dict[str, np.ndarray] | None = None
    spread: float = math.radians(3.0)
    samples: int = 13
    time_step: float = 1e-3
    acceleration_at_start: str = "rest"

    __repr__ = brief()

    def __post_init__(self):
        object.__setattr__(self, "spread", number("spread", self.spread, at_least=0, unit="rad"))
        object.__setattr__(self, "time_step", number("time step", self.time_step, above=0, unit="s"))
        one_of("acceleration at start", self.acceleration_at_start, STARTS)
        object.__setattr__(self, "samples", integer("samples", self.samples, at_least=1, at_most=MOST_SAMPLES))
        for name in ("posture", "start"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, mapping_of(name, getattr(self, name), "{finger: joint angles}"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Joint trajectory and torques from t = 0 to t_F.

    Attributes:
        status: ``OK``, ``JOINT_LIMIT`` or ``NOT_TRACKED``.
        remedy: what causes that, and what to do, empty for ``OK``.
        notes: position and effort limits met or exceeded, by joint.
        times: (m,) [s]; sample ``impact`` is t_I, the last of the approach and the first of the grasp phase.
        q, dq, ddq: (m, n) [rad, rad/s, rad/s^2].
        torques: (m, n) [N m];
        holding_torques: (n,), those that hold still after t_F.
        forces_o: contact forces on the object (m, k, 3), world axes [N].
        contact_velocities: velocities of the contact points J dq (m, k, 3) [m/s], zero before the impact.
        tracking_error: largest distance of each contact point from its path (k,) [m]; of a closed grasp along the
            normal.
        slip: largest distance across the normal, of a closed grasp whose joints cannot follow it (k,) [m].
        postures: number of contact-phase postures tried per finger.
        peak_torque: infinity norm of ``torques`` [N m].
    """

    status: Status
    notes: tuple[str, ...]
    times: np.ndarray
    impact: int
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    torques: np.ndarray
    holding_torques: np.ndarray
    forces_o: np.ndarray
    contact_velocities: np.ndarray
    tracking_error: np.ndarray
    slip: np.ndarray
    postures: dict[str, int]
    peak_torque: float
    remedy: str = ""

    __repr__ = brief("status", "peak_torque", "impact", "times", "q", "notes")


def plan_motion(hand: HandModel, solution: ForceSolution | RobustForces, spec: MotionSpec | None = None) -> Motion:
    """Joint motion and torques that carry out ``solution``; of robust forces the squeeze, under ``solution.under()``'s
    load.

    Every contact-phase posture of every finger is taken through grasp and approach phase; per finger the one with the
    least infinity norm of its torques over both phases is kept (the palm is fixed, so fingers do not disturb each
    other and the hand's norm is then least). Postures that stay inside the joint limits and on the path come first.

    Raises:
        ContactNotReached: a finger has no posture at its contact points.
        InvalidInput: unknown fingers or wrong sizes in ``spec``, or a solution without forces.
    """
    instance_of("hand", hand, HandModel)
    spec = MotionSpec() if spec is None else instance_of("spec", spec, MotionSpec)
    instance_of("solution", solution, ForceSolution, RobustForces)
    if isinstance(solution, RobustForces):
        solution = solution.under()
    problem, contacts = solution.problem, solution.problem.contacts
    gravity_o = problem.gravity_o
    postures = contact_postures(
        hand, contacts, reference=_of_touching(contacts, spec.posture), spread=spec.spread, samples=spec.samples
    )
    profile = solution.profile
    t_I, t_F = profile.impact_time, profile.final_time
    if t_F / spec.time_step > _MOST_TIMES:
        raise InvalidInput(f"time step: expected at least {t_F / _MOST_TIMES:g} s, got {spec.time_step:g} s")
    before = np.linspace(0.0, t_I, max(2, math.ceil(t_I / spec.time_step - 1e-9)) + 1)
    after = np.linspace(t_I, t_F, max(4, math.ceil((t_F - t_I) / spec.time_step - 1e-9)) + 1)
    start = hand.configuration(spec.start or {})
    # F_n follows Eq. (4) in time; its direction in the contact frame is that of t_F.
    depth, rate = profile.depth(after), profile.rate(after)
    normal = problem.compliance.normal_force(depth, rate)
    forces_c = normal[:, :, None] * problem.forces(np.ones(problem.k), solution.multipliers)
    forces_o = np.einsum("kij,mkj->mki", contacts.rotations_oc, forces_c)
    # A soft finger's moment about the normal grows with F_n as the tangential forces do.
    per_newton = solution.torsion / solution.normal_forces if solution.torsion.size else np.zeros(problem.k)
    moments_o = (normal * per_newton)[:, :, None] * contacts.rotations_oc[:, :, 2]
    wrenches_o = np.concatenate([forces_o, moments_o], axis=2)

    m, impact = before.size + after.size - 1, before.size - 1
    q, dq, ddq = np.tile(start, (m, 1)), np.zeros((m, hand.n)), np.zeros((m, hand.n))
    contact_part = np.zeros((m, hand.n))
    velocities, tracking, slip = np.zeros((m, problem.k, 3)), np.zeros(problem.k), np.zeros(problem.k)
    notes, remedies = list(hand.notes), []
    clean = on_path = True
    groups = moving_groups(hand, contacts)
    for finger, which in groups:
        found, own = postures[finger.name], [contacts[i] for i in which]
        closed = found.method == "closing"
        if closed:
            candidates = [_press_surfaces(hand, finger, own, found, contacts, problem.object, profile, which, after)]
        else:
            candidates = [
                press(hand, finger, own, angles, points, profile, which, after)
                for angles, points in zip(found.angles, found.points_l)
            ]
        paths = [_with_approach(c, before, start[finger.dofs], spec) for c in candidates]
        if closed:
            paths = [
                _gentler(hand, finger, c, p, before, start[finger.dofs], spec, notes) for c, p in zip(candidates, paths)
            ]
        torques = [contact_torques(c.jacobians, wrenches_o[:, which]) for c in candidates]
        peaks = _peak_torques(hand, finger.dofs, paths, torques, start, impact, gravity_o)
        chosen = _choose(hand, finger, candidates, paths, peaks)
        motion, path = candidates[chosen], paths[chosen]
        q[:, finger.dofs], dq[:, finger.dofs], ddq[:, finger.dofs] = path
        contact_part[impact:, finger.dofs] = torques[chosen]
        velocities[impact:, which] = np.einsum("mcxn,mn->mcx", motion.jacobians[:, :, :3], motion.dq)
        tracking[which], slip[which] = motion.errors.max(axis=0), motion.slips.max(axis=0)
        outside = _outside_limits(hand, finger, path[0])
        stopped = [
            f"{joint} was stopped by its limit at {_limit_met(hand, joint, motion.q[-1, i])} in the grasp phase"
            for i, joint in enumerate(finger.actuated)
            if joint in motion.limited
        ]
        notes += stopped
        notes += [
            f"{joint} leaves its limits by {_displacement(hand, joint, by)} in the approach" for joint, by in outside
        ]
        if tracking[which].max() > _TRACKED:
            on_path = False
            remedies.append(_why_off_path(finger, own, motion, stopped, closed, after[1] - after[0]))
        elif stopped:
            clean = False
            remedies.append(f"{'; '.join(stopped)}: widen the limit, or take another contact posture")
        if outside:
            clean = False
            swinging = ", ".join(f"{joint} (by {_displacement(hand, joint, by)})" for joint, by in outside)
            remedies.append(f"{swinging} swings beyond its limits in the approach: start elsewhere, or touch later")
    busy = {int(i) for finger, _ in groups for i in finger.dofs}
    for name, angles in (spec.posture or {}).items():
        if not busy.intersection(hand.finger(name).dofs.tolist()):  # an idle finger, on its own path to its own posture
            finger = hand.finger(name)
            zero = np.zeros(finger.n)
            times = np.concatenate([before[:-1], after])
            goal = hand.configuration({name: angles})[finger.dofs]
            path = approach(times, t_F, start[finger.dofs], goal, zero, zero)
            q[:, finger.dofs], dq[:, finger.dofs], ddq[:, finger.dofs] = path
    total = inverse_dynamics(hand, q, dq, ddq, gravity_o=gravity_o) + contact_part
    # The deceleration ends at t_F, and its torques with it.
    still = np.zeros((1, hand.n))
    holding = inverse_dynamics(hand, q[-1:], still, still, gravity_o=gravity_o)[0] + contact_part[-1]
    notes += [
        f"{joint} needs up to {peak:.3g} N m, more than its effort limit of {limit:g} N m"
        for joint, peak, limit in zip(hand.joint_names, np.abs(total).max(axis=0), hand.effort)
        if 0 < limit < peak
    ]
    return Motion(
        status=Status.NOT_TRACKED if not on_path else Status.OK if clean else Status.JOINT_LIMIT,
        notes=tuple(notes),
        times=read_only(np.concatenate([before[:-1], after])),
        impact=impact,
        q=read_only(q),
        dq=read_only(dq),
        ddq=read_only(ddq),
        torques=read_only(total),
        holding_torques=read_only(holding),
        forces_o=read_only(np.concatenate([np.zeros((impact, problem.k, 3)), forces_o])),
        contact_velocities=read_only(velocities),
        tracking_error=read_only(tracking),
        slip=read_only(slip),
        postures={name: len(found.angles) for name, found in postures.items()},
        peak_torque=float(np.abs(total).max()),
        remedy=". ".join(remedies),
    )


def _why_off_path(finger, contacts, motion: FingerMotion, stopped: list[str], closed: bool, step: float) -> str:
    """What keeps contact points from their paths, and what helps."""
    missed = f"{finger.name} misses its path by {1e3 * motion.errors.max():.2g} mm"
    if stopped:
        return f"{missed}: {'; '.join(stopped)}: widen the limit, or take another contact posture"
    J = motion.jacobians[0][:, :3]
    # A closed finger follows the depths before anything else.
    rows = np.einsum("cx,cxn->cn", [one.normal_o for one in contacts], J) if closed else J.reshape(-1, J.shape[2])
    asked, ways = len(rows), int(np.sum(np.linalg.svd(rows, compute_uv=False) > _HARDLY))
    moves = f"{missed}: its contacts ask for {asked} {'depths' if closed else 'displacements'} of their own"
    if finger.n < asked:
        coupled = f" (the others of its {len(finger.joints)} follow)" if finger.coupled else ""
        return (
            f"{moves}, and it has no more actuated joints than {', '.join(finger.actuated)}{coupled}: the motion "
            "is the closest there is; "
            "for more, plan fewer contacts on it, or forces that press them alike"
        )
    if ways < asked:
        return f"{moves}, and its joints, as they stand at impact, can give {ways}: take another contact posture"
    if motion.surfaces:
        return (
            f"{missed}: an edge or another place of its link is in the way: place the hand otherwise, or "
            "press less deep (max_depth)"
        )
    return f"{missed}: its joints could follow: use a smaller time step than {step:g} s"


def _limit_met(hand, joint: str, value: float) -> str:
    """The limit of a joint that is nearest to a position, with its unit."""
    at = hand.joint_names.index(joint)
    return _displacement(hand, joint, min(hand.lower[at], hand.upper[at], key=lambda limit: abs(limit - value)))


def _displacement(hand, joint: str, value: float) -> str:
    """A joint's displacement with its unit."""
    slides = hand.is_prismatic(hand.model.getJointId(joint))
    return f"{1e3 * value:.2f} mm" if slides else f"{math.degrees(value):.2f} deg"


def _press_surfaces(hand, finger, own, found, contacts, object, profile, which, times) -> FingerMotion:
    """The grasp phase of a closed finger: its surface, not the point that touched first, goes as deep as ``profile``
    says.
    """
    angles, points = found.angles[0], found.points_l[0]
    deeper = np.zeros((times.size, len(which)))
    knots = np.unique(np.linspace(0, times.size - 1, _KNOTS).astype(int))
    surfaces = None if object is None else Penetration(hand, object, contacts)
    asked, best, least, off = np.zeros((knots.size, len(which))), None, np.inf, np.zeros(len(which))
    step = reached = None  # the last change of what is asked, and the depths before it
    slope = np.ones_like(asked)  # by secants: what rolls to another place of its link moves faster or slower there
    for _ in range(_SURFACE_ROUNDS):
        motion = press(hand, finger, own, angles, points, profile, which, times, normals_first=True, deeper=deeper)
        best = motion if best is None else best
        if surfaces is None or motion.errors.max() > _TRACKED:
            break  # what cannot be followed is not mended by asking for more
        q, depths = np.array(contacts.posture), np.empty_like(asked)
        for i, knot in enumerate(knots):
            q[finger.dofs] = motion.q[knot]
            depths[i] = surfaces.at(q, which)[0]
        missing = profile.depth(times[knots])[:, which] - depths
        if np.abs(missing).max() < least:
            best, least, off = motion, np.abs(missing).max(), np.abs(missing).max(axis=0)
        if least < _TRACKED:
            return best
        if reached is not None:
            moved = np.abs(step) > _TRACKED
            slope[moved] = np.clip((depths - reached)[moved] / step[moved], 0.1, 2.0)
        step, reached = missing / slope, depths
        asked = asked + step
        deeper = CubicSpline(times[knots], asked)(times)
    # A surface that has other places in the way (links with edges) is off by what is left.
    errors = np.maximum(best.errors, np.where(off > _SURFACE, off, 0.0))
    return replace(best, errors=read_only(errors), surfaces=bool(best.errors.max() <= _TRACKED < errors.max()))


def _of_touching(contacts, posture) -> dict[str, np.ndarray]:
    touching = {contact.finger for contact in contacts if contact.finger != PALM}
    return {name: angles for name, angles in (posture or {}).items() if name in touching}


def _gentler(hand, finger, motion: FingerMotion, path, before, start, spec: MotionSpec, notes: list[str]):
    """The path with joints that leave their limits on the way arriving without the grasp phase's acceleration.

    Joints that start and end near a limit have no room to swing back for it. The jump of the acceleration is noted.
    """
    beyond = dict(_outside_limits(hand, finger, path[0]))
    if not beyond:
        return path
    share = np.array([0.0 if joint in beyond else 1.0 for joint in finger.actuated])
    left = dict(_outside_limits(hand, finger, _with_approach(motion, before, start, spec, share)[0]))
    mended = [joint for joint, by in beyond.items() if left.get(joint, 0.0) < by]
    if not mended:
        return path
    notes.append(f"the acceleration of {', '.join(mended)} jumps at impact: no room within the limits to build it up")
    share = np.array([0.0 if joint in mended else 1.0 for joint in finger.actuated])
    return _with_approach(motion, before, start, spec, share)


def _with_approach(motion: FingerMotion, before, start, spec: MotionSpec, share=1.0):
    """(q, dq, ddq) of one finger over both phases; the sample at t_I is the grasp phase's.

    ``share`` of the grasp phase's acceleration, by joint, is there at the end of the approach.
    """
    rise = approach(
        before,
        before[-1],
        start,
        motion.q[0],
        motion.dq[0],
        share * motion.ddq[0],
        acceleration_at_start=spec.acceleration_at_start,
    )
    return tuple(np.concatenate([a[:-1], b]) for a, b in zip(rise, (motion.q, motion.dq, motion.ddq)))


def _peak_torques(hand, dofs, paths, torques, start, impact, gravity_o) -> np.ndarray:
    """Infinity norm of the finger's torques over both phases, per candidate."""
    peaks = []
    for path, contact_part in zip(paths, torques):
        full = [np.tile(base, (len(path[0]), 1)) for base in (start, 0 * start, 0 * start)]
        for whole, own in zip(full, path):
            whole[:, dofs] = own
        total = inverse_dynamics(hand, *full, gravity_o=gravity_o)[:, dofs]
        total[impact:] += contact_part
        peaks.append(np.abs(total).max())
    return np.array(peaks)


def _choose(hand, finger, candidates, paths, peaks) -> int:
    faults = [
        (c.errors.max() > _TRACKED) + bool(c.limited or _outside_limits(hand, finger, path[0]))
        for c, path in zip(candidates, paths)
    ]
    best = min(range(len(peaks)), key=lambda i: (faults[i], peaks[i]))
    tied = [i for i in range(len(peaks)) if faults[i] == faults[best] and peaks[i] <= peaks[best] + _TIE]
    return tied[0]


def _outside_limits(hand, finger, q) -> list[tuple[str, float]]:
    """Joints of the finger that leave their limits along q (m, n_f), and by how much [rad]."""
    beyond = np.maximum(hand.lower[finger.dofs] - q, q - hand.upper[finger.dofs]).max(axis=0)
    return [(joint, float(by)) for joint, by in zip(finger.actuated, beyond) if by > 1e-6]
