"""Matplotlib figures of a :class:`~pinograsp.plan.PlanRecord`: the paper's Figs. 14 to 18, and more."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinograsp.checks import array_of, flag, floats_of, instance_of, items_of, mapping_of, number, one_of, text_of
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array
from pinograsp.viz.style import (
    NotebookFigure,
    PanelLayout,
    contact_colours,
    finger_colours,
    grid,
    legend_above,
    make_label,
    ranks,
    save_all,
    shades,
)

_STYLES = ("-", "--", "-.", ":")  # for print
_NARROW = 0.15  # of the axes: a phase whose name is written upwards
_NEUTRAL = "0.25"  # of what belongs to no finger


def _contact_lines(axes: Axes, plan: PlanRecord, times: Array, values: Array) -> None:
    """Values of the contacts (m, k) over time, in the colours of their fingers."""
    names = plan.contacts.names
    colours = contact_colours(names, plan.layout.fingers)
    for i, (name, rank) in enumerate(zip(names, ranks(colours))):
        axes.plot(times, values[:, i], _STYLES[rank % 4], color=colours[i], linewidth=1.6, label=make_label(name))


def _joint_lines(axes: Axes, plan: PlanRecord, finger: str, times: Array, values: Array) -> None:
    """Values of a finger's joints over time (m, joints), from base to tip, in shades of its colour."""
    names = [plan.layout.joints[i] for i in plan.layout.fingers[finger]]
    for i, (name, shade) in enumerate(zip(names, shades(_colour(plan, finger), len(names)))):
        axes.plot(times, values[:, i], _STYLES[i % 4], color=shade, linewidth=1.6, label=make_label(name))


def _colour(plan: PlanRecord, finger: str) -> str:
    return finger_colours(plan.contacts.names, list(plan.layout.fingers))[finger]


def note(axes: Axes, time: float, text: str, side: Literal["left", "right"], *, upwards: bool = False) -> None:
    """A small note at the lower end of the axes, on one side of a time [s]."""
    instance_of("axes", axes, Axes)
    axes.text(
        number("time", time, unit="s"),
        0.01,
        text_of("text", text),
        ha=one_of("side", side, ("left", "right")),
        va="bottom",
        transform=axes.get_xaxis_transform(),
        fontsize=8,
        color="0.35",
        rotation=90 if flag("upwards", upwards) else 0,
    )


def _phases(axes: Axes, plan: PlanRecord, start: float = 0.0) -> None:
    """Mark the impact, and name the phases before and after it; the axes begin at ``start`` [s]."""
    impact, end = plan.forces.impact_time, plan.forces.final_time
    axes.axvspan(impact, end, color="0.92", zorder=0)
    axes.axvline(impact, color="0.4", linewidth=0.8)
    note(axes, impact, "approach ", "right")
    note(axes, impact, " grasp", "left", upwards=end - impact < _NARROW * (end - start))
    grid(axes)
    axes.set(xlabel="time [s]", xlim=(start, end))


def _find_moving(plan: PlanRecord) -> list[str]:
    """Fingers that move, in the hand's order."""
    q = plan.motion.q
    return [name for name, dofs in plan.layout.fingers.items() if np.ptp(q[:, dofs], axis=0).max(initial=0.0) > 0]


