"""Plans as grasps of a data set: position references in closed form, read back by the data set's own reader, held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import own_hands
import pytest

import pinograsp as pg
from pinograsp.certification import PROTOCOLS, Commands
from pinograsp.contacts import clearance
from pinograsp.data import read_grasps
from pinograsp.errors import InvalidInput
from pinograsp.handover import commanded_postures, grasp_rows, write_dexgraspbench
from pinograsp.hands import Drive
from pinograsp.motion.torques import inverse_dynamics

KP = 5.0  # [N m/rad]


@pytest.fixture(scope="module")
def plan():
    """A ball in an Allegro hand whose motors are position servos; the last two joints of each finger share one."""
    hand = pg.load_hand("allegro_right")
    drives = []
    for finger in hand.fingers:
        single, pair = finger.actuated[:2], finger.actuated[2:]
        drives += [Drive(name=one, joints=(one,), arms=(1.0,), control="position", stiffness=KP) for one in single]
        drives.append(
            Drive(name=f"{finger.name} tendon", joints=pair, arms=(1.0, 1.0), control="position", stiffness=KP)
        )
    hand, ball = hand.with_drives(drives), pg.Sphere(radius=0.035, mass=0.1)
    conditions = pg.GraspConditions(mu=0.6)
    return pg.plan_best(pg.find_grasps(hand, ball, conditions, count=16, seed=5, jobs=1, progress=False), conditions)


def test_references_are_as_far_ahead_as_the_servos_need(plan):
    hand, motion = plan.hand, plan.motion
    before, touching, squeezing = commanded_postures(plan)
    assert np.array_equal(touching, motion.q[motion.impact])
    # Before it touches, the hand is clear, and the contact that is farthest off has 15 mm to go.
    places = plan.contacts_on_links
    there, here = hand.frame_placements(np.stack([before, touching]), places.links)
    to_go = np.linalg.norm(
        np.einsum("kij,kj->ki", (there - here)[:, :3, :3], places.points_l) + (there - here)[:, :3, 3], axis=1
    )
    assert clearance(hand, plan.body, before) > 0.0 and 0.015 <= to_go.max() < 0.017
    last = motion.q[-1:]
    torques = motion.holding_torques - inverse_dynamics(hand, last, 0 * last, 0 * last)[0]
    efforts = KP * hand.transmission @ (squeezing - last[0])
    # Joints at the end of their range rest on it; all others have what their motors make.
    free = np.minimum(last[0] - hand.lower, hand.upper - last[0]) > 1e-3 * (hand.upper - hand.lower)
    made = hand.transmission.T @ efforts
    assert made[free] == pytest.approx(torques[free], abs=0.05 * np.abs(torques).max())
    # Hard contacts stop the links where they touch.
    hard = commanded_postures(plan, rigid=True)[2]
    assert hard - touching == pytest.approx(squeezing - last[0])
    # Twice the squeeze is twice as far ahead of the touch.
    single, double = (commanded_postures(plan, rigid=True, squeeze=times)[2] for times in (1.0, 2.0))
    assert double - motion.q[motion.impact] == pytest.approx(2 * (single - motion.q[motion.impact]), abs=1e-12)
    # A servo that is twice as stiff is sent half as far.
    stiffer = commanded_postures(plan, stiffness=2 * KP)[2]
    assert hand.transmission @ (stiffer - last[0]) == pytest.approx(hand.transmission @ (squeezing - last[0]) / 2)


def test_joints_that_share_a_motor_are_where_the_fingertips_press_them(plan):
    hand, q = plan.hand, plan.motion.q[-1]
    contacts = plan.solution.problem.contacts
    pressing = {contact.finger for contact, force in zip(contacts, plan.forces.normal_forces) if force > 0.1}
    rests = [hand.finger(name).dofs[2] for name in pressing if name != "palm"]
    assert len(rests) >= 2 and sum(q[i] < hand.lower[i] + 1e-3 for i in rests) >= len(rests) - 1


def test_a_plan_is_read_back_by_the_readers_of_the_data_set(plan, tmp_path):
    path = write_dexgraspbench(plan, tmp_path, "assets/ball", scale=0.08, name="mine")
    assert path == tmp_path / "ball" / "scale008_pose000" / "mine.npy"
    (back,) = read_grasps(path)
    rows = grasp_rows(plan, "assets/ball", scale=0.08)
    assert (back.object_name, back.scale[0]) == ("assets/ball", 0.08)
    for name in ("poses", "q", "pregrasp_q", "squeeze_q", "pregrasp_poses", "squeeze_poses"):
        assert getattr(back, name) == pytest.approx(getattr(rows, name), abs=1e-12), name
    order = [joint for finger in plan.hand.fingers for joint in finger.joints]
    assert rows.joint_names == tuple(order)
    assert rows.q[0] == pytest.approx(
        [plan.motion.q[plan.motion.impact][plan.hand.joint_names.index(j)] for j in order]
    )


def test_what_is_told_presses_as_planned(tmp_path):
    """Three jaws that close on the middle of a ball: nothing comes in between the references and the planned forces."""
    path = tmp_path / "chuck.urdf"
    path.write_text(own_hands.chuck(3), encoding="utf-8")
    drives = [
        Drive(name=f"m{i}", joints=(f"slide{i}",), arms=(1.0,), control="position", stiffness=4e3) for i in range(3)
    ]
    hand, ball = pg.load_hand(path, drives=drives), pg.Sphere(radius=0.03, mass=0.1)
    plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.8))
    forces = plan.forces.normal_forces
    protocol = replace(PROTOCOLS["dexgraspbench"], stiffness=float(np.mean(forces / plan.forces.final_depths)))
    stages, roots = commanded_postures(plan)[None], np.tile(plan.hand.pose, (1, 3, 1, 1))
    found = pg.certify(
        plan.hand,
        plan.body,
        stages[:, 1],
        protocol.conditions(),
        roots=roots[:, 0],
        commands=Commands(stages, roots),
        protocol=protocol,
    )
    assert found.held_as_commanded[0], found.words(0)
    assert np.sort(found.pressed[0])[-3:] == pytest.approx(np.sort(forces), rel=0.03)


def test_what_cannot_be_written_is_said(plan, tmp_path):
    with pytest.raises(InvalidInput, match="without any"):
        grasp_rows(replace(plan, hand=replace(plan.hand, drives=())), "ball")
    with pytest.raises(InvalidInput, match="object"):
        commanded_postures(replace(plan, body=None))
    with pytest.raises(InvalidInput, match="scale"):
        write_dexgraspbench(plan, tmp_path, "ball", scale=0.0)
    torque = [replace(drive, control="torque", stiffness=None) for drive in plan.hand.drives]
    other = replace(plan, hand=replace(plan.hand, drives=tuple(torque)))
    with pytest.raises(InvalidInput, match="stiffness"):
        grasp_rows(other, "ball")
    assert grasp_rows(other, "ball", stiffness=KP).n == 1
