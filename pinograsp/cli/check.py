"""``pinograsp check``."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.app import Json, Quiet, Run, Verbose, app, bar, given, new_folder, numbers, tell_json
from pinograsp.cli.screen import command, needs, show, tell
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.hands import HandModel
    from pinograsp.plan import Simulation
    from pinograsp.planner import GraspPlan
    from pinograsp.simulation import Disturbance, Errors, Servo, WhatHolds
    from pinograsp.simulation.monte_carlo import MonteCarlo
    from pinograsp.simulation.settings import Control
    from pinograsp.simulation.task import Task
    from pinograsp.simulation.thresholds import Threshold
    from pinograsp.simulation.trials import TrialSettings
    from pinograsp.spatial import Array
    from pinograsp.writing import NewFolder

_MOST_TRIALS = 100_000  # of each error
_SHOWN = 9  # lines of measurements, and of a study, on the first screen


@app.command()
def check(
    run: Run,
    hold: Annotated[float, typer.Option(help="How long the object is held after it was let go \\[s].")] = defaults.HOLD,
    push: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FX,FY,FZ",
            help="Force on the object \\[N], with ,MX,MY,MZ \\[N m] and @START+DURATION \\[s]; repeatable.",
        ),
    ] = None,
    shake: Annotated[
        str | None,
        typer.Option(metavar="AX,AY,AZ", help="Shake the hand with this acceleration \\[m/s^2], @FREQUENCY \\[Hz]."),
    ] = None,
    mu: Annotated[float | None, typer.Option(help="Friction coefficient instead of the plan's.")] = None,
    mass: Annotated[float | None, typer.Option(help="Mass of the object instead of the plan's \\[kg].")] = None,
    offset: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Offset of the object \\[mm].")] = None,
    turn: Annotated[str | None, typer.Option(metavar="RX,RY,RZ", help="Rotation of the object \\[deg].")] = None,
    start_error: Annotated[float, typer.Option(help="Offset of every joint at the start \\[deg, mm].")] = 0.0,
    base_motion: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Accelerations of the hand's base: lines T,AX,AY,AZ, T after t_F \\[s, m/s^2]; linear between.",
        ),
    ] = None,
    base_path: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Positions of the hand's base: lines T,X,Y,Z, T after t_F \\[s, m]; a cubic spline from rest to rest.",
        ),
    ] = None,
    stiffness: Annotated[
        float, typer.Option(help="Factor on the contact law's K: above 1 the object is harder than assumed.")
    ] = 1.0,
    joint_friction: Annotated[
        str | None, typer.Option(metavar="F[,F...]", help="Dry friction of all joints, or of each \\[N m, N].")
    ] = None,
    joint_offset: Annotated[
        str | None,
        typer.Option(metavar="O[,O...]", help="Calibration error of all joints' encoders, or of each \\[deg, mm]."),
    ] = None,
    servo_gain: Annotated[
        float, typer.Option(help="Factor on the servos' gains; with --control torque, on the motors' torques.")
    ] = 1.0,
    control: Annotated[
        str,
        typer.Option(
            help="Of the joints: impedance (servos, with the plan's torques as feed-forward), position (servos "
            "alone), torque (the plan's torques alone).",
            autocompletion=completion.one_of(completion.CONTROLS),
        ),
    ] = "impedance",
    kp: Annotated[
        str | None,
        typer.Option(
            metavar="K[,K...]", help="Stiffness of all servos, or of each \\[N m/rad, N/mm]; default: 50, 55.6."
        ),
    ] = None,
    prescribed: Annotated[
        bool, typer.Option("--prescribed", help="Joints follow the commands exactly, instead of by servos.")
    ] = False,
    support: Annotated[
        str,
        typer.Option(
            help="Of the object until the hand carries it: fixed (until the grasp is complete), table (it stands there "
            "freely: a hit on the way moves it), none (from the impact time on).",
            autocompletion=completion.one_of(completion.SUPPORTS),
        ),
    ] = "fixed",
    time_step: Annotated[float, typer.Option(help="Of the simulation \\[s].")] = defaults.TIME_STEP,
    monte_carlo: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Probability of holding: N trials with each random error alone (position, rotation, friction, mass, "
            "posture, push; others by --errors) and N with all of them, 7 N in all. The same command continues an "
            "interrupted study.",
        ),
    ] = 0,
    errors: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=VALUE,...",
            help="Sizes of the random errors in SI units, ranges as LOW:HIGH, as pinograsp.simulation.Errors has them; "
            "0: none. Besides the six there are stiffness=LOW:HIGH, joint_offset, joint_friction, servo_gain.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the random errors.")] = 0,
    thresholds: Annotated[
        bool,
        typer.Option("--thresholds", help="Search for the smallest friction and the largest mass that still hold."),
    ] = False,
    what_holds: Annotated[
        bool,
        typer.Option(
            "--what-holds",
            help="Where the object is lost: 10 to 25 more simulations, one change each, for what would have held.",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; default: RUN/check, RUN/check-2, ...")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results in --out.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a plan with a free object: does it hold? Exit code 0: held, 3: lost.

    Examples:
      pinograsp check runs/paper

      pinograsp check runs/paper --push 0,0,-2@0.5+0.2

      pinograsp check runs/paper --mass 1.05 --shake 0.1,0,0@5

      pinograsp check runs/paper --monte-carlo 5

      pinograsp check runs/paper --kp 100 --joint-friction 0.01

    Runs are written by 'pinograsp plan'. What each answer means: docs/howto/answers.md
    """
    from pinograsp.checks import one_of
    from pinograsp.planner import load_run
    from pinograsp.simulation.settings import CONTROLS, SUPPORTS

    if not 0 <= monte_carlo <= _MOST_TRIALS:
        raise InvalidInput(f"--monte-carlo: expected a number of trials from 0 to {_MOST_TRIALS}, got {monte_carlo}")
    plan = load_run(run)  # raises its errors before anything is written
    with new_folder(out, force, "check", run) as folder:
        place = folder.place
        if (place / "plan.json").exists() or place in (run.resolve(), *run.resolve().parents):
            raise InvalidInput(f"--out: expected a folder for the check alone, got '{out}', which holds a run")
        settings: TrialSettings = {
            "hold": hold,
            "time_step": time_step,
            "mode": "prescribed" if prescribed else "servo",
            "support": one_of("support", support, SUPPORTS),
        }
        if (control, kp) != ("impedance", None):
            if prescribed:
                raise InvalidInput("--control, --kp: expected without --prescribed, whose joints follow exactly")
            settings["servo"] = _servo(plan, one_of("control", control, CONTROLS), kp)
        differences = _Differences(
            push,
            shake,
            mu,
            mass,
            offset,
            turn,
            start_error,
            base_motion,
            base_path,
            stiffness,
            joint_friction,
            joint_offset,
            servo_gain,
        )
        trials = run / "trials" if out is None else place.with_name(f"{place.name}-trials")
        if errors is not None and not monte_carlo:
            raise InvalidInput("--errors: expected with --monte-carlo, which draws them")
        studies = _Studies(monte_carlo, _errors(errors), seed, thresholds, what_holds, trials)
        summary = _check(plan, run, folder, settings, differences, studies, as_json)
    if as_json:
        tell_json({**summary, "folder": str(folder.path)})
    if summary.get("monte_carlo", {}).get("interrupted"):
        raise typer.Exit(130)
    if not summary["held"]:
        raise typer.Exit(3)


