"""Masses, inertias, limits and sizes that no hand has, as descriptions hold them: told, and mended where they can be."""

from __future__ import annotations

import re

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.cases.object_case import ObjectCase
from pinograsp.hands import Drive, load_hand
from pinograsp.hands.catalogue import CATALOGUE

A, B, C = 0.016, 0.012, 0.05  # [m] edges of a finger's link
M = 0.03  # [kg]


def inertial(mass, xx, yy, zz, z=C / 2):
    return (
        f'<inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


SOUND = inertial(M, M / 12 * (B**2 + C**2), M / 12 * (A**2 + C**2), M / 12 * (A**2 + B**2))


def write(
    folder,
    own=SOUND,
    *,
    kind="revolute",
    ends=(-0.3, 1.2),
    speed=3,
    effort=1,
    size=f"{A} {B} {C}",
    at="0.02 0 0.02",
    part="collision",
):
    """A palm and two fingers of one link each; ``part``: what its box is."""
    folder.mkdir(exist_ok=True)
    shape = f'<{part}><origin xyz="0 0 {C / 2}"/><geometry><box size="{size}"/></geometry></{part}>' if part else ""
    palm = '<collision><geometry><box size="0.08 0.1 0.02"/></geometry></collision>'
    text = f'<link name="palm">{inertial(0.4, 4e-4, 4e-4, 4e-4, 0)}{palm}</link>'
    for name, sign in (("left", 1), ("right", -1)):
        text += (
            f'<link name="{name}_link">{own}{shape}</link><joint name="{name}" type="{kind}"><parent link="palm"/>'
            f'<child link="{name}_link"/><origin xyz="{"" if sign > 0 else "-"}{at}"/><axis xyz="0 {-sign} 0"/>'
            f'<limit lower="{ends[0]}" upper="{ends[1]}" effort="{effort}" velocity="{speed}"/></joint>'
        )
    path = folder / "hand.urdf"
    path.write_text(f'<robot name="hand">{text}</robot>')
    return path


def notes_on(hand, *words):
    return [note for note in hand.notes if any(word in note for word in words)]


@pytest.mark.parametrize(
    ("mass", "moments"),
    [
        (0.05, (1, 1, 1)),
        (0.015, (1e-3, 1e-3, 1e-3)),
        (M, (0.02, 0.02, 1e-5)),
        (0.2, (0.03, 0.01, 0.03)),
        (M, (0, 0, 0)),
        (M, (1e-12, 1e-12, 1e-12)),
    ],
)
def test_a_placeholder_inertia_becomes_that_of_the_shape(tmp_path, mass, moments):
    hand = load_hand(write(tmp_path / "given", inertial(mass, *moments)))
    (note,) = notes_on(hand, "inertia")
    assert "left_link" in note and "right_link" in note
    # A homogeneous box, about its middle.
    box = mass / 12 * np.diag([B**2 + C**2, A**2 + C**2, A**2 + B**2])
    for own in hand.model.inertias.tolist()[1:]:
        assert own.mass == mass and own.lever == pytest.approx([0, 0, C / 2])
        assert own.inertia == pytest.approx(box, rel=1e-6, abs=1e-15)


def test_a_placeholder_does_not_decide_the_torques_of_a_plan(tmp_path):
    """The same hand with the inertia of its shapes needs the same torques, and no more than its motors have."""
    at = np.eye(4)
    at[2, 3] = 0.05
    ball = pg.Box(size=(0.02, 0.02, 0.04), mass=0.05).placed(at)
    peaks = []
    for name, own in (("sound", SOUND), ("placeholder", inertial(M, 1, 1, 1))):
        hand = load_hand(write(tmp_path / name, own))
        plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.8), progress=False)
        peaks.append(plan.motion.peak_torque)
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-6) and peaks[0] < 1


@pytest.mark.parametrize("part", ["visual", ""])
def test_a_placeholder_without_shapes_to_touch_is_told(tmp_path, part):
    hand = load_hand(write(tmp_path, inertial(M, 1, 1, 1), part=part))
    (note,) = notes_on(hand, "inertias")
    assert "left_link" in note and hand.model.inertias[1].inertia.max() < 1e-4  # a ball of water of 30 g: 4.5e-6


@pytest.mark.parametrize("mass", [0, 1e-9, 1e-6])
def test_a_placeholder_mass_becomes_that_of_the_shape(tmp_path, mass):
    hand = load_hand(write(tmp_path / "one", inertial(mass, 1e-12, 1e-12, 1e-12)))
    assert notes_on(hand, "masses")
    assert hand.finger_mass("left") == pytest.approx(1000 * A * B * C)
    if mass:
        kept = load_hand(write(tmp_path / "two", inertial(mass, 1e-12, 1e-12, 1e-12)), masses="file")
        assert notes_on(kept, "masses") and kept.finger_mass("left") == mass


