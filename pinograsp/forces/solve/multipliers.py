"""QP over the friction-pyramid multipliers (k1, k2): the equilibrium residual driven to zero, or to its true minimum.

With the normal forces fixed, the residual is affine in the multipliers, r(k) = H k + b (Eqs. 15, 27, 28), so

    minimise 1/2 ||H k + b||^2 + eps/2 ||k||^2   over   -1 <= k <= 1

is a convex QP. The certificate is the support bound: for y = r / ||r|| *any* multipliers leave at least
sum_i F_i s_i(y) + y . load, so the difference between ||r|| and that bound is a duality gap in newtons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pinograsp import core
from pinograsp.checks import array_of, at_least_zero, brief, frozen, instance_of, read_only, shorten
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import TOLERANCE, Certificate, load_size_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.solvers import QPSolverName, check_qp_solver, solve_qp
from pinograsp.spatial import Array

# Weight of ||k||^2 against ||r||^2 (normalised by the largest column): selects the least-norm multipliers. Below 1e-10
# active-set solvers fail on the nearly singular Hessian; at 1e-9 the residual is off by 1e-8 of the forces at most.
_LEAST_NORM = 1e-9
_PROXIMAL_STEPS = 20  # where contacts hardly resist a direction, the bias of that weight takes a few steps to vanish


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiplierSolution:
    """Multipliers for given normal forces.

    Attributes:
        status: ``OK`` (balanced), ``UNBALANCED`` (no multipliers leave less) or ``INACCURATE``.
        multipliers: (k1, k2) per contact (k, 2), in [-1, 1].
        forces_c: contact forces (k, 3) [N].
        direction: y (rows,), the unit direction of the residual, in which the load is not held; zeros at balance.
        certificate: its objective is the norm of the residual [N], moments over the moment length; the gap is relative
            to the largest tangential force.
        solver: name of the QP solver that ran.
    """

    status: Status
    multipliers: Array
    forces_c: Array
    direction: Array
    certificate: Certificate
    solver: str

    __repr__ = brief()


def refine_multipliers(
    problem: ForceProblem, normal_forces: ArrayLike, *, solver: QPSolverName = "daqp"
) -> MultiplierSolution:
    """Find the multipliers (k1, k2) that leave the smallest residual at fixed ``normal_forces`` (k,) [N]; of several,
    those of least norm.

    Raises:
        InvalidInput: negative or non-finite normal forces, or an unknown solver.
    """
    instance_of("problem", problem, ForceProblem)
    check_qp_solver(solver)
    normal = at_least_zero("normal forces", array_of("normal forces", normal_forces, (problem.k,)))
    columns = problem.scaled_columns
    H = (columns[:, :, :2] * (problem.pyramid * normal)[None, :, None]).reshape(problem.rows, -1)
    b = columns[:, :, 2] @ normal + problem.scaled_load
    scale = float(np.linalg.norm(H, axis=0).max(initial=0.0))
    bound = np.ones(2 * problem.k)
    if scale == 0:
        return _certify(problem, normal, np.zeros((problem.k, 2)), solver, scale)
    # Dimensionless, so that the solvers' tolerances mean the same for a millinewton and a kilonewton.
    H, b = H / scale, b / scale
    P = H.T @ H + _LEAST_NORM * np.eye(bound.size)
    k, left = np.zeros(bound.size), _PROXIMAL_STEPS
    while True:
        # From the second pass on the weight pulls towards the last answer, not to zero, so its bias vanishes.
        found = solve_qp(solver, P, H.T @ b - _LEAST_NORM * k, lb=-bound, ub=bound)
        k = k if found is None else np.clip(found, -1.0, 1.0)
        solution = _certify(problem, normal, k.reshape(-1, 2), solver, scale)
        left -= 1
        if found is None or not left or solution.status is not Status.INACCURATE or _may_balance(solution):
            break
    if _may_balance(solution):
        # Balance is not excluded: solve for it as an equation, without the small bias of the weight on ||k||.
        exact = _exact_balance(solver, H, b, bound)
        if exact is not None:
            candidate = _certify(problem, normal, exact.reshape(-1, 2), solver, scale)
            if candidate.status is Status.OK or candidate.certificate.objective <= solution.certificate.objective:
                solution = candidate
    return solution


def _may_balance(solution: MultiplierSolution) -> bool:
    """Whether the bound does not exclude balance."""
    return solution.certificate.lower_bound <= TOLERANCE.residual * solution.certificate.load_size


def _exact_balance(solver: str, H: Array, b: Array, bound: Array) -> Array | None:
    """Least-norm k in the box with H k = -b, or None. Dependent rows (contacts on a line) are removed first."""
    U, sigma, Vt = np.linalg.svd(H, full_matrices=False)
    rank = int(np.sum(sigma > 1e-10 * sigma[0]))
    A, target = Vt[:rank], -(U[:, :rank].T @ b) / sigma[:rank]
    k = solve_qp(solver, np.eye(bound.size), np.zeros(bound.size), A=A, b=target, lb=-bound, ub=bound)
    return None if k is None else np.clip(k, -1.0, 1.0)


def _certify(problem: ForceProblem, normal: Array, multipliers: Array, solver: str, scale: float) -> MultiplierSolution:
    forces = problem.forces(normal, multipliers)
    residual = problem.residual(forces)
    scaled = np.concatenate([residual[:3], residual[3:] / problem.moment_length])[: problem.rows]
    size, load_size = float(np.linalg.norm(scaled)), load_size_of(problem.scaled_load, normal)
    direction = scaled / size if size > 0 else np.zeros(problem.rows)
    lower = max(0.0, float(normal @ problem.support(direction) + direction @ problem.scaled_load))
    no_limits = frozen(np.zeros(problem.k, dtype=bool))
    certificate = Certificate(
        objective=size,
        lower_bound=min(lower, size),
        residual=frozen(residual),
        residual_norm=size,
        violation=0.0,
        load_size=load_size,
        force_size=max(load_size, float(normal.max())),
        objective_size=max(scale, 1e-12),
        at_friction=frozen(np.abs(multipliers).max(axis=1) >= 1 - TOLERANCE.active),
        at_least=no_limits,
        at_most=no_limits,
    )
    if size <= TOLERANCE.residual * load_size:
        status = Status.OK
    else:
        status = Status.UNBALANCED if certificate.relative_gap <= TOLERANCE.gap else Status.INACCURATE
    return MultiplierSolution(
        status=status,
        multipliers=read_only(multipliers),
        forces_c=frozen(forces),
        direction=frozen(direction),
        certificate=certificate,
        solver=solver,
    )


class MultiplierQP:
    """The multiplier QP at fixed normal forces for one load after another, in the compiled core.

    Attributes:
        multipliers: of the last load (k, 2); overwritten by the next.
    """

    def __init__(self, problem: ForceProblem, normal_forces: ArrayLike):
        """For a problem's contacts and friction, and ``normal_forces`` (k,) [N]; the problem's load is not used.

        Raises:
            InvalidInput: normal forces that are negative, or all zero.
            ExtraMissing: the compiled core is not installed.
        """
        instance_of("problem", problem, ForceProblem)
        normal = array_of("normal forces", normal_forces, (problem.k,))
        if np.any(normal < 0) or not normal.any():
            raise InvalidInput(f"normal forces: expected values >= 0 [N], not all zero, got {shorten(normal.tolist())}")
        columns = problem.scaled_columns
        H = (columns[:, :, :2] * (problem.pyramid * normal)[None, :, None]).reshape(problem.rows, -1)
        self.problem, self.normal_forces = problem, normal
        scale = float(np.linalg.norm(H, axis=0).max()) or 1.0
        row = np.full(problem.rows, 1.0 / scale)
        row[3:] /= problem.moment_length
        box = core.load().Box(H / scale, _LEAST_NORM, columns[:, :, 2] @ normal / scale, row)
        self._solve = box.solve
        self.multipliers: Array = box.k.reshape(-1, 2)
        self.solve(np.zeros(6))

    def solve(self, load: ArrayLike) -> Array:
        """Multipliers (k, 2) that leave the smallest residual under ``load`` (6,) [N, N m]; of several, those of least
        norm.

        Raises:
            InvalidInput: a load that is not six finite numbers.
        """
        if type(load) is not np.ndarray or load.shape != (6,) or load.dtype.char != "d":
            load = array_of("load", load, (6,))
        if not self._solve(load):
            array_of("load", load, (6,))
            self.multipliers[:] = refine_multipliers(self.problem.with_load(load), self.normal_forces).multipliers
        return self.multipliers
