"""Mesh files of every format, lying in their headers, counts, indices and references: loaded as a file, a folder, a
pattern or a list, by one line of text, and as the links of a hand.
"""

from __future__ import annotations

import copy
import functools
import json
import re
import struct
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path

import numpy as np
import own_hands

from fuzzing.harness import SECRET
from fuzzing.material import (
    NUMBER_TEXTS,
    NUMBERS,
    damage,
    encode_xml,
    mutate_tree,
    mutate_values,
    pick,
    write_number,
    write_odd_files,
    write_tree,
)

TIME_LIMIT = 10.0
FORMATS = ["stl", "ascii.stl", "obj", "ply", "ascii.ply", "off", "glb", "dae"]
# Counts and indices, for the fit and for the far too many.
WORDS = [*NUMBER_TEXTS, *"0 1 3 8 11 12 13 2000001 99999999 400000000000 f".split(), "\n"]
# Files that a mesh or a description may name; what is beside it may be read, for pictures.
REFERENCES = [
    *(SECRET, f"file://{SECRET}", "/etc/passwd", "file:///etc/passwd", "../../../../../../etc/passwd", "/dev/zero"),
    *("beside.mtl", "beside.png", "sub/../beside.png", "bomb.png", "pipe.stl", "folder.stl", "loop.stl", "zero.stl"),
    *("secret.png", "gone.stl", ".", "..", "", "nul\u2400", "a" * 5000, "**/*", "parts/linked.stl"),
    *("http://localhost/x.png", "data:application/octet-stream;base64,AAAA", "data:;base64,%"),
]
PLACES = [
    *("{}", "./{}", "../{}", "../case/{}", "parts/{}", "../parts/../{}", "%2e%2e/{}", "{}\\x", "{}#x"),
    *("package://thing/{}", "package://{}", "package://../../{}", "model://thing/{}", "file://{}", "file:///{}"),
    "http://localhost/{}",
]
WORDS_OBJ = [
    *("f", "f 0 0 0", "f -1 -2 -3", "f -99999 1 2", "f 1 2 99999999999999999999", "f 1 2 4294967296", "f 1 1 1"),
    *("f 1 2", "f 1/ 2/ 3/", "f 1//1 2//2 3//3", "f 1/1/1 2/9/9 3/-1/0", "f / / /", "f 1e3 2 3", "f 1.5 2.5 3.5"),
    *("f nan nan nan", "f " + "1 2 3 " * 3000, "f 1 2 3 4 5 6 7 8", "l 1 2 3", "p 1", "cstype bezier"),
    *("v", "v nan nan nan", "v inf 0 0", "v 1e300 1e300 1e300", "v 1 2", "v 1 2 3 4 5 6 7 8 9", "v 0 0 0 \\"),
    *("vt nan nan", "vn 0 0 0", "o " + "x" * 5000, "g a b c", "s off", "usemtl gone", "usemtl m"),
    *("call ../outside/secret.txt", "csh touch ran", "!touch ran", "shadow_obj ../outside/secret.txt"),
    *("\\", "#" * 5000, "\0", "\u00e4\u2603"),
]
_JSON = [*NUMBERS, None, True, "", "x", [], {}, [0], [[0]], 5125]


