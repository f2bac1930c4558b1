"""A certified grasp as the referee tries it: the hand closes to where it touches, presses, and the object is let go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.optimize import lsq_linear

from pinograsp.certification.record import Certificates
from pinograsp.checks import integer, read_only
from pinograsp.contacts import PALM, ContactSet
from pinograsp.contacts.penetration import Penetration
from pinograsp.errors import InvalidInput
from pinograsp.handover.quintic import between
from pinograsp.hands import HandModel
from pinograsp.motion import effort_of, torque_limits
from pinograsp.motion.jacobian import point_jacobians
from pinograsp.objects.body import Body
from pinograsp.referee.task import Task
from pinograsp.spatial import Array

_OPEN = 5e-3  # [m] of the surface that links start
_LEAST = 1e-2  # weight of a change of posture [rad] against depths in units of the lever
_GIVES = 1e-2  # ... of the hand's place likewise
_FURTHEST = 0.1  # [rad or m] that a joint moves in a step
_LEVER = 0.03  # [m] that a joint moves a contact for a turn of 1 rad
_ROUNDS = 5  # that bring links to their depths
_SAMPLES, _IMPACT, _FINAL = 101, 0.8, 1.0  # of the commands [s]


def trial_of(certificates: Certificates, i: int) -> Task:
    """Grasp i for :func:`~pinograsp.referee.simulate`: its own posture, forces and torques.

    The hand closes from 5 mm off the object to where the links of its contacts are as deep as the contact law asks for
    the forces, by a small change of posture, and sends the torques that hold them. What the joints cannot do, as jaws
    of one motor that are to close a gap on one side, the hand's place does: it is put where they meet the object.

    Raises:
        InvalidInput: no such grasp, or one without forces.
    """
    i = integer("grasp", i, at_least=0, at_most=len(certificates) - 1)
    count = int(certificates.counts[i])
    normal = certificates.normal_forces[i, :count]
    if not np.any(normal > 0):
        raise InvalidInput(f"grasp {i}: expected one with forces: {certificates.words(i)}")
    conditions, hand = certificates.conditions, certificates.hand.placed(certificates.roots[i])
    problem, q = certificates.problem(i), certificates.q[i]
    law, contacts = conditions.compliance, problem.contacts
    limit = effort_of(hand, conditions.torque_limit)
    joints = torque_limits(hand, contacts, q, limit=limit, gravity_o=conditions.gravity_o)
    depths = (normal / law.stiffness) ** (1.0 / law.exponent)
    body = certificates.object
    hand, pressed, rates = _closed(hand, body, contacts, certificates.gaps[i, :count], depths)
    away, still = np.full(count, -_OPEN), np.zeros((count, 6))
    opened = pressed + _step(rates, still, away, np.zeros(hand.n), hand.lower - pressed, hand.upper - pressed)[0]
    times = np.linspace(0.0, _FINAL, _SAMPLES)
    resting = np.zeros((2, hand.n))
    path, speed, _ = between(np.array([0.0, _FINAL]), [np.array([opened, pressed]), resting, resting], times)
    own_weight, zero = joints.bias, np.zeros((2, 1))
    way, _, _ = between(np.array([0.0, _FINAL]), [np.array([[0.0], [1.0]]), zero, zero], times)
    torques = own_weight + way * (certificates.torques[i] - own_weight)
    return Task(
        hand=hand,
        body=body,
        times=read_only(times),
        q=read_only(path),
        dq=read_only(speed),
        torques=read_only(torques),
        holding_torques=read_only(certificates.torques[i]),
        torque_limit=joints.limit,
        impact_time=_IMPACT,
        final_time=_FINAL,
        names=tuple(contacts.names),
        links=tuple(contact.link for contact in contacts),
        points_o=read_only(certificates.points_o[i, :count]),
        forces_o=read_only(certificates.forces_o[i, :count]),
        normal_forces=read_only(normal),
        settled_forces=read_only(normal),
        depths=read_only(depths),
        mu=problem.mu,
        torsion=problem.friction.torsion,
        law=(law.stiffness, law.damping, law.exponent),
        load=read_only(np.zeros(6)),
        gravity_o=conditions.gravity_o,
    )


def _closed(
    hand: HandModel, body: Body, contacts: ContactSet, gaps: Array, depths: Array
) -> tuple[HandModel, Array, Array]:
    """The hand closed so far that the links of k contacts are ``depths`` (k,) deep [m], by Gauss and Newton.

    Args:
        hand: where it is at first.
        body: what it closes on.
        contacts: with the posture of the hand.
        gaps: of their links (k,) [m].
        depths: (k,) [m].

    Returns:
        The hand where it is then, its posture (n,), and how joints bring the contacts closer there (k, n).
    """
    known = q = np.array(contacts.posture)
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, q)
    joints = [0 if one.finger == PALM else hand.finger(one.finger).joint_of(one.link) for one in contacts]
    # Points of the links, as far from the surface as these are.
    points = [one.point_o - gap * one.normal_o for one, gap in zip(contacts, gaps)]
    own = [replace(one, point_l=read_only(data.oMi[j].actInv(p))) for one, j, p in zip(contacts, joints, points)]
    of_links = replace(contacts, contacts=tuple(own))
    for _ in range(_ROUNDS):
        now, normals, on_object = Penetration(hand, body, of_links).at(q)
        data = hand.model.createData()
        pin.computeJointJacobians(hand.model, data, q)
        rates = np.einsum("kx,kxn->kn", normals, point_jacobians(hand.model, data, joints, on_object)[:, :3])
        shifts = -np.column_stack([normals, np.cross(on_object - body.com_o, normals)])
        step, shift = _step(rates, shifts, depths - now, known - q, hand.lower - q, hand.upper - q)
        q = q + step
        # The hand moves, not the object: contact points and forces stay where they are.
        turned = pin.exp3(shift[3:])
        moved = pin.SE3(turned, body.com_o + shift[:3] - turned @ body.com_o)
        hand = hand.placed(moved.inverse().homogeneous @ hand.pose)
    return hand, q, rates


def _step(rates: Array, shifts: Array, deeper: Array, back: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """A step of joints (n,) and of the object (6,), a twist about its centre of mass, to contacts ``deeper`` (k,) [m].

    ``back`` (n,): the way to the posture that is known; ``lower``, ``upper`` (n,): as far as the joints' limits.
    """
    n = len(back)
    least = np.diag(np.concatenate([np.full(n, _LEAST), np.repeat([_GIVES / _LEVER, _GIVES], 3)]))
    A = np.vstack([np.hstack([rates, shifts]) / _LEVER, least])
    b = np.concatenate([deeper / _LEVER, _LEAST * back, np.zeros(6)])
    low = np.concatenate([np.clip(lower, -_FURTHEST, 0.0), np.full(6, -np.inf)])
    high = np.concatenate([np.clip(upper, 1e-12, _FURTHEST), np.full(6, np.inf)])
    step = lsq_linear(A, b, bounds=(low, high), method="bvls").x
    return step[:n], step[n:]
