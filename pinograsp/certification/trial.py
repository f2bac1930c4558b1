"""A certified grasp as simulated: the hand closes to where it touches, presses, and the object is let go."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.optimize import lsq_linear

from pinograsp.certification.record import Certificates
from pinograsp.checks import instance_of, integer, read_only
from pinograsp.errors import InvalidInput
from pinograsp.handover.quintic import between
from pinograsp.motion import effort_of, torque_limits
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array, cross

_OPEN = 5e-3  # [m] of the surface that links start
_LEAST = 1e-2  # weight of a change of posture [rad] against depths in units of the lever
_GIVES = 1e-2  # ... of the object's place likewise
_LEVER = 0.03  # [m] that a joint moves a contact for a turn of 1 rad
_SAMPLES, _IMPACT, _FINAL = 101, 0.8, 1.0  # of the commands [s]


def make_trial(certificates: Certificates, i: int) -> Task:
    """Make a trial of grasp i for :func:`~pinograsp.simulation.simulate`, with its own posture, forces and torques.

    The hand closes from 5 mm away to the depths that the contact law needs for the forces, by the least change of
    posture, and commands the torques that hold them. If the joints cannot do this, such as jaws of one motor with a gap
    on one side, the object is moved to where they meet it.

    Raises:
        InvalidInput: no such grasp, or one without forces.
    """
    instance_of("certificates", certificates, Certificates)
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
    normals = certificates.normals_o[i, :count]
    rates = np.einsum("kx,kxn->kn", normals, joints.jacobian[:, :3])
    depths = law.depth(np.maximum(normal, 0.0))
    body = certificates.object
    arms = certificates.points_o[i, :count] - body.com_o
    shifts = -np.column_stack([normals, cross(arms, normals)])
    deeper = certificates.gaps[i, :count] + depths
    pressed, shift = _moved_by(rates, shifts, deeper, q, hand.lower, hand.upper)
    opened, _ = _moved_by(rates, shifts * 0.0, np.full(count, -_OPEN), pressed, hand.lower, hand.upper)
    times = np.linspace(0.0, _FINAL, _SAMPLES)
    resting = np.zeros((2, hand.n))
    path, speed, _ = between(np.array([0.0, _FINAL]), [np.array([opened, pressed]), resting, resting], times)
    own_weight, zero = joints.bias, np.zeros((2, 1))
    way, _, _ = between(np.array([0.0, _FINAL]), [np.array([[0.0], [1.0]]), zero, zero], times)
    torques = own_weight + way * (certificates.torques[i] - own_weight)
    return Task(
        hand=hand,
        body=body.moved(shift[:3], pin.exp3(shift[3:])),
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
        rotations_oc=contacts.rotations_oc,
        com_o=body.com_o,
        forces_o=read_only(certificates.forces_o[i, :count]),
        normal_forces=read_only(normal),
        settled_forces=read_only(normal),
        depths=read_only(depths),
        mu=problem.mu,
        torsion=problem.friction.torsion,
        law=law.numbers(conditions.max_depth),
        load=read_only(np.zeros(6)),
        gravity_o=conditions.gravity_o,
    )


def _moved_by(rates: Array, shifts: Array, depths: Array, q: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """The posture nearest to q (n,), within the limits, at which the contacts are deeper by ``depths`` (k,) [m].

    Where the joints alone cannot do it, the object gives way: its twist (6,) about its centre of mass [m, rad].
    """
    n = len(q)
    least = np.diag(np.concatenate([np.full(n, _LEAST), np.repeat([_GIVES / _LEVER, _GIVES], 3)]))
    A = np.vstack([np.hstack([rates, shifts]) / _LEVER, least])
    b = np.concatenate([depths / _LEVER, np.zeros(n + 6)])
    low = np.concatenate([np.minimum(lower - q, 0.0), np.full(6, -np.inf)])
    high = np.concatenate([np.maximum(upper - q, 1e-12), np.full(6, np.inf)])
    step = lsq_linear(A, b, bounds=(low, high), method="bvls").x
    return q + step[:n], step[n:]