class _Differences(NamedTuple):
    """The options that describe a disturbance."""

    push: list[str] | None
    shake: str | None
    mu: float | None
    mass: float | None
    offset: str | None
    turn: str | None
    start_error: float
    base_motion: Path | None
    base_path: Path | None
    stiffness: float
    joint_friction: str | None
    joint_offset: str | None
    servo_gain: float


class _Studies(NamedTuple):
    """The options of further studies: number, errors and seed of random trials, whether to search thresholds and what
    would have held, and the folder of the trials.
    """

    monte_carlo: int
    errors: Errors | None
    seed: int
    thresholds: bool
    what_holds: bool
    trials: Path


def _check(
    plan: GraspPlan,
    run: Path,
    folder: NewFolder,
    settings: TrialSettings,
    differences: _Differences,
    studies: _Studies,
    as_json: bool,
) -> dict[str, Any]:
    """Simulate the plan, run the studies, and write the results; returns their summary."""
    from pinograsp.cli.report import refresh
    from pinograsp.report import report_check
    from pinograsp.simulation import simulate
    from pinograsp.simulation.task import Task
    from pinograsp.storage import newest_check, write_simulation
    from pinograsp.viz.checks import save_check_figures
    from pinograsp.writing import list_in

    task = Task.of(plan)
    disturbance = _disturbance(task, differences)
    if studies.monte_carlo and disturbance.summary():
        raise InvalidInput("--monte-carlo: expected no other disturbances, it draws its own")
    simulation = simulate(task, disturbance=disturbance, **settings)
    if not as_json:
        _print_measured(simulation)
    tried, texts = {}, []
    lost = not simulation.verdict.held
    for name, study in _studies(run, plan, task, studies, disturbance, settings, lost, as_json):
        tried[name] = study.summary()
        texts.append(study.describe())
        if not as_json:
            _print_study(name, texts[-1])

    def fill(path: Path) -> None:
        write_simulation(simulation, path, tried)
        figures = [figure.name for figure in save_check_figures(simulation, path)]
        text = report_check(simulation, figures, texts).to_markdown()
        (path / "check.md").write_text(text, encoding="utf-8")

    list_in(run, f"{folder.place}/")  # so that a folder within the run counts as part of it
    folder.write(fill)
    if newest_check(run) == folder.path:
        refresh(run, redraw=False)
    if not as_json:
        _print_verdict(simulation, run, folder.path)
    return {**simulation.summary(), **tried}


