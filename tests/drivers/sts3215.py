"""Feetech STS3215 servos on a pseudo-terminal: packets, registers and motion profile, and the arm that they move."""

import os
import threading
import tty

import mujoco
import numpy as np

from tests.drivers.plant import Plant

BROADCAST, PING, READ, WRITE, SYNC_READ, SYNC_WRITE = 0xFE, 1, 2, 3, 0x82, 0x83
MODEL, LIMITS, OFFSET = 3, 9, 31  # in the memory that keeps its values
TORQUE, GOAL, SPEED, PRESENT, STATUS = 40, 42, 46, 56, 65
STS3215 = 777
NEGATIVE = 1 << 11  # of an offset
STEPS = 4096 / (2 * np.pi)
FASTEST = 3400  # steps/s, of a goal speed of zero


class So101:
    """Six servos with ids 1 to 6, zero in the middle of their turn; `frames` are the packets that came, by instruction.

    Attributes:
        port: Path of the terminal that the driver opens.
        frames: (instruction, id, parameters) in the order of their coming.
    """

    def __init__(self, model_file, joints, q_rad):
        model = mujoco.MjModel.from_xml_path(str(model_file))
        self.registers = np.zeros((len(joints), 256), dtype=np.uint8)
        for at, word in ((MODEL, STS3215), (LIMITS, 0), (LIMITS + 2, 4095)):
            self.registers[:, at : at + 2] = word & 0xFF, word >> 8
        self.frames, self._n = [], len(joints)
        self._profile = np.array(q_rad, dtype=float)
        self.plant = Plant(model, joints, joints, q_rad, self._follow)
        self.plant.start()
        self._master, slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(slave)
        self.port, self._slave, self._is_cut = os.ttyname(slave), slave, False
        self._thread = threading.Thread(target=self._serve, daemon=True, name="servos")
        self._thread.start()

    def cut(self):
        """The cable breaks: nothing is received, and nothing is answered."""
        self._is_cut = True

    def close(self):
        self.cut()
        os.write(self._slave, b"\0")  # wakes the reader
        self._thread.join()
        self.plant.close()
        os.close(self._master)
        os.close(self._slave)

    def goals(self):
        """Goal positions [steps]."""
        return [self._word(each, GOAL) for each in range(self._n)]

    def present(self):
        """Present positions [steps]."""
        return np.rint(2048 + self.plant.read()[0] * STEPS - self._offsets()).astype(int).tolist()

    def put(self, servo, address, value):
        """A number of two bytes in the memory of a servo."""
        self.registers[servo, address : address + 2] = value & 0xFF, value >> 8

    def _offsets(self):
        """What each servo takes off where it stands [steps]."""
        words = [self._word(each, OFFSET) for each in range(self._n)]
        return np.array([-(word & ~NEGATIVE) if word & NEGATIVE else word for word in words])

    def fail(self, servo, bits):
        """A servo complains."""
        self.registers[servo, STATUS] = bits

    def _word(self, servo, address):
        low, high = self.registers[servo, address : address + 2].tolist()
        return low | high << 8

    def _follow(self, dt):
        """The servos' own profile: to the goal at the goal speed."""
        powered, offsets = self.registers[:, TORQUE] == 1, self._offsets()
        for each in range(self._n):
            now = self.plant.data.qpos[self.plant._q[each]]
            if not powered[each]:  # a servo without torque has its goal where it stands
                self._profile[each] = now
                self.put(each, GOAL, max(round(2048 + now * STEPS - offsets[each]), 0))
                continue
            way = (self._word(each, GOAL) + offsets[each] - 2048) / STEPS - self._profile[each]
            most = (self._word(each, SPEED) or FASTEST) / STEPS * dt
            self._profile[each] += np.clip(way, -most, most)
        self.plant.power(powered)
        self.plant.command(self._profile)

    def _measure(self):
        q, qd = self.plant.read()
        for values, at in ((2048 + q * STEPS - self._offsets(), PRESENT), (qd * STEPS, PRESENT + 2)):
            for each, value in enumerate(np.rint(values).astype(int).tolist()):
                word = -value | 1 << 15 if value < 0 else value
                self.registers[each, at : at + 2] = word & 0xFF, word >> 8

    def _serve(self):
        pending = b""
        while not self._is_cut:
            pending += os.read(self._master, 4096)
            while (begin := pending.find(b"\xff\xff")) >= 0 and len(pending) >= begin + 4:
                end = begin + 4 + pending[begin + 3]
                if len(pending) < end:
                    break
                packet, pending = pending[begin:end], pending[end:]
                if not self._is_cut and ~sum(packet[2:-1]) & 0xFF == packet[-1]:
                    self._carry_out(packet[2], packet[4], packet[5:-1])

    def _carry_out(self, servo, instruction, told):
        self.frames.append((instruction, servo, bytes(told)))
        with self.plant.lock:
            self.plant.advance()
            if instruction == SYNC_WRITE:
                address, length = told[0], told[1]
                for row in range(2, len(told), length + 1):
                    self._store(told[row], address, told[row + 1 : row + 1 + length])
            elif instruction == SYNC_READ:
                self._measure()
                for each in told[2:]:
                    self._answer(each, told[0], told[1])
            elif instruction == READ:
                self._measure()
                self._answer(servo, told[0], told[1])
            elif instruction == WRITE:
                self._store(servo, told[0], told[1:])
                self._answer(servo, 0, 0)
            elif instruction == PING:
                self._answer(servo, 0, 0)

    def _store(self, servo, address, data):
        if 1 <= servo <= self._n:
            self.registers[servo - 1, address : address + len(data)] = list(data)

    def _answer(self, servo, address, length):
        if not 1 <= servo <= self._n:
            return
        data = self.registers[servo - 1, address : address + length].tolist()
        body = [servo, length + 2, 0, *data]
        os.write(self._master, bytes([0xFF, 0xFF, *body, ~sum(body) & 0xFF]))
