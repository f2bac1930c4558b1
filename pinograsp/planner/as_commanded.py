"""What comes of a plan in a hand whose position servos are told where to go, and nothing else."""

from __future__ import annotations

import numpy as np

from pinograsp import core
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.commanded import Loading, Motors, follow_commands
from pinograsp.errors import InvalidInput
from pinograsp.handover import commanded_postures
from pinograsp.plan import PlanRecord
from pinograsp.plan.simulation import TURNED

_FAR = 0.05  # [m] by which soft servos may let an object go
_LITTLE = 0.5  # share of the largest turn that does not count


def measure_turn(plan: PlanRecord) -> float:
    """How far the push of the reserve, in any direction, turns the object where the hand's own position servos hold it,
    as a share [-] of what still counts as held: 0 up to a half of that, 1 where the object is lost.

    Told are the postures of :func:`~pinograsp.handover.commanded_postures`. 0 for hands without such servos, plans
    without a reserve, and without the compiled core.
    """
    hand, body, reserve = plan.hand, plan.body, plan.reserve
    if hand is None or body is None or reserve is None or not hand.drives or not core.is_installed():
        return 0.0
    if any(drive.control != "position" or drive.stiffness is None for drive in hand.drives):
        return 0.0
    try:
        scene, stages = BulkScene(hand, body, surface=True), commanded_postures(plan)
    except InvalidInput:  # geometry that the core does not know
        return 0.0
    axes = np.eye(6)[:3]
    weight = np.concatenate([plan.body_mass * plan.gravity_o, np.zeros(3)])
    loading = Loading(
        loads=weight + reserve.force * np.concatenate([-axes, axes]),
        distance=_FAR,
        angle=np.radians(TURNED),
        stiffness=float(np.median(plan.forces.normal_forces / np.maximum(plan.forces.final_depths, 1e-6))),
        mu=float(plan.friction.mu.mean()),
        torsion=plan.friction.torsion,
    )
    found = follow_commands(scene, Motors.of(hand), stages[None], np.tile(hand.pose, (1, 3, 1, 1)), loading)
    share = float(np.degrees(found.turned[0])) / TURNED if found.kept[0] else 1.0
    return share if share > _LITTLE else 0.0
