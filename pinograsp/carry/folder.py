"""A carry plan as a folder of files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.report import report_carry
from pinograsp.checks import instance_of
from pinograsp.handover import JointTrajectory
from pinograsp.plan import Simulation
from pinograsp.storage.files import documents_of, read_folder
from pinograsp.viz.shown import Shown
from pinograsp.writing import NewFolder, write_folder

SCHEMA = "pinograsp.carry/1"
_ARRAYS = "carry.npz"


def save_carry(
    plan: CarryPlan,
    folder: str | Path | NewFolder,
    *,
    rate: float = 1000.0,
    simulation: Simulation | None = None,
    force: bool = False,
) -> Path:
    """Write a carry plan into ``folder``, completely or not at all; returns it.

    ``report.html`` and ``report.md``, figures, ``view.html`` (arm and hand as they move), ``carry.json`` (figures),
    ``record.json``, ``scene.json`` and ``carry.npz`` (the plan, for :func:`load_carry`), and the motion for a
    controller: ``trajectory.csv``, ``trajectory.json`` (of ROS 2), ``trajectory.xml`` with its ``.npz`` (MuJoCo's
    keyframes).

    Args:
        rate: of the trajectory's samples [Hz].
        simulation: from :func:`~pinograsp.carry.simulate_carry`, for the report.
        force: replace the files of an earlier call.

    Raises:
        InvalidInput: not a carry plan, an unusable rate, or values that cannot be written.
        ResultsNotWritten: the folder exists and ``force`` is off, or it cannot be written.
    """
    instance_of("plan", plan, CarryPlan)
    instance_of("simulation", simulation, Simulation, type(None))
    trajectory = plan.trajectory(rate=rate)

    def fill(path: Path) -> None:
        report_carry(plan, [figure.name for figure in plan.save_figures(path)], simulation).write(path)
        seen = None if simulation is None else simulation.summary()
        write_way(path, plan, trajectory, SCHEMA, _ARRAYS, {"carry.json": {**plan.summary(), "simulation": seen}})

    return write_folder(folder, fill, force=force)


def load_carry(folder: str | Path) -> CarryPlan:
    """Read a carry plan back, with its robot and its object.

    Raises:
        InvalidInput: the folder holds no carry plan, or one that is damaged or of another version.
        HandNotLoaded: mesh files of the robot are missing.
    """
    return read_folder(folder, CarryPlan, SCHEMA, _ARRAYS, "carry plan")


def write_way(
    path: Path,
    plan: Shown,
    trajectory: JointTrajectory,
    schema: str,
    archive: str,
    figures: Mapping[str, Mapping[str, Any]],
) -> None:
    """The record of a way, its figures by the names of their files, its page, and its motion for controllers."""
    documents_of(plan, schema, figures).write(path, archive)
    trajectory.to_csv(path / "trajectory.csv")
    trajectory.to_ros2(path / "trajectory.json")
    trajectory.to_mujoco(path / "trajectory.xml")
    plan.save_html(path / "view.html")
