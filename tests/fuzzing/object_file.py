"""Files of one object, URDF and SDF, with meshes beside them, below them, in packages and elsewhere: loaded by a call,
by one line of text, and by a command.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from fuzzing import command_line, mesh
from fuzzing.harness import SECRET, import_public_names
from fuzzing.material import encode_xml, mutate_tree, pick, translate, write_number, write_tree

TIME_LIMIT = 10.0
TAGS = """
    robot sdf model world link joint include inertial mass inertia origin pose collision geometry box sphere cylinder
    capsule ellipsoid mesh submesh uri scale size radii plane
""".split()
# What includes and references should not make anybody read.
_INCLUDES = [
    f"<include><uri>{SECRET}</uri></include>",
    '<include filename="/etc/passwd"/>',
    f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{SECRET}" parse="text"/>',
    '<xacro:include xmlns:xacro="http://www.ros.org/wiki/xacro" filename="/etc/passwd"/>',
    "<?xml-stylesheet href='/etc/passwd'?>",
    "<?python __import__('os').system('touch ran')?>",
    "<plugin filename='libc.so.6' name='x'/>",
    "<!--" + "-" * 3 + ">",
    "<![CDATA[" + "x" * 5000 + "]]>",
]


def make(rng: np.random.Generator, folder: Path) -> dict:
    _write_package(rng, folder)
    kind = pick(rng, ["urdf", "sdf"])
    root = ElementTree.fromstring(_urdf(rng) if kind == "urdf" else _sdf(rng))
    for _ in range(pick(rng, [0, 0, 1, 1, 1, 2, 4])):
        if rng.random() < 0.3:
            _mutate(rng, root)
        else:
            mutate_tree(rng, root, TAGS)
    text = write_tree(rng, root)
    if rng.random() < 0.08:
        text = text.replace("</", pick(rng, _INCLUDES) + "</", 1)
    name = "thing." + pick(rng, [kind] * 8 + ["xml", "stl", "URDF", ""])
    (folder / name).write_bytes(encode_xml(rng, text, 0.1))
    package = pick(rng, [{"thing": "parts"}] * 6 + [{"thing": "gone"}, {"thing": SECRET}, {"": "."}, {"thing": "/"}])
    return {
        "use": pick(rng, ["call", "call", "call", "spec", "spec", "command"]),
        "path": pick(rng, [name] * 80 + ["pipe.stl", "folder.stl", "loop.stl", "gone.urdf", "zero.stl", "", "nul\0"]),
        "weight": pick(
            rng, [*[{}, {}, {"mass": 0.3}, {"density": 500.0}] * 5, {"mass": float("nan")}, {"density": 1e300}]
        ),
        "hulls": bool(rng.random() < 0.4),
        "packages": package if rng.random() < 0.4 else None,
        "pose": pick(rng, [*[None, translate(0, 0, 0)] * 10, translate(float("nan"), 0, 0)]),
    }


def prepare() -> None:
    """Imports, and what the first call of a command compiles."""
    import pinograsp.objects.mjcf_object  # noqa: F401 - MuJoCo starts a process as it is imported, where its viewer is

    import_public_names()
    command_line.capture(["close", *command_line.PLACED])


def run(case: dict) -> str:
    """Load the object and ask it what plans ask of it; nothing that the file names may have run."""
    from pinograsp.objects import load_object, object_from

    weight, hulls = case["weight"], case["hulls"]
    try:
        if case["use"] == "call":
            given = {"packages": case["packages"], "pose": case["pose"]}
            body = load_object(case["path"], hulls=hulls, **weight, **given)
        else:
            fields = {"path": case["path"], "hulls": str(hulls).lower(), **weight}
            text = "file:" + ",".join(f"{key}={value}" for key, value in fields.items())
            if case["use"] == "command":
                return run_command(text.replace("\0", "?"))
            body = object_from(text)
        mesh.look_at(body)
        return f"loaded {type(body).__name__}"
    finally:
        assert not Path("ran").exists(), "a command ran"


def run_command(text: str) -> str:
    """The hand closes on the object, or the command says why not."""
    line = ["close", "--hand", "panda", "--object", text, "--at", command_line.AT]
    code, out, err = command_line.capture(line)
    assert code in command_line.EXIT_CODES and "Traceback" not in err, f"exit code {code}: {err[-3000:]}"
    assert not code or err or out, f"exit code {code} without a word"
    return f"command, exit {code}"


# -- the files ---------------------------------------------------------------------------------------------------------


def _shape(rng, kind: str) -> tuple[str, dict[str, str]]:
    """A shape's name and sizes, most of them sound."""
    name = pick(rng, ["box", "sphere", "cylinder", "capsule", "mesh", "mesh", "mesh"])
    if name == "mesh":
        file = mesh.name_file(rng, [f"box.{kind}" for kind in mesh.FORMATS])
        scale = pick(rng, ["1 1 1", "1 1 1", "0.5 1 -1", "0.001 0.001 0.001", f"{write_number(rng)} 1 1", ""])
        return name, {"filename" if kind == "urdf" else "uri": file, **({"scale": scale} if scale else {})}
    sizes = {"box": ["size"], "sphere": ["radius"]}.get(name, ["radius", "length"])
    return name, {key: "0.02 0.03 0.04" if key == "size" else f"{rng.uniform(0.005, 0.05):.4f}" for key in sizes}


