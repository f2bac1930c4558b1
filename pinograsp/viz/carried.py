"""Matplotlib figures of what an arm carries: speed along the path, contact forces, friction, torques, and motion."""

from __future__ import annotations

from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import CubicHermiteSpline

from pinograsp.hands.model import HandModel
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array, IntArray
from pinograsp.viz.style import (
    COLOURS,
    NotebookFigure,
    contact_colours,
    finger_colours,
    grid,
    legend_above,
    make_label,
    ranks,
    save_all,
    shades,
)

_NAMED = 6  # limits or joints with a colour of their own: more cannot be told apart
_OTHERS = "0.6"  # grey
_NEAR = 0.3  # share of a torque limit from which on it is drawn
_TALLEST = 2.5  # of the limit's curve, over the largest speed: it may be far above at places
_WIDTH, _HALF = 7.6, 5.2  # [in] of a figure, and of one of two panels
_LETTER, _MARGIN = 0.072, 0.6  # [in] of a legend's letter, and beside each of its labels


class _Carried(Protocol):
    """What figures show of a :class:`~pinograsp.carry.CarryPlan`, which says what these are."""

    @property
    def robot(self) -> HandModel: ...
    @property
    def grasp(self) -> PlanRecord: ...
    @property
    def contacts(self) -> tuple[str, ...]: ...
    @property
    def reserve(self) -> float: ...
    @property
    def s(self) -> Array: ...
    @property
    def times(self) -> Array: ...
    @property
    def speed(self) -> Array: ...
    @property
    def instants(self) -> Array: ...
    @property
    def limit(self) -> Array: ...
    @property
    def torque_limits(self) -> Array: ...
    @property
    def dq(self) -> Array: ...
    @property
    def ddq(self) -> Array: ...
    @property
    def torques(self) -> Array: ...
    @property
    def normal_forces(self) -> Array: ...
    @property
    def commanded(self) -> Array: ...
    @property
    def friction_use(self) -> Array: ...
    @property
    def binding(self) -> tuple[str, ...]: ...
    def shares(self) -> list[tuple[str, float]]: ...


def path_speed(plan: _Carried) -> Figure:
    """Speed over the path parameter, coloured by the limit that binds, below the largest speed at each place."""
    s, speed = plan.s, plan.speed
    middles = CubicHermiteSpline(plan.times, s, speed)(plan.instants)
    figure = NotebookFigure(figsize=(_WIDTH, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(middles, plan.limit, color="0.2", linewidth=1.1, zorder=3, label="limit at each place by itself")
    shares = [(what, share) for what, share in plan.shares() if what != "nothing"]
    named, others = shares[:_NAMED], shares[_NAMED:]
    drawn = [(what, share, {what}, colour) for (what, share), colour in zip(named, COLOURS)]
    if others:
        what, share = f"{len(others)} others", sum(one for _, one in others)
        drawn.append((what, share, {name for name, _ in others}, _OTHERS))
    if free := dict(plan.shares()).get("nothing"):
        drawn.append(("nothing", free, {"nothing"}, "0.8"))
    for what, share, names, colour in drawn:
        inside = np.array([name in names for name in plan.binding])
        # Each interval from end to end; a gap after it where the next one is not of this colour.
        x, y = (
            np.column_stack([part[:-1], part[1:], np.where(inside, part[1:], np.nan)])[inside].ravel()
            for part in (s, speed)
        )
        gaps = np.zeros((inside.sum(), 3), dtype=bool)
        gaps[:, 2] = ~np.append(inside, False)[1:][inside]
        x, y = np.where(gaps.ravel(), np.nan, x), np.where(gaps.ravel(), np.nan, y)
        label = f"{make_label(what)}, {_percent(share)} of the time"
        axes.plot(x, y, color=colour, linewidth=3.0, solid_capstyle="butt", label=label)
    top = float(min(plan.limit.max(), _TALLEST * speed.max()))
    axes.set(xlabel="path parameter s [-]", ylabel="path speed ds/dt [1/s]", xlim=(0, 1), ylim=(0, 1.06 * top))
    grid(axes)
    _legend_above(axes, title="what binds")
    return figure


def normal_forces(plan: _Carried) -> Figure:
    """Sum of the normal forces and those of the contacts over time; dashed: commanded, if different."""
    figure = NotebookFigure(figsize=(_WIDTH, 6.0), layout="constrained")
    total, each = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.7))
    forces, commanded = plan.normal_forces, plan.commanded
    other = np.abs(commanded - forces).max(axis=0) > 1e-3 * max(float(forces.max()), 1e-9)
    total.plot(plan.instants, forces.sum(axis=1), color="0.2", linewidth=1.8, label="on the object")
    _contacts(each, plan, forces)
    if other.any():
        total.plot(plan.instants, commanded.sum(axis=1), "--", color="0.2", linewidth=1.2, label="commanded (dashed)")
        _legend_above(total)
    colours = _colours(plan)
    for i in np.flatnonzero(other):
        each.plot(plan.instants, commanded[:, i], "--", color=colours[i], linewidth=1.1)
    for axes, ylabel in ((total, "sum [N]"), (each, "normal force [N]")):
        _over_time(axes, plan, ylabel)
        axes.set_ylim(0, 1.08 * max(float(np.max(line.get_ydata())) for line in axes.lines))
    total.set_xlabel("")
    _legend_above(each)
    return figure


