"""What is seen of a hand: as other readers find it in the file, with its colours, in few enough triangles."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from marks import slow_except
from PIL import Image
from shipped_hands import SOME_HANDS, loaded

from pinograsp.errors import InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.hands.visuals import mean_colour, mesh_of, meshes_of, share, simplify


def described(name: str) -> list[tuple]:
    """Link, placement, mesh name or size, and colour of every <visual>, as yourdfpy reads them."""
    logging.getLogger("yourdfpy").setLevel(logging.ERROR)
    robot = yourdfpy.URDF.load(str(file_of(name)), load_meshes=False, build_scene_graph=False).robot
    painted = [visual.material for link in robot.links for visual in link.visuals if visual.material is not None]
    colours = {one.name: one.color for one in [*painted, *robot.materials] if one.color is not None}
    rows = []
    for link in robot.links:
        for visual in link.visuals:
            geometry, material = visual.geometry, visual.material
            colour = None if material is None else material.color or colours.get(material.name)
            if geometry.mesh is not None:
                what = Path(geometry.mesh.filename).name
            else:
                what = next(one for one in (geometry.box, geometry.sphere, geometry.cylinder) if one is not None)
            origin = np.eye(4) if visual.origin is None else visual.origin
            rows.append((link.name, origin, what, None if colour is None else np.array(colour.rgba)))
    return rows


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name != "humanoid"])
def test_hands_are_seen_as_their_files_say(name):
    hand = loaded(name)
    links = {frame.name for frame in hand.model.frames}
    wanted = [row for row in described(name) if row[0] in links and not (row[3] is not None and row[3][3] <= 0)]
    assert hand.visuals and len(hand.visuals) == len(wanted)
    for shape, (link, origin, what, rgba) in zip(
        sorted(hand.visuals, key=lambda one: one.link), sorted(wanted, key=lambda row: row[0])
    ):
        assert shape.link == link
        assert np.allclose(shape.placement.homogeneous, origin, atol=1e-9)
        if shape.kind == "mesh":
            assert Path(shape.path).name == what
        if rgba is None:
            assert shape.colour == ""
        else:
            given = [int(shape.colour[i : i + 2], 16) for i in (1, 3, 5)]
            assert np.allclose(given, 255 * np.clip(rgba[:3], 0, 1), atol=0.51)


def test_a_hand_of_ellipsoids_is_seen_as_they_are():
    hand = load_hand("humanoid")
    assert len(hand.visuals) == 19 and {one.kind for one in hand.visuals} == {"ellipsoid"}


@pytest.mark.parametrize("name", slow_except(CATALOGUE, *SOME_HANDS))
def test_all_meshes_of_the_catalogue_are_read(name):
    visuals = loaded(name).visuals
    meshes, problems = meshes_of(visuals, 60_000)
    assert not problems
    shown = [meshes[mesh_of(one)] for one in visuals if one.kind == "mesh"]
    assert sum(len(faces) for mesh in shown for _, _, faces in mesh) <= 60_000
    for one in (one for one in visuals if one.kind == "mesh"):
        whole = trimesh.load(one.path, force="mesh", process=False)
        points = np.concatenate([vertices for _, vertices, _ in meshes[mesh_of(one)]])
        corners = np.array([points.min(axis=0), points.max(axis=0)])
        assert np.abs(corners - whole.bounds).max() < 0.02 * np.ptp(whole.bounds, axis=0).max()


# -- files made here ---------------------------------------------------------------------------------------------------

URDF = """<robot name="claw"><material name="steel"><color rgba="0.2 0.4 0.6 1"/></material>
<link name="palm"><visual><geometry><mesh filename="{mesh}"/></geometry><material name="steel"/></visual>
  <collision><geometry><box size="0.1 0.1 0.02"/></geometry></collision></link>
