"""What callers hand in: numbers that are none, shapes and records that do not fit, each refused in words of the
package's own.
"""

from __future__ import annotations

import datetime
import fractions
from collections import UserDict

import numpy as np
import pytest
from conftest import POINTS

import pinograsp as pg
from pinograsp import checks
from pinograsp.errors import InvalidInput

HUGE = 10**400
NO_NUMBERS = [
    HUGE,
    "0.5",
    b"1",
    True,
    1j,
    None,
    np.datetime64("2020-01-01"),
    np.ma.masked,
    [0.5],
    {0.5},
    datetime.timedelta(1),
    float,
    object(),
]
NO_VECTORS = [
    "abc",
    [1, 2, [3]],
    ["1", "2", "3"],
    [1j, 2, 3],
    [True, False, True],
    np.ones(3, dtype=complex),
    np.zeros(3, dtype="m8[s]"),
    [HUGE, 0, 0],
    {1, 2, 3},
    (float(i) for i in range(3)),
    np.ma.masked_array([1.0, 2.0, 3.0], mask=[0, 1, 0]),
    None,
    {0: 1.0},
    np.zeros(2),
    [1.0, np.nan, 2.0],
    [None] * 3,
]


@pytest.mark.parametrize("value", NO_NUMBERS, ids=lambda value: f"{value!r:.20}")
def test_what_is_no_number_is_refused(value):
    with pytest.raises(InvalidInput, match=r"^length: expected a finite number > 0 \[m\], got "):
        checks.number("length", value, above=0, unit="m")


@pytest.mark.parametrize(
    "value",
    [2, 2.0, np.float32(2), np.int8(2), np.array(2), fractions.Fraction(2)],
    ids=lambda value: type(value).__name__,
)
def test_every_real_number_is_taken(value):
    assert checks.number("length", value) == 2.0


@pytest.mark.parametrize("value", NO_VECTORS, ids=lambda value: f"{value!r:.20}")
def test_what_is_no_vector_is_refused(value):
    with pytest.raises(InvalidInput, match="^load: expected "):
        checks.array_of("load", value, (3,))


@pytest.mark.parametrize(
    "value",
    [
        [1, 2, 3],
        range(1, 4),
        np.array([1, 2, 3], dtype=">i2"),
        np.ma.masked_array([1, 2, 3]),
        [fractions.Fraction(1), 2, 3],
    ],
)
def test_every_vector_of_numbers_is_taken(value):
    assert checks.array_of("load", value, (3,)).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "check", [lambda: checks.array_of("x", [[1, 2], [3]], (2, 2)), lambda: checks.one_of("x", "a", ["b"])]
)
def test_rows_of_several_lengths_and_unknown_choices_are_refused(check):
    with pytest.raises(InvalidInput, match="^x: expected "):
        check()


def test_integers_flags_texts_and_paths():
    assert checks.integer("count", np.int64(3), at_least=1) == 3
    for value in (3.0, "3", True, 0, 10, None, np.array([3])):
        with pytest.raises(InvalidInput, match="^count: expected an integer >= 1 and <= 9, got "):
            checks.integer("count", value, at_least=1, at_most=9)
    assert checks.flag("wrap", np.True_) is True
    for check, values in (
        (checks.flag, (0, 1, "no", None)),
        (checks.text_of, (b"a", 1, None)),
        (checks.path_of, (1, "", b"a", None)),
    ):
        for value in values:
            with pytest.raises(InvalidInput, match="^it: expected "):
                check("it", value)
    assert checks.mapping_of("points", UserDict(a=1)) == {"a": 1}
    for value in ({1: 2}, ["a"], "a"):
        with pytest.raises(InvalidInput):
            checks.mapping_of("points", value)


@pytest.mark.parametrize(
    "value",
    ["x" * 10**6, list(range(10**6)), 10**5000, [["y" * 1000] * 1000], np.zeros((300, 300))],
    ids=lambda value: type(value).__name__,
)
def test_values_are_shortened_in_messages(value):
    with pytest.raises(InvalidInput) as refused:
        checks.instance_of("hand", value, pg.HandModel)
    assert len(str(refused.value)) < 1000 and "\n" not in str(refused.value)


