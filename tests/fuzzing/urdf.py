"""Hands as URDF, with meshes beside them and an object to grasp: mutated in structure, numbers, names, counts and
bytes.
"""

from __future__ import annotations

import copy
import functools
import importlib.metadata
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import own_hands

TIME_LIMIT = 10.0
NUMBERS = [
    "0",
    "-0.0",
    "1",
    "-1",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "1e-12",
    "1e6",
    "6e12",
    "1e3",
    "999",
    "1e-6",
    "0x10",
    "1_0",
    "1e99999",
    "9" * 400,
    "9" * 5000,
    "",
    " ",
    "1,2",
    "1 2",
    "1 2 3 4 5 6 7",
    "one",
    "3.14159",
    "1e-9",
    "-1e-9",
    "2e-9",
    "\u0661",
    "1.5.2",
    "1e",
]
NAMES = [
    "",
    " ",
    "a",
    "palm",
    "base",
    "universe",
    "world",
    "root",
    "tip",
    "x" * 5000,
    "../../etc/passwd",
    "/dev/zero",
    "nul\u2400",
    "\u00e4\U0001f590\u202e",
    "'; --",
    "a b\tc",
    "${1}",
    "$(find x)",
    "%s%n",
    "0001 a",
    "a/b",
    "-1",
    "[]",
    "joint\u0301",
    "&lt;",
    "None",
    "\ufeff",
]
MESHES = ["box.stl", "box.obj", "box.ply", "box.off", "box.glb", "box.dae", "ascii.stl", "unit_sphere.stl"]
PLACES = [
    "{}",
    "./{}",
    "../{}",
    "package://x/{}",
    "file://{}",
    "file:///{}",
    "/dev/zero",
    "pipe.stl",
    "folder.stl",
    "link.stl",
    "%2e%2e/{}",
    "{}\\x",
    "package://{}",
    "http://localhost/{}",
    "{}#x",
    "loop.stl",
]


def make(rng: np.random.Generator, folder: Path) -> dict:
    root = ElementTree.fromstring(_base(rng))
    with_motors(rng, root)
    for _ in range(pick(rng, [0, 1, 1, 1, 2, 3, 6])):
        mutate(rng, root, URDF_TAGS)
    write_meshes(rng, folder)
    with_meshes(rng, root)
    text = nested(rng, ElementTree.tostring(root, encoding="unicode"))
    path = folder / "hand.urdf"
    path.write_bytes(damaged(rng, encoded(rng, with_bombs(rng, text))))
    case = {"hand": str(path), "mesh": str(folder / pick(rng, MESHES)), **options(rng)}
    if rng.random() < 0.15:
        (folder / "hand.srdf").write_bytes(_srdf(rng, root))
        case["options"]["srdf"] = str(folder / pick(rng, [*["hand.srdf"] * 8, "pipe.stl", "folder.stl", "gone.srdf"]))
    return case


def _srdf(rng, robot) -> bytes:
    """Pairs of links whose collisions are not looked at, as MoveIt has them."""
    root = ElementTree.Element("robot", name="r")
    links = [link.get("name", "") for link in robot.findall("link")] or [""]
    for _ in range(pick(rng, [0, 1, 5, 5, 3000])):
        tag = pick(rng, ["disable_collisions", "disable_collisions", "enable_collisions", "disable_default_collisions"])
        ends = {"link1": pick(rng, [*links, *NAMES]), "link2": pick(rng, links), "link": pick(rng, links)}
        ElementTree.SubElement(root, tag, ends, reason="Never")
    for _ in range(pick(rng, [0, 1, 3])):
        mutate(rng, root, ["robot", "disable_collisions", "group", "virtual_joint", "chain"])
    text = nested(rng, ElementTree.tostring(root, encoding="unicode"))
    return damaged(rng, encoded(rng, with_bombs(rng, text)))


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
    body = Sphere(radius=0.02, mass=0.1, pose=_at(0, 0, 0.06))
    if case["object"] == "mesh":
        try:
            body = Mesh.load(case["mesh"], mass=0.1, scale=case["scale"], convex=case["convex"], pose=_at(0, 0, 0.06))
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


