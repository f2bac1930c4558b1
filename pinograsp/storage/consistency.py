"""Whether the parts of a record that was read fit each other, beyond types and sizes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pinograsp.checks import are_rotations
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanRecord, Simulation

ENERGIES = ("joint_work", "load_work", "mechanical", "elastic", "damped", "slipped", "normal_work")


def check_plan(plan: PlanRecord) -> None:
    """:class:`InvalidInput` with the first part that does not fit the others."""
    _check_names(plan)
    _check_times(plan)
    _check_physics(plan)
    check_settings(plan.settings)
    forces, margins, k = plan.forces, plan.require_margins(), len(plan.contacts.names)
    either = (forces.certificate is None) != (forces.grid is None)
    _expect("forces.certificate, forces.grid", "one of the two", either)
    _expect("forces.multipliers", "those of all contacts, or none", len(forces.multipliers) in (0, k))
    _expect("margins.weakest_direction", "3 or 6 numbers", len(margins.weakest_direction) in (3, 6))
    _expect("margins.band", "a factor at least", margins.band is None or len(margins.band.factors) > 0)


def check_settings(settings: Mapping[str, Any]) -> None:
    """Whether the name of a case and what it assumed are texts."""
    _expect("settings.name", "a text", isinstance(settings.get("name") or "", str))
    assumed = settings.get("assumed") or {}
    texts = isinstance(assumed, dict) and all(isinstance(one, str) for one in assumed.values())
    _expect("settings.assumed", "texts by name", texts)


def check_simulation(simulation: Simulation) -> None:
    """:class:`InvalidInput` with the first part that does not fit the others."""
    times, poses = simulation.times, simulation.object_poses
    _expect("times", "times that grow", times.size > 0 and bool(np.all(np.diff(times) > 0)))
    _expect("complete", "the number of a sample", 0 <= simulation.complete < len(times))
    _expect("energies", ", ".join(ENERGIES), set(simulation.energies) == set(ENERGIES))
    bottom = np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1))
    good = bool(are_rotations(poses[:, :3, :3]).all()) and np.array_equal(poses[:, 3], bottom)
    _expect("object_poses", "placements", good)


def _expect(name: str, wanted: str, holds: bool) -> None:
    if not holds:
        raise InvalidInput(f"{name}: expected {wanted[:200]}")


def _check_names(plan: PlanRecord) -> None:
    """Whether joints, fingers and contacts are named once, and the hand is that of the plan."""
    layout, contacts, n = plan.layout, plan.contacts, len(plan.layout.joints)
    for name, words in (("layout.joints", layout.joints), ("contacts.names", contacts.names)):
        _expect(name, "names, each once", 0 < len(set(words)) == len(words))
    for finger, dofs in layout.fingers.items():
        good = all(0 <= dof < n for dof in dofs) and 0 < len(set(dofs)) == len(dofs)
        _expect(f"layout.fingers.{finger}", f"numbers from 0 to {n - 1}, each once", good)
    hand = plan.hand
    if hand is None:
        return
    fingers = {finger.name: tuple(finger.dofs.tolist()) for finger in hand.fingers}
    same = hand.joint_names == layout.joints and fingers == dict(layout.fingers)
    _expect("hand", "the hand of the plan, not one with other joints or fingers", same)
    for link in contacts.links:
        _expect("contacts.links", f"links of the hand, it has no '{link}'", not link or hand.model.existFrame(link))


def _check_times(plan: PlanRecord) -> None:
    times, impact = plan.motion.times, plan.motion.impact
    rising = len(times) >= 3 and times[0] >= 0 and bool(np.all(np.diff(times) > 0))
    _expect("motion.times", "at least three, from 0 s on, each later than the one before", rising)
    _expect("motion.impact", "the number of a sample between the first and the last", 0 < impact < len(times) - 1)
    ends = (plan.forces.impact_time, plan.forces.final_time)
    same = np.allclose(ends, (times[impact], times[-1]), rtol=1e-6, atol=0)
    _expect("forces.impact_time, forces.final_time", "the times of the motion's impact and end", same)


def _check_physics(plan: PlanRecord) -> None:
    friction, forces = plan.friction, plan.forces
    for name, values in (
        ("friction.mu", friction.mu),
        ("friction.torsion", friction.torsion),
        ("torque_limit", plan.torque_limit),
        ("body_mass", plan.body_mass),
        ("forces.residual_force, forces.residual_moment", [forces.residual_force, forces.residual_moment]),
        ("motion.peak_torque", plan.motion.peak_torque),
        ("elapsed", list(plan.elapsed.values())),
    ):
        _expect(name, "from 0 on", bool(np.all(np.asarray(values) >= 0)))
    law = plan.law
    wanted = "a stiffness above 0, a damping from 0 on, an exponent above 0 and up to 100, or 0 beside a table"
    is_power = law.exponent == 0 if len(law.table) else 0 < law.exponent <= 100
    _expect("law", wanted, law.stiffness > 0 and law.damping >= 0 and is_power)
    rises = len(law.table) > 1 and not np.any(law.table[0]) and bool(np.all(np.diff(law.table, axis=0) > 0))
    _expect("law.table", "depths and forces that rise from 0", not len(law.table) or rises)
    _expect("contacts.rotations_oc", "rotations", bool(are_rotations(plan.contacts.rotations_oc).all()))
    edges = friction.edges
    polygon, elliptic = friction.traits.polygon, friction.traits.elliptic
    good = edges is not None and 4 <= edges <= 1000 and edges % 2 == 0 if polygon else edges is None
    _expect("friction.edges", "an even number from 4 to 1000 for a pyramid alone", good)
    _expect("friction.safety", "1 or more", friction.safety >= 1)
    _expect("friction.torsion", "above 0 for soft fingers", not elliptic or friction.torsion > 0)