def test_points_far_from_the_surface_are_refused_whatever_the_tolerance(cylinder):
    for tolerance in (np.nan, "1", -1.0, None):
        with pytest.raises(InvalidInput, match="tolerance"):
            pg.contacts_at(None, cylinder, [[5.0, 0.0, 0.06]], tolerance=tolerance)


@pytest.mark.parametrize("frame", [2 * np.eye(3), np.eye(3)[::-1], np.zeros((3, 3)), np.full((3, 3), 1e308)])
def test_contact_frames_are_rotations(contacts, frame):
    first = contacts[0]
    with pytest.raises(InvalidInput, match="contact frame of 'thumb': expected an orthonormal right-handed rotation"):
        pg.contacts.Contact(
            finger=first.finger, link=first.link, point_o=first.point_o, rotation_oc=frame, length=None, distance=0.0
        )


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"mu": [0.5, [0.5]]}, "mu"),
        ({"mu": "0.7"}, "mu"),
        ({"mu": np.ma.masked_array([0.7, 0.7, 0.7], mask=[1, 0, 0])}, "mu"),
        ({"load": np.ones(6) * 1j}, "load"),
        ({"max_normal_force": HUGE}, "largest normal forces"),
        ({"final_time": HUGE}, "final time"),
        ({"compliance": 5e4}, "compliance: expected a Compliance"),
        ({"object": "cylinder"}, "object: expected a Body"),
        ({"contacts": None}, "contacts: expected a ContactSet"),
        ({"balance": ["wrench"]}, "balance"),
    ],
)
def test_problems(contacts, settings, message):
    with pytest.raises(InvalidInput, match=message):
        pg.ForceProblem(**{"contacts": contacts, "load": np.zeros(6), "mu": 0.7, **settings})


@pytest.mark.parametrize(
    "settings",
    [
        {"mu": np.ones((3, 2))},
        {"low": "0"},
        {"high": np.ones((2, 3)) * 1j},
        {"counts": [1.5]},
        {"counts": "3"},
        {"energies": [("work", 1)]},
        {"energies": {"work": "a"}},
        {"moment_lengths": [1, 2, 3]},
        {"friction": "cone"},
        {"rotations": np.ones((1, 3, 3, 3))},
    ],
)
def test_batches(contacts, settings):
    plain = {
        "points": contacts.points_o[None],
        "rotations": contacts.rotations_oc[None],
        "loads": np.zeros((1, 6)),
        "mu": 0.7,
        "low": 0.0,
        "high": 9.0,
    }
    pg.ForceBatch(**plain)
    with pytest.raises(InvalidInput, match=f"{next(iter(settings)).split('_')[0]}|terms of the work"):
        pg.ForceBatch(**plain | settings)


@pytest.mark.parametrize("samples", [2.5, 10**30, "13", None, True, 0, [13]])
def test_samples_of_a_motion(samples):
    with pytest.raises(InvalidInput, match="samples: expected an integer"):
        pg.MotionSpec(samples=samples)


def test_postures_records_and_names(hand, contacts, cylinder):
    for call, message in (
        (lambda: pg.torque_limits(hand, contacts, "abc"), "^q: expected numbers"),
        (lambda: pg.torque_limits(None, contacts, np.zeros(20)), "^hand: expected a HandModel, got None"),
        (lambda: pg.close_hand(hand, "ball"), "^body: expected a Body"),
        (lambda: pg.close_hand(hand, cylinder, wrap="no"), "^wrap: expected True or False"),
        (lambda: pg.contacts_at(hand, cylinder, {**POINTS, 1: [0, 0, 0]}), "^points: expected"),
        (lambda: pg.contacts_at(hand, cylinder, {"nobody": [0.01, 0.0, 0.06]}), "expected one of thumb"),
        (lambda: pg.contacts_at(hand, cylinder, POINTS, links={"thumb": 3}), "links of finger 'thumb'"),
        (lambda: pg.optimize_forces(contacts, 0.9), "^problem: expected a ForceProblem"),
        (lambda: pg.motion.plan_motion(hand, contacts), "^solution: expected"),
        (lambda: pg.load_hand(3), "^hand: expected a path"),
        (lambda: pg.load_case("paper", 3), "^changes: expected"),
    ):
        with pytest.raises(InvalidInput, match=message):
            call()
