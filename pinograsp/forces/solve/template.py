"""A problem's matrices as the compiled core takes them: by component, contacts side by side."""

from __future__ import annotations

from typing import Any

import numpy as np

from pinograsp import core
from pinograsp.forces.certificate import TOLERANCE
from pinograsp.forces.matrices import Matrices
from pinograsp.forces.problem import ForceProblem


class Template:
    """Matrices in the layout of the core.

    Attributes:
        matrices: in the general layout.
        order: indices of the torque rows in the matrices. Rows that no contact enters are left out where they hold.
        R_lo: least values of the torque rows, in their order [N].
        R_hi: largest values of the torque rows, in their order [N].
        P: blocks of the quadratic objective (d, d, k), in newtons and the objective's unit.
        q: linear objective (d, k), in newtons and the objective's unit.
    """

    def __init__(self, matrices: Matrices):
        """Sort the torque rows, and lay everything out component by component."""
        k, d = matrices.k, matrices.d
        self.matrices = matrices
        enters = np.abs(matrices.R).max(axis=1, initial=0.0) > 0
        # Joints that no contact loads count where gravity alone is too much for them: then there are no forces.
        self.order = np.flatnonzero(enters | (matrices.R_lo > 0) | (matrices.R_hi < 0))
        rows = np.vstack([matrices.A, matrices.R[self.order]])
        self._rows = np.ascontiguousarray(rows.reshape(-1, k, d).transpose(0, 2, 1))
        self.R_lo, self.R_hi = matrices.R_lo[self.order], matrices.R_hi[self.order]
        self.P = np.ascontiguousarray(matrices.blocks().transpose(1, 2, 0))
        self.q = np.ascontiguousarray(matrices.q.reshape(k, d).T)
        self._grasp: Any = None

    def grasp(self, problem: ForceProblem) -> Any:
        """All that does not depend on the load, in the core; ``problem`` shares these matrices.

        Raises:
            ExtraMissing: the core is not installed.
        """
        if self._grasp is None:
            self._grasp = self._make_grasp(problem)
        return self._grasp

    def _make_grasp(self, problem: ForceProblem) -> Any:
        friction, (d, k), m = self.matrices.friction, self.q.shape, self.matrices.rows
        widths = np.ones((k, d))
        widths[:, :-1] = problem.friction.scale(problem.mu)
        setup = core.load().GraspSetup()
        setup.k, setup.m, setup.r = k, m, len(self.order)
        setup.d, setup.round, setup.separates = d, friction.round_dimensions, self.matrices.separates
        setup.facets = np.ascontiguousarray(friction.facets, dtype=float)
        setup.vertices = np.array(friction.vertices) if friction.polyhedral else np.zeros((0, 2))
        setup.B = self._rows
        setup.P = self.P
        setup.q = self.q
        setup.R_lo = self.R_lo
        setup.R_hi = self.R_hi
        setup.correction = np.ascontiguousarray(self.matrices.correction.reshape(k, d, m).transpose(1, 0, 2))
        setup.widths = np.ascontiguousarray(widths.T)
        setup.grasp_matrix = np.ascontiguousarray(problem.contacts.G)
        setup.normals = np.ascontiguousarray(problem.contacts.rotations_oc[:, :, 2])
        setup.constant = self.matrices.constant
        setup.largest = float(np.einsum("jjk->jk", self.P).max())
        setup.peak = self.matrices.peak
        setup.arm = problem.moment_length
        setup.near = TOLERANCE.active
        return core.load().Grasp(setup)
