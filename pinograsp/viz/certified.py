"""A picture of what certificates say of many grasps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import path_of
from pinograsp.errors import InvalidInput
from pinograsp.viz.style import COLOURS, SUFFIXES, NotebookFigure, encode_figure
from pinograsp.writing import write_file

_MOST = 20  # objects with a box of their own
_LONGEST = 28  # characters of a name
# The first is what holds.
_COLOURS = ("#2a7f4f", *COLOURS[:2], *COLOURS[3:7], "#8c6d31", "#999999", "#7a0177", "#c7e9b4", "#fdd0a2")


def certified_picture(columns: Mapping[str, Sequence[Any]], path: str | Path) -> Path:
    """Draw why grasps hold or do not, by object, and the largest normal force of those that hold.

    Args:
        columns: of the table of certificates: ``reason``, ``object`` and ``normal_forces_N``, an entry for each grasp.
        path: .png, .svg or .pdf.

    Raises:
        InvalidInput: no grasps, or another ending.
        ResultsNotWritten: the file cannot be written.
    """
    path = path_of("picture", path)
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise InvalidInput(f"picture: expected a name that ends in {', '.join(SUFFIXES)}, got '{path.name}'")
    rows = [
        (reason, name or "(no name)", forces)
        for reason, name, forces in zip(columns["reason"], columns["object"], columns["normal_forces_N"])
        if reason != "refused"
    ]
    if not rows:
        raise InvalidInput("picture: expected certified grasps, got none")
    names = [name for name, _ in Counter(name for _, name, _ in rows).most_common()]
    shown = sorted(names[:_MOST])
    reasons = sorted({reason for reason, _, _ in rows}, key=lambda reason: (reason != "held", reason))
    counts = Counter((name, reason) for reason, name, _ in rows)
    newtons = {
        name: [max(forces) for reason, own, forces in rows if own == name and reason == "held" and forces]
        for name in shown
    }
    figure = NotebookFigure(figsize=(11.0, 1.8 + 0.32 * len(shown)), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1.6, 1.0])
    at, begin = np.arange(len(shown)), np.zeros(len(shown))
    totals = np.array([sum(counts[name, reason] for reason in reasons) for name in shown])
    for i, reason in enumerate(reasons, start=int(reasons[0] != "held")):
        share = 100 * np.array([counts[name, reason] for name in shown]) / totals
        left.barh(at, share, left=begin, color=_COLOURS[i % len(_COLOURS)], label=reason.replace("_", " "), height=0.7)
        begin += share
    left.set_yticks(at, [name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..." for name in shown])
    left.set(xlabel="share of the grasps [%]", xlim=(0, 100))
    left.invert_yaxis()
    left.legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    for i, name in enumerate(shown):
        if newtons[name]:
            right.boxplot(
                [newtons[name]],
                positions=[i],
                orientation="horizontal",
                widths=0.6,
                showfliers=False,
                manage_ticks=False,
            )
    right.set(xlabel="largest normal force of those held [N]")
    right.grid(axis="x", alpha=0.3, linewidth=0.5)
    held = sum(reason == "held" for reason, _, _ in rows)
    more = f"; the {_MOST} objects with the most of {len(names)}" if len(names) > _MOST else ""
    figure.suptitle(f"{held} of {len(rows)} grasps hold{more}", fontsize=11)
    return write_file(path, encode_figure(figure, kind[1:]))
