"""GraspNet-1Billion: an .npz file of labels of an object, on a grid of points, views, angles and depths.

Layout and frames as of ``graspnetAPI/graspnet.py``, ``utils/utils.py`` and ``utils/rotation.py`` of
graspnet/graspnetAPI: ``points`` (P, 3) [m], ``offsets`` (P, 300, 12, 4, 3) = angle in the plane [rad], depth [m],
width [m], ``scores`` (P, 300, 12, 4), the least coefficient of friction (-1: none), ``collision`` (P, 300, 12, 4).
The gripper's x approaches, y closes, its origin is the point, and the fingertips' ends are ``depth`` farther along x.
"""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Iterator
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import one_line
from pinograsp.data.files import File, header_of
from pinograsp.data.format import Format, Payload
from pinograsp.data.rotations import placements
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.errors import GraspsNotRead, InvalidInput
from pinograsp.spatial import Array

GRID = (300, 12, 4)  # views, angles, depths
_MOST_POINTS = 100_000
_CHUNK = 8  # points that are unpacked at once: 1.4 MB of numbers in 32 bits


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file, some points at a time: all of the grid, or those that hold at some friction."""
    try:
        with contextlib.ExitStack() as stack:
            archive = stack.enter_context(zipfile.ZipFile(file.path))
            yield from _Labels(archive, stack, file).drafts(file.keep)
    except GraspsNotRead:
        raise
    except Exception as error:  # zipfile, zlib and NumPy raise whatever comes of a broken file
        text = f"graspnet: the archive is broken or cut off ({one_line(error)})"
        raise GraspsNotRead(file.source, text) from error


class _Labels:
    """An open archive: its arrays from their beginnings."""

    def __init__(self, archive: zipfile.ZipFile, stack: contextlib.ExitStack, file: File):
        self.file = file
        self.streams: dict[str, tuple[IO[bytes], np.dtype[Any]]] = {}
        shapes = {}
        for name in ("points", "offsets", "scores", "collision"):
            if f"{name}.npy" not in archive.namelist():
                if name == "collision":
                    continue
                there = ", ".join(archive.namelist()[:8])
                raise self.refusal(f"expected arrays points, offsets and scores, got {there or 'none'}")
            stream = stack.enter_context(archive.open(f"{name}.npy"))
            shapes[name], dtype = self._header(name, stream)
            self.streams[name] = stream, dtype
        self.count = shapes["points"][0] if shapes["points"] else 0
        wanted = {
            "points": (self.count, 3),
            "offsets": (self.count, *GRID, 3),
            "scores": (self.count, *GRID),
            "collision": (self.count, *GRID),
        }
        for name, shape in shapes.items():
            if shape != wanted[name] or self.count > _MOST_POINTS:
                raise self.refusal(f"'{name}': expected the shape {wanted[name]}, got {shape}")

    def refusal(self, problem: str) -> GraspsNotRead:
        return GraspsNotRead(self.file.source, f"graspnet: {problem}")

    def _header(self, name: str, stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
        shape, fortran, dtype = header_of(stream, np.lib.format.read_magic(stream))
        if dtype.kind not in "fiub" or fortran:
            raise self.refusal(f"'{name}': expected numbers, row by row, got {dtype}")
        return shape, dtype

    def _next(self, name: str, points: int) -> NDArray[Any]:
        stream, dtype = self.streams[name]
        inner = {"points": (3,), "offsets": (*GRID, 3)}.get(name, GRID)
        size = points * int(np.prod(inner)) * dtype.itemsize
        raw = stream.read(size)
        if len(raw) != size:
            raise self.refusal(f"'{name}' is cut off")
        return np.frombuffer(raw, dtype=dtype).reshape(points, *inner)

    def drafts(self, keep: str) -> Iterator[Draft]:
        for begin in range(0, self.count, _CHUNK):
            points = min(_CHUNK, self.count - begin)
            parts = {name: self._next(name, points) for name in self.streams}
            hit = parts.get("collision", np.zeros((points, *GRID), dtype=bool)) != 0
            wanted = np.ones(hit.shape, dtype=bool) if keep == "all" else (parts["scores"] > 0) & ~hit
            at = np.nonzero(wanted)
            if len(at[0]):
                yield self._draft(parts, hit, at, begin)

    def _draft(
        self, parts: dict[str, NDArray[Any]], hit: NDArray[np.bool_], at: tuple[NDArray[np.intp], ...], begin: int
    ) -> Draft:
        offsets = np.asarray(parts["offsets"][at], dtype=float)
        count = len(offsets)
        return Draft(
            poses=gripper_poses(np.asarray(parts["points"], dtype=float)[at[0]], at[1], offsets[:, 0]),
            q=np.zeros((count, 0)),
            scale=np.ones(count),
            object_name=self.file.path.stem.removesuffix("_labels"),
            widths=offsets[:, 2],
            labels={
                "least_friction": np.asarray(parts["scores"][at], dtype=float),
                "depth": offsets[:, 1],
                "collision": hit[at],
                "point": at[0] + begin,
                **dict(zip(("view", "angle_index", "depth_index"), at[1:])),
            },
        )


def write(rows: GraspRows, payload: Payload) -> bytes:
    """Refused."""
    raise InvalidInput(
        "format: GraspNet's labels are a grid of all points, views, angles and depths, which single grasps do not "
        "fill: write graspgen, acronym or isaac"
    )


def gripper_poses(points: Array, views: NDArray[np.intp], angles: Array) -> Array:
    """Placements (N, 4, 4) of the gripper from points (N, 3) [m], indices of views (N,), angles (N,) [rad].

    x approaches against the view's direction, y is horizontal and closes; both are turned about x by the angle.
    """
    x = -directions()[views]
    flat = np.stack([-x[:, 1], x[:, 0], np.zeros(len(x))], axis=1)
    flat[np.linalg.norm(flat, axis=1) == 0] = [0.0, 1.0, 0.0]
    y = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    z = np.cross(x, y)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return placements(points, np.stack([x, c * y + s * z, c * z - s * y], axis=2))


def directions() -> Array:
    """The 300 views: unit vectors (300, 3) on a Fibonacci lattice, in 32 bits as the labels were made with."""
    one = np.float32
    index = np.arange(GRID[0], dtype=one)
    ratio = one((np.sqrt(5) - 1) / 2)
    z = (one(2) * index + one(1)) / one(GRID[0]) - one(1)
    turn = one(2) * index * one(np.pi) * ratio
    ring = np.sqrt(one(1) - z**2)
    lattice = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1).astype(float)
    unit: Array = lattice / np.linalg.norm(lattice, axis=1, keepdims=True)
    return unit


FORMAT = Format(
    name="graspnet",
    container="a ZIP archive",
    sniff=lambda file: bool({"offsets.npy", "scores.npy"} & set(file.members)),
    read=read,
    write=write,
    keys=(),
    scales=True,
    ask="palm_in_root= for the frame between the fingertips' ends (x approaches, y closes)",
    reach="depth",
)
