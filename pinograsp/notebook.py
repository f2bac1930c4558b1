"""Records as a notebook shows them: a small picture where there is something to see, and the figures that matter.

The HTML stands by itself: no scripts, no style sheets, and the colours of the page's own theme.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Literal

import numpy as np

from pinograsp.carry import CarryPlan
from pinograsp.carry.loads import LoadedRobot
from pinograsp.contacts import Closure, ContactSet
from pinograsp.errors import Status
from pinograsp.forces import Certificate, ConvexSolution, ForceProblem, ForceSolution
from pinograsp.hands import HandModel
from pinograsp.pages import render
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.plan.answer import describe_robustness, does_it_hold, friction_model
from pinograsp.spatial import Array
from pinograsp.synthesis import FoundGrasp, GraspSearch
from pinograsp.viz.scene import name_object, split_forces
from pinograsp.viz.style import contact_colours
from pinograsp.viz.thumbnail import Seen, thumbnail
from pinograsp.words import format_number

Level = Literal["yes", "caution", "no"]

# They read on white and on black.
_BADGES: dict[Level, str] = {"yes": "#1a7f37", "caution": "#9a6700", "no": "#cf222e"}
_MANY, _LONGEST = 12, 300  # rows of a table; characters of a text


@dataclass(slots=True, kw_only=True)
class _Page:
    """What is shown of a record.

    Attributes:
        title: in bold.
        badge: a word or two beside it, and how to take it.
        lead: the answer, in a sentence.
        columns: of the table.
        rows: its rows.
        colours: of the first column's dots, those of the picture's contacts.
        facts: name and value.
        remarks: warnings, notes.
        seen: the picture's content, found when it is drawn; None: no picture.
    """

    title: str
    badge: tuple[str, Level] | None = None
    lead: str = ""
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    colours: Sequence[str] = ()
    facts: Iterable[tuple[str, str]] = ()
    remarks: Sequence[str] = field(default_factory=tuple)
    seen: Callable[[], Seen] | None = None


def render_record(record: object) -> str | None:
    """A record as HTML; None for one that shows as text."""
    page = _make_page(record)
    if page is None:
        return None
    facts, picture = [(what, value) for what, value in page.facts if value], _picture(page)
    return render(
        "notebook.html", longest=_LONGEST, page=page, facts=facts, picture=picture, badges=_BADGES, most=_MANY
    )


def _picture(page: _Page) -> str:
    """The picture in base64; "" where it cannot be drawn: the figures are shown all the same."""
    if page.seen is None:
        return ""
    try:
        return base64.b64encode(thumbnail(page.seen())).decode()
    except Exception:  # meshes that are gone, hands without shapes
        return ""


# -- what is shown of each record --------------------------------------------------------------------------------------


@singledispatch
def _make_page(record: object) -> _Page | None:
    return None


@_make_page.register
def _(hand: HandModel) -> _Page:
    coupled = hand.model.njoints - 1 - hand.n
    rows = [(one.name, str(one.n), ", ".join(one.actuated), one.tip) for one in hand.fingers]
    known = hand.effort[hand.effort > 0]
    efforts = dict.fromkeys(f"{value:g}" for value in (known.min(), known.max())) if known.size else ()
    return _Page(
        title=hand.name,
        lead=f"{hand.n} joints" + (f" that move {coupled} more" if coupled else "") + f", {hand.mass:.3g} kg",
        columns=("finger", "joints", "moved by", "tip"),
        rows=rows,
        facts=(
            ("palm", hand.palm),
            ("drives", str(len(hand.drives)) if hand.drives else ""),
            ("effort limits", f"{' to '.join(efforts)} N m" if efforts else "none known"),
            ("source", hand.source),
        ),
        remarks=_notes(hand.notes),
        seen=lambda: Seen(hand=hand, q=hand.resting),
    )


@_make_page.register
def _(plan: PlanRecord) -> _Page:
    answer, contacts, forces = does_it_hold(plan), plan.contacts, plan.forces
    colours = contact_colours(contacts.names, plan.layout.fingers)
    _, _, used = split_forces(contacts.rotations_oc, plan.friction.mu, plan.motion.forces_o[-1:])
    rows = [
        (name, f"{normal:.3g}", _share(share), format_number(1e3 * depth, 3))
        for name, normal, share, depth in zip(contacts.names, forces.normal_forces, used[0], forces.final_depths)
    ]
    certificate = forces.certificate
    proven = "" if certificate is None else f"gap {certificate.relative_gap:.1e}"
    return _Page(
        title=plan.name,
        badge=(str(plan.status), answer.level),
        lead=answer.text,
        columns=("contact", "F_n [N]", "friction used", "depth [mm]"),
        rows=rows,
        colours=colours,
        facts=(
            ("peak joint effort", plan.peak_efforts()),
            ("it withstands", "" if plan.margins is None else describe_robustness(plan)),
            ("friction", friction_model(plan.friction)),
            ("object", "" if plan.body is None else name_object(plan.body)),
            ("t_I, t_F", f"{forces.impact_time:g}, {forces.final_time:g} s"),
            ("proven optimal", proven),
        ),
        remarks=[*(f"warning: {one}" for one in plan.cautions), *_notes(plan.notes)],
        seen=lambda: Seen(
            hand=plan.require_hand(),
            q=plan.motion.q[-1],
            body=plan.body,
            points_o=contacts.points_o,
            normals_o=contacts.rotations_oc[:, :, 2],
            forces_o=plan.motion.forces_o[-1],
            colours=colours,
            load_o=plan.load[:3],
            gravity_o=plan.gravity_o,
        ),
    )


@_make_page.register
def _(closure: Closure) -> _Page:
    colours = contact_colours([touch.finger for touch in closure.touches], [one.name for one in closure.hand.fingers])

    def make_view() -> Seen:
        points = np.array([touch.point_o for touch in closure.touches]).reshape(-1, 3)
        normals = np.array([touch.normal_o for touch in closure.touches]).reshape(-1, 3)
        return Seen(
            hand=closure.hand, q=closure.q, body=closure.object, points_o=points, normals_o=normals, colours=colours
        )

    rows = [
        (touch.finger or "(no finger)", touch.link, _millimetres(touch.point_o), f"{100 * touch.at:.0f} %")
        for touch in closure.touches
    ]
    touching = len({touch.finger for touch in closure.touches if touch.finger})
    return _Page(
        title=f"{closure.hand.name} closed on a {name_object(closure.object)}",
        badge=(f"{len(closure.touches)} contacts", "yes" if touching > 1 else "caution"),
        columns=("finger", "link", "point [mm]", "of the way"),
        rows=rows,
        colours=colours,
        remarks=[*(f"self-collision: {one} and {two}" for one, two in closure.self_collisions), *_notes(closure.notes)],
        seen=make_view,
    )


@_make_page.register
def _(problem: ForceProblem) -> _Page:
    contacts = problem.contacts
    low, high = problem.impact_time_range
    rows = [
        (name, one.link, _millimetres(one.point_o), f"{mu:g}")
        for name, one, mu in zip(contacts.names, contacts, problem.mu.tolist())
    ]
    thing, friction, wrench = problem.object, problem.friction, problem.balance == "wrench"
    model = f"{friction.model} of {friction.edges} edges" if friction.polyhedral else friction.model
    return _Page(
        title="contact forces that hold a load" if thing is None else f"hold {name_object(thing)}",
        lead=f"{problem.k} contacts, forces {'and moments' if wrench else 'alone'} in balance",
        columns=("contact", "link", "point [mm]", "mu"),
        rows=rows,
        colours=contact_colours(contacts.names),
        facts=(
            ("load", f"{_numbers(problem.load[:3])} N, {_numbers(problem.load[3:])} N m"),
            ("friction", f"{model}, safety factor {friction.safety:g}"),
            ("minimised", problem.measure),
            ("t_I, t_F", f"{low:g} to {high:g}, {problem.final_time:g} s"),
            ("largest F_n", "" if problem.max_normal_force is None else f"{_numbers(problem.max_normal_force)} N"),
            ("torque limits", "none" if problem.torques is None else f"of {len(problem.torques.joints)} joints"),
        ),
    )


@_make_page.register
def _(solution: ForceSolution) -> _Page:
    problem = solution.problem
    rows = []
    if solution.found:
        _, _, used = split_forces(np.tile(np.eye(3), (problem.k, 1, 1)), problem.mu, solution.forces_c[None])
        rows = [
            (name, f"{normal:.3g}", _share(share))
            for name, normal, share in zip(problem.contacts.names, solution.normal_forces, used[0])
        ]
    facts = [("t_I", "" if solution.impact_time is None else f"{solution.impact_time:g} s")]
    if solution.found:
        left = f"{format_number(solution.residual_force, 3)} N, {format_number(solution.residual_moment, 3)} N m"
        facts.append(("residual", left))
    if isinstance(solution, ConvexSolution):
        if solution.certificate is not None:
            facts += _proof(solution.certificate, problem.contacts)
        if solution.infeasibility is not None:
            facts.append(("proof", solution.infeasibility.least_left()))
    facts.append(("computed", f"{solution.search} search, {solution.solver or 'no solver'}, {solution.elapsed:.3g} s"))
    return _Page(
        title="contact forces",
        badge=(str(solution.status), _level(solution.status)),
        lead="" if solution.status is Status.OK else solution.status.remedy,
        columns=("contact", "F_n [N]", "friction used"),
        rows=rows,
        colours=contact_colours(problem.contacts.names),
        facts=facts,
    )


@_make_page.register
def _(certificate: Certificate) -> _Page:
    badge: tuple[str, Level] = ("optimal", "yes") if certificate.is_optimal() else ("not proven", "caution")
    return _Page(title="certificate", badge=badge, facts=_proof(certificate, None))


@_make_page.register
def _(simulation: Simulation) -> _Page:
    verdict = simulation.verdict
    rows = [
        (part, f"{final:.3g}", f"{planned:.3g}", f"{1e3 * slip:.3f}")
        for part, final, planned, slip in zip(
            simulation.parts, simulation.normal_forces[-1], simulation.planned_forces, simulation.slips[-1]
        )
    ]
    return _Page(
        title="simulation",
        badge=("held", "yes") if verdict.held else ("lost", "no"),
        lead=verdict.reason,
        columns=("part", "F_n at the end [N]", "planned [N]", "slipped [mm]"),
        rows=rows,
        facts=(
            ("drift, turn", f"{1e3 * verdict.drift:.3g} mm, {verdict.turn:.3g} deg"),
            ("largest force error", f"{100 * verdict.force_error:.3g} %"),
            ("touching although not planned", ", ".join(verdict.unplanned)),
            ("at their torque limit", ", ".join(verdict.saturated)),
            ("run", f"{simulation.mode}, {simulation.times[-1]:.3g} s in {simulation.elapsed:.2g} s"),
        ),
        remarks=[
            *(f"why: {one}" for one in verdict.causes),
            *(f"what helps: {one}" for one in verdict.remedies),
            *_notes(simulation.notes),
        ],
    )


@_make_page.register
def _(plan: CarryPlan) -> _Page:
    colours = contact_colours(plan.contacts, [one.name for one in plan.grasp.hand.fingers])
    peak = int(plan.squeeze.argmax())

    def make_view() -> Seen:
        held = LoadedRobot.carry(plan.robot, plan.grasp)
        now = held.axes(plan.q[peak : peak + 1])[0]
        turn, shift = now[:3, :3], now[:3, 3]
        contacts = plan.grasp.contacts
        return Seen(
            hand=plan.robot,
            q=plan.q[peak],
            body=held.body.placed(now @ held.body.pose),
            points_o=contacts.points_o @ turn.T + shift,
            normals_o=contacts.rotations_oc[:, :, 2] @ turn.T,
            colours=colours,
            gravity_o=plan.gravity_o,
        )

    rows = [
        (name, f"{least:.3g} to {most:.3g}", f"{100 * use:.0f} %")
        for name, least, most, use in zip(
            plan.contacts, plan.normal_forces.min(axis=0), plan.normal_forces.max(axis=0), plan.friction_use.max(axis=0)
        )
    ]
    what = "its object" if plan.grasp.body is None else f"a {name_object(plan.grasp.body)}"
    bound = "" if plan.lower_bound is None else f"{plan.lower_bound:.4g} s"
    return _Page(
        title=f"{plan.robot.name} carries {what} in {plan.duration:.4g} s",
        badge=(str(plan.status), _level(plan.status)),
        columns=("contact", "F_n on the way [N]", "friction used at most"),
        rows=rows,
        colours=colours,
        facts=(
            ("no timing is faster than", bound),
            ("could be faster by", "" if plan.fastest is not None else f"{plan.factor:.3g} times"),
            ("squeeze", f"{plan.squeeze.min():.3g} to {plan.squeeze[peak]:.3g} N, most at {plan.instants[peak]:.3g} s"),
            ("withstands besides", f"{plan.disturbance[0]:.3g} N in any direction"),
            ("binds", "; ".join(f"{what} ({100 * share:.0f} %)" for what, share in plan.shares()[:4])),
        ),
        remarks=[*(f"warning: {one}" for one in plan.cautions), *_notes(plan.notes)],
        seen=make_view,
    )


@_make_page.register
def _(grasp: FoundGrasp) -> _Page:
    page = _make_page(grasp.closure)
    assert page is not None
    page.facts = _worth(grasp)
    return page


@_make_page.register
def _(search: GraspSearch) -> _Page:
    rows = []
    for i, grasp in enumerate(search.grasps[:_MANY]):
        fingers = dict.fromkeys(one.finger for one in grasp.closure.contacts())
        rows.append((str(i), *(value for _, value in _worth(grasp)), ", ".join(fingers)))
    best = _make_page(search.grasps[0].closure) if search.grasps else None
    return _Page(
        title=f"{len(search.grasps)} grasps",
        badge=None if search.grasps else ("none found", "no"),
        lead=search.explain(),
        columns=("", "squeeze", "quality", "doubtful", "load factor", "fingers"),
        rows=rows,
        remarks=search.remarks if search.grasps else (),
        seen=None if best is None else best.seen,
    )


# -- words -------------------------------------------------------------------------------------------------------------


def _worth(grasp: FoundGrasp) -> tuple[tuple[str, str], ...]:
    return (
        ("squeeze", f"{grasp.squeeze:.3g} N" if grasp.withstands else "withstands no reserve"),
        ("quality", format_number(grasp.quality, 3)),
        ("doubtful", f"{100 * grasp.doubtful:.0f} %"),
        ("load factor", f"{grasp.load_factor:.3g}"),
    )


def _proof(certificate: Certificate, contacts: ContactSet | None) -> list[tuple[str, str]]:
    """What a certificate says; of the active limits where the contacts have names."""
    facts = [
        ("objective", format_number(certificate.objective, 6)),
        ("no forces cost less than", format_number(certificate.lower_bound, 6)),
        ("relative gap", f"{certificate.relative_gap:.1e}"),
        ("violation", f"{certificate.violation:.1e} N"),
    ]
    if contacts is None:
        facts.append(("residual", f"{certificate.residual_norm:.1e} N"))
        meets = zip(
            ("friction", "least F_n", "largest F_n"),
            (certificate.at_friction, certificate.at_least, certificate.at_most),
        )
        facts += [(f"contacts at their {what} limit", f"{int(np.sum(mask))} of {len(mask)}") for what, mask in meets]
    else:
        facts.append(("active limits", "; ".join(certificate.active(contacts.names)) or "none"))
    return facts


def _level(status: Status) -> Level:
    return "yes" if status is Status.OK else "no" if status is Status.INFEASIBLE else "caution"


def _notes(notes: Sequence[str]) -> list[str]:
    return [f"note: {note}" for note in notes]


def _share(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "-"


def _numbers(values: Array) -> str:
    return f"({', '.join(f'{value:.3g}' for value in values.tolist())})"


def _millimetres(point: Array) -> str:
    return ", ".join(f"{1e3 * value:.1f}" for value in point.tolist())
