"""A robot without ROS: its topics by Cyclone DDS, its joints where a joint_trajectory_controller lets them be.

python cyclone_robot.py OPTIONS      # in JSON: names of joints, their positions, domain, namespace

Lines on standard input: `truth`, or `reset` of its stop. Each is answered by a line of JSON.
"""

import json
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

sys.path.insert(0, str(Path(__file__).parent))
from trajectory_controller import TrajectoryController

PERIOD_S = 0.01
CONFIG = """<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
QOS = Qos(Policy.Reliability.Reliable(100_000_000), Policy.Durability.Volatile, Policy.History.KeepLast(10))


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@final
@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@final
@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectoryPoint_"):
    positions: sequence[float64]
    velocities: sequence[float64]
    accelerations: sequence[float64]
    effort: sequence[float64]
    time_from_start: Duration


@final
@dataclass
class JointTrajectory(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectory_"):
    header: Header
    joint_names: sequence[str]
    points: sequence[JointTrajectoryPoint]


@final
@dataclass
class Bool(IdlStruct, typename="std_msgs::msg::dds_::Bool_"):
    data: bool = False


class Robot:
    def __init__(self, names, positions, domain, namespace):
        Domain(domain, CONFIG)
        participant = DomainParticipant(domain)

        def open_topic(name, kind):
            return Topic(participant, f"rt/{namespace}/{name}", kind)

        self._states = DataWriter(participant, open_topic("joint_states", JointState), qos=QOS)
        self._commands = DataReader(
            participant, open_topic("arm_controller/joint_trajectory", JointTrajectory), qos=QOS
        )
        self._stop = DataReader(participant, open_topic("stop", Bool), qos=QOS)
        self.names, self.q, self.qd = names, np.array(positions), np.zeros(len(names))
        self.controller = TrajectoryController(names, self.q, begins_at_desired=True)
        self.is_stopped, self.stops, self.lock = False, 0, threading.Lock()

    def run(self):
        due_s = time.monotonic()
        while True:
            with self.lock:
                self.turn(time.time())
            due_s = max(due_s + PERIOD_S, time.monotonic())
            time.sleep(due_s - time.monotonic() if due_s > time.monotonic() else 0.0)

    def turn(self, now_s):
        for each in take(self._stop, Bool):
            if each.data and not self.is_stopped:
                self.is_stopped, self.stops = True, self.stops + 1
                self.controller.hold()
        for each in take(self._commands, JointTrajectory):
            if not self.is_stopped:
                points = [(read(one.time_from_start), one.positions, one.velocities) for one in each.points]
                measured = self.q, self.qd
                self.controller.take(each.joint_names, points, read(each.header.stamp), now_s, measured)
        before = self.q
        self.q = self.controller.update(now_s, (self.q, self.qd))[0].copy()
        self.qd = (self.q - before) / PERIOD_S
        stamp = Time(int(now_s), int((now_s - int(now_s)) * 1e9))
        rows = (self.q.tolist(), self.qd.tolist(), [0.0] * len(self.q))
        self._states.write(JointState(Header(stamp), list(self.names), *rows))

    def answer(self, order):
        with self.lock:
            if order == "reset":
                self.is_stopped = False
            return {"stops": self.stops, "counts": dict(self.controller.counts), "q": self.q.tolist()}


def take(reader, kind):
    """Messages; not the news that a writer is gone."""
    return [each for each in reader.take(20) if isinstance(each, kind)]


def read(duration):
    return duration.sec + 1e-9 * duration.nanosec


if __name__ == "__main__":
    robot = Robot(**json.loads(sys.argv[1]))
    threading.Thread(target=robot.run, daemon=True).start()
    for line in sys.stdin:
        print(json.dumps(robot.answer(line.strip())), flush=True)