def carry_friction(plan: _Carried) -> Figure:
    """Share of the friction on which the plan relies that each contact uses over time; 1: all of it."""
    figure = NotebookFigure(figsize=(_WIDTH, 4.4), layout="constrained")
    axes = figure.subplots()
    _contacts(axes, plan, plan.friction_use)
    axes.axhline(1.0, color="0.2", linewidth=1.0, linestyle="--", zorder=3)
    _remark(axes, 1.01, "all that the plan relies on", "bottom")
    _over_time(axes, plan, "share of the friction relied on [-]")
    axes.set_ylim(0, max(1.12, 1.05 * float(plan.friction_use.max())))
    _legend_above(axes)
    return figure


def torque_shares(plan: _Carried) -> Figure:
    """Joint torques as shares of their limits over time, of the arm and of the fingers."""
    limits = plan.torque_limits
    fingers = _fingers(plan)
    arm = np.setdiff1d(np.arange(plan.robot.n), fingers)
    figure = NotebookFigure(figsize=(2 * _HALF, 4.8), layout="constrained")
    for axes, dofs, what in zip(figure.subplots(1, 2), (arm, fingers), ("arm", "fingers")):
        known = dofs[np.isfinite(limits[dofs])]
        shares = plan.torques[:, known] / limits[known]
        _over_time(axes, plan, f"torque of the {what}, share of each joint's limit [-]")
        if not known.size:
            axes.text(0.5, 0.5, "no torque limits are known", ha="center", color="0.35", transform=axes.transAxes)
            continue
        axes.axhline(0.0, color="0.2", linewidth=0.6)
        _joints(axes, plan, known, shares)
        # The limit's line would leave curves far below it flat.
        if np.abs(shares).max() > _NEAR:
            axes.set_ylim(-1.12, 1.12)
            for bound in (-1.0, 1.0):
                axes.axhline(bound, color="0.2", linewidth=1.0, linestyle="--")
                axes.axhline(bound * (1.0 - plan.reserve), color="0.45", linewidth=0.8, linestyle=":")
            _remark(axes, 1.01, "limit", "bottom")
            if plan.reserve:
                _remark(axes, 0.985 - plan.reserve, f"{100 * plan.reserve:g} % kept free", "top")
    return figure


def arm_motion(plan: _Carried) -> Figure:
    """Speeds and accelerations of the joints that move, over time."""
    moving = np.flatnonzero(np.abs(plan.dq).max(axis=0) > 0)
    slides = plan.robot.slides[moving]
    unit = "m" if slides.all() else "rad or m" if slides.any() else "rad"
    figure = NotebookFigure(figsize=(2 * _HALF, 4.8), layout="constrained")
    for axes, values, what, per in zip(
        figure.subplots(1, 2), (plan.dq, plan.ddq), ("speed", "acceleration"), ("s", "s$^2$")
    ):
        _joints(axes, plan, moving, values[:, moving])
        _over_time(axes, plan, f"joint {what} [{unit}/{per}]")
    return figure


