"""The record of what was planned: forces and motion as numbers and names, warnings, the failure of a search."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np

from pinograsp.checks import instance_of, mapping_of, read_only, text_of
from pinograsp.contacts import PALM, Closure
from pinograsp.contacts.clearance import HOLLOW, behind_hulls
from pinograsp.contacts.doubt import DOUBTFUL, doubtful_share
from pinograsp.contacts.edges import sharp_contacts
from pinograsp.contacts.hits import find_overlaps
from pinograsp.errors import SearchFailed, Status
from pinograsp.forces import (
    ConvexSolution,
    ForceSolution,
    GlobalSolution,
    GraspConditions,
    GridSolution,
    Reserve,
    RobustForces,
)
from pinograsp.hands import HandModel, servo_gains
from pinograsp.hands.efforts import effort_shares
from pinograsp.hands.geometry import UNSEEN
from pinograsp.motion.torques import drives_limit
from pinograsp.objects.body import Body
from pinograsp.plan import (
    Layout,
    Motion,
    PlanCertificate,
    PlanContacts,
    PlanFailure,
    PlanForces,
    PlanFriction,
    PlanGrid,
    PlanReserve,
    Proof,
)
from pinograsp.planner.compliance import instability
from pinograsp.planner.drive_cautions import drive_cautions, drive_notes
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.planner.overshoot import tell_caps
from pinograsp.spatial import Array

_SLIDES = 1e-4  # [m] across the normal: worth a warning
_ELSEWHERE = 0.01  # [m] across the normal: contacts of plans that held slid by up to 7 mm, of two that were lost by 19
_GRAZES = 0.1  # of the largest depth: a link that is less deep presses with less than 3 % of the force there
_ROUNDING = 1e-3  # forces lie on their limits
_OTHER = 0.03  # share of a force from which on it is another one
_LEFT = 0.5  # share of the planned forces that the release has to leave


def assemble_plan(
    hand: HandModel,
    solution: ForceSolution,
    motion: Motion,
    *,
    elapsed: Mapping[str, float],
    closure: Closure | None = None,
    conditions: GraspConditions | None = None,
    reserve: PlanReserve | None = None,
    notes: tuple[str, ...] = (),
) -> GraspPlan:
    """The plan of a hand that is to bring these forces about by this motion."""
    problem, contacts, friction = solution.problem, solution.problem.contacts, solution.problem.friction
    push = 0.0 if reserve is None else reserve.force
    unstable = instability(hand, solution, motion.q[-1], servo_gains(hand), push)
    if closure is not None and reserve is not None:
        motion = _in_doubt(hand, solution, motion, unstable)
    closed = () if closure is None else closure.notes
    changed = () if problem.object is None else tuple(f"object: {note}" for note in problem.object.notes)
    cautions = _cautions(hand, solution, motion, unstable)
    others = [note for note in motion.notes if note not in cautions]
    return GraspPlan(
        layout=Layout(
            hand=hand.name,
            joints=tuple(hand.joint_names),
            fingers={finger.name: tuple(finger.dofs.tolist()) for finger in hand.fingers},
        ),
        hand=hand,
        body=problem.object,
        contacts=PlanContacts(
            names=tuple(contacts.names),
            links=tuple(contact.link for contact in contacts),
            points_o=contacts.points_o,
            rotations_oc=contacts.rotations_oc,
            com_o=contacts.com_o,
        ),
        friction=PlanFriction(
            mu=problem.mu,
            model=friction.model,
            edges=friction.edges if friction.polyhedral else None,
            safety=friction.safety,
            torsion=friction.torsion,
        ),
        law=problem.compliance.numbers(problem.max_depth),
        load=problem.load,
        gravity_o=problem.gravity_o,
        body_mass=0.0 if problem.object is None else problem.object.mass,
        balance=problem.balance,
        measure=problem.measure,
        on_table=conditions is not None and conditions.table,
        reserve=reserve,
        torque_limit=read_only(drives_limit(hand) if problem.torques is None else problem.torques.limit),
        forces=_forces(solution, motion),
        motion=motion,
        cautions=cautions,
        notes=(*others, *closed, *changed, *notes, *drive_notes(hand, motion), *tell_caps(hand, problem)),
        closing=None if closure is None else closure.summary(),
        elapsed=elapsed,
        versions=_versions(solution.solver),
        solution=solution,
        closure=closure,
        conditions=conditions,
    )


def _in_doubt(hand: HandModel, solution: ForceSolution, motion: Motion, unstable: str | None) -> Motion:
    """The motion with its status, where the reserve hangs on contacts that a small error changes or that slide far, or
    the object leaves by itself or is easily pushed away (``unstable``, in words).
    """
    problem = solution.problem
    if motion.status is not Status.OK or problem.object is None:
        return motion
    planned = solution.normal_forces
    kept = float(np.minimum(motion.settled_forces, planned).sum() / planned.sum())
    if kept < _LEFT:
        remedy = (
            f"once the object is let go its contacts press with {100 * kept:.0f} % of the planned forces, on which its "
            "reserve relies: choose another grasp, or search more samples"
        )
        return replace(motion, status=Status.DOUBTFUL, remedy=remedy)
    slip = np.asarray(motion.slip)
    if slip.size and float(slip.max()) > _ELSEWHERE:
        remedy = (
            f"{problem.contacts.names[int(slip.argmax())]} slides {1e3 * float(slip.max()):.0f} mm along the surface "
            "while it presses, to where no contact is planned: choose another grasp, or search more samples"
        )
        return replace(motion, status=Status.DOUBTFUL, remedy=remedy)
    share = doubtful_share(hand, problem.object, problem.contacts, planned)
    if share <= DOUBTFUL:
        return replace(motion, status=Status.DOUBTFUL, remedy=unstable) if unstable else motion
    where = f"{100 * share:.0f} % of the normal forces act on edges of the object or on hollow links"
    remedy = f"{where}, where a small error changes the normal. Choose another grasp, or search more samples"
    return replace(motion, status=Status.DOUBTFUL, remedy=remedy)


def record_reserve(
    reserve: Reserve, squeeze: RobustForces, hand: HandModel, tried: int, unrestricted: float
) -> PlanReserve:
    """The record of the reserve that a squeeze withstands; ``tried``: impact times in all rounds.

    ``unrestricted``: lower bound of the objective of a hand that could make any forces.
    """
    problem = squeeze.problem
    body = instance_of("object", problem.object, Body)
    weight = body.mass * float(np.linalg.norm(problem.gravity_o))
    softest, stiffest = reserve.stiffness_range
    return PlanReserve(
        disturbance=reserve.disturbance,
        force=reserve.disturbance * weight,
        moment=reserve.disturbance * weight * reserve.arm(body),
        mass=reserve.mass,
        friction=reserve.friction,
        normal_force=reserve.normal_force * weight,
        torque=reserve.torque,
        softer=1.0 / softest,
        stiffer=stiffest,
        drive=float(effort_shares(hand).max(initial=0.0)) if reserve.drive == "sheet" else reserve.drive,
        tasks=tuple(task.describe() for task in reserve.tasks),
        loads=len(squeeze.load_set.loads),
        impact_times=tried,
        above_unrestricted=max(0.0, squeeze_cost(squeeze) / unrestricted - 1.0) if unrestricted > 0 else 0.0,
    )


def squeeze_cost(squeeze: RobustForces) -> float:
    """The objective of a squeeze that was found."""
    return squeeze.certificate.objective if squeeze.certificate is not None else 0.0


def _forces(solution: ForceSolution, motion: Motion) -> PlanForces:
    problem, profile = solution.problem, solution.profile
    depths, rates = profile.depth(motion.times), profile.rate(motion.times)
    kept = None
    if isinstance(solution, GridSolution):
        grid = solution.grid
        kept = PlanGrid(
            points=grid.points, cells=grid.cells, rejections=dict(grid.rejections), qp_solves=grid.qp_solves
        )
    return PlanForces(
        status=solution.status,
        search=solution.search,
        solver=solution.solver,
        impact_time=float(profile.impact_time),
        final_time=problem.final_time,
        forces_c=solution.forces_c,
        multipliers=read_only(np.reshape(solution.multipliers, (-1, 2))),
        torsion=solution.torsion if len(solution.torsion) else read_only(np.zeros(problem.k)),
        acceleration=solution.acceleration,
        work=solution.work,
        impulse=solution.impulse,
        residual_force=solution.residual_force,
        residual_moment=solution.residual_moment,
        depths=read_only(depths),
        rates=read_only(rates),
        normal_history=read_only(problem.compliance.normal_force(depths, rates)),
        certificate=_certificate(solution),
        grid=kept,
    )


def _certificate(solution: ForceSolution) -> PlanCertificate | None:
    if not isinstance(solution, ConvexSolution) or solution.certificate is None:
        return None
    certificate = solution.certificate
    branches = solution.branches if isinstance(solution, GlobalSolution) else ()
    rows = [(one.start, one.end, one.lower_bound, one.best) for one in branches]
    return PlanCertificate(
        weights=dict(solution.weights),
        objective=certificate.objective,
        lower_bound=certificate.lower_bound,
        relative_gap=certificate.relative_gap,
        violation=certificate.violation,
        active=certificate.active(solution.problem.contacts.names),
        branches=read_only(np.array(rows, dtype=float).reshape(-1, 4)),
    )


def _cautions(hand: HandModel, solution: ForceSolution, motion: Motion, unstable: str | None) -> tuple[str, ...]:
    """What the plan's promise does not cover, in words; ``unstable``: how the object would leave or give way."""
    problem, contacts, cautions = solution.problem, solution.problem.contacts, list[str]()
    if problem.balance == "force":
        cautions.append("forces are balanced, moments are not: a free object turns (balance='wrench')")
    cautions += [note for note in hand.notes if UNSEEN in note]
    if problem.friction.safety == 1.0:
        cautions.append("friction is used up to its limit: ask for a friction safety factor above 1")
    cautions += [
        f"{name} cannot press: its force builds up only when the object gives way to the fingers"
        for name, contact in zip(contacts.names, contacts)
        if contact.finger == PALM
    ]
    if problem.torques is not None and problem.torques.limited.any():
        loaded = np.abs(problem.torques.jacobian).max(axis=(0, 1)) > 0
        bearing = zip(problem.torques.joints, loaded, problem.torques.limited)
        free = [name for name, bears, limited in bearing if bears and not limited]
        if free:
            cautions.append(f"no torque limits are known for {', '.join(free)}: their torques are not limited")
    others = np.abs(motion.settled_forces / solution.normal_forces - 1.0) > _OTHER
    cautions += [
        f"{name} slides {1e3 * slip:.2f} mm along the surface while it presses, which changes the direction of "
        f"friction: once the object is let go it presses with {rest:.2g} N, not {planned:.2g} N"
        for name, slip, other, rest, planned in zip(
            contacts.names, motion.slip, others, motion.settled_forces, solution.normal_forces
        )
        if slip > _SLIDES and other
    ]
    if problem.object is not None:
        cautions += [
            f"{name} touches an edge of the object, where the normal is not defined: a small error changes it"
            for name, sharp in zip(contacts.names, sharp_contacts(problem.object, contacts))
            if sharp
        ]
    cautions += [
        f"{name} touches where its link is hollow: the link itself is {1e3 * gap:.2g} mm behind its convex hull"
        for name, gap in zip(contacts.names, behind_hulls(hand, contacts))
        if gap > HOLLOW
    ]
    if problem.object is not None and (links := pressing_too(hand, solution, motion.q[-1])):
        touch, carry = ("touches", "it carries") if len(links) == 1 else ("touch", "they carry")
        cautions.append(
            f"{', '.join(links)} {touch} the object while the hand presses, although no contact is planned there: "
            f"{carry} part of the force"
        )
    if unstable:
        cautions.append(unstable)
    return (*cautions, *drive_cautions(hand, solution, motion), *_hardly_pressing(solution))


