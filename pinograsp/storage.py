"""Runs on disk.

``plan.json`` holds figures and settings, ``plan.npz`` the arrays, ``scene.json`` the hand and the object.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pinograsp.checks import mapping_of, one_line, path_of, shown
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.objects.body import Body
from pinograsp.objects.record import object_of, object_record
from pinograsp.run_files import read_check, read_document, read_plan
from pinograsp.writing import NewFolder, write_folder

SCHEMA = "pinograsp.plan/2"
SCENE = "pinograsp.scene/1"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A plan as data, fresh or read back: everything that reports and figures need.

    Attributes:
        summary: ``GraspPlan.summary()``.
        arrays: ``GraspPlan.arrays()`` and ``GraspPlan.margins_around()``.
        layout: names: ``{"hand", "joints": [...], "fingers": {name: [dof, ...]}, "contacts": [...]}``.
        settings: the case that made it (empty for a plan made from Python).
        versions: packages and their versions.
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
        told = {
            "name": self.settings.get("name"),
            "status": self.summary.get("status"),
            "hand": self.layout.get("hand"),
        }
        words = ", ".join(f"{key}={value!r:.60}" for key, value in told.items())
        return (
            f"Run({words}, contacts={', '.join(map(str, self.layout.get('contacts', ())))!r:.60}, "
            f"arrays={len(self.arrays)})"
        )

    def hand(self) -> HandModel:
        """The hand of the plan, as it was placed; its meshes are read from their files.

        Raises:
            InvalidInput: the run has none, a broken one, or one of other joints and links than the plan's;
                HandNotLoaded names mesh files that are missing.
        """
        hand = hand_of(self._kept("hand", "load it from its description, pinograsp.load_hand"))
        fingers = {finger.name: finger.dofs.tolist() for finger in hand.fingers}
        if list(hand.joint_names) != self.layout.get("joints") or fingers != self.layout.get("fingers"):
            raise InvalidInput(
                "expected the hand of the plan, got one with other joints or fingers (scene.json): plan it again"
            )
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
    if not (hasattr(plan, "forces") and hasattr(plan, "margins_around")):
        raise InvalidInput(f"plan: expected a GraspPlan, got {shown(plan)}")
    settings = {} if settings is None else mapping_of("settings", settings)
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
        settings=settings,
        versions=_versions(plan.forces.backend),
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
            "residual": proof.residual.tolist(),
        }
    return Run(summary=summary, arrays={}, layout=layout, settings=settings or {}, versions=_versions(solution.backend))


def _versions(solver: str) -> dict[str, str]:
    from importlib.metadata import version

    packages = ("pinograsp", "pin", "qpsolvers", "numpy", *((solver,) if solver in ("daqp", "clarabel") else ()))
    return {name: version(name) for name in packages}


def save_run(
    run, folder: str | Path | NewFolder, *, force: bool = False, extras: Callable[[Path], None] | None = None
) -> Path:
    """Write a run, or a :class:`~pinograsp.plan.GraspPlan`, into ``folder``, whole or not at all; returns it.

    ``extras(path)`` may add files (report, figures). ``force`` replaces an earlier run, with its checks.

    Raises:
        InvalidInput: neither a run nor a plan, or one with values that cannot be written down.
        ResultsNotWritten: the folder exists and ``force`` is off, it holds files that no run wrote, another process is
            writing it, or the place cannot be written.
    """
    if not isinstance(run, Run):
        run = run_of(run)
    document = {
        "schema": SCHEMA,
        **run.summary,
        "layout": run.layout,
        "settings": run.settings,
        "versions": run.versions,
    }
    try:
        documents = {"plan.json": json.dumps(document, indent=2, allow_nan=False)}
        if run.scene:
            documents["scene.json"] = json.dumps({"schema": SCENE, **run.scene}, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"run: expected plain, finite values in summary, layout, settings and scene ({error})"
        ) from error

    if extras is not None and not callable(extras):
        raise InvalidInput(f"extras: expected a function of a path, got {shown(extras)}")

    def fill(staging: Path) -> None:
        for name, text in documents.items():
            (staging / name).write_text(text + "\n", encoding="utf-8")
        np.savez_compressed(staging / "plan.npz", **run.arrays)
        if extras is not None:
            extras(staging)

    return write_folder(folder, fill, force=force)


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


def load_check(folder: str | Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Summary and arrays of a simulation; :class:`InvalidInput` where the folder holds none."""
    folder = path_of("folder", folder)
    try:
        return _of_one(folder, read_check)
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(
            f"simulation: expected a folder that 'pinograsp check' wrote, got {shown(str(folder))} ({one_line(error)})"
        ) from error


def load_run(folder: str | Path) -> Run:
    """Read a run back; :class:`InvalidInput` where the folder holds none, a damaged one or one of another schema."""
    folder = path_of("folder", folder)

    def read(folder: Path) -> tuple[dict, dict, dict]:
        scene = folder / "scene.json"
        return *read_plan(folder, SCHEMA), read_document(scene, SCENE) if scene.exists() else {}

    try:
        document, arrays, scene = _of_one(folder, read)
        layout, settings, versions = (document.pop(name) for name in ("layout", "settings", "versions"))
    except Exception as error:  # the readers raise whatever comes of a broken file
        raise InvalidInput(f"'{folder}' holds no readable run: {one_line(error)}") from error
    return Run(summary=document, arrays=arrays, layout=layout, settings=settings, versions=versions, scene=scene)


def _of_one(folder: Path, read: Callable[[Path], tuple]) -> tuple:
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
