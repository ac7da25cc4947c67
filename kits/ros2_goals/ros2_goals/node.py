"""The ROS 2 node: the action `run_goal`, the services `stop` and `pause`, and diagnostics of one workspace."""

import threading
from collections.abc import Iterator
from datetime import datetime

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from phyagentos_msgs.action import RunGoal
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from ros2_goals.framework import Framework, Refused
from ros2_goals.goals import CANCEL, Line, Outcome, Progress, Pursuit, Request, Rules

_DIAGNOSTICS_S = 1.0
_CALLER = "a ROS 2 service call"


class GoalServer(LifecycleNode):  # type: ignore[misc,unused-ignore]  # a ROS distribution brings no types
    """Serves one workspace; `waiting_max` goals wait for their turn, and further ones are rejected.

    Goals are taken while it is active. One that is deactivated or shut down cancels those that it has.
    """

    def __init__(self, framework: Framework, rules: Rules, waiting_max: int) -> None:
        super().__init__("phyagentos")
        self._framework, self._rules, self._waiting_max = framework, rules, waiting_max
        self._line, self._places = Line(), threading.Semaphore(waiting_max + 1)
        self._pursuits: dict[bytes, Pursuit] = {}
        self._said = {"last rejection": "", "last goal": ""}
        self._is_active = False
        self._is_over = threading.Event()
        at_once = ReentrantCallbackGroup()
        self._action = ActionServer(
            self,
            RunGoal,
            "~/run_goal",
            self._carry_out,
            goal_callback=self._admit,
            handle_accepted_callback=self._enter,
            cancel_callback=self._cancel,
            callback_group=at_once,
        )
        self.create_service(Trigger, "~/stop", self._stop, callback_group=at_once)
        self.create_service(Trigger, "~/pause", self._pause, callback_group=at_once)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(_DIAGNOSTICS_S, self._publish_diagnostics, callback_group=at_once)
        say = self.get_logger().error
        follow = threading.Thread(target=framework.follow, args=[self._line.put, self._is_over, say], daemon=True)
        follow.start()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._rest()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._rest()
        return super().on_shutdown(state)

    def _rest(self) -> None:
        self._is_active = False
        self._line.put(CANCEL)

    def close(self, patience_s: float) -> None:
        """Cancel every goal, and wait for their ends."""
        self._rest()
        waits = threading.Event()
        for _ in range(int(10 * patience_s)):
            if not len(self._line) or waits.wait(0.1):
                break
        self._is_over.set()

    def _admit(self, request: RunGoal.Goal) -> GoalResponse:
        """Reject what cannot be proposed at all; whether it may run is decided later."""
        problem = self._find_problem(_read(request))
        if not problem and not self._places.acquire(blocking=False):
            problem = f"{self._waiting_max} goals wait already; expected: a later call"
        if problem:
            self.get_logger().warning(f"rejected: {problem}")
            self._said["last rejection"] = problem
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _find_problem(self, request: Request) -> str:
        if not self._is_active:
            return f"{self.get_name()} is not active: `ros2 lifecycle set {self.get_fully_qualified_name()} activate`"
        if self._framework.level == "read":
            return "this server was started with the level `read`: goals need `propose` or `submit`"
        if bool(request.graph) == bool(request.words):
            return f"graph, words: found {'both' if request.graph else 'none'} of them; expected one"
        if request.seed < 0:
            return f"seed: found {request.seed}; expected 0 or greater"
        try:
            overrides = request.parse_parameters()
            if request.graph:
                self._framework.tools.call("compile", graph=request.graph, overrides=overrides)
        except Refused as error:
            return str(error)
        return ""

    def _enter(self, handle: ServerGoalHandle) -> None:
        pursuit = Pursuit(self._framework, self._rules, _read(handle.request), lambda each: _show(handle, each))
        self._pursuits[bytes(handle.goal_id.uuid)] = pursuit
        self._line.enter(pursuit)
        handle.execute()

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        pursuit = self._pursuits.get(bytes(handle.goal_id.uuid))
        if pursuit is None:
            return CancelResponse.REJECT
        pursuit.events.put(CANCEL)
        return CancelResponse.ACCEPT

    def _carry_out(self, handle: ServerGoalHandle) -> RunGoal.Result:
        pursuit = self._pursuits[bytes(handle.goal_id.uuid)]
        outcome = Outcome(reason="a defect of this server; see what it printed")
        try:
            outcome = pursuit.carry_out()
        finally:
            self._line.leave(pursuit)
            del self._pursuits[bytes(handle.goal_id.uuid)]
            self._said["last goal"] = f"{outcome.goal} {outcome.verdict or 'no verdict'}: {outcome.reason}"
            if outcome.verdict == "success":
                handle.succeed()
            elif outcome.verdict == "cancelled" and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            self._places.release()
        return RunGoal.Result(**vars(outcome))

    def _stop(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        """The emergency stop; only a person resets it."""
        return self._answer("estop", answer)

    def _pause(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        """A rest at the end of the present motion; only a person lets it go on."""
        return self._answer("pause", answer, session="all")

    def _answer(self, tool: str, answer: Trigger.Response, **about: str) -> Trigger.Response:
        try:
            done = self._framework.stop(tool, reason=_CALLER, **about)
            answer.message = "; ".join(each["file"] or each["subject"] for each in done.get("requests", ()))
            answer.success = bool(answer.message)
        except Refused as error:
            answer.message = str(error)
        return answer

    def _publish_diagnostics(self) -> None:
        message = DiagnosticArray(status=[self._describe()])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _describe(self) -> DiagnosticStatus:
        present, is_stopped = self._line.find_present(), self._framework.is_stopped()
        status = DiagnosticStatus(name=f"{self.get_name()}: goals", hardware_id=str(self._framework.root))
        status.level = DiagnosticStatus.ERROR if is_stopped else DiagnosticStatus.OK
        rests = "no goal" if self._is_active else "not active"
        running = f"runs {present.name or 'the first goal of its line'}" if present else rests
        status.message = "emergency stop is latched" if is_stopped else running
        facts = {"goal": present.name if present else "", "waiting": str(max(0, len(self._line) - 1)), **self._said}
        status.values = [KeyValue(key=key, value=value) for key, value in facts.items()]
        return status


def _read(goal: RunGoal.Goal) -> Request:
    return Request(goal.graph, goal.words, goal.scene, tuple(goal.parameters), goal.seed)


def _show(handle: ServerGoalHandle, progress: Progress) -> None:
    facts = dict(_iter_facts(progress))
    handle.publish_feedback(RunGoal.Feedback(stamp=_read_time(progress.at), **facts))


def _iter_facts(progress: Progress) -> Iterator[tuple[str, str]]:
    yield from ((name, value) for name, value in vars(progress).items() if name != "at")


def _read_time(at: str) -> Time:
    seconds = datetime.fromisoformat(at.removesuffix("Z") + "+00:00").timestamp()  # Python 3.10 reads no Z
    return Time(sec=int(seconds), nanosec=int(seconds % 1 * 1e9))
