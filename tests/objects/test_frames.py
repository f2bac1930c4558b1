"""A body has one frame, that of its file: whichever way it is given, ``body.pose`` puts the file's points where they are."""

import dataclasses

import numpy as np
import pytest
import trimesh

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.objects import load_object
from pinograsp.objects.record import object_of, object_record
from pinograsp.spatial import pose_of, rotation_rpy

SIZE = np.array([0.03, 0.05, 0.08])
PLACE = pose_of([0.4, -0.7, 0.2], rotation_rpy(0.5, -1.0, 2.0))
TURNED = pose_of([0.1, 0.2, -0.1], rotation_rpy(0.3, 0.2, 1.0))
MASS = 0.2


def block(at=None):
    """A block of trimesh, its middle and axes at a placement (4, 4)."""
    return trimesh.creation.box(SIZE, transform=at)


def described(inside, at):
    """A URDF link with one collision shape at a placement, weighing nothing, and a visual elsewhere."""
    xyz = " ".join(map(str, at[:3, 3]))
    origin = f'<origin xyz="{xyz}" rpy="0.3 0.2 1.0"/>'
    return (
        '<robot name="t"><link name="t"><visual><origin xyz="1 1 1"/><geometry><sphere radius="1"/></geometry></visual>'
        f"<collision>{origin}<geometry>{inside}</geometry></collision></link></robot>"
    )


def on_the_floor(folder):
    block(pose_of([0, 0, 0.04])).export(folder / "block.stl")
    return pg.Mesh.load(folder / "block.stl", mass=MASS), pose_of([0, 0, 0.04])


def in_millimetres(folder):
    made = block(TURNED)
    made.apply_scale(1000)
    made.export(folder / "block.stl")
    return pg.Mesh.load(folder / "block.stl", scale=1e-3, mass=MASS), TURNED


def far_off(folder):
    at = pose_of([4.0, -7.0, 2.5], rotation_rpy(1.0, 2.0, 3.0))
    block(at).export(folder / "block.ply")
    return pg.Mesh.load(folder / "block.ply", mass=MASS), at


def hull(folder):
    made = block(TURNED)
    return pg.Mesh(vertices=made.vertices, faces=made.faces, convex=True, mass=MASS), TURNED


def mirrored(folder):
    at = pose_of([-0.2, 0.01, 0.03])
    block(at).export(folder / "block.stl")
    (folder / "thing.urdf").write_text(
        '<robot name="t"><link name="t"><collision><geometry><mesh filename="block.stl" scale="-1 1 1"/></geometry>'
        "</collision></link></robot>"
    )
    return load_object(folder / "thing.urdf", mass=MASS), pose_of([0.2, 0.01, 0.03])


def of_convex_parts(folder):
    for number, z in enumerate((-0.01995, 0.01995)):  # they overlap by 0.2 mm
        part = trimesh.creation.box([*SIZE[:2], 0.0401], transform=pose_of([0.1, 0.02, z]))
        part.export(folder / f"part{number}.obj")
    return pg.Mesh.load(folder / "part*.obj", mass=MASS), pose_of([0.1, 0.02, 0])


def urdf_mesh(folder):
    block().export(folder / "block.stl")
    (folder / "thing.urdf").write_text(described('<mesh filename="block.stl"/>', TURNED))
    return load_object(folder / "thing.urdf", mass=MASS), TURNED


def urdf_primitive(folder):
    size = " ".join(map(str, SIZE))
    (folder / "thing.urdf").write_text(described(f'<box size="{size}"/>', TURNED))
    return load_object(folder / "thing.urdf", mass=MASS), TURNED


def sdf_primitive(folder):
    size = " ".join(map(str, SIZE))
    (folder / "thing.sdf").write_text(
        '<sdf version="1.9"><model name="t"><link name="t"><pose>0.1 0.2 -0.1 0.3 0.2 1.0</pose><collision name="c">'
        f"<geometry><box><size>{size}</size></box></geometry></collision></link></model></sdf>"
    )
    return load_object(folder / "thing.sdf", mass=MASS), TURNED


def mjcf_primitive(folder):
    half = " ".join(map(str, SIZE / 2))
    (folder / "thing.xml").write_text(
        '<mujoco><worldbody><body name="b" pos="0.5 0.4 0.3" euler="0 0 30"><freejoint/>'
        f'<geom type="box" size="{half}" pos="0.05 0 0.04" mass="{MASS}"/></body></worldbody></mujoco>'
    )
    return load_object(folder / "thing.xml"), pose_of([0.05, 0, 0.04])


def primitive(folder):
    return pg.Box(size=SIZE, mass=MASS), np.eye(4)


