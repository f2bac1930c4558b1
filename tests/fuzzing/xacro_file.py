"""Hands as xacro files that nobody trusts: expressions, macros, properties, includes and comments that try for more
than arithmetic.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import own_hands

from fuzzing import urdf
from fuzzing.urdf import pick

TIME_LIMIT = urdf.TIME_LIMIT
NAMESPACE = "http://www.ros.org/wiki/xacro"
SYSTEM = "[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == '_wrap_close'][0].__init__.__globals__['system']('touch ran')"
HARMFUL = [
    SYSTEM,
    "().__class__",
    "load_yaml('secret.yaml')",
    "load_yaml('/etc/passwd')",
    "xacro.load_yaml('secret.yaml')",
    "open('/etc/passwd')",
    "python.map(str, [1])",
    "__import__('os').system('touch ran')",
    "9**9**9",
    "9**9**9 > 1",
    "factorial(10**8)",
    "1 << 10**9",
    "'a' * 10**9",
    "[0] * 10**9",
    "comb(10**9, 10**8)",
    "perm(10**7)",
    "round(1, -10**9)",
    "'%1000000000d' % 1",
    "'%c' % 36",
    "(lambda: 1)()",
    "[x for x in [1]]",
    "xacro.print_location()",
    "xacro.fatal('x')",
    "math.__dict__",
    "f'{1}'",
    "{1: 2}",
    "a := 1",
    "exec('1')",
    "-" * 3000 + "1",
    "(" * 300 + "1" + ")" * 300,
    "1+" * 4000 + "1",
    "'x'.join(['a'])",
    "prod([10**300] * 9000)",
    "lcm(10**300, 3**600)",
    "list(map(str, [1]))",
    "sorted([2, 1])",
    "range(10**9)",
    "str(1) * 9999",
    "[[1] * 9000] * 9000",
    "vars()",
    "type(1)",
    "getattr(1, 'real')",
    "_",
    "__builtins__",
    "None",
    "Ellipsis",
    "1j",
    "b'x'",
    "1 if 2 else 3",
    "len",
    "sin",
    "math",
    "int('9' * 5000)",
    "float('nan')",
    "1/0",
    "a",
    "n + 1",
    "\u0661 + 1",
    "1 +",
    "",
    " ",
    "10**400",
    "2.0**5000",
]
TEXTS = [
    "${{{}}}",
    "${{{}}}{{}}",
    "$${{{}}}",
    "${{ ${{{}}} }}",
    "$({})",
    "$(arg {})",
    "$(env HOME)",
    "$(optenv HOME x)",
    "$(eval {})",
    "$(find x)",
    "$(dirname)",
    "$(cwd)",
    "$",
    "$$",
    "$$$",
    "${{",
    "$(",
    "}}",
    "${{'$'}}{{{}}}",
    "^|${{{}}}",
    "x$y",
    "$(arg n)",
    "${{n}}",
    "${{a}}${{a}}",
    "${{{}}}" * 50,
    "${{{}}}" * 2000,
]
TAGS = [
    f"{{{NAMESPACE}}}{name}"
    for name in (
        "property",
        "macro",
        "if",
        "unless",
        "include",
        "insert_block",
        "arg",
        "call",
        "element",
        "attribute",
        "m",
        "n",
        "ns.m",
        "unknown",
    )
]
ATTRIBUTES = [
    "name",
    "value",
    "default",
    "scope",
    "lazy_eval",
    "remove",
    "params",
    "filename",
    "ns",
    "optional",
    "macro",
    "x",
    "y",
    f"{{{NAMESPACE}}}name",
    f"{{{NAMESPACE}}}x",
]
PARAMS = [
    "x y",
    "x:=1",
    "x:=${%s}",
    "x:=^|2",
    "x:=^",
    "*b",
    "**b",
    "x:='%s'",
    "x:=" + "a" * 3000 + "'",
    "x:=$(arg n)",
    "x x",
    ":=",
    'x:="a b" *b **c',
    "x:=" + "'a' " * 500,
    "=" * 500,
]
FILES = [
    "part.xacro",
    "hand.xacro",
    "sub/part.xacro",
    "../case/part.xacro",
    "/etc/hostname",
    "/dev/zero",
    "pipe.stl",
    "*.xacro",
    "${a}.xacro",
    "gone.xacro",
    "$(find x)/a.xacro",
    "sub/../part.xacro",
    "link.stl",
    "x" * 5000,
    "",
    "sub",
    "[p]art.xacro",
    "latin.xacro",
]


def prepare() -> None:
    import pinograsp

    pinograsp.load_hand  # noqa: B018 - imports what it needs


def make(rng: np.random.Generator, folder: Path) -> dict:
    ElementTree.register_namespace("xacro", NAMESPACE)
    root = ElementTree.fromstring(_base(rng))
    _spice(rng, root)
    for _ in range(pick(rng, [0, 0, 0, 1, 1, 2, 4, 8])):
        if rng.random() < 0.6:
            _mutate(rng, root)
        else:
            urdf.mutate(rng, root, [*urdf.URDF_TAGS, *TAGS])
    urdf.write_meshes(rng, folder) if rng.random() < 0.3 else (folder / "box.stl").write_bytes(b"solid")
    text = urdf.nested(rng, ElementTree.tostring(root, encoding="unicode"))
    if rng.random() < 0.2:
        comments = pick(rng, ["<!-- xacro:eval-comments -->", "<!-- xacro:eval-comments:on --> ", "<?xacro eval?>"])
        place = pick(rng, [0, *(match.end() for match in re.finditer(">", text))][:200])
        text = text[:place] + comments + f"<!-- {_text(rng).replace('--', '')} -->" + text[place:]
    if rng.random() < 0.05:
        place = pick(rng, [0, *(match.end() for match in re.finditer(">", text))][:200])
        text = text[:place] + f"<![CDATA[{_text(rng)}]]>" + text[place:]
    path = folder / "hand.xacro"
    path.write_bytes(urdf.damaged(rng, urdf.encoded(rng, urdf.with_bombs(rng, text))))
    (folder / "sub").mkdir()
    (folder / "secret.yaml").write_text("key: hidden")
    part = f'<robot xmlns:xacro="{NAMESPACE}">{pick(rng, ["", "<link name=" + repr(_text(rng)).replace("<", "") + "/>", _bomb(rng)])}</robot>'
    for name in ("part.xacro", "sub/part.xacro", "latin.xacro"):
        (folder / name).write_bytes(
            urdf.damaged(rng, part.encode("latin-1" if name == "latin.xacro" else "utf-8", "replace"))
        )
    arguments = {"n": pick(rng, ["1", "${a}", "$(env HOME)", "$", *urdf.NUMBERS])} if rng.random() < 0.3 else {}
    return {"hand": str(path), "mesh": str(folder / "box.stl"), **urdf.options(rng), "arguments": arguments}


def run(case: dict) -> str:
    """As for URDF; and nothing of it may have run."""
    try:
        return urdf.run({**case, "options": {**case["options"], "xacro_args": case["arguments"]}})
    finally:
        assert not (Path(case["hand"]).parent / "ran").exists(), "a command ran"


def _base(rng) -> str:
    """The shipped xacro file, or one of our own hands within a few macros."""
    if rng.random() < 0.3:
        from pinograsp.hands.catalogue import shipped_folder

        return (shipped_folder() / "humanoid_hand.urdf.xacro").read_text(encoding="utf-8")
    text = own_hands.HANDS[pick(rng, list(own_hands.HANDS))]
    head = f'<robot xmlns:xacro="{NAMESPACE}" name='
    front = """<xacro:arg name="n" default="2"/><xacro:property name="a" value="${pi/3}"/><xacro:property name="b" value="${a * 2 + n}"/>
    <xacro:property name="n" value="$(arg n)"/><xacro:property name="l" value="${[1, 2, [3, 4]]}"/>
    <xacro:macro name="m" params="x:=1 y:=${n} *b"><xacro:if value="${x &lt; 3}"><xacro:insert_block name="b"/></xacro:if></xacro:macro>"""
    text = text.split("?>", 1)[1].strip().replace("<robot name=", head, 1)
    first = text.index(">") + 1
    text = text[:first] + front + text[first:]
    return text.replace('mass value="0.03"', 'mass value="${0.03 + 0*l[2][1]}"').replace(
        'xyz="0 0 0.05"', 'xyz="0 0 ${0.05 + 0*cos(b)}"'
    )


def _text(rng) -> str:
    made = pick(rng, TEXTS)
    return made.format(*[pick(rng, HARMFUL)] * 3000) if "{}" in made else made.replace("{{", "{").replace("}}", "}")


def _spice(rng, root) -> None:
    """Expressions in place of some numbers: harmless ones mostly."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if rng.random() < 0.03 and re.fullmatch(r"-?[\d.]+", value):
                element.set(
                    key,
                    "${"
                    + pick(
                        rng,
                        [
                            f"{value}*1",
                            f"max({value}, {value})",
                            f"{value} if a > 0 else 1",
                            f"sqrt({value}**2)",
                            f"0 + {value}",
                        ],
                    )
                    + "}",
                )


