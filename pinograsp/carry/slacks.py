"""Slacks of an interior-point method with their multipliers: values above zero, and vectors in second-order cones.

Steps of cones are those of Nesterov and Todd's scaling (Vandenberghe, "The CVXOPT linear and quadratic cone program
solvers", 2010).
"""

from __future__ import annotations

import numpy as np

from pinograsp.spatial import Array, BoolArray

_SMALL = 1e-300


class Limits:
    """Values that stay above zero, with slacks s > 0 and multipliers z > 0; some of them are not in use."""

    def __init__(self, s: Array, z: Array, used: BoolArray | None = None):
        self.used = np.ones(s.shape, dtype=bool) if used is None else used
        self.s, self.z = np.where(self.used, s, 1.0), np.where(self.used, z, 0.0)
        self.off = self.ds = self.dz = np.zeros_like(self.s)
        self.degree = int(self.used.sum())

    def measure(self, values: Array) -> None:
        """How far the slacks are from what they stand for."""
        self.off = np.where(self.used, values - self.s, 0.0)

    @property
    def weight(self) -> Array:
        """What z weighs in the normal equations."""
        return np.asarray(self.z / self.s)

    def pull(self, aim: float, correction: Array | float) -> Array:
        """What z becomes, but for its weight times the change of the values."""
        return np.where(self.used, (aim - correction) / self.s - self.weight * self.off, 0.0)

    def move(self, change: Array, aim: float, correction: Array | float) -> None:
        """The step of slacks and multipliers, where the values change by ``change``."""
        self.ds = np.where(self.used, self.off + change, 0.0)
        self.dz = np.where(self.used, (aim - correction - self.z * self.ds) / self.s - self.z, 0.0)

    @property
    def second_order(self) -> Array:
        """What the step leaves of the products of slacks and multipliers."""
        return self.ds * self.dz

    def longest(self) -> float:
        """Share of the step to the nearest boundary."""
        least = min((self.ds / self.s).min(initial=0.0), (self.dz / np.maximum(self.z, _SMALL)).min(initial=0.0))
        return float(1.0 / -least) if least < 0 else np.inf

    def step(self, share: float) -> None:
        """Take a share of the step."""
        self.s, self.z = self.s + share * self.ds, self.z + share * self.dz

    def gap(self, share: float = 0.0) -> float:
        """The sum of the products, after a share of the step."""
        return float(np.vdot(self.s + share * self.ds, self.z + share * self.dz))


class Cones:
    """Second-order cones s0 >= |s1...|, and their multipliers z: the last axis, with its first entry s0."""

    def __init__(self, s: Array, z: Array):
        self.s, self.z = s, z
        self.ds = self.dz = np.zeros_like(s)
        self.degree = int(np.prod(s.shape[:-1]))

    def scale(self) -> None:
        """The scaling W with W z = W^-1 s = point."""
        ns, nz = np.sqrt(_minkowski(self.s)), np.sqrt(_minkowski(self.z))
        s, z = self.s / ns[..., None], self.z / nz[..., None]
        mirrored = np.concatenate([z[..., :1], -z[..., 1:]], axis=-1)
        self.w = (s + mirrored) / np.sqrt(2.0 + 2.0 * np.einsum("...i,...i->...", s, z))[..., None]
        self.size = np.sqrt(ns / nz)
        self.point = self.times(self.z)

    def matrix(self, sign: float = 1.0) -> Array:
        """W (..., d, d), or with ``sign`` -1 its inverse."""
        w0, w1 = self.w[..., 0], sign * self.w[..., 1:]
        found = np.empty((*self.w.shape, self.w.shape[-1]))
        found[..., 0, 0], found[..., 0, 1:], found[..., 1:, 0] = w0, w1, w1
        found[..., 1:, 1:] = w1[..., :, None] * (w1 / (1.0 + w0)[..., None])[..., None, :]
        for j in range(1, self.w.shape[-1]):
            found[..., j, j] += 1.0
        return np.asarray(found * self.size[..., None, None] ** sign)

    def times(self, v: Array, sign: float = 1.0) -> Array:
        """W v, or with ``sign`` -1 W^-1 v."""
        w0, w1 = self.w[..., :1], sign * self.w[..., 1:]
        along = np.einsum("...i,...i->...", w1, v[..., 1:])[..., None]
        first, rest = w0 * v[..., :1] + along, v[..., 1:] + w1 * (v[..., :1] + along / (1.0 + w0))
        return np.concatenate([first, rest], axis=-1) * self.size[..., None] ** sign

    def pull(self, aim: float, correction: Array | float) -> Array:
        """What z becomes, but for W^-2 times the change of s."""
        right = np.zeros_like(self.point)
        right[..., 0] = aim
        self.pulled = _divided(self.point, right - correction)
        return self.times(self.pulled, -1.0)

    def move(self, ds: Array) -> None:
        """The step of the multipliers, where s changes by ``ds``."""
        self.ds, self.scaled = ds, self.times(ds, -1.0)
        self.scaled_dz = self.pulled - self.scaled - self.point
        self.dz = self.times(self.scaled_dz, -1.0)

    @property
    def second_order(self) -> Array:
        """What the step leaves of the products of slacks and multipliers."""
        return _jordan(self.scaled, self.scaled_dz)

    def longest(self) -> float:
        """Share of the step to the nearest boundary."""
        return min(_to_boundary(self.s, self.ds), _to_boundary(self.z, self.dz))

    def step(self, share: float) -> None:
        """Take a share of the step."""
        self.s, self.z = self.s + share * self.ds, self.z + share * self.dz

    def gap(self, share: float = 0.0) -> float:
        """The sum of the products, after a share of the step."""
        return float(np.vdot(self.s + share * self.ds, self.z + share * self.dz))


def _minkowski(v: Array) -> Array:
    """v0^2 - |v1...|^2."""
    rest = np.sqrt(np.einsum("...i,...i->...", v[..., 1:], v[..., 1:]))
    return np.asarray(np.maximum((v[..., 0] - rest) * (v[..., 0] + rest), _SMALL))


def _jordan(u: Array, v: Array) -> Array:
    """The product u o v of second-order cones."""
    first = np.einsum("...i,...i->...", u, v)[..., None]
    return np.concatenate([first, u[..., :1] * v[..., 1:] + v[..., :1] * u[..., 1:]], axis=-1)


def _divided(u: Array, right: Array) -> Array:
    """The v with u o v = right."""
    along = np.einsum("...i,...i->...", u[..., 1:], right[..., 1:])
    first = (u[..., 0] * right[..., 0] - along) / _minkowski(u)
    rest = (right[..., 1:] - first[..., None] * u[..., 1:]) / u[..., :1]
    return np.concatenate([first[..., None], rest], axis=-1)


def _to_boundary(v: Array, dv: Array) -> float:
    """The largest share of the steps dv after which all v are in their cones."""
    a = dv[..., 0] ** 2 - np.einsum("...i,...i->...", dv[..., 1:], dv[..., 1:])
    b = v[..., 0] * dv[..., 0] - np.einsum("...i,...i->...", v[..., 1:], dv[..., 1:])
    c = _minkowski(v)
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    # The least positive root of a t^2 + 2 b t + c.
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(b <= 0, c / (root - b), -(b + root) / a)
    never = np.where(b > 0, a >= 0, (a > 0) & (b * b < a * c))
    return float(np.where(never, np.inf, t).min(initial=np.inf))
