"""Slacks of an interior-point method with their multipliers: values above zero, and vectors in second-order cones.

Intervals are the last axis of all arrays; sums and shares of steps are told for each of them. Steps of cones are those
of Nesterov and Todd's scaling (Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010).
"""

from __future__ import annotations

import numpy as np

from pinograsp.spatial import Array, BoolArray

_SMALL = 1e-300


class Limits:
    """Values that stay above zero, with slacks s > 0 and multipliers z > 0 (..., N); some of them are not in use."""

    def __init__(self, s: Array, z: Array, used: BoolArray | None = None):
        self.used = None if used is None or used.all() else used
        self.s, self.z = self._masked(s, 1.0), self._masked(z, 0.0)
        self.off = self.ds = self.dz = np.zeros_like(self.s)
        self.degree = summed(np.ones_like(s) if used is None else used.astype(float))

    def _masked(self, values: Array, other: float = 0.0) -> Array:
        return values if self.used is None else np.where(self.used, values, other)

    def measure(self, values: Array) -> None:
        """How far the slacks are from what they stand for."""
        self.off = self._masked(values - self.s)

    @property
    def weight(self) -> Array:
        """What z weighs in the normal equations."""
        return np.asarray(self.z / self.s)

    def pull(self, aim: Array | float, correction: Array | float) -> Array:
        """What z becomes, but for its weight times the change of the values."""
        return self._masked((aim - correction - self.z * self.off) / self.s)

    def move(self, change: Array, aim: Array | float, correction: Array | float) -> None:
        """The step of slacks and multipliers, where the values change by ``change``."""
        self.ds = self._masked(self.off + change)
        self.dz = self._masked((aim - correction - self.z * self.ds) / self.s - self.z)

    @property
    def second_order(self) -> Array:
        """What the step leaves of the products of slacks and multipliers."""
        return self.ds * self.dz

    def longest(self) -> Array:
        """Share of the step to the nearest boundary (N,)."""
        nearest = np.minimum(self.ds / self.s, self.dz / np.maximum(self.z, _SMALL))
        least = nearest.reshape(-1, nearest.shape[-1]).min(axis=0, initial=0.0)
        return np.asarray(1.0 / np.maximum(-least, _SMALL))

    def step(self, share: Array | float) -> None:
        """Take a share of the step."""
        self.s, self.z = self.s + share * self.ds, self.z + share * self.dz

    def gap(self, share: Array | float = 0.0) -> Array:
        """The sums of the products (N,), after a share of the step."""
        return summed((self.s + share * self.ds) * (self.z + share * self.dz))

    def keep(self, which: BoolArray) -> None:
        """Only these of N from now on."""
        self.s, self.z, self.off, self.degree = (one[..., which] for one in (self.s, self.z, self.off, self.degree))
        self.ds = self.dz = np.zeros_like(self.s)
        self.used = None if self.used is None else self.used[..., which]


