"""MJCF files made one text: what they include and attach is found, checked and read here, so that MuJoCo opens none.

What has no part in how a hand moves, touches and looks (sensors, key frames, soft bodies) is left out.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

from pinograsp.checks import shorten
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import MOST_ELEMENTS, floats, parse_xml, read_bytes
from pinograsp.hands.file_reads import is_there

_MOST_INCLUDES, _DEEPEST, _MOST_CLASSES = 1000, 20, 2000
_MOST = {"body": 2000, "joint": 2000, "geom": 10_000, "default": _MOST_CLASSES}
_MOST_PARAMETER = 1000.0  # of built-in meshes, whose triangles grow with its square
# They make many elements of one.
_COPIES = {"replicate": "count", "composite": "count"}
_DROPPED = ("size", "option", "visual", "statistic", "sensor", "keyframe", "custom", "deformable", "flexcomp")
_TOLD = ("deformable", "flexcomp")
_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")


class MjcfDocument:
    """An MJCF file made one text, in which files are named by their whole paths.

    Attributes:
        models: texts of models that it attaches, by the names that it has for them then.
        problems, notes: found on the way.
    """

    def __init__(self, name: str, folder: Path, trusted: bool):
        self.name, self.folder, self.trusted = name, folder, trusted
        self.models: dict[str, bytes] = {}
        self.problems: list[str] = []
        self.notes: list[str] = []
        self._size, self._includes = 0, 0

    def read(self, element: ElementTree.Element, path: Path, above: tuple[Path, ...] = ()) -> str:
        """The text of a model, whose files are included, and those it attaches in ``models``."""
        above = (*above, path.resolve())
        self._count(element)
        beside: dict[ElementTree.Element, Path] = {}
        self._include(element, path, above, beside)
        if not above[1:] and element.find("worldbody") is None:
            raise HandNotLoaded(self.name, [*self.problems, "no <worldbody> found: expected a model with bodies"])
        self._drop(element)
        self._check_copies(element)
        for tag, most in _MOST.items():
            if (count := sum(1 for _ in element.iter(tag))) > most:
                raise HandNotLoaded(self.name, f"expected at most {most} elements <{tag}>, got {count}")
        compiler: dict[str, str] = {}
        for one in element.findall("compiler"):
            compiler |= one.attrib
            for key in ("meshdir", "texturedir", "assetdir", "strippath"):
                one.attrib.pop(key, None)
        for asset in element.findall("asset/*"):
            if asset.tag == "model":
                self._attach(asset, path, above)
            else:
                self._name_files(asset, path.resolve().parent, beside.get(asset), compiler)
        return ElementTree.tostring(element, encoding="unicode")

    def _count(self, element: ElementTree.Element) -> None:
        self._size += sum(1 for _ in element.iter())
        if self._size > MOST_ELEMENTS:
            raise HandNotLoaded(self.name, f"expected at most {MOST_ELEMENTS} elements, with those of included files")

    # -- included and attached files -----------------------------------------------------------------------------------

    def _include(
        self, element: ElementTree.Element, path: Path, above: tuple[Path, ...], beside: dict[ElementTree.Element, Path]
    ) -> None:
        """Put what an element includes, on any level, in place; ``beside``: folders of what is included."""
        waiting = [element]
        while waiting:
            parent = waiting.pop()
            for child in list(parent):
                if child.tag != "include":
                    waiting.append(child)
                    continue
                place = list(parent).index(child)
                parent.remove(child)
                opened = self._open(child, path, above)
                if opened is None:
                    continue
                found, included = opened
                self._count(included)
                self._include(included, found, (*above, found), beside)
                for one in included.iter():
                    beside.setdefault(one, found.parent)
                parent[place:place] = list(included)

    def _attach(self, asset: ElementTree.Element, path: Path, above: tuple[Path, ...]) -> None:
        """Read a model that may be attached, and name it by what MuJoCo is given for it."""
        opened = self._open(asset, path, above)
        if opened is None:
            return
        found, element = opened
        asset.set("name", asset.get("name") or element.get("model") or found.stem)
        asset.set("file", key := f"{len(self.models)}.xml")
        self.models[key] = b""  # the name is taken while its own are read
        self.models[key] = self.read(element, found, above).encode()

    def _open(
        self, element: ElementTree.Element, path: Path, above: tuple[Path, ...]
    ) -> tuple[Path, ElementTree.Element] | None:
        """The file that an element names, and its outermost element; None and a problem where it cannot be used."""
        self._includes += 1
        if self._includes > _MOST_INCLUDES or len(above) > _DEEPEST:
            raise HandNotLoaded(
                self.name,
                f"expected at most {_MOST_INCLUDES} included files, {_DEEPEST} deep: it includes more, or itself",
            )
        name = element.get("file", "")
        try:
            found = next((p.resolve() for p in (path.parent / name, self.folder / name) if is_there(p)), None)
            if found is None:
                raise ValueError("no such file")
            if not (self.trusted or found.is_relative_to(self.folder)):
                raise ValueError(
                    "outside the first file's own folder (symbolic links followed): pass trusted=True if you trust "
                    "this file"
                )
            if found in above:
                raise ValueError("includes itself")
            return found, parse_xml(read_bytes(found))
        except (OSError, ValueError) as error:
            self.problems.append(f"<{element.tag} file={shorten(name)}>: {error}")
            return None

    def _name_files(
        self, asset: ElementTree.Element, folder: Path, beside: Path | None, compiler: dict[str, str]
    ) -> None:
        """Give the files of an asset their whole paths, as MuJoCo finds them: by the compiler's folder for its kind,
        or else from the file's folder on, or that of the included file that names it.
        """
        inside = compiler.get("texturedir" if asset.tag == "texture" else "meshdir", compiler.get("assetdir", ""))
        for key in _FILES:
            if not (file := asset.get(key, "").replace("\\", "/")):
                asset.attrib.pop(key, None)
                continue
            if compiler.get("strippath", "false") == "true":
                file = file.split("/")[-1]
            path = folder / inside / file
            if beside is not None and not inside and not is_there(path):
                path = beside / file
            if asset.tag == "mesh" and not asset.get("name"):
                asset.set("name", Path(file).stem)
            asset.set(key, str(path))

    # -- what is not needed, and what a small file can blow up to ------------------------------------------------------

    def _drop(self, element: ElementTree.Element) -> None:
        for parent in list(element.iter()):
            for child in list(parent):
                if child.tag in _DROPPED and (parent is element or child.tag == "flexcomp"):
                    parent.remove(child)
                    if child.tag in _TOLD:
                        self.notes.append(f"soft bodies are left out: <{child.tag}>")
        for mesh in element.iter("mesh"):
            for key in ("params", "subdivision", "resolution"):
                if (text := mesh.get(key)) and max(map(abs, _floats(text)), default=math.inf) > _MOST_PARAMETER:
                    self.problems.append(f"<mesh {key}={shorten(text)}>: expected numbers up to {_MOST_PARAMETER:g}")

    def _check_copies(self, element: ElementTree.Element) -> None:
        """Refuse repetitions that would make more elements than are read."""
        for times, one in _copy(element):
            self._size += times * sum(1 for _ in one.iter())
            if self._size > MOST_ELEMENTS:
                raise HandNotLoaded(
                    self.name, f"expected at most {MOST_ELEMENTS} elements, with those that <{one.tag}> makes"
                )


def _copy(element: ElementTree.Element) -> Iterator[tuple[int, ElementTree.Element]]:
    """Yield what is repeated and how often, those inside of others as often as these."""
    waiting = [(element, 1)]
    while waiting:
        parent, times = waiting.pop()
        for child in parent:
            if key := _COPIES.get(child.tag):
                count = math.prod(max(value, 1.0) for value in _floats(child.get(key, "1"))[:3])
                copies = int(min(times * count, 1e9))
                yield copies, child
                waiting.append((child, copies))
            else:
                waiting.append((child, times))


def _floats(text: str) -> list[float]:
    """Numbers of a text, none where it has others: MuJoCo tells."""
    try:
        return floats(text)
    except ValueError:
        return []
