"""Files of a hand-over, written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

from pinograsp.errors import ResultsNotWritten


def write(path: Path, content: bytes) -> None:
    """Whole or not at all: written next to its place, then renamed."""
    staging = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, staging = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(staging, 0o666 & ~umask)  # mkstemp makes it private
        os.replace(staging, path)
    except OSError as error:
        if staging is not None:
            Path(staging).unlink(missing_ok=True)
        raise ResultsNotWritten(f"cannot write '{path}': {error}") from error


def yaml_of(message: dict) -> str:
    """YAML that version 1.1 reads alike: names in quotes, a point in every number with an exponent."""
    inner = message.get("trajectory", message)
    header = inner["header"]
    lines = [
        f"header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: {json.dumps(header['frame_id'])}}}",
        f"joint_names: [{', '.join(map(json.dumps, inner['joint_names']))}]",
        "points:",
    ]
    for point in inner["points"]:
        for i, (name, values) in enumerate(point.items()):
            if name == "time_from_start":
                text = f"{{sec: {values['sec']}, nanosec: {values['nanosec']}}}"
            else:
                text = f"[{', '.join(map(_digits, values))}]"
            lines.append(f"{'  ' if i else '- '}{name}: {text}")
    if inner is not message:
        lines = ["trajectory:", *(f"  {line}" for line in lines)]
    return "\n".join(lines) + "\n"


def _digits(value: float) -> str:
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
