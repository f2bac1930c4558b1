"""Commands in register units: what is written is what the drives make, to a unit."""

from __future__ import annotations

import csv
import secrets
from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.handover import closing_commands
from pinograsp.handover.jaws import group_contacts
from pinograsp.hands.sheets import apply_sheet
from pinograsp.planner import plan_best

CONDITIONS = pg.GraspConditions(mu=0.7)


@pytest.fixture(scope="module")
def plan():
    hand = pg.load_hand("allegro_right", drives="leap")
    return plan_best(pg.find_grasps(hand, pg.Sphere(radius=0.03, mass=0.12), CONDITIONS, count=8, seed=1), CONDITIONS)


def read(path):
    with path.open(newline="") as stream:
        head, *rows = csv.reader(stream)
    return head, np.array(rows, dtype=float)


def test_units_times_their_worth_are_the_drives_commands(plan, tmp_path):
    plain = plan.to_csv(tmp_path / "si.csv", command="torque")
    told = plan.to_csv(tmp_path / "r.csv", command="torque", units="register")
    head, rows = read(tmp_path / "r.csv")
    m, drive = len(plan.hand.drives), plan.hand.drives[0]
    assert head[:2] == ["time", "joint_0.0/position"] and head[-1] == "joint_15.0/effort"
    np.testing.assert_array_equal(rows[:, 0], plain.times)
    np.testing.assert_array_equal(rows[:, 1:], np.rint(rows[:, 1:]))
    np.testing.assert_allclose(rows[:, 1 : 1 + m] * drive.step, plain.q, atol=drive.step / 2 * (1 + 1e-9))
    np.testing.assert_allclose(
        rows[:, 1 + m :] * drive.effort_step, plain.effort, atol=drive.effort_step / 2 * (1 + 1e-9)
    )
    assert any("unit of the effort registers" in note for note in told.notes)
    plan.to_csv(tmp_path / "p.csv", command="position", units="register", stiffness=5.0)
    head, rows = read(tmp_path / "p.csv")
    assert len(head) == 1 + m
    ahead = plan.to_csv(tmp_path / "si.csv", command="position", stiffness=5.0).q
    np.testing.assert_allclose(rows[:, 1:] * drive.step, ahead, atol=drive.step / 2 * (1 + 1e-9))


def test_coarse_registers_are_told(plan, tmp_path):
    coarse = replace(plan, hand=plan.hand.with_drives([replace(one, effort_step=0.05) for one in plan.hand.drives]))
    assert any(
        "rounding changes its effort by up to" in note
        for note in coarse.to_csv(tmp_path / "a.csv", command="torque", units="register").notes
    )


