"""The whole motion, approach and grasp phase, for the contact-phase posture with the least peak torque (step 15)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, frozen, instance_of, integer, mapping_of, number, one_of
from pinograsp.contacts import PALM, PenetrationProfile
from pinograsp.contacts.support_plane import SupportPlane
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import ForceSolution, RobustForces
from pinograsp.hands import Finger, HandModel, servo_gains
from pinograsp.motion.approach import (
    LAST_PARTS,
    ORDERS,
    STARTS,
    JointPath,
    Order,
    StartAcceleration,
    approach,
    gentle_approach,
    take_turns,
)
from pinograsp.motion.contact_ik import MOST_SAMPLES, ContactPostures, find_postures, moving_groups
from pinograsp.motion.grasp_ik import ContactPath, FingerMotion, press_points
from pinograsp.motion.jacobian import contact_jacobian
from pinograsp.motion.obstacles import Obstacles
from pinograsp.motion.press_solver import TRACKED
from pinograsp.motion.remedies import explain_miss, find_outside_limits, name_displacement, name_limit, note_rest
from pinograsp.motion.surfaces import ClosedPress, follow_press, off_path, press_closed, press_surfaces
from pinograsp.motion.torques import beyond_limits, contact_torques, finger_dynamics, inverse_dynamics, soften_servos
from pinograsp.plan import Motion
from pinograsp.spatial import Array, BoolArray

# Peak torques closer than this [N m] are a tie: the first posture wins.
_TIE = 1e-9
_MOST_TIMES = 200_000  # steps of a motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionSpec:
    """Settings of the motion.

    Attributes:
        posture: ``{finger: joint angles at contact}`` [rad], around which redundant joints are sampled; a finger that
            does not touch moves there on its own path. For missing fingers see ``contact_postures``; they stay if they
            do not touch.
        start: ``{finger: joint angles at t = 0}`` [rad]; default all 0.
        spread: half-width of the sampling [rad].
        samples: number of samples.
        time_step: largest step between samples [s].
        acceleration_at_start: ``"rest"`` (ddq = 0) or ``"paper"`` (ddq = -ddq at impact).
        table: the table above which closing fingers stay; None: no table.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> ball = pg.Sphere(radius=0.02, mass=0.1).placed(up)
        >>> finer = pg.PlanOptions(motion=pg.MotionSpec(time_step=5e-4))
        >>> plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.6), finer)
        >>> print(len(plan.motion.times))
        2001

    See Also:
        :class:`~pinograsp.planner.PlanOptions`, which has it.
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
    """Plan the joint motion and torques that execute ``solution``; for robust forces, the squeeze under the problem's
    own load.

    The planner tries every contact-phase posture of every finger in the grasp and approach phases. For each finger it
    keeps the posture with the least infinity norm of its torques over both phases; because the palm is fixed, fingers
    do not disturb each other and the hand's norm is then least. Postures that stay inside the joint limits and on the
    path come first.

    Args:
        hand: the hand.
        solution: the forces.
        spec: postures and sampling; default: :class:`MotionSpec`.
        corrected: whether a closed hand presses to other depths if friction and servos change the forces at rest. Not
            for a squeeze for contacts of several stiffnesses, because the correction fits only one of them.

    Raises:
        ContactNotReached: a finger has no posture at its contact points.
        InvalidInput: unknown fingers or wrong sizes in ``spec``, or a solution without forces.
    """
    return draft_motion(hand, solution, spec, corrected=corrected).finish()


class MotionDraft(NamedTuple):
    """A motion whose fingers are on their paths, whatever is in their way: half of the work."""

    planning: _Planning
    tried: dict[str, int]

    @property
    def posture(self) -> Array:
        """The posture (n,) that the motion ends in."""
        posture: Array = self.planning.path.q[-1]
        return posture

    def finish(self) -> Motion:
        """Return the motion, with its fingers clear of what is in their way if any order of their joints is."""
        self.planning.keep_clear()
        return self.planning.result(self.tried)


