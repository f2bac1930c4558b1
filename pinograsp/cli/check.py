"""``pinograsp check``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.disturbance import DisturbanceOptions, read_of_joints
from pinograsp.cli.options import RunFolder, force_option, new_folder, out_option, read_numbers, read_settings
from pinograsp.cli.reflex import Believed, ReflexOptions, make_controller
from pinograsp.cli.screen import command, needs, show, tell
from pinograsp.cli.session import Session, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.plan import Simulation
    from pinograsp.planner import GraspPlan
    from pinograsp.simulation import Disturbance, Errors, WhatHolds
    from pinograsp.simulation.monte_carlo import MonteCarlo
    from pinograsp.simulation.options import StudySettings
    from pinograsp.simulation.task import Task
    from pinograsp.simulation.thresholds import Threshold
    from pinograsp.writing import NewFolder

_MOST_TRIALS = 100_000  # of each error
_SHOWN = 9  # lines of measurements, and of a study, on the first screen

_simulation = partial(option, "Simulation")
_study = partial(option, "Further trials")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialOptions:
    """How a plan is simulated."""

    hold: float = _simulation("How long to simulate after the object is let go \\[s].", default=defaults.HOLD)
    control: str = _simulation(
        "Control of the joints: impedance (servos, with the plan's torques as feed-forward), position (servos "
        "alone) or torque (the plan's torques alone).",
        default="impedance",
        choices=completion.CONTROLS,
    )
    kp: str | None = _simulation(
        "Stiffness of all servos, or of each servo \\[N m/rad, N/mm]; default: 50, 55.6.", metavar="K[,K...]"
    )
    prescribed: bool = _simulation("Joints follow the commands exactly, without servos.", "--prescribed", default=False)
    support: str | None = _simulation(
        "Support of the object until the hand carries it: fixed (until the grasp is complete), table (the "
        "object stands freely, and a collision moves it) or none (from the impact time on). Default: table if "
        "the plan has one, none if it has a reserve, otherwise fixed.",
        choices=completion.SUPPORTS,
    )
    time_step: float = _simulation("Time step of the simulation \\[s].", default=defaults.TIME_STEP)

    def settings(self, plan: GraspPlan) -> StudySettings:
        """By the names of :func:`~pinograsp.simulation.simulate`; :class:`InvalidInput` for what is none."""
        from pinograsp.checks import one_of
        from pinograsp.simulation import Servo
        from pinograsp.simulation.settings import CONTROLS, SUPPORTS

        settings: StudySettings = {
            "hold": self.hold,
            "time_step": self.time_step,
            "mode": "prescribed" if self.prescribed else "servo",
            "support": None if self.support is None else one_of("support", self.support, SUPPORTS),
        }
        if (self.control, self.kp) != ("impedance", None):
            if self.prescribed:
                raise InvalidInput("--control, --kp: expected without --prescribed, whose joints follow exactly")
            hand, control = plan.require_hand(), one_of("control", self.control, CONTROLS)
            stiffness = None if self.kp is None else read_of_joints(hand, "--kp", self.kp, 1.0, 1e3)
            settings["servo"] = Servo.of(hand, stiffness, control=control)
        return settings


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOptions:
    """Further simulations."""

    monte_carlo: int = _study(
        "Estimate the probability of holding: N trials with each random error alone (position, rotation, "
        "friction, mass, posture, push; others by --errors) and N with all of them, 7 N in all. The same "
        "command continues an interrupted study.",
        default=0,
        metavar="N",
    )
    errors: str | None = _study(
        "Sizes of the random errors in SI units, ranges as LOW:HIGH, by the names in "
        "pinograsp.simulation.Errors; 0: none. Besides the six errors there are stiffness=LOW:HIGH, "
        "joint_offset, joint_friction and servo_gain.",
        metavar="NAME=VALUE,...",
    )
    pose_errors: str | None = _study(
        "Misplace the object N times, by MM and DEG (default: 5 and 5) in random directions, on a table "
        "within its plane, and count how often it is held, with a confidence interval. The same command "
        "continues an interrupted study.",
        metavar="N[,MM,DEG]",
    )
    seed: int = _study("Random seed of the errors.", default=0)
    thresholds: bool = _study(
        "Search for the smallest friction and the largest mass that still hold.", "--thresholds", default=False
    )
    what_holds: bool = _study(
        "If the object is lost, find what would have held it: 10 to 25 more simulations with one change each.",
        "--what-holds",
        default=False,
    )

    def refuse(self, option: str) -> None:
        """:class:`InvalidInput` where any were asked for beside an option that they do not have."""
        if self.monte_carlo or self.pose_errors is not None or self.thresholds or self.what_holds:
            raise InvalidInput(f"{option}: expected without further trials, which are of the plan's own squeeze")

    def read_pose_errors(self) -> tuple[int, Errors] | None:
        """How often the object is misplaced, and by how much; None: never."""
        from pinograsp.plan import PoseError
        from pinograsp.simulation import Errors

        if self.pose_errors is None:
            return None
        count, *size = read_numbers("--pose-errors", self.pose_errors, (1, 3))
        if count != int(count) or not 1 <= count <= _MOST_TRIALS:
            raise InvalidInput(f"--pose-errors: expected a number of trials from 1 to {_MOST_TRIALS}, got {count:g}")
        pose = PoseError(distance=1e-3 * size[0], angle=math.radians(size[1])) if size else PoseError()
        return int(count), Errors.of_pose(pose)

    def read_errors(self) -> Errors | None:
        """The sizes of the random errors; None: the default ones."""
        from pinograsp.simulation import Errors

        if self.errors is None:
            return None
        if not self.monte_carlo:
            raise InvalidInput("--errors: expected with --monte-carlo, which draws them")
        known = [field.name for field in fields(Errors)]
        given: dict[str, Any] = {}
        for name, value in read_settings("--errors", self.errors, known).items():
            sizes = read_numbers("--errors", value.replace(":", ","), (1, 2, 3))
            given[name] = sizes[0] if len(sizes) == 1 else tuple(sizes)
        return Errors(**given)


def check(
    *,
    run: RunFolder,
    differences: DisturbanceOptions,
    trial: TrialOptions,
    grip: ReflexOptions,
    studies: StudyOptions,
    out: Annotated[Path | None, out_option("RUN/check, RUN/check-2, ...")] = None,
    force: Annotated[bool, force_option("earlier results in --out")] = False,
    session: Session,
) -> None:
    """Simulate a plan with a free object: does it hold? Exit code 0: held, 3: lost.

    Examples:
      pinograsp check runs/paper

      pinograsp check runs/paper --push 0,0,-2@0.5+0.2

      pinograsp check runs/paper --mass 1.05 --shake 0.1,0,0@5

      pinograsp check runs/paper --monte-carlo 5

      pinograsp check runs/paper --pose-errors 12

      pinograsp check runs/paper --kp 100 --joint-friction 0.01

      pinograsp check runs/paper --reflex --sensors noise=0.1,delay=0.02

    Runs are written by 'pinograsp plan'. What each answer means:
    docs/howto/answers.md
    """
    from pinograsp.planner import load_run
    from pinograsp.simulation import simulate
    from pinograsp.simulation.task import Task

    if not 0 <= studies.monte_carlo <= _MOST_TRIALS:
        count = studies.monte_carlo
        raise InvalidInput(f"--monte-carlo: expected a number of trials from 0 to {_MOST_TRIALS}, got {count}")
    plan = load_run(run)  # raises its errors before anything is written
    with new_folder(out, force, "check", run) as folder:
        place = folder.place
        if (place / "plan.json").exists() or place in (run.resolve(), *run.resolve().parents):
            raise InvalidInput(f"--out: expected a folder for the check alone, got '{out}', which holds a run")
        settings, errors, task = trial.settings(plan), studies.read_errors(), Task.of(plan)
        poses = studies.read_pose_errors()
        disturbance = differences.read(task)
        if studies.monte_carlo and disturbance.summary():
            raise InvalidInput("--monte-carlo: expected no other disturbances, it draws its own")
        believed = None
        if (sensors := grip.read()) is not None:
            studies.refuse("--reflex")
        simulation = simulate(task, disturbance=disturbance, **settings)
        if sensors is not None:
            controller = make_controller(plan, sensors, disturbance, settings.get("servo"))
            believed = Believed(controller, sensors, simulation.verdict)
            simulation = simulate(task, disturbance=disturbance, controller=controller, sensors=sensors, **settings)
        if not session.as_json:
            _print_measured(simulation, session)
        trials = run / "trials" if out is None else place.with_name(f"{place.name}-trials")
        work = _Work(run, plan, task, disturbance, settings, session)
        lost = not simulation.verdict.held
        results: dict[str, Any] = {}
        texts = []
        if believed is not None:
            results["reflex"] = believed.summary()
            texts.append(believed.describe())
        for name, study in _run_studies(work, studies, errors, poses, trials, lost):
            results[name] = study.summary()
            texts.append(study.describe())
            if not session.as_json:
                _print_study(name, texts[-1], session)
        _write(simulation, run, folder, results, texts)
    summary = {**simulation.summary(), **results}
    if session.as_json:
        session.print_json({**summary, "folder": str(folder.path)})
    else:
        _print_verdict(simulation, believed, _count_lost(results), run, folder.path)
    if any(summary.get(name, {}).get("interrupted") for name in ("monte_carlo", "pose_errors")):
        raise typer.Exit(130)
    if not summary["held"]:
        raise typer.Exit(3)


def _write(simulation: Simulation, run: Path, folder: NewFolder, results: dict[str, Any], texts: list[str]) -> None:
    """Write a simulation, and what was found further, into its folder; and into the run's report."""
    from pinograsp.cli.report import refresh
    from pinograsp.report import report_check
    from pinograsp.storage import newest_check, write_simulation
    from pinograsp.viz.checks import save_check_figures
    from pinograsp.writing import list_in

    def fill(path: Path) -> None:
        write_simulation(simulation, path, results)
        figures = [figure.name for figure in save_check_figures(simulation, path)]
        (path / "check.md").write_text(report_check(simulation, figures, texts).to_markdown(), encoding="utf-8")

    list_in(run, f"{folder.place}/")  # so that a folder within the run counts as part of it
    folder.write(fill)
    if newest_check(run) == folder.path:
        refresh(run, redraw=False)


