"""``pinograsp ros2 hold`` and ``pinograsp ros2 play``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from pinograsp.cli.options import RunFolder
from pinograsp.cli.session import Session, as_command

_ROS, _END = "--ros-args", "--"
RosArguments = Annotated[
    list[str] | None,
    typer.Option(
        _ROS,
        metavar="-p NAME:=VALUE -r FROM:=TO",
        help="Everything that follows, up to -- or the end, is for ROS: parameters, topics.",
    ),
]


class CommandWithRosArguments(TyperCommand):
    """Takes all between ``--ros-args`` and ``--`` as it is."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As its base class."""
        own: list[str] = []
        for_ros = False
        for one in args:
            if one == _ROS:
                for_ros = True
            elif one == _END and for_ros:
                for_ros = False
            else:
                own.append(f"{_ROS}={one}" if for_ros else one)
        return super().parse_args(ctx, own)


def hold(*, run: RunFolder, ros: RosArguments = None, session: Session) -> None:
    """Hold the object of a plan that the hand has grasped: the squeeze reacts to its sensors.

    It ends with SIGINT or SIGTERM; the drives keep the last command. Needs ROS 2,
    or the extra ros2.

    Examples:
      pinograsp ros2 hold runs/paper --ros-args -p rate:=250

    If joint states have efforts, it starts from those, so that it can be stopped
    and started again while the object is held.
    """
    _run(run, ros, session, plays=False, reflex=True)


def play(
    *,
    run: RunFolder,
    reflex: Annotated[
        bool,
        typer.Option("--reflex/--no-reflex", help="Hold with the reflex afterwards, or with the plan's last command."),
    ] = True,
    ros: RosArguments = None,
    session: Session,
) -> None:
    """Play a plan from where the hand is: approach, closing, then hold as pinograsp ros2 hold.

    Needs joint states, and a controller that accepts the commands.

    Examples:
      pinograsp ros2 play runs/paper --ros-args -p stiffness:=5.0 -p interface:=position
    """
    _run(run, ros, session, plays=True, reflex=reflex)


def _run(run: Path, ros: list[str] | None, session: Session, *, plays: bool, reflex: bool) -> None:
    from pinograsp.planner import load_run
    from pinograsp.ros2 import run_node

    run_node(load_run(run), ros or (), plays=plays, reflex=reflex)
    if session.as_json:
        session.print_json({"status": "ok", "run": str(run)})


ros2 = typer.Typer(
    no_args_is_help=True,
    help="""Play and hold a plan as a node of ROS 2.

Examples:
  pinograsp ros2 play runs/paper --ros-args -p message:=trajectory

  pinograsp ros2 hold runs/paper --ros-args -r commands:=/hand/commands

Parameters and topics follow --ros-args; play --no-reflex ends with the plan's
last command.
""",
)
for function in (play, hold):
    ros2.command(cls=CommandWithRosArguments)(as_command(function))
