"""The whole motion, approach and grasp phase, for the contact-phase posture with the least peak torque (step 15)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import brief, flag, frozen, instance_of, integer, mapping_of, number, one_of
from pinograsp.contacts import PALM, Contact, ContactSet, PenetrationProfile
from pinograsp.contacts.clearance import Way
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.contacts.support_plane import SupportPlane, deepest_below
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import ForceSolution, RobustForces
from pinograsp.hands import Finger, HandModel, servo_gains
from pinograsp.motion.approach import STARTS, JointPath, StartAcceleration, approach, gentle_approach
from pinograsp.motion.contact_ik import MOST_SAMPLES, ContactPostures, contact_postures, moving_groups
from pinograsp.motion.grasp_ik import FingerMotion, press_all
from pinograsp.motion.jacobian import contact_jacobian
from pinograsp.motion.surfaces import TRACKED, ClosedPress, off_path, press_closed, press_surfaces, pressing_along
from pinograsp.motion.torques import contact_torques, finger_dynamics, inverse_dynamics
from pinograsp.plan import Motion
from pinograsp.spatial import Array, BoolArray

_HARDLY = 1e-4  # [m] per radian: joints that move contacts less than this do not move them
# Peak torques closer than this [N m] are a tie: the first posture wins.
_TIE = 1e-9
_SHIFTED = 1e-4  # [m] of the object as it is let go: worth a note
_ANOTHER_FORCE = 0.1  # share of a force by which it may come otherwise without a note
Order = Literal["together", "base first", "tip first"]
_ORDERS: tuple[Order, ...] = get_args(Order)
_TURNS = 0.6  # share of the way after which the last joint starts, where they take turns
# Shares of the approach in which joints come up to speed; the shorter, the nearer to the contact they start to.
_LAST_PARTS = (0.1, 0.03, 0.01)
_HIT = 1e-4  # [m] that links may go into the object on the way: 0.05 N on contacts of the default stiffness
_LOOKS, _EVERY = 28, 4  # samples of the way that are looked at for hits, and every which for links hitting each other
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
        table: what closing fingers are to keep above; None: nothing.
    """

    posture: Mapping[str, ArrayLike] | None = None
    start: Mapping[str, ArrayLike] | None = None
    spread: float = math.radians(3.0)
    samples: int = 13
    time_step: float = 1e-3
    acceleration_at_start: StartAcceleration = "rest"
    table: SupportPlane | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        object.__setattr__(self, "spread", number("spread", self.spread, at_least=0, unit="rad"))
        object.__setattr__(self, "time_step", number("time step", self.time_step, above=0, unit="s"))
        one_of("acceleration at start", self.acceleration_at_start, STARTS)
        object.__setattr__(self, "samples", integer("samples", self.samples, at_least=1, at_most=MOST_SAMPLES))
        instance_of("table", self.table, SupportPlane, type(None))
        for name in ("posture", "start"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, mapping_of(name, getattr(self, name), "{finger: joint angles}"))


def plan_motion(
    hand: HandModel,
    solution: ForceSolution | RobustForces,
    spec: MotionSpec | None = None,
    *,
    corrected: bool = True,
) -> Motion:
    """Joint motion and torques that carry out ``solution``; of robust forces the squeeze, under the problem's own load.

    Every contact-phase posture of every finger is taken through grasp and approach phase; per finger the one with the
    least infinity norm of its torques over both phases is kept (the palm is fixed, so fingers do not disturb each
    other and the hand's norm is then least). Postures that stay inside the joint limits and on the path come first.

    Args:
        hand: the hand.
        solution: its forces.
        spec: postures and sampling; default: :class:`MotionSpec`.
        corrected: whether a closed hand presses to other depths where friction and servos leave other forces at rest;
            not for a squeeze on contacts of several stiffnesses, of which it would suit one.

    Raises:
        ContactNotReached: a finger has no posture at its contact points.
        InvalidInput: unknown fingers or wrong sizes in ``spec``, or a solution without forces.
    """
    instance_of("hand", hand, HandModel)
    spec = MotionSpec() if spec is None else instance_of("spec", spec, MotionSpec)
    if isinstance(solution, RobustForces):
        solution = solution.under()
    instance_of("solution", solution, ForceSolution)
    contacts = solution.problem.contacts
    postures = contact_postures(
        hand, contacts, reference=_of_touching(contacts, spec.posture), spread=spec.spread, samples=spec.samples
    )
    planning = _Planning(hand, solution, spec, flag("corrected", corrected))
    groups = moving_groups(hand, contacts)
    for finger, which in groups:
        planning.move(finger, which, postures[finger.name])
    busy = {int(i) for finger, _ in groups for i in finger.dofs}
    planning.move_idle(busy)
    planning.load_others(busy)
    planning.keep_clear()
    return planning.result({name: len(found.angles) for name, found in postures.items()})


