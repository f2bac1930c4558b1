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
from pinograsp.viz.scene import ViewScene, make_scene
from pinograsp.viz.scene_meshes import AXES, GHOST, LOAD, arrow
from pinograsp.viz.simulated import Simulated
from pinograsp.viz.style import finger_colours
from pinograsp.writing import write_file

_NEAR = 4.5  # how much of the scene a camera at the hand sees, over a friction cone's height

# What pages have as scenes have it; and what lies in their bytes, by its name in the page and in the scene.
_PLAIN = ["title", "subtitle", "status", "remedy", "heading", "facts", "rate", "phases", "cone_height", "force_scale"]
_PLAIN += ["up", "ground", "cell", "centre", "view", "extent", "thickness"]
_STORED = {name: name for name in ("times", "link_poses", "normal", "tangential", "used", "q", "torques")}
_STORED |= {"forces": "forces_o", "load": "load_o"}
_SIMULATED = {"link_poses": "link_poses", "object_poses": "object_poses", "drift": "drift"}
_SIMULATED |= {"normal": "normal_forces", "forces": "forces_o"}


def save_html(plan: PlanRecord, path: str | Path, *, simulation: Simulation | None = None) -> Path:
    """Write a page that shows a plan: one file that needs no server and no network; returns its path.

    Args:
        plan: as for :func:`~pinograsp.viz.viewer.view`.
        path: path of the file; an existing file is overwritten.
        simulation: as for :func:`~pinograsp.viz.viewer.view`.

    Raises:
        InvalidInput: a plan without its hand, or a simulation of another plan.
        HandNotLoaded: mesh files are missing.
        ResultsNotWritten: the file cannot be written.
    """
    return write_file(path, render_page(make_scene(plan, simulation)).encode())


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


def render_page(scene: ViewScene) -> str:
    """Render the page of a scene as HTML."""
    template = files("pinograsp.viz").joinpath("viewer.html").read_text(encoding="utf-8")
    # "<" could end the script element that holds the record.
    record = json.dumps(_record(scene), allow_nan=False).replace("<", "\\u003c")
    return template.replace("__DATA__", record)


def _record(scene: ViewScene) -> dict[str, Any]:
    """The scene as plain JSON values, arrays in base64."""
    block, simulated = _Bytes(), scene.simulated
    alone, apart = scene.centre, 0.0
    if simulated is not None:
        alone, apart = scene.centre - simulated.beside / 2, float(np.linalg.norm(simulated.beside)) / 2
    right = np.cross(scene.up, scene.view)
    top = np.cross(scene.view, right / np.linalg.norm(right))
    distinct = list(dict.fromkeys(scene.told))
    record = {
        **{name: _to_plain(getattr(scene, name)) for name in _PLAIN},
        **{name: block.put(getattr(scene, field)) for name, field in _STORED.items()},
        **_describe(scene),
        "start": scene.frame_at(scene.closed),
        "sentences": distinct,
        "phase": [distinct.index(sentence) for sentence in scene.told],
        "links": scene.link_poses.shape[1],
        "solids": [
            {"name": one.name, "link": one.link, "colour": one.colour, "look": one.look}
            | {"mesh": block.mesh(one.vertices, one.faces)}
            for one in scene.solids
        ],
        "object_pose": _to_plain(scene.object_pose),
        "carried": None if scene.carried is None else block.put(scene.carried),
        "points": scene.points_o.ravel().tolist(),
        "rotations": scene.rotations_oc.ravel().tolist(),
        "cones": [block.mesh(*cone) for cone in scene.cones],
        "arrow": [block.mesh(*part) for part in arrow()],
        "com": scene.com_o.tolist(),
        "centre_alone": alone.tolist(),
        "close": _NEAR * scene.cone_height / float(scene.extent[1:].max()),
        "alone": float(scene.extent[0]) - apart,
        "sign": (alone + top * scene.extent[1]).tolist(),
        "simulated": None if simulated is None else _record_simulation(scene, simulated, block),
    }
    record["bytes"] = base64.b64encode(b"".join(block.parts)).decode("ascii")
    return record


def _describe(scene: ViewScene) -> dict[str, Any]:
    """Names, words and colours of a scene."""
    limits = [float(limit) if np.isfinite(limit) and limit > 0 else None for limit in scene.limits]
    shape = "pyramid" if scene.pyramids else "cone"
    return {
        "answer": scene.answer.text,
        "level": scene.answer.level,
        "cautions": [*scene.cautions, *scene.unseen],
        "contacts": [{"name": name, "colour": colour} for name, colour in zip(scene.contacts, scene.colours)],
        "cone_name": f"friction {shape}s",
        "cone_told": f"{shape}s: forces on the object that friction allows",
        "axes": AXES,
        "load_colour": LOAD,
        "load_told": f"black arrow: its weight and {'other loads' if scene.carried is None else 'inertia'}",
        "joints": [
            {"name": name, "slides": bool(slides), "limit": limit}
            for name, slides, limit in zip(scene.joints, scene.sliding, limits)
        ],
        "fingers": list(scene.fingers.items()),
        "finger_colours": finger_colours(scene.contacts, list(scene.fingers)),
    }


def _record_simulation(scene: ViewScene, simulated: Simulated, block: _Bytes) -> dict[str, Any]:
    return {
        **{name: _to_plain(getattr(simulated, name)) for name in ("held", "reason", "parts", "planned", "beside")},
        **{name: block.put(getattr(simulated, field)) for name, field in _SIMULATED.items()},
        "points": [point.tolist() if np.isfinite(point).all() else None for point in simulated.points_b],
        "colours": [scene.colour_of(part) for part in simulated.parts],
        "colour": GHOST,
    }


def _to_plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value
