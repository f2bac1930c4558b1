"""Torque constants, friction, masses and friction coefficients of logs whose truth is known."""

from __future__ import annotations

import csv

import numpy as np
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.identification import (
    MotionLog,
    apply_fits,
    identify_friction,
    identify_load,
    identify_motion,
    read_motion,
)

TIP = "link_3.0_tip"
JOINTS = (1, 2, 3)


@pytest.fixture(scope="module")
def hand():
    """Its index finger lifts against gravity."""
    turned = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.zeros(3))
    return pg.load_hand("allegro_right").placed(turned.homogeneous)


def make_log(
    hand, rng, mass, *, noise=2.0, late=0.0, gears=0.0, outer=0.0, friction=0.01, still=(), com=(0.0, 0.0, 0.0)
):
    """A log of the index finger with a mass at its tip, registers in units of 1 mN m, and friction [N m]."""
    times, dt = np.arange(0, 10, 1e-3), 1e-3
    model = hand.model.copy()
    frame = model.frames[hand.frame_id(TIP)]
    model.appendBodyToJoint(frame.parentJoint, pin.Inertia(mass, np.array(com), np.zeros((3, 3))), frame.placement)
    data = model.createData()
    q = np.tile(hand.resting, (len(times), 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for j in set(JOINTS) - set(still):
        middle, far = (hand.lower[j] + hand.upper[j]) / 2, 0.3 * (hand.upper[j] - hand.lower[j])
        w, phase = 2 * np.pi * rng.uniform(0.2, 0.4), rng.uniform(0, 6)
        q[:, j] = middle + far * np.sin(w * times + phase)
        dq[:, j], ddq[:, j] = far * w * np.cos(w * times + phase), -far * w**2 * np.sin(w * times + phase)
    torques = np.array([pin.rnea(model, data, *one) for one in zip(q, dq, ddq)])
    sign = np.sign(dq)
    # effort = driven + s |gears effort + outer torque|: the sign of what is in it decides between two efforts
    driven = torques + friction * sign + 0.004 * dq + 0.002
    one, other = ((driven + s * outer * torques) / (1 - s * gears) for s in (sign, -sign))
    effort = np.where(gears * one + outer * torques >= 0, one, other)
    rows = np.arange(0, len(times), 10)
    register = np.full((len(rows), len(hand.drives)), np.nan)
    for j in JOINTS:
        register[:, j] = np.round(
            1e3 * effort[np.clip(rows - round(late / dt), 0, None), j] + rng.normal(0, noise, len(rows))
        )
    return MotionLog(source="made", times=times[rows], q=q[rows], effort=register)


@pytest.mark.parametrize("seed", [2, 20261128])
def test_drives_come_back_with_their_friction_and_delay(hand, seed):
    rng = np.random.default_rng(seed)
    gears, outer, late = rng.uniform(0, 0.25), rng.uniform(0, 0.2), rng.uniform(0, 0.03)
    found = identify_motion(hand, make_log(hand, rng, 0.15, gears=gears, outer=outer, late=late), masses={TIP: 0.15})
    names = [hand.joint_names[j] for j in JOINTS]
    assert {*found.drives} <= {*names} and hand.joint_names[1] in found.drives
    assert len(found.unknown) + len(found.drives) == hand.n
    assert found.unknown["joint_12.0"] == "its register is not in the log"
    fit = found.drives[hand.joint_names[1]]
    assert fit.effort_step.value == pytest.approx(1e-3, rel=0.05)
    assert fit.effort_step.low <= 1e-3 <= fit.effort_step.high
    assert fit.friction.value == pytest.approx(0.01, abs=0.004)
    assert fit.delay == pytest.approx(late, abs=0.006)
    told = (1 + fit.outer_friction.value) / (1 - fit.load_friction.value)
    assert told == pytest.approx((1 + outer) / (1 - gears), rel=0.06)
    covariance = fit.covariance
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12 * np.abs(covariance).max())
    assert np.sqrt(covariance[0, 0]) == pytest.approx((fit.effort_step.high - fit.effort_step.low) / 3.92, rel=1e-9)
    deviations = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(*2 * [np.where(deviations > 0, deviations, 1.0)])).min() > -1e-9
    # A drive's share is the ratio of what drives and what brakes; both together decide the torque constant.


