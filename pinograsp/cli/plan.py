"""``pinograsp plan`` and ``pinograsp close``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.app import (
    Arguments,
    At,
    Exclude,
    Fingers,
    FrictionModel,
    Hulls,
    Json,
    Masses,
    Mu,
    Packages,
    Palm,
    Posture,
    Quiet,
    Root,
    Safety,
    Samples,
    Seed,
    Srdf,
    Trusted,
    Verbose,
    Within,
    Wrap,
    app,
    bar,
    given,
    loading,
    new_folder,
    numbers,
    posture_of,
    refuse_with_case,
    tell_json,
)
from pinograsp.cli.screen import command, console, needs, show, tell
from pinograsp.errors import GraspInfeasible, InvalidInput, NoGrasp

if TYPE_CHECKING:
    from pinograsp.cases import Case
    from pinograsp.cases.object_case import ObjectCase
    from pinograsp.contacts import Closure
    from pinograsp.planner import GraspPlan
    from pinograsp.synthesis import GraspSearch
    from pinograsp.writing import NewFolder

_SPECS = "cylinder:radius=0.02,height=0.12,mass=0.2 (all shapes: below)"
_WIDE = 120  # columns of a terminal that are enough for the notes of the comparison
_SOME = 6  # contacts that are named one by one


class _WithObjects(TyperCommand):
    """A command whose help ends with all that ``--object`` takes."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from pinograsp.objects.spec import object_language

        first, *others = object_language()
        lines = [f"--object {first}", *others]
        self.epilog = "\n\n".join(line.replace("[", "\\[") for line in lines)
        super().format_help(ctx, formatter)


