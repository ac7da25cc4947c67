"""The ROS 2 node: it receives what verdicts rest on, forms them when requested or in a rhythm, and publishes them."""

import json
import math
import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ros2_verdicts.question import Question, Refused, Verdict
from ros2_verdicts.recent import Message, Recent

SILENCE_S = 1.0
_LOOK_FOR_TOPICS_S = 0.5
_TYPES = ("JointState", "Image", "CompressedImage", "CameraInfo")
RECEIVED = (*(f"sensor_msgs/msg/{name}" for name in _TYPES), "tf2_msgs/msg/TFMessage")
_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_PICTURES = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
_STATES = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
_HAS_TIMES = hasattr(Subscription, "CallbackType")  # of reception; not in Humble
_LEVELS = {"true": DiagnosticStatus.OK, "false": DiagnosticStatus.ERROR, "unknown": DiagnosticStatus.WARN}


class VerdictNode(Node):  # type: ignore[misc,unused-ignore]  # a ROS distribution brings no types
    """Watches topics and commands nothing.

    `~/verify` (std_srvs/Trigger) forms a verdict: `success` where every criterion is true, `message` is why not.
    `~/begin` (std_srvs/Trigger) makes now the beginning with which criteria such as `moved` compare.
    `~/verdict` (std_msgs/String, latched) is the latest verdict as JSON; `/diagnostics` has a line for each criterion.
    """

    def __init__(self, question: Question, topics: Sequence[str], evidence: Path, every_s: float) -> None:
        super().__init__("phyagentos_verdicts")
        self._question, self._topics, self._evidence = question, tuple(topics), evidence
        self._recent, self._judging = Recent(), threading.Lock()
        self._received: set[str] = set()
        self._number = max((int(each.name) for each in evidence.iterdir() if each.name.isdecimal()), default=0)
        at_once = ReentrantCallbackGroup()
        self._verdict = self.create_publisher(String, "~/verdict", _LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_service(Trigger, "~/verify", self._verify, callback_group=at_once)
        self.create_service(Trigger, "~/begin", self._begin, callback_group=at_once)
        self.create_timer(_LOOK_FOR_TOPICS_S, self._receive_new_topics)
        if every_s:
            self.create_timer(every_s, self.form_verdict, callback_group=ReentrantCallbackGroup())

    def form_verdict(self) -> Verdict:
        """One verdict on the present world, published; unknown with its `reason` where none could be formed."""
        with self._judging:
            silent_s = self._recent.find_silence()
            if silent_s > SILENCE_S:
                said = "yet" if math.isinf(silent_s) else f"for {silent_s:.1f} s"
                verdict: Verdict = {"verdict": "unknown", "reason": f"no message was received {said}"}
            else:
                verdict = self._judge()
        self._publish(verdict)
        return verdict

    def _judge(self) -> Verdict:
        self._number += 1
        with TemporaryDirectory(prefix="ros2_verdicts-") as folder:
            try:
                self._recent.write(Path(folder) / "bag")
                return self._question.judge(Path(folder) / "bag", self._evidence / f"{self._number:04}")
            except (Refused, OSError) as error:
                self.get_logger().error(str(error))
                return {"verdict": "unknown", "reason": str(error)}

    def _receive_new_topics(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            is_wanted = not self._topics or topic.startswith(self._topics)
            if topic in self._received or not is_wanted or types[0] not in RECEIVED:
                continue
            self._received.add(topic)
            package, _, name = types[0].split("/")
            try:
                kind = getattr(import_module(f"{package}.msg"), name)
            except ImportError:
                self.get_logger().warning(f"{topic}: {package} is not installed; it is left out")
                continue
            is_lens, is_fixed = name == "CameraInfo", topic.endswith("tf_static")
            found = self.get_publishers_info_by_topic(topic) if is_lens else ()
            is_latched = is_fixed or any(each.qos_profile.durability == _LATCHED.durability for each in found)
            quality = _LATCHED if is_latched else _STATES if name in {"JointState", "TFMessage"} else _PICTURES
            receive = partial(self._receive, topic, types[0], is_lens or is_fixed)
            callback = receive if _HAS_TIMES else partial(receive, times={})
            self.create_subscription(kind, topic, callback, quality, raw=True)

    def _receive(self, topic: str, kind: str, is_latched: bool, data: bytes, times: Mapping[str, int]) -> None:
        received_ns = times.get("received_timestamp", 0)
        waited_ns = max(0, time.time_ns() - received_ns) if received_ns else 0  # for this thread, on a busy machine
        now_ns = self.get_clock().now().nanoseconds - waited_ns
        self._recent.keep(Message(topic, kind, now_ns, data), is_latched=is_latched)

    def _begin(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        self._recent.begin()
        answer.success = True
        return answer

    def _verify(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        verdict = self.form_verdict()
        answer.success, answer.message = verdict["verdict"] == "true", describe(verdict)
        return answer

    def _publish(self, verdict: Verdict) -> None:
        self._verdict.publish(String(data=json.dumps(verdict)))
        judged = {each["text"]: (each["truth"], each["because"]) for each in verdict.get("criteria", ())}
        judged = judged or dict.fromkeys(self._question.accept, ("unknown", verdict["reason"]))
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                name=f"{self.get_name()}: {text}",
                level=_LEVELS[truth],
                message=truth,
                values=[KeyValue(key="because", value=because)],
            )
            for text, (truth, because) in judged.items()
        ]
        self._diagnostics.publish(message)


def describe(verdict: Verdict) -> str:
    """A verdict in a line: the reason of what is not true, else of everything."""
    criteria = verdict.get("criteria", ())
    decisive = [each for each in criteria if each["truth"] == verdict["verdict"]]
    return "; ".join(f"{each['text']}: {each['because']}" for each in decisive) or str(verdict.get("reason", ""))
