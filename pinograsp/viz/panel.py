"""Text of the live page's panel, as HTML. Names come from files and are escaped."""

from __future__ import annotations

from html import escape

import numpy as np

from pinograsp.viz.scene import ViewScene
from pinograsp.words import fixed

_CELL = "padding:1px 0 1px 6px;text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums"
_FIRST = "padding:1px 0;text-align:left;max-width:9em;overflow:hidden;text-overflow:ellipsis;white-space:nowrap"
_BOX = "padding:0 1em;font-size:0.82em;line-height:1.45"
_LEVELS = {"yes": ("#009E73", "#e3f4ee"), "caution": ("#E69F00", "#fdf3dd"), "no": ("#D55E00", "#fdeae1")}
_USED = "#56B4E9"


def head(scene: ViewScene) -> str:
    """Title, whether the grasp holds, the plan's status, and the simulation's verdict."""
    lines = [f"<b style='font-size:1.25em'>{escape(scene.title)}</b><br>{escape(scene.subtitle)}"]
    plan = f"plan: {scene.status}" + (f"; {scene.remedy}" if scene.remedy else "")
    lines.append(_badge(scene.answer.level, scene.answer.text, plan))
    if (check := scene.simulated) is not None:
        verdict = ("yes", "HELD") if check.held else ("no", "LOST")
        lines.append(_badge(verdict[0], f"simulation: {verdict[1]}", check.reason))
    return _boxed("".join(lines))


def forces(scene: ViewScene, frame: int) -> str:
    """Time, contact forces with the friction that they use, and the simulation's forces."""
    rows = [_row("contact", "normal [N]", "friction [N]", "of mu F_n", grey=True)]
    for k, name in enumerate(scene.contacts):
        dot = f"<span style='color:{scene.colours[k]}'>&#9679;</span> {escape(name)}"
        used = scene.used[frame, k]
        rows.append(_row(dot, short(max(scene.normal[frame, k], 0.0)), short(scene.tangential[frame, k]), _bar(used)))
    total = scene.forces_o[frame].sum(axis=0)
    load = float(np.linalg.norm(scene.load_o[frame]))
    lines = [
        f"<b style='font-size:1.25em'>{scene.times[frame]:.3f} s</b><br>{escape(scene.told[frame])}",
        _table(rows),
        f"sum {short(float(np.linalg.norm(total)))} N; load {short(load)} N; "
        f"residual {short(float(np.linalg.norm(total + scene.load_o[frame])), 2)} N",
    ]
    if (check := scene.simulated) is not None:
        rows = [_row("in the simulation", "normal [N]", "planned [N]", grey=True)]
        rows += [
            _row(escape(part), short(check.normal_forces[frame, p]), short(check.planned[p]))
            for p, part in enumerate(check.parts)
        ]
        lines += [_table(rows), f"drift of the object since t_F: {short(1e3 * check.drift[frame])} mm"]
    return _boxed("".join(f"<div style='margin:4px 0'>{line}</div>" for line in lines))


def torques(scene: ViewScene, frame: int) -> str:
    """Joint positions, torques, and the shares of the torque limits that they use."""
    rows = [_row("joint", "position", "torque", "of its limit", grey=True)]
    for finger, dofs in scene.fingers.items():
        rows.append(_row(f"<b>{escape(finger)}</b>"))
        for i in dofs:
            q, torque, slides, limit = scene.q[frame, i], scene.torques[frame, i], scene.sliding[i], scene.limits[i]
            share = abs(torque) / limit if np.isfinite(limit) and limit > 0 else np.nan
            position = f"{fixed(1e3 * q, 1)} mm" if slides else f"{fixed(np.degrees(q), 1)} deg"
            rows.append(
                _row(escape(scene.joints[i]), position, f"{short(torque)} {'N' if slides else 'N m'}", _bar(share))
            )
    return _boxed(_table(rows))


def foot(scene: ViewScene) -> str:
    """What does not change over time: margins of the grasp, and cautions."""
    rows = [
        f"<tr><td>{escape(what)}</td><td style='text-align:right'>{escape(value)}</td></tr>"
        for what, value in scene.facts
    ]
    cautions = "".join(f"<li>{escape(caution)}</li>" for caution in (*scene.cautions, *scene.unseen))
    return _boxed(_table(rows) + (f"<b>Cautions</b><ul>{cautions}</ul>" if cautions else ""))


def short(value: float, digits: int = 3) -> str:
    """A number with few digits, for display."""
    if not np.isfinite(value):
        return "-"
    if abs(value) < 1e-12:
        return "0"
    return f"{value:.1e}" if abs(value) < 1e-3 else np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")


def _boxed(text: str) -> str:
    return f"<div style='{_BOX}'>{text}</div>"


def _table(rows: list[str]) -> str:
    return f"<table style='width:100%;border-collapse:collapse'>{''.join(rows)}</table>"


def _row(first: str, *others: str, grey: bool = False) -> str:
    colour = ";color:#66727f" if grey else ""
    cells = "".join(f"<td style='{_CELL}{colour}'>{other}</td>" for other in others)
    return f"<tr><td style='{_FIRST}{colour}'>{first}</td>{cells}</tr>"


def _bar(share: float) -> str:
    if not np.isfinite(share):
        return "-"
    colour = _USED if share <= 1.0001 else _LEVELS["no"][0]
    fill = f"<span style='display:block;height:100%;width:{100 * min(share, 1.0):.1f}%;background:{colour}'></span>"
    box = "display:inline-block;width:40px;height:8px;background:#e2e7ec;border-radius:3px;"
    box += "overflow:hidden;margin-right:4px"
    return f"<span style='{box}'>{fill}</span><span style='display:inline-block;width:2.9em'>{100 * share:.0f} %</span>"


def _badge(level: str, text: str, more: str) -> str:
    line, ground = _LEVELS[level]
    style = f"border-left:5px solid {line};background:{ground}"
    small = f"<br>{escape(more)}" if more else ""
    return f"<div style='margin:6px 0;padding:4px 8px;{style}'><b>{escape(text)}</b>{small}</div>"
