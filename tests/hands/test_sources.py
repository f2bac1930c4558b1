"""Where the figures of drives come from: every one of the catalogue has a source, or is called a guess."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from shipped_hands import loaded

from pinograsp.errors import InvalidInput
from pinograsp.hands import Drive, Source, load_hand
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.hands.summary import record

FIGURES = ("limit", "stiffness", "damping", "step", "backlash", "latency", "friction", "effort_step", "continuous")


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_figure_has_a_source_and_is_shown_with_it(name):
    hand = loaded(name)
    shown, plain = hand.describe(), json.loads(json.dumps(record(hand), allow_nan=False))
    for drive, values in zip(hand.drives, plain["drives"], strict=True):
        known = [figure for figure in FIGURES if values[figure] is not None]
        assert [source["figure"] for source in values["sources"]] == known
        for figure in known:
            source, value = drive.source(figure), getattr(drive, figure)
            assert source.text in shown and ("a guess" in str(source)) == source.guess
            low, high = source.interval or (value, value)
            assert low <= value <= high
    kept = hand_record(hand)
    assert json.loads(json.dumps(kept["drives"])) == kept["drives"] and hand_of(kept).drives == hand.drives


def test_limits_of_makers():
    """Wonik: 0.7 N m a joint; Franka: 70 N of each jaw, so 140 N on the joint that both slide along."""
    assert loaded("allegro_left").effort == pytest.approx(np.full(16, 0.7))
    panda = loaded("panda")
    assert panda.drives[0].limit == 70.0 and panda.effort == pytest.approx([140.0])
    assert not any(
        loaded(name).drives[0].source("limit").guess for name in ("allegro_right", "panda", "so101", "g1_left")
    )
    assert all(loaded(name).drives[0].source("limit").guess for name in ("pr2_left", "hey5", "talos_left", "sake_left"))
    # 30 N at a fingertip: by the arm of a force there on the one joint that moves both.
    jaws = loaded("tiago_pro_left")
    assert jaws.drives[0].limit == jaws.effort[0] == 6.0 and jaws.drives[0].source("limit").guess
    assert not any(note.startswith("effort limits that look like placeholders") for note in jaws.notes)


def test_stiffness_of_a_servo_as_identified():
    """duty = 0.165/rad P, torque = k_t / R V duty, with k_t = 2.5 N m/A, R = 5.49 ohm at 12 V (and 1.21, 2.68 at 7.4 V)."""
    servo = loaded("so101").drives[0]
    assert servo.stiffness == pytest.approx(2.5 / 5.489 * 12.0 * 0.165 * 16, rel=0.01)
    assert servo.source("stiffness").interval == pytest.approx((1.2116 / 2.6762 * 7.4 * 0.165 * 16, 28.9), rel=0.02)
    assert servo.damping == pytest.approx(2.5**2 / 5.489 + 0.041, rel=0.05)
    assert servo.step == pytest.approx(2 * math.pi / 4096)


def test_drives_of_the_user_are_without_those_of_the_catalogue():
    own = Drive(name="gripper", joints=("gripper",), arms=(1.0,), limit=1.0)
    (drive,) = load_hand("so101", drives=[own]).drives
    assert drive == own and not drive.sources
    stated = Source(figure="limit", text="a spring balance", interval=(0.9, 1.1))
    own = Drive(name="gripper", joints=("gripper",), arms=(1.0,), limit=1.0, sources=(stated,))
    assert "limit (0.9 to 1.1): a spring balance" in load_hand("so101", drives=[own]).describe()


@pytest.mark.parametrize(
    "given",
    [
        {"figure": "speed", "text": "x"},
        {"figure": "limit", "text": ""},
        {"figure": "limit", "text": 3},
        {"figure": "limit", "text": "x", "guess": 1},
        {"figure": "limit", "text": "x", "interval": (2.0, 1.0)},
        {"figure": "limit", "text": "x", "interval": (-1.0, 1.0)},
        {"figure": "limit", "text": "x", "interval": (float("nan"), 1.0)},
        {"figure": "limit", "text": "x", "interval": (0.0, float("inf"))},
        {"figure": "limit", "text": "x", "interval": 1.0},
        {"figure": "limit", "text": "x", "interval": "ab"},
    ],
)
def test_sources_that_are_none(given):
    with pytest.raises(InvalidInput, match="source|interval"):
        Source(**given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"step": 0.0}, "step of drive 'm'"),
        ({"step": -1.0}, "step of drive 'm'"),
        ({"step": "fine"}, "step of drive 'm'"),
        ({"sources": "limit"}, "sources of drive 'm'"),
        ({"sources": [1]}, "sources of drive 'm'"),
        ({"sources": 2 * (Source(figure="limit", text="x"),)}, "each once"),
    ],
)
def test_drives_with_figures_that_are_none(given, message):
    with pytest.raises(InvalidInput, match=message):
        Drive(name="m", joints=("a",), arms=(1.0,), **given)


@pytest.mark.parametrize("broken", [3, [1], [{}], [{"figure": "x", "text": "y"}], [{"figure": "limit", "text": 2}]])
def test_records_with_broken_sources(broken):
    plain = hand_record(loaded("so101"))
    plain["drives"][0]["sources"] = broken
    with pytest.raises(InvalidInput, match="hand record"):
        hand_of(plain)
