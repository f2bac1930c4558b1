"""Collision geometry of a hand: primitives, meshes, and exact ellipsoids where a URDF scales the unit sphere."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import coal
import numpy as np
import pinocchio as pin

_UNIT_SPHERE = "unit_sphere.stl"
_DENSITY = 1000.0  # [kg/m^3] of links without mass: most of a hand is lighter than its hull, so this is on the heavy side


def collision_geometry(model: pin.Model, text: str, notes: list[str]) -> pin.GeometryModel:
    """The collision geometry of prepared URDF text (mesh files absolute); files that cannot be read are left out and noted.

    URDF has no ellipsoid. A mesh called ``unit_sphere.stl`` with a scale stands for one and becomes the exact shape.
    """
    robot = ElementTree.fromstring(text)
    broken = []
    for link in robot.findall("link"):
        for element in link.findall("collision"):
            mesh = element.find("geometry/mesh")
            if mesh is not None and not mesh.get("filename").endswith(_UNIT_SPHERE) and not _readable(mesh.get("filename")):
                link.remove(element)
                broken.append(f"{link.get('name')} ({mesh.get('filename')})")
    if broken:
        notes.append(f"meshes that cannot be read, so these links cannot touch anything: {', '.join(broken)}")
    geometry = pin.buildGeomFromUrdfString(
        model, ElementTree.tostring(robot, encoding="unicode"), pin.GeometryType.COLLISION
    )
    for one in geometry.geometryObjects:
        if one.meshPath.endswith(_UNIT_SPHERE):
            one.geometry = coal.Ellipsoid(np.abs(one.meshScale).astype(float))
            one.meshPath, one.meshScale = "", np.ones(3)
    return geometry


def _readable(path: str) -> bool:
    try:
        return coal.MeshLoader().load(path, np.ones(3)).num_vertices > 0
    except (ValueError, RuntimeError):
        return False


def fill_masses(model: pin.Model, geometry: pin.GeometryModel, notes: list[str]) -> None:
    """Give moving links that have no mass, nor any link beyond them, the mass of their collision geometry; noted."""
    filled = []
    for j in range(1, model.njoints):
        subtree = [i for i in range(1, model.njoints) if j in model.supports[i]]
        if sum(model.inertias[i].mass for i in subtree) > 0:
            continue
        for i in subtree:
            for one in geometry.geometryObjects:
                if one.parentJoint == i and (volume := abs(one.geometry.computeVolume())) > 0:
                    inertia = _DENSITY * np.array(one.geometry.computeMomentofInertiaRelatedToCOM())
                    own = pin.Inertia(_DENSITY * volume, np.array(one.geometry.computeCOM()).ravel(), inertia)
                    model.inertias[i] = model.inertias[i] + one.placement.act(own)
            if model.inertias[i].mass > 0:
                filled.append(f"{model.names[i]} {1e3 * model.inertias[i].mass:.1f} g")
    if filled:
        notes.append(f"no masses given, taken from the geometry at {_DENSITY:g} kg/m^3: {', '.join(filled)}")
