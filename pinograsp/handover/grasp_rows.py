"""A plan as the postures that data sets keep: before the grasp, at it, and the references that squeeze."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import flag, number, path_of, read_only, text_of
from pinograsp.data import GraspRows, write_grasps
from pinograsp.errors import InvalidInput
from pinograsp.handover.commands import efforts, gains, require_drives
from pinograsp.hands import HandModel
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array, inverse_of
from pinograsp.writing import write_errors

# Shapes of simulations differ by tenths of a millimetre from those of the plan, and references that ask for little more
# than that lose their force. Of 60 plans for a LEAP hand, 54 succeeded in DexGraspBench's evaluation with the planned
# efforts, 58 with twice, 59 with three times as much.
SQUEEZE = 2.0
_TO_GO = 0.015  # [m] for the contact that has most: from farther away fingers come fast, and not at once


def commanded_postures(
    plan: PlanRecord, *, stiffness: ArrayLike | None = None, rigid: bool = False, squeeze: float = 1.0
) -> Array:
    """Return three postures (3, n) that a plan commands to position servos: the last one in its approach with the
    contact points 15 mm before the object, the one in which the links touch, and references q + tau / kp that press
    with its forces and compensate the hand's own weight. The references start from the depths of contacts as soft as
    planned, or, for ``rigid`` ones, from the touch. Other arguments and errors are those of :func:`grasp_rows`.
    """
    squeeze = number("squeeze", squeeze, above=0)
    hand, motion = plan.require_hand(), plan.motion
    _body_of(plan)
    require_drives(hand)
    kp, last = gains(hand, "stiffness", stiffness), motion.q[-1:]
    weight = inverse_dynamics(hand, last, 0 * last, 0 * last, gravity_o=plan.gravity_o)
    effort, _ = efforts(hand, last, motion.holding_torques[None] - weight, shortfall=None)
    pressed = motion.q[[motion.impact]] if flag("rigid", rigid) else last
    squeezed = pressed + squeeze * effort / kp @ np.linalg.pinv(hand.transmission).T
    found: Array = np.concatenate([motion.q[[_find_near(plan, hand), motion.impact]], squeezed])
    return found


def grasp_rows(
    plan: PlanRecord,
    object_name: str,
    *,
    scale: float = 1.0,
    stiffness: ArrayLike | None = None,
    squeeze: float = SQUEEZE,
) -> GraspRows:
    """Return the postures of a plan (:func:`commanded_postures`) as one row of a data set, whose simulations have hard
    contacts.

    Joints are in the order of the hand's fingers in its description, coupled ones included.

    Args:
        plan: new or read back.
        object_name: name of the object in the data set.
        scale: of its mesh in the data set [-].
        stiffness: kp, one number or (m,) of the drives; default: their own.
        squeeze: multiple of the planned efforts that the references ask for [-].

    Raises:
        InvalidInput: a plan without its hand or object, a hand without drives or with an arm, unknown gains.
    """
    hand = plan.require_hand()
    object_name, scale = text_of("object", object_name), number("scale of the object", scale, above=0)
    names = [joint for finger in hand.fingers for joint in finger.joints]
    own = {joint for finger in hand.fingers for joint in finger.actuated}
    if others := [joint for joint in hand.joint_names if joint not in own]:
        raise InvalidInput(
            f"hand: expected one without an arm, whose root is free, got joints of no finger: {', '.join(others)}"
        )
    postures = commanded_postures(plan, stiffness=stiffness, rigid=True, squeeze=squeeze)
    before, touching, squeezing = (_every_joint(hand, names, q) for q in postures)
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


def _find_near(plan: PlanRecord, hand: HandModel) -> int:
    """The last sample on the way from which one of the contacts has so far to go; the first where none has."""
    places = plan.contacts_on_links
    if places is None:
        return 0
    links_o = hand.frame_placements(plan.motion.q[: plan.motion.impact + 1], places.links)
    points_o = np.einsum("mkij,kj->mki", links_o[..., :3, :3], places.points_l) + links_o[..., :3, 3]
    to_go = np.linalg.norm(points_o - points_o[-1], axis=2).max(axis=1)
    return int(np.flatnonzero(to_go >= _TO_GO).max(initial=0))


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
    squeeze: float = SQUEEZE,
) -> Path:
    """Write a plan as a grasp for DexGraspBench's evaluation, ``OBJECT/scale008_pose000/NAME.npy`` in a folder; returns
    the file. Arguments as for :func:`grasp_rows`; ``object_name`` is the object's folder in its repository.
    """
    folder, name = path_of("folder", folder), text_of("name", name)
    rows = grasp_rows(plan, object_name, scale=scale, stiffness=stiffness, squeeze=squeeze)
    place = folder / Path(rows.object_name).name / f"scale{round(100 * scale):03d}_pose000"
    with write_errors(place):
        place.mkdir(parents=True, exist_ok=True)
    return write_grasps(place / f"{name}.npy", rows)
