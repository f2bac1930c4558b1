"""Figures of carry plans: every curve is the plan's, what binds is named, and legends are beside the curves."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import imread

from pinograsp.hands import load_hand
from pinograsp.plan import Layout
from pinograsp.viz.carried import (
    arm_motion,
    carry_friction,
    normal_forces,
    path_speed,
    save_carry_figures,
    torque_shares,
)

N, K = 60, 9
BINDS = [f"torque of joint {i}" for i in range(9)]


@pytest.fixture(scope="module")
def hand():
    return load_hand("panda")


@pytest.fixture
def plan(hand):
    """Made-up: constant acceleration and deceleration, nine limits of which each binds for longer than the one before."""
    times = np.linspace(0.0, 2.0, N + 1)
    instants = (times[1:] + times[:-1]) / 2
    speed = 1.0 - np.abs(times - 1.0)
    s = np.where(times < 1, times**2 / 2, 1 - (2 - times) ** 2 / 2)
    wave = np.sin(3 * instants)[:, None]
    binding = tuple(what for i, what in enumerate(BINDS) for _ in range(i + 2))[:N]
    binding = (*binding, *(["nothing"] * (N - len(binding))))
    contacts = tuple(f"finger {i}" for i in range(K))
    layout = Layout(
        hand=hand.name,
        joints=hand.joint_names,
        fingers={one.name: tuple(one.dofs.tolist()) for one in hand.fingers},
    )
    plan = SimpleNamespace(
        robot=hand,
        grasp=SimpleNamespace(require_hand=lambda: hand, contacts=SimpleNamespace(names=contacts), layout=layout),
        contacts=contacts,
        reserve=0.1,
        s=s,
        times=times,
        speed=speed,
        instants=instants,
        limit=1.5 + 10.0 * (instants > 1.9),
        torque_limits=np.full(hand.n, 20.0),
        dq=wave * np.arange(1, hand.n + 1),
        ddq=3 * wave * np.arange(1, hand.n + 1),
        torques=15.0 * wave * np.ones(hand.n),
        normal_forces=3.0 + wave + 0.1 * np.arange(K),
        commanded=3.0 + wave + 0.1 * np.arange(K),
        friction_use=0.5 + 0.4 * wave * np.ones(K),
        binding=binding,
    )
    plan.shares = lambda: [(what, count / N) for what, count in Counter(plan.binding).most_common()]
    return plan


def lines(axes):
    return {line.get_label(): line for line in axes.lines}


def test_the_phase_plane_names_what_binds_longest(plan):
    axes = path_speed(plan).axes[0]
    shown = lines(axes)
    count = {what: plan.binding.count(what) for what in BINDS}
    named = sorted(BINDS, key=lambda what: -count[what])[:6]
    for what in named:
        line = shown[f"{what}, {100 * count[what] / N:.0f} % of the time"]
        x, y = line.get_data()
        own = np.flatnonzero([one == what for one in plan.binding])
        # From the beginning of its first interval to the end of its last, along the speed.
        np.testing.assert_allclose([np.nanmin(x), np.nanmax(x)], plan.s[[own[0], own[-1] + 1]])
        good = np.isfinite(x)
        np.testing.assert_allclose(y[good], np.interp(x[good], plan.s, plan.speed))
    others = sum(count[what] for what in BINDS if what not in named)
    assert f"3 others, {100 * others / N:.0f} % of the time" in shown
    assert any(label.startswith("nothing") for label in shown)
    assert len({line.get_color() for label, line in shown.items() if "torque" in label}) == 6
    assert [text.get_text() for text in axes.get_legend().get_texts()] == list(shown)
    assert 1.0 < axes.get_ylim()[1] < 3.0  # what is far above does not flatten the curve


def test_separate_stretches_of_one_limit_are_not_joined(plan):
    plan.binding = tuple("friction of a" if i < 10 or i >= 50 else "speed of the joints" for i in range(N))
    shown = lines(path_speed(plan).axes[0])
    x, _ = next(line for label, line in shown.items() if label.startswith("friction")).get_data()
    pieces = np.split(x, np.flatnonzero(np.isnan(x)))
    runs = [(np.nanmin(one), np.nanmax(one)) for one in pieces if np.isfinite(one).any()]
    np.testing.assert_allclose(runs, [(plan.s[0], plan.s[10]), (plan.s[50], plan.s[60])])


def test_forces_and_their_sum(plan):
    total, each = normal_forces(plan).axes
    np.testing.assert_allclose(lines(total)["on the object"].get_ydata(), plan.normal_forces.sum(axis=1))
    for i, name in enumerate(plan.contacts):
        np.testing.assert_allclose(lines(each)[name].get_ydata(), plan.normal_forces[:, i])
    assert not [line for line in [*total.lines, *each.lines] if line.get_linestyle() == "--"]
    styles = {(line.get_color(), line.get_linestyle()) for line in each.lines}
    assert len(styles) == K  # more contacts than colours


def test_commands_are_dashed_where_they_are_something_else(plan):
    plan.commanded = plan.commanded.copy()
    plan.commanded[:, 2] += 1.0
    total, each = normal_forces(plan).axes
    dashed = [line for line in each.lines if line.get_linestyle() == "--"]
    assert len(dashed) == 1 and dashed[0].get_color() == lines(each)["finger 2"].get_color()
    np.testing.assert_allclose(dashed[0].get_ydata(), plan.commanded[:, 2])
    np.testing.assert_allclose(lines(total)["commanded (dashed)"].get_ydata(), plan.commanded.sum(axis=1))


def test_friction_has_its_limit_marked(plan):
    axes = carry_friction(plan).axes[0]
    assert any(np.allclose(line.get_ydata(), 1.0) for line in axes.lines)
    assert axes.get_ylim()[0] == 0 and axes.get_ylim()[1] > 1
    plan.friction_use = 2 * plan.friction_use
    assert carry_friction(plan).axes[0].get_ylim()[1] > plan.friction_use.max()


def test_torques_are_shares_of_their_limits(plan, hand):
    arm, fingers = torque_shares(plan).axes
    finger = hand.joint_names[hand.fingers[0].dofs[0]]
    np.testing.assert_allclose(lines(fingers)[finger].get_ydata(), plan.torques[:, 0] / 20.0)
    assert finger not in lines(arm)
    assert {0.9, 1.0} <= {round(float(line.get_ydata()[0]), 6) for line in fingers.lines}
    plan.torque_limits = np.full(hand.n, np.inf)
    assert "no torque limits are known" in [text.get_text() for text in torque_shares(plan).axes[1].texts]


def test_speeds_and_accelerations_are_those_of_joints_that_move(plan, hand):
    plan.dq = plan.dq * (np.arange(hand.n) > 0)
    speed, acceleration = arm_motion(plan).axes
    for axes, values in ((speed, plan.dq), (acceleration, plan.ddq)):
        assert hand.joint_names[0] not in lines(axes)
        for i in range(1, hand.n):
            np.testing.assert_allclose(lines(axes)[hand.joint_names[i]].get_ydata(), values[:, i])


@pytest.mark.slow
@pytest.mark.parametrize("length", [0, 60])
def test_legends_are_beside_the_curves(plan, length):
    plan.contacts = tuple(name.ljust(length, "e") for name in plan.contacts)
    plan.binding = tuple(what.ljust(length, "e") for what in plan.binding)
    plan.torques = 1e6 + plan.torques  # numbers with an offset are told in full
    plan.ddq = 1e7 + 1e-3 * plan.ddq
    for drawn in (path_speed, normal_forces, carry_friction, torque_shares, arm_motion):
        figure = drawn(plan)
        FigureCanvasAgg(figure).draw()
        for axes in figure.axes:
            assert "+" not in axes.yaxis.get_offset_text().get_text()
            if (legend := axes.get_legend()) is not None:
                box = legend.get_window_extent()
                assert box.y0 >= axes.get_window_extent().y1 - 1, drawn.__name__
                assert box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1, drawn.__name__


@pytest.mark.slow
def test_figures_are_written(plan, tmp_path):
    paths = save_carry_figures(plan, tmp_path)
    assert len(paths) == 5 and len({path.read_bytes() for path in paths}) == 5
    for path in paths:
        image = imread(path)[..., :3]
        coloured = np.ptp(image, axis=2) > 0.2
        assert coloured.mean() > 1e-3, path.name
