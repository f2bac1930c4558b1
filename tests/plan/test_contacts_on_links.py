"""Where on its links a plan's contacts are: on the links' surfaces, and wherever the hand stands."""

from __future__ import annotations

import json
from dataclasses import replace

import coal
import numpy as np
import pytest

import pinograsp as pg
from pinograsp.plan import LinkContacts
from pinograsp.report import report_plan
from pinograsp.spatial import pose_of, rotation_rpy

CONDITIONS = pg.GraspConditions(mu=0.6)
ELSEWHERE = pose_of([0.4, -0.3, 0.5], rotation_rpy(0.3, -0.5, 2.0))


def plan_of(hand, body):
    closure = pg.close_hand(hand, body)
    return pg.plan_grasp_on(closure.hand, closure, CONDITIONS)


@pytest.fixture(scope="module")
def jaws():
    return plan_of(pg.load_hand("panda").placed(pose_of([0, 0, 0.1234], rotation_rpy(np.pi, 0, 0))), block(np.eye(4)))


@pytest.fixture(scope="module")
def fingers():
    body = pg.Cylinder(radius=0.033, height=0.12, mass=0.25)
    found = pg.find_grasps(pg.load_hand("allegro_right"), body, CONDITIONS, count=16, seed=1, jobs=1, progress=False)
    return pg.plan_best(found, CONDITIONS, progress=False)


def block(pose):
    return pg.Box(size=[0.05, 0.03, 0.09], mass=0.15, pose=pose)


def distance(hand, link, point_l):
    """Of a point from the surface of a link, by coal [m]; 0 inside."""
    frame = hand.model.frames[hand.frame_id(link)]
    point = coal.Transform3s(np.eye(3), frame.placement.act(np.array(point_l)))
    found = []
    for one in hand.geometry.geometryObjects:
        if one.parentJoint == frame.parentJoint:
            place = coal.Transform3s(one.placement.rotation, one.placement.translation)
            found.append(
                coal.distance(
                    one.geometry, place, coal.Sphere(1e-9), point, coal.DistanceRequest(), coal.DistanceResult()
                )
            )
    return max(0.0, min(found))


def test_contacts_are_on_the_surface_of_their_links_which_they_leave_along_their_normals(jaws, fingers):
    for plan in (jaws, fingers):
        places = plan.contacts_on_links
        assert places.names == plan.contacts.names and places.links == plan.contacts.links
        np.testing.assert_allclose(np.linalg.norm(places.normals_l, axis=1), 1, atol=1e-12)
        np.testing.assert_array_equal(places.normal_forces, plan.forces.normal_forces)
        for link, point, normal in zip(places.links, places.points_l, places.normals_l):
            assert distance(plan.hand, link, point) < 2e-4, link  # the closing stops within a tenth of a millimetre
            assert distance(plan.hand, link, point - 1e-3 * normal) < 1e-6, link
            assert distance(plan.hand, link, point + 2e-3 * normal) > 1e-3, link


def test_they_stay_where_hand_and_object_are_placed_elsewhere(jaws):
    moved = plan_of(jaws.hand.placed(ELSEWHERE @ jaws.hand.pose), block(ELSEWHERE))
    one, other = jaws.contacts_on_links, moved.contacts_on_links
    for link, point, normal in zip(one.links, one.points_l, one.normals_l):  # in whatever order
        same = [i for i in range(len(other.links)) if np.allclose(other.points_l[i], point, atol=1e-6)]
        assert link in [other.links[i] for i in same]
        assert any(np.allclose(other.normals_l[i], normal, atol=1e-6) for i in same)


def test_they_are_told_in_summary_report_and_files_for_controllers(jaws, tmp_path):
    places = jaws.contacts_on_links
    told = jaws.summary()["contacts_on_links"]
    assert list(told) == list(places.names) and json.dumps(told)
    for name, link, point, force in zip(places.names, places.links, places.points_l, places.normal_forces):
        assert told[name]["link"] == link and told[name]["point_m"] == point.tolist()
        assert told[name]["normal_force_N"] == force
    constants = json.loads(jaws.to_core(tmp_path / "grasp.json").read_text())
    assert constants["contact_links"] == list(places.links)
    assert constants["link_points"] == places.points_l.tolist()
    assert constants["link_normals"] == places.normals_l.tolist()
    header = jaws.to_core(tmp_path / "grasp.hpp").read_text()
    assert f'contact_links[] = {{"{places.links[0]}"' in header and "double link_points[] = {" in header
    (section,) = [one for one in report_plan(jaws.with_margins()).sections if one.title == "Contact forces at t_F"]
    assert [row[5] for row in section.rows] == list(places.links)
    numbers = [float(value) for value in section.rows[0][6].split(",")]
    assert numbers == pytest.approx(1e3 * places.points_l[0], abs=0.051)


def test_a_plan_without_its_hand_does_not_know_them(jaws):
    for lost in (replace(jaws, hand=None), replace(jaws, contacts=replace(jaws.contacts, links=()))):
        assert lost.contacts_on_links is None
    assert isinstance(jaws.contacts_on_links, LinkContacts)
