"""What :func:`pinograsp.forces.kernels.single.solve_one` takes and gives, in few flat arrays: passing one from Python
costs as much time as a contact.

The layout is known here alone. Each packing stands beside its unpacking: the same names, in the same order.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import COUNTED
from pinograsp.forces.kernels.layouts import Friction, Grasp, Limits, Rows, Scalars
from pinograsp.spatial import Array, BoolArray, IntArray

_Scalar = TypeVar("_Scalar", bound=np.generic)


def _joined(parts: Iterable[ArrayLike], kind: type[_Scalar]) -> NDArray[_Scalar]:
    """All entries in one array (n,)."""
    return np.concatenate([np.asarray(part, dtype=kind).ravel() for part in parts])


@jit(**COUNTED)
def part(packed: NDArray[_Scalar], start: int, shape: tuple[int, ...]) -> tuple[NDArray[_Scalar], int]:
    """The array of this shape that begins at ``start``, and where the next one does."""
    size = 1
    for n in shape:
        size *= n
    return packed[start : start + size].reshape(shape), start + size


def pack_grasp(grasp: Grasp) -> tuple[IntArray, Array]:
    """Sizes and whole numbers; all other numbers."""
    rows, limits, friction = grasp.rows, grasp.limits, grasp.friction
    k, d, all_rows = rows.B.shape
    sizes = (
        (k, d, grasp.correction.shape[1], all_rows, rows.shared, friction.n_round),
        (len(rows.A), len(friction.facets), len(limits.G), len(friction.vertices)),
    )
    numbers = (
        grasp.scalars,
        rows.A,
        limits.G,
        rows.B,
        grasp.P,
        grasp.q,
        friction.facets,
        friction.vertices,
        friction.radii,
        grasp.R_lo,
        grasp.R_hi,
        grasp.correction,
        grasp.widths,
        grasp.grasp_matrix,
        grasp.normals,
    )
    whole = *sizes, limits.used, limits.own, rows.touched, rows.counts
    return _joined(whole, np.int64), _joined(numbers, np.float64)


@jit(**COUNTED)
def unpack_grasp(whole: IntArray, numbers: Array) -> Grasp:
    """Views of the arrays of :func:`pack_grasp`."""
    k, d, m, all_rows, shared, n_round = whole[0], whole[1], whole[2], whole[3], whole[4], whole[5]
    padded, facets, limited, corners = whole[6], whole[7], whole[8], whole[9]
    used, i = part(whole, 10, (limited, d))
    own, i = part(whole, i, (limited - facets - 1, k))
    touched, i = part(whole, i, (k, all_rows))
    counts, i = part(whole, i, (k, 2))
    scalars = Scalars(numbers[0], numbers[1], numbers[2], numbers[3])
    A, i = part(numbers, 4, (padded, d * k))
    G, i = part(numbers, i, (limited, d, k))
    B, i = part(numbers, i, (k, d, all_rows))
    P, i = part(numbers, i, (k, d, d))
    q, i = part(numbers, i, (k, d))
    C, i = part(numbers, i, (facets, d))
    vertices, i = part(numbers, i, (corners, 2))
    radii, i = part(numbers, i, (d - 1,))
    R_lo, i = part(numbers, i, (all_rows - m,))
    R_hi, i = part(numbers, i, (all_rows - m,))
    correction, i = part(numbers, i, (k * d, m))
    widths, i = part(numbers, i, (k, d))
    grasp_matrix, i = part(numbers, i, (6, 3 * k))
    normals, i = part(numbers, i, (k, 3))
    return Grasp(
        Rows(A, B, touched, counts, shared),
        Limits(G, used, own),
        Friction(C, vertices, radii, n_round),
        P,
        q,
        R_lo,
        R_hi,
        correction,
        widths,
        grasp_matrix,
        normals,
        scalars,
    )


class Stage(NamedTuple):
    """What one impact time and objective add: whether Newton's method is tried first, least and largest F_n (k,) [N],
    terms of the energy (t, 2): pairs (coefficient, exponent).
    """

    newton: bool
    least: Array
    greatest: Array
    terms: Array


def pack_stage(stage: Stage) -> Array:
    """One array (1 + 2 k + 2 t,)."""
    return _joined(((stage.newton,), stage.least, stage.greatest, stage.terms), np.float64)


@jit(**COUNTED)
def unpack_stage(packed: Array, k: int) -> Stage:
    """Views of the array of :func:`pack_stage`."""
    least, i = part(packed, 1, (k,))
    greatest, i = part(packed, i, (k,))
    terms, i = part(packed, i, ((packed.shape[0] - i) // 2, 2))
    return Stage(packed[0] != 0.0, least, greatest, terms)


class Results(NamedTuple):
    """Residual of the balance (6,) [N, N m], contact forces (k, 3) [N], torsion (k,) [N m]; what is at its limit:
    friction, least and largest F_n (k,), torque rows (r,).
    """

    wrench: Array
    forces: Array
    torsion: Array
    at_friction: BoolArray
    at_least: BoolArray
    at_most: BoolArray
    at_torque: BoolArray


def room_for_results(k: int, torque_rows: int) -> tuple[Array, BoolArray]:
    """The two arrays of :class:`Results`."""
    return np.empty(6 + 4 * k), np.empty(3 * k + torque_rows, np.bool_)


def results_in(numbers: Array, active: BoolArray, k: int) -> Results:
    """Views of the arrays of :func:`room_for_results`."""
    return Results(
        numbers[:6],
        numbers[6 : 6 + 3 * k].reshape((k, 3)),
        numbers[6 + 3 * k :],
        active[:k],
        active[k : 2 * k],
        active[2 * k : 3 * k],
        active[3 * k :],
    )


unpack_results = jit(**COUNTED)(results_in)  # for compiled code; Python's own slices are quicker than a call