def options(rng) -> dict:
    """How the case is used."""
    chosen = {}
    if rng.random() < 0.2:
        chosen["hulls"] = True
    if rng.random() < 0.1:
        chosen["root"] = pick(rng, [*NAMES, "palm", "left_jaw"])
    if rng.random() < 0.1:
        chosen["palm"] = pick(rng, [*NAMES, "palm", "left_jaw"])
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


def _base(rng) -> str:
    """A sound description: one of three of our own, a hand of a few links, or one from example-robot-data."""
    if rng.random() < 0.15:
        names = ["allegro_left_hand.urdf", "panda.urdf", "so101.urdf"]
        wanted = pick(rng, names)
        found = [file for file in importlib.metadata.files("example-robot-data") or [] if file.name == wanted]
        if found:
            return Path(found[0].locate()).read_text(encoding="utf-8")
    if rng.random() < 0.3:
        shapes = ["box 0.01 0.01 0.04", "sphere 0.01", "cylinder 0.01 0.04"]
        parts = [own_hands.link("palm", 0.1, "box 0.05 0.05 0.01")]
        for i in range(rng.integers(1, 4)):
            parent = "palm"
            for k in range(rng.integers(1, 4)):
                name = f"f{i}{k}"
                kind = pick(rng, ["revolute", "revolute", "prismatic"])
                mimic = f"j{i}0 {rng.uniform(-2, 2):.3f} 0.1" if k and rng.random() < 0.4 else ""
                parts += [
                    own_hands.link(name, 0.01, pick(rng, shapes), "0 0 0.02"),
                    own_hands.joint(
                        f"j{i}{k}",
                        parent,
                        name,
                        f"{0.03 * i - 0.03} {0.01 * k} 0.04",
                        pick(rng, ["0 1 0", "1 0 0", "0 0 -1"]),
                        "-0.5 1.2 1 1",
                        kind=kind,
                        mimic=mimic,
                    ),
                ]
                parent = name
        return own_hands.robot("small", *parts)
    return own_hands.HANDS[pick(rng, list(own_hands.HANDS))]


def with_motors(rng, root) -> None:
    """Transmissions, ros2_control and Gazebo's springs at some joints."""
    for one in root.findall("joint"):
        name = one.get("name", "")
        if rng.random() < 0.3:
            trans = ElementTree.SubElement(root, "transmission", name=f"t{name}")
            driven = ElementTree.SubElement(trans, "joint", name=name)
            ElementTree.SubElement(driven, "hardwareInterface").text = pick(
                rng, ["EffortJointInterface", "PositionJointInterface", "JointStateInterface", "x", ""]
            )
            ElementTree.SubElement(trans, "actuator", name=pick(rng, [f"m{name}", "m", *NAMES]))
        if rng.random() < 0.1:
            control = ElementTree.SubElement(root, "ros2_control")
            ElementTree.SubElement(
                ElementTree.SubElement(control, "joint", name=name),
                "command_interface",
                name=pick(rng, ["velocity", "effort", "position", "x"]),
            )
        if rng.random() < 0.1:
            spring = ElementTree.SubElement(root, "gazebo", reference=name)
            ElementTree.SubElement(spring, "springStiffness").text = pick(rng, ["0.1", number(rng)])
            ElementTree.SubElement(spring, "springReference").text = pick(rng, ["0.2", number(rng)])


# -- what every kind of description shares -----------------------------------------------------------------------------

URDF_TAGS = [
    "robot",
    "link",
    "joint",
    "inertial",
    "origin",
    "mass",
    "inertia",
    "collision",
    "geometry",
    "box",
    "sphere",
    "cylinder",
    "mesh",
    "limit",
    "mimic",
    "axis",
    "parent",
    "child",
    "visual",
    "dynamics",
    "capsule",
    "ellipsoid",
    "transmission",
]


def pick(rng, choices):
    return choices[int(rng.integers(len(choices)))]


def _at(*position) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


