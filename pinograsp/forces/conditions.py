"""The conditions under which an object is to be held: a force problem whose contacts are not known yet."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pinograsp import defaults
from pinograsp.checks import array_of, brief, flag, floats_of, instance_of, number, one_of, shown
from pinograsp.contacts import Compliance, ContactSet, DecelerationShape, Friction
from pinograsp.contacts.compliance import MEASURES, Measure
from pinograsp.contacts.deceleration import bounds_of
from pinograsp.contacts.friction import LARGEST_MU
from pinograsp.contacts.quality import BALANCES, Balance
from pinograsp.errors import InvalidInput
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.reserve import Reserve
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

_LATER = ("torque_limit", "reserve", "table")  # what no problem has before the hand has closed, and where it is solved

TorqueLimit = Literal["effort"] | float | Array | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspConditions:
    """The force problem of a grasp whose contacts are not known yet.

    Attributes:
        mu: friction coefficient of all contacts [-].
        friction: the friction model with its safety factor; None: as :class:`ForceProblem` chooses it.
        compliance: the contact law.
        balance: ``"wrench"`` (forces and moments) or ``"force"`` (forces only).
        measure: grasp energy that is minimised, ``"impulse"`` [N s] or ``"work"`` [J].
        gravity_o: gravity (3,) [m/s^2].
        final_time: t_F [s].
        impact_time_range: admissible t_I [s] (Eq. 14).
        acceleration_range: admissible A [m/s^2] (Eq. 13c).
        max_speed: bound on A tau [m/s] (Eq. 13b).
        max_depth: bound on delta_F [m] (Eq. 13a).
        max_normal_force: cap on every F_n [N]; None: no cap.
        moment_length: moments are divided by this length so that they compare with forces [m]; None: the mean distance
            of the contacts from the centre of mass.
        shape: of the deceleration over the grasp phase.
        torque_limit: largest |torque| while the hand holds: ``"effort"`` (its own limits; joints without one are not
            limited), one number or (n,) [N m]; None: not limited.
        reserve: what the forces of a plan are to bear besides the weight; None: nothing.
        table: whether the object stands on a table, a plane across gravity under its lowest point: the hand keeps above
            it.
    """

    mu: float
    friction: Friction | None = None
    compliance: Compliance = field(default_factory=Compliance)
    balance: Balance = "wrench"
    measure: Measure = "impulse"
    gravity_o: Array = defaults.GRAVITY  # type: ignore[assignment]  # becomes an array in __post_init__
    final_time: float = defaults.FINAL_TIME
    impact_time_range: tuple[float, float] = defaults.IMPACT_TIMES
    acceleration_range: tuple[float, float] = defaults.ACCELERATIONS
    max_speed: float = defaults.MAX_SPEED
    max_depth: float = defaults.MAX_DEPTH
    max_normal_force: float | None = None
    moment_length: float | None = None
    shape: DecelerationShape = field(default_factory=DecelerationShape.constant)
    torque_limit: TorqueLimit = "effort"
    reserve: Reserve | None = field(default_factory=Reserve)
    table: bool = False

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self,
            *,
            mu: float,
            friction: Friction | None = ...,
            compliance: Compliance = ...,
            balance: Balance = ...,
            measure: Measure = ...,
            gravity_o: ArrayLike = ...,
            final_time: float = ...,
            impact_time_range: tuple[float, float] = ...,
            acceleration_range: tuple[float, float] = ...,
            max_speed: float = ...,
            max_depth: float = ...,
            max_normal_force: float | None = ...,
            moment_length: float | None = ...,
            shape: DecelerationShape = ...,
            torque_limit: TorqueLimit = ...,
            reserve: Reserve | None = ...,
            table: bool = ...,
        ) -> None: ...

    __repr__ = brief("mu", "friction", "balance", "measure", "torque_limit")

    def __post_init__(self) -> None:
        number("mu", self.mu, at_least=0, at_most=LARGEST_MU)
        for name, kind in (("compliance", Compliance), ("shape", DecelerationShape)):
            instance_of(name, getattr(self, name), kind)
        instance_of("friction", self.friction, Friction, type(None))
        instance_of("reserve", self.reserve, Reserve, type(None))
        flag("table", self.table)
        one_of("balance", self.balance, BALANCES)
        one_of("measure", self.measure, MEASURES)
        bounds = (self.final_time, self.impact_time_range, self.acceleration_range, self.max_speed, self.max_depth)
        for name, value in bounds_of(*bounds).items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "gravity_o", array_of("gravity", self.gravity_o, (3,)))
        if self.max_normal_force is not None:
            number("largest normal force", self.max_normal_force, above=0, unit="N")
        if self.moment_length is not None:
            number("moment length", self.moment_length, above=0, unit="m")
        given_limit(self.torque_limit)

    def problem(self, body: Body, contacts: ContactSet) -> ForceProblem:
        """The problem of holding ``body`` at these contacts, without torque limits and without the reserve.

        Raises:
            InvalidInput: times, ranges or limits that cannot be used.
        """
        own: dict[str, Any] = {one.name: getattr(self, one.name) for one in fields(self) if one.name not in _LATER}
        return ForceProblem.holding(body, contacts, **own)


def given_limit(torque_limit: TorqueLimit) -> Literal["effort"] | Array | None:
    """A ``torque_limit``, its numbers as an array [N m]; of how many joints is not looked at.

    Raises:
        InvalidInput: numbers that are not above 0, another text.
    """
    if torque_limit is None:
        return None
    if isinstance(torque_limit, str):
        one_of("torque limit", torque_limit, ("effort",))
        return "effort"
    limit = floats_of("torque limit", torque_limit)
    if not np.all(limit > 0):
        raise InvalidInput(
            f"torque limit: expected one number > 0 [N m], one for each joint, or 'effort', got {shown(torque_limit)}"
        )
    return limit
