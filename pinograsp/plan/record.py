"""A grasp plan as data: what hand-over, simulation, pictures, reports and files are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from pinograsp.checks import brief, read_only
from pinograsp.errors import InvalidInput, Status
from pinograsp.hands.model import HandModel
from pinograsp.objects.body import Body
from pinograsp.plan.link_contacts import LinkContacts
from pinograsp.plan.motion import Motion
from pinograsp.plan.parts import (
    INFINITE,
    Balance,
    ComparisonRow,
    ContactLaw,
    Layout,
    Measure,
    PlanContacts,
    PlanForces,
    PlanFriction,
    PlanMargins,
    PlanReserve,
    Reach,
)
from pinograsp.plan.plain_fields import Plain, by_contact, plain_fields
from pinograsp.plan.tolerance import PoseTolerance
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array, inverse_of
from pinograsp.words import by_name, format_number, lines_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanRecord:
    """A grasp: contact forces, and the joint motion and torques that produce them.

    Attributes:
        layout: names of the hand's parts.
        hand: the hand, as it was placed; None if the record was read without it.
        body: the held object; None if it is not known.
        contacts: the contact points and frames.
        friction: the friction of the plan.
        law: the contact law.
        load: external wrench on the object about its centre of mass, weight included (6,) [N, N m].
        gravity_o: (3,) [m/s^2].
        body_mass: mass of the object whose weight is in the load [kg]; 0: not known.
        balance: ``"wrench"`` (forces and moments) or ``"force"``.
        measure: grasp energy that was minimised, ``"impulse"`` or ``"work"``.
        on_table: whether the plan is for an object that stands on a table.
        torque_limit: largest |torque| (n,) [N m or N]; infinity: none.
        forces: contact forces at t_F, and how they build up.
        motion: trajectory and torques.
        reserve: what the forces withstand by plan besides the load; None: the load alone.
        margins: what the grasp withstands besides its load; None: not computed.
        reach: the same by direction; None: not computed.
        tolerance: how far the object may be from its planned place; None: not computed.
        cautions: what the plan's promise does not cover, in words; read them before you simulate or execute the plan.
        notes: further remarks.
        closing: how the hand was closed, as plain values; None: the contacts were given.
        comparison: published figures beside ours.
        elapsed: seconds per stage, ``{"closing": ..., "forces": ..., "motion": ...}``.
        settings: the case that made it, as plain values; empty for a plan made from Python.
        versions: packages and their versions.
    """

    layout: Layout
    hand: HandModel | None
    body: Body | None
    contacts: PlanContacts
    friction: PlanFriction
    law: ContactLaw
    load: Annotated[Array, "6"]
    gravity_o: Annotated[Array, "3"]
    body_mass: float
    balance: Balance
    measure: Measure
    torque_limit: Annotated[Array, "n", INFINITE]
    forces: PlanForces
    motion: Motion
    on_table: bool = False
    reserve: PlanReserve | None = None
    margins: PlanMargins | None = None
    reach: Reach | None = None
    tolerance: PoseTolerance | None = None
    cautions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    closing: Mapping[str, Any] | None = None
    comparison: tuple[ComparisonRow, ...] = ()
    elapsed: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    __repr__ = brief("status", "name", "hand", "contacts", "forces", "motion", "elapsed")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        return self.describe()

    def describe(self) -> str:
        """Status, normal forces, timing, peak efforts, robustness, warnings and notes, as readable text."""
        names, forces = self.contacts.names, self.forces
        said = f"{self.name}: {self.status}"
        held = (
            ""
            if self.margins is None
            else f"withstands {self.margins.disturbance_force:.3g} N in any direction besides the load"
        )
        return lines_of(
            f"{said}: {self.remedy}" if self.remedy else said,
            f"normal forces: {by_name(names, forces.normal_forces.tolist(), 'N')}",
            f"impact at {forces.impact_time:g} s, complete at {forces.final_time:g} s; peak joint effort "
            f"{self.peak_efforts()}; residual {forces.residual_force:.1e} N, {forces.residual_moment:.1e} N m",
            held,
            "" if self.tolerance is None else f"the object is held {self.tolerance.describe()}",
            *(f"warning: {one}" for one in self.cautions),
            *(f"note: {one}" for one in self.notes),
        )

    def peak_efforts(self) -> str:
        """The largest torque over the motion, and the largest force of sliding joints, in words with their units."""
        largest = np.abs(self.motion.torques).max(axis=0)
        if self.hand is None:  # which joints slide is not known
            return f"{format_number(float(largest.max()), 3)} N m (N where it slides)"
        slides = self.hand.slides
        kinds = ((largest[~slides], "N m"), (largest[slides], "N"))
        return " and ".join(f"{format_number(float(values.max()), 3)} {unit}" for values, unit in kinds if values.size)

    @property
    def name(self) -> str:
        """The case's name, or the hand's."""
        return str(self.settings.get("name") or self.layout.hand)

    @property
    def status(self) -> Status:
        """``OK``, or the status of the first stage that is not."""
        return self.forces.status if self.forces.status is not Status.OK else self.motion.status

    @property
    def remedy(self) -> str:
        """The cause of a status other than ``OK``, and what to do about it; empty for ``OK``."""
        own = self.motion.remedy if self.forces.status is Status.OK else ""
        return own or self.status.remedy

    @property
    def residual_force_o(self) -> Array:
        """Residual force of contact forces and load, over the motion's times (m, 3) [N]."""
        left: Array = self.motion.forces_o.sum(axis=1) + self.load[:3]
        return left

    @property
    def weight(self) -> float:
        """Weight of the object [N]; 0: not known."""
        return self.body_mass * float(np.linalg.norm(self.gravity_o))

    @property
    def hand_in_object(self) -> Array | None:
        """bMh (4, 4): the hand's root frame in the object's, that of its file [m].

        This is where a robot has to bring the hand. None if the record lacks one of the two.
        """
        if self.hand is None or self.body is None:
            return None
        return np.asarray(inverse_of(self.body.pose) @ self.hand.pose)

    def require_hand(self) -> HandModel:
        """Return the hand, or raise :class:`InvalidInput` if the record has none."""
        if self.hand is None:
            raise InvalidInput(
                "expected a plan with its hand, got one that did not keep it: load it from its description, "
                "pinograsp.load_hand"
            )
        return self.hand

    @property
    def contacts_on_links(self) -> LinkContacts | None:
        """Where on its links the hand touches, and how hard; None if the record lacks the hand, or the contacts were
        made without one.
        """
        hand, contacts, motion = self.hand, self.contacts, self.motion
        if hand is None or not contacts.links or not all(contacts.links):
            return None
        # At the impact: afterwards the rigid links of the model go on by the depth to which the contacts give way.
        links_o = hand.frame_placements(motion.q[motion.impact], contacts.links)
        to_link = links_o[:, :3, :3].swapaxes(1, 2)
        return LinkContacts(
            names=contacts.names,
            links=contacts.links,
            points_l=read_only(np.einsum("kij,kj->ki", to_link, contacts.points_o - links_o[:, :3, 3])),
            normals_l=read_only(np.einsum("kij,kj->ki", to_link, contacts.rotations_oc[:, :, 2])),
            normal_forces=read_only(self.forces.normal_forces),
        )

    def require_margins(self) -> PlanMargins:
        """Return the margins, or raise :class:`InvalidInput` if they were not computed."""
        if self.margins is None:
            raise InvalidInput("expected a plan with its margins, got one without: plan.with_margins()")
        return self.margins

    def torque_maxima(self) -> dict[str, dict[str, Array]]:
        """Largest |torque| per joint [N m or N], ``{finger: {"approach": (n_f,), "grasp": (n_f,)}}``."""
        torques, impact = np.abs(self.motion.torques), self.motion.impact
        return {
            finger: {
                "approach": torques[: impact + 1, list(dofs)].max(axis=0),
                "grasp": torques[impact:, list(dofs)].max(axis=0),
            }
            for finger, dofs in self.layout.fingers.items()
        }

    def summary(self) -> Plain:
        """The plan's figures as plain JSON values, units in the names."""
        forces, motion, names = self.forces, self.motion, self.contacts.names
        certificate, grid = forces.certificate, forces.grid
        return {
            "status": str(self.status),
            "remedy": self.remedy,
            "search": forces.search,
            "solver": forces.solver or "none",
            "balance": self.balance,
            "measure": self.measure,
            "friction": self.friction.summary(),
            "reserve": None if self.reserve is None else self.reserve.summary(),
            "impact_time_s": forces.impact_time,
            "final_time_s": forces.final_time,
            "normal_forces_N": by_contact(names, forces.normal_forces),
            "multipliers": by_contact(names, forces.multipliers),
            "contact_forces_N": by_contact(names, forces.forces_c),
            "torsion_Nm": by_contact(names, forces.torsion) if self.friction.torsion else {},
            "accelerations_m_s2": by_contact(names, forces.acceleration),
            "work_J": forces.work,
            "impulse_Ns": forces.impulse,
            "residual_N": forces.residual_force,
            "residual_Nm": forces.residual_moment,
            "max_penetration_m": float(forces.final_depths.max()),
            "joint_torque_max_Nm": {
                finger: {phase: values.tolist() for phase, values in phases.items()}
                for finger, phases in self.torque_maxima().items()
            },
            "peak_torque_Nm": motion.peak_torque,
            "closing_stiffness_Nm_rad": None if motion.closing_stiffness is None else motion.closing_stiffness.tolist(),
            "tracking_error_m": by_contact(names, motion.tracking_error),
            "postures_tried": dict(motion.postures),
            "forces_status": str(forces.status),
            "motion": {"status": str(motion.status), "remedy": motion.remedy, "notes": list(motion.notes)},
            "grid": None if grid is None else grid.summary(),
            "certificate": None if certificate is None else certificate.summary(),
            "margins": None if self.margins is None else self.margins.summary(names),
            "tolerance": None if self.tolerance is None else self.tolerance.summary(),
            "closing": None if self.closing is None else dict(self.closing),
            "hand_in_object": None if (placed := self.hand_in_object) is None else placed.tolist(),
            "contacts_on_links": None if (places := self.contacts_on_links) is None else places.summary(),
            "comparison": [row.summary() for row in self.comparison],
            "cautions": list(self.cautions),
            "notes": list(self.notes),
            "elapsed_s": sum(self.elapsed.values()),
            "elapsed_by_stage_s": dict(self.elapsed),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proof:
    """Why no forces can hold the object: a direction in which every admissible force leaves some of the load.

    Attributes:
        margin: least residual along it [N].
        direction: in the balance rows (3,) or (6,), moments over the moment length.
        at_torque_limit: joints whose limits are part of the proof.
        residual: the least residual wrench (6,) [N, N m].
    """

    margin: float
    direction: Annotated[Array, "w"]
    at_torque_limit: tuple[str, ...]
    residual: Annotated[Array, "6"]

    __repr__ = brief()

    def summary(self) -> Plain:
        """As plain JSON values."""
        return plain_fields(self, margin="margin_N")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanFailure:
    """The diagnosis of a search that found no grasp, stored like a plan.

    Attributes:
        status: of the search.
        search: its name.
        message: the diagnosis, in words.
        proof: None if nothing is proven.
        hand: its name.
        contacts: names.
        settings: the case, as plain values.
        versions: packages and their versions.
    """

    status: Status
    search: str
    message: str
    proof: Proof | None
    hand: str
    contacts: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    __repr__ = brief("status", "name", "search", "message")

    def __str__(self) -> str:
        return self.describe()

    def describe(self) -> str:
        """Status and reason, as readable text."""
        return lines_of(f"{self.name}: {self.status}", self.message)

    @property
    def name(self) -> str:
        """The case's name, or the hand's."""
        return str(self.settings.get("name") or self.hand)

    def summary(self) -> Plain:
        """As plain JSON values."""
        proof = {} if self.proof is None else {"proof": self.proof.summary()}
        return {"status": str(self.status), "search": self.search, "message": self.message, **proof}
