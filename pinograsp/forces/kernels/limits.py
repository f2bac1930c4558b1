"""Limits of single contacts, with slacks: least <= G x <= most, the coefficients G of
:class:`~pinograsp.forces.kernels.layouts.Limits`; facets have no upper side.

Torque rows of several contacts, ``shared``, follow as rows of their own. Vectors over all contacts are stored by
component, v[0, j k + i] for component j of contact i.
"""

from __future__ import annotations

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import add_products
from pinograsp.forces.kernels.flags import FLAGS
from pinograsp.spatial import Array, IntArray


@jit(**FLAGS)
def limits_along(G: Array, used: IntArray, shared: Array, v: Array, out: Array) -> None:
    """out = G v. ``used`` (limits of a contact, d): whether a component enters."""
    _, d, k = G.shape
    e = (d - 1) * k
    for a in range(G.shape[0]):
        for i in range(k):
            out[a * k + i] = G[a, d - 1, i] * v[0, e + i]
        for j in range(d - 1):
            if used[a, j]:
                for i in range(k):
                    out[a * k + i] += G[a, j, i] * v[0, j * k + i]
    out[G.shape[0] * k :] = 0.0
    add_products(shared, v, out[G.shape[0] * k :])


@jit(**FLAGS)
def add_limits(G: Array, used: IntArray, v: Array, out: Array) -> None:
    """out += G' v, without the torque rows of several contacts."""
    _, d, k = G.shape
    for a in range(G.shape[0]):
        for j in range(d):
            if used[a, j]:
                for i in range(k):
                    out[0, j * k + i] += G[a, j, i] * v[a * k + i]


@jit(**FLAGS)
def add_weighted_limits(G: Array, used: IntArray, w: Array, H: Array) -> None:
    """H += G' diag(w) G, without the torque rows of several contacts."""
    _, d, k = G.shape
    for a in range(G.shape[0]):
        for j in range(d):
            for c in range(j, d):
                if used[a, j] and used[a, c]:
                    for i in range(k):
                        H[j, c, i] += G[a, j, i] * G[a, c, i] * w[a * k + i]


@jit(**FLAGS)
def both_sides(v: Array, sign: float, one_sided: int, out: Array) -> None:
    """Per limit the entry of its lower side plus ``sign`` times that of its upper side, which facets do not have."""
    other = out.shape[0] - one_sided
    for l in range(one_sided):
        out[l] = v[l]
    for l in range(one_sided, out.shape[0]):
        out[l] = v[l] + sign * v[l + other]


@jit(**FLAGS)
def to_boundary(v: Array, dv: Array, alpha: float) -> float:
    """The largest step up to alpha that keeps v + alpha dv at least 0."""
    for l in range(v.shape[0]):
        if v[l] + alpha * dv[l] < 0.0:
            alpha = -v[l] / dv[l]
    return alpha
