"""Warnings of a carry plan whose forces balance all loads, in words."""

from __future__ import annotations

import numpy as np

from pinograsp.carry.path import ArmPath
from pinograsp.contacts.edges import past_edges
from pinograsp.errors import Status
from pinograsp.forces import ConvexSolution
from pinograsp.hands import HandModel, servo_gains
from pinograsp.hands.efforts import exceed_ways
from pinograsp.plan import Motion
from pinograsp.planner import GraspPlan
from pinograsp.planner.assemble import pressing_too
from pinograsp.planner.best import FAR
from pinograsp.planner.compliance import stiffness_of, tell_leaving
from pinograsp.spatial import Array

# [m, rad] under loads that come slowly, half of what counts as lost: those that come at once give twice as much.
_SWAYS = (2.5e-3, np.radians(5.0))
_SERVOS = "with servos of"
OWN = "the grasp's own plan is doubtful:"  # how warnings that are the grasp's begin
_HALF_TURN = np.pi + 1e-3  # [rad] as few digits give it


def doubt_grasp(grasp: GraspPlan, *, arm_in_hand: bool) -> list[str]:
    """What the grasp's own plan says against it.

    ``arm_in_hand``: of a grasp of arm and hand in one, which takes the arm's drives for as soft as fingers'.
    """
    doubts = list(grasp.cautions) if grasp.status is Status.DOUBTFUL else []
    if arm_in_hand:
        doubts = [one for one in doubts if not one.startswith(_SERVOS)]
    return [f"{OWN} {one}" for one in doubts]


def doubt_path(robot: HandModel, path: ArmPath) -> list[str]:
    """Steps of continuous joints that are a way round as they stand, and a short one if angles are wrapped."""
    doubts = []
    for joint, q in zip(path.joints, path.q.T):
        wrapped = np.maximum(np.abs(q[:-1]), np.abs(q[1:])) <= _HALF_TURN
        steps = np.where(wrapped, np.abs(np.diff(q)), 0.0)
        at = int(steps.argmax())
        if joint in robot.continuous and steps[at] > np.pi:
            doubts.append(
                f"{joint} turns by {np.degrees(steps[at]):.4g} deg between waypoints {at} and {at + 1}: if angles are "
                "wrapped into +-180 deg, unwrap them first (numpy.unwrap); if the turn is meant, add a waypoint "
                "between them"
            )
    return doubts


def doubt_drives(robot: HandModel, q: Array, torques: Array) -> list[str]:
    """Drives that would have to act the other way than they can, somewhere on the way (N, n)."""
    beyond = exceed_ways(robot, q, torques)
    return [
        f"drive {drive.name} produces {drive.efforts[0]:g} to {drive.efforts[1]:g}, but would have to act in the other "
        f"direction in {100 * share:.2g} % of the intervals"
        for drive, share in zip(robot.drives, beyond.mean(axis=0))
        if share and drive.efforts is not None
    ]


def doubt_squeeze(grasp: GraspPlan, first: ConvexSolution, closing: Motion, most: Array, loads: Array) -> list[str]:
    """What speaks against the way's squeeze, which may be far firmer than that of the grasp's own plan.

    Args:
        grasp: what is carried.
        first: the forces of the way's beginning.
        closing: of the grasp's hand to these.
        most: the largest normal forces on the way (k,) [N].
        loads: wrenches on the object on the way (N, 6), in the axes of the grasp [N, N m].
    """
    problem, body, doubts = first.problem, grasp.body, list[str]()
    names, contacts = problem.contacts.names, problem.contacts
    if body is not None:
        depths = np.asarray(problem.compliance.depth(most))
        doubts += [
            f"{names[i]} presses up to {1e3 * depths[i]:.2g} mm deep on the way, but another face of the object is "
            "nearer than that, so the contact gives way; grasp the object farther from edges, or cap the normal force"
            for i in np.flatnonzero(past_edges(body, contacts, depths))
        ]
        doubts += [
            f"{names[i]} slides {1e3 * closing.slip[i]:.2g} mm along the surface while the hand closes to the squeeze "
            "of the path"
            for i in np.flatnonzero(np.asarray(closing.slip) > FAR * body.bounding_radius)
        ]
    doubts += [
        f"{name} touches the object while the hand closes to the squeeze of the path, although no contact is planned "
        "there"
        for name in pressing_too(grasp.hand, first, closing.q[-1])
    ]
    gains = servo_gains(grasp.hand)
    held = stiffness_of(grasp.hand, first, closing.q[-1], gains)
    if leaves := tell_leaving(grasp.hand, held, gains):
        doubts.append(f"with the squeeze at the beginning of the path, {leaves}")
        return doubts
    swayed = np.linalg.solve(np.array(held.matrix), (loads - loads[0]).T).T
    shift, turn = (float(np.linalg.norm(part, axis=1).max()) for part in (swayed[:, :3], swayed[:, 3:]))
    if shift > _SWAYS[0] or turn > _SWAYS[1]:
        doubts.append(
            f"the object sways in the hand by up to {1e3 * shift:.2g} mm and {np.degrees(turn):.2g} deg, because "
            "contacts and servos give way to the loads on the path: hold it with more fingers, or move more slowly"
        )
    return doubts
