"""A scene as a recording for the Rerun viewer: extra ``rerun``."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import path_of
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.spatial import Array
from pinograsp.viz.raster import average_normals
from pinograsp.viz.scene import ViewScene
from pinograsp.viz.scene_meshes import LOAD, rgb
from pinograsp.viz.solids import Solid
from pinograsp.viz.style import finger_colours
from pinograsp.writing import write_file


def write_rerun(scene: ViewScene, path: str | Path) -> Path:
    """Write a scene as a recording for Rerun; returns its path.

    On the timeline ``time`` [s] it has below ``world`` the solids of hand and object, the contact forces and the load
    as arrows, ``scene.force_scale`` metres per newton, and below ``world/simulation`` the same of a simulation, beside
    the plan. Time series are ``normal/CONTACT`` and ``tangential/CONTACT`` [N], ``torques/JOINT`` [N m or N] and
    ``positions/JOINT`` [rad or m]; the text ``summary`` has answer, facts and warnings.

    Args:
        scene: as of :func:`~pinograsp.viz.scene.make_scene`.
        path: ends in .rrd; an existing file is overwritten. ``rerun FILE`` opens it.

    Raises:
        InvalidInput: another suffix.
        ExtraMissing: rerun-sdk is not installed.
        ResultsNotWritten: the file cannot be written.
    """
    path = path_of("path", path)
    if path.suffix.lower() != ".rrd":
        raise InvalidInput(f"recording: expected a name that ends in .rrd, got '{path.name:.200}'")
    try:
        import rerun as rr
    except ImportError as error:
        raise ExtraMissing("recordings for Rerun need rerun-sdk: pip install 'pinograsp[rerun]'") from error
    with tempfile.TemporaryDirectory(prefix="pinograsp-") as folder:
        made = Path(folder) / "scene.rrd"
        with rr.RecordingStream("pinograsp") as recording:
            recording.save(made, default_blueprint=_arrange(rr))
            _Recorder(rr, recording, scene).record()
        recording.disconnect()
        return write_file(path, made.read_bytes())


def _arrange(rr: Any) -> Any:
    """The scene beside its time series."""
    views = rr.blueprint
    series = [views.TimeSeriesView(origin=name, name=f"{name} [{unit}]") for name, unit in _UNITS.items()]
    plots = views.Vertical(*series, views.TextDocumentView(origin="summary", name="summary"))
    return views.Blueprint(views.Horizontal(views.Spatial3DView(origin="world"), plots, column_shares=[3, 2]))


_CLEAR = 100  # opacity of the object, of 255: arrows of forces begin on it and point inwards
_UNITS = {"normal": "N", "tangential": "N", "torques": "N m, N", "positions": "rad, m"}


class _Recorder:
    def __init__(self, rr: Any, recording: Any, scene: ViewScene):
        self.rr, self.recording, self.scene = rr, recording, scene
        self.frames = range(len(scene.times))

    def record(self) -> None:
        rr, scene = self.rr, self.scene
        axis = int(np.abs(scene.up).argmax())
        upwards = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if scene.up[axis] > 0 else 'DOWN'}"
        self._put(["world"], getattr(rr.ViewCoordinates, upwards))
        things = None if scene.object_pose is None else np.array([scene.object_at(i) for i in self.frames])
        self._solids(["world"], scene.link_poses, things)
        arrows = np.array([scene.carry_points(scene.arrows(i), i) for i in self.frames])
        for k, (name, colour) in enumerate(zip(scene.contacts, scene.colours)):
            self._arrow(["world", "forces", name], arrows[:, k], colour)
            self._series(["normal", name], scene.normal[:, k], colour)
            self._series(["tangential", name], scene.tangential[:, k], colour)
        loads = np.array([scene.carry_points(scene.load_arrow(i), i) for i in self.frames])
        self._arrow(["world", "load"], loads, LOAD)
        colours = finger_colours(scene.contacts, list(scene.fingers))
        for finger, joints in scene.fingers.items():
            for i in joints:
                self._series(["torques", scene.joints[i]], scene.torques[:, i], colours[finger])
                self._series(["positions", scene.joints[i]], scene.q[:, i], colours[finger])
        if (simulated := scene.simulated) is not None:
            self._put(["world", "simulation"], rr.Transform3D(translation=simulated.beside))
            self._solids(["world", "simulation"], simulated.link_poses, simulated.object_poses)
            pressing = np.array([simulated.arrows(i, scene.force_scale) for i in self.frames])
            for p, part in enumerate(simulated.parts):
                self._arrow(["world", "simulation", "forces", part], pressing[:, p], scene.colour_of(part))
        facts = (f"- {name}: {value}" for name, value in scene.facts)
        lines = [f"# {scene.title}", scene.subtitle, f"**{scene.answer}**", *facts, *scene.cautions, *scene.unseen]
        self._put(["summary"], rr.TextDocument("\n\n".join(map(str, lines)), media_type="text/markdown"))

    def _put(self, place: list[str], what: Any) -> None:
        self.recording.log(place, what, static=True)

    def _send(self, place: list[str], columns: Iterable[Any]) -> None:
        times = self.rr.TimeColumn("time", duration=self.scene.times)
        self.recording.send_columns(self.rr.new_entity_path(place), indexes=[times], columns=columns)

    def _solids(self, root: list[str], links: Array, things: Array | None) -> None:
        for i in range(links.shape[1]):
            self._move([*root, "hand", str(i)], links[:, i])
        if things is not None:
            self._move([*root, "object"], things)
        for solid in self.scene.solids:
            if solid.look != "collision" and (solid.link is not None or things is not None):
                parent = ["object"] if solid.link is None else ["hand", str(solid.link)]
                self._put([*root, *parent, solid.name], self._mesh(solid))

    def _mesh(self, solid: Solid) -> Any:
        normals = average_normals(solid.vertices, solid.faces)
        return self.rr.Mesh3D(
            vertex_positions=solid.vertices,
            triangle_indices=solid.faces,
            vertex_normals=normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300),
            albedo_factor=[*rgb(solid.colour), _CLEAR if solid.link is None else 255],
        )

    def _move(self, place: list[str], poses: Array) -> None:
        """Along positions and quaternions w, x, y, z (f, 7)."""
        self._send(place, self.rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, [4, 5, 6, 3]]))

    def _arrow(self, place: list[str], ends: Array, colour: str) -> None:
        """From start to end (f, 2, 3) [m]."""
        self._put(place, self.rr.Arrows3D.from_fields(colors=[rgb(colour)], radii=[self.scene.thickness]))
        self._send(place, self.rr.Arrows3D.columns(origins=ends[:, 0], vectors=ends[:, 1] - ends[:, 0]))

    def _series(self, place: list[str], values: Array, colour: str) -> None:
        self._put(place, self.rr.SeriesLines(colors=[rgb(colour)], names=[place[-1]]))
        self._send(place, self.rr.Scalars.columns(scalars=values))
