"""Force closure: whether contacts can resist any wrench with forces of any size, and how evenly."""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from pinograsp.checks import brief, read_only
from pinograsp.contacts import ContactSet, Friction
from pinograsp.contacts.quality import Balance
from pinograsp.forces.matrices import balance_columns
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.conic import solve, solve_linear, sparse
from pinograsp.forces.solve.program import feasibility
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceClosure:
    """Whether contact forces of any size can resist *any* wrench (of the balance rows).

    Attributes:
        closed: whether they can.
        rank: of the grasp map's usable columns.
        margin: largest t such that forces with normal forces of sum 1 balance while every contact keeps a share t of
            its even part (1 / k) clear of its friction limit [-]; positive with full rank: force closure.
        separating: wrench (6,) that no contact force opposes, checked; zero if closed.
    """

    closed: bool
    rank: int
    margin: float
    separating: Array

    __repr__ = brief()


def force_closure(
    contacts: ContactSet, mu: ArrayLike, *, friction: Friction | None = None, balance: Balance = "wrench"
) -> ForceClosure:
    """Test force closure: whether the contacts' friction cones can balance every wrench (Nguyen 1988).

    Args:
        contacts: k contacts.
        mu: friction coefficient, a number or (k,) [-].
        friction: the friction model; None: as :class:`ForceProblem` chooses it.
        balance: ``"wrench"`` or ``"force"``.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> three = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> two = [[0.03, 0, 0], [-0.03, 0, 0]]  # no moment about the line between them
        >>> for points in (three, two):
        ...     contacts = pg.contacts_at(None, ball, points)
        ...     print(pg.force_closure(contacts, 0.6, friction=pg.Friction(model="cone")).closed)
        True
        False

    See Also:
        :func:`~pinograsp.forces.grasp_margins`; :mod:`pinograsp.contacts.quality` has measures of quality.
    """
    problem = ForceProblem(
        contacts=contacts,
        load=np.zeros(6),
        mu=mu,
        friction=friction,
        balance=balance,
    )
    A = balance_columns(problem, problem.friction.scale(problem.mu))
    rank = int(np.linalg.matrix_rank(A, tol=1e-9 * max(1.0, float(np.abs(A).max()))))
    margin, y = _interior(problem)
    closed = rank == problem.rows and margin > 1e-8
    separating = np.zeros(6)
    if not closed:
        separating[: problem.rows] = _separate(problem, A, rank, y)
    return ForceClosure(closed=closed, rank=rank, margin=max(margin, 0.0), separating=read_only(separating))


def min_weight(contacts: ContactSet, mu: ArrayLike, *, edges: int = 8, balance: Balance = "wrench") -> float:
    """Min-weight metric [-]: the largest l such that weights >= l, of sum 1, on the edges of all friction pyramids
    balance.

    It is normalised by the number of edges, so it lies in [0, 1]; it is positive exactly if positive weights on all
    edges balance (Li et al., FRoGGeR, 2023). A linear program.
    """
    problem = ForceProblem(contacts=contacts, load=np.zeros(6), mu=mu, friction=Friction(edges=edges), balance=balance)
    A = balance_columns(problem, problem.friction.scale(problem.mu)).reshape(problem.rows, problem.k, 3)
    corners = problem.friction.vertices
    edge_wrenches = (A[:, :, :2] @ corners.T + A[:, :, 2:]).reshape(problem.rows, -1)
    count = edge_wrenches.shape[1]
    # Variables: weights, l. Maximise l.
    rows = np.block(
        [
            [edge_wrenches, np.zeros((problem.rows, 1))],
            [np.ones((1, count)), np.zeros((1, 1))],
            [-np.eye(count), np.ones((count, 1))],
        ]
    )
    q = np.append(np.zeros(count), -1.0)
    b = np.concatenate([np.zeros(problem.rows), [1.0], np.zeros(count)])
    cones = [clarabel.ZeroConeT(problem.rows + 1), clarabel.NonnegativeConeT(count)]
    found = solve(sp.csc_matrix((count + 1, count + 1)), q, sparse(rows), b, cones)
    # Certified without the solver: weights that balance to rounding, and the least of them.
    equations = np.vstack([edge_wrenches, np.ones(count)])
    weights = np.array(found.x)[:count]
    if not np.isfinite(weights).all():
        return 0.0
    weights -= np.linalg.pinv(equations) @ (equations @ weights - b[: problem.rows + 1])
    balances = np.abs(equations @ weights - b[: problem.rows + 1]).max() <= 1e-9
    return max(0.0, float(weights.min()) * count) if balances else 0.0


def _interior(problem: ForceProblem) -> tuple[float, Array]:
    """Largest t with balanced forces of sum 1 whose F_n and distance from the friction limit are t / k, and its dual y.

    With F = F' + t / k the cones read u in F' U, so t enters only the balance and the sum.
    """
    k, n = problem.k, problem.k * problem.friction.d
    program = feasibility(problem, np.zeros(k), np.ones(k))
    mean = program.A.reshape(problem.rows, k, -1)[:, :, -1].mean(axis=1)
    total = np.zeros((1, n))
    total[0, program.d - 1 :: program.d] = 1.0
    equal = np.block([[program.A, mean[:, None]], [total, np.ones((1, 1))]])
    q = np.zeros(n + 1)
    q[n] = -1.0
    right = np.append(np.zeros(problem.rows), 1.0)
    found = solve_linear(program, equal, right, q, least=np.eye(1, n + 1, n))
    if found is None:
        return 0.0, np.zeros(problem.rows)
    # Certified without the solver: t of forces that balance to rounding.
    x, every = found[0][:n], np.vstack([program.A, total])
    x[program.d - 1 :: program.d] += found[0][n] / k
    x -= np.linalg.pinv(every) @ (every @ x - right)
    z = x.reshape(k, -1)
    balances = np.abs(every @ x - right).max() <= 1e-9
    margin = k * float((z[:, -1] - problem.friction.gauge(z[:, :-1])).min()) if balances else 0.0
    return margin, found[1][: problem.rows]


def _separate(problem: ForceProblem, A: Array, rank: int, y: Array) -> Array:
    """A unit direction that no contact force opposes: y . A x >= 0 for every x in the cones."""
    if rank < problem.rows:
        return np.linalg.svd(A)[0][:, -1]
    y = y / max(float(np.linalg.norm(y)), 1e-300)
    program = feasibility(problem, np.zeros(problem.k), np.ones(problem.k))
    return y if program.reduce_costs(y @ A).min() >= -1e-6 else np.zeros(problem.rows)
