"""The leaf of the skill `nod`: the first joint swings to and fro."""

import numpy as np

from phyagentos.runtime.execution.leaf import Leaf, Role, Status
from phyagentos.runtime.execution.leaf_registry import LeafRegistry

SWING_RAD, SWING_S = 0.15, 4.0


class Nod(Leaf):
    """One swing towards zero, at rest at both ends: q = q0 + a (1 - cos s)^2 / 4, s from 0 to 2 pi."""

    ROLE = Role.MOVE

    def on_start(self) -> Status:
        """From where the set-points stand."""
        self._from, self._row = self.context.commands.q_rad, 0
        return self.on_running()

    def on_running(self) -> Status:
        """The next rows."""
        commands = self.context.commands
        rows = round(SWING_S / commands.step_s)
        if self._row >= rows:
            return self.succeed()
        s = 2.0 * np.pi * np.arange(self._row + 1, self._row + 1 + commands.n_steps) / rows
        swing = -SWING_RAD if self._from[0] > 0.0 else SWING_RAD
        q, qd = np.tile(self._from, (len(s), 1)), np.zeros((len(s), self._from.size))
        q[:, 0] += swing * (1.0 - np.cos(s)) ** 2 / 4.0
        qd[:, 0] = swing * (1.0 - np.cos(s)) * np.sin(s) / 2.0 * 2.0 * np.pi / (rows * commands.step_s)
        self._row += commands.n_steps
        if self._row >= rows:
            qd[-1] = 0.0
        commands.set_arm(q, qd)
        return Status.RUNNING


def register(registry: LeafRegistry) -> None:
    """Make the leaf known."""
    registry.register("nod_once", Nod)
