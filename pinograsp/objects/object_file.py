"""What a file says of one object, whichever kind of file it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pinograsp.errors import InvalidInput
from pinograsp.hands.elements import parse_xml, read_bytes
from pinograsp.hands.mesh_file import LFS_POINTER
from pinograsp.objects.description import Description, sdf_description, urdf_description
from pinograsp.objects.mjcf_object import mjcf_description


def read_description(path: Path, packages: Mapping[str, Path], body: str | None = None) -> Description:
    """What a URDF, SDF or MJCF file says of one object; ``body``: which of an MJCF file's.

    Raises:
        InvalidInput: not such a file, several links or bodies or joints that move, no collision shape, a missing mesh.
    """
    try:
        content = read_bytes(path)
        if content.startswith(LFS_POINTER):
            raise ValueError("a pointer of Git LFS: run 'git lfs pull' where it was cloned")
        root = parse_xml(content.strip())
        for element in root.iter():
            element.tag = element.tag.rsplit("}", 1)[-1]
        if root.tag == "mujoco":
            return mjcf_description(root, path.resolve(), body)
        if root.tag not in ("robot", "sdf", "model"):
            raise ValueError(f"expected <robot> (URDF), <sdf> or <mujoco> (MJCF), found <{root.tag}>")
        if body is not None:
            raise ValueError(f"expected body= with an MJCF file, got it with <{root.tag}>: leave it out")
        read = urdf_description if root.tag == "robot" else sdf_description
        return read(root, path.resolve().parent, packages)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"object file '{path}': {error}") from None
