"""The node from its beginning to its end."""

from __future__ import annotations

import gc
import signal
from collections.abc import Sequence

from pinograsp.checks import flag, instance_of, items_of, one_line
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.planner import GraspPlan
from pinograsp.ros2.node import GripNode

_WAKES = 0.1  # [s] at most without a look at whether it is to end


def run_node(plan: GraspPlan, arguments: Sequence[str] = (), *, plays: bool = False, reflex: bool = True) -> None:
    """Hold a plan's object until SIGINT or SIGTERM comes; the last command stays with the drives.

    A ROS 2 installation that is sourced is used as it is; else that of the extra ``ros2``. Called in the main thread.

    Args:
        plan: whose grasp is held.
        arguments: of ROS, as after ``--ros-args``: ``-p NAME:=VALUE``, ``-r FROM:=TO``, ``--params-file FILE``...
        plays: send the plan's trajectory first, from where the hand is.
        reflex: let the squeeze follow what is felt; False, with ``plays`` alone: the plan's last command stays.

    Raises:
        InvalidInput: arguments or parameters that cannot be used; a trajectory without joint states to start from, or
            without anybody who takes it.
        ExtraMissing: there is no ROS 2, or the compiled core is not installed.
    """
    instance_of("plan", plan, GraspPlan)
    if not flag("reflex", reflex) and not flag("plays", plays):
        raise InvalidInput("reflex: expected True where no trajectory is played, got False: nothing would be sent")
    rest = items_of("arguments", list(arguments), str)
    try:
        import rclpy
        from rclpy.executors import Executor, SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise ExtraMissing(
            f"ROS 2 is not there ({one_line(error)}): source an installation, as . /opt/ros/jazzy/setup.bash, or "
            "pip install 'pinograsp[ros2]'"
        ) from error
    try:  # much cheaper, where ROS has it
        from rclpy.experimental import EventsExecutor
    except ImportError:
        EventsExecutor = SingleThreadedExecutor
    try:
        rclpy.init(args=["--ros-args", *rest] if rest else [], signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        rclpy.try_shutdown()
        raise InvalidInput(
            f"--ros-args: expected arguments of ROS 2, got {' '.join(rest)} ({one_line(error)})"
        ) from None
    ended = False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        grip = GripNode(plan, plays=plays, reflex=reflex)
        executor: Executor = EventsExecutor()
        executor.add_node(grip.node)
        gc.collect()
        gc.freeze()  # what stays is not looked through again while commands wait
        while not (ended or grip.error):
            executor.spin_once(timeout_sec=_WAKES)
        executor.remove_node(grip.node)
        grip.node.destroy_node()
    finally:
        rclpy.try_shutdown()
        gc.unfreeze()
        for number, handler in before.items():
            signal.signal(number, handler)
    if grip.error:
        raise InvalidInput(grip.error)
