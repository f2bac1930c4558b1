"""``pinograsp export``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp.cli import completion
from pinograsp.cli.options import read_numbers, refuse_existing
from pinograsp.cli.screen import Fact, show
from pinograsp.cli.session import Session, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.handover import JawCommand, JointTrajectory

_CARRY = "carry.json"  # in a folder of 'pinograsp carry'
_RATE = 1000.0  # [Hz]
_ENDINGS = {"--csv": (".csv",), "--ros2": (".yaml", ".yml", ".json"), "--mujoco": (".xml",)}

_file = partial(option, "What to write")
_motor = partial(option, "Commands for the motors")
_start = partial(option, "The start")


@dataclass(frozen=True, slots=True, kw_only=True)
class FileOptions:
    """What is written, and what is in it."""

    csv: Path | None = _file("Write a table: time, then each joint's position, velocity, ... (.csv).", metavar="FILE")
    ros2: Path | None = _file("Write a ROS 2 message, a JointTrajectory (.yaml, .json).", "--ros2", metavar="FILE")
    mujoco: Path | None = _file(
        "Write keyframes for MuJoCo, with the controls in a second file (.xml).", metavar="FILE"
    )
    dexgraspbench: Path | None = _file(
        "Write a grasp for DexGraspBench's evaluation into this folder: postures before, at and after the grasp.",
        "--dexgraspbench",
        metavar="DIR",
    )
    object_path: str | None = _file(
        "With --dexgraspbench: the object's folder, relative to the root of its repository (assets/...).",
        "--object-path",
        metavar="PATH",
    )
    object_scale: float = _file(
        "With --dexgraspbench: scale of the object's mesh there.", "--object-scale", default=1.0
    )
    units: str = _file(
        "With --csv and --command: SI, or register (whole numbers for the drives' registers; with --command "
        "jaw, speed and force limit for closing drives).",
        default="SI",
        choices=completion.UNITS,
    )
    followers: bool = _file(
        "With --csv and --ros2: also write columns for coupled joints.", "--followers", default=False
    )
    goal: bool = _file(
        "With --ros2: write a goal of FollowJointTrajectory, not only the message.", "--goal", default=False
    )
    effort: bool = _file("With --ros2: include the joints' torques in the message.", default=True)
    scene: bool = _file(
        "With --mujoco: write a scene that loads by itself, with hand, object and motors.", "--scene", default=False
    )
    force: bool = _file("Overwrite existing files.", "--force", default=False)

    @property
    def places(self) -> dict[str, Path]:
        """The files that are wanted, by option."""
        places = {"--csv": self.csv, "--ros2": self.ros2, "--mujoco": self.mujoco}
        return {option: file for option, file in places.items() if file is not None}

    @property
    def contents(self) -> dict[str, dict[str, Any]]:
        """What is in a file, by option."""
        table: dict[str, Any] = {"followers": self.followers}
        return {
            "--csv": {**table, "units": self.units},
            "--ros2": {**table, "goal": self.goal, "effort": self.effort},
            "--mujoco": {},
        }

    def check(self) -> None:
        """InvalidInput for options that nothing written would heed, files without their ending, none at all."""
        places = self.places
        if not places and self.dexgraspbench is None:
            names = ", ".join(f"{name} FILE" for name in _ENDINGS)
            raise InvalidInput(f"expected one or more of {names}, or --dexgraspbench DIR")
        if (self.dexgraspbench is None) is not (self.object_path is None):
            raise InvalidInput("--dexgraspbench DIR and --object-path PATH: expected both, got one of them")
        if places and self.dexgraspbench is not None:
            raise InvalidInput(f"--dexgraspbench: expected it alone, got {', '.join(places)} besides")
        for name, file in places.items():
            if file.suffix not in _ENDINGS[name]:
                endings = ", ".join(_ENDINGS[name])
                raise InvalidInput(f"{name}: expected a name that ends in {endings}, got '{file.name}'")
        for flag, is_set, options in (
            ("--followers", self.followers, ("--csv", "--ros2")),
            ("--goal", self.goal, ("--ros2",)),
            ("--no-effort", not self.effort, ("--ros2",)),
            ("--scene", self.scene, ("--mujoco",)),
            ("--units", self.units != "SI", ("--csv",)),
            ("--object-scale", self.object_scale != 1.0 and self.object_path is None, ("--dexgraspbench",)),
        ):
            if is_set and not places.keys() & set(options):
                raise InvalidInput(f"{flag}: expected with {' or '.join(options)}, got {', '.join(places)}")
        for name, file in places.items():
            refuse_existing(name, file, self.force)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorOptions:
    """What the motors are sent."""

    command: str | None = _motor(
        "What to command: torque, position (servos without feed-forward), impedance (servos with "
        "feed-forward) or jaw (a gripper's force, and its widths when the jaws touch and at the end); "
        "default: the joints' motion with their torques.",
        choices=completion.COMMANDS,
    )
    stiffness: str | None = _motor(
        "Stiffness of all servos, or of each servo \\[N m/rad or N/m]; default: the hand's own.", metavar="K[,K...]"
    )
    damping: str | None = _motor("Damping of all servos, or of each servo \\[N m s/rad or N s/m].", metavar="D[,D...]")
    rate: float = _motor("Samples per second \\[Hz].", default=_RATE)
    blend: float | None = _motor("Time in which to bridge jumps of acceleration \\[s]; default: 0.01.")
    start: str | None = _start(
        "Posture in which the hand is now \\[rad or m], joints in the order of q that 'pinograsp hands NAME' "
        "prints. The trajectory then starts with a straight path from there, which is not checked for "
        "collisions.",
        metavar="Q,Q,...",
    )
    lead: float | None = _start("Duration of the path from --start, or of waiting \\[s]; default: slowly.")

    def settings(self) -> dict[str, Any]:
        """Those that are given, by the names of the functions that write."""
        from pinograsp.checks import one_of
        from pinograsp.handover.commands import COMMANDS

        values: dict[str, Any] = {"lead": self.lead, "blend": self.blend}
        values["command"] = None if self.command is None else one_of("--command", self.command, COMMANDS)
        for name in ("stiffness", "damping", "start"):
            text = getattr(self, name)
            numbers = None if text is None else read_numbers(f"--{name}", text)
            values[name] = numbers[0] if numbers is not None and len(numbers) == 1 else numbers
        return {name: value for name, value in values.items() if value is not None}


def export(
    *,
    run: Annotated[
        Path,
        typer.Argument(help="Folder of a run, or of 'pinograsp carry'.", autocompletion=completion.exportable),
    ],
    files: FileOptions,
    motors: MotorOptions,
    session: Session,
) -> None:
    """Hand a plan over to a controller or a simulator: any of --csv, --ros2, --mujoco and --dexgraspbench.

    Examples:
      pinograsp export runs/paper --csv grasp.csv --ros2 grasp.yaml --rate 500

      pinograsp export runs/paper --csv drives.csv --command position --stiffness 5

      pinograsp export runs/paper --ros2 goal.json --goal --lead 2

      pinograsp export runs/paper --mujoco scene.xml --scene

      pinograsp export runs/paper --dexgraspbench d --object-path rod --stiffness 5
    """
    files.check()
    if motors.command == "jaw" and files.mujoco is not None:
        raise InvalidInput("--mujoco: expected with --command torque, position or impedance, got jaw")
    settings = motors.settings()
    if files.dexgraspbench is not None:
        useless = [f"--{name}" for name in settings if name != "stiffness"] + ["--rate"] * (motors.rate != _RATE)
        if useless:
            raise InvalidInput(f"{', '.join(useless)}: expected with a trajectory, got --dexgraspbench")
        _write_grasp(run, files, settings.get("stiffness"), session)
        return
    jaws: tuple[JawCommand, ...] = ()
    if (run / _CARRY).is_file():
        useless = [f"--{name}" for name in settings]
        useless += ["--scene"] * files.scene + ["--units"] * (files.units != "SI") + ["--rate"] * (motors.rate != _RATE)
        if useless:
            raise InvalidInput(
                f"{', '.join(useless)}: expected a run's folder, got '{run}', a carry plan, whose joints are sampled "
                "already ('pinograsp carry --rate')"
            )
        trajectory = _write_carry(run, files)
    else:
        trajectory, jaws = _write_plan(run, files, {"rate": motors.rate, **settings})
    written = {option.removeprefix("--"): str(file) for option, file in files.places.items()}
    if session.as_json:
        document: dict[str, Any] = {
            "samples": len(trajectory.times),
            "duration_s": float(trajectory.times[-1]),
            "names": list(trajectory.names),
            "notes": list(trajectory.notes),
        }
        if jaws:
            document["jaws"] = [jaw.summary() for jaw in jaws]
        session.print_json({**document, **written})
        return
    answer, *others = trajectory.describe().splitlines()
    facts: list[Fact] = [("", line) for line in (*(jaw.describe() for jaw in jaws), *map(str.strip, others))]
    more = "" if session.verbose else "more: with -v"
    show(facts, [("What is it?", answer), *(("Written", name) for name in written.values())], more=more)


def _write_grasp(run: Path, files: FileOptions, stiffness: Any, session: Session) -> None:
    """Write a run's plan as a grasp of a data set, and say so."""
    from pinograsp.handover import write_dexgraspbench
    from pinograsp.planner import load_run

    place = write_dexgraspbench(
        load_run(run),
        files.dexgraspbench or Path(),
        files.object_path or "",
        scale=files.object_scale,
        name=run.resolve().name,
        stiffness=stiffness,
    )
    if session.as_json:
        session.print_json({"dexgraspbench": str(place)})
        return
    show([], [("What is it?", "a grasp with its pregrasp and squeeze postures"), ("Written", str(place))])


