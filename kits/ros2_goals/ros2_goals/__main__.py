"""`python -m ros2_goals WORKSPACE`: serve the goals of a workspace until Ctrl-C."""

import argparse
import signal
import sys
import threading
from pathlib import Path

import rclpy
from rclpy.executors import MultiThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from ros2_goals.framework import Framework, Refused
from ros2_goals.goals import Rules
from ros2_goals.node import GoalServer

_END_S = 20.0  # for goals to be cancelled


def read_arguments() -> tuple[argparse.Namespace, list[str]]:
    """Those of this program, and what is for ROS."""
    parser = argparse.ArgumentParser(prog="ros2_goals", description="Verified goals of a workspace as a ROS 2 action.")
    parser.add_argument("workspace", type=Path, help="folder that `paos run` has made")
    parser.add_argument("--paos", default="paos", help="the command of the environment that has phyagentos[mcp]")
    parser.add_argument("--level", choices=("read", "propose", "submit"), default="read", help="as for `paos mcp`")
    about = "a goal graph of the library that runs without a further decision; repeatable"
    parser.add_argument("--permit", metavar="GRAPH", action="append", default=[], help=about)
    parser.add_argument("--policy", type=Path, help="at level submit: the file that decides, as for `paos approve`")
    parser.add_argument("--waiting", type=int, default=4, metavar="N", help="goals that may wait for their turn")
    managed = "begin unconfigured, for a lifecycle manager; active without"
    parser.add_argument("--managed", action="store_true", help=managed)
    return parser.parse_known_args()


def main() -> None:
    """Serve until a signal; then every goal is cancelled."""
    given, of_ros = read_arguments()
    framework = Framework(given.paos, given.workspace.resolve(), given.level)
    try:
        framework.tools.open()
    except Refused as error:
        sys.exit(f"ros2_goals: {error}")
    rclpy.init(args=of_ros, signal_handler_options=SignalHandlerOptions.NO)
    node = GoalServer(framework, Rules(frozenset(given.permit), given.policy), given.waiting)
    if not given.managed:
        node.trigger_configure()
        node.trigger_activate()
    executor = MultiThreadedExecutor(num_threads=given.waiting + 8)  # a goal holds one until its end
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    is_over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: is_over.set())
    is_over.wait()
    node.close(_END_S)
    executor.shutdown()
    spinning.join(_END_S)
    node.destroy_node()  # a node whose threads outlive its context crashes
    rclpy.shutdown()


if __name__ == "__main__":
    main()
