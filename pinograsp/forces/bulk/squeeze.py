"""Contact forces of many grasps: the squeeze that withstands the reserve, the weight alone, the least friction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pinograsp import core
from pinograsp.checks import record_of
from pinograsp.contacts import Friction
from pinograsp.core.threads import call_in_parts
from pinograsp.errors import Status
from pinograsp.forces.bulk.elastic import Grips, Reactions, find_multiples, find_offsets, react, spread
from pinograsp.forces.robust.reserve import Reserve
from pinograsp.forces.solve.batch import ForceBatch, solve_batch
from pinograsp.spatial import Array, BoolArray, IntArray, cross

MOST_MU = 2.0  # tried
# Parts of the step to a softer squeeze that are tried, and what rounding may miss of a wrench.
_STEPS, _ROUNDING = (1.0, 0.5, 0.2), 1e-6
_SHARE_HALVINGS = 5  # of the reserve
_MU_WITHIN = 0.008  # a bit less than a hundredth
_SQUARES = np.array([1.0, 2.0])  # the cost of soft fingers, sum of F_n^2, as a power of F_n
_UNCAPPED, _TRACE = 100.0, 1e-4  # times the weight: no squeeze is worth more, and no contact of soft fingers has less


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forces:
    """Forces of N grasps; zero where there are none.

    Attributes:
        status: of each (N,), a :class:`~pinograsp.errors.Status`.
        local: in contact axes, the normal last (N, k, d) [N, N m].
        residual: of the balance (N,) [N, moments over the contacts' mean distance].
    """

    status: NDArray[np.object_]
    local: Array
    residual: Array

    @property
    def found(self) -> BoolArray:
        """Which have forces (N,)."""
        found: BoolArray = self.status == Status.OK
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Holding:
    """An object to be held, and with what friction.

    Attributes:
        friction: the model, with its safety factor.
        mu: friction coefficient.
        weight: the load (6,), about the centre of mass [N, N m].
        cap: largest F_n [N]; infinity: none.
    """

    friction: Friction
    mu: float
    weight: Array
    cap: float

    @property
    def size(self) -> float:
        """[N]."""
        return float(np.linalg.norm(self.weight))

    def kept_back(self, reserve: Reserve) -> Holding:
        """The same with the friction that a reserve does not rely on."""
        return replace(self, friction=reserve.kept_friction(self.friction))


def squeeze(
    grips: Grips,
    holding: Holding,
    reserve: Reserve,
    wrenches: Array,
    threads: int | None,
    shares: Array | float = 1.0,
) -> tuple[Forces, tuple[Reactions, Reactions]]:
    """Forces under the weight that withstand wrenches (m, 6) added to it, with what the reserve keeps back.

    Those whose contacts cannot balance some wrench at all have none. The reactions are to all of the wrenches, two ways
    to react of which one withstands all; the forces withstand ``shares`` (N,) of them.
    """
    kept = holding.kept_back(reserve)
    floor = np.full(grips.used.shape, reserve.least_force(holding.size))
    if grips.least is not None:
        floor = np.maximum(floor, grips.least)
    shares = np.broadcast_to(shares, len(floor))
    whole = react(grips, kept.friction, wrenches, threads)
    needed = find_offsets(whole, kept.friction, kept.mu, shares=shares, threads=threads)
    first = _above(grips, kept, needed, floor, threads)
    status = np.where(whole.borne.all(axis=1), first.status, Status.INFEASIBLE)
    best = Forces(status=status, local=first.local, residual=first.residual)
    # Of a share of the wrenches it is the same share.
    spread_out = spread(grips, kept.friction, wrenches, whole, best.local[..., -1], threads)
    rows = np.flatnonzero(best.found)
    if len(rows):
        own, some = grips.of(rows), spread_out.of(rows)
        needed = find_offsets(some, kept.friction, kept.mu, best.local[rows], shares=shares[rows], threads=threads)
        _take(best, _above(own, kept, needed, floor[rows], threads), rows, some, shares[rows], kept, threads)
    local = best.local * best.found[:, None, None]
    return Forces(status=best.status, local=local, residual=best.residual), (whole, spread_out)


def squeeze_partly(grips: Grips, holding: Holding, reserve: Reserve, wrenches: Array, threads: int | None) -> Forces:
    """Forces that withstand the largest share below 1 of the wrenches that halving finds; none where not any."""
    count = len(grips.points)
    low, high = np.zeros(count), np.ones(count)
    best = Forces(
        status=np.full(count, Status.INFEASIBLE, dtype=object),
        local=np.zeros((*grips.used.shape, holding.friction.d)),
        residual=np.zeros(count),
    )
    for _ in range(_SHARE_HALVINGS):
        middle = (low + high) / 2
        tried, _ = squeeze(grips, holding, reserve, wrenches, threads, middle)
        found = tried.found
        best.status[found], best.local[found] = tried.status[found], tried.local[found]
        best.residual[found] = tried.residual[found]
        low, high = np.where(found, middle, low), np.where(found, high, middle)
    return best


def find_hopeless(
    grips: Grips, holding: Holding, reserve: Reserve, wrenches: Array, changes: Array, threads: int | None
) -> BoolArray:
    """Which grasps (N,) no squeeze holds: a wrench (m, 6) added to the weight is proven to be too much for them alone.

    Proven for twice the largest F_n, to which the contacts as springs add ``changes`` (N, k, m) [N].
    """
    n, m, k = len(grips.points), len(wrenches), grips.used.shape[1]
    high = 2.0 * (min(holding.cap, _UNCAPPED * holding.size) + np.maximum(changes, 0.0))
    high = np.swapaxes(high, 1, 2).reshape(n * m, k)
    each = grips.of(np.repeat(np.arange(n), m))
    loads = np.tile(holding.weight + wrenches, (n, 1))
    alone = _solve(each, holding.kept_back(reserve), loads, np.zeros_like(high), high, threads)
    return np.asarray((alone.status == Status.INFEASIBLE).reshape(n, m).any(axis=1))


def press(grips: Grips, holding: Holding, normal: Array, threads: int | None) -> Forces:
    """Forces under the weight with these F_n (N, k) [N]."""
    loads = np.broadcast_to(holding.weight, (len(grips.points), 6))
    return _solve(grips, holding, loads, normal, normal, threads)


def _take(
    best: Forces,
    better: Forces,
    rows: IntArray,
    reacted: Reactions,
    shares: Array,
    holding: Holding,
    threads: int | None,
) -> None:
    """Put in what presses less hard, or as much of it as withstands shares of the wrenches: such forces are a convex
    set.
    """
    cost, before = ((one[..., -1] ** 2).sum(axis=1) for one in (better.local, best.local[rows]))
    left = np.flatnonzero(better.found & (cost < before))
    for step in _STEPS:
        if not len(left):
            return
        mixed = step * better.local[left] + (1.0 - step) * best.local[rows[left]]
        borne = find_multiples(mixed, reacted.of(left), holding.friction, holding.mu, threads=threads)
        good = (borne >= (shares[left] * (1.0 - _ROUNDING))[:, None]).all(axis=1)
        best.local[rows[left[good]]] = mixed[good]
        best.residual[rows[left[good]]] = np.maximum(best.residual[rows[left[good]]], better.residual[left[good]])
        left = left[~good]


def _above(grips: Grips, holding: Holding, above: Array, floor: Array, threads: int | None) -> Forces:
    """Forces under the weight whose F_n exceed what friction needs by ``above`` (N, k), and ``floor`` (N, k) [N]."""
    above = np.where(grips.used, above, 0.0)
    normals = above[..., None] * grips.rotations[..., 2]
    loads = np.concatenate([normals.sum(axis=1), cross(grips.points, normals).sum(axis=1)], axis=1)
    high = np.maximum(min(holding.cap, _UNCAPPED * holding.size) - above, 0.0)
    low = np.minimum(np.maximum(floor - above, 0.0), high)
    found = _solve(grips, holding, holding.weight + loads, low, high, threads)
    local = found.local.copy()
    local[..., -1] += above * found.found[:, None]
    return Forces(status=found.status, local=local, residual=found.residual)


def hold_weight(grips: Grips, holding: Holding, threads: int | None, mu: Array | None = None) -> Forces:
    """Forces that hold the weight, as the friction allows; ``mu`` (N,): instead of the one of all."""
    loads = np.broadcast_to(holding.weight, (len(grips.points), 6))
    high = np.full(grips.points.shape[:2], min(holding.cap, _UNCAPPED * holding.size))
    return _solve(grips, holding, loads, np.zeros_like(high), high, threads, mu)


def find_least_mu(grips: Grips, holding: Holding, threads: int | None) -> Array:
    """The least friction coefficient (N,) with which some forces hold the weight, from above to a hundredth.

    Infinity where 2 is not enough. More friction never hurts: it is between what holds and what is proven not to.
    """
    most = replace(holding, mu=MOST_MU, cap=np.inf)
    n = len(grips.points)
    least = np.full(n, np.inf)
    left: IntArray = np.arange(n)
    if holding.friction.separates:
        left = _search_mu(grips, most, least, threads)
    if len(left):
        least[left] = _halve_mu(grips.of(left), most, threads)
    return least


def _search_mu(grips: Grips, most: Holding, least: Array, threads: int | None) -> IntArray:
    """Fill the least friction, all in compiled code; returns those that it does not know."""
    friction, codes = most.friction, np.full(len(least), core.STALLED, dtype=np.int64)
    low, high = _limits(most, least.shape + grips.points.shape[1:2])
    given = {
        "components": friction.d,
        "round": friction.round_dimensions,
        "torsion": friction.torsion / friction.safety,
        "most": most.mu / friction.safety,
        "within": _MU_WITHIN / friction.safety,
        "points": grips.points,
        "rotations": grips.rotations,
        "counts": grips.counts,
        "loads": np.tile(most.weight, (len(least), 1)),
        "low": low,
        "high": high,
        "arms": grips.arms,
        "least": least,
        "codes": codes,
    }
    call_in_parts("find_least_mu", len(least), threads, given)
    least *= friction.safety
    return np.flatnonzero(codes == core.STALLED)


def _halve_mu(grips: Grips, most: Holding, threads: int | None) -> Array:
    """The least friction (N,) by halving its range, a force problem each time."""
    low, high = np.zeros(len(grips.points)), np.where(hold_weight(grips, most, threads).found, most.mu, np.inf)
    asked = np.flatnonzero(np.isfinite(high))
    while len(asked) and (high[asked] - low[asked]).max() > _MU_WITHIN:
        middle = (low[asked] + high[asked]) / 2
        holds = hold_weight(grips.of(asked), most, threads, middle).found
        high[asked], low[asked] = np.where(holds, middle, high[asked]), np.where(holds, low[asked], middle)
    return high


def _limits(holding: Holding, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Of F_n, without any others: the least that the compiled method takes, and the most."""
    least = _TRACE * holding.size if holding.friction.elliptic else 0.0
    return np.full(shape, least), np.full(shape, min(holding.cap, _UNCAPPED * holding.size))


def _solve(
    grips: Grips,
    holding: Holding,
    loads: Array,
    low: Array,
    high: Array,
    threads: int | None,
    mu: Array | None = None,
) -> Forces:
    friction = holding.friction
    # The compiled method knows least squares of plain friction, and of soft fingers powers of F_n that is not zero.
    soft = friction.elliptic
    low = np.maximum(low, np.minimum(_TRACE * holding.size, high)) if soft else low
    # What was checked once is not checked for every load.
    batch = record_of(
        ForceBatch,
        {
            "points": grips.points,
            "rotations": grips.rotations,
            "loads": loads,
            "mu": np.broadcast_to(np.reshape(holding.mu if mu is None else mu, (-1, 1)), low.shape),
            "low": low,
            "high": high,
            "counts": grips.counts,
            "friction": friction,
            "balance": "wrench",
            "moment_lengths": grips.arms,
            "energies": {"work": np.broadcast_to(_SQUARES, (len(low), 1, 2))} if soft else {},
        },
    )
    found = solve_batch(batch, objective="work" if soft else "least_squares", threads=threads)
    local = found.forces_c
    if friction.d == 4:
        local = np.concatenate([local[..., :2], found.torsion[..., None], local[..., 2:]], axis=2)
    return Forces(status=found.status, local=local, residual=found.residual_norm)
