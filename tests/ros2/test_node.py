"""The node against a hand in MuJoCo, each in a process of its own, over DDS on this machine."""

from __future__ import annotations

import contextlib
import json
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from marks import slow_except

import pinograsp as pg

rclpy = pytest.importorskip("rclpy", reason="the extra ros2 is not installed")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray, String  # noqa: E402

HAND = Path(__file__).with_name("hand.py")
HEAVY = ("--mu", "0.4", "--mass", "3")  # 5.9 N with friction 0.4: the plan's 12 N are too little
STIFFNESS = 8000.0  # [N/m] of the gripper's servo
KEPT = 0.01  # [m] that a held object moves at most
LOST = 0.1  # [m]
LATE = 0.3  # [s] that a simulation in real time may be


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A folder with a run, and its scenes with motors and with servos: a box in a gripper, from above."""
    folder = tmp_path_factory.mktemp("planned")
    box, conditions = pg.Box(size=(0.04, 0.04, 0.1), mass=0.2), pg.GraspConditions(mu=0.6)
    wishes = pg.Wishes(approach="above")
    found = pg.find_grasps(pg.load_hand("panda"), box, conditions, count=16, seed=1, wishes=wishes)
    plan = pg.plan_best(found, conditions)
    pg.save_run(plan, folder / "run")
    plan.to_mujoco(folder / "effort.xml", scene=True, command="torque")
    # The drive moves two jaws: its coordinate is twice that of the joint.
    plan.to_mujoco(folder / "position.xml", scene=True, command="position", stiffness=STIFFNESS / 4, damping=50.0)
    return folder


@pytest.fixture
def domain(monkeypatch):
    """A network of its own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random.SystemRandom().randrange(1, 200)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")


