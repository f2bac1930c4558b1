"""Tasks whose commands go on after the object is let go, and objects that are to stay with a link."""

from dataclasses import replace

import numpy as np
import own_hands
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.objects import Sphere
from pinograsp.simulation import simulate
from pinograsp.simulation.task import Task

HOLD, MORE = 0.2, 0.1  # [s]
FREE = {"time_step": 1e-3, "letting_go": 0.1}


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    """Three jaws around a ball; the torques at the end are held."""
    path = tmp_path_factory.mktemp("hand") / "chuck.urdf"
    path.write_text(own_hands.chuck(3), encoding="utf-8")
    plan = pg.plan_grasp_on(
        pg.load_hand(path),
        Sphere(radius=0.03, mass=0.1),
        pg.GraspConditions(mu=0.6, final_time=0.4, impact_time_range=(0.2, 0.35)),
    )
    found = Task.of(plan)
    torques = np.array(found.torques)
    torques[-1] = found.holding_torques
    return replace(found, torques=torques)


def longer(task, q):
    """The task with one more command, ``MORE`` after the release."""
    return replace(
        task,
        times=np.append(task.times, task.final_time + MORE),
        q=np.vstack([task.q, q]),
        dq=np.vstack([task.dq[:-1], np.zeros((2, task.hand.n))]),
        torques=np.vstack([task.torques, task.holding_torques]),
    )


@pytest.mark.slow
def test_commands_that_stay_are_a_longer_hold(task):
    still = longer(task, task.q[-1])
    assert task.way == 0.0 and still.way == pytest.approx(MORE)
    one = simulate(replace(task, dq=still.dq[:-1]), hold=HOLD + MORE, support="fixed", **FREE)
    two = simulate(still, hold=HOLD, support="fixed", **FREE)
    np.testing.assert_allclose(two.times, one.times, atol=1e-12)
    np.testing.assert_allclose(two.object_poses, one.object_poses, atol=1e-9)
    assert one.verdict.held and two.verdict.held


def test_commands_after_the_release_are_followed_and_then_held(task):
    """Jaws that open there lose the object, of which the last command is the cause."""
    opened = task.q[0]
    seen = simulate(longer(task, opened), hold=HOLD, support="fixed", **FREE)
    assert not seen.verdict.held
    assert seen.release == pytest.approx(task.final_time)
    assert np.abs(seen.q[-1] - task.q[-1]).max() > 0.5 * np.abs(opened - task.q[-1]).max()


def test_poses_as_carried(task):
    """What moves along with the carrier is where it was; without one it is where it is."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = np.random.default_rng(0).normal(size=(3, 3))
    q = np.array([task.q[0], task.q[len(task.q) // 2], task.q[-1]])
    np.testing.assert_array_equal(task.as_carried(q, poses), poses)
    link = task.links[0]
    where = np.array([task.hand.frame_placements(one, [link])[0] for one in q])
    kept = pin.SE3.Random().homogeneous
    seen = replace(task, carrier=link).as_carried(q, where @ kept)
    np.testing.assert_allclose(seen, np.tile(where[0] @ kept, (3, 1, 1)), atol=1e-12)
    assert np.linalg.norm(where[-1, :3, 3] - where[0, :3, 3]) > 1e-3
