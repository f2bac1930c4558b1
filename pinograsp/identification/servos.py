"""Stiffness of position servos: from the duty that they give a position error, and from what their motor is."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import alike, array_of, items_of, number, one_line, path_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.estimates import Estimate
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Motor:
    """An identified motor of a servo, with its gears.

    Attributes:
        torque_constant: [N m/A] at the output.
        resistance: [ohm].
        friction: Coulomb friction without load [N m]; None if it is not known.
        viscous: viscous friction [N m s/rad]; None if it is not known.
        armature: inertia at the output [kg m^2]; None if it is not known.
    """

    torque_constant: float
    resistance: float
    friction: float | None = None
    viscous: float | None = None
    armature: float | None = None

    def __post_init__(self) -> None:
        for name in ("torque_constant", "resistance"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0))
        for name in ("friction", "viscous", "armature"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, number(name, getattr(self, name), at_least=0))

    def damping(self) -> float:
        """Back-EMF and viscous friction at constant voltage [N m s/rad]: k_t^2 / R + viscous."""
        return self.torque_constant**2 / self.resistance + (self.viscous or 0.0)


def read_bam(path: str | Path) -> Motor:
    """Read a motor from a file of Rhoban's BAM (JSON with ``kt``, ``R``, ``armature``, ``friction_base``).

    Raises:
        InvalidInput: the file is missing, or is not of this kind.
    """
    path = path_of("motor", path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InvalidInput(f"motor {path}: expected JSON, got {one_line(error)}") from None
    if not isinstance(found, dict) or not {"kt", "R"} <= found.keys():
        raise InvalidInput(f"motor {path}: expected kt and R, as files of BAM have them, got neither")
    return Motor(
        torque_constant=found["kt"],
        resistance=found["R"],
        friction=found.get("friction_base"),
        viscous=found.get("friction_viscous"),
        armature=found.get("armature"),
    )


def read_duty(path: str | Path) -> tuple[Array, Array]:
    """Read position errors (m,) [rad] and duty per error and unit of P (m,) [1/rad] from a CSV file of two columns.

    Raises:
        InvalidInput: the file is missing, or is not such a table.
    """
    path = path_of("duty", path)
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            rows = [[float(cell) for cell in line[:2]] for line in list(csv.reader(stream))[1:] if line]
    except (OSError, ValueError, csv.Error) as error:
        raise InvalidInput(
            f"duty {path}: expected two columns of numbers below a header, got {one_line(error)}"
        ) from None
    table = array_of(f"duty {path}", rows, (None, 2))
    return table[:, 0], table[:, 1]


def identify_servo_stiffness(
    errors: ArrayLike, duties: ArrayLike, motors: Iterable[Motor], *, voltage: float, gain: float
) -> Estimate:
    """Identify the stiffness of a position servo at rest [N m/rad]: k_t V / R times the duty per position error.

    A servo adds duty to compensate for its friction, a constant above errors of some steps; the stiffness is the slope
    beyond, by least squares of duty over error.

    Args:
        errors: position errors (m,) [rad].
        duties: duty per error and unit of the proportional gain (m,) [1/rad], at these errors.
        motors: identified motors of one type.
        voltage: of the supply [V].
        gain: the proportional gain P of the servo's register.

    Returns:
        The median over the motors, and the least and the largest of them.

    Raises:
        InvalidInput: values that are not numbers, fewer than three errors, no motor.
    """
    error, duty = array_of("errors", errors, (None,)), array_of("duties", duties, (None,))
    alike("errors, duties", error, duty)
    units = items_of("motors", motors, Motor)
    if len(error) < 3 or np.ptp(error) == 0 or not units:
        raise InvalidInput(f"expected three position errors and one motor or more, got {len(error)} and {len(units)}")
    slope = float(np.polyfit(error, error * duty, 1)[0])
    volts, p = number("voltage", voltage, above=0, unit="V"), number("gain", gain, above=0)
    found = [slope * p * volts * unit.torque_constant / unit.resistance for unit in units]
    return Estimate(float(np.median(found)), min(found), max(found))
