"""``pinograsp pick``."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.options import RESERVE_HELP, ArmOptions, force_option, new_folder, out_option, read_numbers
from pinograsp.cli.plan import SPECS
from pinograsp.cli.screen import show
from pinograsp.cli.session import REQUIRED, Session, argument, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.hands import HandModel
    from pinograsp.objects import Scene
    from pinograsp.objects.body import Body
    from pinograsp.pick import PickPlan, PickSimulation, PlaceRegion
    from pinograsp.spatial import Array

_REMARKS = 3  # warnings on the first screen
_PLACE = "x,y,z\\[,roll,pitch,yaw] of its frame, or x,y if it stands on the table \\[m, deg]"
_REGION = "or anywhere in x1:x2,y1:y2\\[,z]"

_what = partial(option, "What to pick")
_around = partial(option, "Surroundings")
_mount = partial(option, "A hand from another file")


@dataclass(frozen=True, slots=True, kw_only=True)
class PickOptions:
    """Robot, object, and where it goes."""

    robot: str = argument(
        "Arm and hand: a file, or a hand from the catalogue whose file has an arm, read with the options "
        "--root to --posture.",
        complete=completion.complete_hands,
    )
    object: str = argument(f"Object to pick, such as {SPECS}.", complete=completion.objects)
    at: str = _what(f"Place of the object: {_PLACE}.", default=REQUIRED, metavar="PLACE")
    to: str | None = _what(f"Target place, in the same form, {_REGION}; default: only lift it.", metavar="PLACE")
    lift: float = _what("How far to lift the object straight up \\[m].", default=0.1)
    upright: float | None = _what("How far the object may tilt on the way \\[deg]; default: any tilt.")
    object_speed: float | None = _what("How fast the object may move \\[m/s]; default: as fast as the arm.")
    mu: float = _what("Friction coefficient.", default=defaults.MU)
    reserve: str | None = _what(RESERVE_HELP, choices=completion.RESERVES)
    seed: int = _what("Random seed.", default=0)
    rate: float = _what("Sampling rate of the trajectory \\[Hz].", default=500.0)
    check: bool = _what("Also simulate the pick.", "--check", default=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class MountOptions:
    """Arm and hand from two files."""

    hand: str | None = _mount("File of the hand, or a hand from the catalogue.", complete=completion.complete_hands)
    link: str | None = _mount("Link of the robot to which the hand is fixed.")
    remove: list[str] | None = _mount(
        "Link of the robot to leave out with everything that it carries; repeatable.", metavar="LINK"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class AroundOptions:
    """Table and obstacles."""

    table: float = _around("Height of the table \\[m].", default=0.0)
    boxes: list[str] | None = _around(
        "Obstacle: a box along the world's axes, edge lengths and centre \\[m]; repeatable.",
        "--box",
        metavar="NAME=dx,dy,dz,x,y,z",
    )
    clearance: float = _around("Distance to keep from table and obstacles \\[m].", default=0.01)


def pick(
    *,
    what: PickOptions,
    around: AroundOptions,
    mount: MountOptions,
    arm: ArmOptions,
    out: Annotated[Path | None, out_option("a new one, picks/NAME, picks/NAME-2, ...")] = None,
    force: Annotated[bool, force_option("earlier results in --out")] = False,
    session: Session,
) -> None:
    r"""Pick an object from a table with an arm, carry it and put it down: grasp, paths, timing and torques.

    Examples:
      pinograsp pick panda sphere:radius=0.03,mass=0.1 --at 0.5,0.2 --to 0.5,-0.2

    Add --check to simulate the pick, --box wall=0.02,0.3,0.2,0.5,0,0.1 for an
    obstacle, --upright 10 for a full object, --to 0.4:0.6,-0.3:-0.1 for anywhere
    in a rectangle, --hand and --link for a hand on another arm, and --posture for
    the arm's start. Needs the extra arm: pip install 'pinograsp\[arm]'
    """
    from pinograsp.cases.reserve_section import make_reserve
    from pinograsp.forces import GraspConditions
    from pinograsp.objects import object_from
    from pinograsp.pick import PickMotion, plan_pick, save_pick, simulate_pick

    robot, scene = _load_robot(what.robot, mount, arm), _make_scene(around)
    body = object_from(what.object)
    body = body.placed(_read_place("--at", what.at, body, around.table))
    place = None if what.to is None else _read_goal(what.to, body, around.table)
    upright = None if what.upright is None else math.radians(what.upright)
    conditions = GraspConditions(mu=what.mu, reserve=make_reserve("default" if what.reserve is None else what.reserve))
    with new_folder(out, force, f"{Path(what.robot).stem}-{what.object.partition(':')[0]}", Path("picks")) as folder:
        plan = plan_pick(
            robot,
            body,
            scene,
            conditions,
            place=place,
            motion=PickMotion(lift=what.lift, upright=upright, object_speed=what.object_speed),
            seed=what.seed,
            progress=session.progress,
        )
        simulation = simulate_pick(plan) if what.check else None
        save_pick(plan, folder, rate=what.rate, simulation=simulation)
    if session.as_json:
        seen = {} if simulation is None else simulation.summary()
        session.print_json({**plan.summary(), **seen, "folder": str(folder.path)})
    else:
        _print(plan, simulation, folder.path, session)
    if simulation is not None and not simulation.done:
        raise typer.Exit(3)


def _load_robot(robot: str, mount: MountOptions, arm: ArmOptions) -> HandModel:
    """Arm and hand in one model."""
    from pinograsp.hands import attach, load_hand
    from pinograsp.hands.attach import take_drives
    from pinograsp.hands.catalogue import CATALOGUE, file_of

    settings = arm.settings()
    file = file_of(robot) if robot in CATALOGUE else Path(robot)
    if mount.hand is not None:
        if mount.link is None:
            raise InvalidInput("--hand: expected --link, of the robot, that the hand is fixed to, got none")
        files = {name: settings[name] for name in ("root", "posture", "trusted", "packages", "xacro_args")}
        return attach(file, mount.hand, link=mount.link, remove=mount.remove or (), **files)
    if mount.link is not None or mount.remove:
        raise InvalidInput("--link, --remove: expected with --hand, got them without")
    if robot in CATALOGUE and settings["palm"] is None and settings["root"] is None:
        # The file's efforts of a hand are often no more than a simulator needs: the catalogue knows better.
        alone = load_hand(robot, drives=settings.pop("drives"))
        settings |= {"palm": alone.palm, "fingers": {finger.name: finger.tip for finger in alone.fingers}}
        return take_drives(load_hand(file, **settings), alone)
    return load_hand(file, **settings)


def _make_scene(around: AroundOptions) -> Scene:
    from pinograsp.objects import Scene

    scene = Scene.on_table(around.table, clearance=around.clearance)
    for text in around.boxes or []:
        name, _, numbers = text.partition("=")
        sizes = read_numbers("--box", numbers, (6,), "NAME=dx,dy,dz,x,y,z [m]")
        scene = scene.with_box(name, sizes[:3], at=sizes[3:])
    return scene


def _read_place(name: str, text: str, body: Body, table: float) -> Array:
    """The pose (4, 4) of the object's frame."""
    import numpy as np

    from pinograsp.spatial import pose_of, rotation_rpy

    numbers = read_numbers(name, text, (2, 3, 6), "x,y or x,y,z or x,y,z,roll,pitch,yaw [m, deg]")
    if len(numbers) == 2:
        far = body.com_o - np.array([0.0, 0.0, 1e4 * body.bounding_radius])
        lowest = float(body.project(far[None])[0][0, 2])
        return pose_of([*numbers, table + body.pose[2, 3] - lowest], body.pose[:3, :3])
    turn = np.eye(3) if len(numbers) == 3 else rotation_rpy(*np.radians(numbers[3:]))
    return pose_of(numbers[:3], turn)


