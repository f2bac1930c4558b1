"""The conditions under which an object is to be held: a force problem whose contacts are not known yet."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pinograsp.checks import brief, flag, floats_of, instance_of, number, one_of, shorten
from pinograsp.contacts import ContactSet
from pinograsp.contacts.friction import LARGEST_MU
from pinograsp.errors import InvalidInput
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.reserve import Reserve
from pinograsp.forces.settings import ForceArguments, ForceSettings
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

if TYPE_CHECKING:
    from typing_extensions import Unpack

_LATER = ("torque_limit", "reserve", "table")  # what no problem has before the hand has closed, and where it is solved

TorqueLimit = Literal["effort"] | float | Array | None


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspConditions(ForceSettings):
    """The force problem of a grasp whose contacts are not known yet.

    Attributes:
        mu: friction coefficient of all contacts [-].
        max_normal_force: cap on every F_n [N]; None: no cap. If a finger's closing table is known (its drive's data
            sheet), the plan asks for less, so that the finger keeps the cap in 95 % of its closings.
        torque_limit: largest |torque| while the hand holds: ``"effort"`` (its own limits; joints without one are not
            limited), one number or (n,) [N m]; None: not limited.
        reserve: what the forces of a plan withstand besides the weight; None: nothing.
        table: whether the object stands on a table, a plane perpendicular to gravity under its lowest point; the hand
            stays above it.

    Example:
        >>> import pinograsp as pg
        >>> reserve = pg.Reserve(disturbance=1.0)  # a push of a whole weight
        >>> conditions = pg.GraspConditions(mu=0.5, max_normal_force=8.0, reserve=reserve)
        >>> print(conditions.mu, conditions.max_normal_force, conditions.reserve.disturbance)
        0.5 8.0 1.0

    See Also:
        :class:`~pinograsp.forces.Reserve`, :class:`~pinograsp.contacts.Friction`;
        :func:`~pinograsp.planner.plan_grasp_on` plans under them.
    """

    mu: float
    max_normal_force: float | None = None
    torque_limit: TorqueLimit = "effort"
    reserve: Reserve | None = field(default_factory=Reserve)
    table: bool = False

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self,
            *,
            mu: float,
            max_normal_force: float | None = ...,
            torque_limit: TorqueLimit = ...,
            reserve: Reserve | None = ...,
            table: bool = ...,
            **settings: Unpack[ForceArguments],
        ) -> None: ...

    __repr__ = brief("mu", "friction", "balance", "measure", "torque_limit")

    def __post_init__(self) -> None:
        number("mu", self.mu, at_least=0, at_most=LARGEST_MU)
        super().__post_init__()
        instance_of("reserve", self.reserve, Reserve, type(None))
        flag("table", self.table)
        if self.max_normal_force is not None:
            number("largest normal force", self.max_normal_force, above=0, unit="N")
        if self.moment_length is not None:
            number("moment length", self.moment_length, above=0, unit="m")
        given_limit(self.torque_limit)

    def problem(self, body: Body, contacts: ContactSet) -> ForceProblem:
        """Return the problem of holding ``body`` at these contacts, without torque limits and without the reserve.

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
            f"torque limit: expected one number > 0 [N m], one for each joint, or 'effort', got {shorten(torque_limit)}"
        )
    return limit
