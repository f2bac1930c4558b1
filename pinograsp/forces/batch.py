"""Many force problems at once, on all cores: arrays in, arrays out (extra ``fast``)."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from pinograsp.checks import (
    are_rotations,
    array_of,
    brief,
    each_of,
    floats_of,
    frozen,
    instance_of,
    integer,
    items_of,
    mapping_of,
    one_of,
    read_only,
    shown,
)
from pinograsp.contacts import Contact, ContactSet, Friction
from pinograsp.contacts.compliance import MEASURES
from pinograsp.contacts.quality import BALANCES
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.backends import Backends
from pinograsp.forces.certificate import TOLERANCE, Tolerance, is_optimal
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import Program, assemble, weights_of
from pinograsp.forces.solvers import compiled_solvers

_AT_ONCE, _MOST_THREADS = 256, 1024  # problems per compiled call: Ctrl-C waits for one, about a millisecond


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceBatch:
    """N force problems of one friction model, with up to k contacts each; what lies beyond a problem's own is ignored.

    Attributes:
        points: contact points from the objects' centres of mass (N, k, 3) [m].
        rotations: contact frames R_oc (N, k, 3, 3).
        loads: external wrenches (N, 6), linear first, about the centres of mass [N, N m].
        mu: friction coefficients (N, k).
        low, high: least and largest F_n (N, k) [N]. Numbers apply to all.
        counts: contacts of each problem (N,); default: all k.
        friction: model, torsion and safety factor.
        balance: ``"wrench"`` or ``"force"``.
        moment_lengths: moments are divided by it to compare with forces (N,) [m]; default: the mean distance of the
            contacts.
        energies: grasp energies as powers of F_n, ``{"work" or "impulse": (N, t, 2)}``, pairs of coefficient and
            exponent (:func:`~pinograsp.contacts.energy_terms`); (t, 2) applies to all.
    """

    points: np.ndarray
    rotations: np.ndarray
    loads: np.ndarray
    mu: np.ndarray
    low: np.ndarray
    high: np.ndarray
    counts: np.ndarray | None = None
    friction: Friction = field(default_factory=Friction)
    balance: str = "wrench"
    moment_lengths: np.ndarray | None = None
    energies: Mapping[str, np.ndarray] = field(default_factory=dict)

    __repr__ = brief()

    def __post_init__(self):
        def put(name, value):
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
            raise InvalidInput(f"counts: expected {n} whole numbers from 1 to {k}, got {shown(self.counts)}")
        put("counts", read_only(counts.astype(np.int64)))
        used = np.arange(k) < counts[:, None]
        off = ~are_rotations(self.rotations) & used
        if off.any():
            at = tuple(int(i) for i in np.argwhere(off)[0])
            raise InvalidInput(
                f"rotations: expected contact frames that are rotations, that of problem {at[0]}, contact {at[1]} is "
                "not"
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
        energies = {}
        for name, terms in mapping_of("energies", self.energies).items():
            one_of("energy", name, MEASURES)
            terms = floats_of(f"terms of the {name}", terms)
            if terms.ndim == 2:
                terms = np.broadcast_to(terms, (n, *terms.shape))
            energies[name] = array_of(f"terms of the {name}", terms, (n, None, 2))
            if np.any(energies[name][:, :, 0] <= 0) or np.any(energies[name][:, :, 1] < 1):
                raise InvalidInput(f"terms of the {name}: expected coefficients > 0 and exponents >= 1")
        put("energies", energies)

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(cls, problems: Sequence[ForceProblem], impact_times) -> ForceBatch:
        """From problems, which may differ in everything but friction model and balance, each at its impact time [s].

        Raises:
            InvalidInput: torque limits, or problems of different friction models or balances.
        """
        problems = items_of("problems", problems, ForceProblem)
        if not problems:
            raise InvalidInput("batch: expected at least one problem")
        times = each_of("impact times", impact_times, len(problems))
        first, n, k = problems[0], len(problems), max(problem.k for problem in problems)
        made = {name: np.zeros((n, k)) for name in ("mu", "low", "high")}
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
            made["low"][i, :own], made["high"][i, :own] = problem.normal_force_range(problem.checked_impact_time(at))
            made["mu"][i, :own] = problem.mu
        energies = {}
        for name in MEASURES:
            terms = [problem.energy_terms(at, name) for problem, at in zip(problems, times)]
            most = max(map(len, terms))
            # Without damping there is a term less: the last one then counts as several.
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
            **made,
            counts=np.array([problem.k for problem in problems]),
            friction=first.friction,
            balance=first.balance,
            moment_lengths=np.array([problem.moment_length for problem in problems]),
            energies=energies,
        )


def _spread(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers that go into ``shape``, as an array of it."""
    values = floats_of(name, value)
    try:
        return array_of(name, np.broadcast_to(values, shape), shape)
    except ValueError as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"{name}: expected a number or shape {shape}, got {values.shape}") from None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchSolution:
    """Answers to a :class:`ForceBatch`; zeros where there is none.

    Attributes:
        status: (N,) of :class:`~pinograsp.errors.Status`: ``OK``, ``INFEASIBLE`` (proven) or ``INACCURATE``.
        forces_c: (N, k, 3) [N].
        torsion: moments about the normals (N, k) [N m].
        objective: (N,).
        lower_bound: of the objective, proven (N,).
        residual_norm: of what forces and load leave over (N,) [N, moments over the moment length].
        violation: of friction and bounds (N,) [N].
        load_size: size of the load, or of the least F_n without one (N,) [N].
        force_size: ``load_size`` or the largest F_n, whichever is more (N,) [N].
        general: how many were left to the general methods.
        elapsed: [s].
    """

    status: np.ndarray
    forces_c: np.ndarray
    torsion: np.ndarray
    objective: np.ndarray
    lower_bound: np.ndarray
    residual_norm: np.ndarray
    violation: np.ndarray
    load_size: np.ndarray
    force_size: np.ndarray
    general: int
    elapsed: float

    __repr__ = brief()

    @property
    def ok(self) -> np.ndarray:
        """Which have forces (N,) bool."""
        return self.status == Status.OK

    def is_optimal(self, tolerance: Tolerance = TOLERANCE) -> np.ndarray:
        """Which forces are optimal (N,) bool: the rule of :meth:`Certificate.is_optimal
        <pinograsp.forces.certificate.Certificate.is_optimal>`, the gap relative to the objective.
        """
        return self.ok & is_optimal(
            residual_norm=self.residual_norm,
            load_size=self.load_size,
            violation=self.violation,
            force_size=self.force_size,
            gap=self.objective - self.lower_bound,
            objective_size=np.abs(self.objective),
            tolerance=tolerance,
        )


