"""Runs on disk.

``plan.json`` holds figures and settings, ``plan.npz`` the arrays, ``scene.json`` the hand and the object.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pinograsp.checks import one_line, path_of, shown
from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands.record import hand_record
from pinograsp.objects.record import object_record
from pinograsp.plan import PlanFailure, PlanRecord, Simulation
from pinograsp.storage.arrays import read_arrays, write_arrays
from pinograsp.storage.documents import read_document
from pinograsp.storage.plans import failure_of, plan_of
from pinograsp.storage.simulations import read_simulation
from pinograsp.writing import NewFolder, write_folder

SCHEMA = "pinograsp.plan/2"
SCENE = "pinograsp.scene/1"

T = TypeVar("T")


def write_run(
    run: PlanRecord | PlanFailure,
    folder: str | Path | NewFolder,
    *,
    force: bool = False,
    extras: Callable[[Path], None] | None = None,
) -> Path:
    """Write a plan, or its failure, into ``folder``, whole or not at all; returns it.

    ``extras(path)`` may add files (report, figures). ``force`` replaces an earlier run, with its checks.

    Raises:
        InvalidInput: a plan without margins, or settings that cannot be written down.
        ResultsNotWritten: the folder exists and ``force`` is off, it holds files that no run wrote, another process is
            writing it, or the place cannot be written.
    """
    if extras is not None and not callable(extras):
        raise InvalidInput(f"extras: expected a function of a path, got {shown(extras)}")
    documents = _documents(run)

    def fill(staging: Path) -> None:
        for name, text in documents.items():
            (staging / name).write_text(text + "\n", encoding="utf-8")
        write_arrays(staging / "plan.npz", run.arrays() if isinstance(run, PlanRecord) else {})
        if extras is not None:
            extras(staging)

    return write_folder(folder, fill, force=force)


def _documents(run: PlanRecord | PlanFailure) -> dict[str, str]:
    """The texts of a run's documents by their names."""
    scene: dict[str, Any] = {}
    if isinstance(run, PlanFailure):
        layout: dict[str, Any] = {"hand": run.hand, "contacts": list(run.contacts)}
    else:
        if run.margins is None or run.reach is None:
            raise InvalidInput(
                "run: expected a plan with its margins, got one without: plan.with_margins().with_reach()"
            )
        layout = {
            "hand": run.layout.hand,
            "joints": list(run.layout.joints),
            "fingers": {finger: list(dofs) for finger, dofs in run.layout.fingers.items()},
            "contacts": list(run.contacts.names),
        }
        scene["hand"] = None if run.hand is None else hand_record(run.hand)
        scene["object"] = None if run.body is None else object_record(run.body)
    plan = {
        "schema": SCHEMA,
        **run.summary(),
        "layout": layout,
        "settings": dict(run.settings),
        "versions": dict(run.versions),
    }
    try:
        documents = {"plan.json": json.dumps(plan, indent=2, allow_nan=False)}
        if scene:
            documents["scene.json"] = json.dumps({"schema": SCENE, **scene}, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"run: expected plain, finite values in summary and settings ({error})") from error
    return documents


def read_run(folder: str | Path, *, with_scene: bool = True) -> PlanRecord | PlanFailure:
    """The plan in a folder, or the failure of one.

    Args:
        folder: of the run.
        with_scene: whether to read the hand, with its meshes, and the object. Reports and figures need neither but for
            the picture of the grasp.

    Raises:
        InvalidInput: the folder holds no run, or one that is damaged or of another schema.
        HandNotLoaded: mesh files of the hand that are missing.
    """
    folder = path_of("folder", folder)

    def read(folder: Path) -> PlanRecord | PlanFailure:
        document, arrays = read_document(folder / "plan.json", SCHEMA), read_arrays(folder / "plan.npz")
        if "message" in document:
            return failure_of(document, arrays)
        path = folder / "scene.json"
        return plan_of(document, arrays, read_document(path, SCENE) if with_scene and path.exists() else None)

    try:
        return _of_one(folder, read)
    except HandNotLoaded:
        raise
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(f"'{folder}' holds no readable run: {one_line(error)}") from error


def newest_check(folder: str | Path) -> Path | None:
    """The folder of the last simulation of a run, where there is one below the run's own."""
    folder = path_of("folder", folder)
    try:
        found = folder.glob("[!.]*/check.json")  # hidden: not written to the end
        checks = [path.parent for path in found if path.is_file()]
    except (OSError, ValueError) as error:  # ValueError: a name that no file system takes
        raise InvalidInput(
            f"folder: expected that of a run, got {shown(str(folder))}: {type(error).__name__}"
        ) from error
    return max(checks, key=lambda path: (path / "check.json").stat().st_mtime_ns, default=None)


def read_check(folder: str | Path) -> Simulation:
    """The simulation in a folder; :class:`InvalidInput` where it holds none."""
    folder = path_of("folder", folder)
    try:
        return _of_one(folder, read_simulation)
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(
            f"simulation: expected a folder that 'pinograsp check' wrote, got {shown(str(folder))} ({one_line(error)})"
        ) from error


def _of_one(folder: Path, read: Callable[[Path], T]) -> T:
    """What ``read(folder)`` gives, all of one folder: another may take its place meanwhile."""
    while True:
        before = _state(folder)
        try:
            value = read(folder)
        except Exception:
            if _state(folder) == before:
                raise
        else:
            if _state(folder) == before:
                return value


def _state(folder: Path) -> tuple[int, int] | None:
    try:
        found = folder.stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_ctime_ns
