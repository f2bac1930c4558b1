"""Programs of carrying as one sparse program over second-order cones, in Clarabel's form.

Unknowns are the forces, the squared speeds y that are not given and, where time is the cost, roots r <= sqrt(y) and for
each interval t >= 1 / (r_i + r_i+1): in them the time is linear (Verscheure et al. 2009).
"""

from __future__ import annotations

from typing import NamedTuple

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp.carry.program import CarryProgram
from pinograsp.forces.solve.conic import Cone
from pinograsp.spatial import Array, BoolArray

# a b >= c^2 as a cone, |(2 c, a - b)| <= a + b: where a, b and c go.
_FIRST, _SECOND, _MIDDLE = (
    np.array([[1.0], [0.0], [1.0]]),
    np.array([[1.0], [0.0], [-1.0]]),
    np.array([[0.0], [2], [0]]),
)


class Multipliers(NamedTuple):
    """Of the constraints that couple forces and speeds, which are signed as the terms of the Lagrangian are.

    Attributes:
        balance: of A x - E p - e (N, b).
        low: of low - R x - B p (N, m), not negative; so are the others.
        high: of R x + B p - high (N, m).
        pairs: of C p - c (N, r).
    """

    balance: Array
    low: Array
    high: Array
    pairs: Array


class Assembly(NamedTuple):
    """Minimise 1/2 u . P u + q . u where A u + s = b and s lies in the cones; and where constraints are in it.

    Rows begin with the balance of every interval, the limits ``low`` and ``high`` that are finite, and the ``pairs``
    that may bind.

    Attributes:
        program: what it is of.
        problem: P, q, A, b and the cones.
        low: which of these limits are in it (N, m).
        high: likewise.
        pairs: likewise (N, r).
    """

    program: CarryProgram
    problem: tuple[sp.csc_matrix, Array, sp.csc_matrix, Array, list[Cone]]
    low: BoolArray
    high: BoolArray
    pairs: BoolArray

    def read_unknowns(self, u: Array) -> tuple[Array, Array]:
        """Forces (N, k d) within friction, and squared speeds, as ``top``, within their limits."""
        program, free = self.program, self.program.free
        forces = program.count * program.A.shape[1]
        x = u[:forces].reshape(program.count, program.k, -1).copy()
        x[..., -1] = np.maximum(np.maximum(x[..., -1], program.least), program.friction.gauge(x[..., :-1]))
        y = program.given.copy()
        y[free] = np.clip(u[forces : forces + free.sum()], 1e-12 * program.top[free], program.top[free])
        return x.reshape(program.count, -1), y

    def read_multipliers(self, z: Array) -> Multipliers:
        """The rows' multipliers; those of what is not in it are 0."""
        at = self.program.e.size
        found = [z[:at].reshape(self.program.e.shape)]
        for used in (self.low, self.high, self.pairs):
            values = np.zeros(used.shape)
            values[used] = np.maximum(z[at : at + used.sum()], 0.0)
            at += int(used.sum())
            found.append(values)
        return Multipliers(*found)


class _Stack:
    """Rows one above the other; columns: forces, squared speeds and, with a time, their roots and the times."""

    def __init__(self, program: CarryProgram):
        self.program, self.free = program, program.free
        self.known = np.where(self.free, 0.0, program.given)
        nodes = int(self.free.sum())
        self.widths = [program.count * program.A.shape[1], nodes]
        self.widths += [nodes, program.count] if program.step is not None else []
        self.rows, self.right, self.cones = list[sp.csr_matrix](), list[Array](), list[Cone]()

    def add(self, right: Array, *blocks: sp.spmatrix | None) -> None:
        """Rows with their right-hand side, in blocks of columns; None, or none at the end: zeros."""
        padded = [*blocks, *[None] * (len(self.widths) - len(blocks))]
        parts = [sp.csr_matrix((len(right), w)) if one is None else one for one, w in zip(padded, self.widths)]
        self.rows.append(sp.hstack(parts, format="csr"))
        self.right.append(right)

    def at_nodes(self, pairs: Array) -> tuple[sp.csr_matrix, Array]:
        """Rows (N m, free nodes) of values at both ends of each interval (N, m, 2); what known nodes make (N m,)."""
        N, m, _ = pairs.shape
        columns = np.repeat(self.program.nodes, m, axis=0).ravel()
        rows = sp.csr_matrix((pairs.ravel(), columns, np.arange(0, 2 * N * m + 1, 2)), (N * m, len(self.free)))
        return rows[:, self.free], rows @ self.known


