"""The record every force search returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pinograsp.checks import brief, read_only
from pinograsp.contacts import PenetrationProfile
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.problem import ForceProblem

if TYPE_CHECKING:
    from pinograsp.forces.global_optimum import Branch
    from pinograsp.forces.infeasibility import Infeasibility
    from pinograsp.forces.optimize import Certificate


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: see record_of
class ForceSolution:
    """Optimal contact forces, or why there are none.

    Attributes:
        status: ``OK``, ``INFEASIBLE`` (no admissible forces, or no point of the grid), ``INACCURATE`` or
            ``INTERRUPTED``.
        problem: what was solved.
        search: ``"paper"``, ``"paper+qp"``, ``"hybrid"``, ``"convex"`` or ``"robust"``.
        solver: which one ran, "" if none did.
        impact_time: t_I [s], None without a solution.
        acceleration: A (k,) [m/s^2].
        multipliers: (k1, k2) (k, 2).
        forces_c: contact forces (k, 3) [N]. All empty without a solution.
        net_wrench: what is left of the balance (6,) [N, N m]; without a solution the least one seen.
        lower_bound: certified least residual of any multipliers at these normal forces [N].
        points: size of the whole grid.
        cells: its points in (t_I, A) alone.
        qp_solves: QPs solved.
        cuts: rejecting half-spaces learnt from them.
        rejections: cells rejected, by constraint; they and the optimum add up to ``cells``.
        elapsed: [s].
        torsion: moments about the contact normals (k,) [N m] (soft fingers), zeros otherwise.
        objective: of a convex search, ``{name: weight}``.
        certificate: its proof of optimality.
        infeasibility: its proof that there are no forces.
        branches: of a global search over t_I, its log: one row per interval.
    """

    status: Status
    problem: ForceProblem
    search: str
    solver: str
    impact_time: float | None
    acceleration: np.ndarray
    multipliers: np.ndarray
    forces_c: np.ndarray
    net_wrench: np.ndarray
    elapsed: float
    lower_bound: float = 0.0
    points: int = 0
    cells: int = 0
    qp_solves: int = 0
    cuts: int = 0
    rejections: dict[str, int] = field(default_factory=dict)
    torsion: np.ndarray = field(default_factory=lambda: read_only(np.zeros(0)))
    objective: dict[str, float] = field(default_factory=dict)
    certificate: Certificate | None = None
    infeasibility: Infeasibility | None = None
    branches: tuple[Branch, ...] = ()

    __repr__ = brief("status", "search", "solver", "impact_time", "normal_forces", "net_wrench", "elapsed")

    @property
    def found(self) -> bool:
        """Whether there are forces (of an interrupted search: the best so far)."""
        return self.impact_time is not None

    @property
    def normal_forces(self) -> np.ndarray:
        """F_n at t_F (k,) [N]."""
        return self.forces_c[:, 2]

    @property
    def duration(self) -> float:
        """tau = t_F - t_I [s]."""
        return self.profile.duration

    @property
    def profile(self) -> PenetrationProfile:
        """Penetration of every contact over time."""
        if self.impact_time is None:
            raise InvalidInput("this search found no forces: there is no penetration profile (see rejections)")
        return PenetrationProfile(
            acceleration=self.acceleration,
            impact_time=self.impact_time,
            final_time=self.problem.final_time,
            shape=self.problem.shape,
        )

    @property
    def impulse(self) -> float:
        """Grasp energy by Eq. (11) as printed [N s]."""
        return float(self.problem.energy(self.normal_forces, self.impact_time, "impulse").sum())

    @property
    def work(self) -> float:
        """Grasp energy by Eq. (9) over depth [J]: rho + 1 times the work that the contacts do."""
        return float(self.problem.energy(self.normal_forces, self.impact_time, "work").sum())

    @property
    def net_force(self) -> float:
        """Norm of the net force on the object [N]."""
        return float(np.linalg.norm(self.net_wrench[:3]))

    @property
    def net_moment(self) -> float:
        """Norm of the net moment on the object about its centre of mass [N m]."""
        return float(np.linalg.norm(self.net_wrench[3:]))

    @property
    def residual(self) -> float:
        """Net wrench in the balance rows, moments divided by the moment length [N]."""
        return self.problem.scaled_norm(self.net_wrench)

    def explain(self) -> str:
        """Why the grid gave this answer: the rejection histogram in words."""
        lines = [f"{self.points:.3g} grid points, {self.cells} cells in (t_I, A)"]
        lines += [f"  {count} rejected by {reason}" for reason, count in self.rejections.items() if count]
        if not self.found and self.qp_solves:
            lines.append("  " + self._closest())
        return "\n".join(lines)

    def _closest(self) -> str:
        if self.residual <= 1e-6:
            return (
                "with multipliers off the grid some cells do balance: refine the multiplier grid or use search='hybrid'"
            )
        force, moment = self.net_wrench[:3], self.net_wrench[3:]
        text = f"closest to balance: {np.linalg.norm(force):.3g} N left, along {np.round(force, 3).tolist()} N"
        if self.problem.balance == "wrench":
            text += f", and {np.linalg.norm(moment):.3g} N m, along {np.round(moment, 5).tolist()} N m"
        return text
