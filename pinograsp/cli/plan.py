"""``pinograsp plan``."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions, FrictionOptions, GraspOptions, force_option, new_folder, out_option
from pinograsp.cli.screen import command, console, needs, show
from pinograsp.cli.session import Session
from pinograsp.errors import GraspInfeasible, InvalidInput, NoGrasp

if TYPE_CHECKING:
    from pinograsp.cases import Case
    from pinograsp.cases.object_case import ObjectCase
    from pinograsp.planner import GraspPlan
    from pinograsp.synthesis import GraspSearch
    from pinograsp.writing import NewFolder

SPECS = "cylinder:radius=0.02,height=0.12,mass=0.2 (all shapes: below)"
_WIDE = 120  # columns of a terminal that are enough for the notes of the comparison
_SOME = 6  # contacts that are named one by one

_thing = functools.partial(typer.Option, rich_help_panel="What to grasp")
_pair = functools.partial(typer.Option, rich_help_panel="With --hand and --object alone")
_case = functools.partial(typer.Option, rich_help_panel="With a case alone")
_forces = functools.partial(typer.Option, rich_help_panel="Forces")


class CommandWithObjects(TyperCommand):
    """A command whose help ends with all that ``--object`` takes."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        from pinograsp.objects.spec import object_language

        first, *others = object_language()
        lines = [f"--object {first}", *others]
        self.epilog = "\n\n".join(line.replace("[", "\\[") for line in lines)
        super().format_help(ctx, formatter)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceOptions:
    """How contact forces are chosen."""

    search: Annotated[
        str | None,
        _forces(
            help="hybrid, paper, paper+qp (grids) or convex (certified optimum).",
            autocompletion=completion.one_of(completion.SEARCHES),
        ),
    ] = None
    balance: Annotated[
        str | None,
        _forces(
            help="force (the paper) or wrench (forces and moments).",
            autocompletion=completion.one_of(completion.BALANCES),
        ),
    ] = None
    measure: Annotated[
        str | None,
        _forces(help="impulse \\[N s] or work \\[J].", autocompletion=completion.one_of(completion.MEASURES)),
    ] = None
    solver: Annotated[
        str | None,
        _forces(
            help="auto, newton, interior, or a QP solver that is there: daqp, clarabel, osqp...",
            autocompletion=completion.one_of(completion.SOLVERS),
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PairOptions:
    """What a case file says otherwise."""

    table: Annotated[bool, _pair("--table", help="The object stands on a table: the hand keeps above it.")] = False
    torque_limit: Annotated[
        float | None,
        _pair(
            help="Of every joint \\[N m or N], where it is below the effort limit of the hand's file, which may be far "
            "too generous."
        ),
    ] = None
    check: Annotated[
        bool,
        _pair(
            "--check",
            help="Simulate the grasps that were found, at rest and shaken, and take one that is held.",
        ),
    ] = False
    reserve: Annotated[
        str | None,
        _pair(
            help="What to bear besides the weight: none, default, or some of disturbance, moment_arm, mass, friction, "
            "normal_force, torque, softer, stiffer: disturbance=0.5,mass=0.2 (shares; moment_arm \\[m]; softer, "
            "stiffer: factors on the contacts' stiffness).",
            autocompletion=completion.one_of(completion.RESERVES),
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseOptions:
    """What is done with a case besides planning it."""

    changes: Annotated[
        list[str] | None,
        _case(
            "--set",
            metavar="KEY=VALUE",
            help="Change a value of the case; repeatable.",
            autocompletion=completion.keys,
        ),
    ] = None
    compare: Annotated[
        bool, _case("--compare", help="With the case 'paper': print the table against the paper's figures, too.")
    ] = False


def plan(
    *,
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
        _thing(help="With --object: a hand of the catalogue, or its file.", autocompletion=completion.hands),
    ] = None,
    object: Annotated[
        str | None,
        _thing(help=f"With --hand: what to hold, as {SPECS}.", autocompletion=completion.objects),
    ] = None,
    grasp: GraspOptions,
    friction: FrictionOptions,
    forces: ForceOptions,
    pair: PairOptions,
    of_case: CaseOptions,
    arm: ArmOptions,
    out: Annotated[Path | None, out_option("a new one, runs/NAME, runs/NAME-2, ...")] = None,
    force: Annotated[bool, force_option("an earlier run in --out")] = False,
    session: Session,
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
    chosen = {key: value for key, value in asdict(forces).items() if value is not None}
    if case is not None and hand is None and object is None:
        _refuse_with_case(context, case)
        if pair.reserve not in (None, "none"):
            raise InvalidInput("--reserve: expected --hand and --object, got CASE: its forces hold its load alone")
        if of_case.compare and case != "paper":
            raise InvalidInput(
                f"--compare: expected with the case 'paper', whose figures are published, got '{case:.200}'"
            )
        _plan_case(case, chosen, of_case, (out, force), session)
    elif case is None and hand is not None and object is not None:
        if of_case.changes:
            raise InvalidInput("--set changes a case: expected CASE, got --hand and --object")
        if of_case.compare:
            raise InvalidInput("--compare: expected with the case 'paper', got --hand and --object")
        beside = asdict(pair)
        if pair.reserve is None:
            del beside["reserve"]
        options = {**grasp.settings(), **asdict(friction), **arm.settings(), **chosen, **beside}
        described = make_case(hand, object, options)
        kind = object.partition(":")[0]
        with new_folder(out, force, f"{Path(hand).stem}-{kind}") as folder:
            found = search_grasps(described, session)
            _finish(described.plan(found, progress=session.progress), folder, session)
    else:
        raise InvalidInput("expected either CASE, or --hand and --object")


# Where a case file has what options say of a hand and an object, by the names of the commands' parameters.
_IN_CASES = {
    **dict.fromkeys(
        ("root", "palm", "fingers", "packages", "trusted", "masses", "exclude", "srdf", "hulls", "posture"), "hand."
    ),
    "arguments": "hand.xacro_args",
    "at": "hand.position_mm",
    "mu": "friction.mu",
    "friction": "friction.model",
    "safety": "friction.safety",
    **dict.fromkeys(("within", "samples", "seed", "wrap", "table", "check"), "contacts"),
    "torque_limit": "limits.torque_limit",
}


def _refuse_with_case(context: typer.Context, case: str) -> None:
    """Refuse options of ``--hand`` and ``--object`` that were given with a case, which has all of that itself.

    Raises:
        InvalidInput: with the places of a case file where it is to be written.
    """
    options, places = [], []
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if name in _IN_CASES and source is not None and source.name == "COMMANDLINE":
            place = _IN_CASES[name]
            options.append(max(parameter.opts, key=len))
            places.append(place + name if place.endswith(".") else place)
    if options:
        raise InvalidInput(
            f"{', '.join(options)}: expected with --hand and --object, got CASE '{case:.200}', whose hand, object and "
            f"contacts are in its file: write {', '.join(dict.fromkeys(places))} there, or give them with "
            "--set KEY=VALUE"
        )


def _plan_case(
    case: str,
    chosen: dict[str, str],
    options: CaseOptions,
    results: tuple[Path | None, bool],
    session: Session,
) -> None:
    from pinograsp.cases import load_case

    changes = [f'forces.{key}="{value}"' for key, value in chosen.items()]
    loaded = load_case(case, texts=[*(options.changes or []), *changes])
    with new_folder(*results, loaded.name) as folder:
        try:
            planned = loaded.plan(progress=session.progress)
        except GraspInfeasible as error:
            # A proof that there is no grasp is a result and is kept; a grid that found nothing proves nothing.
            if error.solution.search == "convex":
                _keep_proof(error, loaded, folder)
            raise
        _finish(_with_comparison(planned, loaded) if case == "paper" else planned, folder, session, options.compare)


def _with_comparison(plan: GraspPlan, case: Case) -> GraspPlan:
    """The plan with the comparison with the paper, or with a note where the paper's choices give no grasp."""
    from pinograsp.cases.published import compare

    try:
        return replace(plan, comparison=tuple(compare(case)))
    except NoGrasp as error:
        note = f"no comparison with the paper: with the paper's choices there is no grasp ({error})"
        return replace(plan, notes=(*plan.notes, note))


def make_case(hand: str, object: str, options: dict[str, Any]) -> ObjectCase:
    """A hand and an object as a case, with checked options."""
    from pinograsp.cases.object_case import ObjectCase

    return ObjectCase.of(hand=hand, object=object, **options)


def search_grasps(case: ObjectCase, session: Session) -> GraspSearch | None:
    """Grasps of the object, or None where its place in the hand is given."""
    if case.at is not None:
        return None
    search = case.grasps(progress=session.progress)
    if search.interrupted:
        typer.echo(
            f"pinograsp: {search.tried} of {case.samples} samples tried, {len(search.grasps)} grasps hold the object; "
            "nothing written",
            err=True,
        )
        raise KeyboardInterrupt
    return search


def _finish(plan: GraspPlan, folder: NewFolder, session: Session, compare: bool = False) -> None:
    """Save a plan with its report and figures, print it, and exit with its code."""
    from pinograsp.planner import save_run

    plan = plan.with_margins().with_reach()

    def extras(path: Path) -> None:
        from pinograsp.report import write_report

        write_report(plan, path, [figure.name for figure in plan.save_figures(path)])

    save_run(plan, folder, extras=extras)
    if session.as_json:
        session.print_json({**plan.summary(), "folder": str(folder.path)})
    else:
        if compare and plan.comparison:
            _print_comparison(plan)
        print_plan(plan, folder.path, session)
    if plan.status.exit_code:
        raise typer.Exit(plan.status.exit_code)


def _keep_proof(error: GraspInfeasible, case: Case, folder: NewFolder) -> None:
    from pinograsp.planner import record_failure, save_run
    from pinograsp.report import write_report

    failure = record_failure(error, case.hand.source, case.settings())
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


def print_plan(plan: GraspPlan, folder: Path, session: Session) -> None:
    """Print a plan: what was planned, and at the end the answer."""
    from pinograsp.plan.answer import bears, does_it_hold, friction_used, shares
    from pinograsp.report import list_details, summarize

    remarks = [("caution", text) for text in plan.cautions]
    if session.verbose:
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
        (command("check", folder), "try it in simulation"),
        (command("view", folder), f"look at it in a browser{needs('viz', 'viser')}"),
    ]
    show(facts, answers, then, title=f"Grasp plan '{plan.name}'", level=answer.level, more=session.more)


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
