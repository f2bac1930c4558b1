"""Grasps at a given part of an object: the hand touches it nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pinograsp.contacts import Friction
from pinograsp.errors import CaseRejected, InvalidInput
from pinograsp.forces import GraspConditions
from pinograsp.hands import load_hand
from pinograsp.objects import Box, Cylinder
from pinograsp.synthesis import Wishes, find_grasps
from pinograsp.synthesis.seeds import Region, find_pairs

CONDITIONS = GraspConditions(mu=0.7, friction=Friction(model="soft", torsion=0.005), reserve=None)
POSE = pin.SE3(pin.utils.rotate("x", 0.7) @ pin.utils.rotate("z", 0.4), np.array([0.3, -0.1, 0.5])).homogeneous


def _touched(closure):
    """Where the object is touched, in its own frame (k, 3)."""
    pose = closure.object.pose
    return (np.vstack([one.patch_o for one in closure.touches]) - pose[:3, 3]) @ pose[:3, :3]


@pytest.mark.slow
@pytest.mark.parametrize("end", [-1, 1])
def test_jaws_hold_a_bar_at_the_given_end(end):
    bar = Box(size=(0.03, 0.03, 0.2), mass=0.1, pose=POSE)
    ends = sorted((end * 0.05, end * 0.101))
    within = np.array([[-0.02, -0.02, ends[0]], [0.02, 0.02, ends[1]]])
    wishes = Wishes(within=within)
    found = find_grasps(load_hand("panda"), bar, CONDITIONS, wishes=wishes, count=8, seed=1, jobs=1, progress=False)
    assert found.grasps
    for grasp in found.grasps:
        at = _touched(grasp.closure)
        assert ((at >= within[0]) & (at <= within[1])).all()


@pytest.mark.slow
def test_fingers_that_would_touch_elsewhere_stay_open():
    hand = load_hand("allegro_right")
    bar = Cylinder(radius=0.02, height=0.2, mass=0.1)
    within = np.array([[-0.03, -0.03, 0.04], [0.03, 0.03, 0.101]])
    free, held = (
        find_grasps(hand, bar, CONDITIONS, wishes=Wishes(within=where), count=8, seed=2, jobs=1, progress=False)
        for where in (None, within)
    )
    assert any(((_touched(one.closure) < within[0]) | (_touched(one.closure) > within[1])).any() for one in free.grasps)
    assert held.grasps
    still = 0
    others = (
        find_grasps(hand, bar, CONDITIONS, wishes=Wishes(within=within), count=8, seed=i, jobs=1, progress=False)
        for i in (3, 4)
    )
    for grasp in (*held.grasps, *(one for other in others for one in other.grasps)):
        at, closure = _touched(grasp.closure), grasp.closure
        assert ((at >= within[0]) & (at <= within[1])).all()
        open_ = [one for one in hand.fingers if np.array_equal(closure.start[one.dofs], closure.target[one.dofs])]
        assert not {one.name for one in open_} & {touch.finger for touch in closure.touches}
        still += len(open_)
    assert still > 0


def test_the_distance_from_a_region_moves_with_the_object():
    rng = np.random.default_rng(0)
    region = Region(lower=np.array([-0.1, 0.0, 0.2]), upper=np.array([0.3, 0.1, 0.4]), pose=np.eye(4))
    points = rng.uniform(-0.5, 0.5, (200, 3))
    nearest = np.clip(points, region.lower, region.upper)
    apart = np.linalg.norm(points - nearest, axis=1)
    assert np.allclose(region.outside(points), apart, atol=1e-15) and (apart == 0).any()
    moved = replace(region, pose=POSE)
    there = points @ POSE[:3, :3].T + POSE[:3, 3]
    assert np.allclose(moved.outside(there), apart, atol=1e-12)
    assert np.allclose(moved.outside(moved.draw(rng, 100)), 0, atol=1e-12)
    assert moved.outside(moved.middle_o[None])[0] == 0


def test_pairs_of_a_thin_part_alone():
    bar = Box(size=(0.03, 0.03, 0.2), mass=0.1, pose=POSE)
    region = Region(lower=np.array([-0.02, -0.02, 0.06]), upper=np.array([0.02, 0.02, 0.08]), pose=POSE)
    pairs = find_pairs(bar, np.random.default_rng(1), region)
    assert len(pairs.widths) > 50 and np.allclose(pairs.widths, 0.03, atol=1e-4)
    assert np.allclose(region.outside(pairs.middles_o), 0)


@pytest.mark.parametrize(
    ("within", "message"),
    [
        ([[0, 0, 0], [0.1, -0.1, 0.1]], "lower corner < upper corner"),
        ([0, 0, 0, 1, 1, 1], r"expected shape \(2, 3\)"),
        ([[0, 0, np.nan], [1, 1, 1]], "finite"),
        ([[1, 1, 1], [2, 2, 2]], "opposed surfaces of the object in it, found none"),
    ],
)
def test_boxes_that_cannot_be_used(within, message):
    bar = Box(size=(0.03, 0.03, 0.2), mass=0.1)
    with pytest.raises(InvalidInput, match=message):
        wishes = Wishes(within=within)
        find_grasps(load_hand("panda"), bar, CONDITIONS, wishes=wishes, count=4, jobs=1, progress=False)


@pytest.mark.slow
def test_a_case_takes_it_where_the_place_is_searched():
    from pinograsp.cases.object_case import ObjectCase

    values = {
        "hand": "panda",
        "object": "box:size=0.03x0.03x0.2,mass=0.1",
        "wishes": {"within": (-1, -1, 0.05, 1, 1, 1)},
    }
    case = ObjectCase.of(**values, samples=8)
    for grasp in case.grasps(jobs=1, progress=False).grasps:
        assert _touched(grasp.closure)[:, 2].min() >= 0.05
    with pytest.raises(CaseRejected, match="expected them without at"):
        ObjectCase.of(**values, at=(0, 0, 0.1))
