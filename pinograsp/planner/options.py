"""How to plan a grasp: one record for every planner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pinograsp.checks import brief, instance_of, one_of
from pinograsp.forces import GridSpec, Objective, SolverName
from pinograsp.motion import MotionSpec

Search = Literal["convex", "hybrid", "paper", "paper+qp"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanOptions:
    """How to search for forces and a motion; the defaults fit all problems.

    Attributes:
        search: ``"convex"``: the certified global optimum (:func:`~pinograsp.forces.optimize_grasp`), with any friction
            model; or a grid, see :func:`~pinograsp.forces.grid_search`. Grids support neither torque limits nor a
            reserve (``GraspConditions(torque_limit=None, reserve=None)``).
        grid: for a grid search; None: the paper's.
        solver: name of the solver; ``"auto"``: the search's own.
        objective: for the convex search, a name or ``{name: weight}``, with a reserve ``"impulse"``, ``"work"``,
            ``"peak"`` or weights of these; None: the problem's measure.
        motion: postures and sampling; None: from the open hand to the contact posture, if the hand was closed.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> ball = pg.Sphere(radius=0.02, mass=0.1).placed(up)
        >>> options = pg.PlanOptions(objective="peak")  # the largest normal force
        >>> plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.6), options)
        >>> print(plan.status)
        ok

    See Also:
        :func:`~pinograsp.planner.plan_grasp_on`, :class:`~pinograsp.motion.MotionSpec`.
    """

    search: Search = "convex"
    grid: GridSpec | None = None
    solver: SolverName = "auto"
    objective: Objective | None = None
    motion: MotionSpec | None = None

    __repr__ = brief("search", "solver", "objective", "grid", "motion")

    def __post_init__(self) -> None:
        one_of("search", self.search, get_args(Search))
        instance_of("grid", self.grid, GridSpec, type(None))
        instance_of("solver", self.solver, str)
        instance_of("motion", self.motion, MotionSpec, type(None))


AS_USUAL = PlanOptions()
