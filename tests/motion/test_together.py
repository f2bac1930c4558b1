"""What is computed together, against the same one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.contacts import PenetrationProfile
from pinograsp.contacts.clearance import Distances, parts_of
from pinograsp.hands import load_hand
from pinograsp.motion import contact_postures
from pinograsp.motion.grasp_ik import ContactPath, press_points
from pinograsp.motion.jacobian import contact_jacobian, point_jacobians
from pinograsp.motion.torques import finger_dynamics, inverse_dynamics


@pytest.mark.slow
def test_all_postures_are_pressed_as_each_alone(hand, contacts, final_angles):
    """Of some, joints meet their limits on the way: the others must not notice."""
    profile = PenetrationProfile(acceleration=np.full(3, 0.3), impact_time=0.9, final_time=1.0)
    times = np.linspace(0.9, 1.0, 26)
    for i, (name, found) in enumerate(contact_postures(hand, contacts, reference=final_angles).items()):
        finger = hand.finger(name)
        middle = found.angles[len(found.angles) // 2]
        narrow = hand.with_limits(
            {joint: (q - 0.02, q + 0.02) for joint, q in zip(finger.actuated, middle, strict=True)}
        )
        for one in (hand, narrow):
            path = ContactPath([contacts[i]], profile, [i], times)
            together = press_points(one, finger, path, found.angles, found.points_l)
            for angles, points, motion in zip(found.angles, found.points_l, together):
                (alone,) = press_points(one, finger, path, angles[None], points[None])
                assert motion.limited == alone.limited
                for what in ("q", "dq", "jacobians", "errors"):
                    assert np.abs(getattr(motion, what) - getattr(alone, what)).max() < 1e-12


@pytest.mark.parametrize("name", ["allegro_right", "hey5"])
def test_a_fingers_torques_are_those_of_the_hand(name):
    """Of a hand without coupled joints, and of one with them."""
    hand, rng = load_hand(name), np.random.default_rng(1)
    posture = rng.uniform(hand.lower, hand.upper)
    for finger in hand.fingers:
        path = tuple(rng.normal(size=(3, 8, finger.n)))
        whole_hand = [np.tile(posture, (8, 1)), *np.zeros((2, 8, hand.n))]
        for own, all_joints in zip(path, whole_hand):
            all_joints[:, finger.dofs] = own
        gravity = (1.0, -2.0, 9.0)
        expected = inverse_dynamics(hand, *whole_hand, gravity_o=gravity)[:, finger.dofs]
        assert finger_dynamics(hand, finger, posture, path, gravity) == pytest.approx(expected, abs=1e-13)


@pytest.mark.slow
def test_jacobians_of_points_in_the_world():
    hand, rng = load_hand("psyonic_right"), np.random.default_rng(2)
    model, data = hand.model, hand.model.createData()
    pin.computeJointJacobians(model, data, rng.uniform(hand.lower, hand.upper))
    joints, points = [0, *range(1, model.njoints), 3], rng.normal(scale=0.1, size=(model.njoints + 1, 3))
    found = point_jacobians(model, data, joints, points)
    assert np.all(found[0] == 0)
    for J, joint, point in zip(found[1:], joints[1:], points[1:]):
        assert np.abs(J - contact_jacobian(model, data, joint, data.oMi[joint].actInv(point))).max() < 1e-14


def test_parts_that_are_not_near_do_not_touch():
    hand, rng = load_hand("allegro_right"), np.random.default_rng(5)
    pose = np.eye(4)
    pose[:3, :3] = pin.exp3(np.array([0.3, -0.8, 0.5]))
    pose[:3, 3] = [0.06, 0.0, 0.05]
    body = pg.Box(size=(0.05, 0.09, 0.04), mass=0.1, pose=pose)
    distances, parts = Distances(hand, body), parts_of(hand)
    postures = rng.uniform(hand.lower, hand.upper, (40, hand.n))
    near, steps = distances.near(parts, postures)
    gaps = np.empty(near.shape)
    for i, q in enumerate(postures):
        distances.put(q)
        gaps[i] = [distances.rough(part) for part in parts]
    touching = gaps < 0
    both_apart = ~touching[1:] & ~touching[:-1]
    assert np.all(np.abs(np.diff(gaps, axis=0))[both_apart] <= steps[both_apart] + 1e-9)
    assert touching.sum() > 40 and not (touching & ~near).any() and near.mean() < 0.8
