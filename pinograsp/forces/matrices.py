"""The matrices of a force problem, in newtons, which depend neither on load nor on impact time. Pure functions.

Scaled variables are per contact x_i = (u_i, F_i): tangential force (and torsion) and normal force, so that friction of
every model reads u_i in F_i U (:mod:`pinograsp.contacts.friction`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import brief
from pinograsp.contacts import Friction
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.torque_limits import TorqueLimits
from pinograsp.spatial import Array

_SAME = 1e-12  # relative difference of weights that count as equal
_TRACE = 1e-6  # of the load, by which the torques of an underactuated hand may miss their ratio
_RANK = 1e-9  # singular values of the grasp map below this share of the largest count as zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matrices:
    """A force problem's matrices for one objective; see :mod:`pinograsp.forces.solve.program` for the symbols.

    Attributes:
        friction: the friction model.
        k: number of contacts.
        d: variables per contact.
        weights: the objective, ``{name: weight}``.
        A: balance (rows, k d), moments over the moment length.
        correction: pseudo-inverse of A (k d, rows): the least change of x that removes a residual.
        R: torque rows (m, k d), of unit norm; the last ``fixed`` of them are those of an
            underactuated hand.
        fixed: number of torque rows of an underactuated hand.
        R_lo: least values of R x (m,) [N].
        R_hi: largest values of R x (m,) [N].
        R_norm: norms that the rows were divided by (m,) [m].
        R_reach: largest absolute value of row . x per newton of F_n (m, k).
        P: quadratic objective (k d, k d), or None.
        P_size: its largest diagonal entry.
        q: linear objective (k d,).
        constant: constant term of the objective.
    """

    friction: Friction
    k: int
    d: int
    weights: dict[str, float]
    A: Array
    correction: Array
    R: Array
    fixed: int
    R_lo: Array
    R_hi: Array
    R_norm: Array
    R_reach: Array
    P: Array | None
    P_size: float
    q: Array
    constant: float

    __repr__ = brief("friction", "k", "weights")

    @property
    def rows(self) -> int:
        """Balance rows: 3 or 6."""
        return len(self.A)

    @property
    def peak(self) -> float:
        """Weight of the largest normal force."""
        return self.weights.get("peak", 0.0)

    @property
    def decoupled(self) -> bool:
        """Whether the objective has no products of two contacts: what the compiled interior-point method takes."""
        return self.P is None or np.count_nonzero(self.P) == np.count_nonzero(self.blocks())

    @property
    def separates(self) -> bool:
        """Whether the dual's inner problems have a closed form: what the compiled Newton method takes."""
        if self.peak or not self.decoupled:
            return False
        if self.P is None:
            return True
        blocks = self.blocks()
        diagonal = np.einsum("kjj->kj", blocks)
        joint = 2 if self.friction.polyhedral and self.friction.edges > 4 else self.friction.round_dimensions
        own = diagonal[:, :joint]
        return bool(
            np.count_nonzero(blocks) <= np.count_nonzero(diagonal)
            and (own.shape[1] == 0 or np.all(np.ptp(own, axis=1) <= _SAME * own.max()))
        )

    def blocks(self) -> Array:
        """The diagonal blocks of P, one for each contact (k, d, d)."""
        if self.P is None:
            return np.zeros((self.k, self.d, self.d))
        at = np.arange(self.k)
        return self.P.reshape(self.k, self.d, self.k, self.d)[at, :, at, :]


def matrices_of(problem: ForceProblem, weights: Mapping[str, float]) -> Matrices:
    """The matrices of a problem for the objective ``weights``, see :func:`~.solve.program.weights_of`."""
    k, d, friction = problem.k, problem.friction.d, problem.friction
    widths = friction.scale(problem.mu)
    A = balance_columns(problem, widths)
    torque = None if problem.torques is None else torque_columns(problem, problem.torques, widths)
    R, R_lo, R_hi, R_norm = _torque_rows(problem, torque)
    under = None if problem.torques is None else problem.torques.underactuation
    rows = R.reshape(-1, k, d)
    P, q, constant = _quadratic(problem, weights, widths, torque)
    return Matrices(
        friction=friction,
        k=k,
        d=d,
        weights=dict(weights),
        A=A,
        correction=np.asarray(np.linalg.pinv(A, rcond=1e-10), dtype=float),
        R=R,
        fixed=0 if under is None else int(np.sum(under.limited_sides)),
        R_lo=R_lo,
        R_hi=R_hi,
        R_norm=R_norm,
        R_reach=np.abs(rows[:, :, -1]) + friction.support(rows[:, :, :-1]),
        P=P,
        P_size=0.0 if P is None else float(np.diag(P).max()) or 1.0,
        q=q,
        constant=constant,
    )


