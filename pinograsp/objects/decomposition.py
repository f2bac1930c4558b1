"""Convex parts of a mesh that is not convex, for programs that know convex shapes alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.checks import read_only
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.objects.mesh_checks import is_convex
from pinograsp.objects.triangles import TriangleSurface
from pinograsp.spatial import Array, IntArray

# Concavity that a part may keep, of the mesh scaled to a cube of side 2; the default of 0.05 fills the gap between a
# mug's handle and its wall to 3 mm, this to 1 mm, which takes twice the parts.
_CONCAVITY = 0.02
_ITERATIONS, _NODES = 60, 10  # of the search for planes that cut; more take longer and save no part of a mug
_SLIVER = 1e-6  # of the whole volume
# A surface that crosses itself is meshed anew by CoACD, at the scale of a voxel, which takes a minute. Where more than
# this part of it bounds something other than a solid, that becomes a shell, and hundreds of parts in as many minutes.
_CROSSED, _SAMPLES = 0.02, 500


class ConvexParts(NamedTuple):
    """Convex parts of a solid.

    Attributes:
        corners: of each part (n, 3) [m].
        excess: by how much they stand out of the solid at most, where it is hollow [m].
    """

    corners: tuple[Array, ...]
    excess: float


def convex_parts(vertices: Array, faces: IntArray, surface: TriangleSurface) -> ConvexParts:
    """Convex parts that together are about the solid, the same ones every time.

    X. Wei et al., Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity and Tree Search, ACM
    Trans. Graph. 41(4), 2022.

    Raises:
        ExtraMissing: coacd (extra ``mesh``) is not installed.
        InvalidInput: no parts were found, or the surface crosses itself.
    """
    import trimesh

    if is_convex(vertices, faces):
        return ConvexParts((read_only(vertices),), 0.0)
    _check_crossing(surface)
    try:
        import coacd
    except ImportError as error:
        raise ExtraMissing(
            "an object that is not convex is cut into convex parts for this, which needs coacd: pip install "
            "'pinograsp[mesh]'"
        ) from error
    coacd.set_log_level("error")
    found = coacd.run_coacd(
        coacd.Mesh(vertices, faces), threshold=_CONCAVITY, mcts_iterations=_ITERATIONS, mcts_nodes=_NODES, seed=0
    )
    hulls = [trimesh.convex.convex_hull(corners) for corners, _ in found]
    whole = sum(hull.volume for hull in hulls)
    parts = [hull for hull in hulls if hull.volume > _SLIVER * whole]
    if not parts:
        raise InvalidInput("mesh: no convex parts were found: use its convex hull (convex=True)")
    excess = max(float(surface.nearest(_spread(part.triangles))[2].max()) for part in parts)
    return ConvexParts(tuple(read_only(np.array(part.vertices)) for part in parts), max(excess, 0.0))


def _check_crossing(surface: TriangleSurface) -> None:
    """Refuse a surface that, over much of its area, does not have the solid once on its inner side."""
    areas = np.cumsum(surface.areas)
    faces = np.searchsorted(areas, areas[-1] * (np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    inside = surface.corners[faces].mean(axis=1)
    inside = inside - 1e-4 * np.sqrt(surface.areas[faces])[:, None] * surface.normals[faces]
    wrong = float(np.mean(np.abs(surface.winding_number(inside) - 1) > 0.5))
    if wrong > _CROSSED:
        raise InvalidInput(
            f"mesh: expected a surface that does not cross itself, got one that does, over {100 * wrong:.2g} % of its "
            "area, so that no convex parts are found: repair it (MeshLab, Blender), or use its convex hull: convex=True"
        )


def _spread(triangles: Array) -> Array:
    """Middles of triangles and of their sides (k, 3): what stands out over a hollow does so there."""
    sides = (triangles + np.roll(triangles, 1, axis=1)) / 2
    return np.concatenate([sides.reshape(-1, 3), triangles.mean(axis=1)])
