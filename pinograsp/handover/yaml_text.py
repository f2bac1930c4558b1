"""A ROS 2 message as YAML text."""

from __future__ import annotations

from typing import Any


def write_yaml(message: dict[str, Any]) -> str:
    """YAML that version 1.1 reads alike: names in quotes, a point in every number with an exponent."""
    inner = message.get("trajectory", message)
    header = inner["header"]
    lines = [
        f"header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: {_quote(header['frame_id'])}}}",
        f"joint_names: [{', '.join(map(_quote, inner['joint_names']))}]",
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


def write_gripper_yaml(message: dict[str, Any]) -> str:
    """YAML of a parallel gripper's goal, as :func:`write_yaml`."""
    inner = message["command"]
    lines = [
        "command:",
        f"  header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: {_quote(inner['header']['frame_id'])}}}",
        f"  name: [{', '.join(map(_quote, inner['name']))}]",
        *(f"  {name}: [{', '.join(map(_digits, inner[name]))}]" for name in ("position", "velocity", "effort")),
    ]
    return "\n".join(lines) + "\n"


def _quote(text: str) -> str:
    """In double quotes: with YAML's own escapes, JSON's pairs of surrogates mean something else there."""
    return '"' + "".join(f"\\{c}" if c in '"\\' else c if c.isprintable() else f"\\U{ord(c):08x}" for c in text) + '"'


def _digits(value: float) -> str:
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
