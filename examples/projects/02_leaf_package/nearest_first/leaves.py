"""The leaf `choose_nearest`."""

import math
from pathlib import Path

from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.perception.world_model import BELIEF


class ChooseNearest(Leaf):
    """Names the visible object of a kind that is nearest to the tool."""

    ROLE = Role.SENSE
    INPUT_PORTS = {"kind": PortInformation(str, description="Class of thing, such as cube.")}
    OUTPUT_PORTS = {"object": PortInformation(str, description="Its name.")}

    def on_start(self) -> Status:
        environment = self.context.world.observe(BELIEF)
        tool = environment.targets[self.context.session.target].tcp.position_m
        found = [
            (math.dist(tool, item.pose.position_m), item.name)
            for item in environment.entities.values()
            if item.kind == self.read("kind") and item.visible
        ]
        if not found:
            return self.fail("NOTHING_TO_CHOOSE", f"no visible {self.read('kind')}")
        distance_m, name = min(found)
        self.write("object", name)
        return self.succeed(distance_m=distance_m)


def register(registry: LeafRegistry) -> None:
    registry.register("choose_nearest", ChooseNearest)


def find_library() -> Path:
    return Path(__file__).parent / "library"
