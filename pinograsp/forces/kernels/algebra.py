"""Small dense algebra of the compiled methods."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import FLAGS
from pinograsp.spatial import Array


@jit(**FLAGS)
def factor(H: Array) -> None:
    """Cholesky factor U'U of H (n, n) in its upper triangle, in place, inverse pivots on the diagonal; small pivots are
    raised to a floor.
    """
    n = H.shape[0]
    largest = 0.0
    for r in range(n):
        largest = max(largest, H[r, r])
    floor = 1e-15 * largest + 1e-300
    for r in range(n):
        scale = 1.0 / np.sqrt(max(H[r, r], floor))
        H[r, r] = scale
        for c in range(r + 1, n):
            H[r, c] *= scale
        for i in range(r + 1, n):
            t = H[r, i]
            for c in range(i, n):
                H[i, c] -= t * H[r, c]


@jit(**FLAGS)
def solve(U: Array, v: Array) -> None:
    """v <- (U'U)^-1 v with U from :func:`factor`."""
    n = v.shape[0]
    for r in range(n):
        t = v[r] * U[r, r]
        v[r] = t
        for c in range(r + 1, n):
            v[c] -= t * U[r, c]
    for r in range(n - 1, -1, -1):
        t = v[r]
        for c in range(r + 1, n):
            t -= U[r, c] * v[c]
        v[r] = t * U[r, r]


@jit(**FLAGS)
def factor_contacts(H: Array) -> None:
    """:func:`factor` for every contact's block of H (d, d, k); d is 3 or 4."""
    d, _, k = H.shape
    for i in range(k):
        a, b, c = H[0, 0, i], H[1, 1, i], H[2, 2, i]
        floor = 1e-15 * max(max(a, b), c) + 1e-300
        a = 1.0 / np.sqrt(max(a, floor))
        ab, ac = H[0, 1, i] * a, H[0, 2, i] * a
        b = 1.0 / np.sqrt(max(b - ab * ab, floor))
        bc = (H[1, 2, i] - ab * ac) * b
        c = 1.0 / np.sqrt(max(c - ac * ac - bc * bc, floor))
        H[0, 0, i], H[1, 1, i], H[2, 2, i], H[0, 1, i], H[0, 2, i], H[1, 2, i] = a, b, c, ab, ac, bc
        if d == 4:
            ae = H[0, 3, i] * a
            be = (H[1, 3, i] - ab * ae) * b
            ce = (H[2, 3, i] - ac * ae - bc * be) * c
            rest = H[3, 3, i] - ae * ae - be * be - ce * ce
            H[0, 3, i], H[1, 3, i], H[2, 3, i] = ae, be, ce
            H[3, 3, i] = 1.0 / np.sqrt(max(rest, max(floor, 1e-15 * H[3, 3, i])))


@jit(**FLAGS)
def half_solve(U: Array, rows: Array, out: Array) -> None:
    """out[h] = U'^-1 rows[h] for the contacts' factors U and every row (n, d k)."""
    d, _, k = U.shape
    for i in range(k):
        a, b, c = U[0, 0, i], U[1, 1, i], U[2, 2, i]
        ab, ac, bc = U[0, 1, i], U[0, 2, i], U[1, 2, i]
        for h in range(rows.shape[0]):
            s = rows[h, i] * a
            t = (rows[h, k + i] - ab * s) * b
            u = (rows[h, 2 * k + i] - ac * s - bc * t) * c
            out[h, i], out[h, k + i], out[h, 2 * k + i] = s, t, u
            if d == 4:
                rest = rows[h, 3 * k + i] - U[0, 3, i] * s - U[1, 3, i] * t - U[2, 3, i] * u
                out[h, 3 * k + i] = rest * U[3, 3, i]


@jit(**FLAGS)
def back_solve(U: Array, v: Array) -> None:
    """v <- U^-1 v for the contacts' factors U; v (1, d k)."""
    d, _, k = U.shape
    for i in range(k):
        s, t, u = v[0, i], v[0, k + i], v[0, 2 * k + i]
        if d == 4:
            w = v[0, 3 * k + i] * U[3, 3, i]
            v[0, 3 * k + i] = w
            s, t, u = s - U[0, 3, i] * w, t - U[1, 3, i] * w, u - U[2, 3, i] * w
        u *= U[2, 2, i]
        t = (t - U[1, 2, i] * u) * U[1, 1, i]
        v[0, i], v[0, k + i], v[0, 2 * k + i] = (s - U[0, 1, i] * t - U[0, 2, i] * u) * U[0, 0, i], t, u


@jit(**FLAGS)
def add_products(A: Array, v: Array, out: Array) -> None:
    """out += A v; the number of rows is a multiple of three."""
    for r in range(0, A.shape[0], 3):
        a, b, c = 0.0, 0.0, 0.0
        for l in range(A.shape[1]):
            t = v[0, l]
            a, b, c = a + A[r, l] * t, b + A[r + 1, l] * t, c + A[r + 2, l] * t
        out[r], out[r + 1], out[r + 2] = out[r] + a, out[r + 1] + b, out[r + 2] + c


@jit(**FLAGS)
def add_combination(A: Array, y: Array, sign: float, out: Array) -> None:
    """out += sign A' y; the number of rows is a multiple of three."""
    for r in range(0, A.shape[0], 3):
        a, b, c = sign * y[r], sign * y[r + 1], sign * y[r + 2]
        for l in range(A.shape[1]):
            out[0, l] += A[r, l] * a + A[r + 1, l] * b + A[r + 2, l] * c


@jit(**FLAGS)
def gram(T: Array, S: Array) -> None:
    """S = T T', its upper triangle, in blocks of three rows and columns."""
    for r in range(0, T.shape[0], 3):
        for c in range(r, T.shape[0], 3):
            a0, a1, a2, b0, b1, b2, c0, c1, c2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for l in range(T.shape[1]):
                a, b, g = T[r, l], T[r + 1, l], T[r + 2, l]
                s, t, u = T[c, l], T[c + 1, l], T[c + 2, l]
                a0, a1, a2 = a0 + a * s, a1 + a * t, a2 + a * u
                b0, b1, b2 = b0 + b * s, b1 + b * t, b2 + b * u
                c0, c1, c2 = c0 + g * s, c1 + g * t, c2 + g * u
            S[r, c], S[r, c + 1], S[r, c + 2] = a0, a1, a2
            S[r + 1, c], S[r + 1, c + 1], S[r + 1, c + 2] = b0, b1, b2
            S[r + 2, c], S[r + 2, c + 1], S[r + 2, c + 2] = c0, c1, c2


@jit(**FLAGS)
def not_finite(values: Array) -> bool:
    """Whether one is not finite, or absurdly large."""
    for v in values.flat:
        if not abs(v) < 1e12:
            return True
    return False
