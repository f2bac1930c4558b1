"""Comparison with the paper: every quantity of its results section beside ours, for the case study."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from pinograsp.cases.case import Case, with_changes
from pinograsp.cases.changes import CaseChanges
from pinograsp.contacts import Measure
from pinograsp.contacts.quality import Balance
from pinograsp.forces import (
    ForceProblem,
    GridSpec,
    QPSolverName,
    Reserve,
    grid_search,
    least_squeeze,
    optimize_grasp,
    qp_solvers,
    refine_multipliers,
)
from pinograsp.motion import contact_postures
from pinograsp.motion.grasp_ik import ContactPath, press_points
from pinograsp.plan import ComparisonRow
from pinograsp.planner import GraspPlan

# The paper's choices: balance of forces only, a friction pyramid without safety factor, contacts on the lines along the
# links, constant deceleration, no force caps, no torque limits.
AS_PUBLISHED: CaseChanges = {
    "forces.balance": "force",
    "friction.model": "pyramid",
    "friction.edges": 4,
    "friction.safety": 1.0,
    "limits.deceleration": "constant",
    "limits.max_normal_force": None,
    "limits.torque_limit": None,
    "motion.touch": "length",
}

NORMAL_FORCES_N = {"thumb": 9.873, "index": 6.35, "middle": 4.7}
IMPACT_TIME_S = 0.90
ENERGY_MJ = 55.9
UNOPTIMISED_ENERGY_MJ = 73.6  # MSC.Adams, without optimisation
NET_FORCE_N = 0.089
PENETRATION_MM = 3.3

_HALVINGS = 5  # of the reserve's disturbance
_BALANCES: tuple[Balance, ...] = ("force", "wrench")
_MEASURES: tuple[Measure, ...] = ("work", "impulse")

# Joint torque maxima of joints 1 to 4 [N m], after optimisation.
TORQUES_NM = {
    "grasp": {
        "thumb": (9.1e-3, 0.31, 0.18, 6.95e-2),
        "index": (8.4e-4, 0.15, 5.3e-2, 1.7e-2),
        "middle": (7.7e-4, 8.25e-2, 2.36e-2, 7.18e-3),
    },
    "approach": {
        "thumb": (1.84e-2, 1.47e-2, 5.0e-3, 9.6e-4),
        "index": (9.1e-3, 8.5e-4, 2.0e-4, 2.95e-5),
        "middle": (1.23e-3, 1.96e-3, 4.5e-4, 6.86e-5),
    },
}


def _row(quantity: str, unit: str, published: float | None, ours: float | None, note: str = "") -> ComparisonRow:
    return ComparisonRow(quantity=quantity, unit=unit, published=published, ours=ours, note=note)


def compare(case: Case) -> list[ComparisonRow]:
    """The paper's figures beside those of ``case``, planned with the paper's choices (``AS_PUBLISHED``).

    Figures that depend on the balance or the measure are given for each choice. The case must have the case study's
    three contacts.

    Raises:
        NoGrasp: the case has no grasp with the paper's choices.
    """
    case = with_changes(case, AS_PUBLISHED)
    plan = case.plan(progress=False)
    chosen = case.forces.solver
    solver = chosen if chosen in qp_solvers() else "daqp"  # of the grids and QPs beside
    return [
        *_compare_forces(plan),
        *_compare_optima(plan.problem, case.make_grid(), solver),
        *_compare_published_forces(plan.problem, solver),
        _row("energy, not optimised (MSC.Adams)", "mJ", UNOPTIMISED_ENERGY_MJ, None, "needs a simulation"),
        *_compare_torques(plan),
    ]


def tell_figures(plan: GraspPlan) -> list[tuple[str, str]]:
    """The paper's main figures beside those of a plan of its case, a line each, and why its answer is what it is."""
    rows = [row for row in _compare_forces(plan) if row.published is not None and row.ours is not None]
    each = [row for row in rows if row.quantity.startswith("normal force ")]
    paper, ours = (
        " / ".join(f"{value:.4g}" for value in values) for values in zip(*((r.published, r.ours) for r in each))
    )
    figures = [
        (row.quantity, f"paper {row.published:.4g} {row.unit}, ours {row.ours:.4g} {row.unit}")
        for row in rows
        if "normal force" not in row.quantity
    ]
    forces = (f"F_n {' / '.join(NORMAL_FORCES_N)}", f"paper {paper} N, ours {ours} N")
    return [forces, *figures, ("with a reserve", _tell_reserve(plan))]


