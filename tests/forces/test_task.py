"""Loads of tasks: closed forms, invariance, and that all of a round set lies inside its hull."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog

from pinograsp.errors import InvalidInput
from pinograsp.forces import LoadSet, Reserve, Task
from pinograsp.objects import Box

GRAVITY = np.array([0.0, 0.0, -9.81])
POSE = pin.SE3(pin.utils.rotate("x", 0.8) @ pin.utils.rotate("z", -0.5), np.array([0.1, 0.2, 0.3])).homogeneous
BODY = Box(size=(0.04, 0.06, 0.1), mass=0.4, pose=POSE)


def in_hull(point, points):
    """Whether a point is a convex combination of others (linear program)."""
    A = np.vstack([points.T, np.ones(len(points))])
    return linprog(np.zeros(len(points)), A_eq=A, b_eq=np.append(point, 1.0), bounds=(0, None)).status == 0


def test_torques_and_forces_act_along_the_objects_axes():
    turn, weight = POSE[:3, :3], 0.4 * GRAVITY
    screw = Task.screw(torque=0.7, axis=(0, 1, 0)).find_loads(BODY, 0.4, GRAVITY)
    assert np.allclose(screw, [[*weight, *0.7 * turn[:, 1]], [*weight, *-0.7 * turn[:, 1]]])
    ((force, moment),) = Task.pull(force=5, direction=(2, 0, 0)).find_loads(BODY, 0.4, GRAVITY).reshape(1, 2, 3)
    assert np.allclose(force, weight + 5 * turn[:, 0]) and np.allclose(moment, 0)
    at = np.array([0.02, 0.01, -0.05])
    ((force, moment),) = Task.insert(force=3, at=at).find_loads(BODY, 0.4, GRAVITY).reshape(1, 2, 3)
    assert np.allclose(force, weight + 3 * turn[:, 2])  # what is pressed down presses back up
    assert np.allclose(moment, turn @ np.cross(at, (0, 0, 3)))


@pytest.mark.parametrize("tilt", np.radians([10.0, 45.0, 100.0, 180.0]))
def test_all_tilts_lie_in_the_hull(tilt):
    rng = np.random.default_rng(int(1e3 * tilt))
    loads = np.vstack([Task.pour(tilt=tilt).find_loads(BODY, 0.4, GRAVITY)[:, :3], 0.4 * GRAVITY])
    for _ in range(40):
        angle, around = tilt * rng.uniform(), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.cos(around), np.sin(around), 0.0])
        tilted = pin.exp3(angle * axis) @ (0.4 * GRAVITY)
        assert in_hull(tilted, loads)
    assert np.linalg.norm(loads, axis=1).max() < 1.2 * 0.4 * 9.81  # nor much more than that


def test_all_accelerations_lie_in_the_hull():
    rng = np.random.default_rng()
    loads = Task.shake(acceleration=4.0).find_loads(BODY, 0.4, GRAVITY)[:, :3]
    for way in rng.normal(size=(40, 3)):
        assert in_hull(0.4 * GRAVITY + 0.4 * 4.0 * way / np.linalg.norm(way), loads)


def test_the_reserve_has_each_task_at_both_masses():
    task = Task.screw(torque=0.3)
    with_it = Reserve(tasks=(task,)).load_set(BODY).loads
    without = Reserve().load_set(BODY).loads
    assert len(with_it) == len(without) + 4
    assert np.allclose(with_it[-4:], np.vstack([task.find_loads(BODY, times * 0.4, GRAVITY) for times in (0.8, 1.2)]))
    alone = Reserve(disturbance=0, mass=0, tasks=(task,)).load_set(BODY).loads
    assert len(alone) == 3


def test_given_loads_come_besides_the_weight():
    wrench = np.array([[1.0, 2, 3, 0.1, 0.2, 0.3]])
    task = Task.of_loads(LoadSet(loads=wrench))
    assert np.allclose(task.find_loads(BODY, 0.4, GRAVITY), wrench + [0, 0, -0.4 * 9.81, 0, 0, 0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Task.screw(torque=-1), "task screw"),
        (lambda: Task.pull(force=1, direction=(0, 0, 0)), "expected a direction"),
        (lambda: Task.pour(tilt=4.0), "at most pi"),
        (lambda: Task.shake(acceleration=np.nan), "task shake"),
        (lambda: Task(name="push", size=1), "task"),
        (lambda: Task.of_loads(LoadSet(loads=[[0] * 6], ball=1.0)), "without a ball"),
        (lambda: Reserve(tasks=("screw",)), "reserve: tasks"),
    ],
)
def test_tasks_that_cannot_be(make, message):
    with pytest.raises(InvalidInput, match=message):
        make()
