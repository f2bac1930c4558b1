"""What hostile inputs of all kinds are made of: numbers, names, and the damage done to bytes, plain values, trees of XML
and folders.
"""

from __future__ import annotations

import copy
import math
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from fuzzing.harness import SECRET

NUMBERS = [
    *(0, -0.0, 1, -1, 2, 3, 0.5, 3.5, 90.0, 100, 1e3, 1 + 1e-10, -7),
    *(1e-3, 1e-6, 1e-9, -1e-9, 1e-11, 1e-30, 1e-300, 1e-320, 5e-324),
    *(1e6, 1e9, -1e9, 1e11, 1e30, -1e30, 1e31, 1e39, 1e100, 1e154, 1e200, 1e308, -1e308),
    *(7, 255, 2**31, 2**32 - 1, 2**32, 4_000_000_000, 2**63, -(2**63), 2**64, 10**18, 10**30, 10**400),
    *(math.nan, math.inf, -math.inf),
]
NUMBER_TEXTS = [
    *map(repr, NUMBERS),
    *("1e", "1e99999", "0x10", "1_0", "1,5", "1;5", "1 2", "1 2 3 4 5 6 7", "1.5.2", "--1", "1\t", "1+1j", "[1]"),
    *("", " ", "x", "one", "True", "None", "\u0661", "9" * 30, "9" * 400, "9" * 5000),
]
# Names that a text of any format can hold, and those that most cannot.
NAMES = [
    *("", " ", "a", "0", "-1", "0001 a", "a b\tc", "a\nb", "x" * 300, "x" * 5000, "a/" * 3000, "None", "nan", "1e5"),
    *("..", ".", "/", "../up", "../../etc/passwd", "/dev/zero", "a/b", "a.b", "nothing.urdf", "~nobody/x", "[", "[]"),
    *("'", '"', "\\", "'; --", "`code`", "$(touch ran)", "$(find x)", "${1}", "{x}", "%s%n", "=1+1", "@x", "\t=1", "#"),
    *("&lt;", "-->", "]]>", "<script>alert(1)</script>", "a|b", "**b**", "# h", "1. x", "tip ![x](plan.json)"),
    *("tip ![x](/etc/hostname)", "$x^2$", "$\\frac{1}{0", "$" * 9, "_hidden", "time,time"),
    *("\u00e4\u2603\u202e", "\u202egnp", "\u540d\u524d", "\U0001f590", "joint\u0301", "\ufeff", "nul\u2400"),
    *("thumb", "palm", "base", "universe", "world", "root", "tip"),
]
UNWRITABLE = ["\0", "a\x00b", "\x1b[2J", "\ud800", "\udcff"]


def pick(rng: np.random.Generator, choices: Sequence):
    return choices[int(rng.integers(len(choices)))]


def write_number(rng) -> str:
    if rng.random() < 0.6:
        return pick(rng, NUMBER_TEXTS)
    return repr(float(rng.normal() * 10.0 ** rng.uniform(-14, 14)))


def translate(*position: float) -> np.ndarray:
    """The placement (4, 4) of a frame at a position [m], not turned."""
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


# -- bytes -------------------------------------------------------------------------------------------------------------


def damage(rng, content: bytes, share: float = 1.0, pieces: Sequence[bytes] = ()) -> bytes:
    """Bytes changed, cut out, repeated, cut off, or with some of the ``pieces`` between them, in a ``share`` of cases."""
    if rng.random() > share or not content:
        return content
    data = bytearray(content)
    for _ in range(pick(rng, [1, 1, 2, 3, 5, 8])):
        i, size, kind = int(rng.integers(len(data) + 1)), pick(rng, [1, 2, 10, 40, 200]), int(rng.integers(6))
        if pieces and rng.random() < 0.5:
            data[i:i] = pick(rng, pieces)
        elif kind == 0:
            data[i : i + 1] = rng.bytes(1)
        elif kind == 1:
            data[i : i + 1] = bytes(byte ^ 1 << int(rng.integers(8)) for byte in data[i : i + 1])
        elif kind == 2:
            del data[i : i + size]
        elif kind == 3:
            data[i:i] = data[i : i + size] * pick(rng, [1, 2, 50])
        elif kind == 4:
            data[i:i] = rng.bytes(min(size, 12))
        elif rng.random() < 0.3:
            del data[i:]
    return bytes(data)


# -- plain values ------------------------------------------------------------------------------------------------------


def list_paths(value, path=()):
    """The paths of all values within plain ones, their own first."""
    yield path
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield from list_paths(value[key], (*path, key))


def look_up(value, path):
    for key in path:
        value = value[key]
    return value


def mutate_values(rng, data, values: Sequence, names: Sequence = (*NAMES, *UNWRITABLE)):
    """A copy of plain values with one to six of them changed, removed, doubled, renamed, or nested deeper."""
    data, mild = copy.deepcopy(data), rng.random() < 0.4  # numbers alone, and not by much
    for _ in range(pick(rng, [1, 1, 1, 2, 3, 6])):
        paths = list(list_paths(data))[1:]
        if not paths:
            return data
        # Lists of numbers can be long; what stands before them has more meaning.
        path = paths[int(rng.integers(len(paths)) * (pick(rng, [0.05, 1, 1]) if len(paths) > 300 else 1))]
        *above, key = path
        holder, how = look_up(data, above), rng.random()
        old = holder[key]
        number = isinstance(old, int | float) and not isinstance(old, bool) and abs(old) < 1e300
        if mild or (how < 0.3 and number):
            factors = [0.5, 0.9, 0.99, 1 + 1e-9, 1.1, 2, 10, 1e3, 1e-3, -1]
            if number:
                holder[key] = old * float(pick(rng, factors if mild else [*factors, 0, 1e6, 1e-6, 1e12, rng.normal()]))
        elif how < 0.6:
            holder[key] = copy.deepcopy(pick(rng, values))
        elif how < 0.72:
            del holder[key]
        elif how < 0.79 and isinstance(holder, list):
            holder[key:key] = [copy.deepcopy(old)] * pick(rng, [1, 2, 30, 300])
        elif how < 0.9 and isinstance(holder, dict):
            renamed = pick(rng, [pick(rng, names), "name", 1, str(key).upper(), f"{key} "])
            holder[renamed] = holder.pop(key)
        elif how < 0.97:
            holder[key] = copy.deepcopy(look_up(data, pick(rng, list(list_paths(data)))))  # another part in its place
        else:
            for _ in range(pick(rng, [1, 20, 60])):  # six times over, still what the writer of YAML can bear
                old = [old] if rng.random() < 0.5 else {"a": old}
            holder[key] = old
    return data


