"""Named parts of objects: from groups of meshes, names of shapes, and records."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pinograsp.errors import InvalidInput
from pinograsp.objects import Box, Mesh, object_from
from pinograsp.objects.load import load_object
from pinograsp.objects.record import object_of, object_record

URDF = """<robot name="jar"><link name="jar">
<inertial><mass value="0.2"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
<collision name="wall"><geometry><box size="0.06 0.06 0.1"/></geometry></collision>
<collision name="lid"><origin xyz="0 0 0.055"/><geometry><box size="0.07 0.07 0.02"/></geometry></collision>
</link></robot>"""
MJCF = """<mujoco><worldbody><body name="jar"><freejoint/>
<geom name="wall" type="box" size="0.03 0.03 0.05"/>
<geom name="lid" type="box" size="0.035 0.035 0.01" pos="0 0 0.055"/></body></worldbody></mujoco>"""


def write_obj(path, word):
    """A block with a smaller one on it, one solid; faces above the step are the lid."""
    block = trimesh.creation.box((0.06, 0.06, 0.1))
    lines = [f"v {x} {y} {z}" for x, y, z in 1e3 * block.vertices]
    top = block.triangles_center[:, 2] > 0.049
    for name, which in (("lid", top), ("wall", ~top)):
        lines += [f"{word} {name}", *("f " + " ".join(f"{i + 1}/1/1" for i in face) for face in block.faces[which])]
    path.write_text("\n".join(["vt 0 0", "vn 0 0 1", *lines]), encoding="utf-8")


@pytest.mark.parametrize("word", ["o", "g"])
def test_groups_of_an_obj_file_are_parts(tmp_path, word):
    write_obj(tmp_path / "jar.obj", word)
    body = object_from(f"mesh:path={tmp_path / 'jar.obj'},scale=0.001,mass=0.2")
    assert set(body.regions) == {"lid", "wall"}
    assert np.allclose(body.regions["lid"], [[-0.03, -0.03, 0.05], [0.03, 0.03, 0.05]], atol=1e-8)
    assert np.allclose(body.regions["wall"], [[-0.03, -0.03, -0.05], [0.03, 0.03, 0.05]], atol=1e-8)


def test_a_file_of_one_part_has_none(tmp_path):
    trimesh.creation.box((0.05, 0.05, 0.05)).export(tmp_path / "box.obj")
    assert Mesh.load(tmp_path / "box.obj", mass=0.1).regions == {}
    trimesh.creation.box((0.05, 0.05, 0.05)).export(tmp_path / "box.stl")
    assert Mesh.load(tmp_path / "box.stl", mass=0.1).regions == {}


def test_nodes_of_a_scene_are_parts(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((0.06, 0.06, 0.1)), node_name="wall")
    lid = trimesh.creation.box((0.07, 0.07, 0.02))
    scene.add_geometry(lid, node_name="lid", transform=trimesh.transformations.translation_matrix([0, 0, 0.055]))
    scene.export(tmp_path / "jar.glb")
    body = Mesh.load(tmp_path / "jar.glb", mass=0.2, convex=True)
    assert np.allclose(body.regions["lid"], [[-0.035, -0.035, 0.045], [0.035, 0.035, 0.065]], atol=1e-6)


@pytest.mark.parametrize(("text", "name"), [(URDF, "jar.urdf"), (MJCF, "jar.xml")])
def test_names_of_shapes_in_a_file_are_parts(tmp_path, text, name):
    (tmp_path / name).write_text(text, encoding="utf-8")
    body = load_object(tmp_path / name)
    assert np.allclose(body.regions["wall"], [[-0.03, -0.03, -0.05], [0.03, 0.03, 0.05]], atol=1e-8)
    assert np.allclose(body.regions["lid"], [[-0.035, -0.035, 0.045], [0.035, 0.035, 0.065]], atol=1e-8)


def test_records_and_copies_keep_them():
    regions = {"top": [[-1, -1, 0], [1, 1, 1]]}
    body = Box(size=(0.1, 0.1, 0.1), mass=1, regions=regions)
    for other in (object_of(object_record(body)), body.placed(np.eye(4)), body.moved((0, 0, 1), np.eye(3))):
        assert np.array_equal(other.regions["top"], regions["top"])


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ({"top": [[0, 0, 0], [1, 1, 0]]}, "region 'top': expected lower corner < upper corner"),
        ({"top": [0, 0, 0]}, r"region 'top': expected shape \(2, 3\)"),
        ([1], "regions"),
    ],
)
def test_parts_that_cannot_be(regions, message):
    with pytest.raises(InvalidInput, match=message):
        Box(size=(0.1, 0.1, 0.1), mass=1, regions=regions)
