"""How far the object of a plan may be from where the plan has it."""

from __future__ import annotations

import numpy as np

from pinograsp import core
from pinograsp.checks import instance_of
from pinograsp.contacts import Closure
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.misplaced import ClosingCommands, Pressing, close_misplaced
from pinograsp.errors import InvalidInput, Status
from pinograsp.hands import servo_gains
from pinograsp.motion.tolerance import STEP, measure_tolerance, sample_commands, stiffness_of_links
from pinograsp.plan import PlanRecord
from pinograsp.plan.simulation import MOVED
from pinograsp.plan.tolerance import PoseError, PoseTolerance

DROPS = "the object drops"  # how the warning of that begins
_FINE = 1e-3  # [s] steps of an object that falls for hundredths of a second
_BEFORE = 0.05  # [s] that its fixed object is closed on before it is let go


def tell_tolerance(
    plan: PlanRecord,
    closure: Closure | None,
    error: PoseError | None = None,
    *,
    quick: bool = False,
    known: PoseTolerance | None = None,
) -> PoseTolerance | None:
    """As :func:`find_tolerance`, which may be ``known`` of the errors that are asked about; None of a plan that is not
    ``OK``, or of given contacts (no ``closure``), or without the compiled core, or of geometry that it does not know.
    """
    if plan.status is not Status.OK or closure is None or not core.is_installed():
        return None
    try:
        return find_tolerance(plan, error, quick=quick, known=known)
    except InvalidInput:  # geometry that the core does not know
        return None


def find_tolerance(
    plan: PlanRecord,
    error: PoseError | None = None,
    *,
    threads: int | None = None,
    quick: bool = False,
    known: PoseTolerance | None = None,
) -> PoseTolerance:
    """Find how far the object may be from its planned place: close the hand of the plan on it in other places.

    The joints follow their commands with the plan's servos for closing. Links that touch push the object, which slides
    and turns on its table (``table=True``), or stays until the grasp is complete. Then the table disappears, the joints
    are held where they are, and the object must stay in the hand for 0.4 s. This is a quick computation in implicit
    steps of 10 ms, some milliseconds per error; :func:`pinograsp.simulate` checks it by independent means. If the open
    hand is already in the way of the misplaced object, the object counts as lost.

    Args:
        plan: a plan with its hand and its object.
        error: sizes and directions; default: 5 mm and 5 deg, in 12 directions.
        threads: of the compiled core; None: one for each core.
        quick: try errors of that size only: ``distance`` is that size or 0.
        known: what this found of the same plan and errors when it was quick: these are not tried again.

    Raises:
        InvalidInput: the plan has no hand or object, or its contacts have no link.
        ExtraMissing: the compiled core is not installed; or the object is not convex, and coacd (extra ``mesh``) is
            not.
    """
    instance_of("error", error, PoseError, type(None))
    closing = _closing_of(plan)
    return measure_tolerance(*closing, error or PoseError(), threads, quick=quick, known=known)


def find_drop(plan: PlanRecord) -> float:
    """How far the object drops, or the hand moves it, before the hand has closed, where nothing but the hand holds it
    from the touch on, t_I [m]; infinity where it falls out. 0 where that is not known, of plans without a reserve,
    whose objects are fixed until t_F, and of those on a table.
    """
    if plan.on_table or plan.reserve is None or plan.body is None or not all(plan.contacts.links):
        return 0.0
    if plan.status is not Status.OK or not core.is_installed():
        return 0.0
    try:
        closing = _closing_of(plan, free=float(plan.motion.times[plan.motion.impact]), step=_FINE)
    except InvalidInput:  # geometry that the core does not know
        return 0.0
    seen = close_misplaced(*closing, np.eye(4)[None])
    return float(seen.pushed[0]) if seen.kept[0] else np.inf


def tell_drop(drop: float) -> str | None:
    """The warning of an object that drops far [m], in words; None of others."""
    if drop <= MOVED:
        return None
    far = f"by {1e3 * drop:.2g} mm" if np.isfinite(drop) else "out of the hand"
    return (
        f"{DROPS} {far} before the squeeze holds it, if nothing but the hand supports it from the touch on: support it "
        "until the grasp is complete"
    )


def _closing_of(
    plan: PlanRecord, free: float | None = None, step: float = STEP
) -> tuple[BulkScene, ClosingCommands, Pressing]:
    """A plan's hand and object, how the hand closes, and how both press; ``free``: when what is fixed is let go [s]."""
    hand, body = instance_of("plan", plan, PlanRecord).require_hand(), plan.body
    if body is None or not all(plan.contacts.links):
        raise InvalidInput("tolerance: expected a plan whose object and links are known: plan a hand on a shape")
    scene, motion = BulkScene(hand, body, surface=True), plan.motion
    stiff = servo_gains(hand)
    commands = sample_commands(
        motion.times,
        motion.q,
        motion.torques,
        soft=stiff if motion.closing_stiffness is None else motion.closing_stiffness,
        stiff=stiff,
        limit=plan.torque_limit,
        begin=0.0 if free is None else max(0.0, free - _BEFORE),
        free=free,
        step=step,
    )
    slopes = plan.forces.normal_forces / np.maximum(plan.forces.final_depths, 1e-6)
    pressing = Pressing(
        root=hand.pose,
        stiffness=stiffness_of_links(scene, plan.contacts.links, slopes),
        mu=float(plan.friction.mu.mean()),
        torsion=plan.friction.torsion,
        gravity_o=plan.gravity_o,
        on_table=plan.on_table,
    )
    return scene, commands, pressing
