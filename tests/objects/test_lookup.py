"""Objects that data sets name are found; parts that are convex stay as they are."""

import numpy as np
import pytest
import trimesh

from pinograsp.errors import InvalidInput
from pinograsp.objects import Box, Mesh
from pinograsp.objects.lookup import find_object, object_in
from pinograsp.objects.mesh_union import convex_pieces


def write(folder, name, *parts):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.util.concatenate(parts).export(path)
    return path


def box(*size, at=(0.0, 0.0, 0.0)):
    made = trimesh.creation.box(size)
    made.apply_translation(at)
    return made


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("mug.obj", "mug"),
        ("mug.obj", "mug.obj"),
        ("mug.stl", "meshes/Mug/mug.stl"),
        ("Mug/mug.ply", "meshes/Mug/mug.ply"),
        ("mug.obj", "/data/objects/mug.obj"),
        ("mug/coacd/decomposed.obj", "mug"),
        ("core-mug-1/mesh/simplified.obj", "core-mug-1"),
        ("mug.obj", "C:\\data\\mug.obj"),
        ("mug.stl", "mug.obj"),
    ],
)
def test_names_of_data_sets_are_found(tmp_path, file, name):
    path = write(tmp_path, file, box(0.02, 0.03, 0.04))
    assert find_object(tmp_path, name) == [path]
    body = object_in(tmp_path, name, scale=2.0, density=100.0)
    assert body.mass == pytest.approx(8 * 0.02 * 0.03 * 0.04 * 100)


def test_parts_in_files_are_one_object(tmp_path):
    pytest.importorskip("manifold3d")
    for i in range(3):
        write(tmp_path, f"can/urdf/meshes/convex_piece_{i}.obj", box(0.02, 0.02, 0.02, at=(0.015 * i, 0, 0)))
    assert len(find_object(tmp_path, "can")) == 3
    body = object_in(tmp_path, "can", mass=0.1)
    assert isinstance(body, Mesh) and len(body.convex_parts.corners) == 3 and body.convex_parts.excess == 0.0


def test_the_files_frame_is_the_worlds_and_a_description_keeps_its_own(tmp_path):
    write(tmp_path, "off.stl", box(0.02, 0.02, 0.02, at=(0.1, 0.2, 0.3)))
    body = object_in(tmp_path, "off", mass=0.1)
    assert np.allclose(body.com_o, [0.1, 0.2, 0.3]) and np.allclose(body.pose[:3, :3], np.eye(3))
    (tmp_path / "cube.urdf").write_text(
        "<robot name='c'><link name='l'><inertial><mass value='0.2'/><inertia ixx='1e-4' iyy='1e-4' izz='1e-4' ixy='0' "
        "ixz='0' iyz='0'/></inertial><collision><geometry><box size='0.1 0.1 0.1'/></geometry></collision></link></robot>"
    )
    assert isinstance(object_in(tmp_path, "cube", mass=0.2), Box)
    with pytest.raises(InvalidInput, match="expected a mesh, since the grasps are of one enlarged 2 times"):
        object_in(tmp_path, "cube", scale=2.0, mass=0.2)


@pytest.mark.parametrize("name", ["../secret", "nothing", "..", "deep/er/nothing.obj"])
def test_what_is_not_there_is_named_and_nothing_above_is_read(tmp_path, name):
    folder = tmp_path / "objects"
    folder.mkdir()
    write(tmp_path, "secret.obj", box(0.01, 0.01, 0.01))
    with pytest.raises(InvalidInput, match="expected a mesh, or a folder with one"):
        find_object(folder, name)
    with pytest.raises(InvalidInput, match="expected a folder, or the file of one object"):
        find_object(tmp_path / "gone", name)
    assert find_object(tmp_path / "secret.obj", name) == [tmp_path / "secret.obj"]  # the one object of all grasps


def test_a_file_of_convex_parts_keeps_them_and_one_with_a_hollow_part_does_not(tmp_path):
    pytest.importorskip("manifold3d")
    two = Mesh.load(
        write(tmp_path, "two.obj", box(0.02, 0.02, 0.05), box(0.05, 0.02, 0.02, at=(0.02, 0, 0.02))), density=300.0
    )
    corners = two.convex_parts.corners
    assert sorted(len(one) for one in corners) == [8, 8] and two.convex_parts.excess == 0.0
    # Each part's corners are on or in the solid, in the same frame.
    _, _, distance = two.project(np.concatenate(corners) @ two.pose[:3, :3].T + two.com_o)
    assert distance.max() < 1e-9
    ring, block = trimesh.creation.annulus(0.02, 0.03, 0.02), box(0.02, 0.02, 0.05, at=(0.035, 0, 0))
    assert convex_pieces([(one.vertices, one.faces) for one in (ring, block)]) is None
