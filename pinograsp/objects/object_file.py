"""What a file says of one object, whichever kind of file it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pinograsp.errors import InvalidInput
from pinograsp.hands.elements import is_text, parse_xml, read_bytes
from pinograsp.hands.mesh_file import LFS_POINTER
from pinograsp.objects.description import Description, sdf_description, urdf_description

if TYPE_CHECKING:
    import mujoco


def read_object_file(
    source: str | Path | mujoco.MjSpec, name: str, packages: Mapping[str, Path], body: str | None = None
) -> Description:
    """What a URDF, SDF or MJCF file, the text of one, or a specification of MuJoCo's says of one object.

    Args:
        source: path, text or specification.
        name: what to call it in errors.
        packages: folders of ROS packages, by name.
        body: of an MJCF's bodies, the one that is meant.

    Raises:
        InvalidInput: not such a file, several links or bodies or joints that move, no collision shape, a missing mesh.
    """
    try:
        if not isinstance(source, str | Path):
            from pinograsp.objects.mjcf_object import mjcf_description  # MuJoCo takes a moment to import

            return mjcf_description(source, Path(), body)
        text = isinstance(source, str) and is_text(source)
        path, content = (Path("text.xml"), str(source).encode()) if text else (Path(source), read_bytes(Path(source)))
        if content.startswith(LFS_POINTER):
            raise ValueError("a pointer of Git LFS: run 'git lfs pull' where it was cloned")
        root = parse_xml(content.strip())
        for element in root.iter():
            element.tag = element.tag.rsplit("}", 1)[-1]
        if root.tag == "mujoco":
            from pinograsp.objects.mjcf_object import mjcf_description

            return mjcf_description(root, path.resolve(), body)
        if root.tag not in ("robot", "sdf", "model"):
            raise ValueError(f"expected <robot> (URDF), <sdf> or <mujoco> (MJCF), found <{root.tag}>")
        if body is not None:
            raise ValueError(f"expected body= with an MJCF file, got it with <{root.tag}>: leave it out")
        read = urdf_description if root.tag == "robot" else sdf_description
        return read(root, path.resolve().parent, packages)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"object file '{name}': {error}") from None
