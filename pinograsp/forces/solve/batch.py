"""Batches of force problems, solved on all cores: arrays in, arrays out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinograsp import core
from pinograsp.checks import (
    are_rotations,
    array_of,
    brief,
    each_of,
    floats_of,
    instance_of,
    integer,
    items_of,
    mapping_of,
    one_of,
    read_only,
    shorten,
)
from pinograsp.contacts import Friction
from pinograsp.contacts.compliance import MEASURES
from pinograsp.contacts.contact_set import bare_contacts
from pinograsp.contacts.friction import CONE
from pinograsp.contacts.quality import BALANCES, Balance
from pinograsp.core.threads import call_in_parts
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import TOLERANCE, Tolerance
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.answers import CertifiedForces
from pinograsp.forces.solve.compiled import CompiledForces
from pinograsp.forces.solve.program import EnergyTerms, Objective, Program, assemble, weights_of
from pinograsp.forces.solve.solver_order import SolverOrder
from pinograsp.spatial import Array, BoolArray, IntArray

_MOST_THREADS = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceBatch:
    """N force problems of one friction model, with up to k contacts each.

    Numbers, or arrays that broadcast to the shape, are accepted for ``mu``, ``low``, ``high`` and ``moment_lengths``.

    Attributes:
        points: contact points from the objects' centres of mass (N, k, 3) [m].
        rotations: contact frames R_oc (N, k, 3, 3).
        loads: external wrenches (N, 6), linear first, about the centres of mass [N, N m].
        mu: friction coefficients (N, k) [-].
        low: least F_n (N, k) [N].
        high: largest F_n (N, k) [N].
        counts: number of contacts of each problem (N,), further entries are ignored; default: all k.
        friction: model, torsion and safety factor; default: cones.
        balance: ``"wrench"`` or ``"force"``.
        moment_lengths: moments are divided by these lengths to compare with forces (N,) [m]; default: the mean distance
            of the contacts.
        energies: grasp energies as powers of F_n, ``{"work" or "impulse": (N, t, 2)}``, pairs of coefficient and
            exponent (:func:`~pinograsp.contacts.energy_terms`); (t, 2) applies to all problems.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> batch = pg.ForceBatch.of([problem, problem.with_load(2 * problem.load)], 0.9)
        >>> print(batch.loads.round(2))
        [[ 0.    0.   -1.96  0.    0.    0.  ]
         [ 0.    0.   -3.92  0.    0.    0.  ]]

    See Also:
        :func:`~pinograsp.forces.solve_batch`.
    """

    points: Array
    rotations: Array
    loads: Array
    mu: Array
    low: Array
    high: Array
    counts: IntArray = None  # type: ignore[assignment]  # None becomes an array in __post_init__
    friction: Friction = CONE
    balance: Balance = "wrench"
    moment_lengths: Array = None  # type: ignore[assignment]  # None becomes an array in __post_init__
    energies: Mapping[str, Array] = field(default_factory=dict)

    if TYPE_CHECKING:  # arguments may be numbers and lists, attributes are arrays

        def __init__(
            self,
            *,
            points: ArrayLike,
            rotations: ArrayLike,
            loads: ArrayLike,
            mu: ArrayLike,
            low: ArrayLike,
            high: ArrayLike,
            counts: ArrayLike | None = ...,
            friction: Friction = ...,
            balance: Balance = ...,
            moment_lengths: ArrayLike | None = ...,
            energies: Mapping[str, ArrayLike] = ...,
        ) -> None: ...

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        points = array_of("points", self.points, (None, None, 3))
        n, k = points.shape[:2]
        if not n or not k:
            raise InvalidInput(f"points: expected at least one problem with one contact, got shape {points.shape}")
        put("points", points)
        put("rotations", array_of("rotations", self.rotations, (n, k, 3, 3)))
        put("loads", array_of("loads", self.loads, (n, 6)))
        counts = np.full(n, k, dtype=float) if self.counts is None else floats_of("counts", self.counts)
        if counts.shape != (n,) or not np.all((counts >= 1) & (counts <= k) & (counts == np.floor(counts))):
            raise InvalidInput(f"counts: expected {n} integers from 1 to {k}, got {shorten(self.counts)}")
        put("counts", read_only(counts.astype(np.int64)))
        used = np.arange(k) < counts[:, None]
        off = ~are_rotations(self.rotations) & used
        if off.any():
            at = tuple(int(i) for i in np.argwhere(off)[0])
            raise InvalidInput(
                f"rotations: expected orthonormal right-handed contact frames, not so in problem {at[0]}, contact "
                f"{at[1]}"
            )
        for name, least in (("mu", 0.0), ("low", 0.0), ("high", None)):
            put(name, _spread(name, getattr(self, name), (n, k)))
            if least is not None and np.any(getattr(self, name)[used] < least):
                raise InvalidInput(f"{name}: expected values >= 0")
        if np.any((self.low > self.high)[used]):
            at = tuple(int(i) for i in np.argwhere((self.low > self.high) & used)[0])
            raise InvalidInput(f"low, high: expected low <= high, not so in problem {at[0]}, contact {at[1]}")
        instance_of("friction", self.friction, Friction)
        one_of("balance", self.balance, BALANCES)
        if self.moment_lengths is None:
            mean = np.where(used, np.linalg.norm(points, axis=2), 0.0).sum(axis=1) / counts
            put("moment_lengths", read_only(np.where(mean > 0, mean, 1.0)))
        else:
            lengths = _spread("moment lengths", self.moment_lengths, (n,))
            if np.any(lengths <= 0):
                raise InvalidInput("moment lengths: expected values > 0 [m]")
            put("moment_lengths", lengths)
        energies: dict[str, Array] = {}
        for name, value in mapping_of("energies", self.energies).items():
            one_of("energy", name, MEASURES)
            terms = floats_of(f"terms of the {name}", value)
            if terms.ndim == 2:
                terms = np.broadcast_to(terms, (n, *terms.shape))
            energies[name] = array_of(f"terms of the {name}", terms, (n, None, 2))
            if np.any(energies[name][:, :, 0] <= 0) or np.any(energies[name][:, :, 1] < 1):
                raise InvalidInput(f"terms of the {name}: expected coefficients > 0 and exponents >= 1")
        put("energies", energies)

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(cls, problems: Sequence[ForceProblem], impact_times: ArrayLike) -> ForceBatch:
        """A batch of problems, each at its impact time [s]; friction model and balance must be the same for all.

        Raises:
            InvalidInput: torque limits, or problems of different friction models or balances.
        """
        problems = items_of("problems", problems, ForceProblem)
        if not problems:
            raise InvalidInput("batch: expected at least one problem")
        times = each_of("impact times", impact_times, len(problems))
        first, n, k = problems[0], len(problems), max(problem.k for problem in problems)
        mu, low, high = np.zeros((n, k)), np.zeros((n, k)), np.zeros((n, k))
        points, rotations = np.zeros((n, k, 3)), np.zeros((n, k, 3, 3))
        for i, (problem, at) in enumerate(zip(problems, times)):
            if problem.friction != first.friction or problem.balance != first.balance:
                raise InvalidInput(
                    f"batch: expected one friction model and balance, those of problem {i} differ from the first's"
                )
            if problem.torques is not None:
                raise InvalidInput(f"batch: problem {i} has torque limits: use optimize_forces")
            own = problem.k
            points[i, :own], rotations[i, :own] = (
                problem.contacts.points_o - problem.contacts.com_o,
                problem.contacts.rotations_oc,
            )
            low[i, :own], high[i, :own] = problem.normal_force_range(problem.checked_impact_time(at))
            mu[i, :own] = problem.mu
        energies: dict[str, Array] = {}
        for name in MEASURES:
            terms = [problem.energy_terms(at, name) for problem, at in zip(problems, times)]
            most = max(map(len, terms))
            # Without damping there are fewer terms: the last one is then split into equal parts.
            energies[name] = np.array(
                [
                    [*own[:-1], *[(own[-1][0] / (most - len(own) + 1), own[-1][1])] * (most - len(own) + 1)]
                    for own in terms
                ]
            )
        return cls(
            points=points,
            rotations=rotations,
            loads=np.array([problem.load for problem in problems]),
            mu=mu,
            low=low,
            high=high,
            counts=np.array([problem.k for problem in problems]),
            friction=first.friction,
            balance=first.balance,
            moment_lengths=np.array([problem.moment_length for problem in problems]),
            energies=energies,
        )


def _spread(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """``value``, broadcast to ``shape``."""
    values = floats_of(name, value)
    try:
        return array_of(name, np.broadcast_to(values, shape), shape)
    except ValueError as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"{name}: expected a number or shape {shape}, got {values.shape}") from None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchSolution:
    """Answers to a :class:`ForceBatch`; zeros if a problem has none.

    Attributes:
        status: of each problem (N,), a :class:`~pinograsp.errors.Status`: ``OK``, ``INFEASIBLE`` (proven) or
            ``INACCURATE``.
        forces_c: contact forces (N, k, 3) [N].
        torsion: moments about the contact normals (N, k) [N m].
        objective: values at the forces (N,).
        lower_bound: proven lower bounds of the objective (N,).
        residual_norm: norms of the balance residuals (N,) [N, moments over the moment length].
        violation: largest violations of friction and bounds (N,) [N].
        load_size: size of the load, or of the least F_n without one (N,) [N].
        general: number of problems that went to the general methods.
        elapsed: computing time [s].
    """

    status: NDArray[Any]  # of Status
    forces_c: Array
    torsion: Array
    objective: Array
    lower_bound: Array
    residual_norm: Array
    violation: Array
    load_size: Array
    general: int
    elapsed: float

    __repr__ = brief()

    @property
    def force_size(self) -> Array:
        """``load_size`` or the largest F_n, whichever is larger (N,) [N]."""
        size: Array = np.maximum(self.load_size, self.forces_c[:, :, 2].max(axis=1))
        return size

    @property
    def ok(self) -> BoolArray:
        """Which have forces (N,) bool."""
        solved: BoolArray = self.status == Status.OK
        return solved

    def is_optimal(self, tolerance: Tolerance = TOLERANCE) -> BoolArray:
        """Which forces are optimal (N,) bool: the rule of :meth:`Certificate.is_optimal
        <pinograsp.forces.certificate.Certificate.is_optimal>`, the gap relative to the objective.
        """
        accepted: BoolArray = self.ok & tolerance.accepts(
            residual_norm=self.residual_norm,
            load_size=self.load_size,
            violation=self.violation,
            force_size=self.force_size,
            gap=self.objective - self.lower_bound,
            objective_size=np.abs(self.objective),
        )
        return accepted


def solve_batch(
    batch: ForceBatch, *, objective: Objective = "least_squares", threads: int | None = None
) -> BatchSolution:
    """Find the least-cost forces of every problem, by the dual Newton method on all cores; see :func:`optimize_forces`.

    Problems that this method does not support (pyramids of more than 4 edges, ``peak``, least squares of soft fingers)
    or does not finish go to the general methods, one by one.

    Args:
        batch: the problems.
        objective: as for :func:`optimize_forces`; energies need the batch's ``energies``.
        threads: number of threads of the compiled code; default: one for each core.

    Raises:
        InvalidInput: an objective that is unknown or has no energies.
        ExtraMissing: the compiled core is not installed.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> batch = pg.ForceBatch.of([problem, problem.with_load(2 * problem.load)], 0.9)
        >>> print(pg.solve_batch(batch).forces_c[:, :, 2].round(1))
        [[1.1 1.1 1.1]
         [2.2 2.2 2.2]]

    See Also:
        :class:`~pinograsp.forces.ForceBatch`, :class:`~pinograsp.forces.ForceSolver`.
    """
    started = time.perf_counter()
    instance_of("batch (see ForceBatch.of)", batch, ForceBatch)
    threads = None if threads is None else integer("threads", threads, at_least=1, at_most=_MOST_THREADS)
    weights = weights_of(objective, None)
    friction, (n, k) = batch.friction, batch.mu.shape
    for name in MEASURES:
        if weights.get(name) and name not in batch.energies:
            raise InvalidInput(
                f"objective '{name}': expected the batch's energies to have it (ForceBatch.of gives them)"
            )
    parts = [batch.energies[name] * [weights[name], 1.0] for name in MEASURES if weights.get(name)]
    terms = np.concatenate(parts, axis=1) if parts else np.zeros((n, 0, 2))
    squares = weights.get("least_squares", 0.0)
    takes = friction.separates and not weights.get("peak") and not (friction.elliptic and squares)
    objectives, bounds, residuals, violations = np.zeros((4, n))
    found = BatchSolution(
        status=np.empty(n, dtype=object),
        forces_c=np.zeros((n, k, 3)),
        torsion=np.zeros((n, k)),
        objective=objectives,
        lower_bound=bounds,
        residual_norm=residuals,
        violation=violations,
        load_size=_load_sizes(batch),
        general=0,
        elapsed=0.0,
    )
    codes = np.full(n, core.STALLED, dtype=np.int64)
    given: dict[str, Any] = {
        "components": friction.d,
        "round": friction.round_dimensions,
        "rows": 6 if batch.balance == "wrench" else 3,
        "torsion": float(friction.torsion / friction.safety),
        "squares": float(squares),
        "points": batch.points,
        "rotations": batch.rotations,
        "counts": batch.counts,
        "loads": batch.loads,
        "mu": batch.mu / friction.safety,
        "low": batch.low,
        "high": batch.high,
        "arms": batch.moment_lengths,
        "terms": terms,
        # These are filled.
        "forces": found.forces_c,
        "moments": found.torsion,
        "objective": found.objective,
        "lower_bound": found.lower_bound,
        "residual": found.residual_norm,
        "violation": found.violation,
        "codes": codes,
    }
    call_in_parts("solve_batch", n if takes else 0, threads, given)
    kinds = {core.CONVERGED: Status.OK, core.STALLED: Status.INACCURATE, core.INFEASIBLE: Status.INFEASIBLE}
    for code, status in kinds.items():
        found.status[codes == code] = status
    left = np.flatnonzero((codes == core.STALLED) | (found.ok & ~found.is_optimal()))
    for i in left.tolist():
        found.status[i] = _solve_by_general_methods(batch, i, weights, found)
    return replace(found, general=len(left), elapsed=time.perf_counter() - started)


def _load_sizes(batch: ForceBatch) -> Array:
    """The size that forces are compared with (N,) [N]: that of the load, or of the least F_n without a load."""
    used = np.arange(batch.mu.shape[1]) < batch.counts[:, None]
    scaled = batch.loads.copy()
    scaled[:, 3:] = scaled[:, 3:] / batch.moment_lengths[:, None] if batch.balance == "wrench" else 0.0
    size = np.sqrt(np.einsum("nr,nr->n", scaled, scaled))
    least = np.where(used, batch.low, 0.0).max(axis=1)
    return np.where(size > 0, size, np.where(least > 0, least, 1.0))


def _problem(batch: ForceBatch, i: int) -> ForceProblem:
    own = batch.counts[i]
    return ForceProblem(
        contacts=bare_contacts(batch.points[i, :own], batch.rotations[i, :own], np.zeros(3)),
        load=batch.loads[i],
        mu=batch.mu[i, :own],
        balance=batch.balance,
        friction=batch.friction,
        moment_length=batch.moment_lengths[i],
    )


def program_of(batch: ForceBatch, i: int, weights: Mapping[str, float]) -> tuple[ForceProblem, Program]:
    """Problem ``i`` alone, for the general methods; ``weights`` as of :func:`weights_of`."""
    problem, own = _problem(batch, i), batch.counts[i]
    terms, matrices = _energy_terms(batch, i, weights), matrices_of(problem, weights)
    return problem, assemble(matrices, problem.scaled_load, terms, batch.low[i, :own], batch.high[i, :own])


def _energy_terms(batch: ForceBatch, i: int, weights: Mapping[str, float]) -> EnergyTerms:
    return {m: [(c, e) for c, e in batch.energies[m][i].tolist()] for m in MEASURES if weights.get(m)}


def _solve_by_general_methods(batch: ForceBatch, i: int, weights: Mapping[str, float], into: BatchSolution) -> Status:
    """The status of problem ``i``, whose entries of the other arrays are filled."""
    (problem, program), own = program_of(batch, i, weights), batch.counts[i]
    order, limits = SolverOrder(program.matrices, "auto"), (batch.low[i, :own], batch.high[i, :own])
    found: CompiledForces | CertifiedForces | None = None
    prepared = order.prepare(problem, _energy_terms(batch, i, weights), limits)
    if prepared is not None:
        found = prepared.forces(problem.load)
        if found is None and prepared.prove(problem.load) is not None:
            return Status.INFEASIBLE
    if found is None:
        outcome = order.solve(problem, program, tried=prepared is not None)
        if outcome.status is not Status.OK or outcome.forces is None:
            return outcome.status
        found = outcome.forces
    certificate = found.certificate
    into.forces_c[i, :own], into.torsion[i, :own] = found.forces_c, found.torsion
    into.objective[i], into.lower_bound[i] = certificate.objective, certificate.lower_bound
    into.residual_norm[i], into.violation[i] = certificate.residual_norm, certificate.violation
    return Status.OK