@pytest.mark.parametrize("seed", [7, 20261130])
def test_motors_that_push_against_their_load_tell_the_gears_friction(hand, seed):
    """Where friction is more than a small load, motor and load pull at the gears in opposite directions: what is lost
    there is their difference (Rhoban's BAM), and the torque constant comes out nonetheless.
    """
    rng = np.random.default_rng(seed)
    gears, outer = rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.3)
    log = make_log(hand, rng, 0.3, gears=gears, outer=outer, friction=0.06)
    found = identify_motion(hand, log, masses={TIP: 0.3})
    fit = found.drives[hand.joint_names[1]]
    assert fit.effort_step.value == pytest.approx(1e-3, rel=0.05)
    told = (1 + fit.outer_friction.value) / (1 - fit.load_friction.value)
    assert told == pytest.approx((1 + outer) / (1 - gears), rel=0.06)
    mass, _ = identify_load(hand, make_log(hand, rng, 0.2, gears=gears, outer=outer, friction=0.06), found, TIP)
    assert mass.low <= 0.2 <= mass.high and mass.value == pytest.approx(0.2, rel=0.1)


def test_gears_that_no_load_drives_back_hide_the_torque_constant(hand):
    """Motor effort over torque is as large with any friction of the gears and the torque constant that belongs to it."""
    rng = np.random.default_rng(8)
    found = identify_motion(hand, make_log(hand, rng, 0.1, gears=0.35, outer=0.3, friction=0.5), masses={TIP: 0.1})
    for j in JOINTS:
        assert "lost in friction" in found.unknown[hand.joint_names[j]]


def test_carried_mass_and_its_centre(hand):
    rng = np.random.default_rng(4)
    found = identify_motion(hand, make_log(hand, rng, 0.1), masses={TIP: 0.1})
    mass, com = identify_load(hand, make_log(hand, rng, 0.22, com=(0.0, 0.0, 0.03)), found, TIP)
    assert mass.low <= 0.22 <= mass.high and mass.value == pytest.approx(0.22, rel=0.05)
    assert com is None or np.abs(com[[0, 2]] - [0.0, 0.03]).max() < 0.01


def test_what_cannot_be_told_is_named_with_the_experiment(hand):
    rng = np.random.default_rng(1)
    still = identify_motion(hand, make_log(hand, rng, 0.1, still=(2,)), masses={TIP: 0.1})
    assert "hardly moves" in still.unknown[hand.joint_names[2]] and hand.joint_names[1] in still.drives
    flat = hand.placed(pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3)).homogeneous)  # gravity along the axes
    bare = identify_motion(flat, make_log(flat, rng, 0.0, noise=5.0))
    assert "lost in friction" in bare.unknown[hand.joint_names[3]]


@pytest.mark.slow
def test_intervals_hold_the_truth_in_most_of_many_logs(hand):
    inside = []
    for seed in range(30):
        rng = np.random.default_rng([seed, 5])
        log = make_log(hand, rng, 0.15, gears=rng.uniform(0, 0.3), late=rng.uniform(0, 0.02))
        found = identify_motion(hand, log, masses={TIP: 0.15})
        inside += [fit.effort_step.low <= 1e-3 <= fit.effort_step.high for fit in found.drives.values()]
    assert np.mean(inside) > 0.85 and len(inside) >= 60


def test_registers_that_count_the_other_way_or_follow_nothing_are_told(hand):
    rng = np.random.default_rng(1)
    log = make_log(hand, rng, 0.1)
    name = hand.joint_names[1]
    turned = MotionLog(source="turned", times=log.times, q=log.q, effort=-log.effort)
    assert "counts against" in identify_motion(hand, turned, masses={TIP: 0.1}).unknown[name]
    for off in (np.zeros_like(log.effort), rng.normal(0, 50, log.effort.shape)):
        off = np.where(np.isnan(log.effort), np.nan, off)
        found = identify_motion(hand, MotionLog(source="off", times=log.times, q=log.q, effort=off), masses={TIP: 0.1})
        assert name in found.unknown


