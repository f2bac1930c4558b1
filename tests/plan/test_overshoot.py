"""Fingers whose drives are not as told touch slowly enough for the caps of their contacts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinograsp as pg

CONDITIONS = pg.GraspConditions(mu=0.6)


def energies_at_touch(plan: pg.GraspPlan) -> dict[str, float]:
    """The largest kinetic energy [J] of each touching finger, from shortly before t_I on, as Pinocchio reckons it."""
    motion, model, data, kept = plan.motion, plan.hand.model, plan.hand.model.createData(), {}
    touch, end = motion.times[motion.impact], motion.times[-1]
    for finger in plan.hand.fingers:
        if not {*finger.links, finger.tip} & set(plan.contacts.links):
            continue
        rates = np.zeros_like(motion.dq)
        rates[:, finger.dofs] = motion.dq[:, finger.dofs]
        late = motion.times >= 2 * touch - end
        kept[finger.name] = max(
            pin.computeKineticEnergy(model, data, q, v) for q, v in zip(motion.q[late], rates[late])
        )
    return kept


@pytest.fixture(scope="module")
def grasps():
    return pg.find_grasps(
        pg.load_hand("allegro_right"), pg.Sphere(radius=0.035, mass=0.18), CONDITIONS, count=8, seed=4, progress=False
    )


@pytest.mark.slow
def test_drives_that_may_be_off_touch_gently_under_a_cap(grasps):
    free = pg.plan_best(grasps, replace(CONDITIONS, reserve=pg.Reserve(drive=0.3)))
    cap = 1.4 * float(free.forces.normal_forces.max())
    capped = pg.plan_best(grasps, replace(free.conditions, max_normal_force=cap))
    law = capped.problem.compliance
    for reserve, stiff in ((pg.Reserve(drive=0.3), 20.0), (pg.Reserve(drive=0.3, stiffer=2.0), 2.0)):
        plan = pg.plan_best(grasps, replace(capped.conditions, reserve=reserve))
        taken = float(law.scale(stiff).energy(law.scale(stiff).depth(cap / 2)))
        longest = plan.forces.final_time - plan.forces.impact_time > 0.099
        # Torques at the end of another motion change the forces, and with them the speeds, by a little.
        assert longest or all(energy <= 1.2 * taken for energy in energies_at_touch(plan).values())
    assert capped.forces.impact_time <= free.forces.impact_time
    assert set(capped.elapsed) == set(free.elapsed)


@pytest.mark.slow
def test_no_cap_that_matters_changes_nothing(grasps):
    free = pg.plan_best(grasps, replace(CONDITIONS, reserve=pg.Reserve(drive=0.3)))
    wide = pg.plan_best(grasps, replace(free.conditions, max_normal_force=500.0))
    assert wide.forces.impact_time == free.forces.impact_time
    np.testing.assert_allclose(wide.forces.normal_forces, free.forces.normal_forces, rtol=1e-4)
