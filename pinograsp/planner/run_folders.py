"""Grasp plans in folders: written completely, and read back with hand and object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pinograsp.checks import instance_of
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanFailure
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.storage import read_run, write_run
from pinograsp.writing import NewFolder


def save_run(
    plan: GraspPlan | PlanFailure,
    folder: str | Path | NewFolder,
    *,
    force: bool = False,
    extras: Callable[[Path], None] | None = None,
) -> Path:
    """Write a plan with its margins, or the failure of a search, into ``folder``, completely or not at all; returns it.

    ``extras(path)`` may add files (report, figures). ``force`` replaces an earlier run, with its checks.

    Raises:
        InvalidInput: not a plan, or one whose settings cannot be written.
        ResultsNotWritten: the folder exists and ``force`` is off, it holds files that no run wrote, another process is
            writing into it, or it cannot be written.

    Example:
        >>> import pinograsp as pg
        >>> print(pg.save_run(pg.load_case("paper").plan(), "runs/paper"))
        runs/paper

    See Also:
        :func:`~pinograsp.planner.load_run` reads it back.
    """
    instance_of("plan", plan, GraspPlan, PlanFailure)
    complete = plan.with_margins().with_reach() if isinstance(plan, GraspPlan) else plan
    return write_run(complete, folder, force=force, extras=extras)


def load_run(folder: str | Path) -> GraspPlan:
    """Read a plan back, with its hand and its object.

    Raises:
        InvalidInput: the folder holds no plan, one that is damaged, of another schema or without its hand, or the
            failure of a search (:func:`pinograsp.storage.read_run` reads those).
        HandNotLoaded: mesh files of the hand that are missing.

    Example:
        >>> import pinograsp as pg
        >>> folder = pg.save_run(pg.load_case("paper").plan(), "runs/paper")
        >>> print(pg.load_run(folder).status)
        ok

    See Also:
        :func:`~pinograsp.planner.save_run`, :class:`~pinograsp.planner.GraspPlan`.
    """
    record = read_run(folder, kind=GraspPlan)
    if isinstance(record, PlanFailure):
        raise InvalidInput(
            f"'{folder}' holds no plan, because its search found none ({record.status}): pinograsp report says why"
        )
    plan = instance_of("plan", record, GraspPlan)
    plan.require_hand()
    if plan.contacts.names != plan.problem.contacts.names or not np.array_equal(
        plan.forces.forces_c, plan.solution.forces_c
    ):
        raise InvalidInput(f"'{folder}' holds no readable run: expected the contact forces of its solution, got others")
    return plan if plan.body is not None else replace(plan, closure=None)  # an object of a class that no file knows
