"""What messages say: real messages in, arrays out."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp.errors import InvalidInput
from pinograsp.ros2.messages import JointReader, Told, read_numbers, read_wrench
from pinograsp.spatial import pose_of, rotation_rpy

pytest.importorskip("rclpy", reason="the extra ros2 is not installed")
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def test_joints_are_read_by_name_whatever_their_order():
    reader = JointReader(["a", "b"])
    message = JointState(name=["b", "arm", "a"], position=[2.0, 0.0, 1.0], effort=[20.0, 0.0, 10.0])
    np.testing.assert_array_equal(reader.read("effort", message), [10.0, 20.0])
    np.testing.assert_array_equal(reader.read("position", message), [1.0, 2.0])
    other = JointState(name=["a", "b"], effort=[1.0, 2.0])
    np.testing.assert_array_equal(reader.read("effort", other), [1.0, 2.0])
    assert reader.read("position", other) is None
    np.testing.assert_array_equal(reader.read("effort", message), [10.0, 20.0])
    assert reader.read("effort", JointState(name=["arm"], effort=[1.0])) is None  # somebody else's
    assert reader.read("effort", JointState(name=["arm"], effort=[1.0])) is None


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (JointState(name=["a"], effort=[1.0]), "none named b"),
        (JointState(name=["a", "b"], effort=[1.0]), "one for each of 2 names, got 1"),
        (JointState(name=["a", "b"], effort=[1.0, np.nan]), "expected finite numbers"),
    ],
)
def test_joints_that_cannot_be_used_are_refused(message, told):
    reader = JointReader(["a", "b"])
    for _ in range(2):
        with pytest.raises(InvalidInput, match=told):
            reader.read("effort", message)


def test_numbers_have_the_size_of_the_plan():
    np.testing.assert_array_equal(read_numbers(Float64MultiArray(data=[1, 2, 3, 4, 5, 6]), (2, 3))[1], [4, 5, 6])
    for data in ([1.0], [], [1.0] * 7):
        with pytest.raises(InvalidInput, match=f"expected 6 numbers .2x3., got {len(data)}"):
            read_numbers(Float64MultiArray(data=data), (2, 3))
    with pytest.raises(InvalidInput, match="finite"):
        read_numbers(Float64MultiArray(data=[np.inf]), (1,))


def test_a_wrench_is_that_about_the_centre_of_mass():
    """A weight below a turned sensor: force along its axis of gravity, moment by the lever, both turned."""
    pose = pose_of([0.1, 0.0, 0.5], rotation_rpy(0.3, -0.2, 1.1))
    com, weight = np.array([0.15, 0.02, 0.4]), np.array([0.0, 0.0, -2.0])
    moment = np.cross(com - pose[:3, 3], weight)
    to_sensor = pose[:3, :3].T
    message = WrenchStamped(
        wrench=Wrench(
            force=Vector3(**dict(zip("xyz", to_sensor @ weight))),
            torque=Vector3(**dict(zip("xyz", to_sensor @ moment))),
        )
    )
    np.testing.assert_allclose(read_wrench(message, pose, com), [0, 0, -2, 0, 0, 0], atol=1e-15)
    message.wrench.torque.x = np.nan
    with pytest.raises(InvalidInput):
        read_wrench(message, pose, com)


def test_what_is_wrong_is_told_once_and_counted():
    lines: list[str] = []
    told = Told(lines.append)
    for topic in ("a", "b", "a", "a"):
        told.leave_out(topic, "bad")
    assert len(lines) == 2 and told.counts == {"a": 3, "b": 1}
