"""The steps of a carry plan: the fastest timing, its moving average, the forces on the way, the record."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from pinograsp.carry.binding import binding_of
from pinograsp.carry.doubts import doubts_of, doubts_of_path, doubts_of_squeeze
from pinograsp.carry.loads import Carried, CarryScenario
from pinograsp.carry.passage import Held, Passage
from pinograsp.carry.path import ArmPath
from pinograsp.carry.program import CarrySolution
from pinograsp.carry.programs import ArmLimits, Programs
from pinograsp.carry.record import CarryPlan
from pinograsp.carry.reserve import disturbance_of, spare_forces, with_reserve
from pinograsp.carry.solving import solve
from pinograsp.carry.squeeze import CommonSqueeze, common_squeeze
from pinograsp.carry.timing import Timing
from pinograsp.checks import read_only
from pinograsp.errors import CarryInfeasible, CarryUndecided, PinograspError, Status
from pinograsp.forces import ConvexSolution, TorqueLimit, diagnose, optimize_forces
from pinograsp.hands import HandModel
from pinograsp.motion import MotionSpec, plan_motion, torque_limits
from pinograsp.plan import Motion
from pinograsp.planner import GraspPlan
from pinograsp.spatial import Array

ACCURACY = 1e-7  # relative, of the duration
_CURVE = 1e-6  # of how fast each interval may be passed by itself
_FORCES = 1e-6  # relative, of the squared forces
_SLOWER, _SLOWER_ALONE = 1e-6, 2e-5  # squared speeds less than the fastest: there is room for a choice of forces
_BALANCED, _LEAST = 1e-6, 1e-3  # errors of the loads, and the gap, with which chosen forces are good enough
_FREE = 1.05  # an interval that may be passed so many times as fast is bound by nothing
_WINDOWS = 1.5 ** np.arange(12)  # times the ramp, or the smallest, tried against a limit of the jerk
_SMALLEST = 0.02  # [s] of these, where no ramp is asked for
_NEAR = 1e-4  # relative, of the normal forces that a hand closes to
_MOST = 10.0  # times as fast as a known timing: what is beyond does not matter
_HALVINGS = 9  # of the interval in which the largest factor on the speed lies
_GIVING = 1e-2  # joints that move a contact less than this, over the largest, do not press it
_FREELY = 2e-2  # motions along the surface less than this, over the largest, are let be
_IMPACT = 0.9  # t_I over t_F where a force problem asks for one: how fast the hand closed does not matter any more
_AT_REST = 1e-3  # [rad/s or m/s]
_TRIED = 60  # points of the path at which a proof is looked for


class Carrying:
    """What is carried along which path, within what limits; ``count``: intervals."""

    def __init__(
        self,
        *,
        robot: HandModel,
        grasp: GraspPlan,
        path: ArmPath,
        scenarios: tuple[CarryScenario, ...],
        limits: ArmLimits,
        torque_limit: TorqueLimit,
        reserve: float,
        gravity: Array,
        count: int,
        disturbance: float | None,
    ):
        self.robot, self.grasp, self.limits = robot, grasp, limits
        self.reserve, self.gravity, self.count = reserve, gravity, count
        # The planned object first: loads and torques of the plan are its own. Friction counts at its least, so that
        # scenarios of the same loads are one; sorted, since even rounding should not depend on their order.
        planned, others = (1.0, (0.0, 0.0, 0.0)), {(one.mass, tuple(np.asarray(one.com).tolist())) for one in scenarios}
        loads = [planned, *sorted(others - {planned})]
        self.carried = [Carried.of(robot, grasp, CarryScenario(mass=mass, com=com)) for mass, com in loads]
        self.path = self.carried[0].of_arm(path)
        mu = min((1.0, *(one.mu for one in scenarios)))
        self.problem, self.range_n = with_reserve(grasp, self.carried[0], reserve, torque_limit, mu)
        self.disturbance = disturbance_of(grasp, self.carried[0].body, disturbance)
        self.spare = spare_forces(self.problem, *self.disturbance)
        if np.any(short := self.spare >= self.range_n[1]):
            weak = int(np.argmax(short))
            raise CarryInfeasible(
                f"contact '{self.problem.contacts.names[weak]}' would have to keep {self.spare[weak]:.3g} N to bear "
                f"the disturbances, and may press with {self.range_n[1][weak]:.3g} N: bear smaller ones (disturbance=)",
                at=0.0,
                solution=None,
            )

    def _programs(self, s: Array, knots: Array) -> Programs:
        """Programs at samples s (N,) and ends of intervals (N + 1,)."""
        slopes, found = self.carried[0].slopes(self.path, knots), list[Programs]()
        for carried in reversed(self.carried):
            loads = carried.along(self.path, s, self.gravity)
            others = found[::-1] if carried is self.carried[0] else ()
            found.append(
                Programs(self.problem, self.range_n, carried, self.limits, loads, slopes, others, spare=self.spare)
            )
        return found[-1]

    def fastest(self) -> Passage:
        """The fastest timing of the path from rest to rest, with its lower bound."""
        s = np.linspace(0.0, 1.0, self.count + 1)
        middle = (s[:-1] + s[1:]) / 2.0
        programs = self._programs(middle, s)
        found = solve(programs.program(), accuracy=ACCURACY)
        if not found.converged:
            raise self._failure(programs, middle, found)
        y = found.y * (1.0 - _SLOWER)
        timing = Timing.of_squares(s, y)
        # Half the way of an interval, at its acceleration.
        b, a = (y[:-1] + y[1:]) / 2.0, np.diff(y) * self.count / 2.0
        instants = timing.times[:-1] + (s[1] - s[0]) / (timing.speed[:-1] + np.sqrt(b))
        return Passage(
            timing=timing,
            instants=instants,
            knots=timing.times,
            places=programs,
            programs=programs.timed(a, b, y, _MOST),
            level=1.0,
            free=np.ones(self.count),
            found=found,
            fastest=True,
        )

    def passage(self, timing: Timing) -> Passage:
        """A known timing, and how many times as fast each interval of it may be passed."""
        knots = np.linspace(0.0, timing.duration, self.count + 1)
        instants = (knots[:-1] + knots[1:]) / 2.0
        moving, ends = timing.at(instants), timing.at(knots)
        places = self._programs(moving.s, ends.s)
        programs = places.timed(moving.acceleration, moving.speed**2, ends.speed**2, _MOST)
        found, free = self._fastest_anywhere(programs)
        if not found.converged:
            raise self._failure(programs, moving.s, found)
        return Passage(
            timing=timing,
            instants=instants,
            knots=knots,
            places=places,
            programs=programs,
            level=1.0,
            free=free,
            found=found,
        )

    def smoothed(self, timing: Timing, ramp: float, jerk: Array | None) -> Passage:
        """The fastest of some moving averages of a timing, over ``ramp`` [s] at least, that keeps to the limits."""
        best: Passage | None = None
        for window in [ramp] if jerk is None else (ramp or _SMALLEST) * _WINDOWS:
            passage = self.passage(timing.smoothed(float(window)))
            factor = min(passage.factor, 1.0)
            if jerk is not None:
                times = np.linspace(0.0, passage.timing.duration, 4 * self.count + 1)
                factor = min(
                    factor, float(((1.0 - self.reserve) * jerk / self._jerk(passage.timing, times)).min()) ** (1 / 3)
                )
            passage = passage.faster(factor)
            if best is not None and passage.timing.duration >= best.timing.duration:
                break
            best = passage
        assert best is not None
        return best

    def _jerk(self, timing: Timing, times: Array) -> Array:
        """Largest |jerk| of each joint (n,) [rad/s^3 or m/s^3]."""
        moving = timing.at(times)
        _, slope, bend, twist = self.path.at(moving.s)
        v, a, j = (part[:, None] for part in moving[1:])
        jerk = np.abs(slope * j + 3.0 * bend * v * a + twist * v**3).max(axis=0)
        found = np.full(self.robot.n, 1e-12)
        found[self.carried[0].moving(self.path)] = np.maximum(jerk, 1e-12)
        return found

    def least(self, passage: Passage) -> Held:
        """The forces of least squares at every sample."""
        found = solve(passage.programs.gentlest(np.full(self.count + 1, passage.level)), accuracy=_FORCES)
        # Which forces are taken matters less than that they balance the loads.
        least = found.residual < _BALANCED and found.gap < _LEAST
        notes = () if least else ("the forces bear the loads, but they are not the least ones",)
        if found.residual >= _BALANCED and passage.fastest:
            found = passage.found
        if found.residual >= _BALANCED:
            raise CarryUndecided(
                f"no forces were found for a timing that has them: balance to {found.residual:.1e} after "
                f"{found.rounds} rounds",
                solution=found,
            )
        x = found.x[:, : self.problem.k].copy()
        x[..., -1] += self.spare
        return Held(passage=passage, x=x, commanded=x[..., -1], residual=found.residual, notes=notes)

    def common(self, passage: Passage, rate: float, *, slower: bool) -> Held:
        """Normal forces that are commanded once, or change at no more than ``rate`` [N/s].

        ``slower``: whether to slow down where there are none at this speed; otherwise that is an error.
        """
        every = [passage.programs, *passage.programs.others]
        steps = np.diff(passage.instants)

        def at(factor: float) -> CommonSqueeze:
            return common_squeeze(every, steps / factor, rate, passage.level * factor**2)

        found, factor = at(1.0), 1.0
        if not found.found:
            low, high, best = 0.0, 1.0, None
            for _ in range(_HALVINGS):
                factor = (low + high) / 2.0
                tried = at(factor)
                low, high, best = (factor, high, tried) if tried.found else (low, factor, best)
            kind = "constant squeeze" if not rate else f"squeeze that changes by at most {rate:g} N/s"
            at_rest = "not even at rest" if best is None else f"at {low:.3g} times that speed there is one"
            if best is None or not slower:
                proven = ", proven" if found.ruled_out else ""
                raise CarryInfeasible(
                    f"no {kind} bears the whole way at this speed{proven}; {at_rest}: let the squeeze follow the loads "
                    "(squeeze='least'), or go slower",
                    at=float(passage.timing.at(passage.instants).s[int(passage.free.argmin())]),
                    solution=found,
                    factor=low,
                )
            found, factor = best, low
        return Held(passage=passage.faster(factor), x=found.x[0], commanded=found.commanded, residual=found.residual)

    def too_fast(self, passage: Passage) -> Exception:
        """Why a given timing cannot be: where there are no forces, with the proof, and how fast it may be."""
        slow = int(passage.free.argmin())
        s = passage.timing.at(passage.instants).s
        turns = doubts_of_path(self.robot, self.path)
        if over := self._beyond(passage.programs, slow, passage.level):
            return CarryInfeasible(
                f"at {passage.instants[slow]:.4g} s, {100 * s[slow]:.3g} % of the path, this speed asks for {over} "
                f"(less {100 * self.reserve:g} %); "
                + "; ".join([f"{passage.factor:.4g} times the speed is within the limits", *turns]),
                at=float(s[slow]),
                solution=passage.found,
                factor=passage.factor,
            )
        proof = self._proof(passage.programs, slow, passage.level)
        if proof is None:
            return CarryUndecided(
                f"no forces were found at {100 * s[slow]:.3g} % of the path at this speed, and none are ruled out",
                solution=passage.found,
            )
        return CarryInfeasible(
            f"at {passage.instants[slow]:.4g} s, {100 * s[slow]:.3g} % of the path, the grasp cannot hold the "
            f"object at this speed, with what is kept free (proven): {_in_words(proof)}; {passage.factor:.4g} times "
            "the speed can be held: go slower, squeeze from other sides, keep less free",
            at=float(s[slow]),
            solution=proof,
            factor=passage.factor,
        )

    def _beyond(self, programs: Programs, i: int, level: float) -> str:
        """Which limit of the joints an interval breaks at a squared speed of timed loads, whatever the forces; ""."""
        ends = np.maximum(np.abs(programs.slopes[i]), np.abs(programs.slopes[i + 1])) * np.sqrt(level)
        fast = ends / self.limits.speed
        found = [(float(fast.max()), f"speed of {self.robot.joint_names[int(fast.argmax())]}")]
        C, c, words = programs.arm_rows
        if words:  # over what their limits leave of what is there at rest
            over = C[i].sum(axis=1) * level + (1.0 - c[i])
            found.append((float(over.max()), words[int(over.argmax())]))
        share, what = max(found)
        return f"{share:.4g} times the largest {what}" if share > 1.0 else ""

    def _proof(self, programs: Programs, i: int, level: float) -> ConvexSolution | None:
        """That there are no forces at a sample, at the squared speed of timed loads (0: at rest), in any scenario."""
        for one in (programs, *programs.others):
            held = replace(one.problem, min_normal_force=None, max_normal_force=self.range_n[1] - self.spare)
            torques = held.torques
            # What contacts keep to bear disturbances is not there to bear the load.
            normals = np.column_stack([np.zeros((held.k, 2)), self.spare]).ravel()
            kept = self.spare[:, None] * held.contacts.rotations_oc[:, :, 2]
            if torques is not None:
                own = one.middle.torque.squared(level)[i, one.carried.of_hand]
                spare = np.einsum("kxn,kx->n", torques.jacobian[:, :3], kept)
                torques = replace(torques, bias=own + spare)
            wrench = one.middle.wrench.squared(level)[i] - held.contacts.G @ normals
            found = optimize_forces(
                replace(held, load=-wrench, torques=torques), _IMPACT * held.final_time, objective="peak"
            )
            if found.infeasibility is not None:
                return found
        return None

    def _failure(self, programs: Programs, s: Array, found: CarrySolution) -> Exception:
        """Why there is no timing: where the object cannot even be held at rest, with the proof."""
        for i in np.unique(np.linspace(0, len(s) - 1, min(len(s), _TRIED)).astype(int)).tolist():
            proof = self._proof(programs, i, 0.0)
            if proof is not None:
                return CarryInfeasible(
                    f"at {100 * s[i]:.3g} % of the path the grasp cannot hold the object even at rest, with "
                    f"what is kept free (proven): {_in_words(proof)}; turn the hand less, squeeze from other "
                    "sides, keep less free",
                    at=float(s[i]),
                    solution=proof,
                    factor=0.0,
                )
        return CarryUndecided(
            f"no timing was found, and none is ruled out: relative gap {found.gap:.1e}, balance to "
            f"{found.residual:.1e} after {found.rounds} rounds; the arm may not bear the object at rest: see "
            "its torque limits",
            solution=found,
        )

    def record(self, held: Held, fastest: Passage | None, elapsed: dict[str, float]) -> CarryPlan:
        """The plan, as data."""
        passage, problem, x = held.passage, self.problem, held.x
        programs, carried, level = passage.programs, self.carried[0], passage.level
        loads, knots, s = programs.middle, passage.timing.at(passage.knots), passage.timing.at(passage.instants).s
        widths = problem.friction.scale(problem.mu)
        local = np.concatenate([x[..., :2] * widths[:, :2], x[..., -1:]], axis=2)
        torsion = x[..., 2] * widths[:, 2] if problem.friction.d == 4 else np.zeros(x.shape[:2])
        bare = loads.torque.squared(level)
        torques, told, sent = bare.copy(), bare.copy(), loads.q.copy()
        torques[:, carried.fingers] += self._contact_torques(local, torsion)
        closing, first = self._closing(held)
        reference = self.grasp.forces.final_depths if first is None else first.profile.final_depth
        sent[:, carried.fingers] = closing.q[-1][carried.finger_dofs] + self._deeper(held.commanded, reference)
        # What is commanded once has the tangential forces of the first load, when normal forces are the commanded ones.
        once = slice(0, 1) if not np.ptp(held.commanded, axis=0).any() else slice(None)
        pressed = np.broadcast_to(local[once], local.shape).copy()
        pressed[..., 2] = held.commanded
        told[:, carried.fingers] += self._contact_torques(pressed, np.broadcast_to(torsion[once], torsion.shape))
        limit, binding = self._limit(passage, fastest, s)
        return CarryPlan(
            robot=self.robot,
            grasp=self.grasp,
            path=self.path,
            gravity_o=read_only(self.gravity),
            timing=passage.timing,
            closing=closing,
            contacts=tuple(problem.contacts.names),
            s=read_only(knots.s),
            times=read_only(passage.knots),
            speed=read_only(knots.speed),
            instants=read_only(passage.instants),
            limit=read_only(limit),
            q=read_only(loads.q),
            dq=read_only(loads.speed * np.sqrt(level)),
            ddq=read_only(loads.acceleration.squared(level)),
            torques=read_only(torques),
            loads=read_only(-loads.wrench.squared(level)),
            forces_o=read_only(np.einsum("kij,nkj->nki", problem.contacts.rotations_oc, local)),
            normal_forces=read_only(x[..., -1]),
            commanded=read_only(held.commanded),
            commanded_q=read_only(sent),
            commanded_torques=read_only(told),
            torsion=read_only(torsion),
            friction_use=read_only(problem.friction.gauge(x[..., :-1]) / np.maximum(x[..., -1], 1e-300)),
            binding=binding,
            reserve=self.reserve,
            fastest=None if fastest is None else fastest.timing.duration,
            lower_bound=None if fastest is None else fastest.found.lower_bound,
            factor=passage.factor,
            residual=held.residual,
            elapsed=elapsed,
            notes=(*held.notes, *self._notes(passage)),
            cautions=self._cautions(first, closing, x[..., -1].max(axis=0), -loads.wrench.squared(level)),
            disturbance=self.disturbance,
        )

    def _cautions(self, first: ConvexSolution | None, closing: Motion, most: Array, loads: Array) -> tuple[str, ...]:
        """What speaks against the plan; ``most``: the largest normal forces (k,) [N]; ``loads`` (N, 6) [N, N m]."""
        arm = self.carried[0].arm
        own = doubts_of(self.grasp, arm_in_hand=bool(np.isin(arm, self.carried[0].of_hand).any()))
        own += doubts_of_path(self.robot, self.path)
        if first is None:
            if len(self.grasp.hand.drives) < 2:  # jaws press along their one way
                return tuple(own)
            return (
                *own,
                "no motion was found that closes the hand to the way's first squeeze: it goes on from the grasp's",
            )
        return (*own, *doubts_of_squeeze(self.grasp, first, closing, most, loads))

    def _notes(self, passage: Passage) -> list[str]:
        """What the caller should know about how the way begins and ends."""
        speed = passage.timing.at(passage.knots[[0, -1]]).speed[:, None] * self.path.at(np.array([0.0, 1.0])).slope
        fastest = float(np.abs(speed).max())
        if fastest < _AT_REST:
            return []
        return [f"the trajectory does not begin and end at rest: joints move by up to {fastest:.3g} rad/s or m/s there"]

    def _limit(self, passage: Passage, fastest: Passage | None, s: Array) -> tuple[Array, tuple[str, ...]]:
        """How fast each place may be passed by itself (N,) [1/s], and what binds there."""
        _, limit = self._fastest_anywhere((passage if fastest is None else fastest).places)
        if fastest is None:
            return limit, binding_of(passage.programs, passage.found, passage.free > _FREE)
        middle = (np.arange(self.count) + 0.5) / self.count
        words = binding_of(fastest.places, fastest.found)
        nearest = np.clip((s * self.count).astype(int), 0, self.count - 1)
        return np.interp(s, middle, limit), tuple(words[i] for i in nearest.tolist())

    def _fastest_anywhere(self, programs: Programs) -> tuple[CarrySolution, Array]:
        """How fast each interval may be passed by itself (N,)."""
        found = solve(programs.fastest_anywhere(), accuracy=_CURVE)
        return found, np.asarray(np.sqrt((1.0 - _SLOWER_ALONE) * found.y.reshape(self.count, 2).mean(axis=1)))

    @cached_property
    def _jacobian(self) -> Array:
        """Of the contact points (k, 6, n_h) in the joints of the grasp's hand, where the grasp was planned."""
        if self.problem.torques is not None:
            return self.problem.torques.jacobian
        carried = self.carried[0]
        posture = carried.posture[carried.of_hand]
        return torque_limits(carried.hand, self.problem.contacts, posture, limit=np.inf).jacobian

    def _closing(self, held: Held) -> tuple[Motion, ConvexSolution | None]:
        """How the grasp's hand closes to the first squeeze of the way, and the forces it then has.

        It is planned as any grasp's motion, since surfaces, friction and servos make more of it than depths along
        normals. Where that is not to be had, it is the grasp's own, and there are no forces.
        """
        grasp, normal, own = self.grasp, held.commanded[0], self.grasp.motion
        fingers = [(finger.name, finger.dofs) for finger in grasp.hand.fingers]
        spec = MotionSpec(
            start={name: own.q[0, dofs] for name, dofs in fingers},
            posture={name: own.q[own.impact, dofs] for name, dofs in fingers},
        )
        first = held.passage.programs.middle.wrench
        problem = replace(
            self.problem,
            load=-first.squared(held.passage.level)[0],
            gravity_o=-first.still[0, :3] / self.carried[0].inertia.mass,
            torques=None,
            # A little room, for rounding.
            min_normal_force=normal * (1.0 - _NEAR),
            max_normal_force=normal * (1.0 + _NEAR),
        )
        try:
            forces = optimize_forces(problem, grasp.forces.impact_time, objective="least_squares")
            if forces.found:
                motion = plan_motion(grasp.hand, forces, spec)
                if motion.status is Status.OK:
                    return motion, forces
        except PinograspError:
            pass
        return grasp.motion, None

    def _deeper(self, normal: Array, reference: Array) -> Array:
        """How much further the fingers' joints have to be (N, ...) for normal forces (N, k) than for depths (k,) [m].

        Of the ways to be deeper the one that moves contacts along the surface least: friction would hold against it.
        """
        law, dofs = self.problem.compliance, self.carried[0].finger_dofs
        depths = law.depth(np.maximum(normal, 0.0)) - reference
        moved = np.einsum("kxn,kxc->kcn", self._jacobian[:, :3, dofs], self.problem.contacts.rotations_oc)
        along, into = moved[:, :2].reshape(-1, len(dofs)), moved[:, 2]
        deeper = np.linalg.pinv(into, rcond=_GIVING)
        _, size, axes = np.linalg.svd(into)
        free = axes[int((size > _GIVING * size[0]).sum()) :].T
        drag, damping = along @ free, _FREELY * np.linalg.norm(along, 2)
        # Damped: what hardly moves contacts would have to go far.
        deeper -= free @ np.linalg.solve(drag.T @ drag + damping**2 * np.eye(free.shape[1]), drag.T @ along @ deeper)
        return np.asarray(depths @ deeper.T)

    def _contact_torques(self, local: Array, torsion: Array) -> Array:
        """J^T f of the fingers' joints (N, ...) [N m or N]."""
        contacts, J = self.problem.contacts, self._jacobian[..., self.carried[0].finger_dofs]
        forces = np.einsum("kij,nkj->nki", contacts.rotations_oc, local)
        moments = np.einsum("nk,kx->nkx", torsion, contacts.rotations_oc[:, :, 2])
        return np.asarray(np.einsum("kxj,nkx->nj", J[:, :3], forces) + np.einsum("kxj,nkx->nj", J[:, 3:], moments))


def _in_words(proof: ConvexSolution) -> str:
    """What is missing, which load and which friction would do."""
    first, *rest = diagnose(proof.problem, _IMPACT * proof.problem.final_time).text.splitlines()
    told = [first.partition(" s: ")[2].removesuffix(" (proven)")]
    told += [line.strip() for line in rest if "could be held" in line or "would do" in line]
    return "; ".join(told)