<link name="tip"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><origin xyz="0 0 0.02" rpy="0 0 nonsense"/><geometry><box size="1 1 1"/></geometry></visual>
  <visual><geometry><box size="0 1 1"/></geometry></visual>
  <visual><geometry><sphere radius="0.01"/></geometry><material name="gone"><color rgba="1 0 0 0"/></material></visual>
  <visual><origin xyz="0 0 0.02"/><geometry><sphere radius="0.01"/></geometry></visual>
  <collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="bend" type="revolute"><parent link="palm"/><child link="tip"/><axis xyz="0 1 0"/>
  <limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def claw(folder: Path, mesh: str = "palm.stl"):
    (folder / "claw.urdf").write_text(URDF.format(mesh=mesh))
    return load_hand(folder / "claw.urdf")


def test_what_cannot_be_seen_or_read_is_left_out(tmp_path):
    trimesh.creation.box((0.1, 0.1, 0.02)).export(tmp_path / "palm.stl")
    palm, tip = claw(tmp_path).visuals
    assert (palm.kind, palm.path, palm.colour) == ("mesh", str(tmp_path / "palm.stl"), "#336699")
    assert (tip.kind, tip.size, tip.colour, tip.placement.translation[2]) == ("sphere", (0.01,), "", 0.02)


def test_missing_meshes_are_told(tmp_path):
    hand = claw(tmp_path, "package://nowhere/palm.stl")
    assert meshes_of(hand.visuals, 1000) == ({}, ["mesh 'package://nowhere/palm.stl' is not there"])
    (tmp_path / "palm.stl").write_bytes(b"no mesh")
    meshes, (problem,) = meshes_of(claw(tmp_path).visuals, 1000)
    assert meshes == {} and "palm.stl' cannot be read" in problem


def test_records_keep_what_is_seen(tmp_path):
    trimesh.creation.box((0.1, 0.1, 0.02)).export(tmp_path / "palm.stl")
    hand = claw(tmp_path)
    record = hand_record(hand)
    for one, other in zip(hand_of(record).visuals, hand.visuals, strict=True):
        assert (one.link, one.kind, one.size, one.path, one.colour) == (
            other.link,
            other.kind,
            other.size,
            other.path,
            other.colour,
        )
        assert np.array_equal(one.placement.homogeneous, other.placement.homogeneous)
    (tmp_path / "palm.stl").unlink()
    assert len(hand_of(record).visuals) == 2  # pictures tell what is missing
    assert hand_of({key: value for key, value in record.items() if key != "visuals"}).visuals == ()


@pytest.mark.parametrize(
    "change",
    [{"link": "nose"}, {"kind": "cone"}, {"size": [0.1, 0.1]}, {"size": [0.0]}, {"size": [-0.01]}, {"size": [1e9]}, {"colour": "red"},
     {"colour": 3}, {"path": None}, {"placement": 1}],
    ids=str,
)  # fmt: skip
def test_broken_records_are_refused(tmp_path, change):
    trimesh.creation.box((0.1, 0.1, 0.02)).export(tmp_path / "palm.stl")
    record = hand_record(claw(tmp_path))
    record["visuals"][1] |= change
    with pytest.raises(InvalidInput, match=r"hand record: visuals\[1\]"):
        hand_of(record)
    with pytest.raises(InvalidInput, match=r"visuals\[0\]: expected a mapping"):
        hand_of({**record, "visuals": [7]})


def painted_obj(folder: Path, texture: str = "halves.png") -> Path:
    """A square in two triangles on either side of a texture that is red on the left and blue on the right."""
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:, :4], picture[:, 4:] = (255, 0, 0), (0, 0, 255)
    Image.fromarray(picture).save(folder / "halves.png")
    (folder / "square.mtl").write_text(f"newmtl skin\nKd 1 1 1\nmap_Kd {texture}\n")
    path = folder / "square.obj"
    path.write_text(
        "mtllib square.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 0.3 0\nvt 0.3 1\nvt 0.7 0\nvt 1 0\nvt 1 1\n"
        "usemtl skin\nf 1/1 2/2 3/3\nf 1/4 3/5 4/6\n"
    )
    return path


def parts_of(path: Path, tmp_path: Path):
    (tmp_path / "urdf").mkdir(exist_ok=True)
    return meshes_of(claw(tmp_path / "urdf", str(path)).visuals, 1000)[0][str(path), "", ""]