def mutate(rng, root, tags: list[str]) -> None:
    """One change of a tree, in place."""
    elements = list(root.iter())
    one, other = pick(rng, elements), pick(rng, elements)
    parents = {child: parent for parent in elements for child in parent}
    kind = int(rng.integers(14))
    keys = list(one.attrib)
    if kind <= 3:  # a number
        with_numbers = [
            (element, key)
            for element in elements
            for key, value in element.attrib.items()
            if value and value[0] in "-0123456789"
        ]
        if with_numbers:
            element, key = pick(rng, with_numbers)
            values = element.get(key).split()
            values[int(rng.integers(len(values)))] = number(rng)
            element.set(key, " ".join(values[: None if rng.random() < 0.9 else 1]))
    elif kind == 4 and keys:
        one.set(pick(rng, keys), pick(rng, [*NAMES, *NUMBERS]))
    elif kind == 5 and keys:
        del one.attrib[pick(rng, keys)]
    elif kind == 6 and one in parents:
        parents[one].remove(one)
    elif kind == 7 and one in parents:
        for _ in range(pick(rng, [1, 1, 2, 30, 300])):
            parents[one].append(copy.deepcopy(one) if len(list(one.iter())) < 50 else one)
    elif kind == 8:
        one.tag = pick(rng, tags)
    elif kind == 9 and one in parents:  # names that point elsewhere: loops, several parents, mimics of each other
        named = [element.get("name") for element in elements if element.get("name")]
        ends = [(element, key) for element in elements for key in ("link", "joint", "name") if element.get(key)]
        if named and ends:
            element, key = pick(rng, ends)
            element.set(key, pick(rng, named))
    elif kind == 10:
        one.append(
            ElementTree.Element(
                pick(rng, tags),
                {pick(rng, ["name", "value", "xyz", "size", "type", "link"]): pick(rng, [*NAMES, *NUMBERS])},
            )
        )
    elif kind == 11 and one in parents and other is not one and one not in other.iter() and other not in one.iter():
        parents[one].remove(one)
        other.append(one)
    elif kind == 12:
        deep = one
        for _ in range(pick(rng, [3, 50, 150])):
            deep = ElementTree.SubElement(deep, pick(rng, tags[:3]) if rng.random() < 0.01 else one.tag)
    else:
        one.text = pick(rng, [*NAMES, *NUMBERS])


def nested(rng, text: str) -> str:
    """One element very deep, in some cases."""
    if rng.random() > 0.03:
        return text
    depth, tag = pick(rng, [900, 1500, 20_000, 200_000]), pick(rng, ["a", "link", "joint", "body", "default", "frame"])
    inner = f"<{tag}>" * depth + f"</{tag}>" * depth
    return text.replace("</", inner + "</", 1) if "</" in text else text


def number(rng) -> str:
    if rng.random() < 0.6:
        return pick(rng, NUMBERS)
    return repr(float(rng.normal() * 10.0 ** rng.uniform(-14, 14)))


def with_meshes(rng, root) -> None:
    """Put meshes, of the folder or of places that should not be read, in place of some shapes."""
    for geometry in root.iter("geometry"):
        if rng.random() < 0.25:
            for child in list(geometry):
                geometry.remove(child)
            mesh = ElementTree.SubElement(geometry, "mesh", filename=mesh_name(rng))
            if rng.random() < 0.7:
                mesh.set(
                    "scale",
                    " ".join(number(rng) if rng.random() < 0.2 else pick(rng, ["1", "0.3", "-1"]) for _ in range(3)),
                )


def mesh_name(rng) -> str:
    name = pick(rng, MESHES)
    return name if rng.random() < 0.7 else pick(rng, PLACES).format(name)


def write_meshes(rng, folder: Path) -> None:
    """Meshes in every format, half of them damaged; a pipe, a link to nowhere, a folder called like a mesh."""
    box, encoding = bool(rng.random() < 0.7), pick(rng, ["binary", "ascii"])
    for name in MESHES:
        content = _exported(name, box, encoding)
        if rng.random() < 0.5:
            content = _lying(rng, damaged(rng, content, 0.7))
        (folder / name).write_bytes(content)
    os.mkfifo(folder / "pipe.stl")
    (folder / "folder.stl").mkdir()
    (folder / "link.stl").symlink_to("/dev/zero")
    (folder / "loop.stl").symlink_to("loop.stl")


