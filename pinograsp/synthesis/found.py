"""Forces that hold what a hand has closed on: the judgement of a grasp."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from pinograsp import core
from pinograsp.checks import brief, instance_of
from pinograsp.contacts import (
    Closure,
    ContactSet,
)
from pinograsp.contacts.clearance import PALM
from pinograsp.contacts.doubt import DOUBTFUL, doubtful_share
from pinograsp.contacts.quality import ferrari_canny
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    ForceSolution,
    GraspConditions,
    Reserve,
    least_squeeze,
    load_factor,
    optimize_forces,
)
from pinograsp.forces.bulk.elastic import Grips, find_efforts
from pinograsp.forces.bulk.squeeze import Holding, find_hopeless, squeeze as squeeze_all
from pinograsp.forces.robust.reserve import held_body
from pinograsp.hands import HandModel, servo_gains
from pinograsp.motion import effort_of, pressing_together, torque_limits, torques_matter
from pinograsp.motion.holding import AWAY, TILTED, find_tilt, held_stiffness, push_away
from pinograsp.objects.body import Body
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array
from pinograsp.words import lines_of

_SHARP, _ROUGH, _POINTS = 0.1, 0.3, 20_000  # tolerance of the quality, of one of many; its effort
ROOMS = (0.0025, 0.005, 0.0075, 0.01, 0.015, 0.02)  # [m] of the open hand about the object: sizes that count
SOUND = 2  # rank of a grasp that withstands the reserve on contacts that are sure
# What a squeeze of the first rank may sum up to, and one that is not refined further: times the weight, or newtons per
# contact.
_CRUSHING, _GENTLE, _CRUMB = 15.0, 8.0, 0.15
# The certification's squeeze presses up to this times as hard as the least: beyond it no program is asked. And what
# stands for its effort where it finds none, so that the program is asked.
_HARDER, _TRIED = 2.0, 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundGrasp:
    """One grasp: the hand placed and closed so that it holds the object.

    Attributes:
        pose: oMh (4, 4), the hand's root frame in the world.
        closure: the hand closed there.
        forces: certified least-cost forces, at the impact time of the search.
        quality: what the contacts withstand in their weakest direction per newton of squeeze [-], moments over the
            reserve's arm, with the friction that the reserve relies on; 0 without force closure.
        squeeze: sum of the normal forces [N] of a squeeze that the hand can make, and that withstands the reserve
            within the torque limits; infinity: there is none. Without a reserve that of ``forces``.
        reserved: whether there is a reserve to withstand.
        displacement: of the object under the push of the reserve, so squeezed by the hand's own servos [m]; infinity:
            it leaves by itself. 0 without a reserve.
        tilt: of the object under its weight, once only the hand holds it [rad]; likewise.
        doubtful: share of that squeeze [-] that acts on edges of the object, where a small error turns it, or where a
            link is hollow behind its convex hull.
        energy: objective of the forces.
        load_factor: largest multiple of the load that can be held at that impact time.
        fingers: that touch, beside the palm.
        wanted_fingers: more of them rank no higher.
        room: how far the object may be displaced, along its table or anywhere, before the open hand is in its way [m],
            as far as that counts; 0 of power grasps.
        look_o: unit direction (3,) from where the fingers start to what is between their tips, in the world: the hand
            comes along it.
    """

    pose: Array
    closure: Closure
    forces: ForceSolution
    quality: float
    squeeze: float
    reserved: bool
    displacement: float
    tilt: float
    doubtful: float
    energy: float
    load_factor: float
    fingers: int
    wanted_fingers: int
    room: float = 0.0
    look_o: Array = field(default_factory=lambda: np.zeros(3))

    __repr__ = brief()
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        borne = f"a squeeze of {self.squeeze:.3g} N" if self.withstands else "no squeeze that has the reserve"
        on_edges = (
            f", {100 * self.doubtful:.0f} % of it on doubtful contacts" if self.doubtful and self.withstands else ""
        )
        return lines_of(
            f"{borne}{on_edges}; quality {self.quality:.3g}, holds up to {self.load_factor:.3g} times the load",
            *str(self.closure).split("\n"),
        )

    @property
    def withstands(self) -> bool:
        """Whether a squeeze withstands the reserve."""
        return self.squeeze < np.inf

    @property
    def sound(self) -> int:
        """2: withstands the reserve; 1: with doubtful contacts, a squeeze that crushes, or an object that gives way;
        0: does not withstand it.
        """
        firm = self.doubtful <= DOUBTFUL and self.displacement <= AWAY and self.tilt <= TILTED
        return int(self.withstands) * (SOUND if firm and not self.crushes else 1)

    @property
    def crushes(self) -> bool:
        """Whether its squeeze is more than many times the weight."""
        return not self._within(_CRUSHING)

    @property
    def gentle(self) -> bool:
        """Sound, by as many fingers as are wanted, with a squeeze that more of a search would hardly make less."""
        return self.sound == SOUND and self.fingers >= self.wanted_fingers and self._within(_GENTLE)

    def _within(self, times: float) -> bool:
        """Whether the squeeze sums up to no more than so many times the weight, or to next to nothing."""
        problem = self.forces.problem
        return self.squeeze <= max(times * float(np.linalg.norm(problem.load[:3])), _CRUMB * problem.k)

    @property
    def worth(self) -> tuple[float, ...]:
        """Of two grasps the one of which this is larger ranks first: sound ones; of others those in which the object
        gives way less; then by the fingers that take part, up to those wanted, since two soft fingertips need the least
        squeeze and nobody holds things so; then those that press gently; then by the room for an object that is not
        quite where it is said to be; then by the least squeeze that withstands the reserve; without one, since the
        cheapest balance is a cradle, by what they withstand in the weakest direction per newton.
        """
        fingers = min(self.fingers, self.wanted_fingers)
        away, tilt = max(self.displacement, AWAY), max(self.tilt, TILTED)
        order = (self.sound, -away, -tilt, fingers, self._within(_GENTLE), self.room if self.withstands else 0.0)
        return *order, -self.squeeze if self.reserved else 0.0, self.quality, self.load_factor


def hold(
    closure: Closure,
    conditions: GraspConditions,
    *,
    impact_time: float = 0.9,
    quick: bool = False,
    wanted_fingers: int = 2,
) -> tuple[str, FoundGrasp | None]:
    """Forces that hold a closed hand's object, as a grasp; and the outcome in words.

    ``wanted_fingers``: more of them rank no higher.

    ``quick``: to compare many, with the squeeze of the certification where that is good enough, which may press harder
    than the least that withstands the reserve, and of which it is not asked whether the hand can press its contacts
    together so; with a reserve the load factor is left out, as 0, and where a squeeze does, the quality, too, which is
    rough else.
    """
    instance_of("closure", closure, Closure)
    instance_of("conditions", conditions, GraspConditions)
    touching = [touch for touch in closure.touches if touch.finger]
    if len(touching) < 2:
        return "fewer than two contacts", None
    # Where the jaws have pushed the object, the hand goes instead: the object's place is given.
    closure = _move_hand(closure)
    contacts = closure.contacts()
    problem = problem_of(closure.hand, closure.object, contacts, conditions)
    forces = optimize_forces(problem, impact_time)
    if forces.status is not Status.OK or forces.certificate is None:
        return f"forces {forces.status}", None
    squeeze: Array | None = forces.normal_forces
    if conditions.reserve is not None:
        squeeze = _squeeze(closure, problem, conditions.reserve, quick)
    displacement, tilt = _yield(closure, problem, conditions.reserve, squeeze)
    borne = forces.normal_forces if squeeze is None else squeeze
    rough = quick and conditions.reserve is not None  # a squeeze alone ranks it, or else the quality
    return "holds", FoundGrasp(
        pose=closure.hand.pose,
        closure=closure,
        forces=forces,
        quality=0.0 if rough and squeeze is not None else _quality(problem, conditions.reserve, rough),
        squeeze=np.inf if squeeze is None else float(squeeze.sum()),
        reserved=conditions.reserve is not None,
        displacement=displacement,
        tilt=tilt,
        doubtful=doubtful_share(closure.hand, closure.object, contacts, borne),
        energy=forces.certificate.objective,
        load_factor=0.0 if rough else load_factor(problem, impact_time=impact_time),
        fingers=len({touch.finger for touch in touching} - {PALM}),
        wanted_fingers=wanted_fingers,
    )


def _yield(
    closure: Closure, problem: ForceProblem, reserve: Reserve | None, squeeze: Array | None
) -> tuple[float, float]:
    """How far the object, squeezed by normal forces (k,), gives way to the push of the reserve [m], and turns under its
    weight [rad].
    """
    if reserve is None or squeeze is None:
        return 0.0, 0.0
    hand, G, forces_c = closure.hand, problem.contacts.G, np.column_stack([np.zeros((problem.k, 2)), squeeze])
    # Forces that hold the weight keep an object that hangs below its contacts from turning.
    forces_c += (np.linalg.pinv(G) @ (-problem.load - G @ forces_c.ravel())).reshape(-1, 3)
    forces_c[:, 2] = np.maximum(forces_c[:, 2], 0.0)
    held = held_stiffness(hand, problem, forces_c, np.array(closure.q), servo_gains(hand))
    weight = held_body(problem).mass * float(np.linalg.norm(problem.gravity_o))
    return push_away(held, reserve.disturbance * weight), find_tilt(held, problem.load)


def _quality(problem: ForceProblem, reserve: Reserve | None, rough: bool) -> float:
    reserve = Reserve() if reserve is None else reserve
    return float(
        ferrari_canny(
            problem.contacts,
            problem.mu * (1.0 - reserve.friction),
            friction=replace(problem.friction, torsion=problem.friction.torsion * (1.0 - reserve.friction)),
            moment_length=reserve.arm(held_body(problem)) or None,
            balance=problem.balance,
            tolerance=_ROUGH if rough else _SHARP,
            limit=_POINTS,
        ).lower
    )


def _squeeze(closure: Closure, problem: ForceProblem, reserve: Reserve, quick: bool) -> Array | None:
    """Normal forces (k,) of a squeeze that withstands the reserve; None: there is none."""
    contacts, plain = problem.contacts, _is_plain(problem)
    if quick and plain:
        normal, effort = _squeeze_quickly(problem, reserve)
        if effort <= 1.0:
            return normal
        if effort > _HARDER:
            return None
    rows = np.zeros((0, problem.k))
    if contacts.posture is not None:
        rows = pressing_together(closure.hand, contacts, contacts.posture).rows
    # Of one mass there are half as many loads, for hands that the certification's squeeze does not know.
    rough = quick and not plain
    return least_squeeze(problem, replace(reserve, mass=0.0) if rough else reserve, rows=rows)


def _is_plain(problem: ForceProblem) -> bool:
    """Whether the certification's squeeze knows such problems."""
    free = problem.torques is None or problem.torques.underactuation is None
    return core.is_installed() and free and problem.rows == 6 and bool(problem.load.any())


