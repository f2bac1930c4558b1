"""What certified rows were computed from: contents, so that each change is noticed, and a move or a copy is none."""

from __future__ import annotations

import contextlib
import hashlib
import io
import pickle
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.errors import PinograspError
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.hands.file_reads import ABSENT, digest_of, noting_files
from pinograsp.hands.mesh_file import pack_shapes
from pinograsp.objects import load_object
from pinograsp.objects.lookup import MESHES, find_object
from pinograsp.sweep.certified_table import RowSource

# Where a hand comes from, what it is called, and how it looks: no certificate depends on it.
_BESIDE_THE_POINT = ("name", "source", "notes", "description", "visuals")


class Inputs:
    """The contents of files of grasps and of their objects; each object is looked at once.

    Args:
        objects: as of a :class:`~pinograsp.sweep.DataSet`.
    """

    def __init__(self, objects: Path):
        self._objects = objects
        self._known: dict[str, str] = {}

    def source(self, file: Path, object_name: str | None) -> RowSource:
        """A file of grasps and its object as they are now."""
        if object_name is not None and object_name not in self._known:
            contents = "\n".join(self._contents(object_name))
            self._known[object_name] = hashlib.sha256(contents.encode()).hexdigest()
        of_object = "" if object_name is None else self._known[object_name]
        return RowSource(str(file), object_name, _digest(file), of_object)

    def _contents(self, name: str) -> list[str]:
        try:
            files = find_object(self._objects, name)
        except PinograspError:
            return ["no object"]
        if files[0].suffix.lower() in MESHES:
            return [f"{one.suffix.lower()} {_digest(one)}" for one in files]
        with noting_files() as read, contextlib.suppress(PinograspError):
            load_object(files[0], mass=1.0)  # of a URDF, SDF or MJCF file: with the meshes that it names
        return sorted(read.values())


def _digest(file: Path) -> str:
    try:
        return digest_of(file)
    except (OSError, ValueError):
        return ABSENT


def settings_of_hand(hand: HandModel) -> dict[str, str]:
    """Digests of all of a hand that certificates depend on, by its attributes."""
    shapes = [one.geometry for one in hand.geometry.geometryObjects]
    for shape in [*shapes, *hand.own_shapes]:
        shape.computeLocalAABB()  # which coal writes down once it is known
    geometry = [
        (one.name, one.parentJoint, one.placement.homogeneous, shape)
        for one, shape in zip(hand.geometry.geometryObjects, pack_shapes(shapes))
    ]
    values = {one.name: getattr(hand, one.name) for one in fields(hand) if one.name not in _BESIDE_THE_POINT}
    values |= {"geometry": geometry, "own_shapes": pack_shapes(hand.own_shapes), "couplings": dict(hand.couplings)}
    return {name: _digest_value(value) for name, value in values.items()}


def settings_of_conditions(conditions: GraspConditions) -> dict[str, Any]:
    """What holds for all grasps, by its name."""
    return {one.name: plain(getattr(conditions, one.name)) for one in fields(conditions)}


def plain(value: object) -> Any:
    """A value of a setting as JSON has it; records by their digest."""
    if isinstance(value, HandModel):
        return settings_of_hand(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    return value if value is None or isinstance(value, str | bool | int | float) else _digest_value(value)


def _digest_value(value: object) -> str:
    content = io.BytesIO()
    pickler = pickle.Pickler(content, protocol=5)
    pickler.fast = True  # without references: the same values give the same bytes, shared or not
    pickler.dump(value)
    return hashlib.sha256(content.getvalue()).hexdigest()
