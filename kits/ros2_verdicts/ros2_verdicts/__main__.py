"""`python -m ros2_verdicts --scene SCENE --accept CRITERION`: publish verdicts on any robot until Ctrl-C."""

import argparse
import signal
import sys
import threading
from pathlib import Path

import rclpy
from rclpy.executors import MultiThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from ros2_verdicts.node import VerdictNode
from ros2_verdicts.question import Question, Refused

INVALID_INPUT = 2
_END_S = 20.0  # for a verdict to be formed


def read_arguments() -> tuple[argparse.Namespace, list[str]]:
    """Those of this program, and what is for ROS."""
    about = "A second opinion on what a ROS 2 robot did, whatever program moves it."
    parser = argparse.ArgumentParser(prog="ros2_verdicts", description=about)
    parser.add_argument("--scene", required=True, help="of the library: the scene whose objects the cameras show")
    parser.add_argument("--accept", required=True, action="append", help="a criterion; repeatable")
    parser.add_argument("--robot", default="", help="of the library; by its joints without")
    parser.add_argument("--settings", type=Path, help="YAML: topics, frames and clocks, as for `paos verify --bag`")
    parser.add_argument("--topics", nargs="+", default=[], help="how the names of topics begin; all without")
    parser.add_argument("--every", type=float, default=0.0, metavar="SECONDS", help="verdicts in a rhythm as well")
    parser.add_argument("--to", type=Path, default=Path("verdicts"), metavar="DIR", help="where evidence is written")
    parser.add_argument("--paos", default="paos", help="the command of the environment that has phyagentos[export]")
    return parser.parse_known_args()


def main() -> int:
    """Watch until a signal; 2 where no recording could decide the criteria."""
    given, of_ros = read_arguments()
    given.to.mkdir(parents=True, exist_ok=True)
    question = Question(given.paos, given.scene, tuple(given.accept), given.robot, given.settings)
    try:
        question.check(given.to.resolve())
    except Refused as error:
        print(f"ros2_verdicts: {error}", file=sys.stderr)
        return INVALID_INPUT
    rclpy.init(args=of_ros, signal_handler_options=SignalHandlerOptions.NO)
    node = VerdictNode(question, given.topics, given.to.resolve(), given.every)
    executor = MultiThreadedExecutor(num_threads=4)  # verdicts take two; messages are received beside them
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    is_over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: is_over.set())
    is_over.wait()
    executor.shutdown()
    spinning.join(_END_S)
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
