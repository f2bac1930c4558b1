"""``pinograsp export``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from pinograsp.cli.app import Quiet, Verbose, app
from pinograsp.errors import InvalidInput, ResultsNotWritten

_SUFFIXES = (".csv", ".yaml", ".json", ".xml")


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run: what 'pinograsp plan' has written.")],
    file: Annotated[
        Path,
        typer.Argument(help="By its ending: .csv, .yaml or .json (a message of ROS 2), .xml (MuJoCo's keyframes)."),
    ],
    command: Annotated[
        str | None,
        typer.Option(
            help="What the motors are sent: torque, position (servos without feed-forward), impedance (servos with it) "
            "or jaw (width and force of a gripper); default: the joints' motion with their torques."
        ),
    ] = None,
    stiffness: Annotated[
        float | None, typer.Option(help="Of position servos \\[N m/rad or N/m]; default: the hand's own.")
    ] = None,
    damping: Annotated[float | None, typer.Option(help="Of servos \\[N m s/rad or N s/m].")] = None,
    rate: Annotated[float, typer.Option(help="Samples per second \\[Hz].")] = 1000.0,
    scene: Annotated[
        bool, typer.Option("--scene", help="With .xml: a scene that loads by itself, with hand, object and motors.")
    ] = False,
    goal: Annotated[
        bool,
        typer.Option("--goal", help="With .yaml or .json: a goal of FollowJointTrajectory, not the message alone."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a plan for a controller or a simulator.

    Examples:
      pinograsp export runs/paper grasp.csv --rate 500

      pinograsp export runs/paper drives.csv --command position --stiffness 5

      pinograsp export runs/panda grip.yaml --command jaw

      pinograsp export runs/paper scene.xml --scene
    """
    from pinograsp.checks import one_of
    from pinograsp.handover import Command
    from pinograsp.planner import load_run

    kind = file.suffix.lower()
    if kind not in _SUFFIXES:
        raise InvalidInput(f"FILE: expected a name that ends in {', '.join(_SUFFIXES)}, got '{file.name}'")
    if scene and kind != ".xml":
        raise InvalidInput(f"--scene: expected with a name that ends in .xml, got '{file.name}'")
    if goal and kind not in (".yaml", ".json"):
        raise InvalidInput(f"--goal: expected with a name that ends in .yaml or .json, got '{file.name}'")
    if command is not None:
        one_of("--command", command, get_args(Command))
    if os.path.lexists(file) and not force:
        raise ResultsNotWritten(f"'{file}' already exists: choose another name, or overwrite it with --force")
    asked: dict[str, Any] = {"command": command, "stiffness": stiffness, "damping": damping}
    chosen = {"rate": rate} | {key: value for key, value in asked.items() if value is not None}
    plan = load_run(run)
    if kind == ".csv":
        plan.to_csv(file, **chosen)
    elif kind == ".xml":
        plan.to_mujoco(file, scene=scene, **chosen)
    else:
        plan.to_ros2(file, goal=goal, **chosen)
    typer.echo(f"written to {file}")
