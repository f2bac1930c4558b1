"""A pick as a folder of files."""

from __future__ import annotations

import json
from pathlib import Path

from pinograsp.checks import instance_of
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.simulation import PickSimulation
from pinograsp.writing import NewFolder, write_folder


def save_pick(
    plan: PickPlan,
    folder: str | Path | NewFolder,
    *,
    rate: float = 500.0,
    simulation: PickSimulation | None = None,
    force: bool = False,
) -> Path:
    """Write a pick into ``folder``, whole or not at all; returns it.

    ``pick.json`` (figures), ``view.html`` (arm and hand as they move), ``pick.png``, and the motion for controllers:
    ``trajectory.csv``, ``trajectory.json`` (of ROS 2), ``trajectory.xml`` with its ``.npz`` (MuJoCo's keyframes).

    Args:
        rate: of the trajectory's samples [Hz].
        simulation: of :func:`simulate_pick`, for its figures.
        force: replace what an earlier call wrote.

    Raises:
        InvalidInput: not a pick, an unusable rate.
        ResultsNotWritten: the folder exists and ``force`` is off, or the place cannot be written.
    """
    instance_of("plan", plan, PickPlan)
    instance_of("simulation", simulation, PickSimulation, type(None))
    trajectory = plan.trajectory(rate=rate)

    def fill(path: Path) -> None:
        seen = None if simulation is None else simulation.summary()
        document = json.dumps({**plan.summary(), "simulation": seen}, allow_nan=False, indent=1)
        (path / "pick.json").write_text(document + "\n", encoding="utf-8")
        trajectory.to_csv(path / "trajectory.csv")
        trajectory.to_ros2(path / "trajectory.json")
        trajectory.to_mujoco(path / "trajectory.xml")
        plan.picture(path / "pick.png")
        plan.save_html(path / "view.html")

    return write_folder(folder, fill, force=force)
