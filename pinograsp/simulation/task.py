"""The plan under test as plain numbers, from Python or from a run folder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

from pinograsp.checks import brief, instance_of
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.plan import ContactLaw, PlanFailure, PlanRecord
from pinograsp.simulation.settings import Support
from pinograsp.spatial import Array
from pinograsp.storage import read_run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """A plan as the simulation takes it: the commands, and the contacts and forces that they should produce.

    Attributes:
        hand: at its initial placement.
        body: the object at its initial placement.
        times: of the commands (m,) [s].
        q: commanded positions (m, n) [rad or m].
        dq: commanded velocities (m, n) [rad/s or m/s].
        torques: feed-forward torques (m, n) [N m or N].
        holding_torques: feed-forward torques after the last command (n,) [N m or N].
        torque_limit: (n,) [N m or N]; infinity: no limit.
        impact_time: t_I [s].
        final_time: t_F [s], when the object is let go; the commands may go on after it.
        names: of the planned contacts (k).
        links: of the hand at these contacts (k).
        points_o: contact points (k, 3) [m].
        rotations_oc: contact frames, z into the object (k, 3, 3).
        com_o: the object's centre of mass as planned (3,) [m].
        forces_o: planned at the end, on the object (k, 3) [N].
        normal_forces: planned at the end (k,) [N].
        settled_forces: foreseen once the object is let go (k,) [N].
        depths: planned penetration at the end (k,) [m].
        mu: friction coefficients (k,).
        torsion: largest moment about a normal per newton [m].
        law: the contact law, by its numbers.
        load: on the object about its centre of mass, without the weight (6,) [N, N m].
        gravity_o: (3,) [m/s^2].
        closing_stiffness: gains of the servos while the hand closes (n,) [N m/rad or N/m]; None: as afterwards.
        support: of the object until it is let go, as the plan has it: a table where it stands on one; nothing
            from t_I on where its squeeze has a reserve; else it is fixed.
        carrier: link that the object is to stay with; "": it is to stay where it is.
    """

    hand: HandModel
    body: Body
    times: Array
    q: Array
    dq: Array
    torques: Array
    holding_torques: Array
    torque_limit: Array
    impact_time: float
    final_time: float
    names: tuple[str, ...]
    links: tuple[str, ...]
    points_o: Array
    rotations_oc: Array
    com_o: Array
    forces_o: Array
    normal_forces: Array
    settled_forces: Array
    depths: Array
    mu: Array
    torsion: float
    law: ContactLaw
    load: Array
    gravity_o: Array
    closing_stiffness: Array | None = None
    support: Support = "fixed"
    carrier: str = ""

    __repr__ = brief("hand", "body", "names", "normal_forces", "mu", "impact_time", "final_time")

    @classmethod
    def of(cls, plan: PlanRecord | Task | str | Path, body: Body | None = None) -> Task:
        """The task of a plan, or of the plan in a run's folder; ``body``: the object, where the plan has none.

        Raises:
            InvalidInput: not a plan, a search that found none, or a plan without an object.
        """
        instance_of("body", body, Body, type(None))
        if isinstance(plan, Task):
            if body is not None:
                raise InvalidInput(
                    "body: expected with a plan that has no object, got one with a task, which has its own"
                )
            return plan
        record = read_run(plan) if isinstance(plan, str | Path) else plan
        if isinstance(record, PlanFailure):
            raise InvalidInput(f"simulate: expected a plan, got a search that found none ({record.status})")
        hand, motion, forces = instance_of("plan", record, PlanRecord).require_hand(), record.motion, record.forces
        body = body or record.body
        if body is None:
            raise InvalidInput(
                "simulate: this plan does not know its object's shape: give body=..., a pinograsp.objects shape"
            )
        contacts = record.contacts
        if not all(contacts.links):
            raise InvalidInput("simulate: expected contacts of a hand; these were created without one (hand=None)")
        load = np.array(record.load)
        # The engine adds the weight itself. Where the plan has no object, its load contains the given object's weight.
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
            rotations_oc=contacts.rotations_oc,
            com_o=contacts.com_o,
            forces_o=motion.forces_o[-1],
            normal_forces=forces.normal_history[-1],
            settled_forces=motion.settled_forces,
            depths=forces.final_depths,
            mu=record.friction.mu,
            torsion=record.friction.torsion,
            law=record.law,
            load=load,
            gravity_o=record.gravity_o,
            closing_stiffness=motion.closing_stiffness,
            support="table" if record.on_table else "fixed" if record.reserve is None else "none",
        )

    def as_carried(self, q: Array, poses: Array) -> Array:
        """Poses (s, 4, 4) of the object at joint positions (s, n), moved along with the carrier to its place at the
        first of them.
        """
        if not self.carrier:
            return poses
        model, frame = self.hand.model, self.hand.frame_id(self.carrier)
        data, where = model.createData(), np.empty((len(q), 4, 4))
        for i, one in enumerate(q):
            pin.forwardKinematics(model, data, one)
            where[i] = pin.updateFramePlacement(model, data, frame).homogeneous
        return np.asarray(where[0] @ np.linalg.inv(where) @ poses)

    def delay_commands(self, delay: Array) -> Task:
        """The same where each joint follows its commands so much later (n,) [s]; what waits for the hand waits for the
        last of them: t_I, t_F, and the end.
        """
        latest = float(delay.max(initial=0.0))
        if latest == 0.0:
            return self
        last, n = float(self.times[-1]), len(delay)
        every = [self.times + one for one in np.unique(delay)]
        times = np.unique(np.round(np.concatenate([[0.0], *every]), 9))  # a nanosecond apart at least
        sent = times[:, None] - delay
        until = np.clip(sent, 0.0, last)
        splines = [CubicHermiteSpline(self.times, q, dq) for q, dq in zip(self.q.T, self.dq.T)]
        moving = (sent >= 0.0) & (sent < last)
        return replace(
            self,
            times=times,
            q=np.column_stack([splines[j](until[:, j]) for j in range(n)]),
            dq=np.where(moving, np.column_stack([splines[j](until[:, j], 1) for j in range(n)]), 0.0),
            torques=np.column_stack([np.interp(until[:, j], self.times, self.torques[:, j]) for j in range(n)]),
            impact_time=self.impact_time + latest,
            final_time=float(times[-1]) - self.way,
        )

    @property
    def way(self) -> float:
        """How long the commands go on after the object is let go [s]."""
        return float(self.times[-1]) - self.final_time

    def command_at(self, times: Array) -> Array:
        """Positions that the joints are sent (s, n) [rad or m]."""
        return np.column_stack([np.interp(times, self.times, column) for column in self.q.T])

    def joint_of(self, link: str) -> int:
        """Pinocchio's index of the joint that carries a link (0: the palm)."""
        return int(self.hand.model.frames[self.hand.frame_id(link)].parentJoint)
