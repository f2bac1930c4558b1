"""Contact forces of many grasps: the squeeze that withstands the reserve, the weight alone, the least friction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import record_of
from pinograsp.contacts import Friction
from pinograsp.errors import Status
from pinograsp.forces.bulk.elastic import Reactions, find_multiples, find_offsets, make_springs
from pinograsp.forces.robust.reserve import Reserve
from pinograsp.forces.solve.batch import ForceBatch, solve_batch
from pinograsp.spatial import Array, BoolArray, IntArray, cross

MOST_MU = 2.0  # tried
# Shares of a step to a softer squeeze that are tried, and what rounding may miss of a wrench.
_SHARES, _ROUNDING = (1.0, 0.5, 0.2), 1e-6
_SHARE_HALVINGS = 5  # of the reserve
_HALVINGS = 8  # of the range of mu: to less than a hundredth
_SQUARES = np.array([1.0, 2.0])  # the cost of soft fingers, sum of F_n^2, as a power of F_n
_UNCAPPED, _TRACE = 100.0, 1e-4  # times the weight: no squeeze is worth more, and no contact of soft fingers has less


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grips:
    """Contacts of N grasps, up to k each.

    Attributes:
        points: from the centre of mass (N, k, 3) [m].
        rotations: contact frames (N, k, 3, 3).
        counts: contacts (N,), at least one.
        least: F_n that each has at least (N, k) [N]; None: 0.
    """

    points: Array
    rotations: Array
    counts: IntArray
    least: Array | None = None

    @property
    def used(self) -> BoolArray:
        """Which contacts there are (N, k)."""
        used: BoolArray = np.arange(self.points.shape[1]) < self.counts[:, None]
        return used

    @property
    def arms(self) -> Array:
        """Mean distances of the contacts from the centre of mass (N,) [m], 1 where they are all in it."""
        mean = np.where(self.used, np.linalg.norm(self.points, axis=2), 0.0).sum(axis=1) / np.maximum(self.counts, 1)
        return np.where(mean > 0, mean, 1.0)

    def of(self, which: BoolArray | IntArray) -> Grips:
        """Some of them."""
        least = None if self.least is None else self.least[which]
        return Grips(points=self.points[which], rotations=self.rotations[which], counts=self.counts[which], least=least)


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
    contacts = make_springs(grips.points, grips.rotations, grips.used, kept.friction, wrenches)
    whole = contacts.reactions()
    contacts, reacted = contacts.times(shares), whole.times(shares)
    first = _above(grips, kept, find_offsets(reacted, kept.friction, kept.mu), floor, threads)
    status = np.where(reacted.borne.all(axis=1), first.status, Status.INFEASIBLE)
    best = Forces(status=status, local=first.local, residual=first.residual)
    spread = contacts.spread(reacted, best.local[..., -1])
    rows = np.flatnonzero(best.found)
    if len(rows):
        own, some = grips.of(rows), spread.of(rows)
        needed = find_offsets(some, kept.friction, kept.mu, best.local[rows])
        _take(best, _above(own, kept, needed, floor[rows], threads), rows, some, own.used, kept)
    local = best.local * best.found[:, None, None]
    return Forces(status=best.status, local=local, residual=best.residual), (whole, spread)


def torque_columns(jacobians: Array, rotations: Array, friction: Friction) -> Array:
    """Joint torques (N, k, d, n) per unit of the contact components, from the contact Jacobians (N, k, 6, n)."""
    columns = np.einsum("nkxj,nkxc->nkcj", jacobians[:, :, :3], rotations)
    if friction.d == 4:
        turning = np.einsum("nkxj,nkx->nkj", jacobians[:, :, 3:], rotations[..., 2])
        columns = np.concatenate([columns[:, :, :2], turning[:, :, None], columns[:, :, 2:]], axis=2)
    return np.asarray(columns, dtype=float)


def find_efforts(columns: Array, bias: Array, local: Array, reacted: Reactions, usable: Array) -> tuple[Array, Array]:
    """Holding torques (N, n) of forces (N, k, d), and their largest share of a usable torque (n,) under all loads (N,).

    ``columns`` are those of :func:`torque_columns`, ``bias`` (N, n) is the torque without contact; infinity: no limit.
    """
    n, k, d, joints = columns.shape
    flat = np.swapaxes(columns.reshape(n, k * d, joints), 1, 2)
    tau = bias + (flat @ local.reshape(n, k * d, 1))[..., 0]
    change = np.concatenate([reacted.tangential, reacted.normal[:, :, None]], axis=2)
    added = flat @ change.reshape(n, k * d, -1)
    most = np.maximum(np.abs(tau[..., None] + added).max(axis=2, initial=0.0), np.abs(tau))
    return tau, (most / usable)[:, np.isfinite(usable)].max(axis=1, initial=0.0)


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
    n, m = len(grips.points), len(wrenches)
    high = 2.0 * (min(holding.cap, _UNCAPPED * holding.size) + np.maximum(changes, 0.0))
    high = np.swapaxes(high, 1, 2).reshape(n * m, -1)
    each = grips.of(np.repeat(np.arange(n), m))
    loads = np.tile(holding.weight + wrenches, (n, 1))
    alone = _solve(each, holding.kept_back(reserve), loads, np.zeros_like(high), high, threads)
    return np.asarray((alone.status == Status.INFEASIBLE).reshape(n, m).any(axis=1))


def press(grips: Grips, holding: Holding, normal: Array, threads: int | None) -> Forces:
    """Forces under the weight with these F_n (N, k) [N]."""
    loads = np.broadcast_to(holding.weight, (len(grips.points), 6))
    return _solve(grips, holding, loads, normal, normal, threads)


def _take(best: Forces, better: Forces, rows: IntArray, reacted: Reactions, used: BoolArray, holding: Holding) -> None:
    """Put in what presses less hard, or as much of it as withstands the wrenches: such forces are a convex set."""
    cost, before = ((one[..., -1] ** 2).sum(axis=1) for one in (better.local, best.local[rows]))
    left = np.flatnonzero(better.found & (cost < before))
    for share in _SHARES:
        if not len(left):
            return
        mixed = share * better.local[left] + (1.0 - share) * best.local[rows[left]]
        borne = find_multiples(mixed, reacted.of(left), used[left], holding.friction, holding.mu) >= 1.0 - _ROUNDING
        good = borne.all(axis=1)
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

    Infinity where 2 is not enough. More friction never hurts, so that halving the range finds it.
    """
    most = replace(holding, mu=MOST_MU, cap=np.inf)
    low, high = np.zeros(len(grips.points)), np.where(hold_weight(grips, most, threads).found, MOST_MU, np.inf)
    asked = np.flatnonzero(np.isfinite(high))
    for _ in range(_HALVINGS if len(asked) else 0):
        middle = (low[asked] + high[asked]) / 2
        holds = hold_weight(grips.of(asked), most, threads, middle).found
        high[asked], low[asked] = np.where(holds, middle, high[asked]), np.where(holds, low[asked], middle)
    return high


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