def test_closing_drives_get_speed_and_limit(plan, tmp_path):
    hand = apply_sheet(plan.hand, "inspire_rh56")
    first = {
        drive.name: drive.closing for drive in hand.drives if drive.name in ("joint_0.0", "joint_4.0", "joint_12.0")
    }
    fingers = hand.with_drives([replace(one, closing=first.get(one.name)) for one in hand.drives])
    closing = replace(plan, hand=fingers)
    pressed = {finger.name: 0.0 for finger in hand.fingers}
    for link, force in zip(plan.contacts.links, plan.forces.normal_forces):
        (finger,) = [finger.name for finger in hand.fingers if link in (*finger.links, finger.tip)]
        pressed[finger] += force
    found = closing_commands(closing)
    closing.to_csv(tmp_path / "c.csv", command="jaw", units="register")
    with (tmp_path / "c.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["drive"] for row in rows] == [one.drive for one in found]
    for row, one in zip(rows, found, strict=True):
        assert row["position"] == "0"  # the closed end of an Inspire's angles
        assert float(row["force_N"]) == pytest.approx(one.force)
        assert min(abs(one.force - force) for force in pressed.values()) < 1e-9
        speed, limit = float(row["speed"]), int(row["limit"])  # a register takes whole numbers, rounded up
        table = first[one.drive]
        assert table.predict(speed, limit).value == pytest.approx(float(row["expected_N"]))
        assert limit - 1 < min(table.limits) or table.predict(speed, limit - 1).value < one.force
        assert float(row["expected_N"]) >= one.force * (1 - 1e-9)


def test_fingers_that_press_with_less_than_they_can_are_told(plan):
    table = apply_sheet(plan.hand, "inspire_rh56").drives[0].closing
    strong = replace(
        table, **{key: tuple(100 * one for one in getattr(table, key)) for key in ("peaks", "low", "high")}
    )
    hand = plan.hand.with_drives([replace(one, closing=strong) for one in plan.hand.drives])
    with pytest.raises(InvalidInput, match="plan for more"):
        closing_commands(replace(plan, hand=hand))


@pytest.mark.slow
def test_caps_are_kept_with_what_fingers_come_to_when_they_close():
    """A finger that closes until a limit comes to more than its median in some closings: those keep the cap, too."""
    ball, capped = pg.Sphere(radius=0.03, mass=0.4), replace(CONDITIONS, max_normal_force=6.0)
    hand = pg.load_hand("psyonic_right")
    found = pg.find_grasps(hand.with_drives(apply_sheet(hand, "inspire_rh56").drives), ball, capped, count=8, seed=1)
    plan = plan_best(found, capped)
    caps = plan.problem.max_normal_force
    assert np.all(caps <= 6.0) and np.any(caps < 6.0)
    assert any("asked for" in note for note in plan.notes)
    table = plan.hand.drives[0].closing
    parts = group_contacts(plan.hand, plan.contacts.links)
    pressing = {name: float(plan.forces.normal_forces[rows].sum()) for name, rows in parts.items() if name}
    strong = {name: force for name, force in pressing.items() if force > min(table.peaks)}
    assert strong and all(table.find_command(strong[name]).peak.high <= 6.0 * len(parts[name]) for name in strong)
    strongest = table.find_strongest(4.0)
    assert strongest.peak.high <= 4.0 and strongest.peak.value >= table.find_touch(2.0).peak.value
    with pytest.raises(InvalidInput, match="gentlest"):
        table.find_strongest(0.9)
    speed, depth = plan.solution.profile.impact_speed, plan.problem.compliance.depth(np.full(plan.problem.k, 6.0))
    assert np.all(speed * 0.066 <= depth) and any("latency" in note for note in plan.notes)
    with pytest.raises(InvalidInput, match="final time"):
        plan_best(found, replace(capped, final_time=0.13, impact_time_range=(0.05, 0.1)))
    with pytest.raises(InvalidInput, match=r"drive .* gentlest"):
        plan_best(found, replace(capped, max_normal_force=0.3))


def test_what_has_no_registers_is_refused(plan, tmp_path):
    with pytest.raises(InvalidInput, match="expected with a command"):
        plan.to_csv(tmp_path / "a.csv", units="register")
    with pytest.raises(InvalidInput, match="units"):
        plan.to_csv(tmp_path / "a.csv", command="torque", units="counts")
    bare = replace(plan, hand=pg.load_hand("allegro_right"))
    with pytest.raises(InvalidInput, match="effort_step is known"):
        bare.to_csv(tmp_path / "a.csv", command="torque", units="register")
    with pytest.raises(InvalidInput, match="closing table"):
        plan.to_csv(tmp_path / "a.csv", command="jaw", units="register")
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.slow
def test_more_than_a_drive_holds_for_long_and_less_than_its_backlash_are_cautions():
    hand, body = pg.load_hand("panda", drives="franka_hand"), pg.Box(size=(0.04, 0.04, 0.06), mass=1.5)
    conditions, force, seed = pg.GraspConditions(mu=0.3), 70.0, secrets.randbelow(10**6)
    for share in (None, 0.9, 1.1):  # of the force of each jaw
        drives = hand.drives if share is None else [replace(one, continuous=share * force) for one in hand.drives]
        found = pg.find_grasps(hand.with_drives(drives), body, conditions, count=4, seed=seed)
        heavy = plan_best(found, conditions)
        asked = heavy.forces.normal_forces.sum() / 2
        continuous = drives[0].continuous
        assert any("continuous effort" in caution for caution in heavy.cautions) == (asked > continuous), seed
        force = asked if share is None else force
        assert asked == pytest.approx(force, rel=0.02), seed
    drive = pg.load_hand("so101").drives[0]
    loose = pg.load_hand("so101").with_drives([replace(drive, backlash=1.0)])
    grasps = pg.find_grasps(loose, pg.Sphere(radius=0.02, mass=0.05), CONDITIONS, count=4, seed=1)
    assert any("backlash" in caution for caution in plan_best(grasps, CONDITIONS).cautions)


def test_grippers_that_cannot_press_so_gently_say_so():
    hand, conditions = pg.load_hand("panda", drives="robotiq_2f85"), pg.GraspConditions(mu=0.6)
    for mass, gentle in ((0.1, True), (1.6, False)):
        grasps = pg.find_grasps(hand, pg.Box(size=(0.04, 0.04, 0.06), mass=mass), conditions, count=4, seed=1)
        held = plan_best(grasps, conditions)
        assert (held.forces.normal_forces.sum() / 2 < 20) == gentle
        assert any("closes with 20 N at least" in text for text in held.cautions) == gentle