def pressing_too(hand: HandModel, solution: ForceSolution, q: Array) -> tuple[str, ...]:
    """Links without a contact that press on the object at q (n,), where the hand has closed to the planned depths."""
    body = solution.problem.object
    if body is None or not hand.geometry.geometryObjects:
        return ()
    allowed = _GRAZES * float(np.max(solution.profile.final_depth))
    return find_overlaps(hand, body, solution.problem.contacts, q, allowed=allowed)


def _hardly_pressing(solution: ForceSolution) -> Iterator[str]:
    """Contacts that bear next to nothing."""
    problem = solution.problem
    if problem.object is None:
        return
    share = Reserve().normal_force
    least = share * problem.object.mass * float(np.linalg.norm(problem.gravity_o))
    for name, force in zip(problem.contacts.names, solution.normal_forces):
        if force < least * (1 - _ROUNDING):
            yield f"{name} hardly presses, with {force:.2g} N: less than {100 * share:g} % of the weight"


def record_failure(error: SearchFailed, hand: str, settings: Mapping[str, Any]) -> PlanFailure:
    """Return the record of a search that found no forces, for a hand of that name."""
    solution, proof = instance_of("error", error, SearchFailed).solution, None
    text_of("hand", hand)
    settings = mapping_of("settings", settings)
    if isinstance(solution, ConvexSolution) and solution.infeasibility is not None:
        found = solution.infeasibility
        proof = Proof(
            margin=found.margin,
            direction=read_only(found.direction),
            at_torque_limit=tuple(found.at_torque),
            residual=read_only(found.residual),
        )
    return PlanFailure(
        status=solution.status,
        search=solution.search,
        message=str(error),
        proof=proof,
        hand=hand,
        contacts=tuple(solution.problem.contacts.names),
        settings=settings,
        versions=_versions(solution.solver),
    )


def _versions(solver: str) -> dict[str, str]:
    packages = ("pinograsp", "pin", "qpsolvers", "numpy", *((solver,) if solver in ("daqp", "clarabel") else ()))
    return {name: _version(name) for name in packages}


_version = lru_cache(version)  # reads files
