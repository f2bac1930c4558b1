"""The records that force searches return: forces, and what the search knows of them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from pinograsp.checks import brief, frozen, read_only
from pinograsp.contacts import PenetrationProfile
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import Certificate, Infeasibility
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.solver_order import ProgramOutcome
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array
from pinograsp.words import by_name, lines_of


@dataclass(frozen=True, slots=True)
class Branch:
    """One interval of impact times of the search.

    Attributes:
        start: first t_I [s].
        end: last t_I [s].
        lower_bound: proven for every t_I in the interval, in the objective's unit; infinite if it is proven that no t_I
            in it admits forces.
        best: objective of the best forces found when the interval was visited.
        fate: ``"split"``, ``"infeasible"``, ``"bounded"`` (no forces in it cost less than ``best`` minus the gap) or
            ``"unresolved"``.
    """

    start: float
    end: float
    lower_bound: float
    best: float
    fate: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridLog:
    """Counts and bounds of a grid search.

    Attributes:
        points: size of the grid.
        cells: number of its points in (t_I, A) alone.
        qp_solves: number of QPs solved.
        cuts: number of half-spaces of cells that these QPs rejected.
        rejections: number of cells rejected by each constraint; they and the optimum add up to ``cells``.
        residual_bound: certified least norm of the residual of any multipliers at the normal forces found [N].
        closest: the least residual that was seen (6,) [N, N m] if no forces were found, else zeros.
    """

    points: int
    cells: int
    qp_solves: int
    cuts: int
    rejections: dict[str, int]
    residual_bound: float
    closest: Array

    __repr__ = brief()


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: see record_of
class ForceSolution:
    """Contact forces that a search found, or none.

    Attributes:
        status: ``OK``, ``INFEASIBLE`` (no admissible forces, or no point of the grid), ``INACCURATE`` or
            ``INTERRUPTED``.
        problem: the problem that was solved.
        search: ``"paper"``, ``"paper+qp"``, ``"hybrid"``, ``"convex"`` or ``"robust"``.
        solver: name of the method that ran, "" if none did.
        impact_time: t_I [s], None without a solution.
        forces_c: contact forces (k, 3) [N], empty without a solution.
        elapsed: computing time [s].
        torsion: moments about the contact normals (k,) [N m] (soft fingers), zeros otherwise.
    """

    status: Status
    problem: ForceProblem
    search: str
    solver: str
    impact_time: float | None
    forces_c: Array
    elapsed: float
    torsion: Array = field(default_factory=lambda: read_only(np.zeros(0)))

    __repr__ = brief("status", "search", "solver", "impact_time", "normal_forces", "residual", "elapsed")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        if not self.found:
            return lines_of(f"{self.status}: no contact forces; {self.status.remedy}", *self._proven())
        names, forces = self.problem.contacts.names, self.normal_forces.tolist()
        tangential = np.linalg.norm(self.forces_c[:, :2], axis=1)
        limit = self.problem.mu * self.normal_forces
        used = np.divide(100 * tangential, limit, out=np.zeros(len(limit)), where=limit > 0).tolist()
        return lines_of(
            f"{self.status}: contact forces for an impact at {self.impact_time:g} s",
            f"normal forces: {by_name(names, forces, 'N')}",
            f"friction used, of mu F_n: {by_name(names, used, '%')}",
            f"residual {self.residual_force:.1e} N, {self.residual_moment:.1e} N m",
            *self._proven(),
            f"{self.search} search, {self.solver or 'no solver'}, {self.elapsed:.3g} s",
        )

    def _proven(self) -> tuple[str, ...]:
        """What is proven of the forces, or of their absence."""
        return ()

    @property
    def found(self) -> bool:
        """Whether there are forces; those of an interrupted search are the best so far."""
        return self.impact_time is not None

    @property
    def normal_forces(self) -> Array:
        """F_n at t_F (k,) [N]."""
        return self.forces_c[:, 2]

    @property
    def multipliers(self) -> Array:
        """(k1, k2) (k, 2) of Eqs. (27, 28) [-]; zeros without friction or without a normal force."""
        if not self.found:
            return read_only(np.zeros((0, 2)))
        half = (self.problem.pyramid * self.normal_forces)[:, None]
        return frozen(np.divide(self.forces_c[:, :2], half, out=np.zeros((len(half), 2)), where=half > 0))

    @property
    def acceleration(self) -> Array:
        """A (k,) [m/s^2] that ends at the normal forces."""
        if self.impact_time is None:
            return read_only(np.zeros(0))
        return frozen(self.problem.acceleration(np.maximum(self.normal_forces, 0.0), self.impact_time))

    @property
    def residual(self) -> Array:
        """Net wrench of forces and load (6,) [N, N m]; without forces, the least that was seen."""
        return frozen(self.problem.residual(self.forces_c, self.torsion)) if self.found else self._closest_residual()

    @property
    def duration(self) -> float:
        """tau = t_F - t_I [s]."""
        return self.profile.duration

    @property
    def profile(self) -> PenetrationProfile:
        """Penetration of every contact over time."""
        return PenetrationProfile(
            acceleration=self.acceleration,
            impact_time=self._found_time(),
            final_time=self.problem.final_time,
            shape=self.problem.shape,
        )

    @property
    def impulse(self) -> float:
        """Grasp energy by Eq. (11) as printed [N s]."""
        return float(self.problem.energy(self.normal_forces, self._found_time(), "impulse").sum())

    @property
    def work(self) -> float:
        """Grasp energy by Eq. (9), over depth [J]: rho + 1 times the work of the contacts."""
        return float(self.problem.energy(self.normal_forces, self._found_time(), "work").sum())

    def _found_time(self) -> float:
        if self.impact_time is None:
            raise InvalidInput(
                "this search found no forces, so there is neither an impact time nor a grasp phase; see explain() of a "
                "grid search, infeasibility of a convex one"
            )
        return self.impact_time

    def _closest_residual(self) -> Array:
        """The least residual that was seen without forces (6,) [N, N m]."""
        return self.problem.load

    @property
    def residual_force(self) -> float:
        """Norm of the residual's force [N]."""
        return float(np.linalg.norm(self.residual[:3]))

    @property
    def residual_moment(self) -> float:
        """Norm of the residual's moment about the centre of mass [N m]."""
        return float(np.linalg.norm(self.residual[3:]))

    @property
    def residual_norm(self) -> float:
        """Norm of the residual in the balance rows, moments over the moment length [N]."""
        return self.problem.scaled_norm(self.residual)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexSolution(ForceSolution):
    """Optimal contact forces with their certificate, or a proof that there are none.

    Attributes:
        weights: the objective, ``{name: weight}``.
        certificate: proof of optimality, None without forces.
        infeasibility: proof that no forces within the limits hold the load; None with forces, or if no proof was
            found.
    """

    weights: dict[str, float] = field(default_factory=dict)
    certificate: Certificate | None = None
    infeasibility: Infeasibility | None = None

    __repr__ = ForceSolution.__repr__

    def _proven(self) -> tuple[str, ...]:
        if self.certificate is not None:
            active = "; ".join(self.certificate.active(self.problem.contacts.names))
            return str(self.certificate), f"at their limits: {active}" if active else ""
        return () if self.infeasibility is None else (str(self.infeasibility),)

    def _closest_residual(self) -> Array:
        return self.problem.load if self.infeasibility is None else self.infeasibility.residual


