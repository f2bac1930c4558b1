"""How planned forces change where contacts are softer or stiffer than assumed, and which servo gains withstand that.

A servo is in series with its contacts: where its reference gives F* on contacts of the compliance C*, it gives
F* (C* + C_h) / (C' + C_h) on those of C', the hand's compliance being C_h (one contact, linear).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.actuation.compliant_hand import CompliantHand
from pinograsp.actuation.squeeze import NEGLIGIBLE, Squeeze
from pinograsp.checks import array_of, brief, each_of, frozen, number, share_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceSolution, SqueezeScenario
from pinograsp.spatial import Array, BoolArray

FACTORS = (0.2, 0.5, 1.0, 2.0, 5.0, 20.0)
# Servos this much softer or stiffer than the contacts behave as torque control, or as rigid drives.
_SOFTEST, _STIFFEST, _TRIED = 1e-6, 1e6, 25
_FARTHEST_OFF = 1e6
_CLOSE, _EQUAL = 1e-4, 1e-6  # relative, of gains and of deviations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceBand:
    """Forces of one squeeze on contacts that are softer or stiffer than assumed, at given servo gains.

    Attributes:
        factors: real over assumed contact stiffness K (s,) [-].
        planned_c: the forces that were planned (k, 3), contact axes [N].
        forces_c: the forces that come (s, k, 3), contact axes [N].
        shifts: motion of the object from where it was planned (s, 6), a twist about its centre of mass, linear first,
            world axes [m, rad].
        balanced: whether an equilibrium was found (s,) bool; without one, the forces are the last that were tried.
        friction: tangential force over what mu allows at that normal force, without safety factor (s, k) [-]: 1 where a
            contact slips and the others hold what it does not; above 1 where no forces within friction are found that
            hold the object, and those of contacts that stick stand here; infinity where a contact pulls aside but
            does not press.
        holds: whether the object is held (s,) bool: balanced, every contact within its friction and its largest normal
            force, every joint within its torque limit, as far as the problem has them.
        remarks: per factor why it does not hold, in words; empty where it does.
    """

    factors: Array
    planned_c: Array
    forces_c: Array
    shifts: Array
    balanced: BoolArray
    friction: Array
    holds: BoolArray
    remarks: tuple[str, ...]

    __repr__ = brief("factors", "lowest", "highest", "deviation", "holds")

    @property
    def normal_forces(self) -> Array:
        """F_n (s, k) [N]."""
        return frozen(self.forces_c[:, :, 2].copy())

    @property
    def lowest(self) -> Array:
        """Least F_n of each contact over the factors (k,) [N]."""
        return frozen(self.forces_c[:, :, 2].min(axis=0))

    @property
    def highest(self) -> Array:
        """Largest F_n of each contact over the factors (k,) [N]."""
        return frozen(self.forces_c[:, :, 2].max(axis=0))

    @property
    def deviation(self) -> float:
        """Largest change of an F_n relative to what was planned for it [-]; contacts that were not planned to press are
        compared with the largest force. Infinity where there is no equilibrium.
        """
        if not np.all(self.balanced):
            return float("inf")
        planned = self.planned_c[:, 2]
        size = np.where(planned > NEGLIGIBLE * planned.max(), planned, planned.max())
        return float((np.abs(self.forces_c[:, :, 2] - planned) / size).max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GainLimit:
    """The largest servo gains that keep a band within a tolerance.

    Attributes:
        scale: factor on the hand's gains; 0: not even torque control keeps it, infinity: rigid drives do.
        gains: the hand's gains times it, (m,) or (m, m); drives without gains, and rigid ones, stay as they were.
        band: the forces at these gains.
        monotonic: whether the deviation only grew with the gains, where it was looked at. Where it did not, larger
            gains than these may be within the tolerance again.
    """

    scale: float
    gains: Array
    band: ForceBand
    monotonic: bool

    __repr__ = brief("scale", "gains", "monotonic", "band")


def force_band(
    solution: ForceSolution,
    hand: CompliantHand,
    factors: ArrayLike = FACTORS,
    *,
    tangential_ratio: float = 2 / 3,
) -> ForceBand:
    """The forces that come of a squeeze where K is ``factors`` times what was planned with.

    References of the servos stay those that give the planned forces on contacts as assumed, efforts those of torque
    control (gains of 0), rigid drives where they are; the load and moments about the normals of soft fingers stay as
    well. A contact slips where it would pull aside with more than its friction; pyramids stand for round cones here.

    Args:
        solution: forces with their problem: load, contact law, friction, caps, torque limits.
        hand: that touches there, with its servo gains.
        factors: real over assumed stiffness (s,), above 0.
        tangential_ratio: k_t / k_n of contacts that stick [-], at the planned forces; see
            :func:`~pinograsp.actuation.contact_stiffness`.

    Raises:
        InvalidInput: a solution without forces, shapes that do not go together, a contact law that starts infinitely
            stiff, or tangential forces on contacts that have no tangential stiffness.
    """
    return _band(Squeeze.of(solution, hand, tangential_ratio), _factors_of(factors))


def stiffness_scenarios(
    solution: ForceSolution, hand: CompliantHand, factors: ArrayLike, *, tangential_ratio: float = 2 / 3
) -> tuple[SqueezeScenario, ...]:
    """What the normal forces of a squeeze near ``solution`` become where K is ``factors`` (s,) times that of the plan.

    At the solution itself they are those of :func:`force_band`; around it they follow to first order.

    Raises:
        InvalidInput: as for :func:`force_band`.
    """
    squeeze = Squeeze.of(solution, hand, tangential_ratio)
    return tuple(_linearise(squeeze, factor) for factor in _factors_of(factors).tolist())


def drive_scenarios(
    solution: ForceSolution, hand: CompliantHand, share: ArrayLike, *, tangential_ratio: float = 2 / 3
) -> tuple[SqueezeScenario, ...]:
    """What the normal forces of a squeeze near ``solution`` become where drives make other efforts than they are told.

    All drives together make 1 - ``share`` and 1 + ``share`` times theirs, and each of those that press at all does so
    alone; at any motion, as where a torque constant or a gain is other than assumed. The object gives way until forces
    balance again. Rigid drives are where they are, whatever effort that takes.

    Args:
        solution: forces with their problem.
        hand: that touches there, with its servo gains.
        share: of an effort that may be missing or too much, below 1, one number or one for each drive (m,) [-].
        tangential_ratio: as for :func:`force_band`.

    Raises:
        InvalidInput: as for :func:`force_band`, or a share that cannot be used.
    """
    each = each_of("share of the drives' efforts", share, hand.m)
    for one in each.tolist():
        share_of("share of the drives' efforts", one)
    squeeze = Squeeze.of(solution, hand, tangential_ratio)
    pressing = np.abs(hand.jacobian @ hand.transmission).max(axis=0) > 0
    alone = np.eye(hand.m)[hand.yielding & pressing]
    which = np.vstack([np.ones((1, hand.m)), alone]) if len(alone) > 1 else np.ones((1, hand.m))
    shares = [1.0 + sign * each * one for one in which for sign in (-1.0, 1.0)]
    return tuple(_linearise(squeeze.with_drives(hand, one), 1.0) for one in shares)


def _linearise(squeeze: Squeeze, factor: float) -> SqueezeScenario:
    """What comes of a squeeze where contacts press ``factor`` times as much, to first order."""
    planned, G = squeeze.planned.ravel(), squeeze.problem.contacts.G
    settled = squeeze.settle(factor)
    change = squeeze.response(factor, settled)
    offset = settled.forces.ravel() - change @ planned
    # They balance what the planned ones do: of rounding nothing may be left, where contacts leave no choice.
    back = np.linalg.pinv(G, rcond=_EQUAL)
    change = (change - back @ (G @ change - G))[2::3]
    offset = (offset - back @ (G @ offset))[2::3]
    return SqueezeScenario(
        normal=frozen(np.array(change[:, 2::3])),
        tangential=frozen(np.delete(change, np.s_[2::3], axis=1)),
        offset=frozen(np.array(offset)),
    )


def gains_within(
    solution: ForceSolution,
    hand: CompliantHand,
    tolerance: float,
    *,
    factors: ArrayLike = FACTORS,
    tangential_ratio: float = 2 / 3,
) -> GainLimit:
    """The largest gains for which no F_n is off by more than ``tolerance``, relative to what was planned for it.

    The hand's gains are multiplied by one number: ``gains=np.ones(m)`` asks for the largest uniform one. Gains from
    torque control to nearly rigid are looked at first, then the end of the first part within the tolerance is found by
    bisection. Whether the object is stable at gains that low, :func:`~pinograsp.actuation.object_stiffness` says.

    Raises:
        InvalidInput: no gains to change, a tolerance that is not above 0; others as for :func:`force_band`.
    """
    tolerance = number("tolerance", tolerance, above=0)
    factors = _factors_of(factors)
    squeeze = Squeeze.of(solution, hand, tangential_ratio)

    def band(scale: float) -> ForceBand:
        return _band(squeeze.with_hand(replace(hand, gains=_scale(hand, scale))), factors)

    def make_limit(scale: float, one: ForceBand) -> GainLimit:
        return GainLimit(scale=scale, gains=frozen(_scale(hand, scale)), band=one, monotonic=monotonic)

    scales = _as_stiff_as_contacts(squeeze, hand) * np.geomspace(_SOFTEST, _STIFFEST, _TRIED)
    bands = [band(scale) for scale in scales.tolist()]
    deviations = np.array([one.deviation for one in bands])
    monotonic = bool(np.all(deviations[1:] >= (1 - _EQUAL) * deviations[:-1] - _EQUAL))
    if np.all(deviations <= tolerance):
        scale = np.inf if hand.gains.ndim == 1 else float(scales[-1])
        return make_limit(scale, band(scale))
    first = int(np.argmax(deviations > tolerance))
    if first == 0:
        return make_limit(0.0, band(0.0))
    low, high, best = float(scales[first - 1]), float(scales[first]), bands[first - 1]
    while high > (1 + _CLOSE) * low:
        middle = float(np.sqrt(low * high))
        tried = band(middle)
        if tried.deviation <= tolerance:
            low, best = middle, tried
        else:
            high = middle
    return make_limit(low, best)


def _as_stiff_as_contacts(squeeze: Squeeze, hand: CompliantHand) -> float:
    """The factor on the hand's gains that makes its drives about as stiff as the contacts are."""
    gains = float(np.trace(hand.gains)) if hand.gains.ndim == 2 else float(hand.gains[hand.yielding].sum())
    if not gains > 0:
        raise InvalidInput(
            f"servo gains: expected finite values, some above 0, whose ratios are kept, got {hand.gains.tolist()}: "
            "give gains=np.ones(m) for the largest uniform one"
        )
    by_drives = hand.jacobian @ hand.transmission
    contacts = float(np.trace(by_drives.T @ squeeze.stiffness(1.0) @ by_drives))
    return contacts / gains if contacts > 0 else 1.0