def test_a_mass_above_that_of_any_metal_becomes_that_of_the_shape(tmp_path):
    given = inertial(30, 6e-3, 6e-3, 2e-3)
    hand = load_hand(write(tmp_path / "grams", given))
    (note,) = notes_on(hand, "grams")
    assert "left_link (30 kg" in note and "taken from the shapes" in note
    assert hand.finger_mass("left") == pytest.approx(1000 * A * B * C)
    kept = load_hand(write(tmp_path / "kept", given), masses="file")
    (note,) = notes_on(kept, "grams")
    assert "taken from" not in note and kept.finger_mass("left") == 30


def test_where_one_mass_cannot_be_no_other_is_above_that_of_steel(tmp_path):
    """A link of gold is left alone, unless the hand has one that is heavier than any metal."""
    gold = 15e3 * A * B * C
    own = inertial(gold, gold * 2e-4, gold * 2e-4, gold * 3e-5)
    path = write(tmp_path / "gold", own)
    hand = load_hand(path)
    assert not notes_on(hand, "grams") and hand.finger_mass("left") == pytest.approx(gold)
    path.write_text(path.read_text().replace(own, inertial(30, 6e-3, 6e-3, 2e-3), 1))
    (note,) = notes_on(load_hand(path), "grams")
    assert "left_link (30 kg" in note and "right_link" in note
    assert load_hand(path).finger_mass("right") == pytest.approx(1000 * A * B * C)


def test_moments_of_no_solid_are_told_and_kept(tmp_path):
    crooked = load_hand(write(tmp_path / "crooked", inertial(M, 1e-6, 1e-6, 1e-5)))
    assert "left_link" in notes_on(crooked, "sum of the others")[0]
    assert crooked.model.inertias[1].inertia == pytest.approx(np.diag([1e-6, 1e-6, 1e-5]))


@pytest.mark.parametrize(
    "own",
    [
        SOUND,
        "",
        inertial(0.08, 2e-5, 2e-5, 4e-6),  # of aluminium, or with a motor inside
        inertial(0.004, 1.4e-6, 1.4e-6, 5e-7),  # hollow
        inertial(0.02, 1e-5, 1e-5, 1e-6),  # rounded to one digit
    ],
)
def test_sound_masses_are_left_alone(tmp_path, own):
    hand = load_hand(write(tmp_path, own))
    assert not notes_on(hand, "inertia", "grams", "next to nothing")


# -- units -------------------------------------------------------------------------------------------------------------


def units(hand):
    return [note for note in hand.notes if note.startswith("units")]


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ({"ends": (0, 90)}, "(0, 1.571)"),
        ({"ends": (-30, 110)}, "(-0.5236, 1.92)"),
        ({"ends": (-180, 180)}, "(-3.142, 3.142)"),
        ({"kind": "prismatic", "ends": (0, 40)}, "(0, 0.04)"),
        ({"kind": "prismatic", "ends": (-12.5, 0)}, "(-0.0125, 0)"),
        ({"speed": 200}, "3.491"),
        ({"kind": "prismatic", "ends": (0, 0.04), "speed": 150}, "0.15"),
        ({"size": "16 12 50"}, "left_link"),
        ({"at": "20 0 20"}, "left"),
        ({"size": "16e-6 12e-6 50e-6"}, "0.0539 mm"),
    ],
)
def test_other_units_are_told_with_what_they_would_be(tmp_path, given, meant):
    (note,) = units(load_hand(write(tmp_path, "", **given)))
    assert meant in note


def test_limits_that_are_given_take_the_place_of_odd_ones(tmp_path):
    path = write(tmp_path, ends=(0, 90))
    limits = {"left": (0, np.pi / 2), "right": (0, np.pi / 2)}
    for hand in (load_hand(path, limits=limits), load_hand(path).with_limits(limits)):
        assert not units(hand) and hand.upper == pytest.approx([np.pi / 2] * 2)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"ends": (-2 * np.pi, 2 * np.pi)},
        {"ends": (-2.5, 9.25)},  # a winch
        {"ends": (-1e5, 1e5)},  # no limit
        {"speed": 40.3},
        {"speed": 1000},
        {"kind": "prismatic", "ends": (0, 0.3)},
        {"size": "0.02 0.02 0.6"},
    ],
)
def test_units_of_real_hands_are_left_alone(tmp_path, given):
    assert not units(load_hand(write(tmp_path, **given)))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("hey5", "baxter_left", "humanoid", "pr2_left") else pytest.mark.slow)
        for name in CATALOGUE
    ],
)
def test_what_the_catalogue_holds_is_told_where_it_is_so(name):
    """Hey5 has 0.001 kg m^2 for each of its links, most of 10 to 20 g; Baxter's fingers have 0.02 for 30 g."""
    hand = load_hand(name)
    told = notes_on(hand, "inertias", "grams", "masses next")
    assert not units(hand) and bool(told) == (name in ("hey5", "baxter_left", "baxter_right"))


