"""The leaf of the skill `advance`: one command that moves the slide up by one step."""

import numpy as np

from phyagentos.runtime.execution.leaf import Leaf, Role, Status
from phyagentos.runtime.execution.leaf_registry import LeafRegistry

STEP = 0.02  # above the 15 mm from which on an object counts as moved


class Advance(Leaf):
    """One step up, within one control period."""

    ROLE = Role.MOVE

    def on_start(self) -> Status:
        """Command it."""
        commands = self.context.commands
        q = commands.q_rad + STEP * np.linspace(0.0, 1.0, commands.n_steps + 1)[1:, None]  # (n_steps, 1)
        commands.set_arm(q, np.zeros_like(q))
        return Status.RUNNING

    def on_running(self) -> Status:
        """The period is over."""
        return self.succeed()


def register(registry: LeafRegistry) -> None:
    """Make the leaf known."""
    registry.register("advance_one_step", Advance)
