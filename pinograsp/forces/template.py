"""A problem's matrices in the layout of the compiled methods: contact by contact, in a few flat arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinograsp.forces.certificate import TOLERANCE
from pinograsp.forces.matrices import Matrices
from pinograsp.forces.problem import ForceProblem
from pinograsp.spatial import Array, IntArray

_Scalar = TypeVar("_Scalar", bound=np.generic)


class Template:
    """Matrices in the layout of the compiled methods (see :func:`pinograsp.forces.kernels.interior_point`).

    Attributes:
        matrices: in the general layout.
        rows: balance rows, then torque rows of several contacts, then torque rows of one contact (k, d, rows).
        order: indices of the torque rows in the matrices.
        schur: number of rows in the Schur complement: all but the torque rows of one contact.
        touched: rows that a contact enters (k, rows); the first ``counts[i, 1]`` entries count.
        counts: number of rows that a contact enters below ``schur``, and in all (k, 2).
        R_lo: least values of the torque rows, in their order [N].
        R_hi: largest values of the torque rows, in their order [N].
        facets: of friction (r, d).
        n_round: round dimensions of friction.
        vertices: of polyhedral friction (v, 2).
        radii: of friction (d - 1,).
        components: A, G, used and own of the interior-point method.
        P: blocks of the quadratic objective (k, d, d), in newtons and the objective's unit.
        P_size: largest diagonal entry of these blocks.
        q: linear objective (k, d), in newtons and the objective's unit.
    """

    def __init__(self, matrices: Matrices):
        """Sort the torque rows, and lay everything out contact by contact."""
        k, d, friction, m = matrices.k, matrices.d, matrices.friction, matrices.rows
        self.matrices = matrices
        enters = np.abs(matrices.R.reshape(-1, k, d)).max(axis=2) > 0
        alone = enters.sum(axis=1) <= 1
        self.order = np.concatenate([np.flatnonzero(~alone), np.flatnonzero(alone)])
        rows = np.vstack([matrices.A, matrices.R[self.order]])
        self.rows = np.ascontiguousarray(rows.reshape(-1, k, d).transpose(1, 2, 0))
        self.schur = m + int(np.count_nonzero(~alone))
        enters = np.vstack([np.ones((m, k), dtype=bool), enters[self.order]])
        self.touched = np.zeros((k, len(rows)), dtype=np.int64)
        self.counts = np.empty((k, 2), dtype=np.int64)
        for i, entered in enumerate(enters.T):
            at = np.flatnonzero(entered)
            self.touched[i, : len(at)] = at
            self.counts[i] = np.count_nonzero(at < self.schur), len(at)
        self.R_lo, self.R_hi = matrices.R_lo[self.order], matrices.R_hi[self.order]
        self.facets = np.hstack([-friction.facets, np.ones((len(friction.facets), 1))])
        self.n_round = friction.round_dimensions
        self.vertices = np.array(friction.vertices) if friction.polyhedral else np.zeros((0, 2))
        self.radii = friction.radii
        self.components = self._by_component()
        self.P = np.ascontiguousarray(matrices.blocks())
        self.P_size = float(np.einsum("kjj->kj", self.P).max())
        self.q = matrices.q.reshape(k, d)

    def packed(self, problem: ForceProblem) -> tuple[IntArray, Array]:
        """Sizes and numbers of :func:`pinograsp.forces.kernels.solve_one`; ``problem`` shares these matrices."""
        A, limits, used, own = self.components
        k, d, all_rows = self.rows.shape
        m, widths = self.matrices.rows, np.ones((k, d))
        widths[:, :-1] = problem.friction.scale(problem.mu)
        sizes = (
            (k, d, m, all_rows, self.schur, self.n_round, len(A), len(self.facets), len(limits)),
            (len(self.vertices),),
            used,
            own,
            self.touched,
            self.counts,
        )
        numbers = (
            (self.matrices.constant, self.P_size, problem.moment_length, TOLERANCE.active),
            A,
            limits,
            self.rows,
            self.P,
            self.q,
            self.facets,
            self.vertices,
            self.radii,
            self.R_lo,
            self.R_hi,
            self.matrices.correction,
            widths,
            problem.contacts.G,
            problem.contacts.rotations_oc[:, :, 2],
        )
        return joined(sizes, np.int64), joined(numbers, np.float64)

    def _by_component(self) -> tuple[Array, Array, IntArray, IntArray]:
        """A, G, used and own of :func:`pinograsp.forces.kernels.interior_point`: contacts are neighbours in memory."""
        k, d, n = self.matrices.k, self.matrices.d, self.schur
        A = np.zeros((n + -n % 3, d * k))
        A[:n] = self.rows[:, :, :n].transpose(2, 1, 0).reshape(n, -1)
        alone = self.counts[:, 1] - self.counts[:, 0]
        facets = np.repeat(self.facets[:, :, None], k, axis=2)
        limits = np.concatenate([facets, np.zeros((1 + alone.max(), d, k))])
        limits[len(facets), -1] = 1.0
        own = np.full((alone.max(), k), -1)
        for i in range(k):
            own[: alone[i], i] = at = self.touched[i, self.counts[i, 0] : self.counts[i, 1]]
            limits[len(facets) + 1 : len(facets) + 1 + alone[i], :, i] = self.rows[i][:, at].T
        return A, limits, np.any(limits != 0.0, axis=2).astype(np.int64), own


def joined(parts: Iterable[ArrayLike], kind: type[_Scalar]) -> NDArray[_Scalar]:
    """All entries in one array (n,)."""
    return np.concatenate([np.asarray(part, dtype=kind).ravel() for part in parts])