def _of_touching(contacts: ContactSet, posture: Mapping[str, ArrayLike] | None) -> dict[str, ArrayLike]:
    touching = {contact.finger for contact in contacts if contact.finger != PALM}
    return {name: angles for name, angles in (posture or {}).items() if name in touching}


class Gentle(NamedTuple):
    """A closing hand's path over both phases (m, n), and which of its joints (n,) jump into their motion at impact."""

    path: JointPath
    jumps: BoolArray


class _Planning:
    """A motion while it is put together, finger by finger."""

    def __init__(self, hand: HandModel, solution: ForceSolution, spec: MotionSpec, corrected: bool):
        self.hand, self.problem, self.profile, self.spec = hand, solution.problem, solution.profile, spec
        self.before, self.after = _sample_times(solution.profile, spec.time_step)
        self.times, self.impact = np.concatenate([self.before[:-1], self.after]), self.before.size - 1
        self.start = hand.configuration(spec.start or {})
        if self.problem.contacts.posture is not None:
            # Joints of no finger, of a wrist, stay as they were when the hand closed.
            others = np.setdiff1d(np.arange(hand.n), np.concatenate([finger.dofs for finger in hand.fingers]))
            self.start[others] = self.problem.contacts.posture[others]
        self.forces_o, self.wrenches_o = _contact_wrenches(solution, self.after)
        m, n, k = self.times.size, hand.n, self.problem.k
        self.path = JointPath(q=np.tile(self.start, (m, 1)), dq=np.zeros((m, n)), ddq=np.zeros((m, n)))
        self.contact_torques, self.velocities = np.zeros((m, n)), np.zeros((m, k, 3))
        self.tracking, self.slip = np.zeros(k), np.zeros(k)
        self.notes, self.remedies = list(hand.notes), list[str]()
        self.within_limits = self.on_path = self.clear = True
        self.closing: list[Finger] = []
        self.pressed: ClosedPress | None = None
        if self.problem.contacts.posture is not None:
            self.pressed = self.closed(solution, self.problem.contacts.posture, corrected)
            self.pressing = pressing_along(self.pressed, self.profile, self.after)
            self.gentle = self.gentle_path()

    def closed(self, solution: ForceSolution, q: Array, corrected: bool) -> ClosedPress:
        """How all joints of the hand that is closed at ``q`` (n,) press, and the object gives way when it is let go."""
        pressed = press_closed(self.hand, solution, q, servo_gains(self.hand), corrected=corrected)
        planned, rest = self.problem.compliance.normal_force(self.profile.final_depth), pressed.rest.normal
        if not pressed.rest.balanced:
            self.notes.append(
                "where the object comes to rest as it is let go could not be foreseen, since friction is nearly used "
                "up then: simulate the plan"
            )
            return pressed
        size = float(np.linalg.norm(pressed.rest.shift[:3]))
        if size > _SHIFTED:
            self.notes.append(
                f"the object shifts by {1e3 * size:.2g} mm as it is let go, and the joints make up for it"
            )
        others = [
            f"{name} {force:.2g} N (planned {asked:.2g} N)"
            for name, force, asked in zip(self.problem.contacts.names, rest, planned)
            if abs(force - asked) > _ANOTHER_FORCE * asked
        ]
        if others:
            self.notes.append(
                f"friction that builds up while the hand presses leaves other forces: {', '.join(others)}"
            )
        return pressed

    def settled(self, planned: Array) -> Array:
        """Normal forces (k,) [N] once the object is let go, as far as they are foreseen; else the planned ones."""
        return planned if self.pressed is None or not self.pressed.rest.balanced else self.pressed.rest.normal

    def move(self, finger: Finger, which: Sequence[int], found: ContactPostures) -> None:
        """Move a finger, from its best posture ``found``, as its contacts ``which`` ask for."""
        hand, contacts, start = self.hand, self.problem.contacts, self.start[finger.dofs]
        if found.method == "closing" and self.pressed is not None:
            candidates = [press_surfaces(hand, finger, contacts, which, found, self.pressing, self.profile)]
            paths = [self.gentle.path.of(finger.dofs)]
            self.note_jumps(finger, self.gentle.jumps)
            self.closing.append(finger)
        else:
            own = [contacts[i] for i in which]
            candidates = press_all(hand, finger, own, found.angles, found.points_l, self.profile, which, self.after)
            paths = [self.with_approach(motion, start) for motion in candidates]
        torques = [contact_torques(motion.jacobians, self.wrenches_o[:, which]) for motion in candidates]
        chosen = self.choose(finger, candidates, paths, torques)
        motion, path = candidates[chosen], paths[chosen]
        self.follow(finger, path)
        self.contact_torques[self.impact :, finger.dofs] = torques[chosen]
        self.velocities[self.impact :, which] = np.einsum("mcxn,mn->mcx", motion.jacobians[:, :, :3], motion.dq)
        self.tracking[which], self.slip[which] = motion.errors.max(axis=0), motion.slips.max(axis=0)
        self.judge(finger, which, motion, path, found.method == "closing")

    def keep_clear(self) -> None:
        """Let the joints of closing fingers take turns where links hit the object, or each other, on the way."""
        body = self.problem.object
        if not self.closing or body is None:
            return
        way_there, collisions = Way(self.hand, body), SelfCollisions(self.hand)
        tried: list[tuple[float, str, JointPath]] = []
        gentle = self.gentle
        for last_part, order in itertools.product(_LAST_PARTS, _ORDERS):
            # Some samples are enough: the way is smooth, and ends where the last part begins.
            looked_at = np.unique(np.linspace(0, (1 - last_part) * self.impact, _LOOKS).astype(int))
            if tried:  # at first they follow theirs already
                gentle = self.gentle_path(order, last_part)
                self.follow_all(gentle.path)
                for finger in self.closing:
                    self.note_jumps(finger, gentle.jumps)
            way = self.path.q[looked_at]
            what, hit = "the object", way_there.deepest_hit(way, allowed=_HIT)
            if hit is None and self.spec.table is not None:
                what, hit = "the table", deepest_below(self.hand, self.spec.table, np.vstack([way, self.path.q[-1:]]))
            if hit is None:
                crossing = collisions.after(way[0], way[1::_EVERY])
                if not crossing:
                    return
                tried.append((0.0, f"{' and '.join(crossing[0])} hit each other on the way", gentle.path))
            else:
                time = self.times[[*looked_at, -1][hit.sample]]
                where = f"{hit.link} hits {what} on the way, at {time:.2g} s, {1e3 * hit.depth:.2g} mm deep"
                tried.append((hit.depth, where, gentle.path))
        _, why, path = min(tried, key=lambda one: one[0])
        self.follow_all(path)
        self.clear = False
        self.notes.append(why)
        self.remedies.append(f"{why}: start elsewhere, or take another grasp")

    def follow_all(self, path: JointPath) -> None:
        """Take the closing fingers' parts of a path of all joints into the hand's."""
        for finger in self.closing:
            self.follow(finger, path.of(finger.dofs))

    def follow(self, finger: Finger, path: JointPath) -> None:
        """Take a finger's path into the hand's."""
        for whole_hand, own in ((self.path.q, path.q), (self.path.dq, path.dq), (self.path.ddq, path.ddq)):
            whole_hand[:, finger.dofs] = own

    def move_idle(self, busy: set[int]) -> None:
        """Move fingers without contacts to the posture that is given for them; ``busy`` joints are taken."""
        for name, angles in (self.spec.posture or {}).items():
            finger = self.hand.finger(name)
            if busy.intersection(finger.dofs.tolist()):
                continue
            zero = np.zeros(finger.n)
            goal = self.hand.configuration({name: angles})[finger.dofs]
            self.follow(
                finger, approach(self.times, self.profile.final_time, self.start[finger.dofs], goal, zero, zero)
            )

    def load_others(self, busy: set[int]) -> None:
        """Contact torques of the joints that carry touching fingers without being theirs: of a wrist or an arm.

        They stay where they are, so the contact points are those of the fingers at the end of the grasp phase.
        """
        model, data = self.hand.model, self.hand.model.createData()
        others = np.setdiff1d(np.arange(self.hand.n), sorted(busy))
        pin.computeJointJacobians(model, data, self.path.q[-1])
        jacobian = np.zeros((self.problem.k, 6, self.hand.n))
        for i, contact in enumerate(self.problem.contacts):
            if contact.finger != PALM:
                pressed = contact.point_o + self.profile.final_depth[i] * contact.normal_o
                joint = self.hand.finger(contact.finger).joint_ids[-1]  # what carries it moves all its points alike
                jacobian[i] = contact_jacobian(model, data, joint, data.oMi[joint].actInv(pressed))
        self.contact_torques[self.impact :, others] = np.einsum("cxn,mcx->mn", jacobian[:, :, others], self.wrenches_o)

    def with_approach(self, motion: FingerMotion, start: Array) -> JointPath:
        """The path of one finger over both phases."""
        rise = approach(
            self.before,
            self.before[-1],
            start,
            motion.q[0],
            motion.dq[0],
            motion.ddq[0],
            acceleration_at_start=self.spec.acceleration_at_start,
        )
        return _joined(rise, motion)

    def gentle_path(self, order: Order = "together", last_part: float = _LAST_PARTS[0]) -> Gentle:
        """The path of a closing hand over both phases, the joints of a finger moving together or in turn."""
        motion, begin = self.pressing.path, np.zeros(self.hand.n)
        if order != "together":
            for finger in self.closing:
                begin[finger.dofs] = np.linspace(0, _TURNS, finger.n)[:: 1 if order == "base first" else -1]
        rise, jumps = gentle_approach(
            self.before,
            self.before[-1],
            self.start,
            motion.q[0],
            motion.dq[0],
            motion.ddq[0],
            limits=(self.hand.lower, self.hand.upper),
            windows=np.column_stack([begin, begin + (1.0 if order == "together" else 1 - _TURNS)]),
            last_part=last_part,
        )
        return Gentle(_joined(rise, motion), jumps)

    def note_jumps(self, finger: Finger, jumps: BoolArray) -> None:
        """Note which of a finger's joints are among those (n,) that jump into their motion."""
        jumping = ", ".join(name for name, jump in zip(finger.actuated, jumps[finger.dofs]) if jump)
        note = f"{jumping} jumps into its motion at impact: a limit leaves no room to come up to speed"
        if jumping and note not in self.notes:
            self.notes.append(note)

    def choose(
        self,
        finger: Finger,
        candidates: Sequence[FingerMotion],
        paths: Sequence[JointPath],
        torques: Sequence[Array],
    ) -> int:
        """The candidate with the fewest faults, among them the one with the least peak torque."""
        if len(candidates) == 1:
            return 0
        faults = np.array(
            [
                int(motion.errors.max() > TRACKED) + bool(motion.limited or _outside_limits(self.hand, finger, path.q))
                for motion, path in zip(candidates, paths)
            ]
        )
        fewest: list[int] = np.flatnonzero(faults == faults.min()).tolist()
        peaks = self.peak_torques(finger, [paths[i] for i in fewest], [torques[i] for i in fewest])
        return fewest[int(np.argmax(peaks <= peaks.min() + _TIE))]

    def peak_torques(self, finger: Finger, paths: Sequence[JointPath], torques: Sequence[Array]) -> Array:
        """Infinity norms of the finger's torques over both phases, path by path (s,) [N m]."""
        q, dq, ddq = (np.concatenate([getattr(path, name) for path in paths]) for name in ("q", "dq", "ddq"))
        total = finger_dynamics(self.hand, finger, self.start, (q, dq, ddq), self.problem.gravity_o)
        total = total.reshape(len(paths), -1, finger.n)
        total[:, self.impact :] += np.array(torques)
        peaks: Array = np.abs(total).max(axis=(1, 2))
        return peaks

    def judge(self, finger: Finger, which: Sequence[int], motion: FingerMotion, path: JointPath, closed: bool) -> None:
        """Note what keeps a finger off its path or takes it beyond its limits, and what helps."""
        hand = self.hand
        outside = [(joint, _displacement(hand, joint, by)) for joint, by in _outside_limits(hand, finger, path.q)]
        stopped = [
            f"{joint} was stopped by its limit at {_limit_met(hand, joint, motion.q[-1, i])} in the grasp phase"
            for i, joint in enumerate(finger.actuated)
            if joint in motion.limited
        ]
        self.notes += stopped
        self.notes += [f"{joint} leaves its limits by {by} in the approach" for joint, by in outside]
        if off_path(motion, self.profile, which).any() if closed else motion.errors.max() > TRACKED:
            self.on_path = False
            own = [self.problem.contacts[i] for i in which]

            step = float(self.after[1] - self.after[0])
            self.remedies.append(_why_off_path(finger, own, motion, stopped, closed, step))
        elif stopped and not closed:
            self.within_limits = False
            self.remedies.append(f"{'; '.join(stopped)}: widen the limit, or take another contact posture")
        if outside:
            self.within_limits = False
            swinging = ", ".join(f"{joint} (by {by})" for joint, by in outside)
            self.remedies.append(
                f"{swinging} swings beyond its limits in the approach: start elsewhere, or touch later"
            )

    def result(self, postures: dict[str, int]) -> Motion:
        """The motion with its torques; ``postures`` were tried by finger."""
        hand, path, gravity_o = self.hand, self.path, self.problem.gravity_o
        # The deceleration ends at t_F, and its torques with it: one more sample, at rest.
        still = np.zeros((1, hand.n))
        moving = (np.vstack([path.q, path.q[-1:]]), np.vstack([path.dq, still]), np.vstack([path.ddq, still]))
        total = inverse_dynamics(hand, *moving, gravity_o=gravity_o)
        total, holding = total[:-1] + self.contact_torques, total[-1] + self.contact_torques[-1]
        self.notes += [
            f"{joint} needs up to {peak:.3g} N m, more than its effort limit of {limit:g} N m"
            for joint, peak, limit in zip(hand.joint_names, np.abs(total).max(axis=0), hand.effort)
            if 0 < limit < peak
        ]
        planned = self.problem.compliance.normal_force(self.profile.final_depth)
        status = Status.OK if self.clear else Status.EARLY_CONTACT
        status = status if self.within_limits else Status.JOINT_LIMIT
        return Motion(
            status=status if self.on_path else Status.NOT_TRACKED,
            notes=tuple(self.notes),
            times=frozen(self.times),
            impact=self.impact,
            q=frozen(path.q),
            dq=frozen(path.dq),
            ddq=frozen(path.ddq),
            torques=frozen(total),
            holding_torques=frozen(holding),
            settled_forces=frozen(np.array(self.settled(planned))),
            forces_o=frozen(np.concatenate([np.zeros((self.impact, self.problem.k, 3)), self.forces_o])),
            contact_velocities=frozen(self.velocities),
            tracking_error=frozen(self.tracking),
            slip=frozen(self.slip),
            postures=postures,
            peak_torque=float(np.abs(total).max()),
            remedy=". ".join(self.remedies),
        )