WAYS = (on_the_floor, in_millimetres, far_off, hull, mirrored, of_convex_parts, urdf_mesh, urdf_primitive)
WAYS = (*WAYS, sdf_primitive, mjcf_primitive, primitive)


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_the_frame_is_that_of_the_file(way, tmp_path):
    """The same block as a primitive, its middle where the file has it, is what it is compared with."""
    loaded, middle_b = way(tmp_path)
    corners = middle_b[:3, :3] @ (0.5 * SIZE[:, None] * np.array([[1, 1, -1], [-1, 1, 1], [1, -1, -1]]).T)
    corners = corners.T + middle_b[:3, 3]
    assert np.array_equal(loaded.pose, np.eye(4))
    for body in (loaded, loaded.placed(PLACE), object_of(object_record(loaded.placed(PLACE)))):
        same = pg.Box(size=SIZE, mass=MASS, pose=body.pose @ middle_b)
        there = corners @ body.pose[:3, :3].T + body.pose[:3, 3]
        digits = 2e-6 if way is far_off else 2e-7  # binary files hold 7 digits
        assert np.abs(body.project(there)[2]).max() < digits
        assert np.allclose(body.com_o, same.com_o, atol=digits)
        assert np.allclose(body.com_b, middle_b[:3, 3], atol=digits)
        assert np.allclose(body.shape_pose[:3, 3], same.com_o, atol=digits)
        points = same.com_o + np.random.default_rng(0).normal(size=(40, 3)) * 0.05
        assert np.abs(body.project(points)[2] - same.project(points)[2]).max() < 2 * digits
        turn, own = same.pose[:3, :3], body.pose[:3, :3]
        inertia = turn @ same.inertia_b @ turn.T
        assert np.allclose(own @ body.inertia_b @ own.T, inertia, rtol=0, atol=3e-4 * inertia.max())
        R = body.shape_pose[:3, :3]
        assert np.allclose(R @ body.inertia_s @ R.T, own @ body.inertia_b @ own.T, rtol=0, atol=1e-12)


def test_copies_of_a_mesh_keep_its_frame():
    made = block(TURNED)
    body = pg.Mesh(vertices=made.vertices, faces=made.faces, mass=MASS, com=[0.1, 0.2, -0.09], pose=PLACE)
    heavier = dataclasses.replace(body, mass=1.0, density=None)
    assert np.array_equal(heavier.vertices, body.vertices) and np.array_equal(heavier.com_o, body.com_o)
    assert np.allclose(body.com_b, [0.1, 0.2, -0.09]) and np.allclose(
        PLACE[:3, :3] @ body.com_b + PLACE[:3, 3], body.com_o
    )


def test_bodies_turn_about_their_centre_of_mass():
    made = block(TURNED)
    body = pg.Mesh(vertices=made.vertices, faces=made.faces, mass=MASS, pose=PLACE)
    turn, shift = rotation_rpy(0.2, 0.1, -0.4), np.array([0.01, 0.02, 0.03])
    moved = body.moved(shift, turn)
    assert np.allclose(moved.com_o, body.com_o + shift, atol=1e-12)
    assert np.allclose(moved.pose[:3, :3], turn @ body.pose[:3, :3], atol=1e-12)
    assert np.abs(moved.project(made.vertices @ moved.pose[:3, :3].T + moved.pose[:3, 3])[2]).max() < 1e-12


ROW = pose_of([0.1, 0.2, 0.3], rotation_rpy(0.1, 0.2, 0.3)).T  # translation in the last row, as row vectors have it


@pytest.mark.parametrize(
    "place",
    [
        lambda folder: pg.Box(size=SIZE, mass=MASS).placed(ROW),
        lambda folder: pg.Sphere(radius=0.03, mass=MASS, pose=ROW),
        lambda folder: pg.Cylinder(radius=0.03, height=0.1, mass=MASS, shape_b=ROW),
        lambda folder: dataclasses.replace(on_the_floor(folder)[0], pose=ROW),
        lambda folder: load_object(folder / "thing.urdf", mass=MASS, pose=ROW),
        lambda folder: load_object(folder / "thing.urdf", mass=MASS).placed(ROW.tolist()),
        lambda folder: pg.Mesh.load(folder / "block.stl", mass=MASS, pose=ROW),
        lambda folder: object_of({**object_record(pg.Box(size=SIZE, mass=MASS)), "pose": ROW.tolist()}),
        lambda folder: pg.Box(size=SIZE, mass=MASS).placed(np.diag([1.0, 1.0, 1.0, 2.0])),
        lambda folder: pg.load_hand("panda").placed(ROW),
    ],
)
def test_poses_with_their_translation_in_the_last_row_are_refused(place, tmp_path):
    on_the_floor(tmp_path), urdf_primitive(tmp_path)
    with pytest.raises(InvalidInput, match="last row 0 0 0 1, got"):
        place(tmp_path)


def test_the_last_row_may_be_rounded():
    rounded = np.array(PLACE)
    rounded[3] = [1e-17, -2e-16, 0.0, 1.0 + 4e-15]
    assert np.array_equal(pg.Box(size=SIZE, mass=MASS, pose=rounded).pose, PLACE)


def test_meshes_that_version_0_2_wrote_are_refused():
    """It counted vertices, pose and centre of mass from the centre of mass: read as they stand, they are elsewhere."""
    made = block(TURNED)
    mesh = pg.Mesh(vertices=made.vertices, faces=made.faces, mass=MASS)
    with pytest.raises(InvalidInput, match="file_frame_b"):
        object_of(object_record(mesh) | {"file_frame_b": np.eye(4).tolist()})