def draft_motion(
    hand: HandModel,
    solution: ForceSolution | RobustForces,
    spec: MotionSpec | None = None,
    *,
    corrected: bool = True,
) -> MotionDraft:
    """Begin the motion of :func:`plan_motion`, for its last posture alone; arguments and errors as there."""
    instance_of("hand", hand, HandModel)
    spec = MotionSpec() if spec is None else instance_of("spec", spec, MotionSpec)
    if isinstance(solution, RobustForces):
        solution = solution.under()
    contacts = instance_of("solution", solution, ForceSolution).problem.contacts
    flag("corrected", corrected)
    touching = {contact.finger for contact in contacts if contact.finger != PALM}
    near = {
        name: array_of(f"posture of '{name}'", angles, (hand.finger(name).n,))
        for name, angles in (spec.posture or {}).items()
        if name in touching
    }
    postures = find_postures(hand, contacts, near, spec.spread, spec.samples)
    planning = _Planning(hand, solution, spec, corrected)
    groups = moving_groups(hand, contacts)
    for finger, which in groups:
        planning.move(finger, which, postures[finger.name])
    busy = {int(i) for finger, _ in groups for i in finger.dofs}
    planning.move_idle(busy)
    planning.load_others(busy)
    return MotionDraft(planning, {name: len(found.angles) for name, found in postures.items()})


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
            posture, gains = self.problem.contacts.posture, servo_gains(hand)
            self.pressed = press_closed(hand, solution, posture, gains, corrected=corrected)
            self.notes += note_rest(self.problem, self.profile.final_depth, self.pressed.rest)
            self.phase = follow_press(self.pressed, self.profile, self.after)
            self.gentle = self.gentle_path()

    def move(self, finger: Finger, which: Sequence[int], found: ContactPostures) -> None:
        """Move a finger, from its best posture ``found``, as its contacts ``which`` ask for."""
        hand, contacts, start = self.hand, self.problem.contacts, self.start[finger.dofs]
        if found.method == "closing" and self.pressed is not None:
            candidates = [press_surfaces(hand, finger, contacts, which, found, self.phase, self.profile)]
            paths = [self.gentle.path.of(finger.dofs)]
            self.note_jumps(finger, self.gentle.jumps)
            self.closing.append(finger)
        else:
            wanted = ContactPath([contacts[i] for i in which], self.profile, which, self.after)
            candidates = press_points(hand, finger, wanted, found.angles, found.points_l)
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
        obstacles = Obstacles(self.hand, body, self.spec.table)
        tried: list[tuple[float, str, JointPath]] = []
        gentle = self.gentle
        for last_part, order in itertools.product(LAST_PARTS, ORDERS):
            if tried:  # at first they follow theirs already
                gentle = self.gentle_path(order, last_part)
                self.follow_all(gentle.path)
                for finger in self.closing:
                    self.note_jumps(finger, gentle.jumps)
            met = obstacles.meet(self.path.q, self.times, (1 - last_part) * self.impact, self.impact)
            if met is None:
                return
            tried.append((met.depth, met.text, gentle.path))
        _, why, path = min(tried, key=lambda one: one[0])
        self.follow_all(path)
        self.clear = False
        self.notes.append(why)
        self.remedies.append(f"{why}: choose another start, or another grasp")

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
            start, goal, zero = (
                self.start[finger.dofs],
                self.hand.configuration({name: angles})[finger.dofs],
                np.zeros(finger.n),
            )
            self.follow(finger, approach(self.times, self.profile.final_time, start, (goal, zero, zero)))

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
        kind = self.spec.acceleration_at_start
        return motion.come_after(
            approach(self.before, self.before[-1], start, motion.start, acceleration_at_start=kind)
        )

    def gentle_path(self, order: Order = "together", last_part: float = LAST_PARTS[0]) -> Gentle:
        """The path of a closing hand over both phases, the joints of a finger moving together or in turn."""
        motion, hand = self.phase.path, self.hand
        rise, jumps = gentle_approach(
            self.before,
            self.before[-1],
            self.start,
            motion.start,
            limits=(hand.lower, hand.upper),
            windows=take_turns([finger.dofs for finger in self.closing], hand.n, order),
            last_part=last_part,
        )
        return Gentle(motion.come_after(rise), jumps)

    def note_jumps(self, finger: Finger, jumps: BoolArray) -> None:
        """Note which of a finger's joints are among those (n,) that jump into their motion."""
        jumping = ", ".join(name for name, jump in zip(finger.actuated, jumps[finger.dofs]) if jump)
        note = f"{jumping} jumps into its motion at impact: a limit leaves no room to accelerate"
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
                int(motion.errors.max() > TRACKED)
                + bool(motion.limited or find_outside_limits(self.hand, finger, path.q))
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
        outside = [
            (joint, name_displacement(hand, joint, by)) for joint, by in find_outside_limits(hand, finger, path.q)
        ]
        stopped = [
            f"{joint} was stopped by its limit at {name_limit(hand, joint, motion.q[-1, i])} in the grasp phase"
            for i, joint in enumerate(finger.actuated)
            if joint in motion.limited
        ]
        self.notes += stopped
        self.notes += [f"{joint} leaves its limits by {by} in the approach" for joint, by in outside]
        if off_path(motion, self.profile).any() if closed else motion.errors.max() > TRACKED:
            self.on_path = False
            own = [self.problem.contacts[i] for i in which]

            step = float(self.after[1] - self.after[0])
            self.remedies.append(explain_miss(finger, own, motion, stopped, closed, step))
        elif stopped and not closed:
            self.within_limits = False
            self.remedies.append(f"{'; '.join(stopped)}: widen the limit, or choose another contact posture")
        if outside:
            self.within_limits = False
            swinging = ", ".join(f"{joint} (by {by})" for joint, by in outside)
            self.remedies.append(
                f"{swinging} swings beyond its limits in the approach: choose another start, or touch later"
            )

    def result(self, postures: dict[str, int]) -> Motion:
        """The motion with its torques; ``postures`` were tried by finger."""
        hand, path, gravity_o = self.hand, self.path, self.problem.gravity_o
        # The deceleration ends at t_F, and its torques with it: one more sample, at rest.
        still = np.zeros((1, hand.n))
        moving = (np.vstack([path.q, path.q[-1:]]), np.vstack([path.dq, still]), np.vstack([path.ddq, still]))
        total = inverse_dynamics(hand, *moving, gravity_o=gravity_o)
        total, holding = total[:-1] + self.contact_torques, total[-1] + self.contact_torques[-1]
        self.notes += beyond_limits(hand, np.vstack([total, holding])).values()
        settled = self.problem.compliance.normal_force(self.profile.final_depth)
        if self.pressed is not None and self.pressed.rest.balanced:
            settled = self.pressed.rest.normal
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
            settled_forces=frozen(np.array(settled)),
            forces_o=frozen(np.concatenate([np.zeros((self.impact, self.problem.k, 3)), self.forces_o])),
            contact_velocities=frozen(self.velocities),
            tracking_error=frozen(self.tracking),
            slip=frozen(self.slip),
            postures=postures,
            peak_torque=float(np.abs(total).max()),
            remedy=". ".join(self.remedies),
            closing_stiffness=None if self.pressed is None else soften_servos(hand, self.contact_torques[-1]),
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