def test_textures_become_the_colours_of_faces(tmp_path):
    found = parts_of(painted_obj(tmp_path), tmp_path)
    assert sorted(colour for colour, _, _ in found) == ["#0000FF", "#FF0000"]
    assert all(len(faces) == 1 and len(vertices) == 3 for _, vertices, faces in found)


def test_no_file_outside_the_meshs_folder_is_opened(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    path = painted_obj(inner, "../secret.png")
    (inner / "halves.png").rename(tmp_path / "secret.png")
    assert not {colour for colour, _, _ in parts_of(path, tmp_path)} & {"#0000FF", "#FF0000"}
    (inner / "link.png").symlink_to(tmp_path / "secret.png")
    (inner / "square.mtl").write_text("newmtl skin\nKd 0 1 0\nmap_Kd link.png\n")
    assert not {colour for colour, _, _ in parts_of(path, tmp_path)} & {"#0000FF", "#FF0000"}


def test_materials_of_a_mesh_colour_its_parts(tmp_path):
    scene = trimesh.Scene()
    for x, colour in ((0.0, [200, 10, 10, 255]), (1.0, [10, 10, 200, 255])):
        box = trimesh.creation.box((0.5, 0.5, 0.5), transform=trimesh.transformations.translation_matrix([x, 0, 0]))
        box.visual.face_colors = colour
        scene.add_geometry(box)
    scene.export(tmp_path / "boxes.glb")
    found = {colour: vertices for colour, vertices, _ in parts_of(tmp_path / "boxes.glb", tmp_path)}
    assert np.allclose(found["#C80A0A"].mean(axis=0), 0) and np.allclose(found["#0A0AC8"].mean(axis=0), [1, 0, 0])


def test_few_triangles_stay_near_the_surface():
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices, faces = simplify(np.array(ball.vertices), np.array(ball.faces), 1000)
    assert 900 <= len(faces) <= 1000
    assert np.abs(np.linalg.norm(vertices, axis=1) - 1).max() < 0.02
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(4 / 3 * np.pi, rel=0.02)


def test_meshes_of_loose_triangles_become_small_too():
    ball = trimesh.creation.icosphere(subdivisions=5)
    loose = np.array(ball.triangles).reshape(-1, 3) + 1e-4 * np.random.default_rng(0).normal(
        size=(3 * len(ball.faces), 3)
    )
    vertices, faces = simplify(loose, np.arange(len(loose)).reshape(-1, 3), 2000)
    assert 500 <= len(faces) <= 2000 and faces.max() < len(vertices)
    assert np.abs(np.linalg.norm(vertices, axis=1) - 1).max() < 0.05


@pytest.mark.parametrize("most", [1, 50, 1000, 10**6])
def test_small_meshes_keep_their_triangles(most):
    sizes, counts = [10, 300, 5000, 80], [4, 1, 2, 1]
    each = share(sizes, counts, most)
    assert sum(min(size, each) * count for size, count in zip(sizes, counts)) <= max(most, sum(counts))
    assert each == max(sizes) or sum(min(size, each + 1) * count for size, count in zip(sizes, counts)) > most


MJCF = """<mujoco><default><default class="skin"><geom contype="0" conaffinity="0" group="2" material="paint"/></default></default>
<asset><material name="paint" rgba="0.2 0.4 0.6 1"/></asset>
<worldbody><body name="palm"><geom type="box" size="0.05 0.05 0.01" rgba="1 0 0 1"/>
  <body name="tip" pos="0 0 0.1"><joint name="bend" axis="0 1 0" range="0 60"/>
    <geom class="skin" type="sphere" size="0.01"/>
    <geom type="capsule" size="0.01 0.02" group="3"/></body></body></worldbody></mujoco>"""


def test_geoms_that_mujocos_viewer_shows_are_seen(tmp_path):
    (tmp_path / "claw.xml").write_text(MJCF)
    hand = load_hand(tmp_path / "claw.xml")
    assert [(one.link, one.kind, one.colour) for one in hand.visuals] == [
        ("palm", "box", "#FF0000"),
        ("tip", "sphere", "#336699"),
    ]
    assert len(hand.geometry.geometryObjects) == 2


TEXTURED = """<mujoco><compiler meshdir="." texturedir="pictures"/>
<asset><texture name="halves" type="2d" file="halves.png"/><mesh name="square" file="square.obj"/>
  <texture name="checks" type="2d" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" width="8" height="8"/>
  <texture name="plain" builtin="flat" rgb1="0 0.4 0" width="8" height="8"/>
  <material name="skin" texture="halves" rgba="0.6 0.6 0.6 1"/><material name="checked" texture="checks"/>
  <material name="layered"><layer role="rgb" texture="plain"/></material></asset>
<worldbody><body name="palm"><geom type="mesh" mesh="square" material="skin" contype="0" conaffinity="0" mass="0"/>
  <geom type="box" size="0.05 0.05 0.01" material="skin"/>
  <body name="tip" pos="0 0 0.1"><joint name="bend" axis="0 1 0" range="0 60"/>
    <geom type="sphere" size="0.01" material="checked"/><geom type="sphere" size="0.01" material="layered"/>
</body></body></worldbody></mujoco>"""


def test_textures_of_an_mjcf_file_are_seen(tmp_path):
    """Where the mesh says on which of its faces, times the material's colour; on other shapes as their mean."""
    (tmp_path / "pictures").mkdir()
    painted_obj(tmp_path)
    (tmp_path / "halves.png").rename(tmp_path / "pictures" / "halves.png")
    (tmp_path / "square.mtl").unlink()
    (tmp_path / "hand.xml").write_text(TEXTURED)
    hand = load_hand(tmp_path / "hand.xml")
    meshes, problems = meshes_of(hand.visuals, 1000)
    (parts,) = meshes.values()
    assert not problems and sorted(colour for colour, _, _ in parts) == ["#000099", "#990000"]
    # A flat cube has its first colour on all sides but the bottom, which has the second.
    assert [mean_colour(one) for one in hand.visuals if one.kind != "mesh"] == ["#4C004C", "#800080", "#156A15"]
    (back,) = meshes_of(hand_of(hand_record(hand)).visuals, 1000)[0].values()
    assert [colour for colour, _, _ in back] == [colour for colour, _, _ in parts]
    # A mesh without texture coordinates has the mean; a picture that cannot be read leaves the colour.
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "square.stl")
    (tmp_path / "plain.xml").write_text(TEXTURED.replace("square.obj", "square.stl"))
    plain = load_hand(tmp_path / "plain.xml").visuals
    assert [part[0] for parts in meshes_of(plain, 1000)[0].values() for part in parts] == ["#4C004C"]
    (tmp_path / "pictures" / "halves.png").write_bytes(b"no picture")
    assert [part[0] for parts in meshes_of(plain, 1000)[0].values() for part in parts] == [""]
    assert mean_colour(plain[1]) == plain[1].colour == "#999999"