@dataclass(frozen=True, kw_only=True, eq=False)
class GlobalSolution(ConvexSolution):
    """Optimal contact forces over all impact times.

    Attributes:
        branches: log of the search over t_I: one row per interval.
    """

    branches: tuple[Branch, ...] = ()

    __repr__ = ForceSolution.__repr__


@dataclass(frozen=True, kw_only=True, eq=False)
class GridSolution(ForceSolution):
    """The best contact forces of a grid.

    Attributes:
        grid: counts and bounds of the search.
    """

    grid: GridLog

    __repr__ = ForceSolution.__repr__

    def _proven(self) -> tuple[str, ...]:
        return tuple(self.explain().split("\n"))

    def explain(self) -> str:
        """How many cells of the grid each constraint rejected, in words."""
        lines = [f"{self.grid.points:.3g} grid points, {self.grid.cells} cells in (t_I, A)"]
        lines += [f"  {count} rejected by {reason}" for reason, count in self.grid.rejections.items() if count]
        if not self.found and self.grid.qp_solves:
            lines.append("  " + self._closest())
        return "\n".join(lines)

    def _closest(self) -> str:
        if self.residual_norm <= 1e-6:
            return (
                "with multipliers off the grid some cells do balance: refine the multiplier grid or use search='hybrid'"
            )
        force, moment = self.residual[:3], self.residual[3:]
        text = f"closest to balance: {np.linalg.norm(force):.3g} N left, along {_round(force, 3)} N"
        if self.problem.balance == "wrench":
            text += f", and {np.linalg.norm(moment):.3g} N m, along {_round(moment, 5)} N m"
        return text

    def _closest_residual(self) -> Array:
        return self.grid.closest


def _round(values: Array, decimals: int) -> list[float]:
    """Without negative zeros."""
    found: list[float] = (np.round(values, decimals) + 0.0).tolist()
    return found


def solution_of(
    problem: ForceProblem,
    outcome: ProgramOutcome,
    *,
    impact_time: float,
    weights: dict[str, float],
    started: float,
    status: Status | None = None,
) -> ConvexSolution:
    """The record of a convex outcome; ``status``: where it differs from the outcome's; ``started``: perf_counter()."""
    found = outcome.forces
    return ConvexSolution(
        status=outcome.status if status is None else status,
        problem=problem,
        search="convex",
        solver=outcome.solver,
        weights=weights,
        impact_time=None if found is None else impact_time,
        forces_c=frozen(np.zeros((0, 3))) if found is None else found.forces_c,
        torsion=frozen(np.zeros(0)) if found is None else found.torsion,
        certificate=None if found is None else found.certificate,
        infeasibility=outcome.infeasibility,
        elapsed=time.perf_counter() - started,
    )
