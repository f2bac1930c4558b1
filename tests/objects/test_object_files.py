"""Objects as their files give them: parts of one object, URDF and SDF."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pinograsp.cases.object_case import ObjectCase
from pinograsp.errors import InvalidInput
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere, load_object, object_from
from pinograsp.objects.mesh_files import read_surface
from pinograsp.objects.record import object_of, object_record
from pinograsp.spatial import pose_of, rotation_rpy

INERTIAL = """<inertial><origin xyz="0.001 0.002 0.003" rpy="0.1 0.2 0.3"/><mass value="0.3"/>
  <inertia ixx="2e-4" ixy="1e-6" ixz="0" iyy="2.5e-4" iyz="0" izz="3e-4"/></inertial>"""
HAMMER = """<collision><geometry><cylinder radius="0.01" length="0.2"/></geometry></collision>
  <collision><origin xyz="0 0 0.1" rpy="0 0 0.5"/><geometry><box size="0.08 0.03 0.03"/></geometry></collision>
  <collision><origin xyz="0 0 0.1"/><geometry><sphere radius="0.005"/></geometry></collision>"""


def urdf(folder, inside, more=""):
    path = folder / "thing.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="thing"><link name="thing">{inside}</link>{more}</robot>')
    return path


def sdf(folder, inside, version="1.7"):
    path = folder / "thing.sdf"
    path.write_text(f'<?xml version="1.0"?><sdf version="{version}"><model name="thing">{inside}</model></sdf>')
    return path


def inertia_of(path):
    """Mass, centre of mass and inertia, by Pinocchio."""
    model = pin.buildModelFromXML(path.read_text(), pin.JointModelFreeFlyer())
    return model.inertias[1]


def shape(kind, sizes, origin='<origin xyz="0.1 0 0.2" rpy="0.4 -0.2 1"/>'):
    return f"<collision>{origin}<geometry><{kind} {sizes}/></geometry></collision>"


@pytest.mark.parametrize(
    ("kind", "sizes", "expected"),
    [
        ("box", 'size="0.02 0.03 0.04"', Box(size=[0.02, 0.03, 0.04], density=500)),
        ("sphere", 'radius="0.03"', Sphere(radius=0.03, density=500)),
        ("cylinder", 'radius="0.03" length="0.1"', Cylinder(radius=0.03, height=0.1, density=500)),
        ("capsule", 'radius="0.02" length="0.05"', Capsule(radius=0.02, length=0.05, density=500)),
    ],
)
def test_one_primitive_stays_exact(tmp_path, kind, sizes, expected):
    pose, origin = pose_of([1, 2, 3], rotation_rpy(0.3, 0.2, 0.1)), pose_of([0.1, 0, 0.2], rotation_rpy(0.4, -0.2, 1))
    made = load_object(urdf(tmp_path, shape(kind, sizes)), density=500, pose=pose)
    assert type(made) is type(expected) and made.mass == pytest.approx(expected.mass)
    assert np.array_equal(made.pose, pose) and np.allclose(made.shape_pose, pose @ origin, atol=1e-12)
    same = expected.placed(pose @ origin)
    points = same.com_o + np.random.default_rng(0).normal(size=(20, 3)) * 0.1
    for ours, theirs in zip(made.project(points), same.project(points)):
        assert np.allclose(ours, theirs, atol=1e-12)
    turn = origin[:3, :3]
    assert made.volume == expected.volume and np.allclose(made.inertia_b, turn @ expected.inertia_b @ turn.T)


def test_what_the_file_weighs_is_kept(tmp_path):
    """Mass, centre of mass and inertia as Pinocchio reads them; surfaces and volume as trimesh unites them."""
    path = urdf(tmp_path, HAMMER + INERTIAL)
    made, read = load_object(path), inertia_of(path)
    assert made.mass == read.mass and np.allclose(made.com_o, read.lever, atol=1e-12)
    assert np.allclose(made.inertia_b, read.inertia, atol=1e-15)
    stick = trimesh.creation.cylinder(radius=0.01, height=0.2, sections=96)
    head = trimesh.creation.box([0.08, 0.03, 0.03])
    head.apply_transform(pose_of([0, 0, 0.1], rotation_rpy(0, 0, 0.5)))
    assert made.volume == pytest.approx(trimesh.boolean.union([stick, head], engine="manifold").volume, rel=1e-6)
    assert made.notes == ("3 parts were united",)
    assert np.abs(made.project(head.vertices)[2]).max() < 1e-9  # in the file's frame
    lighter = load_object(path, mass=0.15)
    assert np.allclose(lighter.com_o, made.com_o) and np.allclose(lighter.inertia_b, made.inertia_b / 2)
    homogeneous = load_object(path, density=700)
    assert homogeneous.inertia is None and homogeneous.mass == pytest.approx(700 * made.volume)
    assert np.linalg.norm(homogeneous.com_o - made.com_o) > 0.02


def test_a_primitive_that_is_heavy_on_one_side_is_a_mesh(tmp_path):
    path = urdf(tmp_path, shape("cylinder", 'radius="0.03" length="0.1"', "") + INERTIAL)
    made = load_object(path)
    assert isinstance(made, Mesh) and np.allclose(made.com_o, [0.001, 0.002, 0.003])
    assert made.volume == pytest.approx(np.pi * 0.03**2 * 0.1, rel=1e-3)
    centred = load_object(
        urdf(
            tmp_path, shape("cylinder", 'radius="0.03" length="0.1"', "") + INERTIAL.replace("001 0.002 0.003", "0 0 0")
        )
    )
    assert isinstance(centred, Cylinder)
    assert np.allclose(centred.inertia_b, inertia_of(tmp_path / "thing.urdf").inertia)


def test_records_keep_what_was_measured(tmp_path):
    for inside in (HAMMER, shape("sphere", 'radius="0.06"', '<origin xyz="0.001 0.002 0.003"/>')):
        made = load_object(urdf(tmp_path, inside + INERTIAL))
        again = object_of(object_record(made))
        assert type(again) is type(made) and again.notes == made.notes
        assert np.allclose(again.inertia_b, made.inertia_b, rtol=1e-12) and np.allclose(again.pose, made.pose)
        points = np.random.default_rng(0).uniform(-0.2, 0.2, (20, 3))
        assert np.abs(again.project(points)[2] - made.project(points)[2]).max() < 1e-12
    with pytest.raises(InvalidInput, match="expected shape, mass"):
        object_of({**object_record(Sphere(radius=1, mass=1)), "com": [0, 0, 0]})


@pytest.mark.parametrize("moments", [(1, 1, 1), (1e-4, 1e-4, 3e-4), (1e-4, 1e-4, -1e-4)])
def test_impossible_inertias_are_not_used(tmp_path, moments):
    inertia = '<inertia ixx="{}" ixy="0" ixz="0" iyy="{}" iyz="0" izz="{}"/>'.format(*moments)
    made = load_object(
        urdf(tmp_path, shape("box", 'size="0.1 0.1 0.1"', "") + f'<inertial><mass value="0.5"/>{inertia}</inertial>')
    )
    assert made.inertia is None and "inertia cannot be" in made.notes[0]
    assert np.allclose(made.inertia_b, Box(size=[0.1] * 3, mass=0.5).inertia_b)
    with pytest.raises(InvalidInput, match=r"inertia: expected.*got"):
        Box(size=[0.1] * 3, mass=0.5, inertia=np.diag(moments))


def test_meshes_are_scaled_mirrored_and_placed(tmp_path):
    made = trimesh.creation.icosphere(radius=30, subdivisions=2)
    made.vertices[:, 0] += np.where(made.vertices[:, 0] > 0, made.vertices[:, 0], 0)  # longer on one side
    (tmp_path / "meshes").mkdir()
    made.export(tmp_path / "meshes" / "egg.stl")
    for sign, name in ((1, "meshes/egg.stl"), (-1, "package://any/meshes/egg.stl")):
        mesh = f'filename="{name}" scale="{sign * 1e-3} 1e-3 1e-3"'
        egg = load_object(urdf(tmp_path, shape("mesh", mesh, '<origin xyz="0 0 1"/>')), mass=0.1)
        assert egg.volume == pytest.approx(1e-9 * made.volume, rel=1e-5) and egg.notes == ()
        assert np.allclose(egg.com_o, [sign * 1e-3 * made.center_mass[0], 0, 1], atol=1e-8)
    torn = trimesh.Trimesh(made.vertices, made.faces[3:])
    torn.export(tmp_path / "meshes" / "egg.stl")
    path = urdf(tmp_path, shape("mesh", 'filename="meshes/egg.stl" scale="1e-3 1e-3 1e-3"', ""))
    with pytest.raises(InvalidInput, match=r"thing\.urdf.*watertight.*hulls=True"):
        load_object(path, mass=1)
    assert load_object(path, mass=1, hulls=True).volume == pytest.approx(1e-9 * made.convex_hull.volume, rel=1e-5)
    (tmp_path / "deep" / "er").mkdir(parents=True)
    assert load_object(
        urdf(tmp_path / "deep" / "er", shape("mesh", 'filename="meshes/egg.stl"', "")), mass=1, hulls=True
    )


def test_sdf_and_urdf_say_the_same(tmp_path):
    given = """<link name="thing"><pose>0.1 0 0 0 0 0.2</pose>
      <collision name="a"><geometry><cylinder><radius>0.01</radius><length>0.2</length></cylinder></geometry></collision>
      <collision name="b"><pose degrees="true">0 0 0.1 0 0 30</pose><geometry><box><size>0.08 0.03 0.03</size></box>
      </geometry></collision>
      <inertial><pose>0.001 0.002 0.003 0.1 0.2 0.3</pose><mass>0.3</mass><inertia><ixx>2e-4</ixx><ixy>1e-6</ixy>
      <iyy>2.5e-4</iyy><izz>3e-4</izz></inertia></inertial></link>"""
    same = HAMMER.replace('0 0 0.5"', f'0 0 {np.pi / 6}"')
    one = load_object(sdf(tmp_path, given))
    two = load_object(urdf(tmp_path, same + INERTIAL), pose=pose_of([0.1, 0, 0], rotation_rpy(0, 0, 0.2)))
    assert one.mass == two.mass and one.volume == pytest.approx(two.volume, rel=1e-9)
    assert np.allclose(one.com_o, two.com_o)
    turn = [body.pose[:3, :3] for body in (one, two)]
    assert np.allclose(*(r @ body.inertia_b @ r.T for r, body in zip(turn, (one, two))))
    ball = load_object(
        sdf(
            tmp_path,
            '<link name="a"><collision name="c"><geometry><ellipsoid><radii>0.01 0.02 0.03</radii></ellipsoid></geometry></collision></link>',
        ),
        mass=1,
    )
    assert isinstance(ball, Ellipsoid) and np.array_equal(ball.semi_axes, [0.01, 0.02, 0.03])


BOX = shape("box", 'size="0.1 0.1 0.1"', "")
LINK = '<link name="other"><collision><geometry><sphere radius="1"/></geometry></collision></link>'
JOINT = '<joint name="lid" type="{}"><parent link="thing"/><child link="other"/></joint>'


@pytest.mark.parametrize(
    ("inside", "more", "match"),
    [
        (BOX, LINK, r"expected one link with <collision>.*got 2 \(thing, other\)"),
        (BOX, LINK + JOINT.format("revolute"), "joints that move: lid"),
        (BOX, f'<link name="other">{INERTIAL}</link>', r"others with a mass \(other\)"),
        ("", "", "expected one link with <collision>"),
        (shape("mesh", 'filename="gone.stl"'), "", "mesh 'gone.stl' not found"),
        (shape("mesh", 'filename=""'), "", "not found"),
        (shape("cone", 'radius="1"'), "", "expected one of box, sphere, cylinder, capsule, mesh, got <cone>"),
        (shape("box", 'size="1 -1 1"'), "", "expected sizes > 0"),
        (shape("box", 'size="1 1"'), "", "expected 3 finite numbers"),
        (shape("box", 'size="1 1 nan"'), "", "expected 3 finite numbers"),
        (BOX.replace("<geometry>", '<origin xyz="1e99 0 0"/><geometry>'), "", "at most"),
        (BOX, "", "gives no mass: give mass="),
        (BOX + '<inertial><mass value="-1"/></inertial>', "", "expected >= 0 kg"),
        (HAMMER + INERTIAL.replace("0.001", "0.5"), "", "mesh com: expected a centre of mass within the solid"),
        (BOX * 1001, "", "at most 1000 collision shapes"),
        ("<a>" * 2000 + "</a>" * 2000, "", "nested"),
    ],
)
def test_urdf_files_of_no_single_object_are_refused(tmp_path, inside, more, match):
    with pytest.raises(InvalidInput, match=match) as caught:
        load_object(urdf(tmp_path, inside, more))
    assert "thing.urdf" in str(caught.value) and len(str(caught.value)) < 700


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('<!DOCTYPE r [<!ENTITY e SYSTEM "/etc/passwd">]><robot>&e;</robot>', "entity declarations"),
        ("<robot>", "not well-formed"),
        ("<world/>", r"expected <robot> \(URDF\), <sdf> or <mujoco> \(MJCF\), found <world>"),
        ("<mujoco/>", "no <worldbody> found"),
        ("", "not well-formed"),
        ("version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("<sdf><model name='a'/><model name='b'/></sdf>", r"got 2 \(a, b\)"),
        ("<sdf><model name='a'><include><uri>b</uri></include></model></sdf>", "got a model with others in it"),
        (
            "<sdf><model name='a'><link><pose relative_to='b'>1 2 3 0 0 0</pose><collision/></link></model></sdf>",
            "relative_to",
        ),
        ("<sdf><model name='a'><link><pose>1 2 3</pose><collision/></link></model></sdf>", "expected 6 finite numbers"),
        (
            "<sdf><model name='a'><link><collision><geometry><plane/></geometry></collision></link></model></sdf>",
            "got <plane>",
        ),
    ],
)
def test_other_files_are_refused(tmp_path, text, match):
    path = tmp_path / "thing.sdf"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=match):
        load_object(path, mass=1)


def test_missing_files_are_refused(tmp_path):
    for path in (tmp_path / "none.urdf", tmp_path):
        with pytest.raises(InvalidInput, match=r"object file '"):
            load_object(path, mass=1)
    with pytest.raises(InvalidInput, match="object file: expected a path"):
        load_object(3, mass=1)


# -- parts of one object in several files, or several groups of one ----------------------------------------------------


def stack(gap):
    """Two boxes on each other."""
    boxes = [trimesh.creation.box([0.04, 0.04, 0.05]) for _ in range(2)]
    boxes[1].apply_translation([0, 0, 0.05 + gap])
    return boxes


def test_a_folder_and_a_pattern_are_the_parts_of_one_object(tmp_path):
    folder = tmp_path / "parts [1]"
    folder.mkdir()
    for number, part in enumerate([*stack(-0.01), trimesh.creation.icosphere(radius=0.01)]):
        part.export(folder / f"part{number}.obj")
    (folder / "readme.txt").write_text("not a mesh")
    whole = Mesh.load(folder, mass=1)
    assert whole.volume == pytest.approx(0.04 * 0.04 * 0.09, rel=1e-6)  # the ball is inside
    assert whole.notes == ("3 parts were united",)
    (tmp_path / "other").mkdir()
    for number, part in enumerate(stack(-0.01)):
        part.export(tmp_path / "other" / f"part{number}.stl")
    for text in (f"mesh:path={tmp_path}/other/*.stl,mass=1", f"mesh:path={folder},mass=1"):
        assert object_from(text).volume == pytest.approx(whole.volume, rel=1e-6)
    case = ObjectCase.of(hand="panda", object="mesh:path=other/*.stl,mass=1", folder=tmp_path)
    assert case.make_object().volume == pytest.approx(whole.volume, rel=1e-6)
    for wrong in (tmp_path / "other" / "*.obj", tmp_path):
        with pytest.raises(InvalidInput, match="mesh files: expected one or more, got none"):
            Mesh.load(wrong, mass=1)
    hull = Mesh.load(str(tmp_path / "other" / "*.stl"), mass=1, convex=True)
    assert hull.convex and hull.volume == pytest.approx(whole.volume, rel=1e-6)
    torn = trimesh.Trimesh(stack(0)[0].vertices, stack(0)[0].faces[1:])
    torn.export(tmp_path / "other" / "part2.stl")
    with pytest.raises(InvalidInput, match=r"part2\.stl'.*watertight"):
        Mesh.load(tmp_path / "other", mass=1)


@pytest.mark.slow
def test_many_shapes_have_a_bounded_number_of_triangles(tmp_path, monkeypatch):
    """Round ones are coarser the more there are; volumes of separate balls tell how coarse."""

    def balls(count):
        return "".join(
            f'<collision><origin xyz="{k} 0 0"/><geometry><sphere radius="0.4"/></geometry></collision>'
            for k in range(count)
        )

    for count, error in ((2, 2.5e-3), (31, 1e-2), (151, 4e-2)):  # thrice that of the radius, and some
        made = load_object(urdf(tmp_path, balls(count)), density=500)
        assert made.volume == pytest.approx(count * 4 / 3 * np.pi * 0.4**3, rel=error)
        assert len(made.faces) < 50_000
    read = []
    monkeypatch.setattr("pinograsp.objects.load.read_surface", lambda path: read.append(path) or read_surface(path))
    monkeypatch.setattr("pinograsp.hands.mesh_file.MOST_TRIANGLES", 40)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.stl")
    with pytest.raises(InvalidInput, match="at most 40 triangles in all shapes, got 48 in the first 4 of 5"):
        load_object(urdf(tmp_path, shape("mesh", 'filename="box.stl"') * 5), mass=1)
    assert len(read) == 1


def test_an_object_has_a_bounded_number_of_parts(tmp_path):
    """Thousands of specks would be compared with each other."""
    corners, faces = (
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 1e-3,
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    )
    for count, refused in ((300, False), (3001, True)):
        places = 2e-3 * np.stack(np.unravel_index(np.arange(count), (20, 20, 20)), axis=1)
        vertices = (corners + places[:, None]).reshape(-1, 3)
        many = (np.array(faces) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
        if refused:
            with pytest.raises(InvalidInput, match="at most 3000 parts, got 3001: remove the specks"):
                Mesh(vertices=vertices, faces=many, mass=1)
        else:
            assert Mesh(vertices=vertices, faces=many, mass=1).volume == pytest.approx(count * 1e-9 / 6)


def test_links_in_a_folder_lead_to_meshes(tmp_path):
    """Whoever gives a folder of somebody else's does not mean the files that its links may lead to."""
    folder = tmp_path / "parts"
    folder.mkdir()
    stack(0)[0].export(tmp_path / "box.stl")
    (folder / "part0.stl").symlink_to("../box.stl")
    assert Mesh.load(folder, mass=1).volume == pytest.approx(0.04 * 0.04 * 0.05)
    (tmp_path / "box.stl").rename(tmp_path / "secret")
    (folder / "part0.stl").unlink()
    (folder / "part0.stl").symlink_to("../secret")
    for given in (folder, folder / "*.stl"):
        with pytest.raises(InvalidInput, match=r"got the link '.*part0\.stl' to '.*secret'"):
            Mesh.load(given, mass=1)
    assert Mesh.load(folder / "part0.stl", mass=1).volume == pytest.approx(0.04 * 0.04 * 0.05)  # that file was meant


