"""ACRONYM's HDF5 files, read by a process of its own: HDF5's library is C, and broken files crash it.

Run as a script with a path and a block size. It writes frames to its standard output: 8 bytes of length, then JSON
for the first one, and the bytes of one array for each of the others, block by block in the order of the columns.
"""

from __future__ import annotations

import json
import os
import resource
import struct
import sys
from typing import Any

TRANSFORMS = "grasps/transforms"
QUALITIES = "grasps/qualities/flex"
GRASPS = "grasps"
FACTS = ("mass", "com", "inertia", "density", "friction", "volume")
_MOST_FACTS = 100  # numbers of each
_MOST_A_GRASP = 10_000  # numbers
_DENSEST = 100  # times that numbers may shrink in a file; labels of true and false do by less
_FEW_BYTES = 1_000_000  # of numbers that need not be in the file
_LONGEST_TEXT = 100_000  # [bytes]
_MEMORY = 2**33  # [bytes] of addresses
_TIME = 600  # [s]


class Refused(ValueError):
    """The file is not as expected."""


class Reader:
    """An open file, and what is looked at in it: nothing behind links, and nothing outside of this very file."""

    def __init__(self, h5: Any):
        import h5py

        self._h5, self._dataset, self._group, self._link = h5, h5py.Dataset, h5py.Group, h5py.HardLink
        for name in (TRANSFORMS, "object/file", "object/scale"):
            if not isinstance(self._at(name), self._dataset):
                raise Refused(f"expected a dataset '{name}', got none")
        shape = self._at(TRANSFORMS).shape
        if len(shape) != 3 or shape[1:] != (4, 4):
            raise Refused(f"'{TRANSFORMS}': expected the shape (N, 4, 4), got {shape}")
        self.count = int(shape[0])
        self._check_stored(TRANSFORMS)
        scale = self._numbers("object/scale")
        if len(scale) != 1:
            raise Refused(f"'object/scale': expected a number, got {len(scale)}")
        self.columns = self._columns()
        facts = [name for name in FACTS if self._at(f"object/{name}") is not None]
        self.header = {
            "count": self.count,
            "object": self._text("object/file"),
            "scale": scale[0],
            "gripper": self._text("gripper/type") if self._at("gripper/type") is not None else "",
            "facts": {name: self._numbers(f"object/{name}") for name in facts},
            "shapes": {name: self._at(f"object/{name}").shape for name in facts},
            "columns": [(path, self._little(path).str, self._at(path).shape[1:]) for path in self.columns],
        }

    def _little(self, path: str) -> Any:
        return self._at(path).dtype.newbyteorder("<")

    def _at(self, name: str) -> Any:
        at = self._h5
        for part in name.split("/"):
            if not isinstance(at, self._group) or part not in at:
                return None
            if not isinstance(at.get(part, getlink=True), self._link):
                raise Refused(f"'{name}' is a link to elsewhere, which is not followed")
            at = at[part]
        if isinstance(at, self._dataset) and (at.external or at.is_virtual):
            raise Refused(f"'{name}' lies in another file, which is not read")
        return at

    def _check_stored(self, name: str) -> None:
        """Refuse a dataset with far fewer bytes in the file than numbers."""
        data = self._at(name)
        if data.nbytes > _FEW_BYTES + _DENSEST * data.id.get_storage_size():
            raise Refused(f"'{name}': {data.size} numbers in so few bytes of the file: it is not read")

    def _text(self, name: str) -> str:
        data = self._at(name)
        single = isinstance(data, self._dataset) and data.shape == () and data.dtype.itemsize <= _LONGEST_TEXT
        value = data[()] if single else None
        try:
            text = value.decode("utf-8") if isinstance(value, bytes) else value
        except UnicodeDecodeError:
            text = None
        if not isinstance(text, str):
            raise Refused(f"'{name}': expected a text")
        return text

    def _numbers(self, name: str) -> list[float]:
        data = self._at(name)
        if not isinstance(data, self._dataset) or data.dtype.kind not in "fiub" or data.size > _MOST_FACTS:
            raise Refused(f"'{name}': expected numbers")
        return [float(one) for one in data[()].ravel()]

    def _columns(self) -> list[str]:
        """Datasets with numbers of each grasp: the transforms, then others."""
        columns = [TRANSFORMS]
        if self._at(TRANSFORMS).dtype.kind not in "fiu":
            raise Refused(f"'{TRANSFORMS}': expected numbers")
        for folder in (QUALITIES, GRASPS):
            group = self._at(folder)
            for name in group if isinstance(group, self._group) else ():
                if (path := f"{folder}/{name}") == TRANSFORMS:
                    continue
                data = self._at(path)
                if isinstance(data, self._dataset) and data.dtype.kind in "fiub" and data.shape[:1] == (self.count,):
                    if data.size > _MOST_A_GRASP * self.count:
                        raise Refused(f"'{path}': too many numbers a grasp")
                    self._check_stored(path)
                    columns.append(path)
        return columns

    def block(self, begin: int, end: int) -> list[bytes]:
        """The bytes of each column's rows."""
        return [self._at(path)[begin:end].astype(self._little(path)).tobytes() for path in self.columns]


def main(path: str, block: int) -> None:
    """Write the frames of a file."""
    out = sys.stdout.buffer

    def frame(content: bytes) -> None:
        out.write(struct.pack("<Q", len(content)) + content)
        out.flush()

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_TIME, _TIME))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        import h5py

        with h5py.File(path, "r") as h5:
            reader = Reader(h5)
            frame(json.dumps(reader.header).encode())
            for begin in range(0, reader.count, block):
                for content in reader.block(begin, min(begin + block, reader.count)):
                    frame(content)
    except BrokenPipeError:
        return
    except Refused as refusal:
        frame(json.dumps({"refused": str(refusal)}).encode())
    except Exception as error:  # HDF5 raises what it finds
        text = f"the HDF5 file is broken or cut off ({' '.join(str(error).split())[:200]})"
        frame(json.dumps({"refused": text}).encode())


if __name__ == "__main__":
    here = os.path.dirname(os.path.abspath(__file__))  # its modules are not meant by their names alone
    sys.path[:] = [folder for folder in sys.path if os.path.abspath(folder) != here]
    main(sys.argv[1], int(sys.argv[2]))
