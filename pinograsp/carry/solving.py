"""Solving the programs of carrying with Clarabel, and checking its answer.

Only forces, speeds and the multipliers of a few rows come from Clarabel's answer; residual, objective and lower bound
are computed from them here.
"""

from __future__ import annotations

from dataclasses import replace

import clarabel
import numpy as np

from pinograsp.carry.conic import Multipliers, stack_cones
from pinograsp.carry.program import CarryProgram, CarrySolution, measure_times
from pinograsp.spatial import Array, multiply_rows

__all__ = ["solve_carry"]

_USUAL = 0.5  # of the largest normal forces: mostly they are less
_DIGITS = 1e-2  # of the accuracy: what Clarabel is asked for
_SMALL = 1e-300
_SETTINGS = {
    "verbose": False,
    "max_threads": 1,
    "direct_solve_method": "qdldl",
    "presolve_enable": False,
    "equilibrate_max_iter": 1,  # forces and speeds are of order 1 already
}
# Refining the steps takes as long as the steps do, and few programs need it.
_ATTEMPTS: tuple[dict[str, float | bool], ...] = (
    {"iterative_refinement_enable": False},
    {"iterative_refinement_enable": True},
    {"iterative_refinement_enable": True, "max_step_fraction": 0.9},
)


def solve_carry(program: CarryProgram, *, accuracy: float = 1e-8) -> CarrySolution:
    """Solve a program to a relative ``accuracy`` of the objective, or as near to it as rounding allows.

    Rows of R that no forces of half the largest bring to their limits at rest are left out, and added again if the
    solution violates them: a solution of a program with fewer limits that satisfies all limits solves the program.
    """
    force, square = _usual_sizes(program)
    scaled = program.scale(force, square)
    kept = scaled.rows_that_may_bind(_USUAL)
    while True:
        found = _solve_all(scaled.keep_rows(kept), accuracy)
        x = found.x.reshape(program.count, -1)
        broken = ~kept & (scaled.beyond_rows(x, found.y) > accuracy)
        if not found.is_solution or not broken.any():
            break
        kept |= broken | scaled.rows_that_may_bind(1.0)
    rows = np.zeros((2, program.count, len(kept)))
    rows[..., kept] = found.rows / force
    return replace(
        found,
        y=np.where(program.free, found.y * square, program.given),
        x=found.x * force,
        residual=scaled.measure_residual(x, found.y),
        rows=rows,
        speeds=found.speeds / square,
        normals=found.normals / force,
        cones=found.cones / force,
    )


def _usual_sizes(program: CarryProgram) -> tuple[float, float]:
    """A force [N], and a squared speed whose loads are about as large as those at rest."""
    still, moving = np.abs(program.e).max(axis=1), np.abs(program.E.sum(axis=2)).max(axis=1)
    force = max(float(still.max()), float(program.least.max()), 1e-6)
    square = np.median(np.maximum(still, 1e-3 * force) / np.maximum(moving, 1e-9 * force))
    return force, float(np.clip(square, 1e-12, max(np.median(program.top), 1e-12)))


def _solve_all(program: CarryProgram, accuracy: float) -> CarrySolution:
    """The best solution of several attempts, with all rows."""
    assembly, found = stack_cones(program), list[CarrySolution]()
    for attempt in _ATTEMPTS:
        settings = clarabel.DefaultSettings()
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _DIGITS * accuracy
        for name, value in {**_SETTINGS, **attempt}.items():
            setattr(settings, name, value)
        answer = clarabel.DefaultSolver(*assembly.problem, settings).solve()
        x, y = assembly.read_unknowns(np.nan_to_num(answer.x))
        multipliers = assembly.read_multipliers(np.nan_to_num(answer.z))
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of an answer that is none
            found.append(_certify(program, x, y, multipliers, rounds=answer.iterations, accuracy=accuracy))
        if found[-1].is_solution or "PrimalInfeasible" in str(answer.status):
            break
    return min(found, key=lambda one: max(abs(one.gap), one.residual))


def _certify(
    program: CarryProgram, x: Array, y: Array, multipliers: Multipliers, *, rounds: int, accuracy: float
) -> CarrySolution:
    """What forces (N, k d) and squared speeds y are worth.

    The lower bound is the least of the Lagrangian of balance, rows and pairs, over all forces within friction and all
    speeds within their limits. Squares of forces, and times in the roots of speeds, are convex: above their tangents.
    """
    balance, low, high, pairs = multipliers
    used = high - low
    ends = np.where(low > 0, program.low, 0.0), np.where(high > 0, program.high, 0.0)
    bound = float(
        (low * ends[0]).sum() - (high * ends[1]).sum() - (balance * program.e).sum() - (pairs * program.c).sum()
    )
    # Forces: where w . x is least, F_n is as small or as large as can be.
    w = multiply_rows(balance, program.A) + multiply_rows(used, program.R)
    if program.weights is not None:
        w = w + program.weights * x
        bound -= 0.5 * float((program.weights * x**2).sum())
    each = w.reshape(program.count, program.k, -1)
    cones = program.friction.support(-each[..., :-1])
    normal = each[..., -1] - cones
    bound += float((normal * np.where(normal > 0, program.least, program.most)).sum())
    # Speeds: slope y - pull sqrt(y) at each node.
    slopes = np.einsum("nmj,nm->nj", program.B, used) + np.einsum("nrj,nr->nj", program.C, pairs)
    slope = program.add_at_nodes(slopes - np.einsum("nbj,nb->nj", program.E, balance))
    pull = np.zeros_like(slope)
    if program.gain is not None:
        slope -= program.gain
    if program.step is not None:
        times, roots = measure_times(y[program.nodes], program.step), np.sqrt(y[program.nodes]).sum(axis=1)
        pull = program.add_at_nodes(np.stack([times / roots, times / roots], axis=1))
        bound += 2.0 * float(times.sum())
    most = np.sqrt(np.where(program.free, program.top, program.given))
    least = np.where(program.free & (slope > 0), pull / (2.0 * np.maximum(slope, _SMALL)), most)
    root = np.minimum(least, most)
    bound += float((slope * root**2 - pull * root).sum())
    return CarrySolution(
        y=y,
        x=x.reshape(each.shape),
        objective=program.measure_cost(x, y),
        lower_bound=bound,
        residual=program.measure_residual(x, y),
        rounds=rounds,
        accuracy=accuracy,
        rows=np.stack([low, high]),
        pairs=pairs,
        speeds=np.where(program.free, np.maximum(pull / (2.0 * np.maximum(most, _SMALL)) - slope, 0.0), 0.0),
        normals=np.maximum(np.stack([normal, -normal]), 0.0),
        cones=cones,
    )