def _joined(rise: JointPath, motion: JointPath | FingerMotion) -> JointPath:
    """Approach and grasp phase; the sample at t_I is the grasp phase's."""
    return JointPath(
        q=np.concatenate([rise.q[:-1], motion.q]),
        dq=np.concatenate([rise.dq[:-1], motion.dq]),
        ddq=np.concatenate([rise.ddq[:-1], motion.ddq]),
    )


def _sample_times(profile: PenetrationProfile, time_step: float) -> tuple[Array, Array]:
    """Samples [s] of the approach, from 0 to t_I, and of the grasp phase, from t_I to t_F."""
    t_I, t_F = profile.impact_time, profile.final_time
    if t_F / time_step > _MOST_TIMES:
        raise InvalidInput(f"time step: expected at least {t_F / _MOST_TIMES:g} s, got {time_step:g} s")
    before = np.linspace(0.0, t_I, max(2, math.ceil(t_I / time_step - 1e-9)) + 1)
    after = np.linspace(t_I, t_F, max(4, math.ceil((t_F - t_I) / time_step - 1e-9)) + 1)
    return before, after


def _contact_wrenches(solution: ForceSolution, times: Array) -> tuple[Array, Array]:
    """Forces (m, k, 3) on the object [N], and with the moments about the normals wrenches (m, k, 6), world axes."""
    problem, profile = solution.problem, solution.profile
    rotations = problem.contacts.rotations_oc
    # F_n follows Eq. (4) in time; its direction in the contact frame is that of t_F.
    normal = problem.compliance.normal_force(profile.depth(times), profile.rate(times))
    forces_c = normal[:, :, None] * problem.forces(np.ones(problem.k), solution.multipliers)
    forces_o = np.einsum("kij,mkj->mki", rotations, forces_c)
    # A soft finger's moment about the normal grows with F_n as the tangential forces do.
    per_newton = solution.torsion / solution.normal_forces if solution.torsion.size else np.zeros(problem.k)
    moments_o = (normal * per_newton)[:, :, None] * rotations[:, :, 2]
    return forces_o, np.concatenate([forces_o, moments_o], axis=2)