def _tell_reserve(plan: GraspPlan) -> str:
    """The largest disturbance that a squeeze of the same contacts withstands beside the default reserve's other parts:
    a force in any direction, or as a moment about any axis, which is what contacts on one thin side lack.
    """
    least, most, default = 0.0, Reserve().disturbance, Reserve()
    if least_squeeze(plan.problem, default) is not None:
        return f"a squeeze of these contacts withstands pushes and moments of {100 * most:.0f} % of the weight"
    for _ in range(_HALVINGS):
        middle = (least + most) / 2
        works = least_squeeze(plan.problem, replace(default, disturbance=middle)) is not None
        least, most = (middle, most) if works else (least, middle)
    push = f"{100 * least:.1g} % of the weight (default: {100 * default.disturbance:.0f} %)"
    return f"a squeeze of these contacts withstands a push or moment of {push}"


def _compare_forces(plan: GraspPlan) -> list[ComparisonRow]:
    """Impact time, normal forces, energies, penetration and residual of the plan."""
    forces = plan.forces
    total, deepest = float(forces.normal_forces.sum()), float(forces.final_depths.max())
    return [
        _row("impact time t_I", "s", IMPACT_TIME_S, forces.impact_time),
        *(
            _row(f"normal force {name}", "N", published, float(ours))
            for (name, published), ours in zip(NORMAL_FORCES_N.items(), forces.normal_forces)
        ),
        _row("sum of normal forces", "N", float(np.sum(list(NORMAL_FORCES_N.values()))), total),
        _row("grasp energy (work)", "mJ", ENERGY_MJ, 1e3 * forces.work, "rho + 1 times the contacts' own"),
        _row("grasp energy (impulse)", "N s", None, forces.impulse),
        _row("largest penetration", "mm", PENETRATION_MM, 1e3 * deepest),
        _row("remaining net force", "N", NET_FORCE_N, forces.residual_force),
        _row("remaining net moment", "N m", None, forces.residual_moment, "not in the paper"),
    ]


def _compare_published_forces(problem: ForceProblem, solver: QPSolverName) -> list[ComparisonRow]:
    """Energies of the published normal forces, and the residual that they leave, for several mu."""
    published = np.array(list(NORMAL_FORCES_N.values()))
    work = float(problem.energy(published, IMPACT_TIME_S, "work").sum())
    impulse = float(problem.energy(published, IMPACT_TIME_S, "impulse").sum())
    rows = [
        _row("work at the published forces", "mJ", ENERGY_MJ, 1e3 * work),
        _row("impulse at the published forces", "N s", None, impulse),
    ]
    balance = replace(problem, balance="force")
    for mu in dict.fromkeys((float(problem.mu[0]), 0.693, 0.8)):
        left = refine_multipliers(replace(balance, mu=np.full(problem.k, mu)), published, solver=solver)
        norm = left.certificate.residual_norm
        quantity = f"QP at the published forces, mu = {mu:g}"
        rows.append(_row(quantity, "N", NET_FORCE_N, norm, "net force, force balance"))
    return rows


def _compare_optima(problem: ForceProblem, grid: GridSpec, solver: QPSolverName) -> list[ComparisonRow]:
    """The hybrid search's optima for each balance and measure, the paper's own search, the certified optima, and the
    latest feasible impact.
    """
    rows: list[ComparisonRow] = []
    for balance, measure in product(_BALANCES, _MEASURES):
        best = grid_search(replace(problem, balance=balance, measure=measure), grid, solver=solver, progress=False)
        name = f"hybrid, {balance} balance, least {measure}"
        if not best.found:
            rows.append(_row(name, "", None, None, "no grasp on this grid"))
            continue
        split = " + ".join(f"{f:.3f}" for f in best.normal_forces)
        left = f"net {best.residual_force:.1e} N, {best.residual_moment:.1e} N m"
        rows.append(_row(f"{name}: work", "mJ", ENERGY_MJ, 1e3 * best.work, f"F_n {split} N"))
        rows.append(_row(f"{name}: impulse", "N s", None, best.impulse, f"t_I {best.impact_time:g} s, {left}"))
    paper = grid_search(replace(problem, balance="force"), grid, search="paper", solver=solver, progress=False)
    if paper.found:
        note = f"limit {grid.residual_limit:g} N, {paper.grid.points:.2g} points"
        rows.append(_row("the paper's grid search: net force", "N", NET_FORCE_N, paper.residual_force, note))
    for balance, measure in product(_BALANCES, _MEASURES):
        rows += _compare_certified(replace(problem, balance=balance, measure=measure), grid, solver)
    for balance in _BALANCES:
        rows += _compare_latest_impact(replace(problem, balance=balance, measure="impulse"), grid, solver)
    return rows


