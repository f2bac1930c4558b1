"""Functions about hands, called with arguments of kinds that they do not take."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp.contacts import fingertips
from pinograsp.data import joint_axes
from pinograsp.errors import InvalidInput
from pinograsp.hands import Drive, load_hand, ratios_of, servo_gains

WRONG = [5, True, "x", b"x", [1, "a"], {"a": object()}, object(), 1j, np.zeros((2, 3)), {1, 2}, lambda: 0]
DRIVE = Drive(name="motor", joints=("a",), arms=(1.0,))


@pytest.fixture(scope="module")
def hand():
    return load_hand("humanoid", root="index_proximal")


@pytest.mark.parametrize("wrong", WRONG)
def test_they_are_refused_in_our_words(hand, wrong):
    for call in (
        lambda: ratios_of(wrong, (DRIVE,)),
        lambda: ratios_of(("a",), wrong),
        lambda: servo_gains(wrong),
        lambda: joint_axes(wrong),
        lambda: joint_axes(hand, at=wrong),
        lambda: joint_axes(hand, at={hand.joint_names[0]: wrong} if not isinstance(wrong, int) or wrong is True else 5),
        lambda: fingertips(wrong, hand.model.createData()),
        lambda: fingertips(hand, wrong),
        lambda: load_hand(hand.source, root="index_proximal", srdf="a\0b"),
    ):
        with pytest.raises(InvalidInput):
            call()


def test_drives_and_data_of_another_hand_are_refused(hand):
    with pytest.raises(InvalidInput, match="motor"):
        ratios_of(("b",), (DRIVE,))
    with pytest.raises(InvalidInput, match="createData"):
        fingertips(hand, load_hand("humanoid").model.createData())
    assert ratios_of(("a",), (DRIVE,)) == () and len(ratios_of(("a", "b"), (DRIVE,))) == 1
