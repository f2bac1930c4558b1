"""Figures that compare a simulation with its plan."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinograsp.checks import instance_of
from pinograsp.plan import Simulation
from pinograsp.viz.figures import note
from pinograsp.viz.style import COLOURS, NotebookFigure, contact_colours, grid, legend_above, make_label, save_all


def _hold(axes: Axes, simulation: Simulation) -> None:
    """Mark when the object was let go."""
    if simulation.release is not None:
        axes.axvspan(simulation.release, simulation.times[-1], color="0.92", zorder=0)
        note(axes, simulation.release, " let go", "left")
    grid(axes)
    axes.set_xlabel("time [s]")


def forces_beside_plan(simulation: Simulation) -> Figure:
    """Simulated normal forces over time with the planned final ones, and penetration depths."""
    instance_of("simulation", simulation, Simulation)
    figure = NotebookFigure(figsize=(10.4, 4.2), layout="constrained")
    force, depth = figure.subplots(1, 2)
    times, drawn = simulation.times, simulation.times >= _first_touch(simulation)
    for i, (part, colour) in enumerate(zip(simulation.parts, contact_colours(simulation.parts))):
        force.plot(
            times[drawn], simulation.normal_forces[drawn, i], color=colour, linewidth=1.6, label=make_label(part)
        )
        force.axhline(simulation.planned_forces[i], color=colour, linestyle="--", linewidth=1.0)
        depth.plot(times[drawn], 1e3 * simulation.depths[drawn, i], color=colour, linewidth=1.6, label=make_label(part))
    force.set(ylabel="normal force [N], planned: dashed")
    depth.set(ylabel="penetration depth [mm]")
    for axes in (force, depth):
        _hold(axes, simulation)
        legend_above(axes, 3)
    return figure


def object_motion(simulation: Simulation) -> Figure:
    """Motion of the object after it was let go, and slip of the contacts."""
    instance_of("simulation", simulation, Simulation)
    figure = NotebookFigure(figsize=(10.4, 3.6), layout="constrained")
    drift, slip = figure.subplots(1, 2)
    times, places = simulation.times, simulation.com_o
    start = simulation.complete
    moved = 1e3 * (places[start:] - places[start])
    for i, (axis, style) in enumerate(zip("xyz", ("-", "--", ":"))):
        drift.plot(times[start:], moved[:, i], style, color="0.45", linewidth=1.4, label=axis)
    drift.plot(times[start:], np.linalg.norm(moved, axis=1), color="black", linewidth=1.6, label="distance")
    drift.set(ylabel="drift of the centre of mass [mm]")
    for i, (part, colour) in enumerate(zip(simulation.parts, contact_colours(simulation.parts))):
        slip.plot(
            times[start:],
            1e3 * (simulation.slips[start:, i] - simulation.slips[start, i]),
            color=colour,
            linewidth=1.4,
            label=make_label(part),
        )
    slip.set(ylabel="slip since then [mm]")
    for axes in (drift, slip):
        _hold(axes, simulation)
        legend_above(axes, 4)
    return figure


def energy_audit(simulation: Simulation) -> Figure:
    """Energy put in by motors and load, and how it was stored or lost."""
    instance_of("simulation", simulation, Simulation)
    figure = NotebookFigure(figsize=(6.4, 3.8), layout="constrained")
    axes, energies = figure.subplots(), simulation.energies
    put_in = energies["joint_work"] + energies["load_work"]
    parts = ("mechanical", "elastic", "damped", "slipped")
    for i, name in enumerate(parts):
        axes.plot(simulation.times, 1e3 * energies[name], color=COLOURS[i], linewidth=1.4, label=name)
    axes.plot(simulation.times, 1e3 * put_in, color="0.2", linewidth=2.2, label="put in")
    axes.plot(
        simulation.times,
        1e3 * sum(energies[name] for name in parts),
        color="0.75",
        linewidth=1.0,
        linestyle="--",
        label="sum of the four",
    )
    axes.set(ylabel="energy [mJ]")
    _hold(axes, simulation)
    legend_above(axes, 3)
    return figure


def _first_touch(simulation: Simulation) -> float:
    """Time shortly before the first touch, by a tenth of the grasp phase [s]."""
    touching = np.flatnonzero((simulation.normal_forces > 0).any(axis=1))
    if not touching.size:
        return 0.0
    first, until = float(simulation.times[touching[0]]), float(simulation.times[simulation.complete])
    return first - 0.1 * abs(until - first)


def save_check_figures(simulation: Simulation, folder: str | Path) -> list[Path]:
    """Write the figures of a simulation as PNG files; returns their paths."""
    figures = {"forces.png": forces_beside_plan, "object.png": object_motion, "energy.png": energy_audit}
    return save_all({name: partial(figure, simulation) for name, figure in figures.items()}, folder)
