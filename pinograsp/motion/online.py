"""Contact forces and joint torques tick by tick, in a control loop of about 1 kHz."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, TypedDict, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp import core
from pinograsp.checks import (
    are_rotations,
    array_of,
    each_of,
    flag,
    instance_of,
    integer,
    number,
    one_of,
    shorten,
)
from pinograsp.contacts import PALM
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import ForceProblem
from pinograsp.hands import HandModel
from pinograsp.spatial import Array, IntArray

Invalid: TypeAlias = Literal["raise", "keep"]

_HUGE, _FAR = 1e12, 1e6  # loads [N, N m]; positions [rad, m] and friction: beyond them numbers mean nothing
_MOST = 50  # Newton steps of one try; a warm start needs one to five
_STATUS = {core.CONVERGED: Status.OK, core.INFEASIBLE: Status.INFEASIBLE, core.STALLED: Status.INACCURATE}


class LoopSettings(TypedDict, total=False):
    """Settings of :class:`OnlineForces` that a controller in C++ has, too."""

    normal_forces: tuple[ArrayLike, ArrayLike]
    max_rate: float
    ramp: float
    period: float
    max_steps: int


class OnlineForces:
    """Forces that hold a changing load, with joint torques. All memory is allocated here; :meth:`step` only computes.

    Every tick minimises the sum of squares of normal and tangential forces (a torsional moment counts as the tangential
    force that uses as much friction) under balance, friction and the limits of F_n, from the last tick's multipliers: a
    strongly convex problem, so the forces change no more abruptly than the load does. Solved to 1e-11 of the load by
    Newton's method on the dual (:mod:`pinograsp.core`), in a bounded number of steps. If a load cannot be balanced, the
    residual is the least that any forces within the limits leave, to 1e-8 of the load (1e-6 with torque limits), proven
    by a bound. If a joint would exceed its limit, the tick is solved again by interior points, with rows for the
    joints; this takes a tenth of a millisecond more for a dozen contacts, and half a millisecond if the load cannot be
    held. The same happens at every tick if fewer drives than joints produce the torques
    (``TorqueLimits.underactuation``). If no forces at all keep the joints within their limits, these are ignored.

    Attributes:
        forces: (k, 3) in the contacts' axes [N].
        moments: about the normals (k,) [N m].
        torques: (n,) [N m], empty without a hand.
        positions: for position servos without feed-forward (n,) [rad or m]: q + torques / stiffness, the references at
            which they produce these torques; empty without ``stiffness``.
        residual: net wrench of forces and load (6,), about the centre of mass [N, N m].
        status: ``OK``; ``INFEASIBLE``: no forces within the limits of this tick, its rates and ramps included, balance
            the load, and none leave less (least squares; moments over the problem's moment length); ``INACCURATE``:
            neither is proven within the allowed steps, these are the closest forces found; ``INVALID_INPUT``: with
            ``invalid="keep"``, an unusable tick, which changed nothing.
        steps: Newton steps of the last tick.
        names: names of the contacts.
        least, largest: limits of F_n (k,) [N], which you may change between ticks: ``online.largest = 5.0`` for all
            contacts, checked; or one of them in place, ``online.largest[0] = 5.0``, unchecked.

    The other arrays are overwritten by the next step: copy what must stay.

    Example:
        >>> import pinograsp as pg
        >>> plan = pg.load_case("paper").plan()
        >>> online = pg.OnlineForces(plan.problem, hand=plan.hand, q=plan.motion.q[-1])
        >>> forces, torques, status = online.step(plan.problem.load)
        >>> print(status, forces[:, 2].round(1), torques.shape)
        ok [11.2  6.1  4.9] (20,)

    See Also:
        :class:`~pinograsp.forces.ForceSolver`; :meth:`~pinograsp.planner.GraspPlan.to_core` writes the same loop for
        C++.
    """

    def __init__(
        self,
        problem: ForceProblem,
        *,
        hand: HandModel | None = None,
        q: ArrayLike | None = None,
        normal_forces: tuple[ArrayLike, ArrayLike] | None = None,
        max_rate: float | None = None,
        ramp: float = 0.1,
        period: float = 1e-3,
        max_steps: int = _MOST,
        stiffness: ArrayLike | None = None,
        invalid: Invalid = "raise",
    ):
        """Prepare the loop, once, from a grasp.

        Args:
            problem: contacts, friction (a cone, soft fingers or a 4-edge pyramid), balance, gravity, and the limits of
                its ``torques``, which hold at the posture of the tick, with the couplings of an underactuated hand.
                Its load is not used.
            hand: the hand whose torques are needed; None: only forces.
            q: its posture (n,) [rad]; default: the contacts' own.
            normal_forces: least and largest F_n [N], numbers or (k,); default: up to what the problem's largest depth
                and its ``max_normal_force`` allow, from the least force of its range of impact times. The loop finds
                the least squeeze for the load that you pass. For pushes that nobody measures, keep a share of a plan's
                squeeze as the least, ``normal_forces=(0.9 * plan.forces.normal_forces, cap)``.
            max_rate: largest |dF_n/dt| [N/s]; None: any.
            ramp: time in which a contact is gained or lost [s].
            period: of the loop [s].
            max_steps: largest number of Newton steps of one attempt.
            stiffness: of the hand's position servos, one number or (n,) [N m/rad or N/m], for ``positions``.
            invalid: what a tick with unusable numbers does (such as NaN from a sensor): ``"raise"``, or ``"keep"`` the
                last forces, torques and positions, with the status ``INVALID_INPUT``.

        Raises:
            InvalidInput: an argument cannot be used; the message gives the reason.
            ExtraMissing: the compiled core is not installed.
        """
        instance_of("problem", problem, ForceProblem)
        instance_of("hand", hand, HandModel, type(None))
        friction = problem.friction
        if not friction.separates:
            raise InvalidInput(
                f"OnlineForces: expected a cone, soft fingers or 4 edges, got a pyramid with {friction.edges}"
            )
        if problem.torques is not None and (hand is None or len(problem.torques.limit) != hand.n):
            raise InvalidInput("OnlineForces: torque limits need the hand whose joints they are for: give hand=...")
        self.problem, self.hand, self.names = problem, hand, problem.contacts.names
        self.period = number("period", period, above=0, unit="s")
        ramp = number("ramp", ramp, at_least=0, unit="s")
        rate = np.inf if max_rate is None else number("largest rate", max_rate, above=0, unit="N/s") * self.period
        if hand is None and q is not None:
            raise InvalidInput("OnlineForces: q is a posture of the hand: give hand=..., too")
        least, largest = self._range(normal_forces)
        links = np.zeros((0, 3), dtype=np.int64) if hand is None else self._attach(hand, q)
        self._setup = self._list_sizes() | {
            "ramp": min(1.0, self.period / ramp) if ramp else 1.0,
            "most_steps": integer("most steps", max_steps, at_least=1, at_most=10_000),
            "most_rate": rate,
            "links": links.tolist(),
        }
        try:
            setup = core.load().OnlineSetup()
            for name, value in self._setup.items():
                setattr(setup, name, value)
            self._loop = loop = core.load().Loop(setup)
        except ValueError as error:  # the core's own limits of sizes; the message names the field
            value = shorten(self._setup.get(str(error)))
            raise InvalidInput(f"OnlineForces: expected a {error} of usual size, got {value}") from None
        self._tick = loop.step
        self.forces, self.moments, self.residual, self.torques = loop.forces, loop.moments, loop.residual, loop.torques
        self.status = Status.OK
        loop.com[:] = problem.contacts.com_o
        self._place(problem.contacts.points_o, problem.contacts.rotations_oc)
        loop.rub(np.array(problem.mu))
        loop.least[:], loop.largest[:] = least, largest
        if hand is not None:
            # Pinocchio's own memory: it follows the posture.
            loop.hand(self._data.J.T.reshape(-1), self._gravity)
            if problem.torques is not None:
                loop.torque_limit[:] = problem.torques.usable
        self._keeps = one_of("invalid", invalid, get_args(Invalid)) == "keep"
        self._give = self._servos(stiffness)
        self.positions = np.zeros(0) if self._give is None else self._posture.copy()

    def _list_sizes(self) -> dict[str, Any]:
        """What the core is set up with of the problem and the hand."""
        problem, friction, torques = self.problem, self.problem.friction, self.problem.torques
        under = None if torques is None else torques.underactuation
        return {
            "contacts": problem.k,
            "components": friction.d,
            "round": friction.round_dimensions,
            "moments": problem.rows == 6,
            "torsion": friction.torsion,
            "arm": problem.moment_length,
            "safety": friction.safety,
            "joints": 0 if self.hand is None else self.hand.n,
            "limited": [] if torques is None else np.flatnonzero(torques.limited).tolist(),
            "couplings": 0 if under is None else len(under.rows),
            "coupling_rows": np.zeros((0, 0)) if under is None else np.array(under.rows, dtype=float),
            "coupled": np.zeros(0) if under is None else np.array(under.torques, dtype=float),
            "stops": [] if under is None else under.stops.tolist(),
            "borne": 0.0 if under is None else float(under.friction),
        }

    @property
    def least(self) -> Array:
        """Least F_n of the contacts (k,) [N], from the next tick on."""
        least: Array = self._loop.least
        return least

    @least.setter
    def least(self, given: ArrayLike) -> None:
        self._loop.least[:] = self._range((given, self.largest))[0]

    @property
    def largest(self) -> Array:
        """Largest F_n of the contacts (k,) [N], from the next tick on."""
        largest: Array = self._loop.largest
        return largest

    @largest.setter
    def largest(self, given: ArrayLike) -> None:
        self._loop.largest[:] = self._range((self.least, given))[1]

    @property
    def steps(self) -> int:
        """Newton steps of the last tick."""
        steps: int = self._loop.steps
        return steps

    def constants(self) -> dict[str, Any]:
        """Return the loop's settings and present state as plain values, for controllers in C++.

        Keys are those of ``pinograsp::core::OnlineSetup`` and ``Online`` (``pinograsp/core/online.hpp``), and
        ``contact_names``, ``joint_names``, the hand's ``posture`` (n,), ``period`` [s] and the problem's ``load`` (6,).
        """
        loop, hand = self._loop, self.hand
        state = {name: getattr(loop, name) for name in ("com", "points", "mu", "least", "largest", "torque_limit")}
        state["rotations"] = loop.rotations
        if hand is not None:
            state |= {"jacobian": self._data.J.T, "gravity": self._gravity, "posture": self._posture}
        names = {"contact_names": list(self.names), "joint_names": [] if hand is None else list(hand.joint_names)}
        plain = {name: np.asarray(one).tolist() for name, one in (self._setup | state).items()}
        return names | {"period": self.period, "load": self.problem.load.tolist()} | plain

    def _servos(self, stiffness: ArrayLike | None) -> Array | None:
        """How far servos give way by an effort of 1 (n,)."""
        if stiffness is None:
            return None
        if self.hand is None:
            raise InvalidInput("stiffness: expected with a hand, whose servos have it: give hand=..., too")
        given = each_of("stiffness", stiffness, self.hand.n)
        if given.min() <= 0:
            raise InvalidInput(f"stiffness: expected values above 0 [N m/rad or N/m], got {shorten(given.tolist())}")
        return 1.0 / given

    def _range(self, given: tuple[ArrayLike, ArrayLike] | None) -> Array:
        """Least and largest F_n of the contacts (2, k) [N]."""
        problem = self.problem
        if given is None:
            # A loop holds, however the impact was: of the limits of Eqs. (13) the depth alone counts, which the
            # material bears.
            low, _ = problem.normal_force_range(problem.impact_time_range[1])
            high = np.full(problem.k, problem.deepest_force)
            high = high if problem.max_normal_force is None else np.minimum(high, problem.max_normal_force)
            return np.array([np.minimum(low, high), high])
        try:
            least, largest = given
        except (TypeError, ValueError):
            raise InvalidInput(f"normal forces: expected (least, largest) [N], got {shorten(given)}") from None
        both = np.array(
            [each_of("least normal forces", least, problem.k), each_of("largest normal forces", largest, problem.k)]
        )
        if np.any(both[0] < 0) or np.any(both[0] > both[1]):
            raise InvalidInput(
                f"normal forces: expected 0 <= least <= largest [N], got {both[0].tolist()} and {both[1].tolist()}"
            )
        return both

    def _attach(self, hand: HandModel, q: ArrayLike | None) -> IntArray:
        """Take in the hand's model, at its posture q (n,); contact, column of the Jacobian and joint of each joint that
        moves a contact (p, 3).
        """
        contacts = self.problem.contacts
        links: list[tuple[int, int, int]] = []
        self._model = hand.model.copy()
        self._model.gravity.linear = np.array(self.problem.gravity_o)
        self._data = self._model.createData()
        for i, contact in enumerate(contacts):
            if not contact.link:
                raise InvalidInput("OnlineForces: expected contacts of a hand; these were made without one (hand=None)")
            if contact.finger == PALM:
                continue
            finger = hand.finger(contact.finger)
            joint = finger.joint_of(contact.link)
            while joint:
                # A joint that follows others has a column of its own, which counts for the one that it follows.
                links.append((i, self._model.joints[joint].idx_vExtended, self._model.joints[joint].idx_v))
                joint = self._model.parents[joint]
        posture = contacts.posture if q is None else q
        if posture is None:
            raise InvalidInput("OnlineForces: these contacts have no posture: give q=..., the hand's joint positions")
        self._posture = np.zeros(hand.n)
        self._move(array_of("q", posture, (hand.n,)))
        return np.array(links, dtype=np.int64).reshape(-1, 3)

    def _move(self, q: Array) -> None:
        self._posture[:] = q
        pin.computeJointJacobians(self._model, self._data, q)
        self._gravity = pin.computeGeneralizedGravity(self._model, self._data, q)

    def _place(self, points: Array, rotations: Array) -> None:
        self._loop.place(points - self._loop.com, np.ascontiguousarray(rotations))

    def engage(self, contact: str | int, touches: bool = True, *, at_once: bool = False) -> None:
        """Gain or lose a contact (name or number).

        If it is gained, the limits of its force rise from zero in the time ``ramp``. If it is lost, its force falls to
        zero in that time, or as fast as ``max_rate`` allows if that takes longer. The others take over as fast as
        ``max_rate`` allows: give them time by a longer ``ramp``. Use ``at_once`` for a finger that has slipped off: it
        has no force from the next tick on.
        """
        if isinstance(contact, str):
            contact = self.names.index(one_of("contact", contact, self.names))
        contact = integer("contact", contact, at_least=-len(self.names), at_most=len(self.names) - 1)
        self._loop.engage(contact % len(self.names), flag("touches", touches), flag("at_once", at_once))

    def reset(self) -> None:
        """Forget the last tick: the next one starts cold, and its forces may change at any rate."""
        self._loop.reset()

    def step(
        self,
        load: ArrayLike,
        *,
        q: ArrayLike | None = None,
        poses: ArrayLike | None = None,
        mu: ArrayLike | None = None,
    ) -> tuple[Array, Array, Status]:
        """Return forces (k, 3) [N], torques (n,) [N m] and status for the load of this tick.

        Args:
            load: external wrench on the object (6,), linear first, about the centre of mass, world axes [N, N m].
            q: the hand's posture (n,) [rad]; default: the last.
            poses: contact frames (k, 4, 4) in the world, z the inward normal; default: the last.
            mu: friction coefficients (k,) or one; default: the last.

        Raises:
            InvalidInput: shapes that do not fit, a number that is not finite or absurdly large, mu < 0; nothing changes
                then. With ``invalid="keep"`` it is a status instead.
        """
        try:
            if q is not None or poses is not None or mu is not None:
                load = _check_array("load", load, (6,), _HUGE)
                self._update(q, poses, mu)
            try:
                code = self._tick(load)
            except TypeError:  # no array of six numbers
                code = self._tick(_check_array("load", load, (6,), _HUGE))
            if code < 0:
                _check_array("load", load, (6,), _HUGE)
                limits = (self.least, self.largest)
                if not all(np.all(one >= 0) and np.all(np.isfinite(one)) for one in limits):
                    told = " and ".join(shorten(one.tolist()) for one in limits)
                    raise InvalidInput(f"OnlineForces: expected finite least and largest >= 0 [N], got {told}")
                raise InvalidInput(f"OnlineForces: expected contacts and gravity torques below {_HUGE:g}")
        except InvalidInput:
            if not self._keeps:
                raise
            self.status = Status.INVALID_INPUT
            return self.forces, self.torques, self.status
        self.status = status = _STATUS[code]
        self.place_servos(self.torques)
        return self.forces, self.torques, status

    def place_servos(self, torques: Array) -> Array:
        """The ``positions`` for torques (n,) [N m or N]; empty without ``stiffness``."""
        if self._give is not None:
            np.multiply(torques, self._give, out=self.positions)
            self.positions += self._posture
        return self.positions

    def _update(self, q: ArrayLike | None, poses: ArrayLike | None, mu: ArrayLike | None) -> None:
        # All checked before anything changes.
        k = self.problem.k
        posture = frames = None
        if q is not None:
            if self.hand is None:
                raise InvalidInput("q: expected none, there is no hand")
            posture = _check_array("q", q, (self.hand.n,), _FAR)
        if poses is not None:
            frames = _check_array("poses", poses, (k, 4, 4), _FAR)
            if not are_rotations(frames[:, :3, :3]).all():
                raise InvalidInput("poses: expected contact frames with orthonormal right-handed rotations")
        if mu is not None:
            each = _check_array("mu", each_of("mu", mu, k), (k,), _FAR)
            if each.min() < 0:
                raise InvalidInput(f"mu: expected friction coefficients >= 0, got {shorten(each.tolist())}")
            self._loop.rub(each)
        if frames is not None:
            self._place(frames[:, :3, 3], frames[:, :3, :3])
        if posture is not None:
            self._move(posture)
            self._loop.gravity(self._gravity)


def _check_array(name: str, value: ArrayLike, shape: tuple[int, ...], limit: float) -> Array:
    """A contiguous array of finite numbers up to ``limit``; quick where it is one."""
    if type(value) is np.ndarray and value.shape == shape and value.dtype == np.float64 and value.flags.c_contiguous:
        array: Array = value
    else:
        array = array_of(name, value, shape)
    if not np.vdot(array, array) < limit * limit and not np.abs(array).max() < limit:  # the first is quicker
        array_of(name, array, shape)
        raise InvalidInput(f"{name}: expected numbers below {limit:g}, got {array.tolist()}")
    return array