def _squeeze_quickly(problem: ForceProblem, reserve: Reserve) -> tuple[Array, float]:
    """Normal forces (k,) of the certification's squeeze, and its largest share of a torque that may be used; without
    forces a bit more than one, or infinity where it is proven that no squeeze does.
    """
    contacts, torques = problem.contacts, problem.torques
    wrenches = reserve.load_set(held_body(problem), problem.gravity_o).loads - problem.load
    floor = problem.min_normal_force
    rotations = contacts.rotations_oc[None]
    cap = float(problem.compliance.force(problem.max_depth))
    holding = Holding(
        friction=problem.friction,
        mu=float(problem.mu.min()),
        weight=problem.load,
        cap=cap if problem.max_normal_force is None else min(cap, float(np.min(problem.max_normal_force))),
    )
    grips = Grips(
        points=(contacts.points_o - contacts.com_o)[None],
        rotations=rotations,
        counts=np.array([problem.k]),
        least=None if floor is None else np.broadcast_to(floor, (1, problem.k)),
    )
    wrenches = wrenches[np.abs(wrenches).max(axis=1) > 0]
    forces, (reacted, _) = squeeze_all(grips, holding, reserve, wrenches, 1)
    if not forces.found[0]:
        hopeless = find_hopeless(grips, holding, reserve, wrenches, reacted.normal, 1)
        return np.zeros(problem.k), np.inf if hopeless[0] else _TRIED
    if torques is None:
        return forces.local[0, :, -1], 0.0
    jacobians, bias = torques.jacobian[None], torques.bias[None]
    _, most = find_efforts(jacobians, rotations, bias, forces.local, reacted, threads=1)
    usable = torques.usable * (1.0 - reserve.torque)
    return forces.local[0, :, -1], float((most / usable).max(initial=0.0, where=np.isfinite(usable)))


