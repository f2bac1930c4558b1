"""A problem's matrices in the layout of the compiled methods: contact by contact."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.certificate import TOLERANCE
from pinograsp.forces.kernels.layouts import Friction, Grasp, Limits, Rows, Scalars
from pinograsp.forces.matrices import Matrices
from pinograsp.forces.problem import ForceProblem


class Template:
    """Matrices in the layout of the compiled methods (:mod:`pinograsp.forces.kernels.layouts`).

    Attributes:
        matrices: in the general layout.
        order: indices of the torque rows in the matrices: those of several contacts, then those of one. Rows that no
            contact enters are left out where they hold.
        rows: balance and torque rows.
        limits: of single contacts.
        friction: the cone.
        R_lo: least values of the torque rows, in their order [N].
        R_hi: largest values of the torque rows, in their order [N].
        P: blocks of the quadratic objective (k, d, d), in newtons and the objective's unit.
        q: linear objective (k, d), in newtons and the objective's unit.
    """

    def __init__(self, matrices: Matrices):
        """Sort the torque rows, and lay everything out contact by contact."""
        k, d, friction, m = matrices.k, matrices.d, matrices.friction, matrices.rows
        self.matrices = matrices
        enters = np.abs(matrices.R.reshape(-1, k, d)).max(axis=2) > 0
        entered = enters.sum(axis=1)
        # Joints that no contact loads count where gravity alone is too much for them: then there are no forces.
        alone = (entered == 1) | ((entered == 0) & ((matrices.R_lo > 0) | (matrices.R_hi < 0)))
        self.order = np.concatenate([np.flatnonzero(entered > 1), np.flatnonzero(alone)])
        rows = np.vstack([matrices.A, matrices.R[self.order]])
        B, shared = (
            np.ascontiguousarray(rows.reshape(-1, k, d).transpose(1, 2, 0)),
            m + int(np.count_nonzero(entered > 1)),
        )
        enters = np.vstack([np.ones((m, k), dtype=bool), enters[self.order]])
        touched, counts = np.zeros((k, len(rows)), dtype=np.int64), np.empty((k, 2), dtype=np.int64)
        for i, entered in enumerate(enters.T):
            at = np.flatnonzero(entered)
            touched[i, : len(at)] = at
            counts[i] = np.count_nonzero(at < shared), len(at)
        A = np.zeros((shared + -shared % 3, d * k))
        A[:shared] = B[:, :, :shared].transpose(2, 1, 0).reshape(shared, -1)
        self.rows = Rows(A, B, touched, counts, shared)
        self.R_lo, self.R_hi = matrices.R_lo[self.order], matrices.R_hi[self.order]
        self.friction = Friction(
            facets=np.hstack([-friction.facets, np.ones((len(friction.facets), 1))]),
            vertices=np.array(friction.vertices) if friction.polyhedral else np.zeros((0, 2)),
            radii=friction.radii,
            n_round=friction.round_dimensions,
        )
        self.limits = self._limits()
        self.P = np.ascontiguousarray(matrices.blocks())
        self.q = matrices.q.reshape(k, d)

    def grasp(self, problem: ForceProblem) -> Grasp:
        """All that does not depend on the load; ``problem`` shares these matrices."""
        widths = np.ones(self.q.shape)
        widths[:, :-1] = problem.friction.scale(problem.mu)
        largest = float(np.einsum("kjj->kj", self.P).max())
        return Grasp(
            rows=self.rows,
            limits=self.limits,
            friction=self.friction,
            P=self.P,
            q=self.q,
            R_lo=self.R_lo,
            R_hi=self.R_hi,
            correction=self.matrices.correction,
            widths=widths,
            grasp_matrix=problem.contacts.G,
            normals=problem.contacts.rotations_oc[:, :, 2],
            scalars=Scalars(self.matrices.constant, largest, problem.moment_length, TOLERANCE.active),
        )

    def _limits(self) -> Limits:
        """Facets, F_n and torque rows of one contact."""
        k, d, facets, (_, B, touched, counts, _) = self.matrices.k, self.matrices.d, self.friction.facets, self.rows
        alone = counts[:, 1] - counts[:, 0]
        G = np.concatenate([np.repeat(facets[:, :, None], k, axis=2), np.zeros((1 + alone.max(), d, k))])
        G[len(facets), -1] = 1.0
        own = np.full((alone.max(), k), -1)
        for i in range(k):
            own[: alone[i], i] = at = touched[i, counts[i, 0] : counts[i, 1]]
            G[len(facets) + 1 : len(facets) + 1 + alone[i], :, i] = B[i][:, at].T
        return Limits(G, np.any(G != 0.0, axis=2).astype(np.int64), own)