@dataclass(frozen=True, slots=True)
class _Work:
    """What all studies of a plan share."""

    run: Path
    plan: GraspPlan
    task: Task
    disturbance: Disturbance
    settings: StudySettings
    session: Session


def _run_studies(
    work: _Work,
    studies: StudyOptions,
    errors: Errors | None,
    poses: tuple[int, Errors] | None,
    trials: Path,
    lost: bool,
) -> Iterator[tuple[str, MonteCarlo | Threshold | WhatHolds]]:
    """The requested studies, by name; thresholds are compared with the planner's own margins."""
    from pinograsp.simulation import load_threshold, slip_threshold, what_holds

    if lost and studies.what_holds:
        yield "what_holds", what_holds(work.plan, disturbance=work.disturbance, **work.settings)
    if studies.monte_carlo:
        study = _draw_trials(work, studies.monte_carlo, studies.seed, errors, trials)
        yield "monte_carlo", study
        if study.interrupted:
            return
    if poses is not None:
        yield "pose_errors", _draw_trials(work, poses[0], studies.seed, poses[1], trials)
    if studies.thresholds:
        margins, disturbance = work.plan.require_margins(), work.disturbance
        least = float(margins.least_mu.max())
        factor = margins.load_factor if math.isfinite(margins.load_factor) else None
        yield "slip_threshold", slip_threshold(work.task, planned=least, disturbance=disturbance, **work.settings)
        yield "load_threshold", load_threshold(work.task, planned=factor, disturbance=disturbance, **work.settings)