# -- joints that only have play ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "effort", "odd"),
    [("revolute", 0.05, True), ("revolute", 1, False), ("revolute", 20, False), ("revolute", 1000, True)]
    + [("prismatic", 0.1, True), ("prismatic", 10, False), ("prismatic", 230, False), ("prismatic", 1000, True)],
)
def test_efforts_of_no_hand_are_told_as_forces_at_a_fingertip(tmp_path, kind, effort, odd):
    """The corner of the link that is farthest from its axis is 5.1 cm away; limits of plans are as they were."""
    ends = (-0.3, 1.2) if kind == "revolute" else (0, 0.03)
    hand = load_hand(write(tmp_path, kind=kind, effort=effort, ends=ends))
    told = notes_on(hand, "effort limits that look like placeholders")
    assert bool(told) == odd and hand.effort.tolist() == [effort, effort]
    if odd:
        force = float(re.search(r"\(([\d.e+]+) N at a fingertip", told[0])[1])
        least, most = (effort, effort) if kind == "prismatic" else (0.95 * effort / 0.054, effort / 0.05)
        assert 0.95 * least <= force <= 1.05 * most
        assert "left" in told[0] and "right" in told[0]


@pytest.mark.parametrize(("armature", "odd"), [(0.01, False), (1.0, True)])
def test_inertias_of_motors_that_no_hand_has_are_told_as_masses(tmp_path, armature, odd):
    """At 50 to 54 mm from the axis 1 kg m^2 is as 343 to 400 kg."""
    path = write(tmp_path)
    path.write_text(path.read_text().replace("</joint>", f'<dynamics armature="{armature}"/></joint>'))
    hand = load_hand(path)
    assert hand.model.armature.tolist() == [armature, armature]
    told = notes_on(hand, "motors' inertias")
    assert bool(told) == odd
    if odd:
        assert 330 <= float(re.search(r"as ([\d.e+]+) kg at a fingertip", told[0])[1]) <= 400


def test_a_limit_that_is_known_is_no_placeholder(tmp_path):
    source = pg.hands.Source(figure="limit", text="a manual")
    drives = [Drive(name=n, joints=(n,), arms=(1.0,), limit=0.05, sources=(source,)) for n in ("left", "right")]
    assert not notes_on(load_hand(write(tmp_path, effort=0.05), drives=drives), "placeholders")


def with_play(folder, kind, ends):
    path = write(folder)
    tip = f'<link name="tip">{SOUND}<collision><geometry><sphere radius="0.008"/></geometry></collision></link>'
    joint = (
        f'<joint name="play" type="{kind}"><parent link="left_link"/><child link="tip"/><origin xyz="0 0 {C}"/>'
        f'<axis xyz="1 0 0"/><limit lower="{ends[0]}" upper="{ends[1]}" effort="0" velocity="0"/></joint>'
    )
    path.write_text(path.read_text().replace("</robot>", f"{tip}{joint}</robot>"))
    return load_hand(path)


@pytest.mark.parametrize(
    ("kind", "ends", "stays"),
    [
        ("prismatic", (0, 1e-5), 0),
        ("prismatic", (-5e-5, 5e-5), 0),
        ("revolute", (0, 5e-4), 0),
        ("prismatic", (0.00201, 0.00202), 0.00201),
    ],
)
def test_joints_with_next_to_no_way_to_go_are_fixed(tmp_path, kind, ends, stays):
    hand = with_play(tmp_path, kind, ends)
    assert hand.joint_names == ("left", "right") and any("fixed: play" in note for note in hand.notes)
    (tip,) = hand.frame_placements([0, 0], ["tip"])
    assert tip[0, 3] == pytest.approx(0.02 + stays) and hand.passive_joints == ()


@pytest.mark.parametrize(("kind", "ends"), [("prismatic", (0, 2e-3)), ("revolute", (0, 0.05))])
def test_joints_with_some_way_to_go_stay(tmp_path, kind, ends):
    assert "play" in with_play(tmp_path, kind, ends).joint_names


@pytest.mark.parametrize("name, given, kept", [("pr2_left", 30.0, 30.0), ("panda", 1e3, None)])
def test_a_limit_that_is_said_takes_the_place_of_a_placeholder(name, given, kept):
    """PR2's file says 1000 N m for each finger; the Panda's limit is its maker's."""
    case = ObjectCase.of(hand=name, object="sphere:radius=0.03,mass=0.18", torque_limit=given, samples=4)
    plan = case.plan(progress=False)
    np.testing.assert_allclose(plan.torque_limit, plan.hand.effort if kept is None else kept)
