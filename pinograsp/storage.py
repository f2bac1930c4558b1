"""Runs on disk, written whole or not at all.

``plan.json`` holds figures and settings, ``plan.npz`` the arrays, ``scene.json`` the hand and the object.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.hands.model import HandModel
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.objects.body import Body
from pinograsp.objects.record import object_of, object_record
from pinograsp.run_files import read_check, read_document, read_plan

SCHEMA = "pinograsp.plan/1"
SCENE = "pinograsp.scene/1"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A plan as data, fresh or read back: everything that reports and figures need.

    Attributes:
        summary: ``GraspPlan.summary()``. arrays: ``GraspPlan.arrays()`` and ``GraspPlan.margins_around()``.
        layout: names: ``{"hand", "joints": [...], "fingers": {name: [dof, ...]}, "contacts": [...]}``.
        settings: the case that made it (empty for a plan made from Python). versions: packages and their versions.
        scene: ``{"hand": hand_record(...), "object": object_record(...)}``, None for what cannot be written down; empty
            for runs without a plan and for those of versions that did not keep it.
    """

    summary: dict
    arrays: dict[str, np.ndarray]
    layout: dict
    settings: dict
    versions: dict
    scene: dict = field(default_factory=dict)

    def __repr__(self) -> str:
        told = {"name": self.settings.get("name"), "status": self.summary.get("status"), "hand": self.layout.get("hand")}
        words = ", ".join(f"{key}={value!r:.60}" for key, value in told.items())
        return f"Run({words}, contacts={', '.join(map(str, self.layout.get('contacts', ())))!r:.60}, arrays={len(self.arrays)})"

    def hand(self) -> HandModel:
        """The hand of the plan, as it was placed; its meshes are read from their files.

        Raises:
            InvalidInput: the run has none, a broken one, or one of other joints and links than the plan's; HandNotLoaded names
                mesh files that are missing.
        """
        hand = hand_of(self._kept("hand", "load it from its description, pinograsp.load_hand"))
        fingers = {finger.name: finger.dofs.tolist() for finger in hand.fingers}
        if list(hand.joint_names) != self.layout.get("joints") or fingers != self.layout.get("fingers"):
            raise InvalidInput("expected the hand of the plan, got one with other joints or fingers (scene.json): plan it again")
        for link in self.arrays.get("contact_links", ()):
            if str(link) and not hand.model.existFrame(str(link)):
                raise InvalidInput(f"expected contacts of the hand, it has no link '{link}': plan it again")
        return hand

    def object(self) -> Body:
        """The object of the plan, where it was held; :class:`InvalidInput` where the run has none, or a broken one."""
        return object_of(self._kept("object", "make it again, as it was made for the plan"))

    def _kept(self, key: str, remedy: str) -> dict:
        if self.scene.get(key) is None:
            raise InvalidInput(f"expected a run with its {key}, got one that did not keep it: {remedy}")
        return self.scene[key]


def run_of(plan, settings: dict | None = None) -> Run:
    """A :class:`Run` of a :class:`~pinograsp.plan.GraspPlan`."""
    layout = {
        "hand": plan.hand.name,
        "joints": list(plan.hand.joint_names),
        "fingers": {finger.name: finger.dofs.tolist() for finger in plan.hand.fingers},
        "contacts": list(plan.problem.contacts.names),
    }
    return Run(
        summary=plan.summary(),
        arrays=plan.arrays() | plan.margins_around(),
        layout=layout,
        settings=settings or {},
        versions=_versions(plan.forces.solver),
        scene={"hand": hand_record(plan.hand), "object": object_record(plan.problem.object)},
    )


def run_of_failure(error, layout: dict, settings: dict | None = None) -> Run:
    """A :class:`Run` of a :class:`~pinograsp.errors.GraspInfeasible`: status and diagnosis, no arrays."""
    solution = error.solution
    summary = {"status": str(solution.status), "search": solution.search, "message": str(error)}
    if solution.infeasibility is not None:
        proof = solution.infeasibility
        summary["proof"] = {
            "margin_N": proof.margin,
            "direction": proof.direction.tolist(),
            "at_torque_limit": list(proof.at_torque),
            "net_wrench": proof.net_wrench.tolist(),
        }
    return Run(summary=summary, arrays={}, layout=layout, settings=settings or {}, versions=_versions(solution.solver))


def _versions(solver: str) -> dict[str, str]:
    from importlib.metadata import version

    packages = ("pinograsp", "pin", "qpsolvers", "numpy", *((solver,) if solver in ("daqp", "clarabel") else ()))
    return {name: version(name) for name in packages}


