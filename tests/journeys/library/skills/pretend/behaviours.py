"""A leaf that claims success."""

from py_trees.common import Status

from phyagentos.runtime.execution.leaf import Leaf, Role


class Pretend(Leaf):
    """Does nothing, successfully."""

    ROLE = Role.ACT

    def on_start(self) -> Status:
        return Status.SUCCESS


def register(registry) -> None:
    registry.register("pretend", Pretend)