def test_textures_of_a_urdf_are_seen(tmp_path):
    """By the name of a material that another visual defines."""
    painted_obj(tmp_path)
    (tmp_path / "square.mtl").unlink()
    skin = '<material name="skin"><texture filename="halves.png"/></material>'
    text = URDF.format(mesh="square.obj").replace('<color rgba="0.2 0.4 0.6 1"/></material>', f"</material>{skin}", 1)
    (tmp_path / "claw.urdf").write_text(
        text.replace('<material name="steel"/></visual>', '<material name="skin"/></visual>')
    )
    (parts,) = meshes_of(load_hand(tmp_path / "claw.urdf").visuals, 1000)[0].values()
    assert sorted(colour for colour, _, _ in parts) == ["#0000FF", "#FF0000"]


def test_pictures_beside_the_meshs_folder_are_found(tmp_path):
    """In the folders that ROS packages have for them."""
    for place in ("materials/textures", "textures"):
        home = tmp_path / place.replace("/", "_")
        (home / "meshes").mkdir(parents=True)
        (home / place).mkdir(parents=True)
        path = painted_obj(home / "meshes", f"../{place}/halves.png")
        (home / "meshes" / "halves.png").rename(home / place / "halves.png")
        assert sorted(colour for colour, _, _ in parts_of(path, tmp_path)) == ["#0000FF", "#FF0000"]
