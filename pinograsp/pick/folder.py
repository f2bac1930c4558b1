"""A pick as a folder of files."""

from __future__ import annotations

from pathlib import Path

from pinograsp.carry.folder import write_way
from pinograsp.checks import instance_of
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.report import report_pick
from pinograsp.pick.simulation import PickSimulation
from pinograsp.storage.files import read_folder
from pinograsp.writing import NewFolder, write_folder

SCHEMA = "pinograsp.pick/1"
_ARRAYS, _PICTURE = "pick.npz", "pick.png"


def save_pick(
    plan: PickPlan,
    folder: str | Path | NewFolder,
    *,
    rate: float = 500.0,
    simulation: PickSimulation | None = None,
    force: bool = False,
) -> Path:
    """Write a pick into ``folder``, completely or not at all; returns it.

    ``report.html`` and ``report.md`` (phase by phase), ``view.html`` (arm and hand as they move), ``pick.png``,
    ``pick.json`` (figures), ``record.json``, ``scene.json`` and ``pick.npz`` (the plan, for :func:`load_pick`), and the
    motion for controllers: ``trajectory.csv``, ``trajectory.json`` (of ROS 2), ``trajectory.xml`` with its ``.npz``
    (MuJoCo's keyframes).

    Args:
        rate: of the trajectory's samples [Hz].
        simulation: from :func:`simulate_pick`, for its figures.
        force: replace the files of an earlier call.

    Raises:
        InvalidInput: not a pick, an unusable rate, or values that cannot be written.
        ResultsNotWritten: the folder exists and ``force`` is off, or it cannot be written.
    """
    instance_of("plan", plan, PickPlan)
    instance_of("simulation", simulation, PickSimulation, type(None))
    trajectory = plan.trajectory(rate=rate)

    def fill(path: Path) -> None:
        plan.picture(path / _PICTURE)
        report_pick(plan, [_PICTURE], simulation).write(path)
        seen = None if simulation is None else simulation.summary()
        write_way(path, plan, trajectory, SCHEMA, _ARRAYS, {"pick.json": {**plan.summary(), "simulation": seen}})

    return write_folder(folder, fill, force=force)


def load_pick(folder: str | Path) -> PickPlan:
    """Read a pick back, with its robot, its object and its scene.

    Raises:
        InvalidInput: the folder holds no pick, or one that is damaged or of another version.
        HandNotLoaded: mesh files of the robot are missing.
    """
    return read_folder(folder, PickPlan, SCHEMA, _ARRAYS, "pick")
