"""A plan as the postures that data sets keep: before the grasp, at it, and the references that squeeze."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import number, path_of, read_only, text_of
from pinograsp.contacts import clearance
from pinograsp.data import GraspRows, write_grasps
from pinograsp.errors import InvalidInput
from pinograsp.handover.commands import efforts, gains, require_drives
from pinograsp.hands import HandModel
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.objects.body import Body
from pinograsp.plan import Motion, PlanRecord
from pinograsp.spatial import Array, inverse_of
from pinograsp.writing import write_errors

_CLEAR = 0.01  # [m] of an open hand from the object


def commanded_postures(plan: PlanRecord, *, stiffness: ArrayLike | None = None) -> Array:
    """The postures (3, n) that a plan asks of position servos: the last one on its way that is 10 mm clear of the
    object, where the links touch, and references that press with its forces, q + tau / kp, the hand's own weight made
    up for. Arguments and errors as of :func:`grasp_rows`.
    """
    hand, body, motion = plan.require_hand(), _body_of(plan), plan.motion
    require_drives(hand)
    kp, last = gains(hand, "stiffness", stiffness), motion.q[-1:]
    weight = inverse_dynamics(hand, last, 0 * last, 0 * last, gravity_o=plan.gravity_o)
    effort, _ = efforts(hand, last, motion.holding_torques[None] - weight, shortfall=None)
    squeezed = last + effort / kp @ np.linalg.pinv(hand.transmission).T
    found: Array = np.concatenate([motion.q[[_last_clear(hand, body, motion), motion.impact]], squeezed])
    return found


def grasp_rows(
    plan: PlanRecord, object_name: str, *, scale: float = 1.0, stiffness: ArrayLike | None = None
) -> GraspRows:
    """The postures of a plan, as of :func:`commanded_postures`, as one row of a data set.

    Joints are in the order of the hand's fingers, as of its description, coupled ones included.

    Args:
        plan: fresh or read back.
        object_name: what the data set calls the object.
        scale: of its mesh there [-].
        stiffness: kp, one number or (m,) of the drives; default: their own.

    Raises:
        InvalidInput: a plan without its hand or object, a hand without drives or with an arm, gains that nobody gives.
    """
    hand = plan.require_hand()
    object_name, scale = text_of("object", object_name), number("scale of the object", scale, above=0)
    names = [joint for finger in hand.fingers for joint in finger.joints]
    own = {joint for finger in hand.fingers for joint in finger.actuated}
    if others := [joint for joint in hand.joint_names if joint not in own]:
        raise InvalidInput(
            f"hand: expected one without an arm, whose root is free, got joints of no finger: {', '.join(others)}"
        )
    before, touching, squeezing = (_every_joint(hand, names, q) for q in commanded_postures(plan, stiffness=stiffness))
    pose = read_only((inverse_of(_body_of(plan).pose) @ hand.pose)[None])
    return GraspRows(
        source=f"plan of {hand.name}",
        format="dexgraspbench",
        first=0,
        object_name=object_name,
        hand_name=hand.name,
        poses=pose,
        q=touching,
        joint_names=tuple(names),
        scale=read_only(np.array([scale])),
        pregrasp_poses=pose,
        pregrasp_q=before,
        squeeze_poses=pose,
        squeeze_q=squeezing,
    )


def _body_of(plan: PlanRecord) -> Body:
    """The object of a plan, or InvalidInput where it has none."""
    if plan.body is None:
        raise InvalidInput("plan: expected one with its object, got one without: plan with a shape")
    return plan.body


def _last_clear(hand: HandModel, body: Body, motion: Motion) -> int:
    """The last sample on the way to the object at which the hand is clear of it; the first where none is."""
    clear, near = 0, motion.impact
    while near - clear > 1:
        middle = (clear + near) // 2
        if clearance(hand, body, motion.q[middle]) >= _CLEAR:
            clear = middle
        else:
            near = middle
    return clear


def _every_joint(hand: HandModel, names: list[str], q: Array) -> Array:
    """Positions (1, j) of the joints of these names, of which some follow others, at q (n,)."""
    values = dict(zip(hand.joint_names, q.tolist()))
    for joint, one in hand.couplings.items():
        values[joint] = one.factor * values[one.followed] + one.offset
    return read_only(np.array([[values[name] for name in names]]))


def write_dexgraspbench(
    plan: PlanRecord,
    folder: str | Path,
    object_name: str,
    *,
    scale: float = 1.0,
    name: str = "0",
    stiffness: ArrayLike | None = None,
) -> Path:
    """Write a plan as a grasp that DexGraspBench's evaluation takes, ``OBJECT/scale008_pose000/NAME.npy`` in a folder;
    returns the file. Arguments as for :func:`grasp_rows`; ``object_name`` is the object's folder in its repository.
    """
    folder, name = path_of("folder", folder), text_of("name", name)
    rows = grasp_rows(plan, object_name, scale=scale, stiffness=stiffness)
    place = folder / Path(rows.object_name).name / f"scale{round(100 * scale):03d}_pose000"
    with write_errors(place):
        place.mkdir(parents=True, exist_ok=True)
    return write_grasps(place / f"{name}.npy", rows)