def save_run(
    run: Run, folder: str | Path, *, force: bool = False, extras: Callable[[Path], None] | None = None
) -> Path:
    """Write a run into ``folder``; returns it.

    Everything is written into a hidden sibling first and renamed at the end, so a crash leaves nothing half-written.
    ``extras(path)`` may add files (report, figures) before the rename.

    Raises:
        ResultsNotWritten: the folder exists and ``force`` is off, or it holds files that no run wrote, or the place
            cannot be written.
    """

    def fill(staging: Path) -> None:
        document = {
            "schema": SCHEMA,
            **run.summary,
            "layout": run.layout,
            "settings": run.settings,
            "versions": run.versions,
        }
        (staging / "plan.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        np.savez_compressed(staging / "plan.npz", **run.arrays)
        if run.scene:
            scene = json.dumps({"schema": SCENE, **run.scene}, allow_nan=False)
            (staging / "scene.json").write_text(scene + "\n", encoding="utf-8")
        if extras is not None:
            extras(staging)

    return write_folder(folder, fill, force=force)


def write_folder(folder: str | Path, fill: Callable[[Path], None], *, force: bool = False) -> Path:
    """A folder with what ``fill(path)`` writes, whole or not at all; errors as :func:`save_run`."""
    folder = Path(folder)
    check_folder(folder, force)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise ResultsNotWritten(f"cannot write next to '{folder}': {error}") from error
    try:
        fill(staging)
        files = sorted(path.name for path in staging.iterdir())
        (staging / "files.txt").write_text("\n".join(files) + "\n", encoding="utf-8")
        staging.chmod(0o777 & ~_umask())  # mkdtemp makes it private; results are as readable as any other folder
        _move_into_place(staging, folder)
    except OSError as error:
        raise ResultsNotWritten(f"cannot write '{folder}': {error}") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return folder


def write_file(path: str | Path, content: bytes) -> Path:
    """One file, whole or not at all: written next to its place, then renamed; returns its path.

    Raises:
        ResultsNotWritten: it cannot be written.
    """
    path = Path(path)
    staging = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, staging = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())  # renamed before its content is on disk, it could be empty after a power cut
        os.chmod(staging, 0o666 & ~_umask())  # mkstemp makes it private; results are as readable as any other file
        Path(staging).replace(path)
    except BaseException as error:
        if staging is not None:
            Path(staging).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise ResultsNotWritten(f"cannot write '{path}': {error}") from error
        raise
    return path


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


def add_files(folder: str | Path, fill: Callable[[Path], None]) -> None:
    """Files that ``fill(path)`` writes, moved into a run's folder one by one; they replace earlier ones.

    Raises:
        ResultsNotWritten: the folder cannot be written.
    """
    folder = Path(folder)
    try:
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as staging:
            fill(Path(staging))
            new = sorted(Path(staging).iterdir())
            listing = folder / "files.txt"
            known = listing.read_text(encoding="utf-8").split() if listing.is_file() else []
            for path in new:
                path.replace(folder / path.name)
            (Path(staging) / "files.txt").write_text("\n".join(sorted({*known, *(path.name for path in new)})) + "\n", encoding="utf-8")
            (Path(staging) / "files.txt").replace(listing)
    except OSError as error:
        raise ResultsNotWritten(f"cannot write into '{folder}': {error}") from error


def newest_check(folder: str | Path) -> Path | None:
    """The folder of the last simulation of a run, where there is one below the run's own."""
    checks = [path.parent for path in Path(folder).glob("*/check.json")]
    return max(checks, key=lambda path: (path / "check.json").stat().st_mtime_ns, default=None)


def load_check(folder: str | Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Summary and arrays of a simulation; :class:`InvalidInput` where the folder holds none."""
    folder = Path(folder)
    try:
        return read_check(folder)
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(
            f"simulation: expected a folder that 'pinograsp check' wrote, got '{folder}' ({_cause(error)})"
        ) from error


def check_folder(folder: str | Path, force: bool) -> None:
    """Raise :class:`ResultsNotWritten` unless a run may be written to ``folder`` (call it before long work)."""
    folder = Path(folder)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ResultsNotWritten(f"'{folder}' is a file: give a folder that does not exist yet")
    if not any(folder.iterdir()):
        return
    if not force:
        raise ResultsNotWritten(f"folder '{folder}' already exists: choose another --out, or overwrite it with --force")
    listing = folder / "files.txt"
    ours = {*(listing.read_text(encoding="utf-8").split("\n") if listing.is_file() else ()), "files.txt"}
    if (folder / "plan.json").is_file() and listing.is_file():  # checks of a run, and their trials, lie in folders within it
        ours |= {path.name for path in folder.iterdir() if (path / "check.json").is_file() or any(path.glob("*/monte_carlo.jsonl"))}
    foreign = sorted(path.name for path in folder.iterdir() if path.name not in ours)
    if foreign:
        raise ResultsNotWritten(
            f"folder '{folder}' holds files that no run wrote ({', '.join(foreign[:5])}): it is not overwritten, "
            "choose another --out"
        )


def _move_into_place(staging: Path, folder: Path) -> None:
    if not folder.exists():
        staging.rename(folder)
        return
    retired = Path(tempfile.mkdtemp(prefix=f".{folder.name}-old-", dir=folder.parent))
    folder.rename(retired / "run")
    try:
        staging.rename(folder)
    except OSError:
        (retired / "run").rename(folder)
        raise
    finally:
        shutil.rmtree(retired, ignore_errors=True)


def load_run(folder: str | Path) -> Run:
    """Read a run back; :class:`InvalidInput` where the folder holds none, or one that is damaged or of another schema."""
    folder = Path(folder)
    try:
        document, arrays = read_plan(folder, SCHEMA)
        scene = read_document(folder / "scene.json", SCENE) if (folder / "scene.json").exists() else {}
        layout, settings, versions = (document.pop(name) for name in ("layout", "settings", "versions"))
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(f"'{folder}' holds no readable run: {_cause(error)}") from error
    return Run(summary=document, arrays=arrays, layout=layout, settings=settings, versions=versions, scene=scene)


def _cause(error: Exception) -> str:
    return str(error) if isinstance(error, InvalidInput) else f"{type(error).__name__}: {error}"[:300]