@pytest.mark.parametrize(("gap", "grown"), [(-1e-4, False), (0.0, True), (1e-6, True)])
def test_parts_that_share_a_face_up_to_digits_are_one_solid(tmp_path, gap, grown):
    """As planes cut an object in convex parts, written with few digits."""
    for number, part in enumerate(stack(gap)):
        part.export(tmp_path / f"part{number}.ply")
    whole = Mesh.load(tmp_path, mass=1)
    assert whole.volume == pytest.approx(0.04 * 0.04 * (0.1 + gap), rel=2e-3)
    distance = whole.project([whole.com_o + [0.0, 0.015, 0.025]])[2][0]
    assert distance == pytest.approx(-0.005, abs=2.1e-5)  # no faces are left between the parts
    assert not any("enlarged" in note for note in whole.notes) or grown


def test_seams_of_normals_and_materials_do_not_part_a_group(tmp_path):
    """OBJ files as Blender writes them: a normal per face, materials, two groups that meet."""
    lines, count = ["mtllib none.mtl"], 0
    for number, part in enumerate(stack(-0.01)):
        lines += [f"o hull_{number}", *(f"v {x} {y} {z}" for x, y, z in part.vertices)]
        lines += [f"vn {x} {y} {z}" for x, y, z in part.face_normals]
        for face, (a, b, c) in enumerate(part.faces + 1 + count):
            lines += [f"usemtl m{face % 2}", f"f {a}//{face + 1} {b}//{face + 1} {c}//{face + 1}"]
        count += len(part.vertices)
    (tmp_path / "decomposed.obj").write_text("\n".join(lines))
    made = Mesh.load(tmp_path / "decomposed.obj", mass=1)
    assert made.volume == pytest.approx(0.04 * 0.04 * 0.09, rel=1e-9)
    assert made.notes == ("2 parts that meet were united",)


