"""A client of an observed world process, without handle and guard: what goes out is exactly what is asked for.

Shared by `benchmarks/safety.py` and the tests of the target's own limits. Downstream: `observed_world`.
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.channel import Link
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import greet, make_key, mint

Array = NDArray[np.float64]

SCENE = "tabletop/cubes_and_trays"
EYE = Path(__file__).with_name("observed_world.py")
DT, ROWS = 0.002, 10
SHARE = 0.935  # of the velocity limit: just below what the target takes, above what any skill uses


@dataclass(frozen=True, slots=True)
class Seen:
    """What the eye saw, a row a physics step.

    Attributes:
        wall_s: (n,) UTC wall time.
        time_s: (n,) simulated time.
        q: (n, n_joints) [rad].
        qd: (n, n_joints) [rad/s].
        torque: (n, n_joints) [Nm].
        tool: (n, 3) tool centre point [m].
    """

    wall_s: Array
    time_s: Array
    q: Array
    qd: Array
    torque: Array
    tool: Array

    @classmethod
    def read(cls, path: Path) -> "Seen":
        """What a world process left when it ended."""
        rows = np.load(path)
        return cls(rows[:, 0], rows[:, 1], rows[:, 2:9], rows[:, 9:16], rows[:, 16:23], rows[:, 23:26])

    def count_outside(self, profile: TargetProfile, folder: Path) -> dict[str, int]:
        """Rows outside the model's ranges and the profile's limits, by what they leave."""
        model = mujoco.MjModel.from_xml_path(str(folder / profile.model))
        low, high = np.array([model.joint(name).range for name in profile.arm.joints]).T
        box = np.array(profile.workspace_m)
        inside = {
            "position": (self.q >= low) & (self.q <= high),
            "velocity": np.abs(self.qd) <= np.array(profile.arm.velocity_rad_s),
            "torque": np.abs(self.torque) <= np.array(profile.arm.torque_nm),
            "workspace": (self.tool >= box[0]) & (self.tool <= box[1]),
        }
        return {name: int((~each.all(axis=1)).sum()) for name, each in inside.items()}


class Attacker:
    """One world process and the wire to it.

    Args:
        folder: For its socket and what the eye saw.
        profile: The robot.
        options: Further ones of `observed_world`.
    """

    def __init__(self, folder: Path, profile: TargetProfile, options: Sequence[str] = ()) -> None:
        self.profile = profile
        self.velocity = np.array(profile.arm.velocity_rad_s)
        self.acceleration = np.array(profile.arm.acceleration_rad_s2)
        self.socket = str(folder / "world.sock")
        self.record = folder / "record.npy"
        command = [sys.executable, str(EYE), self.socket, str(self.record), *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE)  # the pipe ends it with this process
        self.key = make_key()
        self.process.stdin.write(self.key.hex().encode() + b"\n")
        self.process.stdin.flush()
        self.count, self.sequence, self.session = 0, 0, ""
        self.connect()
        self.load()

    def connect(self) -> None:
        """Wait for the process to listen."""
        for _ in range(1200):
            try:
                self.link: Any = Link(Client(self.socket, "AF_UNIX"))
                greet(self.link, mint(self.key))
            except (FileNotFoundError, ConnectionRefusedError):
                time.sleep(0.05)  # noqa: TID251 - waits for a process to listen
            else:
                return
        raise AssertionError("the world process does not listen")

    def ask(self, request: wire.Request) -> Any:
        """One request, its reply."""
        self.link.send_bytes(wire.REQUESTS.encode(request))
        return wire.receive_reply(self.link, 30.0)

    def ask_bytes(self, message: bytes) -> Any:
        """Whatever these bytes are, and the reply."""
        self.link.send_bytes(message)
        return wire.receive_reply(self.link, 30.0)

    def load(self) -> Any:
        """A fresh world."""
        self.count += 1
        return self.ask(wire.LoadScene(scene=SCENE, seed=1, episode=f"e{self.count}"))

    def begin(self) -> Array:
        """A new session; the posture it begins at."""
        self.count += 1
        self.session, self.sequence = f"s{self.count}", 0
        reply = self.ask(wire.Begin(session=self.session, epoch=1))
        assert reply == wire.Ack(), reply
        live = self.ask(wire.Describe())
        return np.clip(self.ask(wire.Observe()).target.q_rad, live.q_min_rad, live.q_max_rad)

    def end(self) -> Any:
        """The session gives its authority back."""
        return self.ask(wire.End(session=self.session, epoch=1))

    def make(self, q: Array, qd: Array | None = None, width: float = 0.08, **changes: Any) -> wire.Command:
        """A command of rows or of one posture; `changes` spoil it."""
        rows = np.tile(q, (ROWS, 1)) if np.ndim(q) == 1 else q
        facts = {
            "session": self.session, "epoch": 1, "sequence": self.sequence + 1, "expires_at_s": 1e9, "q_rad": rows,
            "qd_rad_s": np.zeros_like(rows) if qd is None else qd, "gripper_width_m": np.full(len(rows), width),
        }  # fmt: skip
        return wire.Command(**{**facts, **changes})

    def send(self, *given: Any, **changes: Any) -> Any:
        """Make a command and send it."""
        reply = self.ask(self.make(*given, **changes))
        self.sequence += isinstance(reply, wire.Step)
        return reply

    def ramp(self, q: Array, qd: Array, wanted: Array, share: float = 1.1) -> tuple[Array, Array]:
        """The hardest rows that still count as smooth: every joint accelerates at its limit towards `wanted`.

        Args:
            q: (n_joints,) where the set-points are.
            qd: (n_joints,) how fast they move.
            wanted: (n_joints,) how fast they shall.
            share: Of the acceleration limit.
        """
        positions, velocities = [], []
        for _ in range(ROWS):
            push = np.clip(wanted - qd, -share * DT * self.acceleration, share * DT * self.acceleration)
            q, qd = q + (qd + 0.5 * push) * DT, qd + push
            positions.append(q)
            velocities.append(qd)
        return np.array(positions), np.array(velocities)

    def finish(self) -> Seen:
        """End the process; what the eye saw."""
        assert self.process.poll() is None, "the world process has died"
        self.ask(wire.Shutdown())
        assert self.process.wait(60) == 0
        self._close_input()
        return Seen.read(self.record)

    def kill(self) -> None:
        """Whatever became of it, it is gone now."""
        self.link.close()
        self.process.kill()
        self.process.wait()
        self._close_input()

    def _close_input(self) -> None:
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


def choose(kind: str, rng: np.random.Generator, index: int, velocity: Array, wanted: Array) -> Array:
    """What an attacker wants next: (n_joints,) velocities that the ramp goes towards."""
    match kind:
        case "noise":
            return rng.uniform(-SHARE, SHARE, 7) * velocity
        case "bang":
            return rng.choice([-SHARE, SHARE], 7) * velocity if rng.random() < 0.3 else wanted
        case "oscillation":
            return SHARE * velocity * np.where(index // np.arange(3, 10) % 2, 1.0, -1.0)
        case "drift":
            if index % 90:
                return wanted
            return np.eye(7)[index // 90 % 7] * velocity * (SHARE if index // 630 % 2 else -SHARE)
        case "slow drift":  # towards one end of all ranges until it is stopped, then towards the other
            return np.full(7, 0.05 if index // 700 % 2 else -0.05) * velocity
    return rng.choice([-SHARE, 0.0, SHARE], 7) * velocity if index % 37 == 0 else wanted


def abandon(attacker: Attacker, rng: np.random.Generator) -> None:
    """Leave the arm in the middle of a motion, in one of the ways there are."""
    match int(rng.integers(4)):
        case 0:
            attacker.ask(wire.Settle(session=attacker.session, epoch=1, duration_s=0.1))
        case 1:
            attacker.end()
            attacker.begin()
        case 2:
            attacker.link.close()
            attacker.connect()
            attacker.begin()
        case 3:
            attacker.ask(wire.Halt(session=attacker.session, epoch=1))


def drive_hard(attacker: Attacker, kind: str, rng: np.random.Generator, count: int) -> int:
    """The hardest motion that is accepted, `count` commands long; how many were accepted."""
    q, qd, wanted = attacker.begin(), np.zeros(7), np.zeros(7)
    refused, accepted = 0, 0
    for index in range(count):
        wanted = choose(kind, rng, index, attacker.velocity, wanted)
        rows = attacker.ramp(q, qd, wanted)
        reply = attacker.send(*rows, width=float(rng.choice([0.0, 0.08])))
        if isinstance(reply, wire.Step) and not reply.stopped:
            q, qd, refused, accepted = rows[0][-1], rows[1][-1], 0, accepted + 1
        elif isinstance(reply, wire.Step):
            attacker.end()
            attacker.load()
            q, qd = attacker.begin(), np.zeros(7)
        else:
            refused += 1
            wanted = -wanted if refused % 2 else rng.uniform(-SHARE, SHARE, 7) * attacker.velocity
            if refused > 4:
                attacker.ask(wire.Halt(session=attacker.session, epoch=1))
                attacker.end()
                q, qd, wanted = attacker.begin(), np.zeros(7), np.zeros(7)
        if kind == "abandoned" and index % 13 == 12:
            abandon(attacker, rng)
            attacker.end()
            q, qd = attacker.begin(), np.zeros(7)
    attacker.end()
    return accepted