def stack_cones(program: CarryProgram) -> Assembly:
    """The program over cones."""
    stack, N = _Stack(program), program.count
    each = sp.identity(N, format="csr")
    E, moved = stack.at_nodes(program.E)
    stack.add(program.e.ravel() + moved, sp.kron(each, program.A), -E)
    stack.cones.append(clarabel.ZeroConeT(N * len(program.A)))
    low, high, pairs = _add_limits(stack)
    _add_friction(stack)
    q, weights = np.zeros(sum(stack.widths)), np.zeros(sum(stack.widths))
    forces, nodes = stack.widths[:2]
    if program.step is not None:
        _add_times(stack)
        q[-N:] = 2.0 * program.step
    if program.gain is not None:
        q[forces : forces + nodes] = -program.gain[stack.free]
    if program.weights is not None:
        weights[:forces] = np.tile(program.weights, N)
    A, P = sp.vstack(stack.rows, format="csc"), sp.diags(weights, format="csc")
    for matrix in (A, P):
        matrix.eliminate_zeros()
    return Assembly(program, (P, q, A, np.concatenate(stack.right), stack.cones), low, high, pairs)


def _add_limits(stack: _Stack) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Rows that are linear, but for the friction; returns which of ``low``, ``high`` and ``pairs`` are among them."""
    program, known, free = stack.program, stack.known, stack.free
    N, k, d, before = program.count, program.k, program.friction.d, len(stack.right)
    R, (B, moved) = sp.kron(sp.identity(N), program.R, format="csr"), stack.at_nodes(program.B)
    low, high = np.isfinite(program.low), np.isfinite(program.high)
    for sign, end, used in ((-1.0, program.low, low), (1.0, program.high, high)):
        kept = used.ravel()
        stack.add(sign * (end.ravel() - moved)[kept], sign * R[kept], sign * B[kept])
    # Pairs that bind at no speeds within their limits are left out.
    most, least = (np.where(free, end, known)[program.nodes][:, None] for end in (program.top, 0.0))
    reach = np.maximum(program.C, 0.0) * most + np.minimum(program.C, 0.0) * least
    binding = reach.sum(axis=2) > program.c
    C, moved = stack.at_nodes(program.C)
    stack.add((program.c.ravel() - moved)[binding.ravel()], None, C[binding.ravel()])
    normal = sp.kron(sp.identity(N * k), np.eye(d)[-1:], format="csr")
    above = np.tile(program.least > 0, N)  # friction implies the others
    stack.add(-np.tile(program.least, N)[above], -normal[above])
    stack.add(np.tile(program.most, N), normal)
    # Over the limit: some are so far away that the solver's tolerance, over the largest number, would be none.
    stack.add(np.ones(free.sum()), None, sp.diags(1.0 / program.top[free]))
    if program.step is None:
        stack.add(np.zeros(free.sum()), None, -sp.identity(free.sum()))
    facets = program.friction.facets
    stack.add(
        np.zeros(N * k * len(facets)), sp.kron(sp.identity(N * k), np.column_stack([facets, -np.ones(len(facets))]))
    )
    stack.cones.append(clarabel.NonnegativeConeT(sum(map(len, stack.right[before:]))))
    return low, high, binding


def _add_friction(stack: _Stack) -> None:
    """|u| <= F_n of every contact whose friction is round."""
    program, n = stack.program, stack.program.friction.round_dimensions
    contacts = program.count * program.k
    if n:
        block = np.zeros((n + 1, program.friction.d))
        block[0, -1] = block[np.arange(1, n + 1), np.arange(n)] = -1.0
        stack.add(np.zeros(contacts * (n + 1)), sp.kron(sp.identity(contacts), block))
        stack.cones += contacts * [clarabel.SecondOrderConeT(n + 1)]


def _add_times(stack: _Stack) -> None:
    """t (r_i + r_i+1) >= 1 of every interval, then y >= r^2 of every node."""
    program = stack.program
    N, each = program.count, sp.identity(int(stack.free.sum()))
    roots = sp.csr_matrix((np.ones(2 * N), program.nodes.ravel(), np.arange(0, 2 * N + 1, 2)), (N, len(stack.free)))
    right = np.kron((roots @ np.sqrt(stack.known))[:, None], _FIRST) + np.tile(_MIDDLE, (N, 1))
    both = sp.kron(roots[:, stack.free], _FIRST)
    stack.add(right.ravel(), None, None, -both, -sp.kron(sp.identity(N), _SECOND))
    one = np.tile(_SECOND, (each.shape[0], 1)).ravel()
    stack.add(one, None, -sp.kron(each, _FIRST), -sp.kron(each, _MIDDLE))
    stack.cones += (N + each.shape[0]) * [clarabel.SecondOrderConeT(3)]