def _read_goal(text: str, body: Body, table: float) -> Array | PlaceRegion:
    """A pose (4, 4) of the object's frame, or a region."""
    from pinograsp.pick import PlaceRegion

    if ":" not in text:
        return _read_place("--to", text, body, table)
    sides, *height = text.rsplit(",", 1) if text.count(",") == 2 else (text,)
    x, _, y = sides.partition(",")
    (left, right), (near, far) = (
        read_numbers("--to", side.replace(":", ","), (2,), "x1:x2,y1:y2[,z] [m]") for side in (x, y)
    )
    if height:
        z = read_numbers("--to", height[0], (1,), "x1:x2,y1:y2[,z] [m]")[0]
    else:
        z = float(_read_place("--to", f"{left},{near}", body, table)[2, 3])
    return PlaceRegion(x=(left, right), y=(near, far), z=z)


def _print(plan: PickPlan, simulation: PickSimulation | None, folder: Path, session: Session) -> None:
    """Phases, and at the end whether it goes."""
    facts = [(phase.name, f"{phase.duration:.3g} s") for phase in plan.phases]
    cautions = list(plan.cautions if session.verbose else plan.cautions[:_REMARKS])
    facts += [("warning", one) for one in cautions]
    squeeze = plan.carry.squeeze
    answers = [
        ("Is it possible?", f"{plan.status}: {plan.duration:.3g} s, after {plan.tried} grasps"),
        ("How hard?", f"{squeeze.min():.3g} to {squeeze.max():.3g} N in total along the path"),
    ]
    level = "caution" if plan.cautions else "yes"
    if simulation is not None:
        answers.append(("Did it work?", simulation.tell()))
        level = level if simulation.done else "no"
    answers.append(("Results", f"{folder / 'report.html'}, beside it view.html, trajectory.csv, .json and .xml"))
    then = [(f"xdg-open {shlex.quote(str(folder / 'view.html'))}", "see arm and hand move")]
    show(facts, answers, then, title=f"{plan.robot.name} picks it", level=level, more=session.more)
