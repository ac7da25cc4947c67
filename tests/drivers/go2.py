"""A Unitree Go2 on DDS, in a process of its own: LowCmd in, LowState out, and the legs that they move.

The trunk hangs on a stand, the legs below it. The motors follow the vendor's law of kp, kd and tau. Commands with a
wrong checksum are left out. What the robot does when commands stay away is not published: here the motors brake.
"""

import dataclasses
import multiprocessing
import re
import struct
import threading
import time

import mujoco
import numpy as np

from tests.drivers.plant import Plant, read_model

DOMAIN = 1
CONFIGURATION = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>"""
MOTORS = [f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
HANGING = (0.0, 0.9, -1.8) * 4  # before the legs are let go
STAND_M = 0.6
PERIOD_S, SILENT_S, BRAKE = 0.01, 0.1, 5.0  # of the states, the robot's is 0.002; nms/rad
LOW_CMD = "<4B4IH2x" + "B3x5f3I" * 20 + "4B" + "55Bx2I"  # the vendor's C structs, as its Python package packs them
LOW_STATE = "<4B4IH2x13fb3x" + "B3x7fb3x3I" * 20 + "4BiH4b15H" + "8hI41B3xf2b2x2f4h2I"


def list_letters(layout):
    """Kinds of the numbers of a struct, in order."""
    parts = re.findall(r"(\d*)([A-Za-z])", layout)
    return [kind for count, kind in parts if kind != "x" for _ in range(int(count or 1))]


def list_leaves(value):
    """Numbers of a message, in order."""
    if dataclasses.is_dataclass(value):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    return [leaf for each in value for leaf in list_leaves(each)] if hasattr(value, "__len__") else [value]


def number_leaves(value, numbers):
    """A message whose numbers are these, in order."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            setattr(value, field.name, number_leaves(getattr(value, field.name), numbers))
        return value
    return [number_leaves(each, numbers) for each in value] if isinstance(value, list) else next(numbers)


def compute_checksum(command):
    """The vendor's: bit by bit over the words of the C struct but the last."""
    remainder = 0xFFFFFFFF
    for (word,) in struct.iter_unpack("<I", struct.pack(LOW_CMD, *list_leaves(command))[:-4]):
        for bit in range(31, -1, -1):
            top, remainder = remainder >> 31, remainder << 1 & 0xFFFFFFFF
            remainder ^= 0x04C11DB7 * (top ^ word >> bit & 1)
    return remainder


class Robot:
    """The robot itself."""

    def __init__(self, model_file):
        model = read_model(model_file, is_fixed=True)
        model.body_pos[model.body("base").id, 2] = STAND_M
        self._limits = model.actuator_ctrlrange[[model.actuator(name).id for name in MOTORS]]
        self._joints = [f"{name}_joint" for name in MOTORS]
        self.plant = Plant(model, self._joints, MOTORS, HANGING, self._follow)
        self.plant.command(np.zeros(12))
        mujoco.mj_step(model, self.plant.data, nstep=5000)  # the legs are let go
        self._rest = self.plant.data.qpos.copy()
        self.rest()

    def rest(self):
        """Hang as after a while without commands."""
        with self.plant.lock:
            self.plant.data.qpos, self.plant.data.qvel = self._rest, 0.0
            self._rows, self._told_s, self._last, self.wrong = np.zeros((12, 5)), -np.inf, None, 0
            self._start, self.swing = self.plant.data.qpos[self.plant._q[0]], 0.0

    def run(self, link):
        """Until the other end of the link asks for the end."""
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        from phyagentos.runtime.drivers.devices.go2_bus import define_messages

        _, LowCmd, LowState = define_messages()
        domain = Domain(DOMAIN, CONFIGURATION)
        participant, other = DomainParticipant(DOMAIN), DomainParticipant(DOMAIN)
        commands = DataReader(participant, Topic(participant, "rt/lowcmd", LowCmd))
        states = DataWriter(participant, Topic(participant, "rt/lowstate", LowState))
        sport = DataWriter(other, Topic(other, "rt/lowcmd", LowCmd))
        self.plant.start()
        state, asked = "rest", "rest"
        while asked != "end":
            if link.poll(PERIOD_S):
                asked = link.recv()
                state = state if asked == "look" else asked
                if asked == "rest":
                    self.rest()
                link.send((*self.plant.read(), self.wrong, self.swing))
            received = [each for each in commands.take() if each.sample_info.valid_data]
            if state == "cut":
                continue
            for command in received:
                self._receive(command)
            if state == "sport":
                sport.write(LowCmd())
            states.write(self._report(LowState(head=[0xFE, 0xEF], level_flag=0xFF)))
        self.plant.close()
        del domain

    def _receive(self, command):
        if command != self._last and compute_checksum(command) != command.crc:
            self.wrong += 1
            return
        self._last = command
        motors = command.motor_cmd[:12]
        with self.plant.lock:
            self.plant.advance()
            self._told_s = time.perf_counter()
            rows = [[m.q, m.dq, m.tau, m.kp, m.kd] if m.mode == 1 else [0.0] * 5 for m in motors]
            self._rows = np.array(rows)

    def _follow(self, dt):
        data, plant = self.plant.data, self.plant
        if self._told_s < time.perf_counter() - SILENT_S:
            self._rows = np.array([[0.0, 0.0, 0.0, 0.0, BRAKE]] * 12)
        q, dq, tau, kp, kd = self._rows.T
        torque = kp * (q - data.qpos[plant._q]) + kd * (dq - data.qvel[plant._v]) + tau
        plant.command(np.clip(torque, *self._limits.T))

    def _report(self, state):
        q, dq = self.plant.read()
        self.swing = max(self.swing, abs(q[0] - self._start))
        for motor, position, velocity in zip(state.motor_state, q.tolist(), dq.tolist(), strict=False):
            motor.mode, motor.q, motor.dq = 1, position, velocity
        return state


def _run(model_file, link):
    Robot(model_file).run(link)


class Go2:
    """The robot in its process."""

    def __init__(self, model_file):
        context = multiprocessing.get_context("spawn")
        self._link, other = context.Pipe()
        self._process = context.Process(target=_run, args=(model_file, other), daemon=True)
        self._process.start()
        self.ask("rest")

    def ask(self, what):
        """`rest`, `cut` the cable, let the `sport` mode command, too, or only `look`.

        Returns:
            Joint positions and velocities (12,) [rad, rad/s], how many checksums were wrong, and how far the first
            joint swung since it rested [rad].
        """
        self._link.send(what)
        return self._link.recv()

    def close(self):
        self.ask("end")
        self._process.join(10)


class Listener:
    """A third participant: the commands that passed, in order; each is (kp, kd) of twelve motors."""

    def __init__(self):
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        from phyagentos.runtime.drivers.devices.go2_bus import define_messages

        self.frames, self._ended = [], threading.Event()
        self._domain = Domain(DOMAIN, CONFIGURATION)
        participant = DomainParticipant(DOMAIN)
        self._reader = DataReader(participant, Topic(participant, "rt/lowcmd", define_messages().command))
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def count(self, is_stop):
        """Frames that are a damping of all motors, or are not."""
        return sum(is_damping == is_stop for is_damping in list(self.frames))

    def close(self):
        self._ended.set()
        self._thread.join()
        self._reader = self._domain = None

    def _listen(self):
        while not self._ended.wait(0.002):
            for command in [each for each in self._reader.take() if each.sample_info.valid_data]:
                motors = command.motor_cmd[:12]
                self.frames.append(all(m.mode == 1 and m.kp == 0 and m.kd > 0 for m in motors))