class Cones:
    """Second-order cones s0 >= |s1...|, and their multipliers z (d, k, N): the first axis, with its first entry s0."""

    def __init__(self, s: Array, z: Array):
        self.s, self.z = s, z
        self.ds = self.dz = np.zeros_like(s)
        self.degree = np.full(s.shape[-1], float(s.shape[1]))

    def scale(self) -> None:
        """The scaling W with W z = W^-1 s = point."""
        ns, nz = np.sqrt(_minkowski(self.s)), np.sqrt(_minkowski(self.z))
        s, z = self.s / ns, self.z / nz
        across = _dot(s[1:], z[1:])
        root = np.sqrt(2.0 + 2.0 * (s[0] * z[0] + across))
        self.w = (s - z) / root
        self.w[0] = (s[0] + z[0]) / root
        self.size = np.sqrt(ns / nz)
        self.point = self.times(self.z)

    def matrix(self, sign: int = 1) -> Array:
        """W (d, d, k, N), or with ``sign`` -1 its inverse."""
        w0, w1 = self.w[0], sign * self.w[1:]
        found = np.empty((len(self.w), *self.w.shape))
        found[0, 0], found[0, 1:], found[1:, 0] = w0, w1, w1
        found[1:, 1:] = w1[:, None] * (w1 / (1.0 + w0))
        for j in range(1, len(self.w)):
            found[j, j] += 1.0
        found *= self.size if sign > 0 else 1.0 / self.size
        return found

    def times(self, v: Array, sign: int = 1) -> Array:
        """W v, or with ``sign`` -1 W^-1 v."""
        w0, w1 = self.w[0], sign * self.w[1:]
        along = _dot(w1, v[1:])
        found = np.empty_like(v)
        found[0] = w0 * v[0] + along
        found[1:] = v[1:] + w1 * (v[0] + along / (1.0 + w0))
        found *= self.size if sign > 0 else 1.0 / self.size
        return found

    def pull(self, aim: Array | float, correction: Array | float) -> Array:
        """What z becomes, but for W^-2 times the change of s."""
        right = np.zeros_like(self.point)
        right[0] = aim
        self.pulled = _divided(self.point, right - correction)
        return self.times(self.pulled, -1)

    def move(self, ds: Array) -> None:
        """The step of the multipliers, where s changes by ``ds``."""
        self.ds, self.scaled = ds, self.times(ds, -1)
        self.scaled_dz = self.pulled - self.scaled - self.point
        self.dz = self.times(self.scaled_dz, -1)

    @property
    def second_order(self) -> Array:
        """What the step leaves of the products of slacks and multipliers."""
        return _jordan(self.scaled, self.scaled_dz)

    def longest(self) -> Array:
        """Share of the step to the nearest boundary (N,)."""
        return np.asarray(np.minimum(_to_boundary(self.s, self.ds), _to_boundary(self.z, self.dz)).min(axis=0))

    def step(self, share: Array | float) -> None:
        """Take a share of the step."""
        self.s, self.z = self.s + share * self.ds, self.z + share * self.dz

    def gap(self, share: Array | float = 0.0) -> Array:
        """The sums of the products (N,), after a share of the step."""
        return summed((self.s + share * self.ds) * (self.z + share * self.dz))

    def keep(self, which: BoolArray) -> None:
        """Only these of N from now on."""
        self.s, self.z, self.degree = (one[..., which] for one in (self.s, self.z, self.degree))
        self.ds = self.dz = np.zeros_like(self.s)


def summed(values: Array) -> Array:
    """Sums over all axes but the last."""
    return np.asarray(values.reshape(-1, values.shape[-1]).sum(axis=0))


def _dot(u: Array, v: Array) -> Array:
    """Sums over the first axis of the products: few of them, so term by term."""
    found = u[0] * v[0]
    for a, b in zip(u[1:], v[1:]):
        found += a * b
    return np.asarray(found)


def _minkowski(v: Array) -> Array:
    """v0^2 - |v1...|^2."""
    rest = np.sqrt(_dot(v[1:], v[1:]))
    return np.asarray(np.maximum((v[0] - rest) * (v[0] + rest), _SMALL))


def _jordan(u: Array, v: Array) -> Array:
    """The product u o v of second-order cones."""
    found = u[0] * v + v[0] * u
    found[0] = _dot(u, v)
    return np.asarray(found)


def _divided(u: Array, right: Array) -> Array:
    """The v with u o v = right."""
    found = np.empty_like(right)
    found[0] = (u[0] * right[0] - _dot(u[1:], right[1:])) / _minkowski(u)
    found[1:] = (right[1:] - found[0] * u[1:]) / u[0]
    return found


def _to_boundary(v: Array, dv: Array) -> Array:
    """The largest shares of the steps dv (k, N) after which v are in their cones."""
    a = dv[0] ** 2 - _dot(dv[1:], dv[1:])
    b = v[0] * dv[0] - _dot(v[1:], dv[1:])
    c = _minkowski(v)
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    # The least positive root of a t^2 + 2 b t + c.
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(b <= 0, c / (root - b), -(b + root) / a)
    never = np.where(b > 0, a >= 0, (a > 0) & (b * b < a * c))
    return np.where(never, np.inf, t)