def make(rng: np.random.Generator, folder: Path) -> dict:
    parts = folder / "parts"
    parts.mkdir()
    write_references(rng, folder)
    names = []
    use = pick(rng, ["file", "file", "file", "spec", "folder", "pattern", "list", "hand", "hand", "hand"])
    for i in range(pick(rng, [1, 1, 1, 2, 4])):
        kind = pick(rng, FORMATS)
        within = use in ("folder", "pattern") or rng.random() < 0.5
        names.append(f"parts/p{i}.{kind}" if within else f"p{i}.{kind}")
        (folder / names[-1]).write_bytes(make_hostile(rng, kind))
    name = names[0]
    if use == "hand":
        (folder / "hand.urdf").write_text(_hand(rng, names))
    if rng.random() < 0.1:
        (parts / "linked.stl").symlink_to(
            pick(rng, ["../" + SECRET, "/etc/hostname", "linked.stl", "../parts", "p0.stl"])
        )
    return {
        "use": use,
        "paths": {
            "folder": pick(rng, ["parts", "parts", "parts", "./parts/", "parts/../parts", "."]),
            "pattern": pick(rng, ["parts/*", "parts/*", "*/p[0-9].*", "parts/p?.*", "**", "p?.stl", "[", "*"]),
            "list": [pick(rng, [*names * 8, "gone.stl", "parts", "pipe.stl"]) for _ in range(rng.integers(0, 5))],
        }.get(use, pick(rng, [*[name] * 40, "pipe.stl", "folder.stl", "loop.stl", "gone.stl", "zero.stl"])),
        "scale": float(pick(rng, [*[1.0] * 12, 0.001, 1e3, 1e-12, 1e300, -1.0, float("nan")])),
        "convex": bool(rng.random() < 0.4),
        "weight": pick(rng, [*[{"mass": 0.1}, {"density": 500}] * 6, {"mass": float("nan")}, {}]),
        "hulls": bool(rng.random() < 0.5),
        "parts": bool(rng.random() < 0.1),
    }


def run(case: dict) -> str:
    """Load what the case says and ask it what plans ask of it; nothing that a file names may have run."""
    try:
        if case["use"] == "hand":
            return _run_hand(case)
        from pinograsp.objects import Mesh, object_from

        weight, convex, scale = case["weight"], case["convex"], case["scale"]
        if case["use"] == "spec":
            fields = {"path": case["paths"], "scale": scale, "convex": str(convex).lower(), **weight}
            body = object_from("mesh:" + ",".join(f"{key}={value}" for key, value in fields.items()))
        else:
            body = Mesh.load(case["paths"], scale=scale, convex=convex, **weight)
        look_at(body)
        if case["parts"] and len(body.faces) <= 100 and body.bounding_radius < 10:
            assert all(np.isfinite(corners).all() for corners in body.convex_parts.corners)
        return "loaded"
    finally:
        assert not Path("ran").exists(), "a command ran"


def look_at(body) -> None:
    """Ask an object for what plans use, at a few points on it and off it; all of it is finite."""
    import coal

    from pinograsp import PinograspError

    assert body.mass > 0 and body.volume > 0 and np.isfinite([body.mass, body.volume, body.bounding_radius]).all()
    assert np.isfinite(body.inertia_b).all() and np.isfinite(body.pose).all(), "not finite"
    rng, radius = np.random.default_rng(0), body.bounding_radius
    points = body.com_o + radius * rng.normal(size=(4, 3))
    try:
        surface, inward, distance = body.project(points)
        assert np.isfinite(surface).all() and np.isfinite(inward).all() and np.isfinite(distance).all(), "not finite"
        body.curvature(surface[:1])
    except PinograspError:
        pass  # an edge, or a point too far away
    geometry, ball = body.collision_geometry, coal.Sphere(max(radius / 10, 1e-6))
    here, there = coal.Transform3s(body.shape_pose[:3, :3], body.com_o), coal.Transform3s(np.eye(3), points[0])
    coal.distance(geometry, here, ball, there, coal.DistanceRequest(), coal.DistanceResult())
    repr(body)


def _run_hand(case: dict) -> str:
    from pinograsp import load_hand
    from pinograsp.hands.visuals import meshes_of

    hand = load_hand("hand.urdf", hulls=case["hulls"])
    assert not any("llocate" in note or "MemoryError" in note for note in hand.notes), f"too much memory: {hand.notes}"
    assert np.isfinite([hand.mass, *hand.effort_or_infinity[:0]]).all()
    meshes, problems = meshes_of(hand.visuals, 2000)
    assert not any("llocate" in one or "MemoryError" in one for one in problems), f"too much memory: {problems}"
    for parts in meshes.values():
        assert all(np.isfinite(vertices).all() and faces.max() < len(vertices) for _, vertices, faces in parts)
    hand.describe()
    return "hand, " + ("seen" if meshes else "mesh left out")