def test_times_of_a_bus_are_evened_out_and_gaps_refused(hand, tmp_path):
    rng = np.random.default_rng(2)
    log = make_log(hand, rng, 0.1)
    joint = hand.joint_names[1]
    times = log.times + np.where(np.arange(len(log.times)) % 2, 0.004, 0.0)
    rows = [times, np.interp(times, log.times, log.q[:, 1]), np.interp(times, log.times, log.effort[:, 1])]
    others = [np.interp(times, log.times, log.q[:, j]) for j in (2, 3)]

    def write(rows):
        head = ["time", f"{joint}/position", f"{joint}/effort", *(f"{hand.joint_names[j]}/position" for j in (2, 3))]
        with (tmp_path / "a.csv").open("w", newline="") as stream:
            table = csv.writer(stream)
            table.writerow(head)
            table.writerows(zip(*(values.tolist() for values in rows)))
        return read_motion(tmp_path / "a.csv", hand)

    fit = identify_motion(hand, write([*rows, *others]), masses={TIP: 0.1}).drives[joint]
    assert fit.effort_step.value == pytest.approx(1e-3, rel=0.05)
    late = times + np.where(times > 5, 0.5, 0.0)
    with pytest.raises(InvalidInput, match="cut the log there"):
        write([late, *rows[1:], *others])


def test_files_of_motion(hand, tmp_path):
    log = make_log(hand, np.random.default_rng(1), 0.1)
    columns = {"time": log.times}
    columns |= {f"{hand.joint_names[j]}/position": log.q[:, j] for j in JOINTS}
    columns |= {f"{hand.joint_names[j]}/effort": log.effort[:, j] for j in JOINTS}
    with (tmp_path / "a.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(columns)
        table.writerows(zip(*(values.tolist() for values in columns.values())))
    again = read_motion(tmp_path / "a.csv", hand)
    np.testing.assert_allclose(again.effort, log.effort, atol=1e-6)
    np.testing.assert_allclose(again.q[:, JOINTS], log.q[:, JOINTS], atol=1e-9)
    with pytest.raises(InvalidInput, match="give their names"):
        read_motion(tmp_path / "a.csv", hand, effort="{}_current")
    with pytest.raises(InvalidInput, match="expected a column 't'"):
        read_motion(tmp_path / "a.csv", hand, time="t")
    fits = identify_motion(hand, again, masses={TIP: 0.1}).drives
    drives = apply_fits(hand.drives, fits, "a log")
    for drive in drives:
        known = drive.name in fits
        assert (drive.effort_step is not None) == known and (drive.source("effort_step") is not None) == known


@pytest.mark.parametrize(
    "changed",
    [
        {"times": np.arange(10.0)},
        {"times": np.zeros(1000)},
        {"q": np.zeros((3, 16))},
        {"effort": np.zeros(1000)},
        {"effort": np.full((1000, 16), np.inf)},
        {"q": np.full((1000, 16), np.nan)},
    ],
)
def test_logs_that_are_none_are_refused(changed):
    good = {"times": 0.01 * np.arange(1000), "q": np.zeros((1000, 16)), "effort": np.zeros((1000, 16))}
    with pytest.raises(InvalidInput):
        MotionLog(source="x", **{**good, **changed})


def test_logs_of_other_hands_and_coupled_drives_are_refused(hand):
    log = make_log(hand, np.random.default_rng(1), 0.1)
    with pytest.raises(InvalidInput, match="expected 1 joints"):
        identify_motion(pg.load_hand("panda"), log)
    with pytest.raises(InvalidInput, match="drives"):
        identify_load(
            hand, log, identify_motion(hand, make_log(hand, np.random.default_rng(1), 0.1, still=JOINTS)), TIP
        )


def test_friction_of_a_contact_that_slips_and_a_bound_where_it_does_not():
    rng = np.random.default_rng(3)
    normal = 4 + rng.normal(0, 0.05, 400)
    pull = np.interp(np.arange(400), [0, 200, 400], [0, 4, 4])
    slips = pull > 0.6 * normal
    tangential = np.where(slips, 0.6 * normal, pull) + rng.normal(0, 0.02, 400)
    mu, stuck = identify_friction(normal, tangential, slips)
    assert mu.low <= 0.6 <= mu.high or mu.value == pytest.approx(0.6, rel=0.01)
    assert stuck < 0.65
    none, stuck = identify_friction(normal[:100], tangential[:100], slips[:100])
    assert none is None and stuck == pytest.approx(0.5, abs=0.03)
    with pytest.raises(InvalidInput):
        identify_friction(normal, tangential, slips.astype(int))
    with pytest.raises(InvalidInput):
        identify_friction(np.zeros(5), np.ones(5), np.zeros(5, dtype=bool))
