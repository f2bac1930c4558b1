"""Grasps as they are commanded: forces by the springs in series, limits, drives of several joints, loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import own_hands
import pytest

import pinograsp as pg
from pinograsp.certification import PROTOCOLS, Certifier, Commands, certify
from pinograsp.contacts import close_hand
from pinograsp.errors import InvalidInput, Status
from pinograsp.hands import Drive

JAWS, SERVO, CONTACT, MU = 3, 4000.0, 3000.0, 0.5  # [N/m] twice
AHEAD = 4e-3  # [m] that jaws are told to go in
BALL = pg.Sphere(radius=0.03, mass=0.1)


def drives(limit: float = np.inf) -> list[Drive]:
    return [
        Drive(name=f"motor{i}", joints=(f"slide{i}",), arms=(1.0,), control="position", limit=limit, stiffness=SERVO)
        for i in range(JAWS)
    ]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("hand") / "chuck.urdf"
    path.write_text(own_hands.chuck(JAWS), encoding="utf-8")
    return path


def axial(push=(0.0, 0.0, 0.1), **changes):
    """A pull along an axis, on contacts of one stiffness."""
    return replace(
        PROTOCOLS["dexgraspbench"],
        name="own",
        mu=MU,
        torsion=1e-4,
        stiffness=CONTACT,
        pulls=np.array([push]) / BALL.mass,
        distance=0.02,
        **changes,
    )


def told(path, motors, protocol, ahead=AHEAD, away=(0.0, 0.0, 0.0)):
    """Jaws that touch the ball are told to go further in by ``ahead``, the ball off by ``away``."""
    hand = pg.load_hand(path, drives=motors)
    q = np.array(close_hand(hand, BALL).q)
    stages, place = np.array([[q, q + ahead]]), np.eye(4)
    place[:3, 3] = away
    return certify(
        hand,
        BALL.placed(place),
        q[None],
        protocol.conditions(),
        commands=Commands(stages, np.tile(hand.pose, (1, 2, 1, 1))),
        protocol=protocol,
    )


def pressed(found):
    """Normal forces of the jaws (3,)."""
    return found.pressed[0][found.pressed[0] > 0]


def test_servos_and_contacts_are_springs_in_series(path):
    found = told(path, drives(), axial())
    assert found.commanded.all() and found.held_as_commanded.all() and found.possible.all()
    expected = AHEAD / (1.0 / SERVO + 1.0 / CONTACT)
    assert pressed(found) == pytest.approx(np.full(JAWS, expected), rel=0.01)
    assert "as commanded: held" in found.words(0)


def test_motors_press_no_harder_than_they_can(path):
    found = told(path, drives(limit=2.0), axial())
    assert pressed(found) == pytest.approx(np.full(JAWS, 2.0), rel=0.01)


@pytest.mark.parametrize("share", [0.8, 0.95, 1.05, 1.3])
def test_friction_of_all_jaws_bears_a_pull_along_the_axis(path, share):
    most = JAWS * MU * AHEAD / (1.0 / SERVO + 1.0 / CONTACT)
    found = told(path, drives(), axial(push=(0.0, 0.0, share * most)))
    assert bool(found.held_as_commanded[0]) == (share < 1)
    assert ("lost" in found.words(0)) == (share > 1)


def test_a_drive_of_two_joints_gives_way_along_them(path):
    """What one motor shares out presses alike, wherever the ball is between the jaws; two motors do not."""
    both = Drive(
        name="both", joints=("slide0", "slide1"), arms=(1.0, 1.0), control="position", limit=np.inf, stiffness=SERVO
    )
    frictionless = axial(push=(0.1, 0.0, 0.0))
    frictionless = replace(frictionless, mu=0.05)
    one = told(path, [both, drives()[2]], frictionless, away=(5e-4, 3e-4, 0.0))
    force = pressed(one)
    assert force[0] == pytest.approx(force[1], rel=0.05)
    # The effort of the motor is what its coordinate lacks; each joint gets all of it, and its contact as much.
    assert force[0] == pytest.approx(2 * AHEAD / (1.0 / SERVO + 2.0 / CONTACT), rel=0.1)


def test_blocks_threads_and_company_do_not_matter(path):
    hand = pg.load_hand(path, drives=drives())
    q = np.array(close_hand(hand, BALL).q)
    ahead = np.linspace(0.0, AHEAD, 40)
    stages = np.stack([np.tile(q, (40, 1)), q + ahead[:, None]], axis=1)
    roots = np.tile(hand.pose, (40, 2, 1, 1))
    protocol = axial(push=(0.0, 0.0, 5.0))
    postures = np.tile(q, (40, 1))
    found = [
        Certifier(hand, BALL, protocol.conditions(), protocol=protocol, threads=threads)(
            postures[some], commands=Commands(stages[some], roots[some])
        )
        for threads, some in ((1, slice(None)), (2, slice(None)), (1, slice(7, 9)))
    ]
    np.testing.assert_array_equal(found[0].moved, found[1].moved)
    np.testing.assert_array_equal(found[0].pressed[7:9], found[2].pressed)
    # The harder, the better.
    held = found[0].held_as_commanded
    assert held.any() and not held.all() and not np.diff(held.astype(int)).min() < 0


def test_without_commands_references_make_the_torques(path):
    hand = pg.load_hand(path, drives=drives())
    q = np.array(close_hand(hand, BALL).q)[None]
    conditions = pg.GraspConditions(mu=MU)
    assert not certify(hand, BALL, q, conditions).commanded.any()
    found = certify(hand, BALL, q, conditions, commanded=True)
    assert found.held.all() and found.held_as_commanded.all() and found.moved[0] < 2e-3
    far = certify(hand, BALL, q - 0.02, conditions, commanded=True)
    assert far.reason[0] == Status.NO_CONTACT.code and not far.commanded.any() and np.isnan(far.moved[0])


def test_what_cannot_be_commanded_is_refused(path):
    hand = pg.load_hand(path, drives=drives())
    q, root = np.zeros((2, 2, JAWS)), np.tile(np.eye(4), (2, 2, 1, 1))
    with pytest.raises(InvalidInput, match="two postures or more"):
        Commands(q[:, :1], root[:, :1])
    with pytest.raises(InvalidInput, match="roots of commands"):
        Commands(q, root[:1])
    with pytest.raises(InvalidInput, match="commands: expected those of 1 grasps"):
        certify(hand, BALL, q[:1, 0], pg.GraspConditions(mu=MU), commands=Commands(q, root))
    with pytest.raises(InvalidInput, match="protocol"):
        certify(hand, BALL, q[:1, 0], pg.GraspConditions(mu=MU), protocol="nobody's")


def test_one_reason_for_half_of_the_grasps_comes_with_what_would_change_it(path):
    hand = pg.load_hand(path, drives=drives())
    q = np.tile(np.array(close_hand(hand, BALL).q) + 4e-3, (6, 1))
    found = certify(hand, BALL, q, pg.GraspConditions(mu=MU))
    assert (found.reason == Status.PENETRATES.code).all() and "--tolerance" in found.describe()
    beyond = certify(hand, BALL, q + 1.0, pg.GraspConditions(mu=MU))
    assert (beyond.reason == Status.JOINT_LIMIT.code).all() and "slide0 by" in beyond.words(0)


# -- other people's tests ----------------------------------------------------------------------------------------------


def test_protocols_ask_what_they_say():
    assert set(PROTOCOLS) == {"dexgraspbench", "dexgraspnet", "acronym", "graspgen"}
    for protocol in PROTOCOLS.values():
        assert (protocol.mass is None) is not (protocol.density is None)
        assert protocol.loads_on(2.0)[:, :3] == pytest.approx(2.0 * protocol.pulls)
        assert np.abs(protocol.pulls.sum(axis=0)).max() == 0  # both ways of each axis
    assert np.linalg.norm(PROTOCOLS["dexgraspbench"].loads_on(0.1), axis=1) == pytest.approx(np.ones(6))


def test_a_protocol_has_servos_of_its_own(path):
    """Of springs in series, those of the protocol's servos and not of the hand's: 1000 N/m against 2e4 of a contact."""
    protocol = replace(PROTOCOLS["dexgraspnet"], pulls=np.zeros((1, 3)))
    found = told(path, drives(limit=0.1), protocol)
    assert found.pressed.max(axis=1) == pytest.approx(AHEAD / (1 / 1000.0 + 1 / protocol.stiffness), rel=0.02)
    assert found.largest_load[0] == np.inf  # nothing weighs on it, and no torque is in the way


def test_lenient_protocols_tell_what_others_refuse(path):
    hand = pg.load_hand(path, drives=drives())
    q = np.array(close_hand(hand, BALL).q)[None]
    q[0, 0] = hand.upper[0] + 0.03
    strict, lenient = PROTOCOLS["dexgraspbench"], PROTOCOLS["dexgraspnet"]
    refused = certify(hand, BALL, q, strict.conditions(), protocol=strict)
    assert refused.reason[0] == Status.JOINT_LIMIT.code
    given = certify(hand, BALL, q, lenient.conditions(), protocol=lenient)
    assert given.reason[0] != Status.JOINT_LIMIT.code and f"{hand.joint_names[0]} by" in given.words(0)


def test_jaws_of_a_protocol_are_told_to_close():
    """Without positions in the file: they press with their motor's limit, and the object goes where both do."""
    hand, protocol = pg.load_hand("panda"), PROTOCOLS["acronym"]
    ball = pg.Sphere(radius=0.02, mass=0.05)
    roots = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (2, 1, 1))
    roots[:, 2, 3] = 0.1034
    roots[1, 1, 3] = 0.005  # off the middle
    certifier = Certifier(hand, ball, protocol.conditions(), protocol=protocol)
    found = certifier.jaws(roots)
    assert found.held_as_commanded.all(), found.words(1)
    assert found.pressed.max(axis=1) == pytest.approx(np.full(2, 70.0), rel=0.1)
    assert found.moved[1] > 0.004


def test_a_weight_without_a_reserve_that_nothing_holds():
    hand = pg.load_hand("panda")
    sheet = pg.Box(size=(0.2, 0.01, 0.2), mass=5.0)
    root = np.diag([1.0, -1.0, -1.0, 1.0])
    root[2, 3] = 0.19
    found = Certifier(hand, sheet, pg.GraspConditions(mu=0.05, reserve=None)).jaws(root[None])
    assert not found.held[0]
