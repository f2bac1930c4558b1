"""The force problem as other solvers take it: a quadratic program, or a program over cones. Records and their methods.

Both are the program of :mod:`pinograsp.forces.solve.program` at one impact time and objective: balance (Eq. 15),
friction (Eq. 16 for the paper's pyramid), the range of F_n (Eqs. 13), torque limits; the grasp energy (Eqs. 9 and 11)
as its objective, or another. They are dimensionless: a column's ``scale`` turns its unknown into newtons (of a
torsional moment, newton metres), and the objective in its own unit is ``objective_scale`` (1/2 x'P x + q'x) +
``constant``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, frozen, instance_of
from pinograsp.spatial import Array, IntArray

NORMAL = "f_n"  # the component that every contact has last


class Column(NamedTuple):
    """What one unknown of a program means.

    Attributes:
        contact: the contact's finger, or ``"contact i"`` if it has none; ``""`` for the largest F_n of all.
        component: ``"f_x"``, ``"f_y"`` (tangential, contact axes), ``"m_n"`` (torsional moment), ``"f_n"`` (normal),
            ``"max f_n"``, or ``"f_n^p"``, which stands for that power of the contact's F_n.
        unit: ``"N"``, ``"N m"``, or the power of newtons.
        scale: of these units per unit of the unknown.
    """

    contact: str
    component: str
    unit: str
    scale: float


class Cones(NamedTuple):
    """The cones of s = b - A x, in the order of the rows of A.

    Attributes:
        zero: rows of equations, s = 0.
        nonnegative: rows of inequalities, s >= 0.
        second_order: rows of each second-order cone, |s[1:]| <= s[0].
        power: exponent a of each power cone of three rows, s[0]^a s[1]^(1 - a) >= |s[2]|, s[0], s[1] >= 0.
    """

    zero: int
    nonnegative: int
    second_order: tuple[int, ...]
    power: tuple[float, ...]

    def clarabel(self) -> list[Any]:
        """The cones in Clarabel's form."""
        cones = [clarabel.ZeroConeT(self.zero), clarabel.NonnegativeConeT(self.nonnegative)]
        cones += [clarabel.SecondOrderConeT(size) for size in self.second_order]
        return cones + [clarabel.PowerConeT(exponent) for exponent in self.power]

    def scs(self) -> dict[str, Any]:
        """The cones in the form of SCS."""
        return {"z": self.zero, "l": self.nonnegative, "q": list(self.second_order), "p": list(self.power)}


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadraticProgram:
    """min 1/2 x'P x + q'x subject to G x <= h, A x = b, lb <= x <= ub: the conventions of qpsolvers' ``Problem``.

    Attributes:
        P: symmetric, positive semidefinite (n, n).
        q: (n,).
        G: inequalities (m, n); m may be 0.
        h: their right-hand side (m,).
        A: equations (p, n); p may be 0.
        b: their right-hand side (p,).
        lb: least values (n,), minus infinity without one.
        ub: largest values (n,), infinity without one.
    """

    P: Array
    q: Array
    G: Array
    h: Array
    A: Array
    b: Array
    lb: Array
    ub: Array

    __repr__ = brief("P", "G", "A")

    @property
    def matrices(self) -> tuple[Any, ...]:
        """P, q, G, h, A, b, lb, ub for ``qpsolvers.Problem(*qp.matrices)``: copies, and None if there are no rows."""
        rows = [(rows, right) if len(rows) else (None, None) for rows, right in ((self.G, self.h), (self.A, self.b))]
        return tuple(
            None if one is None else np.array(one) for one in (self.P, self.q, *rows[0], *rows[1], self.lb, self.ub)
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ConicProgram:
    """min 1/2 x'P x + q'x subject to A x + s = b, s in K: the standard form of Clarabel, SCS and CVXPY.

    Attributes:
        P: symmetric, positive semidefinite (n, n), compressed columns; SCS takes its upper triangle.
        q: (n,).
        A: (m, n), compressed columns.
        b: (m,).
        cones: K, in the order of the rows of A.
    """

    P: sp.csc_matrix
    q: Array
    A: sp.csc_matrix
    b: Array
    cones: Cones

    __repr__ = brief("q", "b", "cones")


class SolverAnswer(NamedTuple):
    """What a solver may return: x and, if available, multipliers, with the signs of qpsolvers' ``Solution``.

    Of a quadratic program P x + q + A'y + G'z + z_box = 0, z >= 0, z_box negative at a lower bound; of a conic one
    P x + q + A'z = 0, z in the dual cone.

    Attributes:
        x: (n,).
        y: of a quadratic program's equations (p,).
        z: of a quadratic program's inequalities (m,), or of all rows of a conic one.
        z_box: of a quadratic program's bounds (n,).
    """

    x: ArrayLike
    y: ArrayLike | None = None
    z: ArrayLike | None = None
    z_box: ArrayLike | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaledForces:
    """What a force problem's programs know of their unknowns.

    Attributes:
        columns: what each unknown means; by contact first, F_n last among its own.
        impact_time: t_I [s].
        weights: the objective, ``{name: weight}``.
        force_scale: unit of the forces [N].
        objective_scale: unit of the objective, in its own unit.
        constant: constant term of the objective, in its own unit.
        judge: makes the record of :meth:`solution`.
    """

    columns: tuple[Column, ...]
    impact_time: float
    weights: dict[str, float]
    force_scale: float
    objective_scale: float
    constant: float
    judge: Callable[[Array, Array | None, Array | None, bool], Any] = field(repr=False)

    def _by_contact(self, x: ArrayLike) -> Array:
        """Components (k, d), tangential (and torsion) first, F_n last [N, N m]."""
        scaled: Array = array_of("x", x, (len(self.columns),)) * np.array([column.scale for column in self.columns])
        components = [column.component for column in self.columns]
        k, d = components.count(NORMAL), components.index(NORMAL) + 1
        return scaled[: k * d].reshape(k, d)

    def forces(self, x: ArrayLike) -> Array:
        """Contact forces (k, 3) [N], contact axes, normal last, of the unknowns x (n,).

        Raises:
            InvalidInput: x that is not n finite numbers.
        """
        return frozen(self._by_contact(x)[:, [0, 1, -1]])

    def torsion(self, x: ArrayLike) -> Array:
        """Moments about the contact normals (k,) [N m] of x (n,); zeros without torsional friction."""
        own = self._by_contact(x)
        return frozen(own[:, 2].copy() if own.shape[1] == 4 else np.zeros(len(own)))


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceQP(QuadraticProgram, ScaledForces):
    """A force problem at one impact time as a quadratic program, see :class:`QuadraticProgram`, :class:`ScaledForces`.

    Columns: x of each contact, then the largest F_n if it counts. Rows of G: the friction polygon's edges (and the
    plain limit of torsion) by contact, F_n below the largest, torques below their upper and above their lower limits.

    Attributes:
        torque_rows: rows of G of each torque's upper and lower limit (t, 2); -1 without a limit.
    """

    torque_rows: IntArray = field(repr=False)

    __repr__ = brief("P", "G", "A", "weights", "impact_time", "force_scale")

    def solution(
        self, x: ArrayLike, *, y: ArrayLike | None = None, z: ArrayLike | None = None, settle: bool = True
    ) -> Any:  # Any: the record holds the problem, whose file comes after this one
        """The :class:`~pinograsp.forces.ConvexSolution` of x (n,) with this package's own certificate.

        Args:
            x: any answer; it need not be admissible.
            y: multipliers of A x = b, as in :class:`SolverAnswer`; the lower bound is proven with them. Without y and z
                one additional solve of this package finds multipliers.
            z: multipliers of G x <= h.
            settle: remove the balance's residual by the least correction first, as ``optimize_forces`` does; False: x
                is judged as it is.

        Returns:
            Status ``OK`` if the certificate accepts x, else ``INACCURATE``; ``certificate.is_optimal(tolerance)``
            answers for other tolerances.

        Raises:
            InvalidInput: arrays of another shape or not finite.
        """
        x = array_of("x", x, (len(self.q),))
        instance_of("settle", settle, bool)
        if y is None and z is None:
            return self.judge(x, None, None, settle)
        y = array_of("multipliers y", np.zeros(len(self.b)) if y is None else y, (len(self.b),))
        z = array_of("multipliers z", np.zeros(len(self.h)) if z is None else z, (len(self.h),))
        upper, lower = (np.where(rows >= 0, z[rows], 0.0) for rows in self.torque_rows.T)
        return self.judge(x, y, upper - lower, settle)


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceSOCP(ConicProgram, ScaledForces):
    """A force problem at one impact time as a program over cones, see :class:`ConicProgram`, :class:`ScaledForces`.

    Columns: x of each contact, the largest F_n if it counts, then for each power of the objective one per contact.
    Rows: balance; -F_n, F_n, friction's edges, torques below their upper and above their lower limits, F_n below the
    largest; friction cones (F_n, tangential) by contact; power cones (power, 1, F_n) by contact.

    Attributes:
        torque_rows: first row of A of the upper torque limits, and their number.
    """

    torque_rows: tuple[int, int] = field(repr=False)

    __repr__ = brief("q", "b", "cones", "weights", "impact_time", "force_scale")

    def solution(self, x: ArrayLike, *, z: ArrayLike | None = None, settle: bool = True) -> Any:  # Any: as above
        """The :class:`~pinograsp.forces.ConvexSolution` of x (n,) with this package's own certificate.

        ``z`` (m,): multipliers of the rows, as in :class:`SolverAnswer`. All else as for :meth:`ForceQP.solution`.
        """
        x = array_of("x", x, (len(self.q),))
        instance_of("settle", settle, bool)
        if z is None:
            return self.judge(x, None, None, settle)
        z = array_of("multipliers z", z, (len(self.b),))
        at, m = self.torque_rows
        return self.judge(x, z[: self.cones.zero], z[at : at + m] - z[at + m : at + 2 * m], settle)