def solve_batch(
    batch: ForceBatch, *, objective: str | Mapping[str, float] = "least_squares", threads: int | None = None
) -> BatchSolution:
    """The least-cost forces of every problem, as :func:`optimize_forces` finds them, by the dual Newton method on all
    cores.

    What that method does not take (pyramids of more edges, ``peak``, least squares of soft fingers) or does not finish
    goes to the general ones, one by one.

    Args:
        batch: the problems.
        objective: as for :func:`optimize_forces`; energies need the batch's ``energies``.
        threads: of the compiled code; default: all cores.

    Raises:
        InvalidInput: an objective that is unknown or has no energies.
        ExtraMissing: numba is not installed.
    """
    started = time.perf_counter()
    kernels = compiled_solvers()
    instance_of("batch (see ForceBatch.of)", batch, ForceBatch)
    threads = _cores() if threads is None else integer("threads", threads, at_least=1, at_most=_MOST_THREADS)
    weights = weights_of(objective, _problem(batch, 0))
    friction, (n, k) = batch.friction, batch.mu.shape
    for name in MEASURES:
        if weights.get(name) and name not in batch.energies:
            raise InvalidInput(
                f"objective '{name}': expected the batch's energies to have it (ForceBatch.of gives them)"
            )
    parts = [batch.energies[name] * [weights[name], 1.0] for name in MEASURES if weights.get(name)]
    terms = np.concatenate(parts, axis=1) if parts else np.zeros((n, 0, 2))
    squares = weights.get("least_squares", 0.0)
    takes = friction.separates and not weights.get("peak") and not (friction.model == "soft" and squares)
    forces, torsion, answers = np.zeros((n, k, 3)), np.zeros((n, k)), np.zeros((n, 4))
    codes = np.full(n, kernels.STALLED)
    given = (
        batch.points,
        batch.rotations,
        batch.counts,
        batch.loads,
        batch.mu / friction.safety,
        float(friction.torsion / friction.safety),
        batch.low,
        batch.high,
        batch.moment_lengths,
        6 if batch.balance == "wrench" else 3,
        float(squares),
        terms,
        friction.radii,
        friction.round_dimensions,
    )
    # Read-only, all of them: another kind of array would be compiled for again.
    given = [frozen(np.ascontiguousarray(one).view()) if isinstance(one, np.ndarray) else one for one in given]

    def solve(start: int) -> None:
        kernels.many(start, min(start + _AT_ONCE, n), *given, forces, torsion, answers, codes)

    starts = range(0, n if takes else 0, _AT_ONCE)
    if threads == 1 or len(starts) < 2:
        for start in starts:
            solve(start)
    else:
        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(solve, starts):  # the compiled code lets go of Python's lock
                pass
    kinds = np.empty(3, dtype=object)  # one by one: assigned at once they would become plain text
    kinds[kernels.CONVERGED], kinds[kernels.STALLED] = Status.OK, Status.INACCURATE
    kinds[kernels.INFEASIBLE] = Status.INFEASIBLE
    found = _solution(batch, kinds[codes], forces, torsion, answers, started)
    left = np.flatnonzero((codes == kernels.STALLED) | (found.ok & ~found.is_optimal()))
    if not len(left):
        return found
    for i in left:
        found.status[i] = _by_itself(batch, int(i), weights, forces, torsion, answers)
    return replace(_solution(batch, found.status, forces, torsion, answers, started), general=len(left))