def problem_of(hand: HandModel, body: Body, contacts: ContactSet, conditions: GraspConditions) -> ForceProblem:
    """The problem of holding an object with a closed hand, torques limited at the posture of the contacts."""
    problem = instance_of("conditions", conditions, GraspConditions).problem(body, contacts)
    limit = effort_of(hand, conditions.torque_limit)
    if conditions.torque_limit is None or not torques_matter(hand, limit):
        return problem
    if contacts.posture is None:
        raise InvalidInput("torque limits: expected contacts with a posture, as a closed hand's have: close the hand")
    torques = torque_limits(hand, contacts, contacts.posture, limit=limit, gravity_o=problem.gravity_o)
    return replace(problem, torques=torques)


def _move_hand(closure: Closure) -> Closure:
    """The same closure with the hand moved back instead of the object pushed."""
    if np.array_equal(closure.pushed, np.eye(4)):
        return closure
    back = pin.SE3(np.array(closure.pushed)).inverse()
    touches = tuple(
        replace(
            touch,
            point_o=back.act(touch.point_o),
            normal_o=back.rotation @ touch.normal_o,
            patch_o=touch.patch_o @ back.rotation.T + back.translation,
        )
        for touch in closure.touches
    )
    return replace(
        closure,
        hand=closure.hand.placed((back * pin.SE3(np.array(closure.hand.pose))).homogeneous),
        object=closure.object.placed((back * pin.SE3(np.array(closure.object.pose))).homogeneous),
        touches=touches,
        pushed=np.eye(4),
    )
