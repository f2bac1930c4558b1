"""Runs on disk: ``plan.json`` has figures for people, ``record.json``, ``plan.npz`` and ``scene.json`` the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pinograsp.checks import one_line, path_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanFailure, PlanRecord, Simulation
from pinograsp.storage.consistency import check_plan, check_settings
from pinograsp.storage.files import (
    RECORD,
    SCENE,
    SCENE_SCHEMA,
    documents_of,
    read_arrays,
    read_document,
    read_of_one,
    read_whole,
)
from pinograsp.storage.schema import read_record
from pinograsp.storage.simulations import FIGURES as CHECK_FIGURES, read_simulation
from pinograsp.writing import NewFolder, write_folder

SCHEMA, FAILURE = "pinograsp.plan/3", "pinograsp.failure/3"
_FIGURES, _ARRAYS = "plan.json", "plan.npz"


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
        raise InvalidInput(f"extras: expected a function of a path, got {shorten(extras)}")
    if isinstance(run, PlanRecord) and (run.margins is None or run.reach is None):
        raise InvalidInput("run: expected a plan with its margins, got one without: plan.with_margins().with_reach()")
    schema = FAILURE if isinstance(run, PlanFailure) else SCHEMA
    documents = documents_of(run, schema, {_FIGURES: {"schema": schema, **_figures(run)}})

    def fill(staging: Path) -> None:
        documents.write(staging, _ARRAYS)
        if extras is not None:
            extras(staging)

    return write_folder(folder, fill, force=force)


def _figures(run: PlanRecord | PlanFailure) -> dict[str, Any]:
    """A run's figures with its names, settings and versions, for people and their scripts."""
    if isinstance(run, PlanFailure):
        layout: dict[str, Any] = {"hand": run.hand, "contacts": list(run.contacts)}
    else:
        layout = {
            "hand": run.layout.hand,
            "joints": list(run.layout.joints),
            "fingers": {finger: list(dofs) for finger, dofs in run.layout.fingers.items()},
            "contacts": list(run.contacts.names),
        }
    return {**run.summary(), "layout": layout, "settings": dict(run.settings), "versions": dict(run.versions)}


def read_run(
    folder: str | Path, *, kind: type[PlanRecord] = PlanRecord, with_scene: bool = True
) -> PlanRecord | PlanFailure:
    """The plan in a folder, or the failure of one.

    Args:
        folder: of the run.
        kind: the class of the record.
        with_scene: whether to read the hand, with its meshes, and the object. Reports and figures need neither but for
            the picture of the grasp.

    Raises:
        InvalidInput: the folder holds no run, or one that is damaged or of another version.
        HandNotLoaded: mesh files of the hand that are missing.
    """
    folder = path_of("folder", folder)

    def read(folder: Path) -> PlanRecord | PlanFailure:
        _refuse_older(folder)
        document, arrays = read_document(folder / RECORD), read_arrays(folder / _ARRAYS)
        if document.get("schema") == FAILURE:
            failure = read_record(PlanFailure, document.get("record"), arrays, None)
            check_settings(failure.settings)
            return failure
        if document.get("schema") != SCHEMA:
            raise InvalidInput(f"{RECORD}: expected schema {SCHEMA}, got {document.get('schema')!r:.60}")
        has_scene = with_scene and (folder / SCENE).exists()
        scene: Mapping[str, Any] | None = read_document(folder / SCENE, SCENE_SCHEMA) if has_scene else None
        plan = read_record(kind, document.get("record"), arrays, scene)
        check_plan(plan)
        return plan

    return read_whole(folder, read, "run")


def _refuse_older(folder: Path) -> None:
    """Say how to go on with a run of version 0.2 or earlier, which kept neither the problem nor the closure."""
    if (folder / RECORD).exists() or not (folder / _FIGURES).is_file():
        return
    schema = read_document(folder / _FIGURES).get("schema")
    if schema in ("pinograsp.plan/1", "pinograsp.plan/2"):
        raise InvalidInput(
            f"{_FIGURES}: expected a run with its {RECORD}, got one of version 0.2 or earlier ({schema}), which kept "
            "less than a plan: plan it again (its case stands in "
            f"{_FIGURES} under 'settings')"
        )


def newest_check(folder: str | Path) -> Path | None:
    """The folder of the last simulation of a run, where there is one below the run's own."""
    folder = path_of("folder", folder)
    try:
        found = folder.glob(f"[!.]*/{CHECK_FIGURES}")  # hidden: not written to the end
        checks = [path.parent for path in found if path.is_file()]
    except (OSError, ValueError) as error:  # ValueError: a name that no file system takes
        raise InvalidInput(
            f"folder: expected that of a run, got {shorten(str(folder))}: {type(error).__name__}"
        ) from error
    return max(checks, key=lambda path: (path / CHECK_FIGURES).stat().st_mtime_ns, default=None)


def read_check(folder: str | Path) -> Simulation:
    """The simulation in a folder; :class:`InvalidInput` where it holds none."""
    folder = path_of("folder", folder)
    try:
        return read_of_one(folder, read_simulation)
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(
            f"simulation: expected a folder that 'pinograsp check' wrote, got {shorten(str(folder))} "
            f"({one_line(error)})"
        ) from error