def _place(rng) -> list[str]:
    return [f"{value:.3f}" for value in (*rng.uniform(-0.02, 0.02, 3), *rng.uniform(-1, 1, 3))]


def _inertia(rng) -> dict[str, str]:
    moments = {"ixx": "2e-4", "iyy": "2.5e-4", "izz": "3e-4", "ixy": "1e-6", "ixz": "0", "iyz": "0"}
    if rng.random() < 0.3:
        moments[pick(rng, list(moments))] = write_number(rng)
    return moments


def _urdf(rng) -> str:
    parts = []
    for _ in range(pick(rng, [1, 1, 1, 2, 3])):
        name, sizes = _shape(rng, "urdf")
        place, given = _place(rng), " ".join(f'{key}="{value}"' for key, value in sizes.items())
        origin = f'<origin xyz="{" ".join(place[:3])}" rpy="{" ".join(place[3:])}"/>' if rng.random() < 0.5 else ""
        parts.append(f"<collision>{origin}<geometry><{name} {given}/></geometry></collision>")
    moments = " ".join(f'{key}="{value}"' for key, value in _inertia(rng).items())
    weight = f'<inertial><origin xyz="0 0 0.001"/><mass value="0.3"/><inertia {moments}/></inertial>'
    frame = '<link name="tip"/><joint name="j" type="fixed"><parent link="a"/><child link="tip"/></joint>'
    more = (weight if rng.random() < 0.8 else "") + "".join(parts)
    return f'<robot name="thing"><link name="a">{more}</link>{frame if rng.random() < 0.3 else ""}</robot>'


def _sdf(rng) -> str:
    def elements(values: dict[str, str]) -> str:
        return "".join(f"<{key}>{value}</{key}>" for key, value in values.items())

    parts = []
    for i in range(pick(rng, [1, 1, 1, 2, 3])):
        name, sizes = _shape(rng, "sdf")
        if rng.random() < 0.15:
            name, sizes = "ellipsoid", {"radii": "0.02 0.03 0.04"}
        pose = f"<pose>{' '.join(_place(rng))}</pose>" if rng.random() < 0.5 else ""
        shape = f"<{name}>{elements(sizes)}</{name}>"
        parts.append(f'<collision name="c{i}">{pose}<geometry>{shape}</geometry></collision>')
    weight = f"<inertial><mass>0.3</mass><inertia>{elements(_inertia(rng))}</inertia></inertial>"
    link = (weight if rng.random() < 0.8 else "") + "".join(parts)
    model = f'<model name="thing"><link name="a">{link}</link></model>'
    return f'<sdf version="1.7">{f"<world>{model}</world>" if rng.random() < 0.2 else model}</sdf>'


def _mutate(rng, root) -> None:
    """What these files alone have: texts, repeated shapes, a long list of them, joints, poses in other frames."""
    elements = list(root.iter())
    one = pick(rng, elements)
    kind = int(rng.integers(5))
    texts = [element for element in elements if element.text and element.text.strip()]
    if kind == 0 and texts:
        element = pick(rng, texts)
        words = element.text.split()
        words[int(rng.integers(len(words)))] = pick(rng, [write_number(rng), pick(rng, mesh.REFERENCES)])
        element.text = " ".join(words)
    elif kind == 1:
        links = [element for element in elements if element.tag == "link"] or [root]
        for _ in range(pick(rng, [2, 30, 1100])):
            collision = ElementTree.SubElement(links[0], "collision")
            shape = ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), "sphere", radius="0.01")
            ElementTree.SubElement(shape, "radius").text = "0.01"
            x = f"{rng.uniform(-0.1, 0.1):.3f} 0 0"
            ElementTree.SubElement(collision, "origin", xyz=x)
            ElementTree.SubElement(collision, "pose").text = x + " 0 0 0"
    elif kind == 2:
        ElementTree.SubElement(root, "joint", name="k", type=pick(rng, ["fixed", "revolute", "floating", ""]))
    elif kind == 3:
        key = pick(rng, ["relative_to", "rotation_format", "degrees", "frame"])
        one.append(ElementTree.Element("pose", {key: pick(rng, ["x", "true", "quat_xyzw", ""])}))
        one[-1].text = pick(rng, ["0 0 0 0 0 0", "1 2 3", "nan 0 0 0 0 0", "", "0 0 0 0 0 0 1"])
    else:
        named = [element for element in elements if element.tag in ("mesh", "uri")] or [one]
        element, name = pick(rng, named), pick(rng, mesh.REFERENCES)
        element.text = name
        element.set("filename", name)


def _write_package(rng, folder: Path) -> None:
    """Meshes beside the file and in a package below it."""
    parts = folder / "parts"
    parts.mkdir()
    (parts / "package.xml").write_text(pick(rng, ["<package><name>thing</name></package>", "<package", ""]))
    mesh.write_meshes(rng, folder)
    for path in folder.glob("box.*"):
        (parts / path.name).write_bytes(path.read_bytes())
    (parts / "linked.stl").symlink_to(pick(rng, ["../" + SECRET, "/etc/hostname", "box.stl"]))
