"""What a grasp and a robot allow along a path, as matrices: the programs of carrying."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, qr

from pinograsp.carry.loads import CarryLoads, LoadedRobot
from pinograsp.carry.program import CarryProgram
from pinograsp.checks import brief
from pinograsp.errors import CarryInfeasible
from pinograsp.forces import ForceProblem, TorqueLimits
from pinograsp.forces.matrices import Matrices, elastic_reaction, matrices_of
from pinograsp.spatial import Array, IntArray, multiply_rows

_RANK, _BALANCED = 1e-9, 1e-7  # singular values, and parts of loads, below this share of the largest are none
_FASTEST = 1e3  # [1/s] of the path parameter: a path in a millisecond


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspLimits:
    """What a grasp may use on the way.

    Attributes:
        problem: with friction and torque limits of the hand's joints, less what is kept free.
        least: smallest normal forces (k,) [N].
        most: largest normal forces (k,) [N].
        spare: normal forces beyond what friction needs (k,) [N]; the programs' forces are those without it.
    """

    problem: ForceProblem
    least: Array
    most: Array
    spare: Array

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmLimits:
    """What the joints of a robot may do; infinity: no limit.

    Attributes:
        torque: largest |torque| (n,) [N m or N].
        speed: largest |speed| (n,) [rad/s or m/s].
        acceleration: largest |acceleration| (n,) [rad/s^2 or m/s^2].
        object_speed: largest speed of the object's centre of mass [m/s].
    """

    torque: Array
    speed: Array
    acceleration: Array
    object_speed: float = np.inf

    __repr__ = brief()


class ArmRows(NamedTuple):
    """Limits of the arm's joints, C p <= c of the two squared speeds p of an interval, each row over its limit.

    Attributes:
        C: (N, r, 2).
        c: (N, r).
        names: of the rows (r,), in words.
    """

    C: Array
    c: Array
    names: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class PathConstraints:
    """Of one grasp along one path, at N intervals.

    Attributes:
        grasp: what the grasp may use.
        arm: what the robot's joints may do.
        loaded: robot and object.
        middle: loads at the middles of the intervals.
        slopes: derivatives of the joints' positions by the path parameter at their ends (N + 1, n).
        object_slopes: how far the object's centre of mass goes by the path parameter there (N + 1,).
        others: those of other scenarios of the same path, which the same squeeze has to withstand.
        fastest: speeds of the path parameter are below it.
    """

    grasp: GraspLimits
    arm: ArmLimits
    loaded: LoadedRobot
    middle: CarryLoads
    slopes: Array
    object_slopes: Array
    others: tuple[PathConstraints, ...] = ()
    fastest: float = _FASTEST

    __repr__ = brief()

    @property
    def count(self) -> int:
        """Number of intervals."""
        return len(self.middle.q)

    @property
    def step(self) -> float:
        """Length of an interval."""
        return 1.0 / self.count

    @property
    def wrench_scale(self) -> Array:
        """Makes moments forces (6,)."""
        return np.concatenate([np.ones(3), np.full(3, 1.0 / self.grasp.problem.moment_length)])

    @cached_property
    def _bare(self) -> TorqueLimits | None:
        """Torques of the hand without contacts go with the path: limits are those of a hand without weight."""
        torques = self.grasp.problem.torques
        return None if torques is None else replace(torques, bias=np.zeros_like(torques.bias))

    @cached_property
    def matrices(self) -> Matrices:
        """Of the grasp's force programs."""
        return matrices_of(replace(self.grasp.problem, torques=self._bare), {"least_squares": 1.0})

    @cached_property
    def _balance(self) -> tuple[Array, Array, Array]:
        """Rows A of full rank, and what of the loads they balance: E (N, b, 2) and e (N, b)."""
        A, scale, wrench = self.matrices.A, self.wrench_scale, self.middle.wrench
        kept = _find_independent(A)
        if len(kept) < 6:
            outside = np.linalg.svd(A, full_matrices=True)[0][:, len(kept) :]
            parts = [np.asarray(part) * scale for part in wrench]
            largest = max(float(np.abs(part).max()) for part in parts)
            if max(float(np.abs(part @ outside).max()) for part in parts) > _BALANCED * largest:
                raise CarryInfeasible(
                    f"the contacts balance only {len(kept)} of the 6 components of a wrench, but the path needs "
                    "others: add contacts, or torsional friction (soft fingers)",
                    at=0.0,
                    solution=None,
                )
        pairs, still = scale[:, None] * wrench.pairs(self.step), wrench.still * scale
        return A[kept], pairs[:, kept], still[:, kept]

    @cached_property
    def top(self) -> Array:
        """Largest squared speeds of the path parameter (N + 1,) [1/s^2]."""
        with np.errstate(divide="ignore"):
            fastest = (self.arm.speed / np.abs(self.slopes)).min(axis=1)
            fastest = np.minimum(fastest, self.arm.object_speed / self.object_slopes)
        return np.asarray(np.minimum(fastest, self.fastest) ** 2)

    @cached_property
    def hand_rows(self) -> tuple[Array, Array, Array]:
        """B (N, m, 2), low and high (N, m) of the hand's torque rows."""
        torque, of_hand = self.middle.torque, self.loaded.of_hand
        L = _follow_bias(self._bare, self.matrices.R_norm, len(of_hand))
        B = np.einsum("rn,mnj->mrj", L, torque.pairs(self.step)[:, of_hand])
        still = multiply_rows(torque.still[:, of_hand], L.T)
        return B, self.matrices.R_lo - still, self.matrices.R_hi - still

    @cached_property
    def arm_rows(self) -> ArmRows:
        """Torques and accelerations of the arm."""
        names, arm = self.loaded.robot.joint_names, self.loaded.arm
        rows, ends, words = [], [], list[str]()
        for kind, linear, limit in (
            ("torque", self.middle.torque, self.arm.torque),
            ("acceleration", self.middle.acceleration, self.arm.acceleration),
        ):
            limited = arm[np.isfinite(limit[arm])]
            pairs = linear.pairs(self.step)[:, limited] / limit[limited, None]
            still = linear.still[:, limited] / limit[limited]
            rows += [pairs, -pairs]
            ends += [1.0 - still, 1.0 + still]
            words += 2 * [f"{kind} of {names[j]}" for j in limited.tolist()]
        return ArmRows(np.concatenate(rows, axis=1), np.concatenate(ends, axis=1), tuple(words))

    @cached_property
    def alone(self) -> CarryProgram:
        """The program of the least time from rest to rest, in this scenario."""
        grasp, (A, E, e), (B, low, high) = self.grasp, self._balance, self.hand_rows
        given = np.full(self.count + 1, np.nan)
        given[[0, -1]] = 0.0
        k, d = grasp.problem.k, grasp.problem.friction.d
        spare = np.zeros(k * d)
        spare[d - 1 :: d] = grasp.spare
        return CarryProgram(
            friction=grasp.problem.friction,
            k=k,
            A=A,
            E=E,
            e=e - A @ spare,
            R=self.matrices.R,
            B=B,
            low=low - self.matrices.R @ spare,
            high=high - self.matrices.R @ spare,
            C=self.arm_rows.C,
            c=self.arm_rows.c,
            least=np.maximum(grasp.least - grasp.spare, 0.0),
            most=grasp.most - grasp.spare,
            top=self.top,
            given=given,
            step=self.step,
        )

    @cached_property
    def least_time(self) -> CarryProgram:
        """The program of the least time from rest to rest, in all scenarios: their contacts side by side.

        Their squeeze is the same: normal forces differ as much as the loads make them on equal springs,
        n_s - n_1 = C (w_s - w_1).
        """
        own = self.alone
        if not self.others:
            return own
        each = [own, *(other.alone for other in self.others)]
        S, k, d = len(each), own.k, own.friction.d
        normal = np.zeros((k, k * d))
        normal[np.arange(k), np.arange(d - 1, k * d, d)] = 1.0
        shares = np.hstack([np.tile(-normal, (S - 1, 1)), block_diag(*(S - 1) * [normal])])
        C, scale = elastic_reaction(self.grasp.problem), self.wrench_scale
        wrenches = [one.middle.wrench for one in (self, *self.others)]
        pairs = [scale[:, None] * one.pairs(self.step) for one in wrenches]
        still = [one.still * scale for one in wrenches]
        A = np.concatenate([block_diag(*(one.A for one in each)), shares])
        E = np.concatenate([*(one.E for one in each), *(-C @ (pair - pairs[0]) for pair in pairs[1:])], axis=1)
        e = np.concatenate(
            [*(one.e for one in each), *(multiply_rows(still[0] - one, C.T) for one in still[1:])], axis=1
        )
        # Forces along the normals of parallel surfaces are balanced by normal forces alone: said twice.
        kept = _find_independent(A)

        def join(name: str) -> Array:
            return np.concatenate([getattr(one, name) for one in each], axis=1)

        return replace(
            own,
            k=S * k,
            A=A[kept],
            E=E[:, kept],
            e=e[:, kept],
            R=block_diag(*(one.R for one in each)),
            B=join("B"),
            low=join("low"),
            high=join("high"),
            C=join("C"),
            c=join("c"),
            least=np.tile(own.least, S),
            most=np.tile(own.most, S),
        )

    @property
    def fastest_anywhere(self) -> CarryProgram:
        """How fast each interval may be passed by itself, with the acceleration that suits it best."""
        top = np.repeat(self.top, 2)[1:-1]
        return replace(
            self.least_time, step=None, top=top, given=np.full(len(top), np.nan), gain=np.full(len(top), 0.5)
        )

    def least_forces(self, y: Array) -> CarryProgram:
        """The least squared forces at squared speeds y (N + 1,) that are known."""
        assert self.matrices.P is not None  # of least squares
        weights = np.tile(np.diag(self.matrices.P), 1 + len(self.others))
        return replace(self.least_time, step=None, given=y, weights=weights)

    def follow(self, a: Array, b: Array, y: Array, fastest: float) -> PathConstraints:
        """The same of a known timing, as functions of the square of a factor on its speed, which is below ``fastest``.

        a, b: accelerations and squared speeds at the middles (N,); y: squared speeds at the ends (N + 1,).
        """
        middle, rate = self.middle.follow(a, b), np.sqrt(y)

        # Neither at the ends of an interval nor at its middle is a joint, or the object, too fast.
        def find_fastest(at_ends: Array, at_middles: Array) -> Array:
            between = np.abs(np.concatenate([at_middles[:1], at_middles, at_middles[-1:]]))
            return np.asarray(np.maximum(np.abs(at_ends), np.maximum(between[:-1], between[1:])))

        slopes = find_fastest(self.slopes * rate[:, None], middle.speed)
        object_slopes = find_fastest(self.object_slopes * rate, middle.object_speed)
        others = tuple(other.follow(a, b, y, fastest) for other in self.others)
        return replace(self, middle=middle, slopes=slopes, object_slopes=object_slopes, others=others, fastest=fastest)


def _find_independent(rows: Array) -> IntArray:
    """Which rows (b, n) are linearly independent of each other, and span the others."""
    upper, order = qr(rows.T, mode="r", pivoting=True)
    size = np.abs(np.diag(upper))
    return np.sort(order[: int((size > _RANK * size[0]).sum())])


def _follow_bias(torques: TorqueLimits | None, norms: Array, n: int) -> Array:
    """How the rows of the hand's torques (m, n) follow the torques without contacts, over the rows' norms."""
    if torques is None or not len(norms):
        return np.zeros((0, n))
    rows = [np.eye(len(torques.bias))[torques.limited]]
    if torques.underactuation is not None:
        rows += [torques.underactuation.rows[side] for side in torques.underactuation.limited_sides]
    return np.asarray(np.concatenate(rows) / norms[:, None])
