"""Ask for ways to put a held object somewhere."""

from phyagentos.protocol.predicates.meaning import find_relation
from phyagentos.runtime.execution.leaf import PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.plan_room import list_removable
from phyagentos.runtime.execution.planning import ApproachPlanningLeaf
from phyagentos.runtime.motion.requests import (
    FindPlacements,
    MotionRequest,
    Payload,
)
from phyagentos.runtime.perception.world_model import BELIEF


class PlanPlace(ApproachPlanningLeaf):
    """Approaches with the payload to free sites; those named in the strategy's `avoid_sites` are left out."""

    ROLE = Role.PLAN_SITE
    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, description="What is held, and how."),
        "destination": PortInformation(data_type=str, description="Entity or region to put it into or onto."),
        "relation": PortInformation(data_type=str, default_value="inside", description="`inside` or `on`."),
        "near": PortInformation(
            data_type=tuple, required=False, description="Point to stay close to, world frame [m]."
        ),
        "near_radius_m": PortInformation(data_type=float, default_value=0.12, description="How close [m]."),
        "up": PortInformation(data_type=tuple, required=False, description="Direction in its frame to point up."),
        "hover_m": PortInformation(data_type=float, default_value=0.07, description="Length of the approach [m]."),
        "may_fall": PortInformation(
            data_type=bool, default_value=True, description="Whether it may be let go above a walled floor."
        ),
    }

    def compose(self) -> MotionRequest | Status:
        """One request."""
        near, payload, place = self.find("near"), self.read("payload"), self.read("destination")
        now = self.context.world.observe(BELIEF)
        return FindPlacements(
            world=self.world(),
            payload=payload,
            destination=place,
            relation=find_relation(self.read("relation")),
            q_rad=self.context.commands.q_rad,
            seed=self.context.draw_seed(self.path),
            near=None if near is None else (float(near[0]), float(near[1]), float(near[2])),
            near_radius_m=self.read("near_radius_m"),
            up=self.find("up"),
            avoid=self.context.session.strategy.avoid_sites,
            hover_m=self.read("hover_m"),
            may_fall=self.read("may_fall"),
            coming=self.context.session.coming,
            removable=list_removable(self.context.session, now, payload.entity, place),
        )
