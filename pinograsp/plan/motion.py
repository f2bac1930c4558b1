"""The record of a motion: joint trajectory, torques and contact forces over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pinograsp.checks import brief
from pinograsp.errors import Status
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Joint trajectory and torques from t = 0 to t_F.

    Attributes:
        status: ``OK``, ``JOINT_LIMIT``, ``NOT_TRACKED`` or ``EARLY_CONTACT``; ``DOUBTFUL`` if a reserve depends on
            contacts that a small error changes or that slide far, or the object is easily pushed away.
        notes: position and effort limits met or exceeded, by joint.
        times: (m,) [s].
        impact: the sample at t_I, the last of the approach and the first of the grasp phase.
        q: joint positions (m, n) [rad; m where joints slide].
        dq: joint velocities (m, n) [rad/s or m/s].
        ddq: joint accelerations (m, n) [rad/s^2 or m/s^2].
        torques: (m, n) [N m or N].
        holding_torques: torques that hold still after t_F (n,) [N m or N].
        settled_forces: predicted normal forces after the object is let go (k,) [N]: the planned ones, or for a closed
            hand what remains of them after friction that built up while it pressed, and after joints that give way like
            their servos (with the torques of the planned forces as feed-forward).
        forces_o: contact forces on the object, world axes (m, k, 3) [N].
        contact_velocities: velocities of the contact points J dq, zero before the impact (m, k, 3) [m/s].
        tracking_error: largest distance of each contact point from its path (k,) [m]; along the normal for a closed
            hand.
        slip: largest distance across the normal, for a closed hand whose joints cannot follow the path (k,) [m].
        postures: number of contact-phase postures tried per finger.
        peak_torque: infinity norm of ``torques`` [N m].
        remedy: what causes a status other than ``OK``, and what to do; empty for ``OK``.
        closing_stiffness: gains of servos that tolerate a misplaced object while the hand closes, with the torques as
            feed-forward (n,) [N m/rad or N/m]; afterwards the joints are held where they are, with their own gains.
            None: their own gains all the time, as in records of earlier versions.
    """

    status: Status
    notes: tuple[str, ...]
    times: Annotated[Array, "m"]
    impact: int
    q: Annotated[Array, "m n"]
    dq: Annotated[Array, "m n"]
    ddq: Annotated[Array, "m n"]
    torques: Annotated[Array, "m n"]
    holding_torques: Annotated[Array, "n"]
    settled_forces: Annotated[Array, "k"]
    forces_o: Annotated[Array, "m k 3"]
    contact_velocities: Annotated[Array, "m k 3"]
    tracking_error: Annotated[Array, "k"]
    slip: Annotated[Array, "k"]
    postures: dict[str, int]
    peak_torque: float
    remedy: str = ""
    closing_stiffness: Annotated[Array | None, "n"] = None

    __repr__ = brief("status", "peak_torque", "impact", "times", "q", "notes")
