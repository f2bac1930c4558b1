"""Hands as URDF, with meshes beside them and an object to grasp: mutated in structure, numbers, names, counts and
bytes.
"""

from __future__ import annotations

import importlib.metadata
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import own_hands

from fuzzing import mesh
from fuzzing.material import NAMES, encode_xml, mutate_tree, pick, translate, write_number, write_tree

TIME_LIMIT = 10.0
MESHES = ["unit_sphere.stl", *(f"box.{kind}" for kind in mesh.FORMATS)]
TAGS = """
    robot link joint inertial origin mass inertia collision geometry box sphere cylinder mesh limit mimic axis parent
    child visual dynamics capsule ellipsoid transmission
""".split()


def make(rng: np.random.Generator, folder: Path) -> dict:
    root = ElementTree.fromstring(_write_sound(rng))
    _add_motors(rng, root)
    for _ in range(pick(rng, [0, 1, 1, 1, 2, 3, 6])):
        mutate_tree(rng, root, TAGS)
    mesh.write_meshes(rng, folder)
    _add_meshes(rng, root)
    path = folder / "hand.urdf"
    path.write_bytes(encode_xml(rng, write_tree(rng, root)))
    case = {"hand": str(path), "mesh": str(folder / pick(rng, MESHES)), **draw_options(rng)}
    if rng.random() < 0.15:
        (folder / "hand.srdf").write_bytes(_write_srdf(rng, root))
        case["options"]["srdf"] = str(folder / pick(rng, [*["hand.srdf"] * 8, "pipe.stl", "folder.stl", "gone.srdf"]))
    return case


def _write_srdf(rng, robot) -> bytes:
    """Pairs of links whose collisions are not looked at, as MoveIt has them."""
    root = ElementTree.Element("robot", name="r")
    links = [link.get("name", "") for link in robot.findall("link")] or [""]
    for _ in range(pick(rng, [0, 1, 5, 5, 3000])):
        tag = pick(rng, ["disable_collisions", "disable_collisions", "enable_collisions", "disable_default_collisions"])
        ends = {"link1": pick(rng, [*links, *NAMES]), "link2": pick(rng, links), "link": pick(rng, links)}
        ElementTree.SubElement(root, tag, ends, reason="Never")
    for _ in range(pick(rng, [0, 1, 3])):
        mutate_tree(rng, root, ["robot", "disable_collisions", "group", "virtual_joint", "chain"])
    return encode_xml(rng, write_tree(rng, root))


def run(case: dict) -> str:
    """Load the hand, look at it, move it; load the object's mesh; close the one on the other where that is cheap."""
    import pinocchio as pin

    from pinograsp import PinograspError, Sphere, close_hand, load_hand
    from pinograsp.objects import Mesh

    hand = load_hand(case["hand"], **case["options"])
    hand.describe()
    assert np.isfinite(hand.transmission).all() and len(hand.passive_joints) < hand.n, "drives that move nothing"
    model, data = hand.model, hand.model.createData()
    rng = np.random.default_rng(0)
    for q in (hand.lower, hand.upper, 0.5 * (hand.lower + hand.upper), rng.uniform(hand.lower, hand.upper)):
        pin.framesForwardKinematics(model, data, np.array(q))
        pin.computeJointJacobians(model, data, np.array(q))
        assert all(np.isfinite(placement.homogeneous).all() for placement in data.oMf), "placements that are not finite"
        assert np.isfinite(data.J).all(), "Jacobians that are not finite"
        assert np.isfinite(pin.crba(model, data, np.array(q))).all(), "inertias that are not finite"
    assert np.isfinite([hand.mass, *hand.effort, *hand.velocity]).all()
    label = "loaded"
    body = Sphere(radius=0.02, mass=0.1, pose=translate(0, 0, 0.06))
    if case["object"] == "mesh":
        try:
            body = Mesh.load(
                case["mesh"], mass=0.1, scale=case["scale"], convex=case["convex"], pose=translate(0, 0, 0.06)
            )
            body.project(np.array([[0.1, 0.2, 0.3]]))
            label = "loaded, object too"
        except PinograspError:
            pass  # an object that is refused; the hand still meets a ball
    triangles = sum(getattr(one.geometry, "num_tris", 1) for one in hand.geometry.geometryObjects)
    if hand.n <= 20 and triangles < 5000:
        closure = close_hand(hand, body, wrap=case["wrap"], fixed=case["fixed"])
        assert np.isfinite(closure.q).all() and all(np.isfinite(touch.normal_o).all() for touch in closure.touches)
        closure.contacts()
        label = label.replace("loaded", "closed")
    return label


