"""Taxels: raw counts of tactile arrays as normal forces and centres of pressure, of arrays and of a plan's contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import (
    array_of,
    at_least_zero,
    brief,
    each_of,
    floats_of,
    instance_of,
    items_of,
    number,
    read_only,
    share_of,
    shorten,
    text_of,
)
from pinograsp.errors import InvalidInput
from pinograsp.plan.felt import Measured
from pinograsp.plan.link_contacts import LinkContacts
from pinograsp.spatial import Array, BoolArray


class TaxelForces(NamedTuple):
    """Forces from raw counts of taxels; each array has the counts' shape.

    Attributes:
        forces: normal to the surface [N]; 0 for dead taxels.
        noise: standard deviation of these [N].
        dead: which counts are not those of a working taxel, NaN included.
        beyond: which forces are lower bounds, because the calibration ends there or the taxel is saturated.
    """

    forces: Array
    noise: Array
    dead: BoolArray
    beyond: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaxelCalibration:
    """Force by raw counts of a taxel: monotone, and straight between m knots. The function
    :func:`pinograsp.identification.identify_taxel` finds it from a log against a load cell.

    Attributes:
        counts: of the knots (m,), all rising or all falling, at rest first.
        forces: there (m,) [N], never falling, at rest 0.
        noise: standard deviation of a force there, hysteresis included (m,) [N].
        valid: least and largest count of a taxel that works.
        hysteresis: largest difference at one count between rising and falling forces [N]; None: it is not known.

    Raises:
        InvalidInput: the values do not describe such a curve.
    """

    counts: Array
    forces: Array
    noise: Array
    valid: tuple[float, float]
    hysteresis: float | None = None

    __repr__ = brief("counts", "forces", "noise", "valid", "hysteresis")

    def __post_init__(self) -> None:
        counts = array_of("counts of a taxel", self.counts, (None,))
        steps = np.diff(counts)
        if not len(steps) or not (np.all(steps > 0) or np.all(steps < 0)):
            raise InvalidInput(
                f"counts of a taxel: expected two or more that all rise or all fall, got {shorten(counts.tolist())}"
            )
        forces = array_of("forces of a taxel", self.forces, counts.shape)
        if forces[0] != 0 or np.any(np.diff(forces) < 0):
            raise InvalidInput(
                f"forces of a taxel: expected 0 at rest and values that never fall, got {shorten(forces.tolist())}"
            )
        noise = at_least_zero("noise of a taxel", each_of("noise of a taxel", self.noise, len(counts)))
        low, high = array_of("valid counts of a taxel", self.valid, (2,)).tolist()
        if not low <= counts.min() < counts.max() <= high:
            raise InvalidInput(
                f"valid counts of a taxel: expected {counts.min():g} to {counts.max():g}, those of the knots, within, "
                f"got {low:g} to {high:g}"
            )
        if self.hysteresis is not None:
            object.__setattr__(self, "hysteresis", number("hysteresis", self.hysteresis, at_least=0, unit="N"))
        for name, value in (("counts", counts), ("forces", forces), ("noise", noise), ("valid", (low, high))):
            object.__setattr__(self, name, value)

    def measure(self, raw: ArrayLike) -> TaxelForces:
        """Convert raw counts of any shape to forces; NaN is allowed.

        Raises:
            InvalidInput: not numbers.
        """
        values = floats_of("raw counts", raw)
        low, high = self.valid
        dead = ~((values >= low) & (values <= high))
        sign = 1.0 if self.counts[-1] > self.counts[0] else -1.0
        knots, given = sign * self.counts, np.where(dead, sign * self.counts[0], sign * values)
        return TaxelForces(
            np.interp(given, knots, self.forces), np.interp(given, knots, self.noise), dead, given > knots[-1]
        )


class TaxelReading(NamedTuple):
    """The reading of an array of t taxels.

    Attributes:
        normal_force: sum of the taxels' forces [N]; NaN: too many taxels are dead.
        noise: its standard deviation [N]; NaN without a force.
        centre_l: centre of pressure, in the link's frame (3,) [m]; NaN if nothing presses, or without a force.
        taxels: forces (t,) [N], their noise, which taxels are dead, and which forces are lower bounds.
    """

    normal_force: float
    noise: float
    centre_l: Array
    taxels: TaxelForces


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaxelArray:
    """An array of t taxels on a link.

    Attributes:
        link: its name.
        points_l: of the taxels, in the link's frame (t, 3) [m].
        normals_l: out of the link (t, 3), of any length.
        calibration: of all taxels, or one for each.
        most_dead: share of its taxels that may be dead [-]; these are left out. If more are dead, there is no force.

    Raises:
        InvalidInput: arrays that do not match, or normals of zero length.
    """

    link: str
    points_l: Array
    normals_l: Array
    calibration: TaxelCalibration | Sequence[TaxelCalibration]
    most_dead: float = 0.25

    __repr__ = brief("link", "points_l")

    def __post_init__(self) -> None:
        points = array_of("points of taxels", self.points_l, (None, 3))
        normals = array_of("normals of taxels", self.normals_l, (len(points), 3))
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        if not len(points) or not np.all(lengths > 0):
            raise InvalidInput("taxels: expected one or more with normals of some length, got none or one without")
        text_of("link of taxels", self.link)
        object.__setattr__(self, "points_l", points)
        object.__setattr__(self, "normals_l", read_only(normals / lengths))
        object.__setattr__(self, "most_dead", share_of("most_dead", self.most_dead))
        if not isinstance(self.calibration, TaxelCalibration):
            each = items_of("calibration of taxels", self.calibration, TaxelCalibration)
            if len(each) != len(points):
                raise InvalidInput(
                    f"calibration of taxels: expected one, or one for each of {len(points)}, got {len(each)}"
                )
            object.__setattr__(self, "calibration", each)

    def __len__(self) -> int:
        return len(self.points_l)

    def measure(self, raw: ArrayLike) -> TaxelReading:
        """Compute normal force and centre of pressure from raw counts (t,). Dead taxels are left out; if more than
        ``most_dead`` are dead, there is no force.

        Raises:
            InvalidInput: counts of another number.
        """
        counts = floats_of("raw counts", raw)
        if counts.shape != (len(self),):
            raise InvalidInput(f"raw counts of '{self.link}': expected shape ({len(self)},), got {counts.shape}")
        if isinstance(self.calibration, TaxelCalibration):
            taxels = self.calibration.measure(counts)
        else:
            found = [one.measure(count) for one, count in zip(self.calibration, counts)]
            taxels = TaxelForces(*(np.array(values) for values in zip(*found)))
        if taxels.dead.mean() > self.most_dead:
            return TaxelReading(np.nan, np.nan, np.full(3, np.nan), taxels)
        force, noise = float(taxels.forces.sum()), float(np.linalg.norm(taxels.noise[~taxels.dead]))
        return TaxelReading(force, noise, _centre(taxels.forces, self.points_l), taxels)


def _centre(forces: Array, points: Array) -> Array:
    """Of pressure (3,); NaN where nothing presses."""
    whole = forces.sum()
    return np.asarray(forces @ points / whole) if whole > 0 else np.full(3, np.nan)


class ContactReading(NamedTuple):
    """The reading of taxels at k contacts.

    Attributes:
        normal_forces: (k,) [N]; NaN: the contact is not measured.
        noise: standard deviation of these (k,) [N].
        centres_l: centres of pressure, in the frames of the links (k, 3) [m]; NaN: nothing presses, or it is not
            measured.
        beyond: which forces are lower bounds (k,).
        arrays: the reading of each array.
    """

    normal_forces: Array
    noise: Array
    centres_l: Array
    beyond: BoolArray
    arrays: tuple[TaxelReading, ...]

    def make_measurement(self, time: float, commanded: ArrayLike) -> Measured | None:
        """Return a measurement for ``Felt.normal_forces``; None: no contact is measured.

        A controller ignores a measurement in which a number is missing. Therefore contacts that are not measured get
        their commanded force, which changes nothing there; so do contacts whose force is a lower bound.

        Args:
            time: of the measurement [s].
            commanded: normal forces (k,) [N], such as ``controller.forces[:, 2]``.

        Raises:
            InvalidInput: commanded forces of another number.
        """
        told = ~np.isnan(self.normal_forces)
        wanted = array_of("commanded", commanded, self.normal_forces.shape)
        if not told.any():
            return None
        least = np.where(self.beyond, np.fmax(self.normal_forces, wanted), self.normal_forces)
        return Measured(np.where(told, least, wanted), time)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactTaxels:
    """The taxel arrays of a hand, as sensors of the k contacts of a plan.

    Each taxel belongs to the nearest planned contact on its link. Its force counts along that contact's normal, and not
    at all if the taxel faces away.

    Attributes:
        contacts: their places on the links: ``plan.contacts_on_links``.
        arrays: of taxels; several may be on one link.
        reach: a contact is measured if it has taxels within this distance [m] that face its way.
        most_dead: share of these that may be dead [-]; if more are dead, the contact is not measured.
        felt: which contacts have such taxels (k,).

    Raises:
        InvalidInput: not contacts and arrays, or contacts of a plan without its hand.
    """

    contacts: LinkContacts
    arrays: tuple[TaxelArray, ...]
    reach: float = 0.01
    most_dead: float = 0.25
    felt: BoolArray = field(init=False)
    _shares: Array = field(init=False, repr=False)  # of taxels' forces by contact (k, T)
    _near: BoolArray = field(init=False, repr=False)  # taxels that have to work (k, T)
    _points: Array = field(init=False, repr=False)  # of all taxels, in the frames of their links (T, 3) [m]

    __repr__ = brief("contacts", "arrays", "felt")

    def __post_init__(self) -> None:
        contacts = instance_of("contacts", self.contacts, LinkContacts)
        arrays = items_of("arrays", self.arrays, TaxelArray)
        reach = number("reach", self.reach, above=0, unit="m")
        if not arrays:
            raise InvalidInput("arrays: expected one or more of taxels, got none")
        links = np.array([array.link for array in arrays for _ in range(len(array))])
        points = np.concatenate([array.points_l for array in arrays])
        normals = np.concatenate([array.normals_l for array in arrays])
        distances = np.linalg.norm(contacts.points_l[:, None] - points, axis=2)
        distances[np.array(contacts.links)[:, None] != links] = np.inf
        nearest = np.isfinite(distances) & (np.arange(len(distances))[:, None] == distances.argmin(axis=0))
        shares = np.where(nearest, np.maximum(contacts.normals_l @ normals.T, 0.0), 0.0)
        near = (shares > 0) & (distances <= reach)
        values = {"arrays": arrays, "reach": reach, "most_dead": share_of("most_dead", self.most_dead)}
        for name, value in values.items():
            object.__setattr__(self, name, value)
        for name, array in (("felt", near.any(axis=1)), ("_shares", shares), ("_near", near), ("_points", points)):
            object.__setattr__(self, name, read_only(array))

    def measure(self, raw: Sequence[ArrayLike]) -> ContactReading:
        """Compute the normal forces of the contacts from raw counts (t,) of each array.

        Raises:
            InvalidInput: counts of another number of arrays or taxels.
        """
        if len(raw) != len(self.arrays):
            raise InvalidInput(f"raw counts: expected one for each of {len(self.arrays)} arrays, got {len(raw)}")
        arrays = tuple(array.measure(counts) for array, counts in zip(self.arrays, raw))
        taxels = TaxelForces(*(np.concatenate(values) for values in zip(*(one.taxels for one in arrays))))
        dead = (self._near & taxels.dead).sum(axis=1) / np.maximum(self._near.sum(axis=1), 1)
        told = self.felt & (dead <= self.most_dead)
        by_taxel = self._shares * taxels.forces
        centres = [_centre(forces, self._points) if one else np.full(3, np.nan) for forces, one in zip(by_taxel, told)]
        return ContactReading(
            np.where(told, by_taxel.sum(axis=1), np.nan),
            np.where(told, np.linalg.norm(self._shares * np.where(taxels.dead, 0.0, taxels.noise), axis=1), np.nan),
            np.array(centres),
            told & ((self._shares > 0) & taxels.beyond).any(axis=1),
            arrays,
        )