@contextlib.contextmanager
def node(planned, command, *arguments, options=()):
    """The command, ended where it still runs."""
    line = [sys.executable, "-m", "pinograsp.cli", "ros2", command, str(planned / "run"), *options]
    process = subprocess.Popen(
        [*line, *(["--ros-args", *arguments] if arguments else [])], stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def end(process, how=signal.SIGINT):
    """What a node has told until a signal ended it, in good order."""
    process.send_signal(how)
    told = process.communicate(timeout=60)[1]
    assert process.returncode == 0, told
    return told


def start_hand(planned, *arguments, interface="effort"):
    result = planned / "result.json"
    result.unlink(missing_ok=True)
    line = [sys.executable, str(HAND), str(planned / "run"), str(planned / f"{interface}.xml"), str(result)]
    return subprocess.Popen([*line, "--interface", interface, *arguments]), result


def finish_hand(started):
    process, result = started
    assert process.wait(timeout=180) == 0
    seen = json.loads(result.read_text(encoding="utf-8"))
    if seen["behind"] > LATE:
        pytest.skip(f"the machine is too busy for real time: {seen['behind']:.2f} s late")
    return seen


def run_hand(planned, *arguments, interface="effort"):
    return finish_hand(start_hand(planned, *arguments, interface=interface))


class Robot:
    """A robot's side of the topics, in this process."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("robot")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.commands, self.status = [], []
        self.node.create_subscription(Float64MultiArray, "commands", lambda m: self.commands.append(list(m.data)), 100)
        self.node.create_subscription(String, "pinograsp/status", lambda m: self.status.append(json.loads(m.data)), 10)

    def publisher(self, kind, topic):
        return self.node.create_publisher(kind, topic, qos_profile_sensor_data)

    def spin(self, until, seconds=90.0, each=lambda: None):
        """Until something is true."""
        limit = time.monotonic() + seconds
        while not until():
            assert time.monotonic() < limit, (len(self.commands), self.status[-1:])
            each()
            self.executor.spin_once(timeout_sec=0.01)


@pytest.fixture
def robot(domain):
    one = Robot()
    yield one
    one.node.destroy_node()
    rclpy.shutdown()


def test_an_object_is_kept_as_without_ros(planned, domain):
    """Three times the mass on less friction: lost with the plan's torques, kept by the reflex, here and over topics."""
    assert run_hand(planned, "--mode", "constant", "--seconds", "2", *HEAVY)["moved"] > LOST
    alone = run_hand(planned, "--mode", "alone", "--seconds", "3", *HEAVY)
    with node(planned, "hold") as process:
        seen = run_hand(planned, "--seconds", "3", *HEAVY)
        told = end(process)
    assert alone["moved"] < KEPT and seen["moved"] < KEPT, told
    assert 0.8 < seen["squeeze"] / alone["squeeze"] < 1.5, told  # drawn late, a reflex squeezes more


@pytest.mark.slow
@pytest.mark.parametrize("senses", [("joints", "slips"), ("forces", "slips")], ids=" ".join)
def test_lost_messages_lose_no_object(planned, domain, senses):
    """A fifth of the measurements and of the commands."""
    with node(planned, "hold") as process:
        seen = run_hand(planned, "--seconds", "4", "--loss", "0.2", "--senses", *senses, *HEAVY)
        told = end(process, signal.SIGTERM)
    assert seen["moved"] < KEPT, told


@pytest.mark.slow
def test_a_node_may_be_killed_and_started_again(planned, domain):
    """The last command holds; the next node takes over from the efforts that are measured."""
    hand = start_hand(planned, "--seconds", "18", *HEAVY)
    with node(planned, "hold") as process:
        while not re.search(r"[1-9]\d* reflexes", line := process.stderr.readline()):
            assert line and hand[0].poll() is None, "node or hand has ended"
        process.kill()
    time.sleep(1.0)
    with node(planned, "hold") as process:
        seen = finish_hand(hand)
        told = end(process)
    assert seen["moved"] < KEPT and seen["squeeze"] > 12.0, told
    pause, change = max(seen["pauses"])
    assert pause > 1.0 and change < 0.5  # [N]; the plan's torque would be 9 N less


@pytest.mark.slow
@pytest.mark.parametrize(("interface", "message"), [("position", "trajectory"), ("effort", "array")])
def test_a_plan_is_played_and_held(planned, domain, interface, message):
    """From the open hand; the object is let go 0.1 s after t_F, with half more of mass on less friction."""
    parameters = ["-p", f"interface:={interface}", "-p", f"message:={message}", "-p", f"stiffness:={STIFFNESS}"]
    release = ["--start", "start", "--release", "1.6", "--seconds", "4", "--mu", "0.5", "--mass", "1.5"]
    with node(planned, "play", *parameters) as process:
        seen = run_hand(planned, *release, "--message", message, "--stiffness", str(STIFFNESS), interface=interface)
        told = end(process)
    assert seen["moved"] < KEPT and seen["squeeze"] > 2.0, told


@pytest.mark.slow
def test_without_reflex_the_last_command_stays(planned, domain):
    """The plan's torques squeeze on, where the controller would have let go of half of them."""
    with node(planned, "play", options=["--no-reflex"]) as process:
        seen = run_hand(planned, "--start", "start", "--release", "2.2", "--seconds", "4")
        told = end(process)
    holding = pg.load_run(planned / "run").motion.holding_torques
    assert seen["moved"] < KEPT, told
    np.testing.assert_allclose(seen["sent"], holding, rtol=1e-6)


def test_nonsense_is_told_once_and_nothing_jumps_at_the_start_or_at_the_end(planned, robot):
    """Arrays of a wrong size, NaN, foreign and old joint states; SIGTERM leaves the last command."""
    plan = pg.load_run(planned / "run")
    name, holding = plan.hand.joint_names[0], float(plan.motion.holding_torques[0])
    forces, slips = (robot.publisher(Float64MultiArray, topic) for topic in ("forces", "slips"))
    joints = robot.publisher(JointState, "joint_states")
    planned_forces = np.einsum("kji,kj->ki", plan.contacts.rotations_oc, plan.motion.forces_o[-1])
    old = JointState(name=[name], effort=[1.5 * holding])
    old.header.stamp.sec = 1000
    bad = (old, JointState(name=[name], effort=[np.nan]), JointState(name=["elbow"], effort=[3.0]))
    good = JointState(name=[name], effort=[1.5 * holding])

    def tell():
        for count in (1, len(plan.contacts.names)):
            slips.publish(Float64MultiArray(data=[0.0] * count))
        forces.publish(Float64MultiArray(data=planned_forces.ravel().tolist()))
        for message in (*bad, good):
            joints.publish(message)

    with node(planned, "hold", "-p", "rate:=100", "-p", "start_time:=1.0") as process:
        robot.spin(lambda: len(robot.commands) > 60 and robot.status, each=tell)
        told = end(process, signal.SIGTERM)
    sent = np.array(robot.commands)[:, 0]
    assert abs(sent[0] - 1.5 * holding) < 1e-9 and np.abs(np.diff(sent)).max() < 0.25 * abs(holding)
    assert np.all(sent != 0.0)  # as some nodes send when they end
    assert told.count("slips: data: expected 10 numbers") == 1 and told.count("joint_states: stamp: expected") == 1
    assert robot.status[-1]["left_out"].keys() == {"slips", "joint_states"} and robot.status[-1]["felt"]["torques"]


@pytest.mark.slow
def test_without_efforts_it_starts_from_the_plan(planned, robot):
    plan = pg.load_run(planned / "run")
    name, zeros = plan.hand.joint_names[0], robot.publisher(JointState, "joint_states")
    with node(planned, "hold", "-p", "rate:=100") as process:
        robot.spin(lambda: len(robot.commands) > 5, each=lambda: zeros.publish(JointState(name=[name], effort=[0.0])))
        told = end(process)
    np.testing.assert_allclose(robot.commands[0], plan.motion.holding_torques, rtol=0.02)
    assert "starts from the plan's holding torques" in told and "only zeros" in told


@pytest.mark.slow
def test_simulated_time_is_the_clock_where_it_is_asked_for(planned, robot):
    """No ticks while it stands; by its seconds, at whatever pace."""
    from rosgraph_msgs.msg import Clock

    clock = robot.node.create_publisher(Clock, "/clock", 1)
    time_now = Clock()
    time_now.clock.sec = 10

    def tick():
        time_now.clock.nanosec += 5_000_000
        if time_now.clock.nanosec >= 1_000_000_000:
            time_now.clock.sec, time_now.clock.nanosec = time_now.clock.sec + 1, 0
        clock.publish(time_now)

    with node(planned, "hold", "-p", "use_sim_time:=true", "-p", "rate:=50") as process:
        robot.spin(lambda: len(robot.commands) > 20, each=tick)
        begun, count = time_now.clock.sec + 1e-9 * time_now.clock.nanosec, len(robot.commands)
        robot.spin(lambda: time_now.clock.sec + 1e-9 * time_now.clock.nanosec > begun + 2.0, each=tick)
        assert 60 < len(robot.commands) - count < 110
        end(process)


@pytest.mark.parametrize(
    ("command", "arguments", "told"),
    slow_except(
        [
            ("hold", ["-p", "interface:=position"], "stiffness: expected numbers above 0 for interface:=position"),
            ("hold", ["-p", "joints:=[thumb]"], "joint: expected"),
            ("hold", ["-p", "rate:=0"], "rate: expected"),
            ("hold", ["-p", "margin:=wide"], "margin: expected"),
            ("hold", ["-p", "rate"], "--ros-args: expected arguments of ROS 2"),
            ("play", [], "/joint_states: expected positions of the hand's joints, got none in 5 s"),
        ],
        ("hold", ["-p", "rate"], "--ros-args: expected arguments of ROS 2"),
    ),
    ids=lambda one: " ".join(one) if isinstance(one, list) else "",
)
def test_what_cannot_be_used_ends_the_command(planned, domain, command, arguments, told):
    with node(planned, command, *arguments) as process:
        assert process.wait(timeout=90) == 2
        assert told in process.stderr.read()
