"""Comparison with the paper: every quantity of its results section beside ours, for the case study."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinograsp.cases.case import Case, with_changes
from pinograsp.cases.changes import CaseChanges
from pinograsp.contacts import ContactSet, Measure
from pinograsp.contacts.quality import Balance
from pinograsp.forces import (
    ForceProblem,
    GridSpec,
    QPSolverName,
    grid_search,
    optimize_grasp,
    qp_solvers,
    refine_multipliers,
)
from pinograsp.hands import HandModel
from pinograsp.motion import contact_postures
from pinograsp.motion.grasp_ik import press
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


def compare(case: Case) -> list[ComparisonRow]:
    """The paper's figures beside those of ``case``, planned with the paper's choices (``AS_PUBLISHED``).

    Figures that depend on the balance or the measure are given for each choice. The case must have the case study's
    three contacts.

    Raises:
        NoGrasp: the case has no grasp with the paper's choices.
    """
    case = with_changes(case, AS_PUBLISHED)
    plan = case.plan(progress=False)
    own = case.forces.solver
    solver = own if own in qp_solvers() else "daqp"  # of the grids and QPs beside
    problem = plan.problem
    return [
        *_forces(plan),
        *_optima(problem, case.make_grid(), solver),
        *_at_published_forces(problem, solver),
        ComparisonRow(
            quantity="energy, not optimised (MSC.Adams)",
            unit="mJ",
            published=UNOPTIMISED_ENERGY_MJ,
            ours=None,
            note="needs a simulation",
        ),
        *_torques(plan),
    ]


def _forces(plan: GraspPlan) -> list[ComparisonRow]:
    """Impact time, normal forces, energies, penetration and residual of the plan."""
    forces = plan.forces
    return [
        ComparisonRow(quantity="impact time t_I", unit="s", published=IMPACT_TIME_S, ours=forces.impact_time),
        *(
            ComparisonRow(quantity=f"normal force {name}", unit="N", published=published, ours=float(ours))
            for (name, published), ours in zip(NORMAL_FORCES_N.items(), forces.normal_forces)
        ),
        ComparisonRow(
            quantity="sum of normal forces",
            unit="N",
            published=float(np.sum(list(NORMAL_FORCES_N.values()))),
            ours=float(forces.normal_forces.sum()),
        ),
        ComparisonRow(
            quantity="grasp energy (work)",
            unit="mJ",
            published=ENERGY_MJ,
            ours=1e3 * forces.work,
            note="rho + 1 times the contacts' own",
        ),
        ComparisonRow(quantity="grasp energy (impulse)", unit="N s", published=None, ours=forces.impulse),
        ComparisonRow(
            quantity="largest penetration",
            unit="mm",
            published=PENETRATION_MM,
            ours=1e3 * float(forces.final_depths.max()),
        ),
        ComparisonRow(quantity="net force left", unit="N", published=NET_FORCE_N, ours=forces.residual_force),
        ComparisonRow(
            quantity="net moment left", unit="N m", published=None, ours=forces.residual_moment, note="not in the paper"
        ),
    ]


def _at_published_forces(problem: ForceProblem, solver: QPSolverName) -> list[ComparisonRow]:
    """Energies of the published normal forces, and the residual that they leave, for several mu."""
    published = np.array(list(NORMAL_FORCES_N.values()))
    work = float(problem.energy(published, IMPACT_TIME_S, "work").sum())
    impulse = float(problem.energy(published, IMPACT_TIME_S, "impulse").sum())
    rows = [
        ComparisonRow(quantity="work at the published forces", unit="mJ", published=ENERGY_MJ, ours=1e3 * work),
        ComparisonRow(quantity="impulse at the published forces", unit="N s", published=None, ours=impulse),
    ]
    balance = replace(problem, balance="force")
    for mu in dict.fromkeys((float(problem.mu[0]), 0.693, 0.8)):
        left = refine_multipliers(replace(balance, mu=np.full(problem.k, mu)), published, solver=solver)
        rows.append(
            ComparisonRow(
                quantity=f"QP at the published forces, mu = {mu:g}",
                unit="N",
                published=NET_FORCE_N,
                ours=left.certificate.residual_norm,
                note="net force, force balance",
            )
        )
    return rows


def _optima(problem: ForceProblem, grid: GridSpec, solver: QPSolverName) -> list[ComparisonRow]:
    """The hybrid search's optima for each balance and measure, the paper's own search, the certified optima, and the
    latest feasible impact.
    """
    rows: list[ComparisonRow] = []
    for balance in _BALANCES:
        for measure in _MEASURES:
            chosen = replace(problem, balance=balance, measure=measure)
            best = grid_search(chosen, grid, solver=solver, progress=False)
            name = f"hybrid, {balance} balance, least {measure}"
            if not best.found:
                rows.append(
                    ComparisonRow(quantity=name, unit="", published=None, ours=None, note="no grasp on this grid")
                )
                continue
            split = " + ".join(f"{f:.3f}" for f in best.normal_forces)
            rows += [
                ComparisonRow(
                    quantity=f"{name}: work",
                    unit="mJ",
                    published=ENERGY_MJ,
                    ours=1e3 * best.work,
                    note=f"F_n {split} N",
                ),
                ComparisonRow(
                    quantity=f"{name}: impulse",
                    unit="N s",
                    published=None,
                    ours=best.impulse,
                    note=f"t_I {best.impact_time:g} s, net {best.residual_force:.1e} N, {best.residual_moment:.1e} N m",
                ),
            ]
    paper = grid_search(replace(problem, balance="force"), grid, search="paper", solver=solver, progress=False)
    if paper.found:
        rows.append(
            ComparisonRow(
                quantity="the paper's grid search: net force",
                unit="N",
                published=NET_FORCE_N,
                ours=paper.residual_force,
                note=f"limit {grid.residual_limit:g} N, {paper.grid.points:.2g} points",
            )
        )
    for balance in _BALANCES:
        for measure in _MEASURES:
            rows += _certified(replace(problem, balance=balance, measure=measure), grid, solver)
    for balance in _BALANCES:
        rows += _latest_impact(replace(problem, balance=balance, measure="impulse"), grid, solver)
    return rows


def _certified(problem: ForceProblem, grid: GridSpec, solver: QPSolverName) -> list[ComparisonRow]:
    """The certified global optimum, and its saving against the hybrid search's grid."""
    best = optimize_grasp(problem)
    certificate = best.certificate
    if not best.found or certificate is None:
        return []
    unit, factor = ("mJ", 1e3) if problem.measure == "work" else ("N s", 1.0)
    note = f"t_I {best.impact_time:.5f} s, gap {certificate.relative_gap:.0e}"
    rival = grid_search(problem, grid, solver=solver, progress=False)
    if rival.found:
        costs = rival.work if problem.measure == "work" else rival.impulse
        note += f", {1 - certificate.objective / costs:.2%} below the grid"
    return [
        ComparisonRow(
            quantity=f"certified optimum, {problem.balance} balance: {problem.measure}",
            unit=unit,
            published=ENERGY_MJ if problem.measure == "work" else None,
            ours=factor * certificate.objective,
            note=note,
        )
    ]