def _per_finger(plan: PlanRecord, values: Array, ylabel: str) -> Figure:
    """Values (m, n) over time, one panel for each moving finger."""
    fingers = _find_moving(plan)
    if not fingers:
        raise InvalidInput("figure: expected a plan with moving joints, got one without any")
    columns = min(3, len(fingers))
    rows = -(-len(fingers) // columns)
    figure = NotebookFigure(figsize=(4.2 * columns, 3.6 * rows), layout=PanelLayout())
    panels = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for axes in panels[len(fingers) :]:
        axes.set_axis_off()
    for axes, name in zip(panels, fingers):
        _joint_lines(axes, plan, name, plan.motion.times, values[:, plan.layout.fingers[name]])
        _phases(axes, plan)
        axes.set_ylabel(ylabel)
        legend_above(axes, 2, make_label(name), _colour(plan, name))
    return figure


def joint_angles(plan: PlanRecord) -> Figure:
    """Joint angles over time, one panel for each moving finger (Fig. 14 d-f)."""
    instance_of("plan", plan, PlanRecord)
    return _per_finger(plan, np.degrees(plan.motion.q), "joint angle [deg]")


def joint_rates(plan: PlanRecord) -> Figure:
    """Joint rates over time, one panel for each moving finger."""
    instance_of("plan", plan, PlanRecord)
    return _per_finger(plan, np.degrees(plan.motion.dq), "joint rate [deg/s]")


def joint_torques(plan: PlanRecord, finger: str) -> Figure:
    """Joint torques of one finger over time: during all of the motion, and during the approach (Figs. 15-17 b)."""
    instance_of("plan", plan, PlanRecord)
    dofs = plan.layout.fingers[one_of("finger", finger, plan.layout.fingers)]
    times, torques, impact = plan.motion.times, plan.motion.torques[:, dofs], plan.motion.impact
    figure = NotebookFigure(figsize=(9.6, 3.9), layout=PanelLayout())
    complete, early = figure.subplots(1, 2)
    _joint_lines(complete, plan, finger, times, torques)
    _phases(complete, plan)
    slides = plan.hand is not None and plan.hand.slides[list(dofs)].all()
    what, unit = ("force", "N") if slides else ("torque", "N m")
    complete.set_ylabel(f"{what} [{unit}]")
    legend_above(complete, 3, make_label(finger), _colour(plan, finger))
    _joint_lines(early, plan, finger, times[: impact + 1], 1e3 * torques[: impact + 1])
    grid(early)
    early.set(xlabel="time [s]", ylabel=f"{what} in the approach [m{unit}]", xlim=(0, times[impact]))
    return figure


def contact_forces(plan: PlanRecord) -> Figure:
    """Normal forces with the net force on the object, and penetration depth, in the grasp phase (Fig. 18)."""
    instance_of("plan", plan, PlanRecord)
    impact, phases = plan.motion.impact, plan.forces
    # A fifth of the grasp phase before the impact shows where the contact begins.
    lead = (phases.final_time - phases.impact_time) / 5
    drawn = plan.motion.times >= phases.impact_time - lead
    times = plan.motion.times[drawn]
    figure = NotebookFigure(figsize=(10.4, 4.2), layout=PanelLayout())
    force, depth = figure.subplots(1, 2)
    _contact_lines(force, plan, times, plan.forces.normal_history[drawn])
    # Until it is released at t_F something else carries the object: its weight counts from there.
    from_fingers = plan.motion.forces_o.sum(axis=1)[drawn]
    force.plot(
        times, np.linalg.norm(from_fingers, axis=1), color="0.2", linewidth=1.2, label="resultant of the contacts"
    )
    left = np.linalg.norm(plan.residual_force_o[impact:], axis=1)
    force.plot(
        plan.motion.times[impact:],
        left,
        color="0.55",
        linewidth=1.2,
        linestyle=(0, (1, 1)),
        label="net force, load included",
    )
    force.set(ylabel="force [N]")
    _contact_lines(depth, plan, times, 1e3 * plan.forces.depths[drawn])
    depth.set(ylabel="penetration depth [mm]")
    for axes in (force, depth):
        _phases(axes, plan, times[0])
        legend_above(axes, 3)
    return figure


def grasp_energy(plan: PlanRecord) -> Figure:
    """Grasp energy over the grasp phase: work (Eq. 9) and impulse (Eq. 11), with the factor rho + 1."""
    instance_of("plan", plan, PlanRecord)
    impact = plan.motion.impact
    times, rates = plan.motion.times[impact:], plan.forces.rates[impact:]
    forces = (1 + plan.law.exponent) * plan.forces.normal_history[impact:]
    figure = NotebookFigure(figsize=(10.4, 4.2), layout=PanelLayout())
    labels = ("grasp energy as work, Eq. (9):\nrho + 1 times the contacts' work [mJ]", "as impulse, Eq. (11) [N s]")
    for axes, power, ylabel, scale in zip(figure.subplots(1, 2), (forces * rates, forces), labels, (1e3, 1.0)):
        steps = np.diff(times)[:, None] * (power[1:] + power[:-1]) / 2
        grown = scale * np.vstack([np.zeros(power.shape[1]), np.cumsum(steps, axis=0)])
        _contact_lines(axes, plan, times, grown)
        axes.plot(times, grown.sum(axis=1), color="0.2", linewidth=2.0, label="all")
        axes.set(ylabel=ylabel, xlabel="time [s]", xlim=(times[0], times[-1]))
        grid(axes)
        legend_above(axes, 4)
    return figure


def friction_use(plan: PlanRecord) -> Figure:
    """Share of Coulomb's cone, mu F_n, that each contact uses in the grasp phase; above 100 % it would slip."""
    instance_of("plan", plan, PlanRecord)
    times, safety = plan.motion.times, plan.friction.safety
    forces = np.einsum("kji,mkj->mki", plan.contacts.rotations_oc, plan.motion.forces_o)
    limit = plan.friction.mu * forces[:, :, 2]
    pressed = limit > 1e-3 * limit.max()  # at negligible normal forces the share is meaningless
    share = np.where(pressed, np.hypot(forces[:, :, 0], forces[:, :, 1]) / np.where(pressed, limit, 1.0), np.nan)
    figure = NotebookFigure(figsize=(6.4, 4.0), layout=PanelLayout())
    axes = figure.subplots()
    drawn = times >= plan.forces.impact_time
    _contact_lines(axes, plan, times[drawn], 100 * share[drawn])
    axes.axhline(100, color="0.2", linewidth=1.2)
    axes.text(times[-1], 99, "slips above ", ha="right", va="top", fontsize=8, color="0.2")
    if safety > 1:
        axes.axhline(100 / safety, color="0.4", linewidth=0.9, linestyle=":")
        axes.text(
            times[-1],
            99 / safety,
            f"safety factor {safety:g} ",
            ha="right",
            va="top",
            fontsize=8,
            color="0.4",
        )
    most = np.nan_to_num(100 * share[drawn]).max(initial=0.0)
    axes.set(xlabel="time [s]", ylabel="friction used, of mu F_n [%]", ylim=(0, max(105, 1.05 * most)))
    grid(axes)
    legend_above(axes, 4)
    return figure


def wrench_margin(plan: PlanRecord) -> Figure:
    """The largest force that the grasp withstands besides its load, by direction, in three planes."""
    instance_of("plan", plan, PlanRecord)
    if plan.reach is None:
        raise InvalidInput("figure: expected a plan with its margins by direction, got one without: plan.with_reach()")
    directions, margins = plan.reach.directions, plan.reach.forces
    figure = NotebookFigure(figsize=(11.4, 4.2), layout=PanelLayout())
    planes = (("x", "y"), ("x", "z"), ("y", "z"))
    for axes, plane, along, reach in zip(figure.subplots(1, 3), planes, directions, margins):
        points = (reach[:, None] * along)[:, ["xyz".index(axis) for axis in plane]]
        closed = np.vstack([points, points[:1]])
        axes.fill(closed[:, 0], closed[:, 1], color=_NEUTRAL, alpha=0.15)
        axes.plot(closed[:, 0], closed[:, 1], color=_NEUTRAL, linewidth=1.6)
        axes.plot(0, 0, "+", color="0.2")
        axes.set(xlabel=f"force along {plane[0]} [N]", ylabel=f"force along {plane[1]} [N]")
        grid(axes)
    told = "Disturbing forces on the centre of mass that friction can hold besides the load (gravity along -z)"
    figure.axes[0].text(0, 1.02, told, transform=figure.axes[0].transAxes, va="bottom", fontsize=10)
    return figure


def search_over_time(plan: PlanRecord) -> Figure:
    """Grasp energy over the impact time: the lower bound of each interval of t_I, the best found, and the gap."""
    instance_of("plan", plan, PlanRecord)
    certificate = plan.forces.certificate
    if certificate is None or not len(certificate.branches):
        raise InvalidInput("figure: expected a plan of search='convex'; the grids prove no bounds")
    unit, scale = {"work": ("mJ", 1e3), "impulse": ("N s", 1.0)}[plan.measure]
    start, end, bound, best = certificate.branches.T * [[1.0], [1.0], [scale], [scale]]
    figure = NotebookFigure(figsize=(10.4, 4.2), layout=PanelLayout())
    bounds, gap = figure.subplots(1, 2)
    known = np.isfinite(bound)
    bounds.hlines(
        bound[known],
        start[known],
        end[known],
        color="0.5",
        linewidth=1.6,
        label="lower bound in this interval",
    )
    if (~known).any():
        floor = np.nanmin(np.where(known, bound, np.nan)) if known.any() else 0.0
        bounds.hlines(
            np.full((~known).sum(), floor),
            start[~known],
            end[~known],
            color="0.6",
            linewidth=3.0,
            alpha=0.5,
            label="no forces in this interval",
        )
    bounds.plot(plan.forces.impact_time, scale * certificate.objective, "o", color="black", label="found")
    bounds.set(xlabel="impact time t_I [s]", ylabel=f"{make_label(plan.measure)} [{unit}]")
    steps = np.arange(1, len(best) + 1)
    known = np.isfinite(best)
    told = f"best found (gap {certificate.relative_gap:.0e})"
    gap.step(steps[known], best[known], where="post", color="black", linewidth=1.6, label=told)
    floor = scale * certificate.lower_bound
    gap.axhline(floor, color="0.5", linewidth=1.4, linestyle="--", label="final lower bound")
    gap.set(xlabel="intervals searched", ylabel=f"{make_label(plan.measure)} [{unit}]")
    for axes in (bounds, gap):
        grid(axes)
        legend_above(axes, 2)
    return figure


def sweep_map(columns: Mapping[str, Iterable[object]], value: str, x: str, y: str | None = None) -> Figure:
    """A value of a sweep over one or two of its inputs; grey: no grasp.

    Args:
        columns: of the sweep's table, name to values (r,).
        value: the column to show.
        x: the column of an input.
        y: the column of a second input, on a grid with x; None: a line over x.
    """
    columns = mapping_of("columns", columns, "{name: values}")
    for name in (value, x, *(() if y is None else (y,))):
        one_of("column", name, columns)
    given = [np.nan if v is None else v for v in items_of(f"column '{value}'", columns[value], object)]
    values = floats_of(f"column '{value}'", given)
    across = array_of(f"column '{x}'", columns[x], values.shape)
    figure = NotebookFigure(figsize=(6.8, 4.6), layout="constrained")
    axes = figure.subplots()
    if y is None:
        order = np.argsort(across)
        axes.plot(across[order], values[order], "o-", color=_NEUTRAL, linewidth=1.4, markersize=4)
        axes.set(xlabel=make_label(x), ylabel=make_label(value))
        grid(axes)
        return figure
    up = array_of(f"column '{y}'", columns[y], values.shape)
    xs, ys = np.unique(across), np.unique(up)
    cells = np.full((len(ys), len(xs)), np.nan)
    cells[np.searchsorted(ys, up), np.searchsorted(xs, across)] = values
    drawn = axes.pcolormesh(xs, ys, np.ma.masked_invalid(cells), cmap="cividis", shading="nearest")
    axes.set_facecolor("0.85")
    figure.colorbar(drawn, ax=axes, label=make_label(value))
    axes.set(xlabel=make_label(x), ylabel=make_label(y), title="grey: no grasp")
    return figure


def _figures(plan: PlanRecord) -> dict[str, Callable[[], Figure]]:
    """What draws each figure of a plan, by the names of their files."""
    from pinograsp.viz.still import picture

    touching = {name.split("/")[0] for name in plan.contacts.names}
    named: dict[str, Callable[[], Figure]] = {}
    if plan.hand is not None:
        named["grasp"] = partial(picture, plan)
    if _find_moving(plan):
        named |= {"joint_angles": partial(joint_angles, plan), "joint_rates": partial(joint_rates, plan)}
    named |= {f"torques_{name}": partial(joint_torques, plan, name) for name in plan.layout.fingers if name in touching}
    for figure in (contact_forces, grasp_energy, friction_use):
        named[figure.__name__] = partial(figure, plan)
    if plan.reach is not None:
        named["wrench_margin"] = partial(wrench_margin, plan)
    if plan.forces.certificate is not None and len(plan.forces.certificate.branches):
        named["search_over_time"] = partial(search_over_time, plan)
    files: dict[str, Callable[[], Figure]] = {}
    for name, drawn in named.items():
        # Names of fingers come from the hand's file and may hold any characters.
        stem = re.sub(r"[^A-Za-z0-9_]", "_", name)[:80]
        files[f"{stem}_{len(files)}.png" if f"{stem}.png" in files else f"{stem}.png"] = drawn
    return files


def figure_files(plan: PlanRecord) -> list[str]:
    """Names of the files that :func:`save_figures` writes."""
    return list(_figures(instance_of("plan", plan, PlanRecord)))


def save_figures(plan: PlanRecord, folder: str | Path) -> list[Path]:
    """Write all figures of a plan as PNG files, and a picture if it has its hand; returns their paths."""
    return save_all(_figures(instance_of("plan", plan, PlanRecord)), folder)