def _hand(rng, names: list[str]) -> str:
    """A gripper of our own, some of its shapes replaced by the meshes."""
    root = ElementTree.fromstring(own_hands.HANDS[pick(rng, list(own_hands.HANDS))].split("?>", 1)[1].strip())
    for link in root.iter("link"):
        for tag in ("collision", "visual"):
            if rng.random() < 0.5 and link.find("collision") is not None:
                geometry = ElementTree.SubElement(ElementTree.SubElement(link, tag), "geometry")
                name = pick(rng, [*names * 3, "zero.stl", "parts/linked.stl", *REFERENCES[:6]])
                scale = pick(rng, ["1 1 1", "1 1 1", "0.001 0.001 0.001", "-1 1 1", f"{write_number(rng)} 1 1"])
                ElementTree.SubElement(geometry, "mesh", filename=name, scale=scale)
    return ElementTree.tostring(root, encoding="unicode")


# -- the files ---------------------------------------------------------------------------------------------------------


def name_file(rng, names: list[str]) -> str:
    """One of the meshes, or a place that should not be read."""
    if rng.random() < 0.08:
        return pick(rng, REFERENCES)
    return (pick(rng, PLACES) if rng.random() < 0.2 else "{}").format(pick(rng, names))


def write_meshes(rng, folder: Path) -> None:
    """A mesh of every format, some of them hostile, and what meshes name."""
    shape = pick(rng, ["box", "box", "ball", "two"])
    for kind in FORMATS:
        content = export_mesh(shape, kind) if rng.random() < 0.7 else make_hostile(rng, kind)
        (folder / f"box.{kind}").write_bytes(content)
    (folder / "unit_sphere.stl").write_bytes(damage(rng, export_mesh("ball", "stl"), 0.3))
    write_references(rng, folder)


def make_hostile(rng, kind: str) -> bytes:
    """A mesh file of a format, whole in some cases, mutated in most, and then damaged in some."""
    content = export_mesh(pick(rng, ["box", "box", "ball", "two", "apart", "open", "inside out"]), kind)
    for _ in range(pick(rng, [0, 0, 1, 1, 1, 3])):
        content = _MUTATIONS[kind](rng, content)
    if rng.random() < 0.01:
        content = _crowded(kind, pick(rng, [2000, 2900, 100_000]))
    elif rng.random() < 0.03:
        others = [b"", b"\0" * 84, b"version https://git-lfs.github.com/spec/v1\n", rng.bytes(500)]
        others += [b"PK\x03\x04" + content, export_mesh("box", pick(rng, FORMATS)), b"<" * 100_000, b"[" * 100_000]
        content = pick(rng, others)
    return damage(rng, content, 0.15)


@functools.cache
def export_mesh(shape: str, kind: str) -> bytes:
    """A mesh file of a solid: convex, round, of two parts that meet or lie apart, open, or turned inside out."""
    import trimesh

    box = trimesh.creation.box((0.02, 0.03, 0.04))
    other = trimesh.creation.box((0.02, 0.02, 0.02))
    made = trimesh.creation.icosphere(1, 0.02) if shape == "ball" else box
    if shape in ("two", "apart"):
        other.apply_translation([0.015 if shape == "two" else 0.05, 0, 0])
        made = trimesh.util.concatenate([box, other])
    if shape == "open":
        made.update_faces(np.arange(len(made.faces)) > 1)
    if shape == "inside out":
        made.invert()
    ending = kind.split(".")[-1]
    if kind == "ascii.stl":
        ending = "stl_ascii"
    more = {"encoding": "ascii" if kind == "ascii.ply" else "binary"} if ending == "ply" else {}
    content = made.export(file_type=ending, **more)
    content = content.encode() if isinstance(content, str) else content
    return b"mtllib beside.mtl\nusemtl m\n" + content if kind == "obj" else content