def _compare_certified(problem: ForceProblem, grid: GridSpec, solver: QPSolverName) -> list[ComparisonRow]:
    """The certified global optimum, and its saving against the hybrid search's grid."""
    best = optimize_grasp(problem)
    certificate = best.certificate
    if not best.found or certificate is None:
        return []
    note = f"t_I {best.impact_time:.5f} s, gap {certificate.relative_gap:.0e}"
    rival = grid_search(problem, grid, solver=solver, progress=False)
    if rival.found:
        costs = rival.work if problem.measure == "work" else rival.impulse
        note += f", {1 - certificate.objective / costs:.2%} below the grid"
    quantity = f"certified optimum, {problem.balance} balance: {problem.measure}"
    if problem.measure == "work":
        return [_row(quantity, "mJ", ENERGY_MJ, 1e3 * certificate.objective, note)]
    return [_row(quantity, "N s", None, certificate.objective, note)]


def _compare_latest_impact(problem: ForceProblem, grid: GridSpec, solver: QPSolverName) -> list[ComparisonRow]:
    """The latest t_I on a 1 ms grid at which the hybrid search finds a grasp, and its impulse."""
    low, high = problem.impact_time_range
    for t_I in np.round(np.arange(high, low - 5e-4, -1e-3), 3):
        found = grid_search(problem, replace(grid, impact_times=np.array([t_I])), solver=solver, progress=False)
        if found.found:
            return [
                _row(f"latest feasible t_I (1 ms grid), {problem.balance} balance", "s", None, float(t_I)),
                _row("  impulse there", "N s", None, found.impulse),
            ]
    return []


def _compare_torques(plan: GraspPlan) -> list[ComparisonRow]:
    """Torque maxima by phase, finger and joint; in the grasp phase, also the force that the published torques imply."""
    rows: list[ComparisonRow] = []
    maxima = plan.torque_maxima()
    for phase, fingers in TORQUES_NM.items():
        for finger, published in fingers.items():
            if phase == "grasp":
                force = NORMAL_FORCES_N[finger]
                in_plane = _fit_in_plane_force(plan, finger)
                note = f"{in_plane / force:.2f} of the published F_n: they cannot both hold"
                rows.append(_row(f"{finger}: in-plane force of the published torques", "N", force, in_plane, note))
            for joint, value, ours in zip(plan.hand.finger(finger).joints, published, maxima[finger][phase]):
                ratio = f"published / ours = {value / ours:.2f}" if ours else ""
                rows.append(_row(f"{phase} torque {joint}", "N m", value, float(ours), ratio))
    return rows


def _fit_in_plane_force(plan: GraspPlan, finger: str) -> float:
    """Magnitude [N] of the fingertip force in the flexion plane that best explains the published flexion torques.

    Least squares on J^T f over joints 2 to 4, at the posture nearest to Table IV's final angles.
    """
    from pinograsp.hands.humanoid import FINAL_ANGLES_DEG

    hand, contacts = plan.hand, plan.problem.contacts
    contact = next(one for one in contacts if one.finger == finger)
    angles = np.radians(FINAL_ANGLES_DEG[finger])
    alone = replace(contacts, contacts=(contact,))
    found = contact_postures(hand, alone, reference={finger: angles}, samples=1)[finger]
    nearest = int(np.argmin(np.abs(found.angles - angles).max(axis=1)))
    profile = plan.solution.profile
    still = replace(profile, acceleration=np.zeros(1))
    path = ContactPath([contact], still, [0], np.linspace(profile.impact_time, profile.final_time, 3))
    only = slice(nearest, nearest + 1)
    (motion,) = press_points(hand, hand.finger(finger), path, found.angles[only], found.points_l[only])
    J = motion.jacobians[0, 0, :3]
    force = np.linalg.lstsq(J[:, 1:].T, np.array(TORQUES_NM["grasp"][finger][1:]), rcond=1e-9)[0]
    return float(np.linalg.norm(force))
