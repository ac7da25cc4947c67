"""The leaf `move_beside`: a straight line of a hand whose joints are the axes of space."""

import numpy as np

from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.perception.world_model import BELIEF

SPEED = 0.3  # greatest on the way [m/s]


class MoveBeside(Leaf):
    """Moves the tool on a straight line to a place that is described from where an object is, or from where it was."""

    ROLE = Role.MOVE
    INPUT_PORTS = {
        "object": PortInformation(str, description="The thing."),
        "x": PortInformation(float, description="From its middle [m]; likewise y and z."),
        "y": PortInformation(float, description="From its middle [m]."),
        "z": PortInformation(float, description="From its middle [m]."),
    }

    def on_start(self) -> Status:
        item = self.context.world.observe(BELIEF).entities.get(self.read("object"))
        if item is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{self.read('object')} is not in the world")
        self._begin = self.context.commands.q_rad
        self._way = np.array(item.pose.position_m) + [self.read(axis) for axis in "xyz"] - self._begin
        duration_s = 1.875 * float(np.linalg.norm(self._way)) / SPEED
        self._count = max(1, round(duration_s / self.context.profile.control_period_s))
        self._done = 0
        return self.on_running()

    def on_running(self) -> Status:
        if self._done == self._count:
            return self.succeed()
        rows, step_s = self.context.commands.n_steps, self.context.commands.step_s
        total = self._count * rows
        s = (self._done * rows + np.arange(1, rows + 1))[:, None] / total
        q = self._begin + self._way * (10 * s**3 - 15 * s**4 + 6 * s**5)
        qd = self._way * (30 * s**2 - 60 * s**3 + 30 * s**4) / (total * step_s)
        self.context.commands.set_arm(q, qd)
        self._done += 1
        return Status.RUNNING


def register(registry: LeafRegistry) -> None:
    registry.register("move_beside", MoveBeside)
