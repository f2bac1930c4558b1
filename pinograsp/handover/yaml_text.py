"""A ROS 2 message as YAML text."""

from __future__ import annotations

import json


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
