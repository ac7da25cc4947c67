"""What a leaf is written with; `phyagentos.leaves` is its entry point group.

    from phyagentos.skills import Leaf, Port, Status

    class ChooseNearest(Leaf):
        # Names the entity of a kind that is nearest to the tool.

        INPUT_PORTS = {"kind": Port(str, description="Such as cube.")}
        OUTPUT_PORTS = {"object": Port(str, description="Its name.")}

        def on_start(self) -> Status:
            tool = self.context.step.target.tcp.position_m
            ...
            return self.succeed()

A leaf that plans derives from `PlanningLeaf`, one that moves the arm from `MovingLeaf`, which state the role for it.
"""

from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.world.environment import Entity, Environment, Pose
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, LeafError, Status
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.planning import (
    ApproachPlanningLeaf,
    CandidatePlanningLeaf,
    LinePlanningLeaf,
    MovingLeaf,
    PlanningLeaf,
)
from phyagentos.runtime.execution.ports import Port
from phyagentos.runtime.motion.requests import Approach, Approaches, Motion, NoPlan, Payload

__all__ = [
    "Approach",
    "ApproachPlanningLeaf",
    "Approaches",
    "CandidatePlanningLeaf",
    "Entity",
    "Environment",
    "FailureCode",
    "Leaf",
    "LeafError",
    "LeafRegistry",
    "LinePlanningLeaf",
    "Motion",
    "MovingLeaf",
    "NoPlan",
    "Payload",
    "PlanningLeaf",
    "Port",
    "Pose",
    "Role",
    "SkillContext",
    "Status",
]
