"""A plan's document and arrays, and the record that they are of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pinograsp.checks import are_rotations, read_only
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.hands.record import hand_of
from pinograsp.objects.record import object_of
from pinograsp.plan import (
    ComparisonRow,
    ContactLaw,
    Layout,
    Motion,
    PlanCertificate,
    PlanContacts,
    PlanFailure,
    PlanForces,
    PlanFriction,
    PlanGrid,
    PlanMargins,
    PlanRecord,
    PlanReserve,
    Proof,
    Reach,
    StiffnessBand,
)
from pinograsp.spatial import Array
from pinograsp.storage.arrays import Arrays, expect, sizes_of, texts_of
from pinograsp.storage.documents import BandPart, FailureDocument, MarginsPart, PlanDocument, ReservePart, checked

_DOCUMENT, _ARRAYS = "plan.json", "plan.npz"
# Shapes by what counts: m samples, n joints, k contacts, any number b, d.
_PLAN = {
    "times": "m",
    "q": "mn",
    "dq": "mn",
    "ddq": "mn",
    "torques": "mn",
    "holding_torques": "n",
    "settled_forces": "k",
    "torque_limit": "n",
    "forces_o": "mk3",
    "contact_velocities": "mk3",
    "slip": "k",
    "depth": "mk",
    "rate": "mk",
    "normal_forces": "mk",
    "points_o": "k3",
    "rotations_oc": "k33",
    "com_o": "3",
    "load": "6",
    "gravity": "3",
    "object_mass": "",
    "mu": "k",
    "torsion_length": "",
    "contact_law": "3",
    "branches": "b4",
    "margin_directions": "3d3",
    "margin_forces": "3d",
}
_BY_CONTACT = (
    "normal_forces_N",
    "multipliers",
    "contact_forces_N",
    "torsion_Nm",
    "accelerations_m_s2",
    "tracking_error_m",
    "friction_used",
    "least_mu",
    "slip_distance_N",
)


def failure_of(document: dict[str, Any], arrays: Arrays) -> PlanFailure:
    """The failure that a run's files hold; :class:`InvalidInput` where they hold anything else."""
    found = checked(FailureDocument, document, _DOCUMENT)
    if arrays:
        raise InvalidInput(f"{_ARRAYS}: expected no arrays for a search without a plan")
    proof = None
    if found.proof is not None:
        proof = Proof(
            margin=found.proof.margin_N,
            direction=_array(found.proof.direction),
            at_torque_limit=tuple(found.proof.at_torque_limit),
            residual=_array(found.proof.residual),
        )
    return PlanFailure(
        status=found.status,
        search=found.search,
        message=found.message,
        proof=proof,
        hand=found.layout.hand,
        contacts=tuple(found.layout.contacts),
        settings=document["settings"],
        versions=found.versions,
    )


def plan_of(document: dict[str, Any], arrays: Arrays, scene: dict[str, Any] | None) -> PlanRecord:
    """The plan that a run's files hold: every field checked, and whether they fit each other.

    ``scene``: hand and object as plain values; None: the plan is wanted without them.

    Raises:
        InvalidInput: what does not fit first. HandNotLoaded: mesh files that are missing.
    """
    found = checked(PlanDocument, document, _DOCUMENT)
    _check_document(found)
    layout = Layout(
        hand=found.layout.hand,
        joints=tuple(found.layout.joints),
        fingers={finger: tuple(dofs) for finger, dofs in found.layout.fingers.items()},
    )
    sizes = sizes_of(_ARRAYS, arrays, _PLAN, {"n": len(layout.joints), "k": len(found.layout.contacts)})
    _check_arrays(found, arrays, sizes)
    contacts = _contacts(found, arrays)
    hand = body = None
    if scene is not None and scene.get("hand") is not None:
        hand = _hand(scene["hand"], layout, contacts)
    if scene is not None and scene.get("object") is not None:
        body = object_of(scene["object"])
    stiffness, damping, exponent = arrays["contact_law"].tolist()
    plan = PlanRecord(
        layout=layout,
        hand=hand,
        body=body,
        contacts=contacts,
        friction=PlanFriction(
            mu=arrays["mu"],
            model=found.friction.model,
            edges=found.friction.edges,
            safety=found.friction.safety,
            torsion=float(arrays["torsion_length"]),
        ),
        law=ContactLaw(stiffness=stiffness, damping=damping, exponent=exponent),
        load=arrays["load"],
        gravity_o=arrays["gravity"],
        body_mass=float(arrays["object_mass"]),
        balance=found.balance,
        measure=found.measure,
        torque_limit=arrays["torque_limit"],
        forces=_forces(found, arrays),
        reserve=_reserve(found.reserve),
        motion=_motion(found, arrays),
        margins=_margins(found.margins),
        reach=Reach(directions=arrays["margin_directions"], forces=arrays["margin_forces"]),
        cautions=tuple(found.cautions),
        notes=tuple(found.notes),
        closing=found.closing,
        comparison=tuple(ComparisonRow(**row.model_dump()) for row in found.comparison),
        elapsed=found.elapsed_by_stage_s,
        settings=document["settings"],
        versions=found.versions,
    )
    expect(_DOCUMENT, "status", "that of the forces, or of the motion", plan.status is found.status)
    return plan


