"""A hand's way to an object in the compiled core, against coal's distances along it."""

from __future__ import annotations

import secrets

import coal
import numpy as np
import pinocchio as pin
import pytest
from convex_shapes import draw_placement, draw_shapes

from pinograsp import core
from pinograsp.contacts import close_hand
from pinograsp.contacts.compiled import support_shape
from pinograsp.errors import InvalidInput
from pinograsp.hands import load_hand
from pinograsp.objects import Box, Cylinder, Ellipsoid, Sphere
from pinograsp.synthesis.preshapes import preshapes

TOUCH, CREEP, NEAR = 5e-8, 2e-5, 2e-6  # [m]


def distance(one, at, other, there):
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance, request.gjk_tolerance = True, 1e-10
    poses = [coal.Transform3s(frame.rotation, frame.translation) for frame in (at, there)]
    return coal.distance(one, poses[0], other, poses[1], request, result)


@pytest.mark.parametrize("turning", [False, True])
def test_a_part_goes_as_far_as_it_is_clear_and_no_farther(turning):
    seed = secrets.randbelow(10**9)
    rng = np.random.default_rng(seed)
    stopped = 0
    for one in draw_shapes(rng, 0.005):
        for other in draw_shapes(rng, 0.005):
            away = np.array([0.25, 0.0, 0.0])
            start, own, there = pin.SE3(np.eye(3), away), draw_placement(rng, 0.02), draw_placement(rng, 0.02)
            axis = rng.normal(size=3) if turning else -away + 0.02 * rng.normal(size=3)
            screw = pin.Motion(np.zeros(3), axis) if turning else pin.Motion(axis, np.zeros(3))
            if turning:  # it sweeps by where the object is
                own.translation = pin.exp3(-rng.uniform(0.3, 1.0) * axis) @ (own.translation - away)
            if distance(one, start * own, other, there) < 1e-3:
                continue
            one.computeLocalAABB()
            centre, half = np.array(one.aabb_center), 0.5 * (one.aabb_local.max_ - one.aabb_local.min_)
            signs = np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0
            corners = (own.rotation @ (centre + signs * half).T).T + own.translation
            way = core.load().Approach(touch=TOUCH, creep=CREEP, near=NEAR)
            way.add_joint(-1, 0, start.homogeneous, screw.vector)
            way.add_part(0, own.homogeneous, corners, *support_shape(one))
            way.put(*support_shape(other))
            reach = np.linalg.norm(corners, axis=1).max()
            speed = np.linalg.norm(axis) * (reach if turning else 1.0)
            bend = np.linalg.norm(axis) * speed if turning else 0.0
            known = np.zeros((7, 1))  # gaps, since, rates, times, stops, speeds, bends
            known[5:, 0] = speed, bend
            end = 2.0
            at, made = way.pursue(0.0, end, np.zeros(1), np.ones(1), there.homogeneous, known, 1000)
            assert 0 < made < 1000, seed
            times, stops = known[3:5, 0]

            def gap(s, one=one, own=own, other=other, there=there, start=start, screw=screw):
                return distance(one, start * pin.exp6(s * screw) * own, other, there)

            assert min(gap(s) for s in np.linspace(0.0, min(max(at, times), end), 40)) > -1e-7, seed
            if at < end:  # where it is to be looked at next, it is near, or has gone on by the least step
                assert stops < end and gap(stops) < 1.01 * NEAR + 1e-7, seed
                stopped += 1
    assert stopped > 9, seed


def test_a_part_that_slides_along_an_object_makes_no_more_steps_than_it_may():
    cube = support_shape(coal.Box(0.1, 0.1, 0.1))
    own = np.eye(4)
    own[2, 3] = 0.1 + 2.5 * NEAR
    signs = 0.05 * (np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0)
    way = core.load().Approach(touch=TOUCH, creep=CREEP, near=NEAR)
    way.add_joint(-1, 0, np.eye(4), np.array([1.0, 0.0, 1e-9, 0.0, 0.0, 0.0]))
    way.add_part(0, own, signs + own[:3, 3], *cube)
    way.put(*cube)
    known = np.zeros((7, 1))
    known[5:, 0] = 1.0, 1.0  # as a part is known that may turn towards the object at once
    at, made = way.pursue(0.0, 0.05, np.zeros(1), np.ones(1), np.eye(4), known, 7)
    assert made == 7 and 0.0 < at < 0.05
    farther, more = way.pursue(at, 0.05, np.array([at]), np.ones(1), np.eye(4), known, 1000)
    assert farther > at and more > 7


@pytest.mark.parametrize("name", ["allegro_left", "panda", "g1_left"])
def test_closings_are_those_of_coal_alone(name, monkeypatch):
    hand = load_hand(name)
    seed = secrets.randbelow(10**9)
    rng = np.random.default_rng(seed)
    wide = [one for one in preshapes(hand, rng) if one.width > 0.01][:10]
    touching = 0
    for _ in range(30):
        if touching > 5:
            break
        shape = wide[int(rng.integers(len(wide)))]
        pose, size = np.eye(4), rng.uniform(0.2, 0.35) * min(shape.width, 0.08)
        between = pin.SE3(np.array(hand.pose)).act(shape.centre_h)
        pose[:3, :3], pose[:3, 3] = pin.exp3(rng.normal(size=3)), between + 0.1 * size * rng.normal(size=3)
        for body in (
            Sphere(radius=size, mass=0.1, pose=pose),
            Box(size=(size, size, 2 * size), mass=0.1, pose=pose),
            Cylinder(radius=size / 2, height=2 * size, mass=0.1, pose=pose),
            Ellipsoid(semi_axes=(size, size / 2, 1.5 * size), mass=0.1, pose=pose),
        ):
            try:
                # Held still: an object that jaws push may slip from them this way or that by a nanometre's difference.
                found = close_hand(hand, body, start=shape.opened, target=shape.closed, fixed=True)
            except InvalidInput:  # the open hand is in its way
                continue
            with monkeypatch.context() as without:
                without.setattr(core, "is_installed", lambda: False)
                alone = close_hand(hand, body, start=shape.opened, target=shape.closed, fixed=True)
            assert sorted(touch.link for touch in found.touches) == sorted(touch.link for touch in alone.touches), seed
            assert np.abs(found.q - alone.q).max() < 2e-3, seed
            touching += len(found.touches) > (hand.n > 1)  # of jaws of one motor the first stops both
    assert touching > 5, seed
