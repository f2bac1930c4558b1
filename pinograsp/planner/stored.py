"""The force problem and its solution, from what is stored of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinograsp.contacts import Compliance, Contact, ContactSet, Friction
from pinograsp.contacts.clearance import PALM
from pinograsp.forces import ForceProblem, ForceSolution, GraspConditions
from pinograsp.forces.reserve import LEAST_FORCE
from pinograsp.hands import HandModel
from pinograsp.motion import torque_limits
from pinograsp.motion.torques import torques_matter
from pinograsp.plan import PlanRecord


def stored_solution(hand: HandModel, plan: PlanRecord) -> ForceSolution:
    """The forces of a plan with a problem that they solve.

    With the plan's torque limits, the share of them that is kept free, and its least forces. Caps of the normal forces
    are not stored: contacts may become as deep as anywhere, or as the plan's deepest.
    """
    own, law, friction, forces = plan.contacts, plan.law, plan.friction, plan.forces
    contacts = ContactSet(
        contacts=tuple(
            Contact(
                finger=_finger_of(hand, name, link),
                link=link,
                point_o=point,
                rotation_oc=R,
                length=None,
                distance=0.0,
            )
            for name, link, point, R in zip(own.names, own.links, own.points_o, own.rotations_oc)
        ),
        com_o=own.com_o,
    )
    torques, limit, reserve = None, np.array(plan.torque_limit), plan.reserve
    if torques_matter(hand, limit):
        q, kept = np.array(plan.motion.q[-1]), 0.0 if reserve is None else reserve.torque
        torques = torque_limits(hand, contacts, q, depth=forces.final_depths, limit=limit, gravity_o=plan.gravity_o)
        torques = replace(torques, headroom=kept)
    problem = ForceProblem(
        contacts=contacts,
        load=plan.load,
        mu=friction.mu,
        compliance=Compliance(stiffness=law.stiffness, damping=law.damping, exponent=law.exponent),
        friction=Friction(
            model=friction.model, edges=friction.edges or 4, torsion=friction.torsion, safety=friction.safety
        ),
        balance=plan.balance,
        final_time=forces.final_time,
        max_depth=max(GraspConditions(mu=1.0).max_depth, float(forces.final_depths.max())),
        gravity_o=plan.gravity_o,
        object=plan.body,
        torques=torques,
        min_normal_force=max(reserve.normal_force, LEAST_FORCE)
        if reserve is not None and reserve.normal_force > 0
        else None,
    )
    return ForceSolution(
        status=forces.status,
        problem=problem,
        search=forces.search,
        backend=forces.backend,
        impact_time=forces.impact_time,
        forces_c=forces.forces_c,
        elapsed=0.0,
        torsion=forces.torsion,
    )


def _finger_of(hand: HandModel, name: str, link: str) -> str:
    """Of a stored contact: the finger that its name begins with, among those that have the link."""
    own = [finger.name for finger in hand.fingers if link in finger.links]
    return next((finger for finger in own if name.split("/")[0].startswith(finger)), own[0] if own else PALM)
