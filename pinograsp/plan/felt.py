"""What a controller of a grip is told at a tick, and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from pinograsp.spatial import Array


class Measured(NamedTuple):
    """A measured quantity.

    Attributes:
        value: the numbers; if one is not finite, the whole measurement is ignored.
        time: time of the measurement [s].
    """

    value: Array
    time: float


class Felt(NamedTuple):
    """The measurements at a tick; None if nothing new has come.

    Attributes:
        time: of the tick, on the clock of the measurements [s].
        forces: on the object, in the contacts' axes (k, 3) [N].
        normal_forces: of the contacts (k,) [N].
        slips: slip speeds of the contacts (k,) [m/s]; a sensor that only detects slip gives 0 or 1.
        torques: of the joints' drives (n,) [N m or N].
        joint_positions: (n,) [rad or m].
        wrench: wrench of the hand on the object (6,), world axes, linear first, about the object's planned centre of
            mass, such as from a wrist's sensor after subtracting the hand's own weight [N, N m].
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
    """The commands of the drives.

    Attributes:
        torques: added to those of the servos (n,) [N m or N].
        references: positions that the servos hold (n,) [rad or m]; None: as the plan has them.
    """

    torques: Array
    references: Array | None = None


Controller: TypeAlias = Callable[[Felt], Command]