def _crowded(kind: str, count: int) -> bytes:
    """A sound file with very many pieces, and mostly one box."""
    content = export_mesh("box", kind)
    if kind == "glb":
        (length,) = struct.unpack_from("<I", content, 12)
        scene = json.loads(content[20 : 20 + length])
        chain = [{"mesh": 0, "children": [k + 1]} for k in range(count)] if count % 10_000 else [{"mesh": 0}] * count
        text = json.dumps({**scene, "nodes": [*chain, {"mesh": 0}], "scenes": [{"nodes": [0]}]}).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(content) - 20 - length, len(text), 0x4E4F534A)
        return head + text + content[20 + length :]
    if kind == "dae":
        found = re.search(rb"<instance_geometry.*?</instance_geometry>", content, re.DOTALL)
        return content.replace(found[0], found[0] * count) if found else content
    if kind == "obj":
        return content + b"".join(b"usemtl m%d\nf 1 2 3\n" % k for k in range(count))
    if kind == "ascii.stl":
        return content * min(count, 10_000)
    if kind == "off":
        return b"OFF\n3 %d 0\n0 0 0\n1 0 0\n0 1 0\n" % count + b"3 0 1 2\n" * count
    return _specks(count, kind)


@functools.cache
def _specks(count: int, kind: str) -> bytes:
    """Small solids beside each other."""
    import trimesh

    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 1e-4
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]) + 4 * np.arange(count)[:, None, None]
    places = 2e-4 * np.stack(np.unravel_index(np.arange(count), (50, 50, 50)), axis=1)
    made = trimesh.Trimesh((corners + places[:, None]).reshape(-1, 3), faces.reshape(-1, 3), process=False)
    return made.export(file_type=kind.split(".")[-1])


