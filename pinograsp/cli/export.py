"""``pinograsp export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp.cli import completion
from pinograsp.cli.app import Json, Quiet, Verbose, app, given, refuse_existing, tell_json
from pinograsp.cli.screen import Fact, show
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.handover import JawCommand, JointTrajectory

_CARRY = "carry.json"  # in a folder of 'pinograsp carry'


@app.command()
def export(
    run: Annotated[
        Path,
        typer.Argument(
            help="Folder of a run, or of 'pinograsp carry'.",
            autocompletion=completion.handed_over,
        ),
    ],
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", help="A table: time, then each joint's position, velocity, ... (.csv)."),
    ] = None,
    ros2: Annotated[
        Path | None,
        typer.Option("--ros2", metavar="FILE", help="A message of ROS 2: a JointTrajectory (.yaml, .json)."),
    ] = None,
    mujoco: Annotated[
        Path | None, typer.Option("--mujoco", metavar="FILE", help="MuJoCo's keyframes, controls beside them (.xml).")
    ] = None,
    command: Annotated[
        str | None,
        typer.Option(
            help="What the motors are sent: torque, position (servos without feed-forward), impedance (servos with it) "
            "or jaw (force of a gripper, and its widths where the jaws touch and at the end); default: the joints' "
            "motion with their torques.",
            autocompletion=completion.one_of(completion.COMMANDS),
        ),
    ] = None,
    stiffness: Annotated[
        str | None,
        typer.Option(metavar="K[,K...]", help="Of all servos, or of each \\[N m/rad or N/m]; default: the hand's own."),
    ] = None,
    damping: Annotated[
        str | None, typer.Option(metavar="D[,D...]", help="Of all servos, or of each \\[N m s/rad or N s/m].")
    ] = None,
    rate: Annotated[float, typer.Option(help="Samples per second \\[Hz].")] = 1000.0,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="Q,Q,...",
            help="Where the hand is, its joints in the order of q that 'pinograsp hands NAME' tells \\[rad or m]: a "
            "straight way from there, unchecked, comes first.",
        ),
    ] = None,
    lead: Annotated[
        float | None, typer.Option(help="How long the way from --start takes, or waiting \\[s]; default: slowly.")
    ] = None,
    blend: Annotated[
        float | None, typer.Option(help="How long it takes to lead across jumps of acceleration \\[s]; default: 0.01.")
    ] = None,
    followers: Annotated[
        bool, typer.Option("--followers", help="With --csv and --ros2: a column for coupled joints, too.")
    ] = False,
    goal: Annotated[
        bool, typer.Option("--goal", help="With --ros2: a goal of FollowJointTrajectory, not the message alone.")
    ] = False,
    effort: Annotated[
        bool, typer.Option("--effort/--no-effort", help="With --ros2: the message has the joints' torques.")
    ] = True,
    scene: Annotated[
        bool, typer.Option("--scene", help="With --mujoco: a scene that loads by itself: hand, object and motors.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Hand a plan over to a controller or a simulator: any of --csv, --ros2 and --mujoco.

    Examples:
      pinograsp export runs/paper --csv grasp.csv --ros2 grasp.yaml --rate 500

      pinograsp export runs/paper --csv drives.csv --command position --stiffness 5

      pinograsp export runs/paper --ros2 goal.json --goal --lead 2

      pinograsp export runs/paper --mujoco scene.xml --scene
    """
    files = {"--csv": csv, "--ros2": ros2, "--mujoco": mujoco}
    wanted = {option: file for option, file in files.items() if file is not None}
    _refuse_useless(wanted, followers=followers, goal=goal, effort=effort, scene=scene)
    for option, file in wanted.items():
        refuse_existing(option, file, force)
    if command == "jaw" and mujoco is not None:
        raise InvalidInput("--mujoco: expected with --command torque, position or impedance, got jaw")
    asked: dict[str, Any] = {
        "command": None if command is None else _command(command),
        "stiffness": _numbers("--stiffness", stiffness),
        "damping": _numbers("--damping", damping),
        "start": _numbers("--start", start),
        "lead": lead,
        "blend": blend,
    }
    jaws: tuple[JawCommand, ...] = ()
    chosen = {key: value for key, value in asked.items() if value is not None}
    more = {"--csv": {"followers": followers}, "--ros2": {"followers": followers, "goal": goal, "effort": effort}}
    if (run / _CARRY).is_file():
        if chosen or scene or rate != 1000.0:
            given_too = ", ".join([f"--{key}" for key in chosen] + ["--scene"] * scene + ["--rate"] * (rate != 1000.0))
            raise InvalidInput(
                f"{given_too}: expected a run's folder, got '{run}', a carry plan, whose joints are sampled already "
                "('pinograsp carry --rate')"
            )
        trajectory = _carried(run, wanted, more)
    else:
        trajectory, jaws = _planned(run, wanted, more, scene, {"rate": rate, **chosen})
    written = {option.removeprefix("--"): str(file) for option, file in wanted.items()}
    if as_json:
        said: dict[str, Any] = {"samples": len(trajectory.times), "duration_s": float(trajectory.times[-1])}
        said |= {"jaws": [jaw.summary() for jaw in jaws]} if jaws else {}
        tell_json({**said, "names": list(trajectory.names), "notes": list(trajectory.notes), **written})
        return
    told, *others = trajectory.describe().splitlines()
    facts: list[Fact] = [("", line) for line in (*(jaw.describe() for jaw in jaws), *map(str.strip, others))]
    show(facts, [("What is it?", told), *(("Written", name) for name in written.values())], more=_more())


