"""A simulation of a plan as the viewer shows it, at the scene's instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pinograsp.checks import brief
from pinograsp.hands.model import HandModel
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.spatial import Array, BoolArray
from pinograsp.viz.solids import Links, to_sevens


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulated:
    """A simulation of the plan at the scene's f instants.

    Attributes:
        held: whether the object stayed in the hand.
        reason: why, in words.
        release: when the object was let go [s]; None: never.
        link_poses: position [m] and quaternion w, x, y, z (f, l, 7).
        object_poses: likewise (f, 7).
        parts: of the hand that touch (p).
        planned: F_n at t_F (p,) [N].
        normal_forces: (f, p) [N].
        forces_o: (f, p, 3) [N].
        points_b: points at which the forces are drawn, in the body frame (p, 3) [m]: the mean of a part's planned
            contacts; NaN: unknown.
        drift: of the object since t_F (f,) [m].
        beside: shift that places the simulation beside the plan (3,) [m].
    """

    held: bool
    reason: str
    release: float | None
    link_poses: Array
    object_poses: Array
    parts: tuple[str, ...]
    planned: Array
    normal_forces: Array
    forces_o: Array
    points_b: Array
    drift: Array
    beside: Array

    __repr__ = brief()

    def arrows(self, frame: int, scale: float) -> Array:
        """Start and end of the forces' arrows (p, 2, 3) [m] at ``scale`` [m/N]; at unknown points without length."""
        pose = self.object_poses[frame]
        known: BoolArray = np.all(np.isfinite(self.points_b), axis=1, keepdims=True)
        start: Array = Rotation.from_quat(pose[[4, 5, 6, 3]]).apply(np.where(known, self.points_b, 0.0)) + pose[:3]
        return np.stack([start, start + scale * np.where(known, self.forces_o[frame], 0.0)], axis=1)


def sample_simulation(plan: PlanRecord, simulation: Simulation, times: Array, links: Links, beside: Array) -> Simulated:
    """A simulation at ``times`` (f,) [s], ``beside`` the plan (3,) [m]."""
    hand = links.hand
    at = np.clip(np.searchsorted(simulation.times, times - 1e-9), 0, len(simulation.times) - 1)
    poses, parts = simulation.object_poses, simulation.parts
    pose = poses[0] if plan.body is None else plan.body.pose
    points_b = (plan.contacts.points_o - pose[:3, 3]) @ pose[:3, :3]
    joints = np.array([_find_joint(hand, link) for link in plan.contacts.links])
    where = np.full((len(parts), 3), np.nan)
    for i, part in enumerate(parts):
        own = np.array([name == part for name in plan.contacts.names])
        own = own if own.any() else (joints == _find_joint(hand, part)) & (joints >= 0)
        if own.any():
            where[i] = points_b[own].mean(axis=0)
    return Simulated(
        held=simulation.verdict.held,
        reason=simulation.verdict.reason,
        release=simulation.release,
        link_poses=links.poses(simulation.q[at]),
        object_poses=to_sevens(poses[at]),
        parts=parts,
        planned=simulation.planned_forces,
        normal_forces=simulation.normal_forces[at],
        forces_o=simulation.forces_o[at],
        points_b=where,
        drift=simulation.drift[at],
        beside=beside,
    )


def _find_joint(hand: HandModel, link: str) -> int:
    """Index of the joint that carries a link; -1: the hand has no such link."""
    return int(hand.model.frames[hand.frame_id(link)].parentJoint) if hand.model.existFrame(link) else -1