def _mutate(rng, root) -> None:
    elements = list(root.iter())
    one = pick(rng, elements)
    kind = int(rng.integers(7))
    if kind == 0 and one.attrib:
        one.set(pick(rng, list(one.attrib)), _text(rng))
    elif kind == 1:
        one.text = _text(rng)
    elif kind == 2:
        one.insert(
            0,
            ElementTree.Element(
                TAGS[4], {"filename": pick(rng, FILES), **({"ns": "ns"} if rng.random() < 0.2 else {})}
            ),
        )
    elif kind == 3:
        values = [
            *urdf.NAMES,
            *urdf.NUMBERS,
            "a",
            "n",
            "m",
            "x",
            "xacro:include",
            "xacro:m",
            "global",
            "parent",
            "true",
            "false",
            _text(rng),
            _text(rng),
        ]
        attributes = {pick(rng, ATTRIBUTES): pick(rng, values) for _ in range(rng.integers(0, 4))}
        one.insert(int(rng.integers(len(one) + 1)), ElementTree.Element(pick(rng, TAGS), attributes))
    elif kind == 4:
        params = pick(rng, PARAMS)
        params = params % pick(rng, HARMFUL) if "%s" in params else params
        macro = ElementTree.Element(
            TAGS[1], {"name": pick(rng, ["m", "n", "call", "a.b", "xacro:m", ""]), "params": params}
        )
        macro.extend(
            [
                ElementTree.Element(pick(rng, TAGS), {"name": "b"} if rng.random() < 0.5 else {})
                for _ in range(rng.integers(0, 4))
            ]
        )
        one.insert(0, macro)
    elif kind == 5:
        holder = ElementTree.fromstring(f'<r xmlns:xacro="{NAMESPACE}">{_bomb(rng)}</r>')
        for i, child in enumerate(holder):
            root.insert(i, child)
    else:
        for element in pick(rng, [[one], elements]):
            for key in list(element.attrib):
                if rng.random() < 0.2:
                    element.set(
                        key,
                        element.get(key).replace("${", pick(rng, ["${", "$${", "${ ", "$(arg n)${", "${-", "${1*"])),
                    )


