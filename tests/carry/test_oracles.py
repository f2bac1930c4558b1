"""Random paths and grasps: against ECOS on the program written row by row, and against TOPP-RA on polyhedral cones."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from whole_carries import by_ecos, random_carry

from pinograsp.carry.solving import solve_carry
from pinograsp.contacts import Friction


def compared(arm, seeds, intervals):
    """Largest relative differences from ECOS's time, and how many carries were held."""
    worst, held = 0.0, 0
    for seed in seeds:
        program = random_carry(arm, seed).constrain(intervals).least_time
        found = solve_carry(program)
        time = by_ecos(program)
        # Both find one, or neither does.
        assert found.is_solution == (time is not None), (seed, found.gap, found.residual)
        if found.is_solution:
            held += 1
            worst = max(worst, abs(found.objective / time - 1.0))
            assert found.lower_bound <= time * (1 + 1e-7)
    return worst, held


@pytest.mark.slow
def test_random_paths_and_grasps_against_another_solver(arm):
    worst, held = compared(arm, range(12), 30)
    assert worst < 1e-6
    assert held > 6


@pytest.mark.slow
def test_many_random_paths_and_grasps_against_another_solver(arm):
    worst, held = compared(arm, range(1000, 1200), 30)
    assert worst < 1e-6
    assert held > 100


# -- TOPP-RA -----------------------------------------------------------------------------------------------------------


def wrench_limits(programs):
    """Facets of all wrenches that contacts of a pyramid with caps can make: rows (m, b) and right-hand side (m,)."""
    problem, A = programs.grasp.problem, programs.alone.A
    d, corners = problem.friction.d, problem.friction.facets
    # The pyramid of one contact with unit cap: its apex, and where the facets of neighbours meet.
    vertices = [np.zeros(d)]
    for i in range(len(corners)):
        pair = corners[[i, (i + 1) % len(corners)]]
        vertices.append(np.append(np.linalg.solve(pair, np.ones(2)), 1.0))
    own = [[A[:, c * d : (c + 1) * d] @ (most * v) for v in vertices] for c, most in enumerate(programs.grasp.most)]
    hull = ConvexHull([sum(choice) for choice in product(*own)])
    return hull.equations[:, :-1], -hull.equations[:, -1]


@pytest.mark.parametrize("seed", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(1, 12))])
def test_the_same_time_as_topp_ra_on_pyramids(arm, seed):
    import toppra
    from toppra.constraint import LinearConstraint

    count = 2000
    pyramid = Friction(model="pyramid", edges=4)
    drawn = (random_carry(arm, 100 * seed + i, k=3, friction=pyramid) for i in range(99))
    carry = next(one for one in drawn if solve_carry(one.constrain(40).least_time).is_solution)
    carry = replace(carry, limits=replace(carry.limits, torque=np.full(arm.n, np.inf)))
    programs = carry.constrain(count)
    ours = solve_carry(programs.least_time)
    F, g = wrench_limits(programs)
    s = np.linspace(0.0, 1.0, count + 1)
    nodes = carry.carried.along(carry.path, s, np.array([0.0, 0.0, -9.81]))
    top = programs.top

    class Held(LinearConstraint):
        """Wrenches of the contacts, and the joints' speeds."""

        def __init__(self):
            super().__init__()
            self.identical = True

        def compute_constraint_params(self, path, gridpoints, *_):
            rows = programs.alone.A @ np.linalg.pinv(programs.matrices.A)
            parts = [part * programs.wrench_scale @ rows.T for part in nodes.wrench]
            return *parts, F, g, None, np.stack([np.zeros_like(top), top], axis=1)

    line = toppra.SplineInterpolator(s, carry.path.at(s).q)
    method = toppra.algorithm.TOPPRA([Held()], line, gridpoints=s, solver_wrapper="seidel")
    _, speed, _ = method.compute_parameterization(0, 0)
    took = (2 * np.diff(s) / (speed[:-1] + speed[1:])).sum()
    assert ours.objective == pytest.approx(took, rel=1e-4)