def _why_off_path(
    finger: Finger,
    contacts: Sequence[Contact],
    motion: FingerMotion,
    stopped: Sequence[str],
    closed: bool,
    step: float,
) -> str:
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
            f"{moves}, and it has no more actuated joints than {', '.join(finger.actuated)}{coupled}: the motion is "
            "the closest there is; for more, plan fewer contacts on it, or forces that press them alike"
        )
    if ways < asked:
        return f"{moves}, and its joints, as they stand at impact, can give {ways}: take another contact posture"
    if motion.surfaces:
        return (
            f"{missed}: an edge or another place of its link is in the way: place the hand otherwise, or press less "
            "deep (max_depth)"
        )
    return f"{missed}: its joints could follow: use a smaller time step than {step:g} s"


def _limit_met(hand: HandModel, joint: str, value: float) -> str:
    """The limit of a joint that is nearest to a position, with its unit."""
    at = hand.joint_names.index(joint)
    limits = (float(hand.lower[at]), float(hand.upper[at]))
    return _displacement(hand, joint, min(limits, key=lambda limit: abs(limit - value)))


def _displacement(hand: HandModel, joint: str, value: float) -> str:
    """A joint's displacement with its unit."""
    slides = hand.is_prismatic(hand.model.getJointId(joint))
    return f"{1e3 * value:.2f} mm" if slides else f"{math.degrees(value):.2f} deg"


def _outside_limits(hand: HandModel, finger: Finger, q: Array) -> list[tuple[str, float]]:
    """Joints of the finger that leave their limits along q (m, n_f), and by how much [rad]."""
    beyond = np.maximum(hand.lower[finger.dofs] - q, q - hand.upper[finger.dofs]).max(axis=0)
    return [(joint, float(by)) for joint, by in zip(finger.actuated, beyond) if by > 1e-6]