def _latest_impact(problem: ForceProblem, grid: GridSpec, solver: QPSolverName) -> list[ComparisonRow]:
    """The latest t_I on a 1 ms grid at which the hybrid search finds a grasp, and its impulse."""
    low, high = problem.impact_time_range
    for t_I in np.round(np.arange(high, low - 5e-4, -1e-3), 3):
        found = grid_search(problem, replace(grid, impact_times=np.array([t_I])), solver=solver, progress=False)
        if found.found:
            return [
                ComparisonRow(
                    quantity=f"latest feasible t_I (1 ms grid), {problem.balance} balance",
                    unit="s",
                    published=None,
                    ours=float(t_I),
                ),
                ComparisonRow(quantity="  impulse there", unit="N s", published=None, ours=found.impulse),
            ]
    return []


def _torques(plan: GraspPlan) -> list[ComparisonRow]:
    """Torque maxima by phase, finger and joint; in the grasp phase, also the force that the published torques imply."""
    rows: list[ComparisonRow] = []
    maxima = plan.torque_maxima()
    for phase, fingers in TORQUES_NM.items():
        for finger, published in fingers.items():
            if phase == "grasp":
                in_plane = _in_plane_force(plan.hand, plan, finger)
                rows.append(
                    ComparisonRow(
                        quantity=f"{finger}: in-plane force of the published torques",
                        unit="N",
                        published=NORMAL_FORCES_N[finger],
                        ours=in_plane,
                        note=f"{in_plane / NORMAL_FORCES_N[finger]:.2f} of the published F_n: they cannot both hold",
                    )
                )
            for joint, value, ours in zip(plan.hand.finger(finger).joints, published, maxima[finger][phase]):
                ratio = f"published / ours = {value / ours:.2f}" if ours else ""
                rows.append(
                    ComparisonRow(
                        quantity=f"{phase} torque {joint}", unit="N m", published=value, ours=float(ours), note=ratio
                    )
                )
    return rows


def _in_plane_force(hand: HandModel, plan: GraspPlan, finger: str) -> float:
    """Magnitude [N] of the fingertip force in the flexion plane that best explains the published flexion torques.

    Least squares on J^T f over joints 2 to 4, at the posture nearest to Table IV's final angles.
    """
    contacts = plan.problem.contacts
    i = [contact.finger for contact in contacts].index(finger)
    chain = hand.finger(finger)
    from pinograsp.hands.humanoid import FINAL_ANGLES_DEG

    angles = np.radians(FINAL_ANGLES_DEG[finger])
    found = contact_postures(hand, _only(contacts, i), reference={finger: angles}, samples=1)[finger]
    nearest = int(np.argmin(np.abs(found.angles - angles).max(axis=1)))
    profile = plan.solution.profile
    t_I, t_F = profile.impact_time, profile.final_time
    still = replace(profile, acceleration=np.zeros(1))
    J = press(
        hand, chain, [contacts[i]], found.angles[nearest], found.points_l[nearest], still, [0], np.linspace(t_I, t_F, 3)
    ).jacobians[0, 0, :3]
    force = np.linalg.lstsq(J[:, 1:].T, np.array(TORQUES_NM["grasp"][finger][1:]), rcond=1e-9)[0]
    return float(np.linalg.norm(force))


def _only(contacts: ContactSet, i: int) -> ContactSet:
    return replace(contacts, contacts=(contacts[i],))
