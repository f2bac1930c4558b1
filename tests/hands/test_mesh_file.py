"""Mesh files that lie, of hands and of objects: refused before compiled code sees them."""

from __future__ import annotations

import json
import os
import struct

import numpy as np
import pytest
import trimesh
from own_hands import joint, link, robot

from pinograsp.errors import InvalidInput
from pinograsp.hands import geometry, load_hand
from pinograsp.objects import Mesh

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
0.1 0 0
0 0.1 0
{last}
3 0 2 1
3 0 1 3
3 0 3 2
3 {face}
"""
OBJ = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv {last}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf {face}\n"
OFF = "OFF\n4 4 0\n0 0 0\n0.1 0 0\n0 0.1 0\n{last}\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 {face}\n"
SOUND = "0 0 0.1"


def glb(**changes) -> bytes:
    """A tetrahedron as GLB with parts of its JSON replaced."""
    content = trimesh.creation.icosahedron().export(file_type="glb")
    (length,) = struct.unpack_from("<I", content, 12)
    scene = {**json.loads(content[20 : 20 + length]), **changes}
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


LYING = {
    "index.ply": PLY.format(last=SOUND, face="1 2 9999999"),
    "negative.ply": PLY.format(last=SOUND, face="1 2 -1"),
    "nan.ply": PLY.format(last="0 0 nan", face="1 2 3"),
    "count.ply": PLY.format(last=SOUND, face="1 2 3").replace("vertex 4", "vertex 400000000000"),
    "index.obj": OBJ.format(last=SOUND, face="2 3 99999"),
    "nan.obj": OBJ.format(last="nan 0 0", face="2 3 4"),
    "index.off": OFF.format(last=SOUND, face="1 2 99999"),
    "inf.off": OFF.format(last="0 0 inf", face="1 2 3"),
    "far.off": OFF.format(last="0 0 6e12", face="1 2 3"),
    "huge.off": OFF.format(last="0 0 1e308", face="1 2 3"),
    "point.obj": "v 0.1 0.1 0.1\n" * 3 + "f 1 2 3\n",
    "nothing.stl": "",
    "short.stl": b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 50,
    "accessor.glb": glb(accessors=[{"componentType": 5126, "count": 10**12, "type": "VEC3"}] * 2),
    "branching.glb": glb(nodes=[*({"children": [i + 1, i + 1]} for i in range(60)), {"mesh": 0}]),
    "repeated.glb": glb(nodes=[{"mesh": 0}] * 300_000),
    "deep.glb": glb(nodes=[*({"children": [i + 1], "mesh": 0} for i in range(300)), {"mesh": 0}]),
    "nodes.glb": glb(nodes=[{"mesh": 0}] * 6000),
    "solids.stl": "solid a\nendsolid a\n" * 6000,
    "entities.dae": '<!DOCTYPE COLLADA [<!ENTITY a "b">]><COLLADA>&a;</COLLADA>',
    "empty.dae": "<COLLADA/>",
}


@pytest.mark.parametrize("name", LYING)
def test_meshes_that_lie_are_refused(tmp_path, name):
    content = LYING[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidInput, match="expected|more than 1000 m"):
        Mesh.load(tmp_path / name, mass=0.1)
    hand = load_hand(hand_with(tmp_path, name))
    assert not hand.geometry.ngeoms and any("cannot be read" in note and name in note for note in hand.notes)


def test_groups_of_an_obj_file_are_bounded(tmp_path):
    """Its reader takes time as their number squared; where they are left out anyway, as of objects, they are fine."""
    text = OBJ.format(last=SOUND, face="2 3 4")
    (tmp_path / "groups.obj").write_text(text + "g a\n" * 6000)
    (note,) = (note for note in load_hand(hand_with(tmp_path, "groups.obj")).notes if "cannot be read" in note)
    assert "6000 groups, more than the 3000" in note
    assert Mesh.load(tmp_path / "groups.obj", mass=0.1).volume == pytest.approx(1e-3 / 6)


def test_a_hand_reads_a_bounded_number_of_triangles_and_no_broken_file_twice(tmp_path, monkeypatch):
    trimesh.creation.icosphere(2).export(tmp_path / "ball.stl")  # 320 triangles
    (tmp_path / "broken.stl").write_text("nothing")
    read = []
    whole = geometry.read_triangles
    monkeypatch.setattr(geometry, "MOST_TRIANGLES", 700)
    monkeypatch.setattr(geometry, "read_triangles", lambda path: read.append(path.name) or whole(path))
    names = [("broken.stl", 1), ("broken.stl", 2), *(("ball.stl", 1 + k % 4) for k in range(8))]
    path = hand_with(tmp_path, "broken.stl")
    one = path.read_text()
    shape = one[one.index("<collision>") : one.index("</collision>") + len("</collision>")]
    shapes = (shape.replace('broken.stl"', f'{name}" scale="{scale} 1 1"') for name, scale in names)
    path.write_text(one.replace(shape, "".join(shapes)))
    hand = load_hand(path)
    assert read == ["broken.stl", "ball.stl"]
    assert hand.geometry.ngeoms == 6  # those of three sizes, with 960 triangles, twice each
    (note,) = (note for note in hand.notes if "cannot be read" in note)
    assert note.count("the meshes before it have more than 700 triangles") == 2


def hand_with(folder, mesh):
    """A hand of one joint whose palm has that mesh."""
    palm = f'<link name="palm"><collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
    finger = link("finger", 0.1, "box 1 1 1").split("<collision>")[0] + "</link>"
    (folder / "hand.urdf").write_text(
        robot("meshed", palm, finger, joint("j", "palm", "finger", "0 0 0", "0 1 0", "-1 1 1 1"))
    )
    return folder / "hand.urdf"


@pytest.mark.parametrize("name", ["sound.ply", "sound.obj", "sound.off", "sound.glb", "sound.stl"])
def test_sound_meshes_are_read_alike(tmp_path, name):
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / name)
    assert Mesh.load(tmp_path / name, mass=0.1).volume == pytest.approx(6e-3, rel=1e-6)
    (shape,) = load_hand(hand_with(tmp_path, name), hulls=False).geometry.geometryObjects
    assert (shape.geometry.num_vertices, shape.geometry.num_tris) == (8, 12)
    assert np.ptp(shape.geometry.vertices(), axis=0) == pytest.approx([0.1, 0.2, 0.3], rel=1e-6)


def test_pipes_devices_and_folders_are_no_meshes(tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    (tmp_path / "folder.stl").mkdir()
    for name in ("pipe.stl", "zero.stl", "folder.stl"):
        with pytest.raises(InvalidInput, match="existing file|none in the folder"):
            Mesh.load(tmp_path / name, mass=0.1)
        hand = load_hand(hand_with(tmp_path, name))
        assert any("meshes not found" in note for note in hand.notes)


def test_files_named_by_a_mesh_are_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.mtl")  # a reader would wait for it without end
    text = "mtllib pipe.mtl\nusemtl m\n" + OBJ.format(last=SOUND, face="2 3 4")
    (tmp_path / "mesh.obj").write_text(text)
    assert Mesh.load(tmp_path / "mesh.obj", mass=0.1).volume == pytest.approx(1e-3 / 6)
    assert load_hand(hand_with(tmp_path, "mesh.obj")).geometry.ngeoms == 1
