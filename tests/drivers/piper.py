"""An AgileX PIPER on a CAN channel: the frames of protocol V2, by `python-can` alone, and the arm that they move.

The gains are this project's. Powered, the arm holds its own weight. After an emergency stop it sinks, braked; how fast
the robot does is not published. Without power it falls.
"""

import struct
import threading

import can
import numpy as np

from tests.drivers.plant import Plant, read_model

STOP_CONTROL, MODE_CONTROL, JOINT_CONTROL, GRIPPER_CONTROL, ENABLE = 0x150, 0x151, (0x155, 0x156, 0x157), 0x159, 0x471
STATUS, JOINTS, GRIPPER, FAST, SLOW = 0x2A1, 0x2A5, 0x2A8, 0x251, 0x261
STEPS = 180_000.0 / np.pi  # per rad
FASTEST_RAD_S = 3.14
STIFFNESS, DAMPING, STOP_DAMPING = 2000.0, 80.0, 600.0
PERIOD_S = 0.01  # of the feedback; the robot's is 0.005
NAMES = [f"joint{each}" for each in range(1, 8)]


class Piper:
    """Six joints and a gripper; `is_stopped`, `powered` and `mode` are what its status frames say."""

    def __init__(self, model_file, channel, q_rad, powered=True):
        model = read_model(model_file)
        arm = [model.actuator(name).id for name in NAMES[:6]]
        model.actuator_gainprm[arm, 0] = STIFFNESS
        model.actuator_biasprm[arm, 1:3] = -STIFFNESS, -DAMPING
        self._weightless = model.body_gravcomp.copy()
        self.powered, self.is_stopped, self.mode = powered, False, 0
        self._start, self.swing = q_rad[0], 0.0  # how far the first joint went since [rad]
        self._goals = np.array([*q_rad, 0.0])
        self._profile, self._is_cut = self._goals.copy(), False
        self.plant = Plant(model, NAMES, [*NAMES[:6], "gripper"], self._goals, self._follow)
        self._arm, self._bus = arm, can.Bus(channel, interface="virtual")
        self.plant.start()
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._receive, self._report)]
        for thread in self._threads:
            thread.start()

    def cut(self):
        """The cable breaks."""
        self._is_cut = True

    def close(self):
        self._ended.set()
        for thread in self._threads:
            thread.join()
        self._bus.shutdown()
        self.plant.close()

    def reset(self):
        """What a person does after an emergency stop: support the arm, reset it, put it back."""
        with self.plant.lock:
            self.is_stopped, self.powered, self.mode = False, True, 0
            self._goals = np.array([*self.plant.read()[0][:6], self._goals[6]])

    def _follow(self, dt):
        model, q = self.plant.model, self.plant.data.qpos[self.plant._q]
        holds = self.powered and not self.is_stopped
        model.body_gravcomp[:] = self._weightless * holds
        self.plant.power(np.full(7, holds))
        if self.is_stopped and self.powered:
            model.actuator_biasprm[self._arm, 2] = -STOP_DAMPING
        way = self._goals - self._profile
        self._profile = self._profile + np.clip(way, -FASTEST_RAD_S * dt, FASTEST_RAD_S * dt) if holds else q.copy()
        self.plant.command(self._profile)

    def _receive(self):
        while not self._ended.is_set():
            frame = self._bus.recv(0.05)
            if frame is not None and not self._is_cut:
                with self.plant.lock:
                    self.plant.advance()
                    self._carry_out(frame.arbitration_id, bytes(frame.data))

    def _carry_out(self, kind, data):
        if kind == STOP_CONTROL and data[0] == 1:
            self.is_stopped = True
        elif kind == STOP_CONTROL and data[0] == 2:
            self.is_stopped, self.powered, self.mode = False, False, 0
        elif kind == ENABLE and not self.is_stopped and data[0] in {7, 0xFF}:
            if data[1] == 2 and not self.powered:
                self._goals = self.plant.data.qpos[self.plant._q].copy()
            self.powered = data[1] == 2
        elif kind == MODE_CONTROL and not self.is_stopped:
            self.mode = data[0]
        elif self.mode == 1 and not self.is_stopped and kind in JOINT_CONTROL:
            at = 2 * JOINT_CONTROL.index(kind)
            self._goals[at : at + 2] = np.array(struct.unpack(">ii", data)) / STEPS
        elif self.mode == 1 and not self.is_stopped and kind == GRIPPER_CONTROL:
            self._goals[6] = struct.unpack(">i", data[:4])[0] / 2e6  # each finger goes half of the way

    def _report(self):
        while not self._ended.wait(PERIOD_S):
            q, qd = self.plant.read()
            self.swing = max(self.swing, abs(q[0] - self._start))
            steps, speeds = np.rint(q[:6] * STEPS).astype(int), np.rint(qd[:6] * 1000).astype(int)
            self._send(STATUS, bytes([self.mode, int(self.is_stopped), 1, 0, 0, 0, 0, 0]))
            for each in range(3):
                self._send(JOINTS + each, struct.pack(">ii", *steps[2 * each : 2 * each + 2]))
            self._send(GRIPPER, struct.pack(">ihBB", round(q[6] * 2e6), 0, 0x40 * self.powered, 0))
            for each in range(6):
                self._send(FAST + each, struct.pack(">hhi", np.clip(speeds[each], -32768, 32767), 0, 0))
                self._send(SLOW + each, struct.pack(">HhbBH", 240, 30, 30, 0x40 * self.powered, 0))

    def _send(self, kind, data):
        if not self._is_cut:
            self._bus.send(can.Message(arbitration_id=kind, data=data, is_extended_id=False))


class Listener:
    """A third node on the channel: (identifier, data) of every command that passed, in order."""

    def __init__(self, channel):
        self.frames, self._bus = [], can.Bus(channel, interface="virtual")
        self._notifier = can.Notifier(self._bus, [self._keep], timeout=0.05)

    def count(self, kind, *first):
        return sum(each == kind and data[: len(first)] == bytes(first) for each, data in list(self.frames))

    def close(self):
        self._notifier.stop()
        self._bus.shutdown()

    def _keep(self, frame):
        if frame.arbitration_id < 0x200 or frame.arbitration_id == ENABLE:
            self.frames.append((frame.arbitration_id, bytes(frame.data)))