def save_carry_figures(plan: _Carried, folder: str | Path) -> list[Path]:
    """Write all of these as PNG files into an existing folder; returns their paths."""
    figures = {
        "carry_speed.png": path_speed,
        "carry_forces.png": normal_forces,
        "carry_friction.png": carry_friction,
        "carry_torques.png": torque_shares,
        "carry_motion.png": arm_motion,
    }
    return save_all({name: partial(figure, plan) for name, figure in figures.items()}, folder)


def _fingers(plan: _Carried) -> IntArray:
    """The robot's joints that are those of the fingers in the grasp."""
    hand = plan.grasp.require_hand()
    own = {hand.joint_names[i] for finger in hand.fingers for i in finger.dofs.tolist()}
    return np.array([i for i, joint in enumerate(plan.robot.joint_names) if joint in own], dtype=int)


def _contacts(axes: Axes, plan: _Carried, values: Array) -> None:
    """A line for each contact; earlier ones are wider, so that they are seen below others of the same values."""
    colours = _colours(plan)
    for i, (name, rank) in enumerate(zip(plan.contacts, ranks(colours))):
        width = 1.2 + 1.4 * (1 - (i + 1) / len(plan.contacts))
        style = ("-", "-.", ":")[rank % 3]
        axes.plot(plan.instants, values[:, i], style, color=colours[i], linewidth=width, label=make_label(name))


def _colours(plan: _Carried) -> tuple[str, ...]:
    return contact_colours(plan.contacts, plan.grasp.layout.fingers)


def _joint_colours(plan: _Carried) -> dict[str, tuple[float, ...]]:
    """Colours of the joints by name: shades of their finger's; of an arm along a scale, from base to tip."""
    layout = plan.grasp.layout
    fingers = finger_colours(plan.grasp.contacts.names, list(layout.fingers))
    found = {
        layout.joints[i]: shade
        for name, dofs in layout.fingers.items()
        for i, shade in zip(dofs, shades(fingers[name], len(dofs)))
    }
    arm = [name for name in plan.robot.joint_names if name not in found]
    return found | dict(zip(arm, colormaps["cividis"](np.linspace(0.0, 0.9, len(arm))).tolist()))


def _joints(axes: Axes, plan: _Carried, dofs: IntArray, values: Array) -> None:
    """A line for each joint, values (N, len(dofs)): those with the largest in colour."""
    named = set(np.argsort(-np.abs(values).max(axis=0, initial=0.0), kind="stable")[: _NAMED + 1].tolist())
    colours, styles = _joint_colours(plan), cycle(("-", "--", "-.", ":"))
    others = "others"
    for i, (joint, column) in enumerate(zip(dofs.tolist(), values.T)):
        if i in named:
            name = plan.robot.joint_names[joint]
            axes.plot(
                plan.instants,
                column,
                next(styles),
                color=colours[name],
                linewidth=1.6,
                label=make_label(name),
                zorder=3,
            )
        else:
            axes.plot(plan.instants, column, color=_OTHERS, linewidth=0.8, label=others)
            others = "_again"  # the legend names them once
    if dofs.size:
        _legend_above(axes, _HALF)


def _over_time(axes: Axes, plan: _Carried, ylabel: str) -> None:
    axes.set(xlabel="time [s]", ylabel=ylabel, xlim=(0, float(plan.times[-1])))
    grid(axes)


def _remark(axes: Axes, height: float, text: str, va: Literal["top", "bottom"]) -> None:
    """A small one on the right, at a height in the axes' unit."""
    where = axes.get_yaxis_transform()
    axes.text(0.995, height, text, fontsize=8, ha="right", va=va, color="0.3", transform=where)


def _percent(share: float) -> str:
    return "less than 1 %" if share < 0.01 else f"{100 * share:.0f} %"


def _legend_above(axes: Axes, room: float = _WIDTH, title: str | None = None) -> None:
    """Clear of the curves, in as many columns as there is room for [in]."""
    columns = int(room / (_MARGIN + _LETTER * max(map(len, axes.get_legend_handles_labels()[1]))))
    legend_above(axes, min(max(columns, 1), 3), title)