@app.command(cls=_WithObjects)
def plan(
    context: typer.Context,
    case: Annotated[
        str | None,
        typer.Argument(
            help="A built-in case ('paper') or a case file ('pinograsp new' writes one); none: --hand and --object.",
            autocompletion=completion.cases,
        ),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(
            help="With --object: a hand of the catalogue, or its file; --root to --wrap go with it.",
            autocompletion=completion.hands,
        ),
    ] = None,
    object: Annotated[
        str | None,
        typer.Option(help=f"With --hand: what to hold, as {_SPECS}.", autocompletion=completion.objects),
    ] = None,
    root: Root = None,
    at: At = None,
    mu: Mu = defaults.MU,
    friction: FrictionModel = None,
    safety: Safety = 1.0,
    samples: Samples = defaults.GRASPS,
    seed: Seed = 0,
    wrap: Wrap = False,
    within: Within = None,
    table: Annotated[
        bool, typer.Option("--table", help="The object stands on a table: the hand keeps above it.")
    ] = False,
    hulls: Hulls = True,
    palm: Palm = None,
    fingers: Fingers = None,
    packages: Packages = None,
    arguments: Arguments = None,
    trusted: Trusted = False,
    masses: Masses = "estimate",
    exclude: Exclude = None,
    srdf: Srdf = None,
    posture: Posture = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; default: a new one, runs/NAME, runs/NAME-2, ...")
    ] = None,
    search: Annotated[
        str | None,
        typer.Option(
            help="hybrid, paper, paper+qp (grids) or convex (certified optimum).",
            autocompletion=completion.one_of(completion.SEARCHES),
        ),
    ] = None,
    balance: Annotated[
        str | None,
        typer.Option(
            help="force (the paper) or wrench (forces and moments).",
            autocompletion=completion.one_of(completion.BALANCES),
        ),
    ] = None,
    measure: Annotated[
        str | None,
        typer.Option(help="impulse \\[N s] or work \\[J].", autocompletion=completion.one_of(completion.MEASURES)),
    ] = None,
    reserve: Annotated[
        str | None,
        typer.Option(
            help="With --hand and --object, what to bear besides the weight: none, default, or some of disturbance, "
            "moment_arm, mass, friction, normal_force, torque, softer, stiffer: disturbance=0.5,mass=0.2 (shares; "
            "moment_arm \\[m]; softer, stiffer: factors on the contacts' stiffness).",
            autocompletion=completion.one_of(completion.RESERVES),
        ),
    ] = None,
    torque_limit: Annotated[
        float | None,
        typer.Option(
            help="With --hand and --object: of every joint \\[N m or N], where it is below the effort limit of the "
            "hand's file, which may be far too generous."
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="With --hand and --object: simulate the grasps that were found, at rest and shaken, and take one that "
            "is held.",
        ),
    ] = False,
    solver: Annotated[
        str | None,
        typer.Option(
            help="auto, newton, interior, or a QP solver that is there: daqp, clarabel, osqp...",
            autocompletion=completion.one_of(completion.SOLVERS),
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change a value of the case; repeatable.",
            autocompletion=completion.keys,
        ),
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="With the case 'paper': print the table against the paper's figures, too.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier run in --out.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Plan a grasp: contact forces, joint torques, trajectories, figures and a report.

    Examples:
      pinograsp plan paper

      pinograsp plan paper --compare

      pinograsp plan paper --search convex --measure work --out runs/work

      pinograsp plan paper --set object.mass=1.1 --set friction.mu=0.8 --json

      pinograsp plan --hand panda --object box:size=0.03x0.03x0.08,mass=0.1

      pinograsp plan --hand panda --object sphere:radius=0.02,mass=0.1 --check

      pinograsp plan --hand g1_right --object sphere:radius=0.04,mass=0.1 --wrap

    A case of your own: pinograsp new case.yaml && pinograsp plan case.yaml

    What each answer means: docs/howto/answers.md
    """
    options = {"search": search, "balance": balance, "measure": measure, "solver": solver}
    if case is not None and hand is None and object is None:
        refuse_with_case(context, case)
        if reserve not in (None, "none"):
            raise InvalidInput("--reserve: expected --hand and --object, got CASE: its forces hold its load alone")
        if compare and case != "paper":
            raise InvalidInput(
                f"--compare: expected with the case 'paper', whose figures are published, got '{case:.200}'"
            )
        _plan(case, out, options, changes, force, as_json, compare)
    elif case is None and hand is not None and object is not None:
        if changes:
            raise InvalidInput("--set changes a case: expected CASE, got --hand and --object")
        if compare:
            raise InvalidInput("--compare: expected with the case 'paper', got --hand and --object")
        placing = {
            "mu": mu,
            "friction": friction,
            "safety": safety,
            "samples": samples,
            "seed": seed,
            "wrap": wrap,
            "within": _region(within),
            "table": table,
            "torque_limit": torque_limit,
            "check": check,
            "hulls": hulls,
            "posture": posture_of(posture),
            **loading(palm, fingers, packages, arguments, trusted, masses, exclude, srdf),
        }
        chosen = {key: value for key, value in {**options, "reserve": reserve}.items() if value is not None}
        _plan_object(_object_case(hand, object, root, at, **placing, **chosen), out, force, as_json)
    else:
        raise InvalidInput("expected either CASE, or --hand and --object")


def _plan(
    case: str,
    out: Path | None,
    options: dict[str, Any],
    changes: list[str] | None,
    force: bool,
    as_json: bool,
    compare: bool,
) -> None:
    from pinograsp.cases import load_case

    chosen = [f'forces.{key}="{value}"' for key, value in options.items() if value is not None]
    loaded = load_case(case, texts=[*(changes or []), *chosen])
    with new_folder(out, force, loaded.name) as folder:
        try:
            planned = loaded.plan(progress=bar(as_json))
        except GraspInfeasible as error:
            # A proof that there is no grasp is a result and is kept; a grid that found nothing proves nothing.
            if error.solution.search == "convex":
                _keep_proof(error, loaded, folder)
            raise
        _finish(_with_comparison(planned, loaded) if case == "paper" else planned, folder, as_json, compare)


def _with_comparison(plan: GraspPlan, case: Case) -> GraspPlan:
    """The plan with the comparison with the paper, or with a note where the paper's choices give no grasp."""
    from pinograsp.cases.published import compare

    try:
        return replace(plan, comparison=tuple(compare(case)))
    except NoGrasp as error:
        note = f"no comparison with the paper: with the paper's choices there is no grasp ({error})"
        return replace(plan, notes=(*plan.notes, note))


def _object_case(hand: str, object: str, root: str | None, at: str | None, **options: Any) -> ObjectCase:
    """The checked options of a hand and an object; ``at`` is x,y,z[,roll,pitch,yaw] in m and degrees."""
    from pinograsp.cases.object_case import ObjectCase

    return ObjectCase.of(
        hand=hand,
        object=object,
        root=root,
        at=None if at is None else numbers("--at", at, (3, 6), "x,y,z or x,y,z,roll,pitch,yaw [m, deg]"),
        **options,
    )


def _region(within: str | None) -> list[float] | None:
    """The corners of ``--within``."""
    wanted = "the lower and the upper corner of a box, x,y,z,x,y,z [m]"
    return None if within is None else numbers("--within", within, (6,), wanted)


def _found(case: ObjectCase, as_json: bool) -> GraspSearch | None:
    """Grasps of the object, or None where its place in the hand is given."""
    if case.at is not None:
        return None
    found = case.grasps(progress=bar(as_json))
    if found.interrupted:
        held = len(found.grasps)
        typer.echo(
            f"pinograsp: {found.tried} of {case.samples} samples tried, {held} grasps hold the object; nothing written",
            err=True,
        )
        raise KeyboardInterrupt
    return found


def _plan_object(case: ObjectCase, out: Path | None, force: bool, as_json: bool) -> None:
    """Search grasps, plan the best one that can be carried out."""
    kind = str(case.object).partition(":")[0]  # on the command line, the object is a text
    with new_folder(out, force, f"{Path(case.hand).stem}-{kind}") as folder:
        _finish(case.plan(_found(case, as_json), progress=bar(as_json)), folder, as_json)


@app.command(cls=_WithObjects)
def close(
    hand: Annotated[
        str,
        typer.Option(help="A hand of the catalogue, or its URDF, xacro or MJCF file.", autocompletion=completion.hands),
    ],
    object: Annotated[str, typer.Option(help=f"What to close on, as {_SPECS}.", autocompletion=completion.objects)],
    root: Root = None,
    at: At = None,
    mu: Mu = defaults.MU,
    friction: FrictionModel = None,
    safety: Safety = 1.0,
    samples: Samples = defaults.GRASPS,
    seed: Seed = 0,
    wrap: Wrap = False,
    within: Within = None,
    hulls: Hulls = True,
    palm: Palm = None,
    fingers: Fingers = None,
    packages: Packages = None,
    arguments: Arguments = None,
    trusted: Trusted = False,
    masses: Masses = "estimate",
    exclude: Exclude = None,
    srdf: Srdf = None,
    posture: Posture = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Close a hand on an object: which links touch it where, and what stops each joint.

    Examples:
      pinograsp close --hand panda --object sphere:radius=0.03,mass=0.2

      pinograsp close --hand panda --object sphere:radius=0.03,mass=0.2 --at 0,0,0.1
    """
    placing = {
        "mu": mu,
        "friction": friction,
        "safety": safety,
        "samples": samples,
        "seed": seed,
        "wrap": wrap,
        "within": _region(within),
        "hulls": hulls,
        "posture": posture_of(posture),
        **loading(palm, fingers, packages, arguments, trusted, masses, exclude, srdf),
    }
    case = _object_case(hand, object, root, at, **placing)
    found = _found(case, as_json)
    closure = case.closure() if found is None else found.best.closure
    if as_json:
        tell_json(closure.summary())
    else:
        _print_closure(closure)
    if not closure.touches:
        raise typer.Exit(3)


def _finish(plan: GraspPlan, folder: NewFolder, as_json: bool, compare: bool = False) -> None:
    """Save a plan with its report and figures, print it, and exit with its code."""
    from pinograsp.planner import save_run

    plan = plan.with_margins().with_reach()

    def extras(path: Path) -> None:
        from pinograsp.report import write_report

        write_report(plan, path, [figure.name for figure in plan.save_figures(path)])

    save_run(plan, folder, extras=extras)
    if as_json:
        tell_json({**plan.summary(), "folder": str(folder.path)})
    else:
        if compare and plan.comparison:
            _print_comparison(plan)
        print_plan(plan, folder.path)
    if plan.status.exit_code:
        raise typer.Exit(plan.status.exit_code)


def _keep_proof(error: GraspInfeasible, case: Case, folder: NewFolder) -> None:
    from pinograsp.planner import failure_of, save_run
    from pinograsp.report import write_report

    failure = failure_of(error, case.hand.source, case.settings())
    save_run(failure, folder, extras=lambda path: write_report(failure, path))
    typer.echo(f"the proof is written to {folder.path}: report.html, report.md, plan.json", err=True)


def _print_comparison(plan: GraspPlan) -> None:
    from rich.table import Table

    from pinograsp.report import list_comparison

    screen = console()
    title = "Comparison with the paper (planned with the paper's choices: balance of forces only)"
    beside = Table(title=title, title_justify="left", box=None, header_style="bold", padding=(0, 1, 0, 0))
    beside.add_column("quantity")
    beside.add_column("unit", no_wrap=True)
    for name in ("paper", "ours", "difference"):
        beside.add_column(name, justify="right", no_wrap=True)
    shown = None if screen.width >= _WIDE else -1  # without the notes, which the report has
    if shown is None:
        beside.add_column("note")
    for row in list_comparison(plan.comparison):
        beside.add_row(*row[:shown])
    screen.print(beside)
    screen.print()


def print_plan(plan: GraspPlan, folder: Path) -> None:
    """Print a plan: what was planned, and at the end the answer."""
    from pinograsp.plan.answer import bears, does_it_hold, friction_used, shares
    from pinograsp.report import list_details, summarize

    remarks = [("caution", text) for text in plan.cautions]
    if given["verbose"]:
        facts = [*(("note", text) for text in plan.notes), *list_details(plan), *summarize(plan), *remarks]
    else:
        known = dict(list_details(plan))
        facts = [("search", known["search"]), ("friction", known["friction"]), ("it bears", bears(plan)), *remarks[:2]]
        if left := len(remarks[2:]) + len(plan.notes):
            facts.append(("remarks", f"{left} more, in the report"))
        uses = friction_used(plan)[0][1]
        used = shares(uses) if len(uses) <= _SOME else f"at most {shares({'': max(uses.values())}).strip()}"
        facts.append(("friction used", f"{used} of mu F_n"))
        deepest, took = known["largest penetration"], known["planning time"]
        facts.append(
            ("impact time t_I", f"{known['impact time t_I']}, largest penetration {deepest}, planned in {took}")
        )
        if plan.hand_in_object is not None:
            facts.append(("hand", known["hand"]))
    answer = does_it_hold(plan)
    answers = [
        ("Does it hold?", answer.text),
        ("How hard?", f"{_presses(plan)}; joints bear at most {plan.peak_efforts()}"),
        ("Results", f"{folder / 'report.html'}, beside it report.md, plan.json, plan.npz, figures"),
    ]
    then = [
        (command("check", folder), f"try it in simulation{needs('sim', 'mujoco')}"),
        (command("view", folder), f"look at it in a browser{needs('viz', 'viser')}"),
    ]
    more = "" if given["verbose"] else "more: in the report, or with -v"
    show(facts, answers, then, title=f"Grasp plan '{plan.name}'", level=answer.level, more=more)


def _presses(plan: GraspPlan) -> str:
    """The normal force of each contact, or of each finger's contacts together where there are many."""
    forces: dict[str, list[float]] = {}
    names, links = plan.contacts.names, plan.contacts.links or ("",) * len(plan.contacts.names)
    for name, link, force in zip(names, links, plan.forces.normal_forces.tolist()):
        finger = name.partition(f"/{link}")[0] if link and len(names) > _SOME else name
        forces.setdefault(finger, []).append(force)
    told = []
    for finger, each in forces.items():
        several = f" at {len(each)} contacts" if len(each) > 1 else ""
        told.append(f"{finger} {sum(each):.2f} N{several}")
    return ", ".join(told)


def _print_closure(closure: Closure) -> None:
    """What touches and stops, and at the end how many contacts there are."""
    answer, *others = closure.describe().splitlines()
    tell("\n".join(line.removeprefix("  ") for line in others))
    touching = [("Next", "move the object (--at), or let a place be searched (no --at)")]
    show([], [("Does it touch?", answer), *([] if closure.touches else touching)])
