"""What forces may be and how they are compared, whatever contacts and load: limits and their defaults, once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypedDict

from numpy.typing import ArrayLike

from pinograsp import defaults
from pinograsp.checks import array_of, brief, instance_of, one_of
from pinograsp.contacts import Compliance, DecelerationShape, Friction, MarhefkaOrin
from pinograsp.contacts.compliance import MEASURES, Measure, checked_law
from pinograsp.contacts.deceleration import CONSTANT, bounds_of
from pinograsp.contacts.quality import BALANCES, Balance
from pinograsp.spatial import Array


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: problems copy all attributes at once
class ForceSettings:
    """Settings and limits that force problems and grasp conditions share.

    Attributes:
        friction: the friction model with its safety factor; None: cones, or soft fingers (5 mm of torsion) if no more
            than two fingers touch, because these could not resist turning about their line otherwise. The grids need
            the paper's pyramid, ``Friction()``.
        compliance: the contact law.
        balance: ``"wrench"`` (forces and moments, the default) or ``"force"`` (forces only, the paper's Eq. 15).
        measure: grasp energy that is minimised, ``"impulse"`` [N s] (Eq. 11) or ``"work"`` [J] (Eq. 9).
        gravity_o: gravity (3,) [m/s^2]; it acts on the hand too, when joint torques are computed.
        final_time: t_F [s].
        impact_time_range: admissible t_I [s] (Eq. 14).
        acceleration_range: admissible A [m/s^2] (Eq. 13c).
        max_speed: bound on A tau [m/s] (Eq. 13b).
        max_depth: bound on delta_F [m] (Eq. 13a).
        moment_length: moments are divided by this length so that they compare with forces [m]; None: the mean distance
            of the contacts from the centre of mass.
        shape: of the deceleration over the grasp phase; constant by default, as in the paper.
    """

    friction: Friction | None = None
    compliance: Compliance = field(default_factory=MarhefkaOrin)
    balance: Balance = "wrench"
    measure: Measure = "impulse"
    gravity_o: Array = defaults.GRAVITY  # type: ignore[assignment]  # becomes an array in __post_init__
    final_time: float = defaults.FINAL_TIME
    impact_time_range: tuple[float, float] = defaults.IMPACT_TIMES
    acceleration_range: tuple[float, float] = defaults.ACCELERATIONS
    max_speed: float = defaults.MAX_SPEED
    max_depth: float = defaults.MAX_DEPTH
    moment_length: float | None = None
    shape: DecelerationShape = CONSTANT

    __repr__ = brief("balance", "measure", "friction", "compliance")

    def __post_init__(self) -> None:
        instance_of("friction", self.friction, Friction, type(None))
        checked_law(self.compliance)
        instance_of("shape", self.shape, DecelerationShape)
        one_of("balance", self.balance, BALANCES)
        one_of("measure", self.measure, MEASURES)
        object.__setattr__(self, "gravity_o", array_of("gravity", self.gravity_o, (3,)))
        bounds = (self.final_time, self.impact_time_range, self.acceleration_range, self.max_speed, self.max_depth)
        for name, value in bounds_of(*bounds).items():
            object.__setattr__(self, name, value)


class ForceArguments(TypedDict, total=False):
    """:class:`ForceSettings` as arguments: numbers and lists, where attributes are arrays."""

    friction: Friction | None
    compliance: Compliance
    balance: Balance
    measure: Measure
    gravity_o: ArrayLike
    final_time: float
    impact_time_range: tuple[float, float]
    acceleration_range: tuple[float, float]
    max_speed: float
    max_depth: float
    moment_length: float | None
    shape: DecelerationShape
