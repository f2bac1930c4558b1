"""``pinograsp plan``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from pinograsp.cli import completion
from pinograsp.cli.options import (
    RESERVE_HELP,
    ArmOptions,
    GraspOptions,
    WishOptions,
    force_option,
    new_folder,
    out_option,
)
from pinograsp.cli.screen import RIGHT, columns, command, needs, print_table, show, tell_missing_core
from pinograsp.cli.session import Session, argument, option
from pinograsp.errors import GraspInfeasible, InvalidInput, NoGrasp

if TYPE_CHECKING:
    from pinograsp.cases import Case
    from pinograsp.cases.object_case import ObjectCase
    from pinograsp.planner import GraspPlan
    from pinograsp.synthesis import GraspSearch
    from pinograsp.writing import NewFolder

SPECS = "cylinder:radius=0.02,height=0.12,mass=0.2 (all shapes: below)"
_WIDE = 120  # columns of a terminal that are enough for the notes of the comparison
_KEYS = {"arguments": "xacro_args"}  # of a case of hand and object, where an option has another name
_BESIDE_PAPER = ("impact time t_I", "friction used", "it withstands")  # which the paper's figures stand for
_SOME = 6  # contacts that are named one by one

_thing = partial(option, "What to grasp")
_pair = partial(option, "Only with --hand and --object")
_case = partial(option, "Only with a case")
_forces = partial(option, "Forces")


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

    search: str | None = _forces(
        "How to choose forces: hybrid, paper, paper+qp (grids) or convex (certified optimum).",
        choices=completion.SEARCHES,
    )
    balance: str | None = _forces(
        "What to balance: force (as in the paper) or wrench (forces and moments).", choices=completion.BALANCES
    )
    measure: str | None = _forces(
        "Measure of the grasp energy: impulse \\[N s] or work \\[J].", choices=completion.MEASURES
    )
    solver: str | None = _forces(
        "auto, newton, interior, or an installed QP solver: daqp, clarabel, osqp...", choices=completion.SOLVERS
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class AloneOptions:
    """What goes with a hand and an object alone, which a case file says otherwise; and with a case alone."""

    table: bool = _pair("The object stands on a table, and the hand stays above it.", "--table", default=False)
    torque_limit: float | None = _pair(
        "Torque limit of every joint \\[N m or N]. It applies if it is below the effort limit of the hand's "
        "file, which may be far too generous, or if that limit looks like a placeholder."
    )
    check: bool = _pair(
        "Simulate the grasps that were found, at rest and shaken, and take one that holds.", "--check", default=False
    )
    reserve: str | None = _pair(RESERVE_HELP, choices=completion.RESERVES)
    tasks: list[str] | None = _pair(
        "Task that the grasp must withstand besides the weight: screw:torque=0.5, pour:tilt_deg=60, insert:force=5, "
        "pull:force=5,direction=0 0 1, shake:acceleration=3; repeatable.",
        "--task",
        metavar="NAME:FIELD=VALUE,...",
    )
    changes: list[str] | None = _case(
        "Change a value of the case; repeatable.", "--set", metavar="KEY=VALUE", complete=completion.keys
    )
    compare: bool = _case(
        "With the case 'paper': show its figures beside ours, on the screen and in the report.",
        "--compare",
        default=False,
    )

    def settings(self) -> dict[str, Any]:
        """By the names of a case of hand and object."""
        settings: dict[str, Any] = {"table": self.table, "torque_limit": self.torque_limit, "check": self.check}
        settings |= {"tasks": self.tasks} if self.tasks else {}
        return settings if self.reserve is None else {**settings, "reserve": self.reserve}


@dataclass(frozen=True, slots=True, kw_only=True)
class WhatOptions:
    """What is planned: a case, or a hand and an object."""

    case: str | None = argument(
        "A built-in case ('paper') or a case file ('pinograsp new' writes one); without it, give --hand and --object.",
        complete=completion.cases,
    )
    hand: str | None = _thing(
        "With --object: a hand from the catalogue, menagerie:NAME, or its file.", complete=completion.complete_hands
    )
    object: str | None = _thing(f"With --hand: object to hold, such as {SPECS}.", complete=completion.objects)


def plan(
    *,
    what: WhatOptions,
    wishes: WishOptions,
    grasp: GraspOptions,
    forces: ForceOptions,
    alone: AloneOptions,
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

    To plan your own case: pinograsp new case.yaml && pinograsp plan case.yaml

    What each answer means: docs/howto/answers.md
    """
    if not (session.as_json or session.quiet):
        tell_missing_core()
    chosen = {key: value for key, value in asdict(forces).items() if value is not None}
    case, hand, object = what.case, what.hand, what.object
    if case is not None and hand is None and object is None:
        if alone.compare and case != "paper":
            raise InvalidInput(
                f"--compare: expected with the case 'paper', whose figures are published, got '{case:.200}'"
            )
        options = {**grasp.settings(), **arm.settings(), **chosen, **alone.settings()}
        typed = {key: options[key] for name in session.typed if (key := _KEYS.get(name, name)) in options}
        _plan_case(case, {**typed, "wishes": wishes.pick(session.typed)}, chosen, alone, (out, force), session)
    elif case is None and hand is not None and object is not None:
        if alone.changes:
            raise InvalidInput("--set changes a case: expected CASE, got --hand and --object")
        if alone.compare:
            raise InvalidInput("--compare: expected with the case 'paper', got --hand and --object")
        options = {**grasp.settings(), **arm.settings(), **chosen, **alone.settings(), "wishes": wishes.settings()}
        described = make_case(hand, object, options)
        kind = object.partition(":")[0]
        # Of a library's name, menagerie:leap_hand/left_hand, the robot and its file.
        called = hand.partition(":")[2].replace("/", "-") or Path(hand).stem
        _plan_pair(described, f"{called}-{kind}", (out, force), session)
    else:
        raise InvalidInput("expected either CASE, or --hand and --object")