def test_a_line_of_text_names_a_file(tmp_path):
    path = urdf(tmp_path, HAMMER + INERTIAL)
    made = object_from(f"file:path={path}")
    assert made.mass == 0.3 and object_from(f"file:path={path},mass=0.6").mass == 0.6
    case = ObjectCase.of(hand="panda", object={"shape": "file", "path": "thing.urdf", "hulls": True}, folder=tmp_path)
    assert case.make_object().volume == pytest.approx(made.volume)


def test_meshes_in_packages(tmp_path):
    """By an argument, by a field of the text, and by a case's own packages, relative to its folder."""
    (tmp_path / "elsewhere").mkdir()
    trimesh.creation.box((0.02, 0.03, 0.04)).export(tmp_path / "elsewhere" / "box.stl")
    path = urdf(tmp_path, shape("mesh", 'filename="package://things/box.stl"', ""))
    with pytest.raises(InvalidInput, match="packages= gives"):
        object_from(f"file:path={path},mass=1")
    given = object_from(f"file:path={path},mass=1", packages={"things": tmp_path / "elsewhere"})
    named = object_from(f"file:path={path},mass=1,package=things={tmp_path / 'elsewhere'}")
    case = ObjectCase.of(
        hand="panda", object="file:path=thing.urdf,mass=1", packages={"things": "elsewhere"}, folder=tmp_path
    )
    field = {"shape": "file", "path": "thing.urdf", "mass": 1, "package": "things=elsewhere"}
    for made in (
        given,
        named,
        case.make_object(),
        case.model_copy(update={"object": field, "packages": {}}).make_object(),
    ):
        assert made.volume == pytest.approx(0.02 * 0.03 * 0.04)
    with pytest.raises(InvalidInput, match="package: expected NAME=DIR, got 'things'"):
        object_from(f"file:path={path},mass=1,package=things")


