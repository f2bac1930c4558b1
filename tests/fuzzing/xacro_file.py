"""Hands as xacro files that nobody trusts: expressions, macros, properties, includes and comments that try for more
than arithmetic.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import own_hands

from fuzzing import mesh, urdf
from fuzzing.material import NAMES, NUMBER_TEXTS, damage, encode_xml, mutate_tree, pick, write_tree

TIME_LIMIT = urdf.TIME_LIMIT
NAMESPACE = "http://www.ros.org/wiki/xacro"
SYSTEM = "[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == '_wrap_close'][0].__init__.__globals__['system']('touch ran')"
HARMFUL = [
    *(SYSTEM, "__import__('os').system('touch ran')", "exec('1')", "open('/etc/passwd')", "load_yaml('/etc/passwd')"),
    *("load_yaml('secret.yaml')", "xacro.load_yaml('secret.yaml')", "xacro.print_location()", "xacro.fatal('x')"),
    *("().__class__", "math.__dict__", "vars()", "type(1)", "getattr(1, 'real')", "_", "__builtins__", "None"),
    "Ellipsis",
    *("9**9**9", "9**9**9 > 1", "factorial(10**8)", "1 << 10**9", "comb(10**9, 10**8)", "perm(10**7)"),
    "round(1, -10**9)",
    *("'a' * 10**9", "[0] * 10**9", "'%1000000000d' % 1", "range(10**9)", "str(1) * 9999", "[[1] * 9000] * 9000"),
    *("prod([10**300] * 9000)", "lcm(10**300, 3**600)", "int('9' * 5000)", "10**400", "2.0**5000", "float('nan')"),
    "1/0",
    *("-" * 3000 + "1", "(" * 300 + "1" + ")" * 300, "1+" * 4000 + "1", "'%c' % 36", "'x'.join(['a'])", "b'x'", "1j"),
    *("(lambda: 1)()", "[x for x in [1]]", "f'{1}'", "{1: 2}", "a := 1", "list(map(str, [1]))", "sorted([2, 1])"),
    *("python.map(str, [1])", "1 if 2 else 3", "len", "sin", "math", "a", "n + 1", "\u0661 + 1", "1 +", "", " "),
]
TEXTS = [
    *("${{{}}}", "${{{}}}{{}}", "$${{{}}}", "${{ ${{{}}} }}", "$({})", "$(arg {})", "$(env HOME)", "$(optenv HOME x)"),
    *("$(eval {})", "$(find x)", "$(dirname)", "$(cwd)", "$", "$$", "$$$", "${{", "$(", "}}", "${{'$'}}{{{}}}"),
    "^|${{{}}}",
    *("x$y", "$(arg n)", "${{n}}", "${{a}}${{a}}", "${{{}}}" * 50, "${{{}}}" * 2000),
]
WORDS = "property macro if unless include insert_block arg call element attribute m n ns.m unknown".split()
TAGS = [f"{{{NAMESPACE}}}{name}" for name in WORDS]
ATTRIBUTES = [
    *"name value default scope lazy_eval remove params filename ns optional macro x y".split(),
    *(f"{{{NAMESPACE}}}name", f"{{{NAMESPACE}}}x"),
]
PARAMS = [
    *("x y", "x:=1", "x:=${%s}", "x:=^|2", "x:=^", "*b", "**b", "x:='%s'", "x:=" + "a" * 3000 + "'", "x:=$(arg n)"),
    *("x x", ":=", 'x:="a b" *b **c', "x:=" + "'a' " * 500, "=" * 500),
]
FILES = [
    *mesh.REFERENCES,
    *("part.xacro", "hand.xacro", "sub/part.xacro", "../case/part.xacro", "sub/../part.xacro", "*.xacro", "gone.xacro"),
    *("${a}.xacro", "$(find x)/a.xacro", "sub", "[p]art.xacro", "latin.xacro"),
]


def prepare() -> None:
    import pinograsp

    pinograsp.load_hand  # noqa: B018 - imports what it needs


def make(rng: np.random.Generator, folder: Path) -> dict:
    ElementTree.register_namespace("xacro", NAMESPACE)
    root = ElementTree.fromstring(_write_sound(rng))
    _spice(rng, root)
    for _ in range(pick(rng, [0, 0, 0, 1, 1, 2, 4, 8])):
        if rng.random() < 0.6:
            _mutate(rng, root)
        else:
            mutate_tree(rng, root, [*urdf.TAGS, *TAGS])
    if rng.random() < 0.3:
        mesh.write_meshes(rng, folder)
    else:
        (folder / "box.stl").write_bytes(b"solid")
    text = write_tree(rng, root)
    for share, front, start, end in (
        (0.2, ["<!-- xacro:eval-comments -->", "<!-- xacro:eval-comments:on --> ", "<?xacro eval?>"], "<!-- ", " -->"),
        (0.05, [""], "<![CDATA[", "]]>"),
    ):
        if rng.random() < share:
            place = pick(rng, [0, *(match.end() for match in re.finditer(">", text))][:200])
            text = text[:place] + pick(rng, front) + start + _write_text(rng).replace("--", "") + end + text[place:]
    path = folder / "hand.xacro"
    path.write_bytes(encode_xml(rng, text))
    (folder / "sub").mkdir()
    (folder / "secret.yaml").write_text("key: hidden")
    link = f"<link name={_write_text(rng)!r}/>".replace("<", "").replace("link", "<link", 1)
    part = f'<robot xmlns:xacro="{NAMESPACE}">{pick(rng, ["", link, _write_bomb(rng)])}</robot>'
    for name in ("part.xacro", "sub/part.xacro", "latin.xacro"):
        content = part.encode("latin-1" if name == "latin.xacro" else "utf-8", "replace")
        (folder / name).write_bytes(damage(rng, content, 0.15))
    arguments = {"n": pick(rng, ["1", "${a}", "$(env HOME)", "$", *NUMBER_TEXTS])} if rng.random() < 0.3 else {}
    return {"hand": str(path), "mesh": str(folder / "box.stl"), **urdf.draw_options(rng), "arguments": arguments}


def run(case: dict) -> str:
    """As for URDF; and nothing of it may have run."""
    try:
        return urdf.run({**case, "options": {**case["options"], "xacro_args": case["arguments"]}})
    finally:
        assert not (Path(case["hand"]).parent / "ran").exists(), "a command ran"


def _write_sound(rng) -> str:
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


def _write_text(rng) -> str:
    made = pick(rng, TEXTS)
    return made.format(*[pick(rng, HARMFUL)] * 3000) if "{}" in made else made.replace("{{", "{").replace("}}", "}")


def _spice(rng, root) -> None:
    """Expressions in place of some numbers: harmless ones mostly."""
    harmless = ["{0}*1", "max({0}, {0})", "{0} if a > 0 else 1", "sqrt({0}**2)", "0 + {0}"]
    for element in root.iter():
        for key, value in element.attrib.items():
            if rng.random() < 0.03 and re.fullmatch(r"-?[\d.]+", value):
                element.set(key, "${" + pick(rng, harmless).format(value) + "}")


def _mutate(rng, root) -> None:
    elements = list(root.iter())
    one = pick(rng, elements)
    kind = int(rng.integers(7))
    if kind == 0 and one.attrib:
        one.set(pick(rng, list(one.attrib)), _write_text(rng))
    elif kind == 1:
        one.text = _write_text(rng)
    elif kind == 2:
        space = {"ns": "ns"} if rng.random() < 0.2 else {}
        one.insert(0, ElementTree.Element(TAGS[4], {"filename": pick(rng, FILES), **space}))
    elif kind == 3:
        values = [*NAMES, *NUMBER_TEXTS, _write_text(rng), _write_text(rng)]
        values += "a n m x xacro:include xacro:m global parent true false".split()
        attributes = {pick(rng, ATTRIBUTES): pick(rng, values) for _ in range(rng.integers(0, 4))}
        one.insert(int(rng.integers(len(one) + 1)), ElementTree.Element(pick(rng, TAGS), attributes))
    elif kind == 4:
        params = pick(rng, PARAMS)
        params = params % pick(rng, HARMFUL) if "%s" in params else params
        name = pick(rng, ["m", "n", "call", "a.b", "xacro:m", ""])
        macro = ElementTree.Element(TAGS[1], {"name": name, "params": params})
        for _ in range(rng.integers(0, 4)):
            ElementTree.SubElement(macro, pick(rng, TAGS), {"name": "b"} if rng.random() < 0.5 else {})
        one.insert(0, macro)
    elif kind == 5:
        holder = ElementTree.fromstring(f'<r xmlns:xacro="{NAMESPACE}">{_write_bomb(rng)}</r>')
        for i, child in enumerate(holder):
            root.insert(i, child)
    else:
        for element in pick(rng, [[one], elements]):
            for key, value in list(element.attrib.items()):
                if rng.random() < 0.2:
                    start = pick(rng, ["${", "$${", "${ ", "$(arg n)${", "${-", "${1*"])
                    element.set(key, value.replace("${", start))


def _write_bomb(rng) -> str:
    """Macros, properties or blocks that double, or call themselves."""
    n = pick(rng, [3, 10, 30, 60])
    calls = [f"<xacro:b{i + 1}/>" * 2 if i < n else "<link name='z'/>" for i in range(n + 1)]
    macros = "".join(f"<xacro:macro name='b{i}' params=''>{call}</xacro:macro>" for i, call in enumerate(calls))
    doubling = "".join(f"<xacro:property name='p{i + 1}' value='${{p{i}}}${{p{i}}}'/>" for i in range(n))
    block = "<xacro:insert_block name='b'/>"
    again = "<xacro:unless value='${x > 5000}'><xacro:r x='${x + 1}'/></xacro:unless>"
    return pick(
        rng,
        [
            macros + "<xacro:b0/>",
            f"<xacro:property name='p0' value='{'x' * 50}'/>{doubling}<link name='${{p{n}}}'/>",
            f"<xacro:macro name='d' params='*b'><g>{block}{block}</g></xacro:macro>"
            + f"{'<xacro:d>' * n}<g/>{'</xacro:d>' * n}",
            f"<xacro:macro name='r' params='x'>{again}</xacro:macro><xacro:r x='0'/>",
            "<xacro:property name='u' value='${v}'/><xacro:property name='v' value='${u}'/><link name='${u}'/>",
        ],
    )
