"""Data sheets of drives: written, read, merged, and refused."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from shipped_hands import loaded

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.hands import Source
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.hands.sheets import list_sheets, read_sheet, write_sheet
from pinograsp.planner import plan_best


@pytest.mark.parametrize("name", CATALOGUE)
def test_sheets_of_the_catalogue_come_back(name, tmp_path):
    hand = loaded(name)
    (tmp_path / "a.toml").write_text(write_sheet(hand.drives, hand.name))
    assert pg.load_hand(name, drives=tmp_path / "a.toml").drives == hand.drives


@pytest.mark.parametrize("name", list_sheets())
def test_shipped_sheets_are_read_and_every_figure_has_a_source(name):
    (values,) = read_sheet(name)
    told = {source["figure"] for source in values["sources"]}
    assert told == values.keys() - {"name", "control", "sources"}
    hand = pg.load_hand("panda" if name == "franka_hand" else "allegro_right", drives=name)
    for drive in hand.drives:
        for source in drive.sources:
            if source.interval is not None:
                low, high = source.interval
                assert low * (1 - 1e-3) <= getattr(drive, source.figure) <= high * (1 + 1e-3)
        if drive.effort_step is not None:
            assert 100 < drive.limit / drive.effort_step < 5000  # units of a register from nothing to all


def test_a_sheet_beside_the_file_is_read_by_itself_and_a_change_of_it_is_seen(tmp_path):
    shutil.copy(file_of("humanoid"), tmp_path / "hand.urdf")
    plain = pg.load_hand(tmp_path / "hand.urdf")
    sheet = tmp_path / "hand.drives.toml"
    sheet.touch()  # as a shell does before the command that is to fill it
    assert pg.load_hand(tmp_path / "hand.urdf").drives == plain.drives
    for limit in (0.3, 0.4):
        sheet.write_text(f'[[drives]]\nname = "index_*"\nlimit = {limit}\nlatency = 0.05\n')
        hand = pg.load_hand(tmp_path / "hand.urdf")
        for drive, before in zip(hand.drives, plain.drives, strict=True):
            changed = drive.name.startswith("index_")
            assert drive == (replace(before, limit=limit, latency=0.05) if changed else before)
        assert any("hand.drives.toml" in note for note in hand.notes)
    np.testing.assert_array_equal(
        pg.load_hand(tmp_path / "hand.urdf", drives=plain.drives).transmission, plain.transmission
    )


def test_figures_that_are_replaced_lose_their_source_and_others_keep_it(tmp_path):
    before = pg.load_hand("so101").drives[0]
    (tmp_path / "a.toml").write_text('[[drives]]\nname = "*"\nlimit = 1.0\n')
    drive = pg.load_hand("so101", drives=tmp_path / "a.toml").drives[0]
    assert drive.source("limit") is None and drive.source("stiffness") == before.source("stiffness")


def test_patterns_fit_drives_of_fingers_alone(tmp_path):
    text = '<robot name="r"><link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    for parent, child in (("base", "arm"), ("arm", "a"), ("arm", "b")):
        text += (
            f'<link name="{child}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0"'
            ' iyz="0"/></inertial><collision><origin xyz="0.03 0 0"/><geometry><sphere radius="0.01"/></geometry>'
            f'</collision></link><joint name="j_{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 {0.03 if child == "a" else -0.03 if child == "b" else 0} 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" effort="5" velocity="1"/></joint>'
        )
    (tmp_path / "a.toml").write_text('[[drives]]\nname = "*"\nlimit = 0.5\n')
    hand = pg.load_hand(text + "</robot>", palm="arm", drives=tmp_path / "a.toml")
    assert {drive.name: drive.limit for drive in hand.drives} == {"j_arm": 5.0, "j_a": 0.5, "j_b": 0.5}


def test_drives_with_all_figures_are_kept_in_records(tmp_path):
    closing = ClosingTable(
        speeds=(1.0, 2.0),
        limits=(0.0, 5.0),
        peaks=(1.0, 2.0),
        low=(0.5, 1.5),
        high=(2.0, 3.0),
        trials=(3, 4),
        position=0.0,
    )
    drive = replace(
        pg.load_hand("so101").drives[0],
        continuous=0.5,
        effort_step=0.01,
        backlash=0.02,
        friction=0.1,
        latency=0.05,
        closing=closing,
        contact_stiffness=(0.5, 2.0),
        sources=(Source(figure="closing", text="a log", date="2026-11-28"),),
    )
    hand = pg.load_hand("so101").with_drives([drive])
    assert hand_of(hand_record(hand)).drives == (drive,)
    (tmp_path / "a.toml").write_text(write_sheet(hand.drives, "so101"))
    assert pg.load_hand("so101", drives=tmp_path / "a.toml").drives == (drive,)
    shown = hand.describe()
    for text in (
        "continuous 0.5",
        "backlash 0.02",
        "latency",
        "closing on a stop: 1 to 2 N",
        "0.5 to 2 times as stiff",
        "2026-11-28",
    ):
        assert text in shown


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "drives"),
        ("[[drives]]\nlimit = 1", "name"),
        ('[[drives]]\nname = "*"\nlimt = 1', "did you mean 'limit'"),
        ('[[drives]]\nname = "elbow"\nlimit = 1', "expected drives of hand"),
        ('[[drives]]\nname = "*"\nlimit = -1', "limit of drive"),
        ('[[drives]]\nname = "*"\nlimit = "much"', "limit of drive"),
        ('[[drives]]\nname = "*"\nlimit = nan', "limit of drive"),
        ('[[drives]]\nname = "*"\ncontinuous = 99.0', "continuous effort"),
        ('[[drives]]\nname = "*"\nclosing = 3', "closing"),
        ('[[drives]]\nname = "*"\n[drives.closing]\nspeeds = [1]', "closing"),
        ('[[drives]]\nname = "*"\n[[drives.sources]]\nfigure = "limit"', "source"),
        ('[[drives]]\nname = "*"\n[[drives.sources]]\nfigure = "limit"\ntext = "a"\ndate = "May"', "YYYY"),
        ("drives = 3", "drives"),
        ("[hand]\nname = 1", "[[drives]] alone"),
        ("a = ", "TOML"),
        ("a" * 10, "TOML"),
    ],
)
def test_broken_sheets_are_refused(tmp_path, content, told):
    (tmp_path / "a.toml").write_text(content)
    with pytest.raises(InvalidInput, match=told.replace("[", r"\[")):
        pg.load_hand("so101", drives=tmp_path / "a.toml")


def test_missing_sheets_are_refused_with_those_there_are(tmp_path):
    with pytest.raises(InvalidInput, match="did you mean 'leap'"):
        pg.load_hand("so101", drives="leep")
    with pytest.raises(InvalidInput, match="cannot read it"):
        pg.load_hand("so101", drives=tmp_path / "none.toml")


@pytest.mark.slow
def test_reserves_take_the_intervals_of_sheets(tmp_path):
    """Jaws that may be 20 % weak press with a fifth more, and with 0.3 where nobody has measured it."""
    body, sums = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2), {}
    sheet = '[[drives]]\nname = "jaws"\neffort_step = 1.0\n[[drives.sources]]\nfigure = "effort_step"\ntext = "a log"\n'
    for name, more in (("known", "interval = [0.8, 1.1]\n"), ("not known", "")):
        (tmp_path / "a.toml").write_text(sheet + more)
        hand = pg.load_hand("panda", drives=tmp_path / "a.toml")
        hand = hand.with_drives([replace(hand.drives[0], control="torque")])
        for drive in ("sheet", {"known": 0.2, "not known": 0.3}[name]):
            conditions = pg.GraspConditions(mu=0.5, reserve=pg.Reserve(drive=drive))
            plan = plan_best(pg.find_grasps(hand, body, conditions, count=2, seed=1), conditions)
            sums.setdefault(name, []).append(plan.forces.normal_forces.sum())
            assert plan.reserve.drive == pytest.approx({"known": 0.2, "not known": 0.3}[name])
        assert sums[name][0] == pytest.approx(sums[name][1], rel=1e-3)
    with pytest.raises(InvalidInput, match="share"):
        pg.Reserve(drive="guess")


def test_reserves_take_the_contacts_stiffness_of_sheets(tmp_path):
    """The widest of the drives' intervals, as numbers in the plan's record."""
    (tmp_path / "a.toml").write_text('[[drives]]\nname = "jaws"\ncontact_stiffness = [0.8, 1.5]\n')
    hand, body = pg.load_hand("panda", drives=tmp_path / "a.toml"), pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
    reserve = pg.Reserve(softer="sheet", stiffer="sheet")
    assert reserve.of_hand(hand) == pg.Reserve(softer=1.25, stiffer=1.5)
    assert pg.Reserve(softer=3.0, stiffer="sheet").of_hand(hand) == pg.Reserve(softer=3.0, stiffer=1.5)
    conditions = pg.GraspConditions(mu=0.5, reserve=reserve)
    plan = plan_best(pg.find_grasps(hand, body, conditions, count=2, seed=1), conditions)
    assert (plan.reserve.softer, plan.reserve.stiffer) == (1.25, 1.5)
    with pytest.raises(InvalidInput, match="contact_stiffness is known"):
        reserve.of_hand(pg.load_hand("allegro_right"))
    with pytest.raises(InvalidInput, match="of_hand"):
        reserve.stiffness_factors  # noqa: B018
    for odd in ([1.5, 2.0], [0.0, 2.0], [0.5, 0.9]):
        (tmp_path / "a.toml").write_text(f'[[drives]]\nname = "jaws"\ncontact_stiffness = {odd}\n')
        with pytest.raises(InvalidInput, match="contact_stiffness"):
            pg.load_hand("panda", drives=tmp_path / "a.toml")
