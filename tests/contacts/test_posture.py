"""Contacts of a given posture: those of a closed hand come back; offsets are told; settling is the least change."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp.contacts import close_hand, contacts_of
from pinograsp.errors import InvalidInput
from pinograsp.hands import load_hand
from pinograsp.objects import Box, Cylinder, Sphere

PLACE = np.eye(4)
PLACE[:3, 3] = [0.07, 0.0, 0.06]


@pytest.fixture(scope="module")
def ball():
    """An Allegro hand closed on a ball."""
    return close_hand(load_hand("allegro_right"), Sphere(radius=0.03, mass=0.1, pose=PLACE))


@pytest.fixture(scope="module")
def jaws():
    """A Panda gripper closed on a box, flat on flat."""
    hand = load_hand("panda")
    box = Box(size=(0.03, 0.03, 0.03), mass=0.1).placed(hand.pose)
    pose = np.array(box.pose)
    pose[:3, 3] += hand.pose[:3, :3] @ [0.0, 0.0, 0.1034]
    return close_hand(hand, box.placed(pose))


@pytest.mark.parametrize("name", ["ball", "jaws"])
def test_touches_of_a_closed_hand_come_back(name, request):
    closure = request.getfixturevalue(name)
    found = contacts_of(closure.hand, closure.object, closure.q, tolerance=1e-5)
    assert not found.overlaps and found.residual < 1e-6 and np.array_equal(found.q, closure.q)
    ours, theirs = found.contacts(), closure.contacts()
    assert ours.names == theirs.names and len(ours) >= 2
    for link in {contact.link for contact in theirs}:  # the corners of a face come in any order
        one, other = (
            np.array([np.append(contact.point_o, contact.normal_o) for contact in contacts if contact.link == link])
            for contacts in (ours, theirs)
        )
        assert len(one) == len(other)
        away = np.abs(one[:, None] - other[None]).max(axis=2)
        assert away.min(axis=1).max() < 2e-4 and away.min(axis=0).max() < 2e-4
    assert np.array_equal(ours.posture, closure.q)


@pytest.mark.parametrize("shift", [-4e-4, 7e-4])
def test_an_object_that_is_off_is_outside_one_jaw_and_inside_the_other(jaws, shift):
    """Flat faces: the distances are known to the last digit, and the areas stay where they are."""
    normal = jaws.touches[0].normal_o
    pose = np.array(jaws.object.pose)
    pose[:3, 3] += shift * normal
    moved = jaws.object.placed(pose)
    found = contacts_of(jaws.hand, moved, jaws.q, tolerance=1e-3)
    gaps = {touch.link: touch.gap for touch in found.touches}
    first, second = (touch.link for touch in jaws.touches[:2])
    assert gaps[first] == pytest.approx(shift, abs=1e-6) and gaps[second] == pytest.approx(-shift, abs=1e-6)
    assert found.residual == pytest.approx(abs(shift), abs=1e-6)
    for touch in found.touches:
        surface, _, _ = moved.project(touch.patch_o)
        assert np.allclose(surface, touch.patch_o, atol=1e-7)  # on the object
    near = contacts_of(jaws.hand, moved, jaws.q, tolerance=0.5 * abs(shift))
    assert not near.touches and list(near.overlaps) == [second if shift > 0 else first]
    assert next(iter(near.overlaps.values())) == pytest.approx(abs(shift), abs=1e-6)
    with pytest.raises(InvalidInput, match="touches nothing"):
        near.contacts()


def test_settling_is_the_least_change_that_touches(ball):
    rng = np.random.default_rng(5)
    hand, moved = ball.hand, 0
    touching = {touch.finger for touch in ball.touches}
    dofs = np.concatenate([finger.dofs for finger in hand.fingers if finger.name in touching])
    for _ in range(4):
        by = np.zeros(hand.n)
        by[dofs] = rng.uniform(-0.03, 0.03, len(dofs))
        given = np.clip(ball.q + by, hand.lower, hand.upper)
        before = contacts_of(hand, ball.object, given, tolerance=5e-3)
        found = contacts_of(hand, ball.object, given, tolerance=5e-3, settle=True)
        assert {one.link for one in found.touches} >= {one.link for one in before.touches if one.finger}
        assert before.residual > 1e-5 and found.residual < 2e-6
        # The closed posture touches with the same links, so it is no nearer.
        if {one.link for one in found.touches} == {one.link for one in ball.touches}:
            moved += 1
            assert np.linalg.norm(found.q - given) <= 1.02 * np.linalg.norm(ball.q - given)
        assert (found.q >= hand.lower).all() and (found.q <= hand.upper).all()
        assert np.array_equal(found.given, given)
    assert moved


def test_what_the_limits_do_not_reach_is_told():
    hand = load_hand("panda")
    pose = np.array(hand.pose)
    pose[:3, 3] += hand.pose[:3, :3] @ [0.0, 0.0, 0.1034]
    rod = Cylinder(radius=0.041, height=0.02, mass=0.1, pose=pose)  # wider than the jaws open
    found = contacts_of(hand, rod, hand.upper, tolerance=5e-3, settle=True)
    assert found.residual == pytest.approx(1e-3, abs=2e-4)
    assert all(touch.gap < 0 for touch in found.touches if touch.joint_id)


def test_bad_input(ball):
    with pytest.raises(InvalidInput, match="within their limits, got"):
        contacts_of(ball.hand, ball.object, ball.hand.upper + 0.1)
    with pytest.raises(InvalidInput, match="q: expected shape"):
        contacts_of(ball.hand, ball.object, np.zeros(3))
    with pytest.raises(InvalidInput, match="tolerance"):
        contacts_of(ball.hand, ball.object, ball.q, tolerance=0)
