"""Objects as one line of text, ``sphere:radius=0.03,mass=0.2``: all shapes and fields, mutated, loaded by a call or a
command.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fuzzing import mesh, object_file
from fuzzing.material import NAMES, NUMBER_TEXTS, pick, write_odd_files

TIME_LIMIT = 10.0
prepare = object_file.prepare
SPECS = [
    "sphere:radius=0.03,mass=0.2",
    "cylinder:radius=0.02,height=0.12,mass=0.2",
    "capsule:radius=0.02,length=0.06,density=900",
    "box:size=0.03x0.03x0.08,mass=0.1",
    "ellipsoid:semi_axes=0.02x0.03x0.04,mass=0.1",
    "mesh:path=p.stl,scale=1,mass=0.1",
    "mesh:path=p.obj,scale=0.5,convex=true,density=600",
    "mesh:path=parts,scale=1,density=600",
    "mesh:path=parts/*.stl,scale=2,mass=0.3",
    "file:path=thing.urdf,hulls=false,mass=0.3",
    "file:path=thing.urdf,package=thing=parts",
]
FIELDS = ["radius", "height", "length", "size", "semi_axes", "path", "scale", "convex", "hulls", "body", "package"]
TEXTS = [
    *(*NUMBER_TEXTS, *NAMES, "\x1b[2J", "\udcff"),
    *"""
    0.03 30 1e-12 1e12 0.02x0.03 0.02x0.03x0.04 0.02X0.03X0.04 1e308x1e308x1e308 nanx1x1 -0.03 0x0x0 true TRUE false
    p.stl p.obj pipe.stl zero.stl folder.stl loop.stl gone.stl parts parts/* **/* thing=parts = a=b=c thing.urdf
    p.stl,mass=2
    """.split(),
]


def make(rng: np.random.Generator, folder: Path) -> dict:
    for name in ("p.stl", "p.obj"):
        (folder / name).write_bytes(mesh.export_mesh(pick(rng, ["box", "ball", "two"]), name[-3:]))
    (folder / "parts").mkdir()
    for i in range(int(rng.integers(3))):
        (folder / "parts" / f"{i}.stl").write_bytes(mesh.export_mesh("box", "stl"))
    geometry = "<geometry><box size='0.02 0.03 0.04'/></geometry>"
    link = f"<link name='a'><inertial><mass value='0.3'/></inertial><collision>{geometry}</collision></link>"
    (folder / "thing.urdf").write_text(f"<robot name='thing'>{link}</robot>")
    write_odd_files(folder, ".stl")
    text = pick(rng, SPECS)
    for _ in range(int(rng.choice([0, 1, 1, 1, 2, 4]))):
        text = _mutate(rng, text)
    return {"text": text, "use": pick(rng, ["call"] * 7 + ["command"])}


def run(case: dict) -> str:
    """The object is there and finite, or told; nothing that a text names may have run."""
    from pinograsp.objects import object_from

    try:
        if case["use"] == "call":
            mesh.look_at(object_from(case["text"]))
            return "loaded"
        return object_file.run_command(case["text"].replace("\0", "?"))
    finally:
        assert not Path("ran").exists(), "a command ran"


def _mutate(rng: np.random.Generator, text: str) -> str:
    """Another value, name, shape, order, or character."""
    shape, _, rest = text.partition(":")
    parts, how = rest.split(","), rng.random()
    at = int(rng.integers(len(parts)))
    name, _, value = parts[at].partition("=")
    if how < 0.45:
        parts[at] = f"{name}={pick(rng, TEXTS)}"
    elif how < 0.55:
        parts[at] = f"{pick(rng, [*FIELDS, 'mass', 'density', 'Radius', '', ' '])}={value}"
    elif how < 0.65:
        shape = pick(rng, ["sphere", "box", "mesh", "file", "Sphere", "spere", "", "cylinder ", "a" * 300])
    elif how < 0.75:
        parts.insert(at, f"{pick(rng, [*FIELDS, 'mass', 'density'])}={pick(rng, TEXTS)}")
    elif how < 0.85:
        del parts[at]
    else:
        text = f"{shape}:{','.join(parts)}"
        i = int(rng.integers(len(text) + 1))
        return text[:i] + pick(rng, [":", ",", "=", " ", "\n", "\0", "x", "", ",,", "'", "\\"]) + text[i + 1 :]
    return f"{shape}:{','.join(parts)}"
