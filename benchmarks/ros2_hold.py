"""How steadily ``pinograsp ros2 hold`` publishes: rate, periods, processor time.

    python benchmarks/ros2_hold.py --seconds 60 --rate 500 [--hand allegro_right] [--sensors 500] [--json]

The node runs in a process of its own and talks DDS on this machine. This process publishes joint states, forces and
slips as planned, each at the rate of ``--sensors`` [Hz], and takes the commands. Periods are those between the times at
which the node has published (of the middleware, ``source_timestamp``), from a second after the first command on;
``late``: share of the periods that are more than half a period too long; ``age``: from there until the command is here;
``node``, ``this``: processor time of the two, in cores. Needs the extra ros2; ``chrt -r 5 python ...`` gives both
processes precedence over others. Writes ros2_hold.csv beside this file; the last line is JSON with ``--json``.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from results import header, table, write_rows

import pinograsp as pg

HERE = Path(__file__).resolve().parent


def make_plan(hand: str) -> pg.GraspPlan:
    conditions = pg.GraspConditions(mu=0.6)
    can = pg.Cylinder(radius=0.03, height=0.12, mass=0.15)
    return pg.plan_best(pg.find_grasps(pg.load_hand(hand), can, conditions, count=24, seed=1), conditions)


def measure(plan: pg.GraspPlan, folder: Path, seconds: float, rate: float, sensors: float) -> dict[str, float]:
    """Talk to a node for some time."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    rclpy.init(args=[])
    robot = rclpy.create_node("robot")
    sent: list[int] = []
    ages: list[int] = []

    def take(_: Float64MultiArray, info: dict[str, int]) -> None:
        sent.append(info["source_timestamp"])
        ages.append(time.time_ns() - info["source_timestamp"])

    robot.create_subscription(Float64MultiArray, "commands", take, 10)
    rotations = plan.contacts.rotations_oc
    forces = np.einsum("kji,kj->ki", rotations, plan.motion.forces_o[-1])
    messages = {
        "joint_states": JointState(
            name=list(plan.hand.joint_names),
            position=plan.motion.q[-1].tolist(),
            effort=plan.motion.holding_torques.tolist(),
        ),
        "forces": Float64MultiArray(data=forces.ravel().tolist()),
        "slips": Float64MultiArray(data=[0.0] * len(forces)),
    }
    publishers = {
        topic: robot.create_publisher(type(one), topic, qos_profile_sensor_data) for topic, one in messages.items()
    }

    def tell() -> None:
        messages["joint_states"].header.stamp = robot.get_clock().now().to_msg()
        for topic, publisher in publishers.items():
            publisher.publish(messages[topic])

    robot.create_timer(1.0 / sensors, tell)
    executor = SingleThreadedExecutor()
    executor.add_node(robot)
    line = [sys.executable, "-m", "pinograsp.cli", "ros2", "hold", str(folder), "--ros-args", "-p", f"rate:={rate}"]
    node = subprocess.Popen([*line, "--log-level", "warn"])
    try:
        while not sent:
            executor.spin_once(timeout_sec=0.1)
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.1)
        first, until, own = len(sent), time.monotonic() + seconds, time.process_time()
        clock = os.sysconf("SC_CLK_TCK")
        before = processor_time(node.pid) / clock
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.1)
        spent, own = processor_time(node.pid) / clock - before, time.process_time() - own
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(timeout=20)
        rclpy.shutdown()
    stamps, late = np.array(sent[first:]) * 1e-9, np.array(ages[first:]) * 1e-6
    periods = 1e3 * np.diff(stamps)
    return {
        "rate [Hz]": rate,
        "reached [Hz]": round(len(periods) / (stamps[-1] - stamps[0]), 2),
        "period median [ms]": round(float(np.median(periods)), 4),
        "p1 [ms]": round(float(np.percentile(periods, 1)), 3),
        "p99 [ms]": round(float(np.percentile(periods, 99)), 3),
        "largest [ms]": round(float(periods.max()), 2),
        "jitter median [us]": round(float(np.median(np.abs(periods - 1e3 / rate))) * 1e3, 1),
        "jitter p99 [us]": round(float(np.percentile(np.abs(periods - 1e3 / rate), 99)) * 1e3, 1),
        "late [%]": round(100 * float(np.mean(periods > 1.5e3 / rate)), 3),
        "age median [ms]": round(float(np.median(late)), 3),
        "age p99 [ms]": round(float(np.percentile(late, 99)), 3),
        "node [cores]": round(spent / seconds, 3),
        "this [cores]": round(own / seconds, 3),
    }


def processor_time(pid: int) -> int:
    """Of a process [clock ticks]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, nargs="+", default=[500.0], help="of the commands [Hz]")
    parser.add_argument("--sensors", type=float, default=500.0, help="rate of each of three topics [Hz]")
    parser.add_argument("--hand", default="allegro_right")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randrange(1, 200))
    policy = {os.SCHED_FIFO: "FIFO", os.SCHED_RR: "RR"}.get(os.sched_getscheduler(0), "none")
    plan = make_plan(arguments.hand)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        pg.save_run(plan, folder)
        rows = [
            {"scheduling": policy, "hand": arguments.hand, "joints": plan.hand.n}
            | measure(plan, folder, arguments.seconds, rate, arguments.sensors)
            for rate in arguments.rate
        ]
    load = f"{arguments.seconds:g} s each, sensors at {arguments.sensors:g} Hz, load {os.getloadavg()[0]:.1f}"
    write_rows(HERE / "ros2_hold.csv", header(["ros-rclpy", "ros-rmw-fastrtps-cpp"], load), rows)
    print(table(rows))
    if arguments.json:
        print(json.dumps(rows))


if __name__ == "__main__":
    main()