def balance_columns(problem: ForceProblem, widths: Array) -> Array:
    """Grasp map on x (rows, k d); ``widths`` (k, d - 1): scale of the friction model."""
    base, friction = problem.scaled_columns, problem.friction
    columns = np.zeros((problem.rows, problem.k, friction.d))
    columns[:, :, :2] = base[:, :, :2] * widths[None, :, :2]
    columns[:, :, -1] = base[:, :, 2]
    if friction.d == 4 and problem.rows == 6:
        normals = problem.contacts.rotations_oc[:, :, 2]
        columns[3:, :, 2] = (normals * widths[:, 2:3]).T / problem.moment_length
    return columns.reshape(problem.rows, -1)


def elastic_reaction(problem: ForceProblem) -> Array:
    """Change of the normal forces (k, rows) [-] per unit of a scaled wrench that is added to the load.

    The object rests on equally stiff springs, along the normals and along the surfaces, and gives way to the wrench:
    these are the normal parts of the contact forces of least squared size that balance it (Salisbury and Roth, 1983).
    With torsional friction a contact also resists turning about its normal, at an arm of its torsion [m].
    """
    friction, widths = problem.friction, np.ones((problem.k, problem.friction.d - 1))
    widths[:, 2:] = friction.torsion
    columns = balance_columns(problem, widths)
    inverse = np.asarray(np.linalg.pinv(columns, rcond=_RANK), dtype=float)
    return -inverse[friction.d - 1 :: friction.d]


def torque_columns(problem: ForceProblem, torques: TorqueLimits, widths: Array) -> Array:
    """Joint torques from x (n, k d) [N m per newton]; ``widths`` (k, d - 1): scale of the friction model."""
    rotations, d = problem.contacts.rotations_oc, problem.friction.d
    J = torques.jacobian
    linear = np.einsum("kxn,kxc->nkc", J[:, :3], rotations)
    columns = np.zeros((J.shape[2], problem.k, d))
    columns[:, :, :2] = linear[:, :, :2] * widths[None, :, :2]
    columns[:, :, -1] = linear[:, :, 2]
    if d == 4:
        columns[:, :, 2] = np.einsum("kxn,kx->nk", J[:, 3:], rotations[:, :, 2]) * widths[:, 2]
    return columns.reshape(J.shape[2], -1)


def _quadratic(
    problem: ForceProblem, weights: Mapping[str, float], widths: Array, torque: Array | None
) -> tuple[Array | None, Array, float]:
    """P, q and the constant of the quadratic objectives, in newtons and the objectives' units."""
    n = problem.k * problem.friction.d
    P: Array | None = None
    q, constant = np.zeros(n), 0.0
    if weights.get("least_squares"):
        size = np.ones((problem.k, problem.friction.d))
        size[:, :-1] = widths
        size[:, 2:-1] /= problem.moment_length
        P = np.diag(2 * weights["least_squares"] * size.ravel() ** 2)
    if weights.get("motor_heat") and problem.torques is not None and torque is not None:
        bias, weight = problem.torques.bias, weights["motor_heat"]
        heat = 2 * weight * torque.T @ torque
        P = heat if P is None else P + heat
        q = 2 * weight * bias @ torque
        constant = weight * float(bias @ bias)
    return P, q, constant


def _torque_rows(problem: ForceProblem, torque: Array | None) -> tuple[Array, Array, Array, Array]:
    """R, its bounds in newtons, and the norms [m] that the rows were divided by."""
    torques = problem.torques
    if torques is None or torque is None or not (np.any(torques.limited) or torques.underactuation):
        return np.zeros((0, problem.k * problem.friction.d)), np.zeros(0), np.zeros(0), np.zeros(0)
    limited = torques.limited
    limit, bias = torques.usable[limited], torques.bias[limited]
    rows = torque[limited]
    least, most = -limit - bias, limit - bias
    if (under := torques.underactuation) is not None:
        # Equations are limits that are the same but for friction, and for a trace of the load, without which programs
        # are hard to solve. What friction bears grows with F_n: a row for each side.
        own = under.rows @ torque
        room = _TRACE * float(np.linalg.norm(problem.scaled_load)) * np.linalg.norm(own, axis=1)
        value = under.torques - under.rows @ torques.bias
        borne = np.zeros_like(own)
        arms = np.linalg.norm(np.einsum("pn,kxn->pkx", under.rows, torques.jacobian[:, :3]), axis=2)
        borne[:, problem.friction.d - 1 :: problem.friction.d] = under.friction * arms
        above, below = under.limited_sides
        rows = np.concatenate([rows, (own - borne)[above], (own + borne)[below]])
        least = np.concatenate([least, np.full(int(above.sum()), -np.inf), (value - room)[below]])
        most = np.concatenate([most, (value + room)[above], np.full(int(below.sum()), np.inf)])
    norm = np.linalg.norm(rows, axis=1)
    norm[norm <= 1e-12 * max(float(norm.max()), 1e-300)] = 1.0
    return rows / norm[:, None], least / norm, most / norm, norm
