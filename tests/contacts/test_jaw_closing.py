"""Jaws closed in bulk: as the exact method closes them, and centred where they would push."""

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.contacts import close_hand
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.jaw_closing import close_jaws
from pinograsp.errors import InvalidInput
from pinograsp.spatial import pose_of, rotation_rpy

TIPS = pose_of([0.0, 0.0, -0.1034])  # the root, seen from between the Panda's fingertips


@pytest.mark.parametrize("shift", [0.0, 0.004, -0.007])
@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_both_jaws_touch_and_the_hand_gives_way(shift, turn):
    hand = pg.load_hand("panda")
    body = pg.Cylinder(radius=0.02, height=0.06, mass=0.1)
    root = pose_of(rotation=rotation_rpy(0, 0, turn)) @ pose_of([0.0, shift, 0.0]) @ TIPS
    scene = BulkScene(hand, body)
    q, moved, touching = close_jaws(scene, root[None])
    assert touching.all() and q[0, 0] == pytest.approx(0.02, abs=3e-5)  # the pads stand out by 20 um
    # Along the way that the jaws close, the axis is in their middle.
    local = np.linalg.inv(moved[0]) @ body.pose
    assert abs(local[1, 3]) < 5e-6
    exact = close_hand(hand.placed(moved[0]), body)
    assert exact.q[0] == pytest.approx(q[0, 0], abs=2e-6)
    found = scene.contacts(q, moved, tolerance=1e-4)
    assert sorted(scene.links[scene.link_of[part]] for part in found.part) == ["panda_leftfinger", "panda_rightfinger"]


def test_jaws_that_miss_close_and_say_so():
    hand, body = pg.load_hand("panda"), pg.Sphere(radius=0.01, mass=0.1)
    q, _, touching = close_jaws(BulkScene(hand, body), np.array([pose_of([0.3, 0.0, 0.0]), TIPS]))
    assert touching.tolist() == [False, True] and q[0, 0] == pytest.approx(0.0)


def test_hands_of_several_joints_are_refused():
    scene = BulkScene(pg.load_hand("allegro_right"), pg.Sphere(radius=0.01, mass=0.1))
    with pytest.raises(InvalidInput, match="expected a hand of one joint"):
        close_jaws(scene, np.eye(4)[None])