def _print_measured(simulation: Simulation) -> None:
    """What was measured; where that is much, or the object lost, some of it."""
    lines, notes = simulation.measured(), [f"note: {note}" for note in simulation.notes]
    if given["verbose"]:
        lines += notes
    elif not simulation.verdict.held:
        lines = [lines[0], lines[-1]]
    else:
        if len(lines) > _SHOWN:
            lines = [
                *lines[: _SHOWN - 2],
                f"... {len(lines) - _SHOWN + 1} more lines: in check.md, or with -v",
                lines[-1],
            ]
        lines += [f"notes: {len(notes)}, in check.md, or with -v"] if notes else []
    tell("\n".join(lines))


def _print_study(name: str, text: str) -> None:
    """A study; of one that nobody asked for, not all."""
    lines = text.splitlines()
    if name == "what_holds" and len(lines) > _SHOWN and not given["verbose"]:
        lines = [*lines[: _SHOWN - 1], "  ... more: in check.md, or with -v"]
    tell("\n".join(["", *lines]))


def _print_verdict(simulation: Simulation, run: Path, folder: Path) -> None:
    verdict = simulation.verdict
    reasons = {"Why?": "; ".join(verdict.causes), "What helps?": "; ".join(verdict.remedies)}
    commands = [(command("view", run), f"see it move{needs('viz', 'viser')}")]
    if verdict.held:
        commands.append((command("check", run, "--monte-carlo", "20"), "how sure is it?"))
    else:
        commands.append((command("check", run, "--what-holds"), "what would have held (minutes)"))
    answers = [
        ("Did it hold?", f"{'HELD' if verdict.held else 'LOST'}: {verdict.reason}"),
        *((what, text) for what, text in reasons.items() if text),
        ("Results", f"{folder / 'check.md'}, beside it check.json, check.npz, figures; and in the run's report.html"),
    ]
    show([], answers, commands, level="yes" if verdict.held else "no")


def _studies(
    run: Path,
    plan: GraspPlan,
    task: Task,
    studies: _Studies,
    disturbance: Disturbance,
    settings: TrialSettings,
    lost: bool,
    as_json: bool,
) -> Iterator[tuple[str, MonteCarlo | Threshold | WhatHolds]]:
    """The requested studies, by name; thresholds are compared with the planner's own margins."""
    from pinograsp.simulation import Errors, Servo, load_threshold, monte_carlo, slip_threshold, what_holds
    from pinograsp.simulation.monte_carlo import FILE
    from pinograsp.writing import list_in

    if lost and studies.what_holds:
        yield "what_holds", what_holds(plan, disturbance=disturbance, **settings)
    if count := studies.monte_carlo:
        errors = Errors() if studies.errors is None else studies.errors
        if not as_json:
            kinds = errors.kinds
            tell(
                f"\n{count} trials with each of {', '.join(kinds)}, and {count} with all together: "
                f"{count * (len(kinds) + 1)} trials"
            )
        # Trials are kept as they come, so that the same command can continue.
        plain = {name: value.summary() if isinstance(value, Servo) else value for name, value in settings.items()}
        if studies.errors is not None:
            plain["errors"] = errors.summary()
        key = json.dumps({"seed": studies.seed, "engine": "mujoco", **plain}, sort_keys=True)  # as 0.2.0 did
        trials = studies.trials / hashlib.sha256(key.encode()).hexdigest()[:8]
        list_in(run, trials / FILE)
        study = monte_carlo(
            task, count=count, seed=studies.seed, errors=errors, progress=bar(as_json), folder=trials, **settings
        )
        yield "monte_carlo", study
        if study.interrupted:
            return
    if studies.thresholds:
        margins = plan.require_margins()
        least = float(margins.least_mu.max())
        held = margins.load_factor if math.isfinite(margins.load_factor) else None
        yield "slip_threshold", slip_threshold(task, planned=least, disturbance=disturbance, **settings)
        yield (
            "load_threshold",
            load_threshold(task, planned=held, disturbance=disturbance, **settings),
        )


