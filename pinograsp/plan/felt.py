"""What a controller of a grip is told at a tick, and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from pinograsp.spatial import Array


class Measured(NamedTuple):
    """A measured quantity.

    Attributes:
        value: the numbers; with one that is not finite nothing of it was measured.
        time: when they were measured [s].
    """

    value: Array
    time: float


class Felt(NamedTuple):
    """What is measured at a tick: None where nothing new has come.

    Attributes:
        time: of the tick, on the clock of the measurements [s].
        forces: on the object, in the contacts' axes (k, 3) [N].
        normal_forces: of the contacts (k,) [N].
        slips: how fast the contacts slip (k,) [m/s]; a sensor that only tells whether they do gives 0 or 1.
        torques: of the joints' drives (n,) [N m or N].
        joint_positions: (n,) [rad or m].
        wrench: what the hand exerts on the object (6,), world axes, linear first, about the object's centre of mass as
            it is planned, as a wrist's sensor tells it where the hand's own weight is taken off [N, N m].
        acceleration: of the hand's base (3,), world axes, without gravity [m/s^2].
    """

    time: float
    forces: Measured | None = None
    normal_forces: Measured | None = None
    slips: Measured | None = None
    torques: Measured | None = None
    joint_positions: Measured | None = None
    wrench: Measured | None = None
    acceleration: Measured | None = None


class Command(NamedTuple):
    """What the drives are sent.

    Attributes:
        torques: added to the servos' (n,) [N m or N].
        references: positions that the servos hold (n,) [rad or m]; None: as the plan has them.
    """

    torques: Array
    references: Array | None = None


Controller: TypeAlias = Callable[[Felt], Command]
