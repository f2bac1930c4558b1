"""Text of the live page's panel, as HTML."""

from __future__ import annotations

from typing import Any

import numpy as np

from pinograsp.pages import render
from pinograsp.viz.scene import ViewScene
from pinograsp.words import format_fixed

_LEVELS = {"yes": ("#009E73", "#e3f4ee"), "caution": ("#E69F00", "#fdf3dd"), "no": ("#D55E00", "#fdeae1")}


def head(scene: ViewScene) -> str:
    """Title, whether the grasp holds, the plan's status, and the simulation's verdict."""
    return _render("head", scene, badges=_LEVELS)


def forces(scene: ViewScene, frame: int) -> str:
    """Time, contact forces with the friction that they use, and the simulation's forces."""
    total, load = scene.forces_o[frame].sum(axis=0), scene.load_o[frame]
    sums = {"sum": total, "load": load, "residual": total + load}
    return _render(
        "forces", scene, frame=frame, sums={name: float(np.linalg.norm(force)) for name, force in sums.items()}
    )


def torques(scene: ViewScene, frame: int) -> str:
    """Joint positions, torques, and the shares of the torque limits that they use."""
    usable = np.where(np.isfinite(scene.limits) & (scene.limits > 0), scene.limits, np.nan)
    return _render("torques", scene, frame=frame, shares=np.abs(scene.torques[frame]) / usable)


def foot(scene: ViewScene) -> str:
    """What does not change over time: margins of the grasp, and warnings."""
    return _render("foot", scene)


def _render(part: str, scene: ViewScene, **values: Any) -> str:
    shown: dict[str, Any] = {"short": short, "fixed": format_fixed, "degrees": np.degrees, "known": np.isfinite}
    return render("viz/panel.html", part=part, scene=scene, **shown, **values)


def short(value: float, digits: int = 3) -> str:
    """A number with few digits, for display."""
    if not np.isfinite(value):
        return "-"
    if abs(value) < 1e-12:
        return "0"
    return f"{value:.1e}" if abs(value) < 1e-3 else np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")