def _check_document(found: PlanDocument) -> None:
    """Whether a plan's document speaks of the same contacts, joints and friction throughout."""
    file, names, n = _DOCUMENT, found.layout.contacts, len(found.layout.joints)
    for kind, words in (("joints", found.layout.joints), ("contacts", names)):
        expect(file, f"layout.{kind}", "names, each once", len(set(words)) == len(words))
    for finger, dofs in found.layout.fingers.items():
        good = all(0 <= dof < n for dof in dofs) and len(set(dofs)) == len(dofs)
        expect(file, f"layout.fingers.{finger}", f"numbers from 0 to {n - 1}, each once", good and len(dofs) > 0)
    listed = f"the contacts {', '.join(names)}"
    for name in _BY_CONTACT:
        part = found.margins if name in MarginsPart.model_fields else found
        values = getattr(part, name)
        may_be_empty = name in ("multipliers", "torsion_Nm") and not values
        expect(file, name, listed, may_be_empty or list(values) == names)
    if (band := found.margins.band) is not None:
        same = list(band.normal_forces_N) == names
        expect(file, "band.normal_forces_N", listed, same)
        many = {len(band.factors), len(band.remarks), *(len(own) for own in band.normal_forces_N.values())}
        expect(file, "band", f"{len(band.factors)} values each", len(many) == 1 and bool(band.factors))
    along_normals = [force[2] for force in found.contact_forces_N.values()]
    same = list(found.normal_forces_N.values()) == along_normals
    expect(file, "normal_forces_N", "the third components of contact_forces_N", same)
    friction = found.friction
    expect(file, "friction.mu", f"{len(names)} numbers", len(friction.mu) == len(names))
    is_pyramid = friction.model == "pyramid"
    expect(file, "friction.edges", "a number for a pyramid alone", (friction.edges is not None) == is_pyramid)
    expect(file, "friction.torsion_m", "above 0 for soft fingers", friction.model != "soft" or friction.torsion_m > 0)
    has_torsion = bool(found.torsion_Nm) or friction.torsion_m == 0
    expect(file, "torsion_Nm", "the contacts' where torsion_m is above 0", has_torsion)
    either = (found.certificate is None) != (found.grid is None)
    expect(file, "certificate, grid", "one of the two", either)


def _check_arrays(found: PlanDocument, arrays: Arrays, sizes: dict[str, int]) -> None:
    """Whether a plan's arrays fit each other, and its document."""
    file, times, impact = _ARRAYS, arrays["times"], arrays.get("impact")
    rising = sizes["m"] >= 3 and times[0] >= 0 and bool(np.all(np.diff(times) > 0))
    expect(file, "times", "at least three, from 0 s on, each later than the one before", rising)
    within = (
        impact is not None and impact.shape == () and impact.dtype.kind in "iu" and 0 < int(impact) < sizes["m"] - 1
    )
    expect(file, "impact", "the number of a sample between the first and the last", within)
    same = np.allclose(
        (found.impact_time_s, found.final_time_s), (times[int(arrays["impact"])], times[-1]), rtol=1e-6, atol=0
    )
    expect(_DOCUMENT, "impact_time_s, final_time_s", "the times of the arrays' impact and end", same)
    for name in ("mu", "torque_limit", "object_mass", "torsion_length"):
        expect(file, name, "numbers from 0 on", bool(np.all(arrays[name] >= 0)))
    same = np.array_equal([*found.friction.mu, found.friction.torsion_m], [*arrays["mu"], arrays["torsion_length"]])
    expect(_DOCUMENT, "friction.mu, friction.torsion_m", "those of the arrays", same)
    stiffness, damping, exponent = arrays["contact_law"]
    wanted = "a stiffness above 0, a damping from 0 on, an exponent above 0 and up to 100"
    expect(file, "contact_law", wanted, stiffness > 0 and damping >= 0 and 0 < exponent <= 100)
    expect(file, "rotations_oc", "rotations", bool(are_rotations(arrays["rotations_oc"]).all()))
    certified = found.certificate is not None or len(arrays["branches"]) == 0
    expect(file, "branches", "none without a certificate", certified)


def _contacts(found: PlanDocument, arrays: Arrays) -> PlanContacts:
    names = tuple(found.layout.contacts)
    kept = texts_of(_ARRAYS, arrays, "contact_names", len(names))
    expect(_ARRAYS, "contact_names", f"the contacts {', '.join(names)}", kept == names)
    return PlanContacts(
        names=names,
        links=texts_of(_ARRAYS, arrays, "contact_links", len(names)),
        points_o=arrays["points_o"],
        rotations_oc=arrays["rotations_oc"],
        com_o=arrays["com_o"],
    )