def _write_plan(
    run: Path, files: FileOptions, settings: dict[str, Any]
) -> tuple[JointTrajectory, tuple[JawCommand, ...]]:
    """Write a run's plan; returns the joints' or drives' trajectory, and what jaws are sent."""
    from pinograsp.handover import jaw_commands
    from pinograsp.handover.commands import make_commands
    from pinograsp.planner import load_run

    plan = load_run(run)
    if files.scene and files.mujoco is not None and len(files.places) == 1:
        return plan.to_mujoco(files.mujoco, scene=True, **settings), ()
    trajectory = make_commands(plan, **settings)  # its errors come before anything is written
    jaws = jaw_commands(plan) if settings.get("command") == "jaw" and files.units == "SI" else ()
    if files.csv is not None:
        trajectory = plan.to_csv(files.csv, **files.contents["--csv"], **settings)
    if files.ros2 is not None:
        plan.to_ros2(files.ros2, **files.contents["--ros2"], **settings)
    if files.mujoco is not None:
        plan.to_mujoco(files.mujoco, scene=files.scene, **settings)
    return trajectory, jaws


def _write_carry(folder: Path, files: FileOptions) -> JointTrajectory:
    """Write the trajectory of a carry plan once more; returns it."""
    from pinograsp.handover import read_csv

    trajectory = read_csv(folder / "trajectory.csv")
    if files.csv is not None:
        trajectory.to_csv(files.csv, followers=files.followers)
    if files.ros2 is not None:
        trajectory.to_ros2(files.ros2, **files.contents["--ros2"])
    if files.mujoco is not None:
        trajectory.to_mujoco(files.mujoco)
    return trajectory
