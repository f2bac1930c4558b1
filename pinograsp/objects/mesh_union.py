"""Solids that meet, as convex decompositions have them, made one solid."""

from __future__ import annotations

import numpy as np

from pinograsp.objects.mesh_checks import part_labels
from pinograsp.spatial import Array, IntArray


def parts_of(faces: IntArray) -> list[IntArray]:
    """Faces of each part of a mesh: triangles that share corners by their numbers."""
    of = part_labels(int(faces.max()) + 1, faces)[faces[:, 0]]
    return [faces[of == part] for part in np.unique(of)]


def united(vertices: Array, parts: list[IntArray]) -> tuple[Array, IntArray]:
    """Vertices and faces of the union of closed parts, each turned outwards.

    Raises:
        ImportError: manifold3d (extra ``mesh``) is not installed.
        ValueError: a part that is not closed.
    """
    import manifold3d
    import trimesh

    solids = []
    for number, faces in enumerate(parts, 1):
        part = trimesh.Trimesh(vertices, faces, process=True)
        if part.volume < 0:
            part.invert()
        mesh = manifold3d.Mesh64(np.array(part.vertices, dtype=float), np.array(part.faces, dtype=np.uint64))
        solid = manifold3d.Manifold(mesh)
        if solid.status() != manifold3d.Error.NoError:
            raise ValueError(f"part {number} of {len(parts)} is not closed ({solid.status().name})")
        solids.append(solid)
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).to_mesh64()
    return np.array(whole.vert_properties[:, :3], dtype=float), np.array(whole.tri_verts, dtype=np.int64)
