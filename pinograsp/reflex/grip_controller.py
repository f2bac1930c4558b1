"""A squeeze that reacts to measured load, friction and slip, tick by tick."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import null_space

from pinograsp import core
from pinograsp.checks import array_of, each_of, instance_of, number, shorten
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import ForceProblem, TorqueLimits
from pinograsp.hands import HandModel
from pinograsp.motion import OnlineForces, torque_limits
from pinograsp.plan.felt import Command, Felt
from pinograsp.spatial import Array

# Of the core's kinds of measurements, in its order.
_KINDS = ("forces", "normal_forces", "slips", "torques", "wrench", "acceleration")
_STATUS = {core.CONVERGED: Status.OK, core.INFEASIBLE: Status.INFEASIBLE, core.STALLED: Status.INACCURATE}
_SINGULAR = 1e-3  # of the largest torque that a force makes: what makes less is not told by torques


class GripSettings(TypedDict, total=False):
    """Settings of :class:`GripController`."""

    max_normal_force: ArrayLike | None
    latency: float
    noise: float
    scale: float
    margin: float
    kept: float
    release: float
    max_rate: float | None
    period: float
    stiffness: ArrayLike | None


class GripController:
    """Controls the squeeze of a hand that holds an object: forces, torques and position references from the sensors, at
    each tick.

    Each quantity (:class:`~pinograsp.reflex.Felt`: forces, normal forces, slip, torques, a wrist's wrench, the arm's
    acceleration) may be given, missing or late; the controller ignores unusable values. Its law:

    - It commands the planned forces plus internal forces, which do not push the object; the servos' stiffness holds the
      weight, as planned. The internal forces are those of the least-squares solution for the measured load
      (:class:`~pinograsp.motion.OnlineForces`), with the estimated friction divided by ``margin``.
    - The estimate of friction is the planned one until a contact slips; then it is the ratio at which that contact
      slips, also for all contacts that have not slipped. It is never less than the ratio at which a contact has held.
    - If the contacts with most of the squeeze slip, the planned squeeze jumps, with its proportions unchanged, to 1.8
      times the commanded one, at most to the caps; it jumps again when the sensors have seen the first jump. The same
      happens if no forces hold the load with that friction.
    - Without slip the squeeze is released slowly, to no less than ``kept`` of the planned squeeze in proportion to load
      over friction, and for at least two fifths of the planned load, because a support may let go at once. If slip or
      load is not measured, the squeeze rises to one and a half times the planned one, and stays.
    - It slowly corrects forces that are measured too high or too low; what it has taken off returns at once if more
      force is needed.
    - Without any measurement for 50 ms it releases nothing (``blind``).

    No command exceeds the caps of F_n or the joints' torque limits; a joint at its limit also limits all others, so
    that none of them pushes the object away. The law runs in the compiled core (``pinograsp/core/grip.hpp``), in
    bounded time, without allocation.

    Attributes:
        forces: commanded, on the object, in contact axes (k, 3) [N].
        torques: (n,) [N m or N].
        load: measured external wrench on the object (6,), about its centre of mass, world axes [N, N m].
        load_bound: three standard deviations of its force, or more if it has just changed or swings [N]; infinity: no
            load is measured.
        object_mass: mass that corresponds to the load [kg].
        mu: estimated friction (k,).
        mu_low: lower bound of friction: the contact has held at a somewhat larger ratio (k,).
        mu_high: the largest ratio at which the contact has slipped, noise included (k,); infinity: it has not. A
            contact that turns as it slips, or that slips in part first, has slightly more friction.
        slipping: which contacts slip, as far as it is measured (k,), 0 or 1.
        reflexes: how often the squeeze has jumped.
        blind: whether nothing has been measured for a while.
        status: ``OK``; ``INFEASIBLE``: no forces hold the measured load with the estimated friction within the limits,
            so the planned forces are scaled up; ``INACCURATE``: the same, because none were found; ``INVALID_INPUT``: a
            time that does not increase.

    The next step overwrites the arrays: copy what you keep.
    """

    def __init__(
        self,
        problem: ForceProblem,
        *,
        hand: HandModel,
        q: ArrayLike,
        forces: ArrayLike,
        torques: ArrayLike,
        torque_limit: ArrayLike | None = None,
        max_normal_force: ArrayLike | None = None,
        latency: float = 0.0,
        noise: float = 0.1,
        scale: float = 0.1,
        margin: float = 1.25,
        kept: float = 0.45,
        release: float = 0.4,
        max_rate: float | None = None,
        period: float = 1e-3,
        stiffness: ArrayLike | None = None,
    ):
        """Prepare the controller, once, from a grasp; from a plan use
        :meth:`pinograsp.planner.GraspPlan.grip_controller`.

        Args:
            problem: contacts, friction, load and limits, as planned.
            hand: the hand.
            q: its posture (n,) [rad or m].
            forces: planned, on the object, in contact axes (k, 3) [N].
            torques: torques that hold it there (n,) [N m or N].
            torque_limit: of the joints (n,) [N m or N]; infinity or None: none.
            max_normal_force: caps of F_n, one number or (k,) [N]; None: those of the problem's largest depth and its
                ``max_normal_force``.
            latency: time from a command to the measurement of its effect [s].
            noise: standard deviation of measured forces and torques, as a share of them.
            scale: standard deviation of the constant error of a joint's torque, as a share; bounds from torques allow
                for it.
            margin: safety factor: friction is used up to the estimate divided by it.
            kept: share of the planned squeeze that is kept, in proportion to load over friction.
            release: time in which the squeeze falls to 1/e [s].
            max_rate: largest |dF_n/dt| of the commanded forces [N/s]; None: any.
            period: of the loop [s].
            stiffness: of the hand's position servos, one number or (n,) [N m/rad or N/m]: commands then have the
                references at which servos without feed-forward produce the torques.

        Raises:
            InvalidInput: an argument cannot be used; the message gives the reason.
            ExtraMissing: the compiled core is not installed.
        """
        instance_of("problem", problem, ForceProblem)
        k, n = problem.k, instance_of("hand", hand, HandModel).n
        f = array_of("forces", forces, (k, 3))
        holding = array_of("torques", torques, (n,))
        posture = array_of("q", q, (n,))
        limits_of_force = None if max_normal_force is None else (0.0, each_of("caps", max_normal_force, k))
        # Its own margin takes the place of the plan's safety factor.
        problem = replace(problem, friction=replace(problem.friction, safety=1.0))
        self.loop = OnlineForces(
            problem,
            hand=hand,
            q=posture,
            normal_forces=limits_of_force,
            max_rate=max_rate,
            period=period,
            stiffness=stiffness,
        )
        caps = self.loop.largest.copy()
        if np.any(caps < f[:, 2] * (1.0 - 1e-9)):
            raise InvalidInput(
                f"caps: expected at least the planned normal forces {shorten(f[:, 2].round(3).tolist())} N, got "
                f"{shorten(caps.tolist())} N"
            )
        self._caps = caps
        self.period, self.names = self.loop.period, problem.contacts.names
        limits = torque_limits(hand, problem.contacts, posture, gravity_o=problem.gravity_o)
        self._setup = _describe_grasp(problem, limits, f, holding) | {
            "period": self.period,
            "latency": number("latency", latency, at_least=0, at_most=10, unit="s"),
            "noise": number("noise", noise, at_least=0, at_most=10),
            "scale": number("scale", scale, at_least=0, at_most=10),
            "margin": number("margin", margin, at_least=1, at_most=1e3),
            "kept": number("kept", kept, at_least=0, at_most=1e3),
            "release": number("release", release, above=0, unit="s"),
            "torque_limit": np.full(n, np.inf) if torque_limit is None else _limits_of(torque_limit, n),
            "most": caps,
        }
        setup = core.load().GripSetup()
        for name, value in self._setup.items():
            setattr(setup, name, value)
        try:
            self._grip = grip = core.load().Grip(self.loop._loop, setup)
        except ValueError as error:  # the message names the field
            value = shorten(self._setup.get(str(error)))
            raise InvalidInput(f"GripController: expected a {error} of usual size, got {value}") from None
        self.forces, self.torques, self.load = grip.forces, grip.torques, grip.load
        self.mu, self.mu_low, self.mu_high, self.slipping = grip.mu, grip.mu_low, grip.mu_high, grip.slipping
        self.status = Status.OK
        self._servos = stiffness is not None

    @property
    def load_bound(self) -> float:
        """Three standard deviations of the load's force [N]; infinity: no load is measured."""
        bound: float = self._grip.load_bound
        return bound

    @property
    def object_mass(self) -> float:
        """Mass that corresponds to the load [kg]."""
        mass: float = self._grip.mass
        return mass

    @property
    def reflexes(self) -> int:
        """How often the squeeze has jumped."""
        count: int = self._grip.reflexes
        return count

    @property
    def blind(self) -> bool:
        """Whether nothing has been measured for a while."""
        blind: bool = self._grip.blind
        return blind

    @cached_property
    def _loop_without_limits(self) -> OnlineForces:
        """A loop without floors and torque limits."""
        return OnlineForces(replace(self.loop.problem, torques=None), normal_forces=(0.0, self._caps))

    def find_least_squeeze(self) -> float:
        """Compute the sum of the normal forces that the measured load needs with the estimated friction, without a
        margin, by least squares [N]; infinity: no forces hold it within the caps. Solved on request, not at every tick.
        """
        forces, _, status = self._loop_without_limits.step(self.load, mu=self.mu)
        return float(forces[:, 2].sum()) if status is Status.OK else np.inf

    def reset(self) -> None:
        """Forget all measurements: the next tick starts from the plan."""
        self._grip.reset()

    def step(self, felt: Felt) -> Command:
        """Return the commands of the drives at a tick.

        Raises:
            InvalidInput: a measurement of another shape. Unusable numbers are ignored.
        """
        grip = self._grip
        for kind, name in enumerate(_KINDS):
            if (measured := getattr(felt, name)) is not None:
                try:
                    grip.feel(kind, measured.value, measured.time)
                except (TypeError, ValueError):
                    grip.feel(kind, self._read(name, measured.value), measured.time)
        code = grip.tick(felt.time)
        self.status = _STATUS.get(code, Status.INVALID_INPUT)
        return Command(self.torques, self.loop.place_servos(self.torques).copy() if self._servos else None)

    __call__ = step

    def _read(self, name: str, value: object) -> Array:
        """A measurement that is no array of the size that the core asks for."""
        k, n = len(self.names), len(self.torques)
        shapes: dict[str, tuple[int, ...]] = {"forces": (k, 3), "torques": (n,), "wrench": (6,), "acceleration": (3,)}
        shape = shapes.get(name, (k,))
        try:
            values = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise InvalidInput(f"felt {name}: expected numbers of shape {shape}, got {shorten(value)}") from None
        if values.shape != shape:
            raise InvalidInput(f"felt {name}: expected shape {shape}, got {values.shape}")
        return values

    def constants(self) -> dict[str, Any]:
        """Return the controller's settings as plain values, for controllers in C++.

        Keys are those of ``pinograsp::core::GripSetup`` (``pinograsp/core/grip.hpp``), whose other fields keep their
        defaults; under ``loop`` those of :meth:`~pinograsp.motion.OnlineForces.constants`.
        """
        return {name: np.asarray(one).tolist() for name, one in self._setup.items()} | {"loop": self.loop.constants()}


