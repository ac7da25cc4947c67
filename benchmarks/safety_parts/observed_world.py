"""A world process with an eye of its own: every physics step's raw state is kept, by code that limits nothing.

    python observed_world.py SOCKET RECORD.npy [--realtime --signals FOLDER --log FILE]

SOCKET is the path of a UNIX socket, or `ws://127.0.0.1:0`; the endpoint is printed then.

The eye wraps `mujoco.mj_step` itself, so that no step passes it, whoever asks for it. A row is (wall time [s],
simulated time [s], 7 positions, 7 velocities, 7 torques, 3 coordinates of the tool).
"""

import argparse
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from phyagentos.assembly.processes import open_door
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.robot import name_actuator, read_profile
from phyagentos.runtime.supervision.workers import end_with_parent
from phyagentos.runtime.targets.handshake import Tokens
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import serve, serve_realtime
from phyagentos.runtime.targets.stop_listener import StopListener

WIDTH = 26
BLOCK = 1 << 15  # rows


class Eye:
    """Keeps a row of every step of any model that has the arm's servos.

    Args:
        profile: Names joints, servos and tool.
    """

    def __init__(self, profile: TargetProfile) -> None:
        self._profile = profile
        self._known: dict[int, tuple[Any, ...]] = {}
        self._step = mujoco.mj_step
        self._blocks = [np.empty((BLOCK, WIDTH))]
        self._count = 0

    def step(self, model: Any, data: Any, nstep: int = 1) -> None:
        """Stands in for `mujoco.mj_step`."""
        q, qd, servos, site = (self._known.get(id(model)) or self._find(model))[:4]
        for _ in range(nstep):
            self._step(model, data)
            if self._count == BLOCK:
                self._blocks.append(np.empty((BLOCK, WIDTH)))
                self._count = 0
            row = self._blocks[-1][self._count]
            row[0], row[1] = 1e-9 * time.time_ns(), data.time
            row[2:9], row[9:16] = data.qpos[q], data.qvel[qd]
            row[16:23], row[23:26] = data.actuator_force[servos], data.site_xpos[site]
            self._count += 1

    def save(self, path: str) -> None:
        """Write what was seen."""
        np.save(path, np.concatenate((*self._blocks[:-1], self._blocks[-1][: self._count])))

    def _find(self, model: Any) -> tuple[Any, ...]:
        arm = self._profile.arm
        joints = [model.joint(name) for name in arm.joints]
        self._known[id(model)] = places = (
            np.array([int(joint.qposadr[0]) for joint in joints]),
            np.array([int(joint.dofadr[0]) for joint in joints]),
            np.array([model.actuator(name_actuator(name)).id for name in arm.joints]),
            model.site(self._profile.tcp).id,
            model,  # kept, so that nobody else gets its address
        )
        return places


def main() -> None:
    """Serve a world until it is shut down; then write what was seen."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("socket")
    parser.add_argument("record")
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--signals", type=Path)
    parser.add_argument("--log", type=Path)
    given = parser.parse_args()
    tokens = Tokens()
    end_with_parent(lambda line: tokens.renew(bytes.fromhex(line.decode())))
    library, clock = Library.open(), SystemClock()
    profile, folder = read_profile(library.get_target("panda"))
    eye = Eye(profile)
    mujoco.mj_step = eye.step
    log = ReceiveLog(given.log, clock)
    stops = StopListener(given.signals, clock) if given.signals else None
    mode = WorldMode.REALTIME if given.realtime else WorldMode.LOCKSTEP
    world = ServedTarget(
        MujocoDriver(SimulatedWorld(library, mode=mode), profile, folder),
        log,
        is_estopped=stops.is_latched if stops else lambda: False,
        keep_stop=stops.keep if stops else lambda: None,
    )
    if given.realtime:
        serve_realtime(world, open_door(given.socket, spin_s=0.0), tokens, clock)
    else:
        serve(world, open_door(given.socket), tokens)
    eye.save(given.record)


if __name__ == "__main__":
    main()