def _bomb(rng) -> str:
    """Macros, properties or blocks that double, or call themselves."""
    n = int(pick(rng, [3, 10, 30, 60]))
    kind = int(rng.integers(5))
    if kind == 0:
        calls = [f"<xacro:b{i + 1}/>" * 2 if i < n else "<link name='z'/>" for i in range(n + 1)]
        return (
            "".join(f"<xacro:macro name='b{i}' params=''>{call}</xacro:macro>" for i, call in enumerate(calls))
            + "<xacro:b0/>"
        )
    if kind == 1:
        return (
            "<xacro:property name='p0' value='"
            + "x" * 50
            + "'/>"
            + "".join(f"<xacro:property name='p{i + 1}' value='${{p{i}}}${{p{i}}}'/>" for i in range(n))
            + f"<link name='${{p{n}}}'/>"
        )
    if kind == 2:
        macro = (
            "<xacro:macro name='d' params='*b'><g><xacro:insert_block name='b'/><xacro:insert_block "
            "name='b'/></g></xacro:macro>"
        )
        return macro + "<xacro:d>" * n + "<g/>" + "</xacro:d>" * n
    if kind == 3:
        return (
            "<xacro:macro name='r' params='x'><xacro:unless value='${x > 5000}'><xacro:r x='${x + "
            "1}'/></xacro:unless></xacro:macro><xacro:r x='0'/>"
        )
    return "<xacro:property name='u' value='${v}'/><xacro:property name='v' value='${u}'/><link name='${u}'/>"