# -- MJCF --------------------------------------------------------------------------------------------------------------

MUG = """<body name="mug" pos="0.3 0 0.2" euler="10 20 30"><freejoint/>
  <geom type="cylinder" size="0.03 0.05" pos="0.01 0 0"/><geom type="box" size="0.01 0.02 0.02" pos="0.035 0 0" mass="0.05"/>
  <geom type="sphere" size="0.2" contype="0" conaffinity="0" density="0"/>
  <body pos="0 0 0.05" euler="0 0 40"><geom type="ellipsoid" size="0.02 0.025 0.01" density="300"/></body></body>"""
TABLE = '<geom type="plane" size="1 1 1"/><body name="table"><geom type="box" size="1 1 0.1" pos="0 0 -0.1"/></body>'


def mjcf(folder, inside, more=""):
    path = folder / "thing.xml"
    path.write_text(f"<mujoco>{more}<worldbody>{inside}</worldbody></mujoco>")
    return path


def test_a_body_of_an_mjcf_file_is_what_mujoco_makes_of_it(tmp_path):
    """Bodies fixed in it belong to it, the table beside it does not; its frame is the body's."""
    path = mjcf(tmp_path, TABLE + MUG)
    made = load_object(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    mug, inner = model.body("mug").id, model.nbody - 1
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert made.mass == pytest.approx(model.body_subtreemass[mug])
    turn, at = data.xmat[mug].reshape(3, 3), data.xpos[mug]
    assert made.com_o == pytest.approx(turn.T @ (data.subtree_com[mug] - at), abs=1e-9)
    whole = np.zeros((3, 3))  # of both bodies, about their centre, in the axes of the first
    for one in (mug, inner):
        R, arm = turn.T @ data.ximat[one].reshape(3, 3), turn.T @ (data.xipos[one] - data.subtree_com[mug])
        whole += R @ np.diag(model.body_inertia[one]) @ R.T
        whole += model.body_mass[one] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert made.inertia_b == pytest.approx(whole, rel=1e-6, abs=1e-10)
    points = np.array([[-0.05, 0, 0], [0.1, 0, 0], [0, 0, 0.2]])
    surface, _, _ = made.project(points)
    assert surface == pytest.approx(np.array([[-0.02, 0, 0], [0.045, 0, 0], [0, 0, 0.06]]), abs=1e-4)
    assert np.allclose(load_object(path, body="mug").com_o, made.com_o)
    assert load_object(path, body="table").mass == pytest.approx(8 * 0.1 * 1000)


@pytest.mark.parametrize(
    ("geom", "expected"),
    [
        ('type="box" size="0.01 0.015 0.02"', Box(size=[0.02, 0.03, 0.04], density=1000)),
        ('size="0.03"', Sphere(radius=0.03, density=1000)),
        ('type="cylinder" size="0.03 0.05"', Cylinder(radius=0.03, height=0.1, density=1000)),
        ('type="capsule" fromto="0 0 -0.02 0 0 0.02" size="0.02"', Capsule(radius=0.02, length=0.04, density=1000)),
        ('type="ellipsoid" size="0.01 0.02 0.03"', Ellipsoid(semi_axes=[0.01, 0.02, 0.03], density=1000)),
        ('type="mesh" mesh="part"', None),
    ],
)
def test_one_geom_stays_exact(tmp_path, geom, expected):
    trimesh.creation.box((20, 30, 40)).export(tmp_path / "part.stl")
    asset = '<asset><mesh name="part" file="part.stl" scale="0.001 0.001 0.001"/></asset>'
    made = load_object(mjcf(tmp_path, f"<body><geom {geom}/></body>", asset))
    if expected is None:
        assert made.volume == pytest.approx(0.02 * 0.03 * 0.04) and made.mass == pytest.approx(0.024)
        return
    assert type(made) is type(expected) and made.mass == pytest.approx(expected.mass)
    assert made.volume == pytest.approx(expected.volume) and made.inertia_b == pytest.approx(expected.inertia_b)


@pytest.mark.parametrize(
    ("inside", "body", "match"),
    [
        (MUG + MUG.replace("mug", "cup"), None, r"one free body, got 2 \(mug, cup\): name one with body="),
        (
            TABLE + TABLE.replace("table", "shelf"),
            None,
            r"one body with shapes in <worldbody>, got 2 \(table, shelf\)",
        ),
        (MUG, "mugg", "body: expected.*mug"),
        (MUG.replace("<freejoint/>", '<joint type="hinge"/>'), None, r"joints that move \(mug\)"),
        (MUG.replace('euler="0 0 40">', "><joint/>"), None, "joints that move"),
        ('<body name="a"><geom size="0.1" contype="0" conaffinity="0"/></body>', None, "a <geom> that touches"),
        ('<body name="a"><geom type="mesh" mesh="b"/></body>', None, "mesh 'b' not found"),
        ('<body name="a"><geom size="0.1"/><include file="../secret.xml"/></body>', None, "include"),
        ('<body name="a"><geom size="0.1"/><composite type="grid" count="9 9"/></body>', None, "composite|grid"),
    ],
)
def test_mjcf_files_of_no_single_object_are_refused(tmp_path, inside, body, match):
    (tmp_path / "secret.xml").write_text("<mujocoinclude><geom size='1'/></mujocoinclude>")
    (tmp_path / "inner").mkdir()
    with pytest.raises(InvalidInput, match=match) as caught:
        load_object(mjcf(tmp_path / "inner", inside), body=body)
    assert "object file '" in str(caught.value) and "hand '" not in str(caught.value)


def test_only_mjcf_files_have_bodies(tmp_path):
    with pytest.raises(InvalidInput, match="expected body= with an MJCF file"):
        load_object(urdf(tmp_path, HAMMER), body="thing")


@pytest.mark.parametrize("radius", [1e-4, 0.003, 0.01, 0.3])
def test_capsules_of_any_size_are_parts_of_a_solid(tmp_path, radius):
    """A cylinder within a capsule adds nothing to its volume."""
    length = 6 * radius
    both = shape("capsule", f'radius="{radius}" length="{length}"', "") + shape(
        "cylinder", f'radius="{radius / 2}" length="{length}"', ""
    )
    made = load_object(urdf(tmp_path, both), density=1000)
    assert made.volume == pytest.approx(Capsule(radius=radius, length=length, mass=1).volume, rel=4e-3)  # of facets