def dump_yaml(data) -> bytes:
    text: str = yaml.safe_dump(data, allow_unicode=bool(len(str(data)) % 2))
    return text.encode("utf-8", "surrogatepass")


# -- trees of XML ------------------------------------------------------------------------------------------------------


def mutate_tree(rng, root, tags: Sequence[str]) -> None:
    """One change of a tree, in place."""
    elements = list(root.iter())
    one, other = pick(rng, elements), pick(rng, elements)
    parents = {child: parent for parent in elements for child in parent}
    kind, keys = int(rng.integers(14)), list(one.attrib)
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
            values[int(rng.integers(len(values)))] = write_number(rng)
            element.set(key, " ".join(values[: None if rng.random() < 0.9 else 1]))
    elif kind == 4 and keys:
        one.set(pick(rng, keys), pick(rng, [*NAMES, *NUMBER_TEXTS]))
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
        key = pick(rng, ["name", "value", "xyz", "size", "type", "link"])
        ElementTree.SubElement(one, pick(rng, tags), {key: pick(rng, [*NAMES, *NUMBER_TEXTS])})
    elif kind == 11 and one in parents and other is not one and one not in other.iter() and other not in one.iter():
        parents[one].remove(one)
        other.append(one)
    elif kind == 12:
        deep = one
        for _ in range(pick(rng, [3, 50, 150])):
            deep = ElementTree.SubElement(deep, pick(rng, tags[:3]) if rng.random() < 0.01 else one.tag)
    else:
        one.text = pick(rng, [*NAMES, *NUMBER_TEXTS])


def write_tree(rng, root: ElementTree.Element) -> str:
    """The text of a tree, with one element very deep in some cases."""
    text = ElementTree.tostring(root, encoding="unicode")
    if rng.random() > 0.03:
        return text
    depth, tag = pick(rng, [900, 1500, 20_000, 200_000]), pick(rng, ["a", "link", "joint", "body", "default", "frame"])
    return text.replace("</", f"<{tag}>" * depth + f"</{tag}>" * depth + "</", 1)


def encode_xml(rng, text: str, share: float = 0.15) -> bytes:
    """A text of XML as bytes: behind a document type, or in another encoding than it says, or damaged, in some cases."""
    text = _add_document_type(rng, text).encode("utf-8", "replace").decode()
    content = text.encode()
    if rng.random() > 0.9:
        encodings = {"utf-8-sig": "utf-8", "utf-16-le": "utf-16", "latin-1": "iso-8859-1"}
        same = ["utf-16", "utf-32", "cp1252"]
        no_text = ["punycode", "utf-7", "nonsense", "rot13", "zip"]
        encoding, declared = pick(
            rng, [*encodings.items(), *((name, name) for name in same), *(("utf-8", name) for name in no_text)]
        )
        content = f'<?xml version="1.0" encoding="{declared}"?>{text}'.encode(encoding, "replace")
    return damage(rng, content, share)


def _add_document_type(rng, text: str) -> str:
    """A document type in front, entities that grow or name files, in some cases."""
    if rng.random() > 0.05 or text.startswith("<?xml"):
        return text
    name = text[1:].split(">")[0].split()[0] if text.startswith("<") else "robot"
    growing = "".join(f"<!ENTITY a{i + 1} '{f'&a{i};' * 10}'>" for i in range(9))
    rest = pick(
        rng,
        [
            "",
            " SYSTEM '/etc/hostname'",
            " [<!ENTITY e SYSTEM 'file:///etc/hostname'>]",
            f" [<!ENTITY a0 'aaaaaaaaaa'>{growing}]",
            " [<!ENTITY % p SYSTEM 'http://localhost/x'> %p;]",
        ],
    )
    return f"<!DOCTYPE {name}{rest}>" + text.replace("</", pick(rng, ["</", "&a9;</", "&e;</"]), 1)


# -- folders -----------------------------------------------------------------------------------------------------------

ODD = ("pipe", "folder", "zero", "loop")


def write_odd_files(folder: Path, suffix: str, names: Sequence[str] = ODD) -> None:
    """What is no regular file, or far too large: pipes, folders, and links to devices, to themselves and outside."""
    links = {"zero": "/dev/zero", "loop": f"loop{suffix}", "secret": SECRET, "tty": "/dev/tty"}
    for name in names:
        path = folder / f"{name}{suffix}"
        if name == "pipe":
            os.mkfifo(path)
        elif name == "folder":
            path.mkdir()
        elif name == "sparse":
            path.touch()
            os.truncate(path, 2**36)
        elif name in links:
            path.symlink_to(links[name])


def write_odd_file(rng, folder: Path, suffix: str) -> str:
    """The name of one of them, or of none that is there."""
    name = pick(rng, [*ODD, "gone", "sparse", "tty"])
    write_odd_files(folder, suffix, [name])
    return f"{name}{suffix}"