@functools.cache
def _exported(name: str, box: bool, encoding: str) -> bytes:
    import trimesh

    shape = trimesh.creation.box((0.02, 0.03, 0.04)) if box else trimesh.creation.icosphere(1, 0.02)
    kind = "stl_ascii" if name == "ascii.stl" else name[-3:]
    content = shape.export(file_type=kind, **({"encoding": encoding} if kind == "ply" else {}))
    return content.encode() if isinstance(content, str) else content


def _lying(rng, content: bytes) -> bytes:
    """Numbers of a text replaced, as faces and counts have them."""
    if rng.random() < 0.5:
        return content
    words = content.split(b" ")
    for _ in range(rng.integers(1, 4)):
        i = int(rng.integers(len(words)))
        words[i] = pick(
            rng,
            [
                b"-1",
                b"99999999",
                b"nan",
                b"inf",
                b"1e300",
                b"4294967295",
                b"0",
                b"400000000000",
                b"",
                b"\n",
                b"2000000",
                b"f",
            ],
        )
    return b" ".join(words)


def damaged(rng, content: bytes, share: float = 0.15) -> bytes:
    """Bytes changed, cut out, repeated or cut off, in some cases."""
    if rng.random() > share or not content:
        return content
    data = bytearray(content)
    for _ in range(rng.integers(1, 8)):
        i = int(rng.integers(len(data) + 1))
        kind = rng.integers(5)
        if kind == 0 and i < len(data):
            data[i] = int(rng.integers(256))
        elif kind == 1:
            del data[i : i + int(rng.integers(1, 40))]
        elif kind == 2:
            data[i:i] = data[i : i + int(rng.integers(1, 200))] * int(pick(rng, [1, 2, 50]))
        elif kind == 3:
            data[i:i] = rng.bytes(int(rng.integers(1, 12)))
        elif rng.random() < 0.3:
            del data[i:]
    return bytes(data)


def encoded(rng, text: str) -> bytes:
    text = text.encode("utf-8", "replace").decode()
    if rng.random() < 0.9:
        return text.encode()
    encoding, declared = pick(
        rng,
        [
            ("utf-8-sig", "utf-8"),
            ("utf-16", "utf-16"),
            ("utf-16-le", "utf-16"),
            ("latin-1", "iso-8859-1"),
            ("utf-8", "punycode"),
            ("utf-8", "utf-7"),
            ("utf-8", "nonsense"),
            ("cp1252", "cp1252"),
            ("utf-32", "utf-32"),
            ("utf-8", "rot13"),
            ("utf-8", "zip"),
        ],
    )
    return f'<?xml version="1.0" encoding="{declared}"?>{text}'.encode(encoding, "replace")


def with_bombs(rng, text: str) -> str:
    """A document type in front, entities that grow or name files, in some cases."""
    if rng.random() > 0.05 or text.startswith("<?xml"):
        return text
    name = text[1:].split(">")[0].split()[0] if text.startswith("<") else "robot"
    doctype = pick(
        rng,
        [
            "<!DOCTYPE x>",
            "<!DOCTYPE x SYSTEM '/etc/hostname'>",
            "<!DOCTYPE x [<!ENTITY e SYSTEM 'file:///etc/hostname'>]>",
            "<!DOCTYPE x [<!ENTITY a0 'aaaaaaaaaa'>"
            + "".join(f"<!ENTITY a{i + 1} '{f'&a{i};' * 10}'>" for i in range(9))
            + "]>",
            "<!DOCTYPE x [<!ENTITY % p SYSTEM 'http://localhost/x'> %p;]>",
        ],
    )
    return doctype.replace("x", name, 1).replace(f"DOCTYPE{name}", f"DOCTYPE {name}") + text.replace(
        "</", pick(rng, ["</", "&a9;</", "&e;</"]), 1
    )
