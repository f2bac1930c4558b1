"""Mass of a mesh as MuJoCo weighs it where a file does not ask for anything else."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from pinograsp.spatial import Array


def counted_mass(mesh: coal.BVHModelBase, density: float) -> pin.Inertia | None:
    """Mass and inertia of the pyramids over a mesh's triangles [kg/m^3], with their top within; None without volume.

    All of them count, also those that face inwards: a mesh that is hollow, or not convex, weighs more than the solid
    that it bounds (MuJoCo's ``inertia="legacy"``, its default).
    """
    vertices = np.array(mesh.vertices())
    triangles = np.array([[t[0], t[1], t[2]] for t in map(mesh.tri_indices, range(mesh.num_tris))])
    corners = vertices[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not (np.isfinite(area).all() and area.sum() > 0):
        return None
    middle = area @ corners.mean(axis=1) / area.sum()
    volumes = _pyramids(corners, middle)
    if not volumes.sum() > 0:
        return None
    centre = volumes @ (corners.sum(axis=1) + middle) / 4 / volumes.sum()
    volumes, arms = _pyramids(corners, centre), corners - centre
    # Second moments of a tetrahedron with one corner at the centre.
    ends = np.concatenate([arms, arms.sum(axis=1, keepdims=True)], axis=1)
    second = np.einsum("t,tci,tcj->ij", volumes, ends, ends) / 20
    inertia = density * (np.trace(second) * np.eye(3) - second)
    moments = np.linalg.eigvalsh(inertia)
    if not (np.isfinite(moments).all() and moments[0] > 0):
        return None
    return pin.Inertia(float(density * volumes.sum()), centre, inertia)


def _pyramids(corners: Array, top: Array) -> Array:
    """Volumes (t,) over triangles (t, 3, 3)."""
    a, b, c = np.moveaxis(corners - top, 1, 0)
    volumes: Array = np.abs(np.einsum("ti,ti->t", np.cross(a, b), c)) / 6
    return volumes
