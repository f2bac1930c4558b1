"""Hands as MJCF: bodies, defaults, includes, meshes, actuators and couplings, mutated in structure, numbers, names,
counts and bytes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from fuzzing import mesh, urdf
from fuzzing.material import NAMES, NUMBER_TEXTS, damage, encode_xml, mutate_tree, pick, write_number, write_tree

TIME_LIMIT = urdf.TIME_LIMIT
TAGS = """
    mujoco compiler default worldbody body joint freejoint geom inertial frame site asset mesh include equality actuator
    motor position general tendon fixed replicate option contact
""".split()
ATTRIBUTES = """
    class childclass type quat euler axisangle fromto size mesh file meshdir polycoef range mass
""".split()
INCLUDES = [
    *mesh.REFERENCES,
    *("part.xml", "hand.xml", "sub/part.xml", "../case/part.xml", "sub/../part.xml", "fan0.xml", "gone.xml", "box.stl"),
]
GEOMS = [
    '<geom type="box" size="0.01 0.01 0.02"/>',
    '<geom type="capsule" size="0.008 0.02"/>',
    '<geom type="sphere" size="0.01" mass="0.01"/>',
    '<geom type="cylinder" fromto="0 0 0 0 0 0.04" size="0.008"/>',
    '<geom type="mesh" mesh="m0"/>',
    '<geom type="ellipsoid" size="0.01 0.008 0.02"/>',
    '<geom class="pad" pos="0 0 0.02"/>',
    '<geom type="mesh" mesh="m1" mass="0.01"/>',
    '<geom type="box" size="0.01 0.01 0.02" euler="10 20 30"/>',
    '<geom type="capsule" size="0.01 0.01" xyaxes="1 0 0 0 1 0"/>',
]


# Their numbers N are drawn.
MACROS = [
    '<replicate count="N" offset="0 N 0" euler="N 0 0"><body><joint range="0 1"/><geom size="0.01"/></body></replicate>',
    '<replicate count="9" sep="-"><replicate count="N"><geom size="0.01"/></replicate></replicate>',
    '<composite type="cable" curve="s" count="N 1 1" size="1"><geom type="capsule" size="0.01"/></composite>',
    '<flexcomp type="grid" count="N N 3" spacing="0.1 0.1 0.1" name="soft"/>',
    '<attach model="part" body="f00" prefix="a_"/>',
    '<geom type="hfield" hfield="h"/>',
    '<geom type="mesh" mesh="inline"/>',
    '<geom type="mesh" mesh="made"/>',
    '<geom type="box" mesh="m0"/>',
    '<geom type="sdf" mesh="m0"/>',
    '<geom type="capsule" mesh="inline" fitscale="N"/>',
    '<geom type="box" size="0.01 0.01 0.01" material="paint"/>',
    '<plugin plugin="mujoco.elasticity.cable"/>',
    '<body mocap="true"><geom size="0.01"/></body>',
    '<body name="ball" pos="0 0 N"><freejoint/><geom size="0.01" mass="N"/></body>',
]
SECTIONS = {
    "asset": [
        '<mesh name="inline" vertex="0 0 0 N 0 0 0 0.1 0 0 0 0.1"/>',
        '<mesh name="inline" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.1" face="0 1 2 N 2 1"/>',
        '<mesh name="made" builtin="sphere" params="N"/>',
        '<mesh name="made" builtin="supertorus" params="N 0.5 1 1"/>',
        '<mesh name="made" builtin="wedge" params="N N 10 10 0"/>',
        '<hfield name="h" nrow="N" ncol="N" size="1 1 1 1"/>',
        '<hfield name="h" file="box.stl" size="1 1 1 1"/>',
        '<texture name="t" type="2d" builtin="checker" width="N" height="9"/>',
        '<texture name="t" type="cube" file="box.stl"/>',
        '<texture name="t" type="2d" file="/dev/zero"/>',
        '<material name="paint" texture="t" rgba="N 1 1 1"/>',
        '<model name="part" file="part.xml"/>',
        '<model file="hand.xml"/>',
        '<skin name="s" file="box.stl"/>',
    ],
    "size": ['<memory size="N"/>'],
    "equality": [
        '<connect body1="f00" body2="palm" anchor="N 0 0"/>',
        '<connect site1="s" site2="s"/>',
        '<weld body1="f00" body2="palm" relpose="N 0 0 1 0 0 0"/>',
        '<tendon tendon1="t0" polycoef="N 0 0 0 0"/>',
    ],
    "tendon": [
        '<fixed name="narrow" range="0 N"><joint joint="j00" coef="1"/><joint joint="j10" coef="-1"/></fixed>',
        '<spatial name="rope"><site site="s"/><site site="s"/></spatial>',
    ],
    "actuator": [
        '<muscle joint="j00" force="N"/>',
        '<general joint="j00" dyntype="filter" dynprm="N" actdim="N"/>',
        '<cylinder joint="j00" area="N"/>',
        '<adhesion body="f00" ctrlrange="0 N"/>',
        '<dcmotor joint="j00" motorconst="N N" resistance="1"/>',
        '<plugin plugin="mujoco.pid" joint="j00"/>',
        '<position joint="j00" kp="3" delay="N" nsample="9"/>',
    ],
    "keyframe": ['<key qpos="N"/>'],
    "deformable": ['<flex name="x" dim="1" body="palm palm" element="0 1"/>'],
    "extension": ['<plugin plugin="mujoco.elasticity.cable"/>'],
    "custom": ['<numeric name="n" size="N"/>'],
    "sensor": ['<user dim="N"/>'],
}


def prepare() -> None:
    import pinograsp
    import pinograsp.hands.mjcf  # MuJoCo starts a process as it is imported, where its viewer is installed

    pinograsp.load_hand  # noqa: B018 - imports what it needs


def _fill_in(rng, texts: list[str]) -> ElementTree.Element:
    """One of the texts, with numbers in the place of N."""
    counts = ["0", "1", "3", "9", "-1", "200", "1000", "100000", "1000000000", "0.1", "nan", "1e300", ""]
    text = pick(rng, texts)
    while " N" in text or '"N' in text:
        place = min(i for i in (text.find(" N"), text.find('"N')) if i >= 0)
        text = text[: place + 1] + pick(rng, counts) + text[place + 2 :]
    return ElementTree.fromstring(text)


def make(rng: np.random.Generator, folder: Path) -> dict:
    root = ElementTree.fromstring(_write_sound(rng))
    for _ in range(pick(rng, [0, 1, 1, 1, 2, 3, 6])):
        if rng.random() < 0.3:
            _mutate(rng, root)
        else:
            mutate_tree(rng, root, TAGS)
    mesh.write_meshes(rng, folder)
    (folder / "sub").mkdir()
    parts = [
        "<mujocoinclude/>",
        '<mujocoinclude><default><joint damping="1"/></default></mujocoinclude>',
        "<mujoco><body/></mujoco>",
        '<mujocoinclude><include file="part.xml"/></mujocoinclude>',
        "<a" * 1000,
        '<x><include file="../hand.xml"/></x>',
    ]
    part = pick(rng, parts).encode()
    for name in ("part.xml", "sub/part.xml"):
        (folder / name).write_bytes(damage(rng, part, 0.15))
    levels, width = pick(rng, [(7, 50), (3, 3), (2, 900), (30, 1)])
    for level in range(levels):
        inner = f'<include file="fan{level + 1}.xml"/>' * width
        (folder / f"fan{level}.xml").write_text(f"<mujocoinclude>{inner}</mujocoinclude>")
    (folder / f"fan{levels}.xml").write_text("<mujocoinclude>" + "<site/>" * pick(rng, [1, 500]) + "</mujocoinclude>")
    path = folder / "hand.xml"
    path.write_bytes(encode_xml(rng, write_tree(rng, root)))
    chosen = urdf.draw_options(rng)
    chosen["options"].pop("fingers", None)
    return {"hand": str(path), "mesh": str(folder / pick(rng, urdf.MESHES)), **chosen}


run = urdf.run


def _write_sound(rng) -> str:
    """A palm with a few fingers, described in one of the many ways that MJCF has."""
    fingers, actuators, ties, tendons = [], [], [], []
    for i in range(rng.integers(1, 4)):
        chain, length = "", int(rng.integers(1, 4))
        for k in reversed(range(length)):
            kind = pick(rng, ["", 'type="hinge"', 'type="slide"', 'ref="0.1"', 'pos="0 0 0.01"', 'class="soft"'])
            inertial = (
                '<inertial pos="0 0 0.01" mass="0.02" diaginertia="1e-5 1e-5 1e-5"/>' if rng.random() < 0.4 else ""
            )
            geoms = "".join([pick(rng, GEOMS[:3]), *(pick(rng, GEOMS) for _ in range(rng.integers(0, 2)))])
            inner = f'{inertial}<joint name="j{i}{k}" {kind} axis="0 1 0" range="-0.5 1.2"/>{geoms}'
            if rng.random() < 0.2:
                inner = f"<frame pos='0 0 0.001'>{inner}</frame>"
            chain = f'<body name="f{i}{k}" pos="{0.03 * i - 0.03 if not k else 0} 0 0.04">{inner}{chain}</body>'
            number = write_number(rng)
            motors = [
                f'<motor joint="j{i}{k}" ctrlrange="-1 1" gear="2"/>',
                f'<position joint="j{i}{k}" kp="3" forcerange="-2 2"/>',
                f'<general joint="j{i}{k}"/>',
                f'<general joint="j{i}{k}" biastype="affine" gainprm="3" biasprm="0 -3 -0.1"/>',
                f'<velocity joint="j{i}{k}" kv="{number}"/>',
                f'<position joint="j{i}{k}" kp="{number}"/>',
                f'<motor tendon="t{i}"/>',
                "",
            ]
            actuators.append(pick(rng, motors))
            if k and rng.random() < 0.4:
                ties.append(f'<joint joint1="j{i}{k}" joint2="j{i}0" polycoef="0.1 {rng.uniform(-2, 2):.2f} 0 0 0"/>')
        fingers.append(chain)
        second = f'<joint joint="j{i}1" coef="-0.2"/>' if length > 1 else ""
        tendons.append(f'<fixed name="t{i}"><joint joint="j{i}0" coef="0.5"/>{second}</fixed>')
    settings = ['angle="radian"', 'angle="degree"', 'autolimits="true"', 'meshdir="."', 'eulerseq="XYZ"']
    compiler = pick(rng, [*settings, 'inertiafromgeom="true"'])
    pad, soft = "<geom type='box' size='0.01 0.01 0.01'/>", "<joint damping='1' stiffness='0.2' springref='9'/>"
    defaults = f"<default><default class='pad'>{pad}</default><default class='soft'>{soft}</default></default>"
    meshes = "".join(
        f'<mesh name="m{i}" file="{mesh.name_file(rng, urdf.MESHES)}" scale="1 1 {pick(rng, ["1", "1", "-1", write_number(rng)])}"/>'
        for i in range(2)
    )
    palm = f'<body name="palm"><geom type="box" size="0.03 0.03 0.01" mass="0.1"/>{"".join(fingers)}</body>'
    return (
        f'<mujoco model="hand"><compiler {compiler}/>{defaults}<asset>{meshes}</asset><worldbody>{palm}</worldbody>'
        f"<actuator>{''.join(actuators)}</actuator><equality>{''.join(ties)}</equality>"
        f"<tendon>{''.join(tendons)}</tendon></mujoco>"
    )


def _mutate(rng, root) -> None:
    elements = list(root.iter())
    one = pick(rng, elements)
    kind = int(rng.integers(8))

    def pick_among(*tags: str) -> ElementTree.Element:
        return pick(rng, [element for element in elements if element.tag in tags] or elements)

    if kind == 0:
        for _ in range(pick(rng, [1, 1, 3, 100])):
            one.insert(0, ElementTree.Element("include", {"file": pick(rng, INCLUDES)}))
    elif kind == 1:
        inner = pick_among("default", "worldbody", "mujoco")
        for i in range(pick(rng, [3, 50, 150])):
            inner = ElementTree.SubElement(inner, "default", {"class": pick(rng, [f"c{i}", "main", "pad"])})
        ElementTree.SubElement(inner, "joint", {pick(rng, ["range", "axis", "type", "ref"]): write_number(rng)})
    elif kind == 2:
        values = ["pad", "soft", "hinge", "ball", "free", "0 0 0 0", "1 0 0 0", "1 1", "../", "/"]
        one.set(pick(rng, ATTRIBUTES), pick(rng, [*NUMBER_TEXTS, *NAMES, *values]))
    elif kind == 3:
        inner = pick_among("body", "worldbody")
        for _ in range(pick(rng, [3, 90, 150])):
            inner = ElementTree.SubElement(inner, "body", {"pos": "0 0 0.01"})
            ElementTree.SubElement(inner, "joint", {"range": "0 1"})
            ElementTree.SubElement(inner, "geom", {"size": "0.005"})
    elif kind == 4:
        equality = ElementTree.SubElement(root, "equality")
        joints = [element.get("name", "") for element in elements if element.tag == "joint"] or [""]
        for _ in range(pick(rng, [1, 3, 300])):
            ends = {"joint1": pick(rng, joints), "joint2": pick(rng, joints)}
            ElementTree.SubElement(equality, "joint", ends, polycoef=f"{write_number(rng)} {write_number(rng)}")
    elif kind == 5:
        compiler = root.find("compiler")
        keys = ["angle", "meshdir", "assetdir", "strippath", "eulerseq", "autolimits", "inertiagrouprange"]
        values = [*NAMES, "sub", "..", "true", "xYz", "0 1", "1e308 nan"]
        (root if compiler is None else compiler).set(pick(rng, keys), pick(rng, values))
    elif kind == 6:
        pick_among("body", "worldbody").append(_fill_in(rng, MACROS))
    else:
        place, texts = pick(rng, list(SECTIONS.items()))
        section = root.find(place)
        section = ElementTree.SubElement(root, place) if section is None else section
        section.append(_fill_in(rng, texts))