def _more() -> str:
    return "" if given["verbose"] else "more: with -v"


def _refuse_useless(wanted: dict[str, Path], *, followers: bool, goal: bool, effort: bool, scene: bool) -> None:
    """InvalidInput for options that nothing written would heed, files without their ending, and one for two."""
    endings = {"--csv": (".csv",), "--ros2": (".yaml", ".yml", ".json"), "--mujoco": (".xml",)}
    if not wanted:
        raise InvalidInput(f"expected one or more of {', '.join(f'{option} FILE' for option in endings)}")
    for option, file in wanted.items():
        if file.suffix not in endings[option]:
            raise InvalidInput(
                f"{option}: expected a name that ends in {', '.join(endings[option])}, got '{file.name}'"
            )
    for flag, set_, options in (
        ("--followers", followers, ("--csv", "--ros2")),
        ("--goal", goal, ("--ros2",)),
        ("--no-effort", not effort, ("--ros2",)),
        ("--scene", scene, ("--mujoco",)),
    ):
        if set_ and not wanted.keys() & set(options):
            raise InvalidInput(f"{flag}: expected with {' or '.join(options)}, got {', '.join(wanted)}")


def _planned(
    run: Path, wanted: dict[str, Path], more: dict[str, dict[str, Any]], scene: bool, chosen: dict[str, Any]
) -> tuple[JointTrajectory, tuple[JawCommand, ...]]:
    """Write a run's plan; returns the joints' or drives' trajectory, and what jaws are sent."""
    from pinograsp.handover import jaw_commands
    from pinograsp.handover.commands import commanded
    from pinograsp.planner import load_run

    plan = load_run(run)
    if scene and len(wanted) == 1:
        return plan.to_mujoco(wanted["--mujoco"], scene=True, **chosen), ()
    trajectory = commanded(plan, **{"command": None, **chosen})  # its errors come before anything is written
    jaws = jaw_commands(plan) if chosen.get("command") == "jaw" else ()
    if "--csv" in wanted:
        trajectory = plan.to_csv(wanted["--csv"], **more["--csv"], **chosen)
    if "--ros2" in wanted:
        plan.to_ros2(wanted["--ros2"], **more["--ros2"], **chosen)
    if "--mujoco" in wanted:
        plan.to_mujoco(wanted["--mujoco"], scene=scene, **chosen)
    return trajectory, jaws


def _carried(folder: Path, wanted: dict[str, Path], more: dict[str, dict[str, Any]]) -> JointTrajectory:
    """Write the trajectory of a carry plan once more; returns it."""
    from pinograsp.handover import read_csv

    trajectory = read_csv(folder / "trajectory.csv")
    if "--csv" in wanted:
        trajectory.to_csv(wanted["--csv"], **more["--csv"])
    if "--ros2" in wanted:
        trajectory.to_ros2(wanted["--ros2"], **more["--ros2"])
    if "--mujoco" in wanted:
        trajectory.to_mujoco(wanted["--mujoco"])
    return trajectory


def _command(text: str) -> str:
    from pinograsp.checks import one_of
    from pinograsp.handover.commands import COMMANDS

    return str(one_of("--command", text, COMMANDS))


def _numbers(option: str, text: str | None) -> float | list[float] | None:
    """One number, or several."""
    if text is None:
        return None
    try:
        values = [float(value) for value in text.split(",")]
    except ValueError:
        raise InvalidInput(f"{option}: expected numbers separated by commas, got '{text:.100}'") from None
    return values[0] if len(values) == 1 else values
