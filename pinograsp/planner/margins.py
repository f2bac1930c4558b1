"""What a plan's forces withstand besides their load, for its record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinograsp.checks import read_only
from pinograsp.contacts.quality import ferrari_canny, grasp_map_metrics, grasp_stiffness
from pinograsp.forces import ForceSolution, Reaction, disturbance_margins, force_closure, grasp_margins
from pinograsp.plan import PlanMargins, Reach, StiffnessBand
from pinograsp.plan.parts import WEAK
from pinograsp.spatial import Array

_DIRECTIONS = 48  # around a plane, in which forces are looked for


def find_margins(solution: ForceSolution, reaction: Reaction, band: StiffnessBand) -> PlanMargins:
    """Margins of the forces and quality of the grasp; ``band``: on softer and stiffer contacts."""
    problem = solution.problem
    margins = grasp_margins(solution, tolerance=1e-3, reaction=reaction)
    friction = replace(problem.friction, safety=1.0)
    closure = force_closure(problem.contacts, problem.mu, friction=friction, balance=problem.balance)
    epsilon = ferrari_canny(
        problem.contacts,
        problem.mu,
        balance=problem.balance,
        tolerance=1e-2,
        friction=friction,
        moment_length=problem.moment_length,
    )
    stiffness = grasp_stiffness(problem.contacts, problem.compliance, solution.normal_forces)
    metrics = grasp_map_metrics(problem.contacts, moment_length=problem.moment_length)
    return PlanMargins(
        friction_used=read_only(margins.friction_used),
        least_mu=read_only(margins.least_mu),
        slip_distance=read_only(margins.slip_distance),
        load_factor=float(margins.load_factor),
        disturbance=float(margins.disturbance.lower),
        weakest_direction=read_only(margins.disturbance.direction),
        disturbance_force=margins.disturbance_force,
        disturbance_moment=margins.disturbance_moment,
        force_closure=closure.closed,
        ferrari_canny=float(epsilon.lower),
        min_singular_value=float(metrics.min_singular_value),
        isotropy=float(metrics.isotropy),
        stiffness=read_only(stiffness.matrix),
        band=band,
    )


def margin_cautions(margins: PlanMargins, weight: float) -> tuple[str, ...]:
    """What the margins warn of, in words; ``weight``: of the object [N]."""
    if not margins.force_closure:
        return ("no force closure: in some direction nothing is held, whatever the friction and the squeeze",)
    if margins.spares_nothing(weight):
        return (f"its weakest direction withstands less than {100 * WEAK:g} % of the weight besides the load",)
    return ()


def find_reach(solution: ForceSolution, reaction: Reaction) -> Reach:
    """Forces that may come on top of the load while the squeeze stays, around the planes xy, xz, yz."""
    problem = replace(solution.problem, friction=replace(solution.problem.friction, safety=1.0))

    def margins(directions: Array) -> Array:
        wrenches = np.hstack([directions, np.zeros_like(directions)])
        held = disturbance_margins(problem, wrenches, normal_forces=solution.normal_forces, reaction=reaction)
        return np.maximum(0.0, held)  # forces on their limits leave nothing, and rounding may say less than nothing

    reach = np.stack([margins(np.eye(3)), margins(-np.eye(3))], axis=1)
    angles = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    directions = np.zeros((3, _DIRECTIONS, 3))
    for plane, axes in enumerate(((0, 1), (0, 2), (1, 2))):
        for axis, share in zip(axes, (np.cos(angles), np.sin(angles))):
            # Denser where the set is thin: as on an ellipse that reaches as far.
            size = np.where(share > 0, *reach[axis])
            directions[plane][:, axis] = share * np.maximum(size, 1e-3 * max(1e-3, reach.max()))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    forces = margins(directions.reshape(-1, 3)).reshape(3, -1)
    return Reach(directions=read_only(directions), forces=read_only(forces))
