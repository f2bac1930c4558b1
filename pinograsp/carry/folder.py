"""A carry plan as a folder of files."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.report import report_carry
from pinograsp.checks import instance_of
from pinograsp.plan import Simulation
from pinograsp.writing import NewFolder, write_folder


def save_carry(
    plan: CarryPlan,
    folder: str | Path | NewFolder,
    *,
    rate: float = 1000.0,
    simulation: Simulation | None = None,
    force: bool = False,
) -> Path:
    """Write a carry plan into ``folder``, whole or not at all; returns it.

    ``report.html`` and ``report.md``, figures, ``view.html`` (arm and hand as they move), ``carry.json`` (figures),
    ``carry.npz`` (the plan's arrays, by their names), and the motion for a controller: ``trajectory.csv``,
    ``trajectory.json`` (of ROS 2), ``trajectory.xml`` with its ``.npz`` (MuJoCo's keyframes).

    Args:
        rate: of the trajectory's samples [Hz].
        simulation: of :func:`~pinograsp.carry.simulate_carry`, for the report.
        force: replace what an earlier call wrote.

    Raises:
        InvalidInput: not a carry plan, an unusable rate.
        ResultsNotWritten: the folder exists and ``force`` is off, or the place cannot be written.
    """
    instance_of("plan", plan, CarryPlan)
    instance_of("simulation", simulation, Simulation, type(None))
    trajectory = plan.trajectory(rate=rate)

    def fill(path: Path) -> None:
        report_carry(plan, [figure.name for figure in plan.save_figures(path)], simulation).write(path)
        seen = None if simulation is None else simulation.summary()
        document = json.dumps({**plan.summary(), "simulation": seen}, allow_nan=False, indent=1)
        (path / "carry.json").write_text(document + "\n", encoding="utf-8")
        values = {one.name: getattr(plan, one.name) for one in fields(plan)}
        arrays: dict[str, Any] = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        np.savez_compressed(path / "carry.npz", binding=np.array(plan.binding), **arrays)
        trajectory.to_csv(path / "trajectory.csv")
        trajectory.to_ros2(path / "trajectory.json")
        trajectory.to_mujoco(path / "trajectory.xml")
        plan.save_html(path / "view.html")

    return write_folder(folder, fill, force=force)