def draw_options(rng) -> dict:
    """How the case is used."""
    chosen = {"hulls": True} if rng.random() < 0.2 else {}
    for name in ("root", "palm"):
        if rng.random() < 0.1:
            chosen[name] = pick(rng, [*NAMES, "palm", "left_jaw"])
    if rng.random() < 0.1:
        chosen["fingers"] = {pick(rng, NAMES): pick(rng, [*NAMES, "left_tip", "right_tip"]) for _ in range(2)}
    return {
        "options": chosen,
        "object": pick(rng, ["ball", "mesh", "mesh"]),
        "scale": float(pick(rng, [1.0, 1.0, 0.001, 1e3, 1e-12])),
        "convex": bool(rng.random() < 0.5),
        "wrap": bool(rng.random() < 0.2),
        "fixed": bool(rng.random() < 0.2),
    }


def _write_sound(rng) -> str:
    """A sound description: one of three of our own, a hand of a few links, or one from example-robot-data."""
    if rng.random() < 0.15:
        wanted = pick(rng, ["allegro_left_hand.urdf", "panda.urdf", "so101.urdf"])
        for file in importlib.metadata.files("example-robot-data") or []:
            if file.name == wanted:
                return Path(file.locate()).read_text(encoding="utf-8")
    if rng.random() > 0.3:
        return own_hands.HANDS[pick(rng, list(own_hands.HANDS))]
    parts = [own_hands.link("palm", 0.1, "box 0.05 0.05 0.01")]
    for i in range(rng.integers(1, 4)):
        parent = "palm"
        for k in range(rng.integers(1, 4)):
            name, at = f"f{i}{k}", f"{0.03 * i - 0.03} {0.01 * k} 0.04"
            shape = pick(rng, ["box 0.01 0.01 0.04", "sphere 0.01", "cylinder 0.01 0.04"])
            kind, axis = pick(rng, ["revolute", "revolute", "prismatic"]), pick(rng, ["0 1 0", "1 0 0", "0 0 -1"])
            mimic = f"j{i}0 {rng.uniform(-2, 2):.3f} 0.1" if k and rng.random() < 0.4 else ""
            parts.append(own_hands.link(name, 0.01, shape, "0 0 0.02"))
            limit = "-0.5 1.2 1 1"
            parts.append(own_hands.joint(f"j{i}{k}", parent, name, at, axis, limit, kind=kind, mimic=mimic))
            parent = name
    return own_hands.robot("small", *parts)


def _add_motors(rng, root) -> None:
    """Transmissions, ros2_control and Gazebo's springs at some joints."""
    for one in root.findall("joint"):
        name = one.get("name", "")
        if rng.random() < 0.3:
            trans = ElementTree.SubElement(root, "transmission", name=f"t{name}")
            interface = ElementTree.SubElement(ElementTree.SubElement(trans, "joint", name=name), "hardwareInterface")
            interface.text = pick(
                rng, ["EffortJointInterface", "PositionJointInterface", "JointStateInterface", "x", ""]
            )
            ElementTree.SubElement(trans, "actuator", name=pick(rng, [f"m{name}", "m", *NAMES]))
        if rng.random() < 0.1:
            driven = ElementTree.SubElement(ElementTree.SubElement(root, "ros2_control"), "joint", name=name)
            command = pick(rng, ["velocity", "effort", "position", "x"])
            ElementTree.SubElement(driven, "command_interface", name=command)
        if rng.random() < 0.1:
            spring = ElementTree.SubElement(root, "gazebo", reference=name)
            ElementTree.SubElement(spring, "springStiffness").text = pick(rng, ["0.1", write_number(rng)])
            ElementTree.SubElement(spring, "springReference").text = pick(rng, ["0.2", write_number(rng)])


def _add_meshes(rng, root) -> None:
    """Put meshes, of the folder or of places that should not be read, in place of some shapes."""
    for geometry in root.iter("geometry"):
        if rng.random() < 0.25:
            for child in list(geometry):
                geometry.remove(child)
            made = ElementTree.SubElement(geometry, "mesh", filename=mesh.name_file(rng, MESHES))
            if rng.random() < 0.7:
                scale = [pick(rng, ["1", "1", "0.3", "-1", write_number(rng)]) for _ in range(3)]
                made.set("scale", " ".join(scale))