def _stl(rng, content: bytes) -> bytes:
    """A binary STL whose count, coordinates or head lie."""
    data = bytearray(content)
    if len(data) < 134:
        return content
    kind = int(rng.integers(5))
    if kind == 0:
        count = pick(rng, [0, 1, 11, 13, 2**31, 2**32 - 1, 4_000_000_000, 85_899_346])  # the last: times 50 wraps round
        data[80:84] = struct.pack("<I", count)
    elif kind == 1:
        for _ in range(pick(rng, [1, 3, 20])):
            place = 84 + 50 * int(rng.integers((len(data) - 84) // 50)) + 4 * int(rng.integers(12))
            value = pick(rng, [float("nan"), float("inf"), 1e38, -1e38, 1e-45, 1e9, 0.0])
            data[place : place + 4] = struct.pack("<f", value)
    elif kind == 2:
        data[:5] = b"solid"
    elif kind == 3:
        del data[int(rng.integers(len(data))) :]
    else:
        start = 84 + 50 * int(rng.integers((len(data) - 84) // 50))
        data += data[start : start + 50] * pick(rng, [1, 5])
        data[80:84] = struct.pack("<I", (len(data) - 84) // 50)
    return bytes(data)


def _lines(rng, content: bytes, words: list[str]) -> bytes:
    """Lines of a text dropped, repeated, moved, or with another word or another line in their place."""
    lines = content.split(b"\n")
    i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    kind = int(rng.integers(6))
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines[i:i] = [lines[i]] * pick(rng, [1, 3, 300])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 3:
        lines[i:i] = [pick(rng, words).encode()] * pick(rng, [1, 1, 50])
    else:
        split = lines[i].split(b" ")
        split[int(rng.integers(len(split)))] = pick(rng, WORDS).encode()
        lines[i] = b" ".join(split)
    return b"\n".join(lines)


def _ascii_stl(rng, content: bytes) -> bytes:
    words = [
        "solid",
        "endsolid",
        "facet normal nan nan nan",
        "vertex 1 2",
        "vertex nan 0 0",
        "vertex",
        "endsolid solid",
    ]
    return _lines(rng, content, words)


def _obj(rng, content: bytes) -> bytes:
    named = [f"{word} {name}" for word in ("mtllib", "map_Kd", "usemap", "call") for name in REFERENCES]
    return _lines(rng, content, [*WORDS_OBJ, *named])


def _off(rng, content: bytes) -> bytes:
    if rng.random() < 0.3:
        head, _, rest = content.partition(b"\n")
        counts, _, rest = rest.partition(b"\n")
        counts = " ".join(pick(rng, WORDS) for _ in range(pick(rng, [0, 1, 2, 3, 3, 3, 4])))
        head = pick(rng, [head, b"COFF", b"NOFF", b"STOFF", b"OFF BINARY", b""])
        return b"\n".join([head, counts.encode(), rest])
    words = ["0", "-1", "3 0 0 0", "3 0 1 -1", "3 0 1 99999999999999999999", "4 0 1 2", "9999999 1", "#"]
    return _lines(rng, content, words)


def _ply(rng, content: bytes) -> bytes:
    """A PLY whose head says something else than what follows it, or whose text lies."""
    end = content.find(b"end_header")
    if end < 0 or (rng.random() < 0.3 and b"ascii" in content[:end]):
        return _lines(rng, content, WORDS)
    head, rest = content[:end], content[end:]
    if rng.random() < 0.3:
        return head + damage(rng, rest)
    words = [
        *(f"element {name} {count}" for name in ("vertex", "face", "edge", "tristrips", "x") for count in WORDS),
        *(
            f"property {kind} {name}"
            for kind in ("float", "double", "uchar", "x", "")
            for name in ("x", "red", "s", "")
        ),
        *(f"property list {kinds} vertex_indices" for kinds in ("uchar int", "int int", "float float")),
        *("property list char double texcoord", "property list uchar float texcoord", "property int vertex1"),
        *(f"comment TextureFile {name}" for name in REFERENCES),
        *("format binary_big_endian 1.0", "format ascii 1.0", "format x", "end_header", "ply"),
    ]
    return _lines(rng, head, words) + rest


def _glb(rng, content: bytes) -> bytes:
    """A GLB whose scene is mutated, with lengths that fit again, or not."""
    if len(content) < 28:
        return content
    (length,) = struct.unpack_from("<I", content, 12)
    try:
        scene = json.loads(content[20 : 20 + length])
    except ValueError:
        return damage(rng, content)
    for _ in range(pick(rng, [0, 1, 1, 2])):
        _mutate_scene(rng, scene)
    if rng.random() < 0.5:
        scene = mutate_values(rng, scene, _JSON)
    text = json.dumps(scene, default=str).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    said = len(text) if rng.random() < 0.9 else pick(rng, [0, 4, 2**31, 2**32 - 1, len(text) + 400])
    whole = 20 + len(text) + len(rest) if rng.random() < 0.9 else pick(rng, [0, 12, 2**32 - 1])
    head = struct.pack("<4sIIII", b"glTF", pick(rng, [2, 2, 2, 2, 1, 3]), whole, said, 0x4E4F534A)
    return head + text + rest


def _mutate_scene(rng, scene: dict) -> None:
    kind = int(rng.integers(5))
    if kind == 0:
        scene["buffers"] = [{"uri": pick(rng, REFERENCES), "byteLength": 100}, *_list(scene, "buffers")]
    elif kind == 1:
        scene["images"] = [{"uri": pick(rng, REFERENCES)}] * pick(rng, [1, 50])
        scene["textures"] = [{"source": 0}]
        scene["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        for one in _primitives(scene):
            one["material"] = 0
    elif kind == 2:
        for one in _list(scene, "accessors"):
            one[pick(rng, ["count", "byteOffset", "componentType", "bufferView"])] = copy.deepcopy(pick(rng, _JSON))
            one["type"] = pick(rng, ["VEC3", "SCALAR", "MAT4", "VEC2", "x"])
        for view in _list(scene, "bufferViews"):
            view[pick(rng, ["byteStride", "byteOffset", "byteLength", "buffer"])] = copy.deepcopy(pick(rng, _JSON))
    elif kind == 3:
        nodes = _list(scene, "nodes")
        count = pick(rng, [1, 10, 2000])
        start = len(nodes)
        chain = [{"children": [start + k + 1], "mesh": 0, "name": pick(rng, ["a", f"n{k}"])} for k in range(count)]
        chain[-1]["children"] = [pick(rng, [0, start, 10**9, -1])]
        matrices = [[float("nan")] * 16, [0] * 16, [1e300] * 16, [1], "x", np.eye(4).ravel().tolist()]
        chain[0]["matrix"] = pick(rng, matrices)
        scene["nodes"] = [*nodes, *chain]
        scene["scenes"] = [{"nodes": [0, start]}]
    else:
        used = pick(rng, ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_transform", "x"])
        scene["extensionsUsed"] = scene["extensionsRequired"] = [used]
        for one in _primitives(scene):
            one["extensions"] = {used: pick(rng, [{}, {"bufferView": 0, "attributes": {"POSITION": 0}}, [], 1])}
            one["mode"] = pick(rng, [0, 1, 3, 4, 5, 6, 99, "x"])


def _list(holder: dict, key: str) -> list[dict]:
    """The records that a scene has there; a damaged scene may have something else."""
    found = holder.get(key)
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _primitives(scene: dict) -> list[dict]:
    return [one for mesh in _list(scene, "meshes") for one in _list(mesh, "primitives")]


def _dae(rng, content: bytes) -> bytes:
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError):
        return damage(rng, content)
    elements = list(root.iter())
    tag = root.tag.rsplit("}", 1)[0] + "}"
    one = pick(rng, elements)
    kind = int(rng.integers(7))
    if kind == 0:
        image = ElementTree.SubElement(ElementTree.SubElement(root, f"{tag}library_images"), f"{tag}image", {"id": "i"})
        ElementTree.SubElement(image, f"{tag}init_from").text = pick(rng, REFERENCES)
    elif kind == 1:
        name = pick(rng, ["instance_geometry", "instance_node", "instance_controller", "node", "instance_visual_scene"])
        for _ in range(pick(rng, [1, 2, 300])):
            url = pick(rng, ["#geometry0", "#node0", "#x", "", f"{SECRET}#x", "file:///etc/passwd", "/etc/passwd"])
            one.append(ElementTree.Element(tag + name, {"url": url}))
    elif kind == 2:
        texts = [element for element in elements if element.text and element.text.strip()]
        if texts:
            element = pick(rng, texts)
            words = element.text.split()
            for _ in range(pick(rng, [1, 3])):
                words[int(rng.integers(len(words)))] = pick(rng, WORDS)
            element.text = " ".join(words)
    elif kind == 3:
        for element in elements:
            for key in ("count", "stride", "offset", "meter", "source"):
                if element.get(key) and rng.random() < 0.3:
                    element.set(key, pick(rng, WORDS))
    elif kind == 4:
        ElementTree.SubElement(pick(rng, elements), f"{tag}matrix").text = " ".join([pick(rng, NUMBER_TEXTS)] * 16)
    else:
        mutate_tree(rng, root, [tag + name for name in ("node", "mesh", "triangles", "polylist", "p", "source", "x")])
    try:
        return encode_xml(rng, write_tree(rng, root), 0.0)
    except (TypeError, ValueError, RecursionError):
        return content


_MUTATIONS = {
    "stl": _stl,
    "ascii.stl": _ascii_stl,
    "obj": _obj,
    "ply": _ply,
    "ascii.ply": _ply,
    "off": _off,
    "glb": _glb,
    "dae": _dae,
}


def write_references(rng, folder: Path) -> None:
    """What meshes name: materials and pictures, one of them a bomb; a pipe, a folder, links out and to nowhere."""
    lines = ["newmtl m", "Kd 1 0 0", f"map_Kd {pick(rng, REFERENCES)}", f"map_Kd {pick(rng, ['nan', 'beside.png'])}"]
    (folder / "beside.mtl").write_text("\n".join(lines[: int(rng.integers(5))]))
    (folder / "beside.png").write_bytes(damage(rng, write_png(4, 4), 0.3))
    (folder / "bomb.png").write_bytes(write_png(pick(rng, [6000, 20_000]), pick(rng, [6000, 20_000])))
    write_odd_files(folder, ".stl")
    write_odd_files(folder, ".png", ["secret"])


@functools.cache
def write_png(width: int, height: int) -> bytes:
    """A grey picture that takes no space."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    squeeze = zlib.compressobj(9)
    rows = b"".join(squeeze.compress(b"\0" * (width + 1)) for _ in range(height)) + squeeze.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
