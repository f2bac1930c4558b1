"""Contact IK for any hand: points anywhere on any link, several per finger, coupled joints included."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_except

from pinograsp.contacts import Contact, ContactSet
from pinograsp.hands import load_hand
from pinograsp.motion import contact_postures
from pinograsp.spatial import tangent_frame

HANDS = ("humanoid", "allegro_left", "g1_right", "psyonic_left", "romeo_left", "panda")


def random_contacts(hand, rng):
    """A posture, and contacts on one to three links of each of two fingers (one, where all share an actuator)."""
    q = rng.uniform(hand.lower + 0.02 * (hand.upper - hand.lower), hand.upper - 0.02 * (hand.upper - hand.lower))
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, q)
    contacts = []
    for finger in rng.permutation(np.array(hand.fingers, dtype=object))[:2]:
        links = sorted(rng.choice(len(finger.links), min(len(finger.links), int(rng.integers(1, 4))), replace=False))
        for i in links:
            local = rng.uniform(-0.02, 0.03, 3)
            point = data.oMi[finger.joint_ids[i]].act(local)
            contacts.append(
                Contact(
                    finger=finger.name,
                    link=finger.links[i],
                    point_o=point,
                    rotation_oc=tangent_frame(rng.normal(size=3)),
                    length=float(np.linalg.norm(local)),
                    distance=0.0,
                    point_l=local,
                )
            )
    return q, ContactSet(contacts=tuple(contacts), com_o=np.zeros(3))


def check(name, count, seed):
    hand, rng = load_hand(name), np.random.default_rng(seed)
    data = hand.model.createData()
    for _ in range(count):
        q, contacts = random_contacts(hand, rng)
        near = {
            finger.name: np.clip(
                q[finger.dofs] + rng.uniform(-0.03, 0.03, finger.n) * (hand.upper - hand.lower)[finger.dofs],
                hand.lower[finger.dofs],
                hand.upper[finger.dofs],
            )
            for finger in hand.fingers
        }
        for group, found in contact_postures(hand, contacts, reference=near).items():
            members = [hand.finger(one) for one in group.split(" + ")]
            own = [contact for contact in contacts if contact.finger in group.split(" + ")]
            dofs = list(dict.fromkeys(int(i) for one in members for i in one.dofs))
            for angles, points in zip(found.angles, found.points_l):
                posture = q.copy()
                posture[dofs] = angles
                pin.forwardKinematics(hand.model, data, posture)
                for contact, local in zip(own, points):
                    chain = hand.finger(contact.finger)
                    placed = data.oMi[chain.joint_of(contact.link)].act(local)
                    assert np.linalg.norm(placed - contact.point_o) < 1e-9
                assert np.all(angles >= hand.lower[dofs] - 1e-9) and np.all(angles <= hand.upper[dofs] + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(HANDS, "humanoid", "panda"))
@pytest.mark.no_cover
def test_random_contacts_come_back(name):
    check(name, 15, 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", HANDS)
def test_a_thousand_random_contacts_come_back(name, often):
    check(name, often(170), 2)
