"""What is tried: a plan as plain numbers, from Python or from a run folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinograsp.checks import brief, instance_of
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.plan import PlanFailure, PlanRecord
from pinograsp.storage import read_run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """A plan as the referee sees it: the commands, and what they are said to bring about.

    Attributes:
        hand: where it is at the start.
        body: the object, where it is at the start.
        times: (m,) [s].
        q, dq: commanded (m, n).
        torques: feed-forward (m, n) [N m], and after the end holding_torques (n,).
        torque_limit: (n,), infinity: none.
        impact_time, final_time: [s].
        names: of the planned contacts (k).
        links: that touch there (k).
        points_o: (k, 3) [m].
        forces_o: planned at the end, on the object (k, 3) [N].
        normal_forces: (k,) [N].
        depths: (k,) [m].
        mu: (k,).
        torsion: largest moment about a normal per newton [m].
        law: K, lambda, rho.
        load: besides the weight, on the object about its centre of mass (6,) [N, N m].
        gravity_o: (3,) [m/s^2].
    """

    hand: HandModel
    body: Body
    times: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    torques: np.ndarray
    holding_torques: np.ndarray
    torque_limit: np.ndarray
    impact_time: float
    final_time: float
    names: tuple[str, ...]
    links: tuple[str, ...]
    points_o: np.ndarray
    forces_o: np.ndarray
    normal_forces: np.ndarray
    depths: np.ndarray
    mu: np.ndarray
    torsion: float
    law: tuple[float, float, float]
    load: np.ndarray
    gravity_o: np.ndarray

    __repr__ = brief("hand", "body", "names", "normal_forces", "mu", "impact_time", "final_time")

    @classmethod
    def of(cls, plan: PlanRecord | str | Path, body: Body | None = None) -> Task:
        """From a plan, fresh or read back, or a run's folder; ``body`` where the plan does not know its own.

        Raises:
            InvalidInput: neither, a search without a plan, or no object.
        """
        instance_of("body", body, Body, type(None))
        record = read_run(plan) if isinstance(plan, str | Path) else plan
        if isinstance(record, PlanFailure):
            raise InvalidInput(f"simulate: expected a plan, got a search that found none ({record.status})")
        hand, motion, forces = instance_of("plan", record, PlanRecord).require_hand(), record.motion, record.forces
        body = body or record.body
        if body is None:
            raise InvalidInput(
                "simulate: this plan does not know its object's shape: give body=..., a pinograsp.objects shape"
            )
        contacts, law = record.contacts, record.law
        if not all(contacts.links):
            raise InvalidInput("simulate: expected contacts of a hand; these were made without one (hand=None)")
        load = np.array(record.load)
        # The weight acts on the simulated object by itself. A plan that did not know its object has the given one's in
        # its load.
        load[:3] -= (record.body_mass or body.mass) * record.gravity_o
        return cls(
            hand=hand,
            body=body,
            times=motion.times,
            q=motion.q,
            dq=motion.dq,
            torques=motion.torques,
            holding_torques=motion.holding_torques,
            torque_limit=record.torque_limit,
            impact_time=float(motion.times[motion.impact]),
            final_time=float(motion.times[-1]),
            names=contacts.names,
            links=contacts.links,
            points_o=contacts.points_o,
            forces_o=motion.forces_o[-1],
            normal_forces=forces.normal_history[-1],
            depths=forces.final_depths,
            mu=record.friction.mu,
            torsion=record.friction.torsion,
            law=(law.stiffness, law.damping, law.exponent),
            load=load,
            gravity_o=record.gravity_o,
        )

    def joint_of(self, link: str) -> int:
        """Pinocchio's index of the joint that carries a link (0: none, the palm)."""
        return self.hand.model.frames[self.hand.frame_id(link)].parentJoint