def _disturbance(task: Task, options: _Differences) -> Disturbance:
    import numpy as np

    from pinograsp.checks import number
    from pinograsp.simulation import BaseMotion, Disturbance, Push

    pushes = []
    for text in options.push or ():
        values, _, when = text.partition("@")
        start, _, duration = when.partition("+")
        wrench = numbers("--push", values, (3, 6))
        timing = {}
        if start:
            timing["start"] = numbers("--push", start, (1,))[0]
        if duration:
            timing["duration"] = numbers("--push", duration, (1,))[0]
        pushes.append(Push(wrench_o=np.array([*wrench, *[0.0] * (6 - len(wrench))]), **timing))
    given: dict[str, Any] = {"pushes": tuple(pushes), "mu": options.mu}
    if options.shake is not None:
        values, _, frequency = options.shake.partition("@")
        given["shake"] = numbers("--shake", values, (3,))
        if frequency:
            given["shake_frequency"] = numbers("--shake", frequency, (1,))[0]
    if options.mass is not None:
        given["mass_factor"] = number("--mass", options.mass, above=0, unit="kg") / task.body.mass
    if options.offset is not None:
        given["object_offset"] = 1e-3 * np.array(numbers("--offset", options.offset, (3,)))
    if options.turn is not None:
        given["object_turn"] = np.radians(numbers("--turn", options.turn, (3,)))
    given |= {"stiffness": options.stiffness, "servo_gain": options.servo_gain}
    if options.base_motion is not None and options.base_path is not None:
        raise InvalidInput("--base-path: expected without --base-motion, both tell the motion of the base")
    if options.base_motion is not None:
        times, rows = _rows("--base-motion", options.base_motion)
        given["base_motion"] = BaseMotion(times=times, accelerations=rows)
    if options.base_path is not None:
        given["base_motion"] = BaseMotion.through(*_rows("--base-path", options.base_path))
    hand = task.hand
    if options.start_error:
        given["start_error"] = _of_joints(hand, "--start-error", str(options.start_error), math.radians(1), 1e-3)
    if options.joint_offset is not None:
        given["joint_offset"] = _of_joints(hand, "--joint-offset", options.joint_offset, math.radians(1), 1e-3)
    if options.joint_friction is not None:
        given["joint_friction"] = _of_joints(hand, "--joint-friction", options.joint_friction, 1.0, 1.0)
    return Disturbance(**given)


def _servo(plan: GraspPlan, control: Control, kp: str | None) -> Servo:
    from pinograsp.simulation import Servo

    hand = plan.require_hand()
    stiffness = None if kp is None else _of_joints(hand, "--kp", kp, 1.0, 1e3)
    return Servo.of(hand, stiffness, control=control)


def _of_joints(hand: HandModel, option: str, text: str, turning: float, sliding: float) -> Array:
    """Values of the joints (n,), from one number or n, times the unit of turning or sliding joints."""
    import numpy as np

    values = numbers(option, text, (1,) if hand.n == 1 else (1, hand.n))
    each: Array = np.array(values) * np.where(hand.slides, sliding, turning)
    return each


def _rows(option: str, path: Path) -> tuple[Array, Array]:
    """Times (m,) and vectors (m, 3) in a CSV file."""
    import numpy as np

    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{option}: expected a readable file of text, got '{path}' ({error})") from error
    rows = np.array([numbers(option, line, (4,)) for line in lines if line.strip()]).reshape(-1, 4)
    return rows[:, 0], rows[:, 1:]


def _errors(text: str | None) -> Errors | None:
    """The sizes of the random errors; None: the default ones."""
    from pinograsp.simulation import Errors

    if text is None:
        return None
    given: dict[str, Any] = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        known = [field.name for field in fields(Errors)]
        if name not in known or name in given or not value:
            raise InvalidInput(f"--errors: expected NAME=VALUE,... each once of {', '.join(known)}, got '{text:.100}'")
        sizes = numbers("--errors", value.replace(":", ","), (1, 2, 3))
        given[name] = sizes[0] if len(sizes) == 1 else tuple(sizes)
    return Errors(**given)