# Where a case file has what options say of a hand and an object, by the names of the commands' parameters.
_IN_CASES = {
    **dict.fromkeys(
        (
            *("root", "palm", "fingers", "packages", "trusted", "masses", "exclude", "srdf", "sheet", "hulls"),
            "posture",
        ),
        "hand.",
    ),
    "arguments": "hand.xacro_args",
    "at": "hand.position_mm",
    "mu": "friction.mu",
    "friction": "friction.model",
    "safety": "friction.safety",
    **dict.fromkeys(
        (
            *("samples", "seed", "wrap", "table", "check", "tasks", "touching_fingers", "least_fingers", "within"),
            *("touching", "forbidden", "approach", "edges", "palm_touches", "opening"),
        ),
        "contacts",
    ),
    "torque_limit": "limits.torque_limit",
}


def _refuse_with_case(session: Session, case: str) -> None:
    """Refuse options of ``--hand`` and ``--object`` that were given with a case, which has all of that itself.

    Raises:
        InvalidInput: with the places of a case file where it is to be written.
    """
    typed = {name: text for name, text in session.typed.items() if name in _IN_CASES}
    if typed:
        places = [place + name if (place := _IN_CASES[name]).endswith(".") else place for name in typed]
        raise InvalidInput(
            f"{', '.join(typed.values())}: expected with --hand and --object, got CASE '{case:.200}', whose hand, "
            f"object and contacts are in its file: write {', '.join(dict.fromkeys(places))} there, or give them with "
            "--set KEY=VALUE"
        )


def _plan_pair(case: ObjectCase, name: str, results: tuple[Path | None, bool], session: Session) -> None:
    with new_folder(*results, name) as folder:
        found = search_grasps(case, session)
        _finish(case.plan(found, progress=session.progress), folder, session)


def _plan_case(
    case: str,
    options: dict[str, Any],
    chosen: dict[str, str],
    alone: AloneOptions,
    results: tuple[Path | None, bool],
    session: Session,
) -> None:
    from pinograsp.cases import load_case
    from pinograsp.cases.case import with_changes
    from pinograsp.cases.object_case import ObjectCase

    loaded = load_case(case, texts=alone.changes or [])
    if isinstance(loaded, ObjectCase):
        out, force = results
        out = Path(loaded.out) if out is None and loaded.out is not None else out
        _plan_pair(loaded.change(options), loaded.name or "mine", (out, force), session)
        return
    _refuse_with_case(session, case)
    if alone.reserve not in (None, "none") and chosen.get("search", "convex") != "convex":
        raise InvalidInput(
            f"--search: expected convex with --reserve, got {chosen['search']}: one squeeze for several loads is a "
            "convex program; leave --search out, or take --reserve none"
        )
    changes: dict[str, object] = {f"forces.{key}": value for key, value in chosen.items()}
    loaded = with_changes(loaded, changes | ({} if alone.reserve is None else {"reserve": alone.reserve}))
    with new_folder(*results, loaded.name) as folder:
        try:
            planned = loaded.plan(progress=session.progress)
        except GraspInfeasible as error:
            # A proof that there is no grasp is a result and is kept; a grid that found nothing proves nothing.
            if error.solution.search == "convex":
                _keep_proof(error, loaded, folder)
            raise
        planned = _with_comparison(planned, loaded) if alone.compare else planned
        _finish(planned, folder, session, published=case == "paper" and alone.reserve is None)


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


