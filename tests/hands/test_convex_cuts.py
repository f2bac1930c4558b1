"""Hollow and bent links in convex parts: against the volumes of the solids that they are made of."""

from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from pinograsp.hands import load_hand
from pinograsp.hands.convex_cuts import cut_in_parts
from pinograsp.hands.record import hand_of, hand_record


def union(*boxes):
    """Of boxes given by their lower and upper corners [m]."""
    return trimesh.boolean.union([trimesh.creation.box(bounds=corners) for corners in boxes], engine="manifold")


BENT = union([[0, 0, 0], [0.06, 0.02, 0.01]], [[0, 0, 0], [0.01, 0.02, 0.05]])
FORK = union([[0, 0, 0], [0.06, 0.02, 0.01]], [[0, 0, 0], [0.01, 0.02, 0.05]], [[0.05, 0, 0], [0.06, 0.02, 0.05]])
BOX = trimesh.creation.box(extents=(0.02, 0.03, 0.05))
SHELL = trimesh.boolean.difference([BOX, trimesh.creation.box(extents=(0.016, 0.026, 0.046))], engine="manifold")


def volumes(solid):
    return [ConvexHull(part.reshape(-1, 3)).volume for part in cut_in_parts(np.asarray(solid.triangles))]


@pytest.mark.parametrize("solid", [BENT, FORK], ids=["bent", "fork"])
def test_parts_fill_little_besides_the_solid(solid):
    """Planes are at eighths of a part's sides: 1 cm of 6 is not among them, so that a corner of some mm stays full."""
    hull = solid.convex_hull.volume
    assert hull > 1.4 * solid.volume
    found = volumes(solid)
    assert solid.volume * (1 - 1e-9) <= sum(found) < solid.volume + 0.15 * (hull - solid.volume)
    assert 2 <= len(found) <= 8


def test_hulls_of_parts_have_the_whole_surface_and_nothing_beyond_the_hull():
    bracket = trimesh.boolean.union([FORK, trimesh.creation.icosphere(radius=0.012)], engine="manifold")
    parts = cut_in_parts(np.asarray(bracket.triangles))
    assert len(parts) > 3
    points, _ = trimesh.sample.sample_surface(bracket, 2000, seed=0)
    hulls = [ConvexHull(part.reshape(-1, 3)).equations for part in parts]
    held = [np.all(points @ one[:, :3].T + one[:, 3] < 1e-9, axis=1) for one in hulls]
    assert np.any(held, axis=0).all()
    whole = ConvexHull(bracket.vertices).equations
    assert max((part.reshape(-1, 3) @ whole[:, :3].T + whole[:, 3]).max() for part in parts) < 1e-9


@pytest.mark.parametrize("solid", [BOX, SHELL, BENT.convex_hull], ids=["box", "shell", "hull"])
def test_what_is_as_its_hull_outside_stays_whole(solid):
    assert volumes(solid) == pytest.approx([solid.convex_hull.volume], rel=1e-9)


@pytest.mark.parametrize("solid", [BENT, FORK], ids=["bent", "fork"])
def test_parts_are_the_surface_between_the_planes(solid):
    parts = cut_in_parts(np.asarray(solid.triangles))
    assert sum(trimesh.triangles.area(part).sum() for part in parts) == pytest.approx(solid.area, rel=1e-9)
    middles = np.concatenate([part.mean(axis=1) for part in parts])
    assert trimesh.proximity.closest_point(solid, middles)[1] == pytest.approx(0, abs=1e-9)


HAND = """<robot name="hand"><link name="palm">{inertial}<collision><origin xyz="0 0 -0.02"/><geometry>
    <box size="0.2 0.1 0.02"/></geometry></collision></link>
  <link name="left">{inertial}<collision><geometry><mesh filename="jaw.stl"/></geometry></collision></link>
  <link name="right">{inertial}<collision><geometry><mesh filename="plain.stl"/></geometry></collision></link>
  <joint name="l" type="prismatic"><parent link="palm"/><child link="left"/><origin xyz="-0.07 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.05" effort="10" velocity="1"/></joint>
  <joint name="r" type="prismatic"><parent link="palm"/><child link="right"/><origin xyz="0.07 0 0"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper="0.05" effort="10" velocity="1"/></joint></robot>"""
INERTIAL = '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'


@pytest.fixture
def path(tmp_path):
    FORK.export(tmp_path / "jaw.stl")
    BOX.export(tmp_path / "plain.stl")
    path = tmp_path / "hand.urdf"
    path.write_text(HAND.format(inertial=INERTIAL))
    return path


def inside(hand, point):
    """Whether a shape of the hand's first finger has a point of its link's frame."""
    ball, own, request = coal.Sphere(1e-6), coal.Transform3s.Identity(), coal.DistanceRequest()
    at = coal.Transform3s(np.eye(3), np.array(point))
    shapes = [one.geometry for one in hand.geometry.geometryObjects if one.name.startswith("left")]
    return any(coal.distance(shape, own, ball, at, request, coal.DistanceResult()) < 0 for shape in shapes)


def test_a_hollow_jaw_is_told_and_stays_open_in_its_middle(path):
    hand = load_hand(path)
    (note,) = [note for note in hand.notes if "convex parts" in note]
    assert "left_0 (" in note and "right" not in note
    assert not inside(hand, [0.03, 0.01, 0.04])  # between the fork's ends, which its hull fills
    assert inside(hand, [0.005, 0.01, 0.04]) and inside(hand, [0.055, 0.01, 0.04]) and inside(hand, [0.03, 0.01, 0.005])
    meshes = load_hand(path, hulls=False)
    assert meshes.geometry.ngeoms == 3 and not any("convex parts" in note for note in meshes.notes)
    assert meshes.mass == hand.mass


def test_parts_are_written_down_with_the_hand(path):
    hand = load_hand(path)
    again = hand_of(hand_record(hand))
    assert [one.name for one in again.geometry.geometryObjects] == [one.name for one in hand.geometry.geometryObjects]
    for one, other in zip(hand.geometry.geometryObjects, again.geometry.geometryObjects):
        assert one.geometry.computeVolume() == pytest.approx(other.geometry.computeVolume(), rel=1e-9)