def _solution(
    batch: ForceBatch,
    status: np.ndarray,
    forces: np.ndarray,
    torsion: np.ndarray,
    answers: np.ndarray,
    started: float,
) -> BatchSolution:
    """The record of forces (N, k, 3), torsion (N, k) and answers (N, 4), see :func:`pinograsp.forces.kernels.many`."""
    used = np.arange(batch.mu.shape[1]) < batch.counts[:, None]
    scaled = batch.loads.copy()
    scaled[:, 3:] = scaled[:, 3:] / batch.moment_lengths[:, None] if batch.balance == "wrench" else 0.0
    size = np.sqrt(np.einsum("nr,nr->n", scaled, scaled))
    least = np.where(used, batch.low, 0.0).max(axis=1)
    load_size = np.where(size > 0, size, np.where(least > 0, least, 1.0))
    return BatchSolution(
        status=status,
        forces_c=forces,
        torsion=torsion,
        objective=answers[:, 0],
        lower_bound=answers[:, 1],
        residual_norm=answers[:, 2],
        violation=answers[:, 3],
        load_size=load_size,
        force_size=np.maximum(load_size, forces[:, :, 2].max(axis=1)),
        general=0,
        elapsed=time.perf_counter() - started,
    )


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _problem(batch: ForceBatch, i: int) -> ForceProblem:
    own = batch.counts[i]
    contacts = tuple(
        Contact(finger=f"contact {j + 1}", link="", point_o=point, rotation_oc=rotation, length=None, distance=0.0)
        for j, (point, rotation) in enumerate(zip(batch.points[i, :own], batch.rotations[i, :own]))
    )
    return ForceProblem(
        contacts=ContactSet(contacts=contacts, com_o=np.zeros(3)),
        load=batch.loads[i],
        mu=batch.mu[i, :own],
        balance=batch.balance,
        friction=batch.friction,
        moment_length=batch.moment_lengths[i],
    )


def program_of(batch: ForceBatch, i: int, weights: Mapping[str, float]) -> tuple[ForceProblem, Program]:
    """Problem ``i`` by itself, for the general methods; ``weights`` as of :func:`weights_of`."""
    problem, own = _problem(batch, i), batch.counts[i]
    terms = {name: [tuple(term) for term in batch.energies[name][i].tolist()] for name in MEASURES if weights.get(name)}
    matrices = matrices_of(problem, weights)
    return problem, assemble(matrices, problem.scaled_load, terms, batch.low[i, :own], batch.high[i, :own])


def _by_itself(batch: ForceBatch, i: int, weights, forces, torsion, answers) -> Status:
    """One problem by the general methods: its status; forces, torsion and answers get its row."""
    (problem, program), own = program_of(batch, i, weights), batch.counts[i]
    found = Backends(program.matrices, "auto").solve(problem, program)
    if found.status is Status.OK:
        certificate = found.forces.certificate
        forces[i, :own], torsion[i, :own] = found.forces.forces_c, found.forces.torsion
        answers[i] = (
            certificate.objective,
            certificate.lower_bound,
            certificate.residual_norm,
            certificate.violation,
        )
    return found.status
