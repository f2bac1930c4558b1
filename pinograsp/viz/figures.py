"""Figures of a run, as Matplotlib figures: the paper's Figs. 14 to 18. They need a :class:`~pinograsp.storage.Run` only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pinograsp.storage import Run

# Okabe-Ito colours, told apart by colour-blind readers too, and line styles for print.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_STYLES = ("-", "--", "-.", ":")


def _lines(axes, times, values, labels) -> None:
    for i, label in enumerate(labels):
        axes.plot(times, values[:, i], _STYLES[i % 4], color=COLOURS[i % 7], linewidth=1.6, label=label)


def _phases(axes, run: Run) -> None:
    """Mark the impact and name the phases on either side."""
    impact, end = run.summary["impact_time_s"], run.summary["final_time_s"]
    axes.axvspan(impact, end, color="0.92", zorder=0)
    axes.axvline(impact, color="0.4", linewidth=0.8)
    foot = {"transform": axes.get_xaxis_transform(), "va": "bottom", "fontsize": 8, "color": "0.35"}
    axes.text(impact, 0.01, "approach ", ha="right", **foot)
    axes.text(impact, 0.01, " grasp", ha="left", **foot)
    axes.grid(alpha=0.3, linewidth=0.5)
    axes.set_xlabel("time [s]")


def _moving(run: Run) -> list[str]:
    """Fingers that move or carry torque from contact, in the hand's order."""
    q = run.arrays["q"]
    return [name for name, dofs in run.layout["fingers"].items() if np.ptp(q[:, dofs], axis=0).max(initial=0.0) > 0]


def joint_angles(run: Run) -> Figure:
    """Joint angles over time, a panel per moving finger (Fig. 14 d-f)."""
    fingers = _moving(run)
    figure = Figure(figsize=(4.2 * len(fingers), 3.6), layout="constrained")
    for axes, name in zip(np.ravel(figure.subplots(1, len(fingers), squeeze=False)), fingers):
        dofs = run.layout["fingers"][name]
        _lines(axes, run.arrays["times"], np.degrees(run.arrays["q"][:, dofs]), [run.layout["joints"][i] for i in dofs])
        _phases(axes, run)
        axes.set(title=name, ylabel="joint angle [deg]", xlim=(0, run.summary["final_time_s"]))
        axes.legend(fontsize=8, loc="center left")
    return figure


def joint_torques(run: Run, finger: str) -> Figure:
    """Joint torques of one finger over time: the whole motion, and the approach alone (Figs. 15-17 b)."""
    dofs = run.layout["fingers"][finger]
    labels = [run.layout["joints"][i] for i in dofs]
    times, torques, impact = run.arrays["times"], run.arrays["torques"][:, dofs], int(run.arrays["impact"])
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    whole, early = figure.subplots(1, 2)
    _lines(whole, times, torques, labels)
    _phases(whole, run)
    whole.set(title=f"{finger}: joint torques", ylabel="torque [N m]", xlim=(0, run.summary["final_time_s"]))
    whole.legend(fontsize=8, loc="center left")
    _lines(early, times[: impact + 1], 1e3 * torques[: impact + 1], labels)
    early.grid(alpha=0.3, linewidth=0.5)
    early.set(title="approach phase alone", xlabel="time [s]", ylabel="torque [mN m]", xlim=(0, times[impact]))
    return figure


def contact_forces(run: Run) -> Figure:
    """Normal forces with the net force on the object, and penetration depth, in the grasp phase (Fig. 18)."""
    impact, summary = int(run.arrays["impact"]), run.summary
    # A fifth of the grasp phase before the impact shows where the contact begins.
    lead = (summary["final_time_s"] - summary["impact_time_s"]) / 5
    shown = run.arrays["times"] >= summary["impact_time_s"] - lead
    times = run.arrays["times"][shown]
    figure = Figure(figsize=(10.4, 4.2), layout="constrained")
    force, depth = figure.subplots(1, 2)
    labels = run.layout["contacts"]
    _lines(force, times, run.arrays["normal_forces"][shown], labels)
    # Until it is released at t_F something else carries the object: its weight counts from there.
    from_fingers = run.arrays["forces_o"].sum(axis=1)[shown]
    force.plot(times, np.linalg.norm(from_fingers, axis=1), color="0.2", linewidth=1.2, label="resultant of the contacts")
    left = np.linalg.norm(run.arrays["net_force_o"][impact:], axis=1)
    force.plot(
        run.arrays["times"][impact:], left, color="0.55", linewidth=1.2, linestyle=(0, (1, 1)), label="net force, load included"
    )
    force.set(ylabel="force [N]")
    _lines(depth, times, 1e3 * run.arrays["depth"][shown], labels)
    depth.set(ylabel="penetration depth [mm]")
    for axes in (force, depth):
        _phases(axes, run)
        axes.set_xlim(times[0], times[-1])
        axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return figure


def save_figures(run: Run, folder: str | Path) -> list[Path]:
    """Write every figure of a run as PNG; returns the paths in the order of the paper's figures."""
    touching = {name.split("/")[0] for name in run.layout["contacts"]}
    figures = {"joint_angles": joint_angles(run)} if _moving(run) else {}
    figures |= {f"torques_{name}": joint_torques(run, name) for name in run.layout["fingers"] if name in touching}
    figures["contact_forces"] = contact_forces(run)
    paths = []
    for name, figure in figures.items():
        paths.append(Path(folder) / f"{name.replace('/', '_')}.png")
        figure.savefig(paths[-1], dpi=130)
    return paths
