"""``pinograsp carry``."""

from __future__ import annotations

import functools
import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions, force_option, new_folder, out_option
from pinograsp.cli.screen import command, show
from pinograsp.cli.session import Session
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.carry import CarryPlan, CarryScenario
    from pinograsp.plan import Simulation
    from pinograsp.planner import GraspPlan

_SHOWN, _REMARKS = 6, 3  # stretches of the way, cautions and notes on the first screen
_SHIFTS = ("com_x", "com_y", "com_z")

_way = functools.partial(typer.Option, rich_help_panel="The way")
_limit = functools.partial(typer.Option, rich_help_panel="Limits of the motion")
_bears = functools.partial(typer.Option, rich_help_panel="What is held, and how")


@dataclass(frozen=True, slots=True, kw_only=True)
class WayOptions:
    """The arm's path, and its time."""

    path: Annotated[
        Path,
        _way(
            metavar="FILE",
            help="The arm's way: .csv (a line of joints, then waypoints, with a column time or without), or .yaml, "
            ".json (a trajectory as ROS and MoveIt print it).",
        ),
    ]
    robot: Annotated[
        str | None,
        _way(
            help="Arm and hand in one model: a file, or a hand of the catalogue, read by --root to --posture; default: "
            "the grasp's own hand.",
            autocompletion=completion.hands,
        ),
    ] = None
    timing: Annotated[
        str,
        _way(help="fastest, or given: that of FILE.", autocompletion=completion.one_of(completion.TIMINGS)),
    ] = "fastest"
    intervals: Annotated[int, _way(help="Of the path, or of its time.")] = 500
    rate: Annotated[float, _way(help="Of the trajectory's samples \\[Hz].")] = 1000.0
    check: Annotated[bool, _way("--check", help="Simulate arm, hand and object on the whole way, too.")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionLimits:
    """Limits of the motion."""

    speed: Annotated[float | None, _limit(help="Largest of each joint \\[rad/s or m/s]; default: the robot's own.")] = (
        None
    )
    acceleration: Annotated[float | None, _limit(help="Largest of each joint \\[rad/s^2 or m/s^2].")] = None
    jerk: Annotated[float | None, _limit(help="Largest of each joint \\[rad/s^3 or m/s^3].")] = None
    ramp: Annotated[float | None, _limit(help="Time in which accelerations change, at least \\[s]; default: 0.05.")] = (
        None
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldOptions:
    """What is to be held against, and how the hand presses."""

    squeeze: Annotated[
        str,
        _bears(
            help="least: follows the loads; constant: commanded once; or a number: its largest change \\[N/s].",
            autocompletion=completion.one_of(completion.SQUEEZES),
        ),
    ] = "least"
    scenario: Annotated[
        list[str] | None,
        _bears(
            metavar="NAME=VALUE,...",
            help="What may be otherwise, as well: mass, mu (over the planned), com_x, com_y, com_z \\[m]; repeatable.",
        ),
    ] = None
    reserve: Annotated[float, _bears(help="Share of every limit that is kept free.")] = 0.1
    disturbance: Annotated[
        float | None,
        _bears(help="Force in any direction to bear as well \\[N]; default: what the grasp's plan bears."),
    ] = None
    gravity: Annotated[tuple[float, float, float], _bears(metavar="X Y Z", help="In the robot's world \\[m/s^2].")] = (
        defaults.GRAVITY
    )

    def settings(self) -> dict[str, Any]:
        """By the names of :func:`~pinograsp.carry.plan_carry`; :class:`InvalidInput` for scenarios that are none."""
        try:
            squeeze: str | float = float(self.squeeze)
        except ValueError:
            squeeze = self.squeeze
        bears = {} if self.disturbance is None else {"disturbance": self.disturbance}
        return {
            "squeeze": squeeze,
            "scenarios": [_scenario(text) for text in self.scenario or []],
            "reserve": self.reserve,
            "gravity_o": self.gravity,
            **bears,
        }


def carry(
    *,
    grasp: Annotated[
        str,
        typer.Argument(
            metavar="RUN_OR_CASE",
            help="What is held: a run's folder, or a case.",
            autocompletion=completion.held,
        ),
    ],
    way: WayOptions,
    hold: HoldOptions,
    limits: MotionLimits,
    arm: ArmOptions,
    out: Annotated[Path | None, out_option("a new one, carries/NAME, carries/NAME-2, ...")] = None,
    force: Annotated[bool, force_option("earlier results in --out")] = False,
    session: Session,
) -> None:
    r"""Carry what a hand holds along an arm's path: how fast, how hard to squeeze on the way, and what binds where.

    Examples:
      pinograsp plan --hand panda --object sphere:radius=0.03,mass=0.1 --out ball

      printf 'panda_joint1,panda_joint4\n0,-2\n0.8,-1.6\n' > way.csv

      pinograsp carry ball --robot panda --root panda_link0 --path way.csv

    Add --check to simulate it, --squeeze constant for a gripper that is told one force, --scenario mass=1.2 to bear
    more. What each answer means: docs/howto/answers.md
    """
    from pinograsp.carry import ArmPath, plan_carry, save_carry, simulate_carry
    from pinograsp.hands import load_hand

    path, held = ArmPath.read(way.path), _load_grasp(grasp, session)
    described = arm.settings()
    hand = held.hand if way.robot is None else load_hand(way.robot, **described)
    bounds = {name: value for name, value in asdict(limits).items() if value is not None}
    with new_folder(out, force, Path(grasp).name, Path("carries")) as folder:
        plan = plan_carry(
            hand,
            held,
            path,
            timing=way.timing,  # type: ignore[arg-type]  # checked there
            intervals=way.intervals,
            **hold.settings(),
            **bounds,
        )
        simulation = simulate_carry(plan) if way.check else None
        save_carry(plan, folder, rate=way.rate, simulation=simulation)
    if session.as_json:
        verdict = {}
        if simulation is not None:
            verdict = {"held": simulation.verdict.held, "reason": simulation.verdict.reason}
        session.print_json({**plan.summary(), **verdict, "folder": str(folder.path)})
    else:
        _print(plan, simulation, folder.path, session)
    if simulation is not None and not simulation.verdict.held:
        raise typer.Exit(3)


def _print(plan: CarryPlan, simulation: Simulation | None, folder: Path, session: Session) -> None:
    """What binds where, and at the end how fast and how hard."""
    stretches = [
        ("binds", f"{plan.times[first]:.3g} to {plan.times[last + 1]:.3g} s: {what}")
        for what, first, last in plan.stretches()
    ]
    if not session.verbose and len(stretches) > _SHOWN:
        shares = [("binds", f"{100 * share:.0f} % of the time: {what}") for what, share in plan.shares()]
        stretches = shares[:_SHOWN]
    remarks = [*(("caution", one) for one in plan.cautions), *(("note", one) for one in plan.notes)]
    if not session.verbose and len(remarks) > _REMARKS:
        left = len(remarks) - _REMARKS
        remarks = [*remarks[:_REMARKS], ("remarks", f"{left} more, in the report")]
    peak = int(plan.squeeze.argmax())
    least, most, when = plan.squeeze.min(), plan.squeeze[peak], plan.instants[peak]
    kept = f"{100 * plan.reserve:g} % of all limits kept free"
    if plan.fastest is None:
        fast = f"{plan.duration:.4g} s as given, and could {plan.factor:.3g} times as fast, {kept}"
    else:
        fast = f"{plan.duration:.4g} s; no timing of this path takes less than {plan.lower_bound:.4g} s, {kept}"
    answers = [
        ("How fast?", fast),
        (
            "How hard?",
            f"{least:.3g} to {most:.3g} N in all, most at {when:.3g} s; bears {plan.disturbance[0]:.3g} N in any "
            "direction besides",
        ),
    ]
    level = "caution" if plan.cautions else "yes"
    if simulation is not None:
        verdict = simulation.verdict
        told = "; ".join([verdict.reason, *verdict.causes])
        answers.append(("Did it hold?", f"{'HELD' if verdict.held else 'LOST'}: {told}"))
        level = level if verdict.held else "no"
    answers.append(("Results", f"{folder / 'report.html'}, beside it view.html, trajectory.csv, .json and .xml"))
    then = [
        (f"xdg-open {shlex.quote(str(folder / 'view.html'))}", "see arm and hand move"),
        (command("export", folder, "--ros2", "goal.json", "--goal"), "a goal for the robot"),
    ]
    show([*stretches, *remarks], answers, then, title=f"{plan.robot.name} carries it", level=level, more=session.more)


def _load_grasp(text: str, session: Session) -> GraspPlan:
    """The plan of a run's folder, or of a case."""
    from pinograsp.cases import load_case
    from pinograsp.planner import load_run

    return load_run(text) if Path(text).is_dir() else load_case(text).plan(progress=session.progress)


def _scenario(text: str) -> CarryScenario:
    """``mass=1.2,mu=0.8,com_x=0.005`` as a scenario."""
    from pinograsp.carry import CarryScenario

    found: dict[str, float] = {}
    for one in text.split(","):
        name, _, value = one.partition("=")
        if name in found:
            raise InvalidInput(f"--scenario: expected each name once, got {name} twice")
        try:
            found[name] = float(value)
        except ValueError:
            raise InvalidInput(f"--scenario: expected NAME=NUMBER, got '{one}'") from None
    if unknown := set(found) - {"mass", "mu", *_SHIFTS}:
        raise InvalidInput(f"--scenario: expected mass, mu, {', '.join(_SHIFTS)}, got {', '.join(sorted(unknown))}")
    options: dict[str, Any] = {name: value for name, value in found.items() if name not in _SHIFTS}
    return CarryScenario(com=[found.get(axis, 0.0) for axis in _SHIFTS], **options)