def _finish(plan: GraspPlan, folder: NewFolder, session: Session, *, published: bool = False) -> None:
    """Save a plan with its report and figures, print it, and exit with its code; ``published``: beside the paper's
    figures.
    """
    from pinograsp.planner import save_run

    plan = plan.with_margins().with_reach().with_tolerance()

    def extras(path: Path) -> None:
        from pinograsp.report import write_report

        write_report(plan, path, [figure.name for figure in plan.save_figures(path)])

    save_run(plan, folder, extras=extras)
    if session.as_json:
        session.print_json({**plan.summary(), "folder": str(folder.path)})
    else:
        if plan.comparison:
            _print_comparison(plan)
        print_plan(plan, folder.path, session, published=published)
    if plan.status.exit_code:
        raise typer.Exit(plan.status.exit_code)


def _keep_proof(error: GraspInfeasible, case: Case, folder: NewFolder) -> None:
    from pinograsp.planner import record_failure, save_run
    from pinograsp.report import write_report

    failure = record_failure(error, case.hand.source, case.settings())
    save_run(failure, folder, extras=lambda path: write_report(failure, path))
    typer.echo(f"the proof is written to {folder.path}: report.html, report.md, plan.json", err=True)


def _print_comparison(plan: GraspPlan) -> None:
    from pinograsp.report import list_comparison

    title = "Comparison with the paper (planned with the paper's choices: balance of forces only)"
    whole = {"no_wrap": True}
    names: dict[str, dict[str, Any]] = {"quantity": {}, "unit": whole}
    names |= {name: {**RIGHT, **whole} for name in ("paper", "ours", "difference")}
    rows = list_comparison(plan.comparison)
    if columns() >= _WIDE:
        names["note"] = {}
    else:
        rows = [row[:-1] for row in rows]  # without the notes, which the report has
    print_table(names, rows, title, padding=(0, 1, 0, 0))
    typer.echo("")


def print_plan(plan: GraspPlan, folder: Path, session: Session, *, published: bool = False) -> None:
    """Print a plan: what was planned, and at the end the answer; ``published``: with the paper's figures."""
    from pinograsp.plan.answer import describe_robustness, describe_trial, does_it_hold, friction_used, shares
    from pinograsp.report import list_details, summarize

    remarks = [("warning", text) for text in plan.cautions]
    if session.verbose:
        facts = [*(("note", text) for text in plan.notes), *list_details(plan), *summarize(plan), *remarks]
    else:
        known = dict(list_details(plan))
        facts = [
            ("search", known["search"]),
            ("friction", known["friction"]),
            ("it withstands", describe_robustness(plan)),
            *([] if plan.tolerance is None else [("it is held", plan.tolerance.describe())]),
            *remarks[:2],
        ]
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
    if published:
        from pinograsp.cases.published import tell_figures

        facts = [*tell_figures(plan), *(fact for fact in facts if fact[0] not in _BESIDE_PAPER)]
    answer = does_it_hold(plan)
    answers = [
        ("Does it hold?", answer.text),
        ("How hard?", f"{_presses(plan)}; joint torques up to {plan.peak_efforts()}"),
        ("Results", f"{folder / 'report.html'}, beside it report.md, plan.json, plan.npz, figures"),
    ]
    then = [
        (command("check", folder), "try it otherwise" if describe_trial(plan) else "try it in simulation"),
        (command("view", folder), f"look at it in a browser{needs('viz', 'viser')}"),
    ]
    if published:
        then.append((command("plan", "mug"), "a mug, with a reserve"))
    show(facts, answers, then, title=f"Grasp plan '{plan.name}'", level=answer.level, more=session.more)


def _presses(plan: GraspPlan) -> str:
    """The normal force of each contact, or of each finger's contacts together where there are many."""
    forces: dict[str, list[float]] = {}
    names, links = plan.contacts.names, plan.contacts.links or ("",) * len(plan.contacts.names)
    many = len(names) > _SOME or len(set(links)) < len(links)  # corners of one area
    for name, link, force in zip(names, links, plan.forces.normal_forces.tolist()):
        finger = name.partition(f"/{link}")[0] if link and many else name
        forces.setdefault(finger, []).append(force)
    told = []
    for finger, each in forces.items():
        several = f" at {len(each)} contacts" if len(each) > 1 else ""
        told.append(f"{finger} {sum(each):.2f} N{several}")
    return ", ".join(told)
