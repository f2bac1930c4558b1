"""Orthogonal factors of many small matrices T = Q U at once, the last axis of arrays being one of them each.

U is upper triangular. Normal equations T^T T would square the matrices' condition.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pinograsp.spatial import Array

_PIECE = 64  # matrices at a time, for which the processor's caches are large enough


class Factors(Protocol):
    """Q and the inverse of U of N matrices (n, r)."""

    def across(self, v: Array) -> Array:
        """Q^T v (r, N) of vectors (n, N)."""

    def along(self, v: Array) -> Array:
        """Q v (n, N) of vectors (r, N)."""

    def divided(self, v: Array) -> Array:
        """U^-1 v (r, N) of vectors (r, N)."""

    def transposed(self, v: Array) -> Array:
        """U^-T v (r, N) of vectors (r, N)."""


class GramSchmidt:
    """By Gram and Schmidt's method, each column twice: then Q is orthogonal to rounding. For few columns.

    Args:
        T: (r, n, N), column by column; becomes Q.
    """

    def __init__(self, T: Array):
        U = np.zeros((len(T), len(T), T.shape[2]))
        for j in range(len(T)):
            for _ in range(2 if j else 0):
                along = np.einsum("rin,in->rn", T[:j], T[j])
                T[j] -= np.einsum("rin,rn->in", T[:j], along)
                U[:j, j] += along
            U[j, j] = np.sqrt(np.einsum("in,in->n", T[j], T[j]))
            T[j] /= U[j, j]
        self.Q, self.inverse = T, np.zeros_like(U)
        for j in range(len(T)):
            self.inverse[j, j] = 1.0 / U[j, j]
            self.inverse[:j, j] = -np.einsum("iln,ln->in", self.inverse[:j, :j], U[:j, j]) * self.inverse[j, j]

    def across(self, v: Array) -> Array:
        """Q^T v."""
        return np.asarray(np.einsum("rin,in->rn", self.Q, v))

    def along(self, v: Array) -> Array:
        """Q v."""
        return np.asarray(np.einsum("rin,rn->in", self.Q, v))

    def divided(self, v: Array) -> Array:
        """U^-1 v."""
        return np.asarray(np.einsum("rsn,sn->rn", self.inverse, v))

    def transposed(self, v: Array) -> Array:
        """U^-T v."""
        return np.asarray(np.einsum("rsn,rn->sn", self.inverse, v))


class Householder:
    """By reflections, matrix by matrix.

    Args:
        T: (r, n, N), column by column.
    """

    def __init__(self, T: Array):
        r, n, N = T.shape
        self.Q, self.inverse = np.empty((N, n, r)), np.empty((N, r, r))
        for at in (slice(i, i + _PIECE) for i in range(0, N, _PIECE)):
            self.Q[at], upper = np.linalg.qr(T[..., at].transpose(2, 1, 0))
            self.inverse[at] = _inverse(upper)

    def across(self, v: Array) -> Array:
        """Q^T v."""
        return np.asarray((v.T[:, None] @ self.Q)[:, 0].T)

    def along(self, v: Array) -> Array:
        """Q v."""
        return np.asarray((self.Q @ v.T[..., None])[..., 0].T)

    def divided(self, v: Array) -> Array:
        """U^-1 v."""
        return np.asarray((self.inverse @ v.T[..., None])[..., 0].T)

    def transposed(self, v: Array) -> Array:
        """U^-T v."""
        return np.asarray((v.T[:, None] @ self.inverse)[:, 0].T)


class Rows:
    """What rows (m, n) that weigh on vectors of n numbers, too, and on two more, make of them: upper triangular factors
    U of the unit matrix above the weighted rows.

    Args:
        Z: the rows over the square roots of their weights (m, n, N).
        B: of the two numbers likewise (m, 2, N).
    """

    def __init__(self, Z: Array, B: Array):
        m, n, N = Z.shape
        self.inverse = np.zeros((N, n, n))
        self.across, self.left = np.empty((2, n, N)), np.empty((3, N))
        for at in (slice(i, i + _PIECE) for i in range(0, N, _PIECE)):
            own = Z[..., at]
            stacked = np.zeros((own.shape[2], m + n, n + 2))
            # Large rows first: then rounding spares the others.
            stacked[:, :m, :n], stacked[:, :m, n:] = own.transpose(2, 0, 1), B[..., at].transpose(2, 0, 1)
            stacked[:, m + np.arange(n), np.arange(n)] = 1.0
            upper = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=float)
            self.inverse[at] = _inverse(upper[:, :n, :n])
            self.across[..., at] = upper[:, :n, n:].transpose(2, 1, 0)
            left = upper[:, n:, n:]
            self.left[:, at] = (left.transpose(0, 2, 1) @ left).reshape(-1, 4).T[[0, 1, 3]]

    def columns(self, T: Array) -> Array:
        """U^-T T of columns (r, n, N)."""
        return np.ascontiguousarray((T.transpose(2, 0, 1) @ self.inverse).transpose(1, 2, 0))

    def divided(self, v: Array) -> Array:
        """U^-1 v (n, N)."""
        return np.asarray((self.inverse @ v.T[..., None])[..., 0].T)

    def transposed(self, v: Array) -> Array:
        """U^-T v (n, N)."""
        return np.asarray((v.T[:, None] @ self.inverse)[:, 0].T)


def _inverse(upper: Array) -> Array:
    """Of upper triangular matrices (N, r, r), half by half."""
    half = upper.shape[-1] // 2
    if half < 3:
        return np.asarray(np.linalg.inv(upper), dtype=float)
    found = np.zeros_like(upper)
    found[:, :half, :half] = first = _inverse(upper[:, :half, :half])
    found[:, half:, half:] = last = _inverse(upper[:, half:, half:])
    found[:, :half, half:] = -first @ upper[:, :half, half:] @ last
    return found
