"""Every hand of the catalogue: loads, is what its entry says, and moves as Pinocchio says the file moves."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from shipped_hands import listed as listed_hands, loaded, oracle

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import catalogue, load_hand
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.spatial import pose_of


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_hand_loads_and_is_complete(name):
    hand, entry = loaded(name), CATALOGUE[name]
    if entry.fingers is not None:
        assert tuple(finger.name for finger in hand.fingers) == tuple(entry.fingers)
        for finger in hand.fingers:
            assert entry.fingers[finger.name] in (finger.tip, finger.links[-1])
    assert np.all(hand.lower < hand.upper) and np.all(hand.effort >= 0) and np.all(hand.velocity >= 0)
    assert np.all(np.isfinite([hand.lower, hand.upper, hand.effort, hand.velocity]))
    assert hand.mass > 0.05 and all(hand.finger_mass(finger.name) > 1e-3 for finger in hand.fingers)
    with_geometry = {one.parentJoint for one in hand.geometry.geometryObjects}
    for finger in hand.fingers:
        assert finger.joint_ids[-1] in with_geometry, f"{finger.name} cannot touch with its fingertip"
        assert finger.actuated == tuple(hand.joint_names[i] for i in finger.dofs)
        assert finger.coupled == (len(finger.joints) > len(finger.dofs))
    assert not any("cannot be read" in note or "left out" in note for note in hand.notes)
    assert hand.describe().count("note:") == len(hand.notes)


@pytest.mark.parametrize("name", CATALOGUE)
def test_joints_are_those_of_the_file(name):
    hand, file = loaded(name), oracle(name)
    assert set(hand.joint_names) == set(file.moving) - set(file.couplings)
    assert set(hand.couplings) == set(file.couplings) & set(file.moving)
    assert hand.model.njoints - 1 == len(file.moving)


@pytest.mark.parametrize("name", CATALOGUE)
def test_forward_kinematics_equals_pinocchios_of_the_file(name):
    hand, file = loaded(name), oracle(name)
    links = sorted({link for finger in hand.fingers for link in (*finger.links, finger.tip)} | {hand.palm})
    rng = np.random.default_rng(7)
    for _ in range(3):
        q = rng.uniform(hand.lower, hand.upper)
        theirs = file.placements(links, dict(zip(hand.joint_names, q)))
        assert np.abs(hand.frame_placements(q, links) - theirs).max() < 1e-9


@pytest.mark.parametrize("name", CATALOGUE)
def test_placing_moves_model_and_geometry_alike(name):
    hand = loaded(name)
    rng = np.random.default_rng(3)
    q, names = rng.uniform(hand.lower, hand.upper), [frame.name for frame in hand.model.frames[1:]]
    first = pose_of([0.3, -0.2, 0.5], pin.rpy.rpyToMatrix(0.4, -1.1, 2.0))
    second = pose_of([-1.0, 0.1, 0.2], pin.rpy.rpyToMatrix(-0.9, 0.3, 0.1))

    def everything(one):
        data, at = one.model.createData(), one.geometry.createData()
        pin.updateGeometryPlacements(one.model, data, one.geometry, at, q)
        return np.array([M.homogeneous for M in at.oMg]), one.frame_placements(q, names)

    geometry, frames = everything(hand)
    for placed in (hand.placed(second), hand.placed(first).placed(second)):
        moved, links = everything(placed)
        assert np.abs(moved - second @ geometry).max(initial=0) < 1e-12
        assert np.abs(links - second @ frames).max() < 1e-12
        assert placed.mass == hand.mass and np.array_equal(placed.pose, second)
        lever = second[:3, :3] @ hand.model.inertias[0].lever + second[:3, 3]
        assert np.abs(placed.model.inertias[0].lever - lever).max() < 1e-12 or not hand.model.inertias[0].mass
    untouched, at_home = everything(hand)
    assert np.array_equal(untouched, geometry) and np.array_equal(at_home, frames)


@pytest.mark.parametrize("name", CATALOGUE)
def test_jacobians_are_the_derivatives_of_the_placements(name):
    hand = loaded(name)
    model, data = hand.model, hand.model.createData()
    q = np.random.default_rng(11).uniform(hand.lower, hand.upper)
    h = 1e-6
    for finger in hand.fingers:
        frame = hand.frame_id(finger.tip)
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL).reshape(6, hand.n)
        numeric = np.zeros((6, hand.n))
        for i in range(hand.n):
            step = h * np.eye(hand.n)[i]
            before, after = (pin.SE3(hand.frame_placements(q + s, [finger.tip])[0]) for s in (-step, step))
            numeric[:, i] = pin.log6(before.actInv(after)).vector / (2 * h)
        assert np.abs(J - numeric).max() < 1e-8


def test_the_papers_hand_has_exact_ellipsoids():
    hand, path = loaded("humanoid"), file_of("humanoid")
    scales = [
        [float(value) for value in mesh.get("scale").split()]
        for mesh in ElementTree.parse(path).getroot().findall("link/collision/geometry/mesh")
    ]
    shapes = [one.geometry for one in hand.geometry.geometryObjects]
    assert len(shapes) == len(scales) == 19 and all(isinstance(shape, coal.Ellipsoid) for shape in shapes)
    radii = np.array([np.ravel(shape.radii) for shape in shapes])
    assert np.abs(radii[np.lexsort(radii.T)] - np.array(scales)[np.lexsort(np.array(scales).T)]).max() < 1e-15
    one = next(one for one in hand.geometry.geometryObjects if one.name.startswith("index_proximal"))
    assert np.allclose(np.ravel(one.geometry.radii), [26.98e-3, 9.11e-3, 9.28e-3], atol=1e-12)


def test_a_missing_package_is_named(monkeypatch):
    def absent(_):
        raise catalogue.importlib.metadata.PackageNotFoundError("example-robot-data")

    monkeypatch.setattr(catalogue.importlib.metadata, "files", absent)
    with pytest.raises(HandNotLoaded, match="pip install example-robot-data"):
        load_hand("panda")
    monkeypatch.setattr(catalogue.importlib.metadata, "files", lambda _: [])
    with pytest.raises(HandNotLoaded, match="version 6"):
        load_hand("panda")
    assert load_hand("humanoid").n == 20


def test_files_without_a_python_package_are_found(monkeypatch, tmp_path):
    """As conda has them: in share/ of the environment."""
    file = catalogue.file_of("panda")
    (tmp_path / "share").mkdir()
    robots = next(folder for folder in file.parents if folder.name == "example-robot-data")
    (tmp_path / "share" / "example-robot-data").symlink_to(robots)

    def absent(_):
        raise catalogue.importlib.metadata.PackageNotFoundError("example-robot-data")

    monkeypatch.setattr(catalogue.importlib.metadata, "files", absent)
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    assert catalogue.file_of("panda").samefile(file)


def test_a_name_spelt_wrong_gets_a_suggestion():
    with pytest.raises(HandNotLoaded, match="did you mean 'allegro_right'"):
        load_hand("allegro_rigth")


@pytest.mark.slow
def test_the_docs_list_the_catalogue():
    """Names, joints, masses, fingers and efforts, as the hands have them."""
    from pinograsp.hands.summary import cells

    text = (Path(__file__).resolve().parents[2] / "docs" / "howto" / "hands.md").read_text(encoding="utf-8")
    table = text[text.index("| name | hand | joints |") :].split("\n\n")[0].splitlines()[2:]
    ours = {row["name"]: cells(row) for row in listed_hands()[0]}
    listed = []
    for line in table:
        names, title, joints, moving, mass, fingers, efforts = (cell.strip() for cell in line.strip("|").split("|"))
        names, masses = re.findall(r"`(\w+)`", names), mass.split(", ")
        listed += names
        for name, kilograms in zip(names, masses * len(names) if len(masses) == 1 else masses, strict=True):
            row = ours[name]
            assert row[1].startswith(title) and row[2:] == [joints, moving, kilograms, fingers, efforts], name
    assert listed == list(CATALOGUE)
