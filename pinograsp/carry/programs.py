"""The programs of carrying: a grasp's limits and a path's loads as matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, qr

from pinograsp.carry.loads import Carried, CarryLoads
from pinograsp.carry.program import CarryProgram
from pinograsp.checks import brief
from pinograsp.errors import CarryInfeasible
from pinograsp.forces import ForceProblem, TorqueLimits
from pinograsp.forces.matrices import elastic_reaction, matrices_of
from pinograsp.spatial import Array, IntArray

_RANK, _BALANCED = 1e-9, 1e-7  # singular values, and parts of loads, below this share of the largest are none
_FASTEST = 1e3  # [1/s] of the path parameter: a path in a millisecond


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmLimits:
    """What the joints of a robot may do; infinity: no limit.

    Attributes:
        torque: largest |torque| (n,) [N m or N].
        speed: largest |speed| (n,) [rad/s or m/s].
        acceleration: largest |acceleration| (n,) [rad/s^2 or m/s^2].
    """

    torque: Array
    speed: Array
    acceleration: Array

    __repr__ = brief()


class Programs:
    """Programs of one grasp along one path, at N intervals.

    Args:
        problem: the grasp's, with its friction, caps and torque limits of the hand's joints (of ``carried.hand``).
        range_n: least and largest normal forces (k,), (k,) [N].
        carried: robot and object.
        limits: of the robot's joints.
        middle: loads at the middles of the intervals.
        slopes: derivatives of the joints' positions by the path parameter at their ends (N + 1, n).
        others: programs of other scenarios of the same path, which the same squeeze has to bear.
        fastest: speeds of the path parameter are below it.
        spare: normal forces beyond what friction needs (k,) [N]; the programs' forces are those without it.
    """

    def __init__(
        self,
        problem: ForceProblem,
        range_n: tuple[Array, Array],
        carried: Carried,
        limits: ArmLimits,
        middle: CarryLoads,
        slopes: Array,
        others: Sequence[Programs] = (),
        fastest: float = _FASTEST,
        spare: Array | None = None,
    ):
        self.problem, self.carried, self.limits, self.middle, self.slopes = problem, carried, limits, middle, slopes
        self.least, self.most = range_n
        self.spare = np.zeros(problem.k) if spare is None else spare
        self.count = len(middle.q)
        self.step = 1.0 / self.count
        torques = problem.torques
        # Torques of the hand without contacts go with the path; the rows' limits are those of a hand without weight.
        bare = None if torques is None else replace(torques, bias=np.zeros_like(torques.bias))
        self.matrices = matrices_of(replace(problem, torques=bare), {"least_squares": 1.0})
        self.bias_rows = _bias_rows(bare, self.matrices.R_norm, len(carried.of_hand))
        self._balance()
        self.top = self._speed_limits(fastest)
        self.others = tuple(others)

    @property
    def wrench_scale(self) -> Array:
        """Makes moments forces (6,)."""
        return np.concatenate([np.ones(3), np.full(3, 1.0 / self.problem.moment_length)])

    def _balance(self) -> None:
        """A of full rank, and what of the loads it balances."""
        scale = self.wrench_scale
        wrench = self.middle.wrench
        U, size, _ = np.linalg.svd(self.matrices.A, full_matrices=True)
        rank = int((size > _RANK * size[0]).sum())
        parts = [np.asarray(part) * scale for part in wrench]
        largest = max(float(np.abs(part).max()) for part in parts)
        out = [part @ U[:, rank:] for part in parts]
        if rank < 6 and max(float(np.abs(part).max(initial=0.0)) for part in out) > _BALANCED * largest:
            raise CarryInfeasible(
                f"the contacts balance only {rank} of the 6 components of a wrench, and the path asks for others: add "
                "contacts, or torsional friction (soft fingers)",
                at=0.0,
                solution=None,
            )
        kept = _independent(self.matrices.A)
        self.A = self.matrices.A[kept]
        self.E = (scale[:, None] * wrench.pairs(self.step))[:, kept]
        self.e = parts[2][:, kept]

    def timed(self, a: Array, b: Array, y: Array, fastest: float) -> Programs:
        """The same of a known timing, as functions of the square of a factor on its speed, which is below ``fastest``.

        a, b: accelerations and squared speeds at the middles (N,); y: squared speeds at the ends (N + 1,).
        """
        slopes, middle = np.abs(self.slopes) * np.sqrt(y)[:, None], self.middle.timed(a, b)
        # Neither at the ends of an interval nor at its middle is a joint too fast.
        between = np.abs(np.concatenate([middle.speed[:1], middle.speed, middle.speed[-1:]]))
        slopes = np.maximum(slopes, np.maximum(between[:-1], between[1:]))
        others = [other.timed(a, b, y, fastest) for other in self.others]
        return Programs(
            self.problem,
            (self.least, self.most),
            self.carried,
            self.limits,
            middle,
            slopes,
            others,
            fastest,
            self.spare,
        )

    def _speed_limits(self, most: float) -> Array:
        """Largest squared speeds of the path parameter (N + 1,) [1/s^2]."""
        with np.errstate(divide="ignore"):
            fastest = (self.limits.speed / np.abs(self.slopes)).min(axis=1)
        return np.asarray(np.minimum(fastest, most) ** 2)

    def _rows(self) -> tuple[Array, Array, Array]:
        """B (N, m, 2), low and high (N, m) of the hand's torque rows."""
        torque, of_hand = self.middle.torque, self.carried.of_hand
        L = self.bias_rows
        B = np.einsum("rn,mnj->mrj", L, torque.pairs(self.step)[:, of_hand])
        still = torque.still[:, of_hand] @ L.T
        return B, self.matrices.R_lo - still, self.matrices.R_hi - still

    @cached_property
    def arm_rows(self) -> tuple[Array, Array, list[str]]:
        """C (N, r, 2) and c (N, r), each row over its limit, and what the rows are."""
        names, arm = self.carried.robot.joint_names, self.carried.arm
        rows, ends, words = [], [], []
        for kind, linear, limit in (
            ("torque", self.middle.torque, self.limits.torque),
            ("acceleration", self.middle.acceleration, self.limits.acceleration),
        ):
            limited = arm[np.isfinite(limit[arm])]
            pairs = linear.pairs(self.step)[:, limited] / limit[limited, None]
            still = linear.still[:, limited] / limit[limited]
            rows += [pairs, -pairs]
            ends += [1.0 - still, 1.0 + still]
            words += 2 * [f"{kind} of {names[j]}" for j in limited.tolist()]
        return np.concatenate(rows, axis=1), np.concatenate(ends, axis=1), words

    def program(self, **changes: object) -> CarryProgram:
        """The program of the least time from rest to rest, in all scenarios; or with ``changes`` of it."""
        return replace(self._whole, **changes)  # type: ignore[arg-type]

    @cached_property
    def _whole(self) -> CarryProgram:
        return self._with_others() if self.others else self.alone

    @cached_property
    def alone(self) -> CarryProgram:
        """The program of the least time from rest to rest, in this scenario."""
        B, low, high = self._rows()
        C, c, _ = self.arm_rows
        given = np.full(self.count + 1, np.nan)
        given[[0, -1]] = 0.0
        k, d = self.problem.k, self.problem.friction.d
        kept = np.zeros(k * d)
        kept[d - 1 :: d] = self.spare
        return CarryProgram(
            friction=self.problem.friction,
            k=k,
            A=self.A,
            E=self.E,
            e=self.e - self.A @ kept,
            R=self.matrices.R,
            B=B,
            low=low - self.matrices.R @ kept,
            high=high - self.matrices.R @ kept,
            C=C,
            c=c,
            least=np.maximum(self.least - self.spare, 0.0),
            most=self.most - self.spare,
            top=self.top,
            given=given,
            step=self.step,
        )

    def _with_others(self) -> CarryProgram:
        """The program of all scenarios: their contacts side by side, whose squeeze is the same.

        Normal forces differ as much as the loads make them on equal springs: n_s - n_1 = C (w_s - w_1).
        """
        own = self.alone
        each = [own, *(other.alone for other in self.others)]
        S, k, d = len(each), own.k, own.friction.d
        C, step = elastic_reaction(self.problem), self.step
        normal = np.zeros((k, k * d))
        normal[np.arange(k), np.arange(d - 1, k * d, d)] = 1.0
        shares = np.zeros(((S - 1) * k, S * k * d))
        shares[:, : k * d] = np.tile(-normal, (S - 1, 1))
        shares[:, k * d :] = block_diag(*(S - 1) * [normal])
        scale = self.wrench_scale[:, None]
        pairs, still = self.middle.wrench.pairs(step), self.middle.wrench.still
        moved = [-C @ (scale * (other.middle.wrench.pairs(step) - pairs)) for other in self.others]
        rest = [-(other.middle.wrench.still - still) * self.wrench_scale @ C.T for other in self.others]
        A = np.concatenate([block_diag(*(one.A for one in each)), shares])
        E = np.concatenate([*(one.E for one in each), *moved], axis=1)
        e = np.concatenate([*(one.e for one in each), *rest], axis=1)
        # Forces along the normals of parallel surfaces are balanced by normal forces alone: said twice.
        kept = _independent(A)
        return replace(
            own,
            k=S * k,
            A=A[kept],
            E=E[:, kept],
            e=e[:, kept],
            R=block_diag(*(one.R for one in each)),
            B=np.concatenate([one.B for one in each], axis=1),
            low=np.concatenate([one.low for one in each], axis=1),
            high=np.concatenate([one.high for one in each], axis=1),
            C=np.concatenate([one.C for one in each], axis=1),
            c=np.concatenate([one.c for one in each], axis=1),
            least=np.tile(own.least, S),
            most=np.tile(own.most, S),
        )

    def wrenches(self, y: float) -> Array:
        """Of the contacts on the object (N, 6), moments over the moment length [N], at a squared speed."""
        return np.asarray(self.middle.wrench.squared(y) * self.wrench_scale)

    def fastest_anywhere(self) -> CarryProgram:
        """How fast each interval may be passed by itself, with the acceleration that suits it best."""
        top = np.repeat(self.top, 2)[1:-1]
        return self.program(step=None, top=top, given=np.full(len(top), np.nan), gain=np.full(len(top), 0.5))

    def gentlest(self, y: Array) -> CarryProgram:
        """The least squared forces at squared speeds y (N + 1,) that are known."""
        assert self.matrices.P is not None  # of least squares
        weights = np.tile(np.diag(self.matrices.P), 1 + len(self.others))
        return self.program(step=None, given=y, weights=weights)


def _independent(rows: Array) -> IntArray:
    """Which rows (b, n) are linearly independent of each other, and span the others."""
    upper, order = qr(rows.T, mode="r", pivoting=True)
    size = np.abs(np.diag(upper))
    return np.sort(order[: int((size > _RANK * size[0]).sum())])


def _bias_rows(torques: TorqueLimits | None, norms: Array, n: int) -> Array:
    """How the rows of the hand's torques (m, n) follow the torques without contacts, over the rows' norms."""
    if torques is None or not len(norms):
        return np.zeros((0, n))
    rows = [np.eye(len(torques.bias))[torques.limited]]
    if torques.underactuation is not None:
        rows += 2 * [torques.underactuation.rows]
    return np.asarray(np.concatenate(rows) / norms[:, None])
