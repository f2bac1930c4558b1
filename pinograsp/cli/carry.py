"""``pinograsp carry``."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions, force_option, new_folder, out_option
from pinograsp.cli.screen import command, show
from pinograsp.cli.session import REQUIRED, Session, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.carry import CarryPlan, CarryScenario
    from pinograsp.plan import Simulation

_SHOWN, _REMARKS = 6, 3  # stretches of the way, warnings and notes on the first screen
_SHIFTS = ("com_x", "com_y", "com_z")

_way = partial(option, "The way")
_limit = partial(option, "Limits of the motion")
_hold = partial(option, "What the hand holds, and how")


@dataclass(frozen=True, slots=True, kw_only=True)
class WayOptions:
    """The arm's path, and its time."""

    path: Path = _way(
        "Path of the arm: .csv (a line of joint names, then waypoints, with or without a column time), or "
        ".yaml or .json (a trajectory as ROS and MoveIt print it).",
        default=REQUIRED,
        metavar="FILE",
    )
    robot: str | None = _way(
        "Arm and hand in one model: a file, or a hand from the catalogue, read with the options --root to "
        "--posture; default: the grasp's own hand.",
        complete=completion.complete_hands,
    )
    timing: str = _way(
        "Timing along the path: fastest, or given (that of FILE).", default="fastest", choices=completion.TIMINGS
    )
    intervals: int = _way("Number of intervals into which the path, or its time, is divided.", default=500)
    rate: float = _way("Sampling rate of the trajectory \\[Hz].", default=1000.0)
    check: bool = _way("Also simulate arm, hand and object along the whole path.", "--check", default=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionLimits:
    """Limits of the motion."""

    speed: float | None = _limit("Largest speed of each joint \\[rad/s or m/s]; default: the robot's own.")
    acceleration: float | None = _limit("Largest acceleration of each joint \\[rad/s^2 or m/s^2].")
    jerk: float | None = _limit("Largest jerk of each joint \\[rad/s^3 or m/s^3].")
    ramp: float | None = _limit("Least time in which accelerations change \\[s]; default: 0.05.")


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldOptions:
    """What is to be held against, and how the hand presses."""

    squeeze: str = _hold(
        "How to squeeze: least (follow the loads), constant (one command), or a number (the largest rate of "
        "change \\[N/s]).",
        default="least",
        choices=completion.SQUEEZES,
    )
    scenario: list[str] | None = _hold(
        "Also withstand this difference: mass, mu (factors on the planned), com_x, com_y, com_z \\[m]; repeatable.",
        metavar="NAME=VALUE,...",
    )
    reserve: float = _hold("Headroom: share of every limit that is kept free.", default=0.1)
    disturbance: float | None = _hold(
        "Force in any direction that the squeeze also withstands \\[N]; default: what the grasp's plan withstands."
    )
    gravity: tuple[float, float, float] = _hold(
        "Gravity in the robot's world frame \\[m/s^2].", default=defaults.GRAVITY, metavar="X Y Z"
    )

    def settings(self) -> dict[str, Any]:
        """By the names of :func:`~pinograsp.carry.plan_carry`; :class:`InvalidInput` for scenarios that are none."""
        try:
            squeeze: str | float = float(self.squeeze)
        except ValueError:
            squeeze = self.squeeze
        settings = {"squeeze": squeeze, "scenarios": [_read_scenario(text) for text in self.scenario or []]}
        if self.disturbance is not None:
            settings["disturbance"] = self.disturbance
        return {**settings, "reserve": self.reserve, "gravity_o": self.gravity}


def carry(
    *,
    grasp: Annotated[
        str,
        typer.Argument(
            metavar="RUN_OR_CASE",
            help="What the hand holds: the folder of a run, or a case.",
            autocompletion=completion.graspable,
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
    r"""Carry what a hand holds along an arm's path: how fast, how hard to squeeze, and which limits bind where.

    Examples:
      pinograsp plan --hand panda --object sphere:radius=0.03,mass=0.1 --out ball

      printf 'panda_joint1,panda_joint4\n0,-2\n0.8,-1.6\n' > way.csv

      pinograsp carry ball --robot panda --root panda_link0 --path way.csv

    Add --check to simulate the plan, --squeeze constant for a gripper that
    accepts one force, and --scenario mass=1.2 to withstand more. What each answer
    means: docs/howto/answers.md
    """
    from pinograsp.carry import ArmPath, plan_carry, save_carry, simulate_carry
    from pinograsp.cases import load_case
    from pinograsp.hands import load_hand
    from pinograsp.planner import load_run

    path = ArmPath.read(way.path)
    held = load_run(grasp) if Path(grasp).is_dir() else load_case(grasp).plan(progress=session.progress)
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
    remarks = [*(("warning", one) for one in plan.cautions), *(("note", one) for one in plan.notes)]
    if not session.verbose and len(remarks) > _REMARKS:
        left = len(remarks) - _REMARKS
        remarks = [*remarks[:_REMARKS], ("remarks", f"{left} more, in the report")]
    peak = int(plan.squeeze.argmax())
    least, most, when = plan.squeeze.min(), plan.squeeze[peak], plan.instants[peak]
    kept = f"{100 * plan.reserve:g} % of all limits kept free"
    if plan.fastest is None:
        fast = f"{plan.duration:.4g} s as given, and could go {plan.factor:.3g} times as fast, {kept}"
    else:
        fast = f"{plan.duration:.4g} s; no timing of this path takes less than {plan.lower_bound:.4g} s, {kept}"
    answers = [
        ("How fast?", fast),
        (
            "How hard?",
            f"{least:.3g} to {most:.3g} N in total, most at {when:.3g} s; also withstands {plan.disturbance[0]:.3g} N "
            "in any direction",
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


def _read_scenario(text: str) -> CarryScenario:
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
