"""Ask for ways to put a held object somewhere."""

from phyagentos.protocol.predicates.meaning import find_relation
from phyagentos.runtime.execution.leaf import Port, PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.plan_room import list_removable
from phyagentos.runtime.execution.planning import ApproachPlanningLeaf
from phyagentos.runtime.motion.requests import (
    FindPlacements,
    MotionRequest,
    Payload,
)


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
        "near_radius_m": Port(data_type=float, above=0.0, default_value=0.12, description="How close [m]."),
        "up": PortInformation(data_type=tuple, required=False, description="Direction in its frame to point up."),
        "heading": PortInformation(
            data_type=float, required=False, description="Turn about the vertical that it has then [rad]."
        ),
        "hover_m": Port(data_type=float, minimum=0.0, default_value=0.07, description="Length of the approach [m]."),
        "may_fall": PortInformation(
            data_type=bool, default_value=True, description="Whether it may be let go above a walled floor."
        ),
    }

    def compose(self) -> MotionRequest | Status:
        """One request."""
        payload, place = self.read("payload"), self.read("destination")
        return self.request(
            FindPlacements,
            payload=payload,
            destination=place,
            relation=find_relation(self.read("relation")),
            near=self.find_point("near"),
            near_radius_m=self.read("near_radius_m"),
            up=self.find("up"),
            heading_rad=self.find("heading"),
            avoid=self.context.session.strategy.avoid_sites,
            hover_m=self.read("hover_m"),
            may_fall=self.read("may_fall"),
            coming=self.context.session.coming,
            removable=list_removable(self.context.session, self.belief, payload.entity, place),
        )