def _draw_trials(work: _Work, count: int, seed: int, errors: Errors | None, folder: Path) -> MonteCarlo:
    """Random trials, kept as they come, so that the same command can continue."""
    import hashlib
    import json

    from pinograsp.simulation import Errors, Servo, monte_carlo
    from pinograsp.simulation.monte_carlo import FILE
    from pinograsp.writing import list_in

    drawn = Errors() if errors is None else errors
    if not work.session.as_json:
        kinds = drawn.kinds
        told = f"{count} trials with each of {', '.join(kinds)}, and {count} with all together: "
        tell(f"\n{count} misplaced objects" if drawn.pose else f"\n{told}{count * (len(kinds) + 1)} trials")
    plain = {name: value.summary() if isinstance(value, Servo) else value for name, value in work.settings.items()}
    if errors is not None:
        plain["errors"] = errors.summary()
    key = json.dumps({"seed": seed, "engine": "mujoco", **plain}, sort_keys=True)  # as 0.2.0 did
    trials = folder / hashlib.sha256(key.encode()).hexdigest()[:8]
    list_in(work.run, trials / FILE)
    return monte_carlo(
        work.task,
        count=count,
        seed=seed,
        errors=drawn,
        progress=work.session.progress,
        folder=trials,
        **work.settings,
    )


def _print_measured(simulation: Simulation, session: Session) -> None:
    """What was measured; where that is much, or the object lost, some of it."""
    lines, notes = simulation.list_measures(), [f"note: {note}" for note in simulation.notes]
    if session.verbose:
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


def _print_study(name: str, text: str, session: Session) -> None:
    """A study; of one that nobody asked for, not all."""
    lines = text.splitlines()
    if name == "what_holds" and len(lines) > _SHOWN and not session.verbose:
        lines = [*lines[: _SHOWN - 1], "  ... more: in check.md, or with -v"]
    tell("\n".join(["", *lines]))


def _count_lost(results: Mapping[str, Any]) -> str:
    """How many of the trials of the studies were lost, in words; empty where none was."""
    told = []
    for name, what in (("monte_carlo", "with errors drawn at random"), ("pose_errors", "with the object misplaced")):
        for one in results.get(name, {}).get("held", {}).values():
            lost = one["trials"] - one["held"]
            if lost:
                told.append(f"{lost} of {one['trials']} {what}")
    return "; ".join(dict.fromkeys(told))


def _print_verdict(simulation: Simulation, believed: Believed | None, lost: str, run: Path, folder: Path) -> None:
    verdict = simulation.verdict
    reasons = {"Why?": "; ".join(verdict.causes), "What helps?": "; ".join(verdict.remedies)}
    commands = [(command("view", run), f"see it move{needs('viz', 'viser')}")]
    if verdict.held:
        commands.append((command("check", run, "--monte-carlo", "20"), "how sure is it?"))
    else:
        commands.append((command("check", run, "--what-holds"), "what would have held (minutes)"))
    answers = [
        ("Did it hold?", f"{'HELD' if verdict.held else 'LOST'}: {verdict.reason}"),
        *([("Lost", lost)] if lost else []),
        *((what, text) for what, text in reasons.items() if text),
        *(() if believed is None else believed.list_answers()),
        ("Results", f"{folder / 'check.md'}, beside it check.json, check.npz, figures; and in the run's report.html"),
    ]
    show([], answers, commands, level="no" if not verdict.held else "caution" if lost else "yes")