def _hand(record: Any, layout: Layout, contacts: PlanContacts) -> HandModel:
    """The hand of the plan; its meshes are read from their files."""
    hand = hand_of(record)
    fingers = {finger.name: tuple(finger.dofs.tolist()) for finger in hand.fingers}
    if hand.joint_names != layout.joints or fingers != dict(layout.fingers):
        raise InvalidInput(
            "scene.json: expected the hand of the plan, got one with other joints or fingers: plan it again"
        )
    for link in contacts.links:
        if link and not hand.model.existFrame(link):
            raise InvalidInput(f"scene.json: expected contacts of the hand, it has no link '{link}': plan it again")
    return hand


def _forces(found: PlanDocument, arrays: Arrays) -> PlanForces:
    k = len(found.layout.contacts)
    certificate = grid = None
    if found.certificate is not None:
        kept = found.certificate
        certificate = PlanCertificate(
            weights=kept.weights,
            objective=kept.objective,
            lower_bound=kept.lower_bound,
            relative_gap=kept.relative_gap,
            violation=kept.violation_N,
            active=tuple(kept.active),
            branches=arrays["branches"],
        )
    if found.grid is not None:
        grid = PlanGrid(**found.grid.model_dump())
    return PlanForces(
        status=found.forces_status,
        search=found.search,
        backend="" if found.solver == "none" else found.solver,
        impact_time=found.impact_time_s,
        final_time=found.final_time_s,
        forces_c=_rows(found.contact_forces_N, 3),
        multipliers=_rows(found.multipliers, 2),
        torsion=_array(list(found.torsion_Nm.values()) or np.zeros(k)),
        acceleration=_array(list(found.accelerations_m_s2.values())),
        work=found.work_J,
        impulse=found.impulse_Ns,
        residual_force=found.residual_N,
        residual_moment=found.residual_Nm,
        depths=arrays["depth"],
        rates=arrays["rate"],
        normal_history=arrays["normal_forces"],
        certificate=certificate,
        grid=grid,
    )


def _array(values: Sequence[float] | Sequence[Sequence[float]] | Array) -> Array:
    return read_only(np.array(values, dtype=float))


def _rows(values: dict[str, list[float]], width: int) -> Array:
    return read_only(np.array(list(values.values()), dtype=float).reshape(-1, width))


def _motion(found: PlanDocument, arrays: Arrays) -> Motion:
    return Motion(
        status=found.motion.status,
        notes=tuple(found.motion.notes),
        times=arrays["times"],
        impact=int(arrays["impact"]),
        q=arrays["q"],
        dq=arrays["dq"],
        ddq=arrays["ddq"],
        torques=arrays["torques"],
        holding_torques=arrays["holding_torques"],
        settled_forces=arrays["settled_forces"],
        forces_o=arrays["forces_o"],
        contact_velocities=arrays["contact_velocities"],
        tracking_error=_array(list(found.tracking_error_m.values())),
        slip=arrays["slip"],
        postures=found.postures_tried,
        peak_torque=found.peak_torque_Nm,
        remedy=found.motion.remedy,
    )


def _reserve(kept: ReservePart | None) -> PlanReserve | None:
    if kept is None:
        return None
    return PlanReserve(
        disturbance=kept.disturbance,
        force=kept.force_N,
        moment=kept.moment_Nm,
        mass=kept.mass,
        friction=kept.friction,
        normal_force=kept.normal_force_N,
        torque=kept.torque,
        loads=kept.loads,
        impact_times=kept.impact_times,
        above_unrestricted=kept.above_unrestricted,
        softer=kept.softer,
        stiffer=kept.stiffer,
    )


def _margins(kept: MarginsPart) -> PlanMargins:
    shares = [np.inf if share is None else share for share in kept.friction_used.values()]
    return PlanMargins(
        friction_used=_array(shares),
        least_mu=_array(list(kept.least_mu.values())),
        slip_distance=_array(list(kept.slip_distance_N.values())),
        load_factor=np.inf if kept.load_factor is None else kept.load_factor,
        disturbance=kept.disturbance_any_N,
        weakest_direction=_array(kept.weakest_direction),
        disturbance_force=kept.disturbance_force_N,
        disturbance_moment=kept.disturbance_moment_Nm,
        force_closure=kept.force_closure,
        ferrari_canny=kept.ferrari_canny_L1,
        min_singular_value=kept.min_singular_value,
        isotropy=kept.isotropy,
        stiffness=_array(kept.stiffness_N_m),
        band=None if kept.band is None else _band(kept.band),
    )


def _band(kept: BandPart) -> StiffnessBand:
    return StiffnessBand(
        servos=kept.servos,
        factors=_array(kept.factors),
        normal_forces=_array(list(kept.normal_forces_N.values())).T,
        remarks=tuple(kept.remarks),
    )
