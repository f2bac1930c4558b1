"""Many postures at once against Pinocchio, posture by posture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pinograsp.hands import load_hand
from pinograsp.motion.chains import points_at
from pinograsp.motion.jacobian import contact_jacobian


@pytest.mark.parametrize("name", ["humanoid", "allegro_right", "psyonic_right", "hey5", "panda", "baxter_left"])
def test_many_postures_at_once(name):
    """Joints that turn, slide or follow others, points on each of a finger's links."""
    hand, rng = load_hand(name), np.random.default_rng(3)
    model, data = hand.model, hand.model.createData()
    posture = rng.uniform(hand.lower, hand.upper)
    first, second = hand.fingers[0], hand.fingers[-1]
    ids = tuple(dict.fromkeys([*first.joint_ids, *second.joint_ids]))
    both = replace(first, joint_ids=ids, dofs=np.union1d(first.dofs, second.dofs))  # as one that shares its motors
    for finger in [*hand.fingers, both]:
        joints = [0, *finger.joint_ids]
        points_l = rng.normal(scale=0.03, size=(len(joints), 3))
        q = rng.uniform(hand.lower[finger.dofs], hand.upper[finger.dofs], (7, finger.n))
        points, jacobians = points_at(hand, finger, joints, points_l, q, posture)
        for i, angles in enumerate(q):
            whole_hand = posture.copy()
            whole_hand[finger.dofs] = angles
            pin.computeJointJacobians(model, data, whole_hand)
            for c, (joint, point) in enumerate(zip(joints, points_l)):
                assert points[i, c] == pytest.approx(data.oMi[joint].act(point), abs=1e-14)
                expected = contact_jacobian(model, data, joint, point)[:, finger.dofs] if joint else 0.0
                assert np.abs(jacobians[i, c] - expected).max() < 1e-13
