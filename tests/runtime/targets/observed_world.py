"""A world process with an eye of its own: every physics step's raw state is kept, by code that limits nothing.

    python observed_world.py SOCKET RECORD.npz

The eye wraps `mujoco.mj_step` itself, so that no step passes it, whoever asks for it.
"""

import sys

import mujoco
import numpy as np

from phyagentos.protocol.library import Library
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.robot import name_actuator, read_profile
from phyagentos.runtime.targets.server import serve
from phyagentos.runtime.targets.world import MujocoWorld


class Eye:
    """Keeps (q, qd, torque, tool) of every step of any model that has the arm's servos."""

    def __init__(self, profile):
        self._profile = profile
        self._known = {}
        self._step = mujoco.mj_step
        self.rows = []

    def step(self, model, data, nstep=1):
        """Stands in for `mujoco.mj_step`."""
        places = self._known.get(id(model)) or self._find(model)
        for _ in range(nstep):
            self._step(model, data)
            q, qd, servos, site = places
            self.rows.append(
                np.concatenate((data.qpos[q], data.qvel[qd], data.actuator_force[servos], data.site_xpos[site]))
            )

    def _find(self, model):
        arm = self._profile.arm
        joints = [model.joint(name) for name in arm.joints]
        self._known[id(model)] = places = (
            np.array([int(joint.qposadr[0]) for joint in joints]),
            np.array([int(joint.dofadr[0]) for joint in joints]),
            np.array([model.actuator(name_actuator(name)).id for name in arm.joints]),
            model.site(self._profile.tcp).id,
        )
        return places


def main(socket, record):
    library = Library.open()
    profile, folder = read_profile(library.get_target("panda"))
    eye = Eye(profile)
    mujoco.mj_step = eye.step
    serve(MujocoWorld(profile, folder, library, ReceiveLog(None)), socket)
    np.save(record, np.array(eye.rows))


if __name__ == "__main__":
    main(*sys.argv[1:])
