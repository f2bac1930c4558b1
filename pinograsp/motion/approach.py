"""Approach phase: a fifth-order polynomial from rest to the state at impact (Eq. 19), or a gentle closing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, number, one_of
from pinograsp.spatial import Array, BoolArray, IntArray

StartAcceleration = Literal["rest", "paper"]
_HALVINGS = 0.5 ** np.arange(7)
_STILL = 1e-9  # [rad/s or m/s]

STARTS: tuple[StartAcceleration, ...] = get_args(StartAcceleration)
Order = Literal["together", "base first", "tip first"]
ORDERS: tuple[Order, ...] = get_args(Order)
_TURNS = 0.6  # share of the way after which the last joint starts, where they take turns
# Shares of the approach in which joints come up to speed; the shorter, the nearer to the contact they start to.
LAST_PARTS = (0.1, 0.03, 0.01)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """Motion of n joints at m samples.

    Attributes:
        q: positions (m, n) [rad].
        dq: rates (m, n) [rad/s].
        ddq: accelerations (m, n) [rad/s^2].
    """

    q: Array
    dq: Array
    ddq: Array

    __repr__ = brief()

    def of(self, joints: IntArray) -> JointPath:
        """Of some joints."""
        return JointPath(q=self.q[:, joints], dq=self.dq[:, joints], ddq=self.ddq[:, joints])

    def come_after(self, rise: JointPath) -> JointPath:
        """An approach and this path, which begins with the sample at which the approach ends."""
        parts = {name: (getattr(rise, name)[:-1], getattr(self, name)) for name in ("q", "dq", "ddq")}
        return JointPath(**{name: np.concatenate(pair) for name, pair in parts.items()})

    @property
    def start(self) -> tuple[Array, Array, Array]:
        """Positions, rates and accelerations of its first sample, each (n,)."""
        return self.q[0], self.dq[0], self.ddq[0]


def approach(
    times: ArrayLike,
    impact_time: float,
    start: ArrayLike,
    end: tuple[ArrayLike, ArrayLike, ArrayLike],
    *,
    acceleration_at_start: StartAcceleration = "rest",
) -> JointPath:
    """The motion of n joints at ``times`` (m,) [s] in [0, t_I].

    From ``start`` (n,) [rad] at rest to the ``end``, q, dq and ddq (n,) each, at ``impact_time``. The acceleration at
    t = 0 is zero (``"rest"``) or -ddq (``"paper"``, the boundary condition (i) below Eq. 19).
    """
    number("impact time", impact_time, above=0, unit="s")
    one_of("acceleration at start", acceleration_at_start, STARTS)
    a0, q_T, dq_T, ddq_T = (array_of("approach state", v, (None,)) for v in (start, *end))
    T = impact_time
    a1 = np.zeros_like(a0)
    a2 = -ddq_T / 2 if acceleration_at_start == "paper" else np.zeros_like(a0)
    # What the cubic and higher terms must still supply at T, solved in closed form.
    gap, rate, curvature = q_T - a0 - a2 * T**2, dq_T - 2 * a2 * T, ddq_T - 2 * a2
    a3 = (10 * gap - 4 * rate * T + curvature * T**2 / 2) / T**3
    a4 = (-15 * gap + 7 * rate * T - curvature * T**2) / T**4
    a5 = (6 * gap - 3 * rate * T + curvature * T**2 / 2) / T**5
    t = array_of("times", times, (None,))[:, None]
    position = a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))
    velocity = a1 + t * (2 * a2 + t * (3 * a3 + t * (4 * a4 + t * 5 * a5)))
    acceleration = 2 * a2 + t * (6 * a3 + t * (12 * a4 + t * 20 * a5))
    return JointPath(q=position, dq=velocity, ddq=acceleration)


def gentle_approach(
    times: ArrayLike,
    impact_time: float,
    start: ArrayLike,
    end: tuple[ArrayLike, ArrayLike, ArrayLike],
    *,
    limits: tuple[ArrayLike, ArrayLike],
    windows: ArrayLike,
    last_part: float,
) -> tuple[JointPath, BoolArray]:
    """As :func:`approach`, within the joints' limits all the way: near to the contact at rest, then on to it.

    Every joint goes from ``start`` to a place just short of ``q`` and rests there; the last part of the time, or
    less where a limit leaves less room, takes it to ``q``, ``dq``, ``ddq``. The rate is then a polynomial of third
    order that has the sign of ``dq`` throughout, so that it does not swing back.

    Args:
        times: samples (m,) [s] in [0, t_I].
        impact_time: t_I [s].
        start: joint positions (n,) [rad or m].
        end: positions q, rates dq and accelerations ddq at impact, each (n,).
        limits: least and largest positions (n,), (n,).
        windows: begin and end of each joint's first motion (n, 2), as shares of the time before its last part [-].
        last_part: share of the time before impact in which joints come up to their rates there [-].

    Returns:
        The path, and which joints (n,) have no room at all to come up to their rates: these jump at impact.
    """
    number("impact time", impact_time, above=0, unit="s")
    a, q_T, dq_T, ddq_T, low, high = (array_of("approach state", v, (None,)) for v in (start, *end, *limits))
    ends = array_of("windows", windows, (a.size, 2))
    t = array_of("times", times, (None,))[:, None]
    last = number("last part", last_part, above=0) * impact_time * _HALVINGS
    back = dq_T * last[:, None] / 2 - ddq_T * last[:, None] ** 2 / 12  # (halvings, n)
    fits = (q_T - back >= low) & (q_T - back <= high) & (back * dq_T >= 0)
    jumps = ~fits.any(axis=0) & (np.abs(dq_T) > _STILL)
    duration = last[np.argmax(fits, axis=0)]
    at = q_T - np.where(fits.any(axis=0), back[np.argmax(fits, axis=0), np.arange(a.size)], 0.0)
    begin, rest = (impact_time - duration) * ends[:, 0], (impact_time - duration) * ends[:, 1]
    gap, span = at - a, rest - begin
    u = np.clip((t - begin) / span, 0.0, 1.0)
    still = u * (1 - u)
    square = u * u
    position = a + gap * (square * u) * (10 - 15 * u + 6 * square)
    rate = gap / span * 30 * (still * still)
    curvature = gap / span**2 * 60 * still * (1 - 2 * u)
    w = np.where(jumps, 0.0, np.clip((t - (impact_time - duration)) / duration, 0.0, 1.0))
    # Only the last samples are in the last part.
    late = np.flatnonzero((w > 0).any(axis=1))
    first = int(late[0]) if late.size else len(w)
    w = w[first:]
    square, cube = w * w, w * w * w
    position[first:] += duration * (
        dq_T * (cube - square * square / 2) + duration * ddq_T * (square * square / 4 - cube / 3)
    )
    rate[first:] += dq_T * (3 * square - 2 * cube) + duration * ddq_T * (cube - square)
    curvature[first:] += dq_T / duration * 6 * w * (1 - w) + ddq_T * (3 * square - 2 * w)
    return JointPath(q=position, dq=rate, ddq=curvature), jumps


def take_turns(fingers: Sequence[IntArray], n: int, order: Order) -> Array:
    """Windows (n, 2) for :func:`gentle_approach` in which the joints of each finger move together, or one by one."""
    begin = np.zeros(n)
    if order == "together":
        return np.column_stack([begin, begin + 1.0])
    for dofs in fingers:
        begin[dofs] = np.linspace(0, _TURNS, len(dofs))[:: 1 if order == "base first" else -1]
    return np.column_stack([begin, begin + 1 - _TURNS])
