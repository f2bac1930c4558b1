"""A run as one HTML file, which opens from disk in a browser with WebGL 2."""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinograsp.plan import PlanRecord, Simulation
from pinograsp.spatial import Array, IntArray
from pinograsp.viz.scene import ViewScene, scene_of
from pinograsp.viz.scene_meshes import AXES, GHOST, LOAD, arrow
from pinograsp.viz.style import finger_colours
from pinograsp.writing import write_file


def save_html(plan: PlanRecord, path: str | Path, *, simulation: Simulation | None = None) -> Path:
    """Write a page that shows a plan: one file that needs no server and no network; returns its path.

    Args:
        plan: as for :func:`~pinograsp.viz.viewer.view`.
        path: of the file; an existing file is overwritten.
        simulation: as for :func:`~pinograsp.viz.viewer.view`.

    Raises:
        InvalidInput: a plan without its hand, or a simulation of another plan.
        HandNotLoaded: mesh files are missing.
        ResultsNotWritten: the file cannot be written.
    """
    return write_file(path, page_of(scene_of(plan, simulation)).encode())


_NEAR = 4.5  # how much of the scene a camera at the hand sees, over a friction cone's height


# Where an array lies in the page's bytes: [type, offset, shape].
_Place: TypeAlias = list[str | int | list[int]]


class _Bytes:
    """Arrays, one after the other."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0

    def put(self, values: NDArray[Any], kind: Literal["f4", "u2", "u4"] = "f4") -> _Place:
        array = np.ascontiguousarray(values, dtype=f"<{kind}")
        place: _Place = [kind, self.size, list(array.shape)]
        padded = array.tobytes() + bytes(-array.nbytes % 4)
        self.parts.append(padded)
        self.size += len(padded)
        return place

    def mesh(self, vertices: Array, faces: IntArray) -> list[_Place]:
        return [self.put(vertices), self.put(faces, "u2" if len(vertices) < 65536 else "u4")]


def page_of(scene: ViewScene) -> str:
    """The page that shows a scene, as HTML."""
    template = files("pinograsp.viz").joinpath("viewer.html").read_text(encoding="utf-8")
    # "<" could end the script element that holds the record.
    record = json.dumps(_record(scene), allow_nan=False).replace("<", "\\u003c")
    return template.replace("__DATA__", record)


def _record(scene: ViewScene) -> dict[str, Any]:
    """The scene as plain JSON values, arrays in base64."""
    block, simulated = _Bytes(), scene.simulated
    limits = [float(limit) if np.isfinite(limit) and limit > 0 else None for limit in scene.limits]
    distinct = list(dict.fromkeys(scene.told))
    shape = "pyramid" if scene.pyramids else "cone"
    alone, apart = scene.centre, 0.0
    if simulated is not None:
        alone, apart = scene.centre - simulated.beside / 2, float(np.linalg.norm(simulated.beside)) / 2
    right = np.cross(scene.up, scene.view)
    top = np.cross(scene.view, right / np.linalg.norm(right))
    record: dict[str, Any] = {
        "title": scene.title,
        "subtitle": scene.subtitle,
        "status": scene.status,
        "answer": scene.answer.text,
        "level": scene.answer.level,
        "remedy": scene.remedy,
        "heading": scene.heading,
        "facts": [list(fact) for fact in scene.facts],
        "cautions": [*scene.cautions, *scene.unseen],
        "times": block.put(scene.times),
        "rate": scene.rate,
        "start": scene.frame_at(scene.closed),
        "phases": scene.phases,
        "sentences": distinct,
        "phase": [distinct.index(sentence) for sentence in scene.told],
        "links": scene.link_poses.shape[1],
        "solids": [
            {
                "name": one.name,
                "link": one.link,
                "colour": one.colour,
                "look": one.look,
                "mesh": block.mesh(one.vertices, one.faces),
            }
            for one in scene.solids
        ],
        "link_poses": block.put(scene.link_poses),
        "object_pose": None if scene.object_pose is None else scene.object_pose.tolist(),
        "carried": None if scene.carried is None else block.put(scene.carried),
        "contacts": [{"name": name, "colour": colour} for name, colour in zip(scene.contacts, scene.colours)],
        "points": scene.points_o.ravel().tolist(),
        "rotations": scene.rotations_oc.ravel().tolist(),
        "cones": [block.mesh(*cone) for cone in scene.cones],
        "cone_height": scene.cone_height,
        "cone_name": f"friction {shape}s",
        "cone_told": f"{shape}s: forces on the object that friction allows",
        "arrow": [block.mesh(*part) for part in arrow()],
        "axes": AXES,
        "load_colour": LOAD,
        "forces": block.put(scene.forces_o),
        "normal": block.put(scene.normal),
        "tangential": block.put(scene.tangential),
        "used": block.put(scene.used),
        "load": block.put(scene.load_o),
        "load_told": f"black arrow: its weight and {'other loads' if scene.carried is None else 'inertia'}",
        "com": scene.com_o.tolist(),
        "joints": [
            {"name": name, "slides": bool(slides), "limit": limit}
            for name, slides, limit in zip(scene.joints, scene.sliding, limits)
        ],
        "fingers": list(scene.fingers.items()),
        "finger_colours": finger_colours(scene.contacts, list(scene.fingers)),
        "q": block.put(scene.q),
        "torques": block.put(scene.torques),
        "force_scale": scene.force_scale,
        "up": scene.up.tolist(),
        "ground": scene.ground,
        "cell": scene.cell,
        "centre": scene.centre.tolist(),
        "centre_alone": alone.tolist(),
        "view": scene.view.tolist(),
        "extent": scene.extent.tolist(),
        "close": _NEAR * scene.cone_height / float(scene.extent[1:].max()),
        "thickness": scene.thickness,
        "alone": float(scene.extent[0]) - apart,
        "sign": (alone + top * scene.extent[1]).tolist(),
        "simulated": None,
    }
    if simulated is not None:
        record["simulated"] = {
            "held": simulated.held,
            "reason": simulated.reason,
            "link_poses": block.put(simulated.link_poses),
            "object_poses": block.put(simulated.object_poses),
            "parts": list(simulated.parts),
            "planned": simulated.planned.tolist(),
            "normal": block.put(simulated.normal_forces),
            "forces": block.put(simulated.forces_o),
            "points": [point.tolist() if np.isfinite(point).all() else None for point in simulated.points_b],
            "colours": [scene.colour_of(part) for part in simulated.parts],
            "drift": block.put(simulated.drift),
            "beside": simulated.beside.tolist(),
            "colour": GHOST,
        }
    record["bytes"] = base64.b64encode(b"".join(block.parts)).decode("ascii")
    return record