def _scale(hand: CompliantHand, scale: float) -> Array:
    """The hand's gains times ``scale``; those of 0, and infinite ones, stay."""
    if hand.gains.ndim == 2:
        return np.asarray(scale * hand.gains, dtype=float)
    servos = hand.yielding & (hand.gains > 0)
    gains = np.array(hand.gains)
    gains[servos] *= scale
    return gains


def _factors_of(factors: ArrayLike) -> Array:
    found = array_of("stiffness factors", factors, (None,))
    if not found.size or np.any((found < 1 / _FARTHEST_OFF) | (found > _FARTHEST_OFF)):
        raise InvalidInput(
            "stiffness factors: expected one or more ratios of real to assumed stiffness, from "
            f"{1 / _FARTHEST_OFF:g} to {_FARTHEST_OFF:g}, got {shorten(found.tolist())}"
        )
    return found


def _band(squeeze: Squeeze, factors: Array) -> ForceBand:
    settled = [squeeze.settle(float(factor)) for factor in factors]
    remarks: Sequence[list[str]] = [squeeze.remarks(one) for one in settled]
    return ForceBand(
        factors=frozen(np.array(factors)),
        planned_c=frozen(np.array(squeeze.planned)),
        forces_c=frozen(np.array([one.forces for one in settled])),
        shifts=frozen(np.array([one.shift for one in settled])),
        balanced=frozen(np.array([one.balanced for one in settled])),
        friction=frozen(np.array([squeeze.friction(one.forces)[0] for one in settled])),
        holds=frozen(np.array([not one for one in remarks])),
        remarks=tuple("; ".join(one) for one in remarks),
    )