def _describe_grasp(problem: ForceProblem, limits: TorqueLimits, forces: Array, holding: Array) -> dict[str, Any]:
    """The linear maps of a grasp that the core asks for."""
    rotations, G, k = problem.contacts.rotations_oc, np.array(problem.contacts.G), problem.k
    joint_map = np.einsum("kxn,kxc->nkc", limits.jacobian[:, :3], rotations).reshape(-1, 3 * k)
    rows = np.array(G)
    rows[3:] /= problem.moment_length
    basis = null_space(rows)
    rank = np.linalg.matrix_rank(joint_map, tol=_SINGULAR * np.linalg.norm(joint_map, 2))
    return {
        "gravity": problem.gravity_o.tolist(),
        "load": problem.load.tolist(),
        "tells_load": bool(rank == 3 * k),
        "planned": forces,
        "grasp_map": G,
        "internal": basis @ basis.T,
        "joint_map": joint_map,
        "from_torques": np.linalg.pinv(joint_map, rcond=_SINGULAR),
        "bias": holding - joint_map @ forces.ravel(),
        "mu": np.array(problem.mu),
    }


def _limits_of(limit: ArrayLike, n: int) -> Array:
    values = np.array(np.broadcast_to(np.asarray(limit, dtype=float), (n,)))
    if np.any(np.isnan(values)) or np.any(values < 0):
        raise InvalidInput(f"torque limits: expected numbers from 0 on, got {shorten(values.tolist())}")
    return values
