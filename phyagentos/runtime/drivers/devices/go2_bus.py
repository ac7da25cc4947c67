"""The legs of a Unitree Go2 at low level: topics `rt/lowcmd` and `rt/lowstate` of DDS, by Cyclone DDS.

Each motor follows tau = kp (q - q_now) + kd (dq - dq_now), with the gains of the profile. The latest command is
repeated every 10 ms, as the vendor's examples repeat theirs. The emergency stop is damping, kp = 0 in all motors: the
legs sink. The robot's sport mode publishes `rt/lowcmd`, too: while it does, no session begins, and one that runs ends.
"""

import contextlib
import threading
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pydantic
from typing_extensions import override

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.devices.device_driver import Array, Bus, DeviceSettings, Reading
from phyagentos.runtime.drivers.devices.go2_messages import compute_crc, define_messages

HEAD, LOW_LEVEL, SERVO = (0xFE, 0xEF), 0xFF, 1
REPEAT_S, POLL_S, LISTEN_S, DISCOVERY_S = 0.01, 0.001, 0.1, 2.0
OTHERS = "another program commands the legs on rt/lowcmd"
UNICAST = """<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address={peer}/></Peers></Discovery>"""
CONFIGURATION = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name={interface}/></Interfaces>
{rest}</Domain></CycloneDDS>"""


class Go2Settings(DeviceSettings):
    """The network.

    Attributes:
        domain: Number of the DDS domain; robots are in 0.
        peer: Address that is asked for participants, instead of by multicast; empty for multicast.
    """

    domain: int = pydantic.Field(default=0, ge=0, le=232)
    peer: str = ""


class Go2Bus(Bus):
    """Twelve motors, in the order of the profile's joints, on the network interface of its `endpoint`."""

    def __init__(self, profile: TargetProfile, settings: Go2Settings, clock: Clock) -> None:
        from cyclonedds.core import DDSException, Policy, Qos
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        self._place, self._settings, self._clock, arm = profile.endpoint, settings, clock, profile.arm
        self._gains = list(zip(arm.stiffness_nm_rad, arm.damping_nms_rad, strict=True))
        rest = UNICAST.format(peer=quoteattr(settings.peer)) if settings.peer else "</General>"
        configuration = CONFIGURATION.format(interface=quoteattr(self._place), rest=rest)
        try:
            self._domain = Domain(settings.domain, configuration)
        except DDSException as error:
            cause = f"{self._place}, domain {settings.domain}: {error}; check cable and interface"
            raise ExecutionError("TARGET_LOST", cause) from error
        participant = DomainParticipant(settings.domain)
        self._messages = define_messages()
        commands = Topic(participant, "rt/lowcmd", self._messages.command)
        self._states = DataReader(participant, Topic(participant, "rt/lowstate", self._messages.state))
        self._others = DataReader(participant, commands, Qos(Policy.IgnoreLocal.Participant))
        self._writer = DataWriter(participant, commands)
        self._command: Any = None  # the latest
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._repeat, daemon=True, name="rt/lowcmd")
        self._thread.start()
        with contextlib.suppress(ExecutionError):  # a robot that stays silent is lost when it is asked
            self._await_state(DISCOVERY_S)

    @override
    def read(self) -> Reading:
        motors = self._await_state(self._settings.silence_max_s).motor_state[: len(self._gains)]
        return Reading(
            q_rad=np.array([motor.q for motor in motors]),
            qd_rad_s=np.array([motor.dq for motor in motors]),
            fault=OTHERS if _take(self._others) else "",
        )

    @override
    def enable(self, q_rad: Array, width_m: float) -> None:
        """Hold this posture; raises ExecutionError `TARGET_BUSY` while another program commands the legs."""
        _take(self._others)
        self._clock.sleep(LISTEN_S)
        if _take(self._others):
            hint = "release the sport mode first (MotionSwitcherClient.ReleaseMode)"
            raise ExecutionError("TARGET_BUSY", f"{self._place}: {OTHERS}; {hint}")
        self.write(q_rad, np.zeros_like(q_rad), width_m)

    @override
    def write(self, q_rad: Array, qd_rad_s: Array, width_m: float) -> None:
        rows = zip(q_rad.tolist(), qd_rad_s.tolist(), self._gains, strict=True)
        self._send([self._messages.motor(mode=SERVO, q=q, dq=dq, kp=kp, kd=kd) for q, dq, (kp, kd) in rows])

    @override
    def stop(self) -> None:
        self._send([self._messages.motor(mode=SERVO, kd=kd) for _, kd in self._gains])
        self._await_state(self._settings.silence_max_s)

    @override
    def close(self) -> None:
        """Nothing is repeated any more; what the motors do then is the robot's own."""
        self._ended.set()
        self._thread.join()
        self._states = self._others = self._writer = self._domain = None

    def _send(self, motors: list[Any]) -> None:
        command = self._messages.command(head=[*HEAD], level_flag=LOW_LEVEL)
        command.motor_cmd[: len(motors)] = motors
        command.crc = compute_crc(command)
        with self._lock:
            self._command = command
            self._writer.write(command)

    def _repeat(self) -> None:
        while not self._ended.wait(REPEAT_S):
            with self._lock:
                if self._command is not None:
                    self._writer.write(self._command)

    def _await_state(self, longest_s: float) -> Any:
        """A state that came since the call."""
        _take(self._states)
        end_s = self._clock.now_s() + longest_s
        while not (found := _take(self._states)):
            if self._clock.now_s() > end_s:
                silence = f"no LowState within {longest_s} s"
                raise ExecutionError("TARGET_LOST", f"{self._place}: {silence}; check cable, power and interface")
            self._clock.sleep(POLL_S)
        return found[0]


def _take(reader: Any) -> list[Any]:
    """The latest sample, if one came since the last time; notices without data are left out."""
    return [sample for sample in reader.take() if sample.sample_info.valid_data]
