"""Ask for ways to take hold of an object."""

from phyagentos.protocol.predicates.meaning import find_relation
from phyagentos.protocol.world.environment import Entity
from phyagentos.protocol.world.mechanisms import find_hinge
from phyagentos.runtime.execution.leaf import Port, PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.find_opening import compute_way
from phyagentos.runtime.execution.planning import BESIDE, CandidatePlanningLeaf
from phyagentos.runtime.motion.requests import (
    Approaches,
    Array,
    Destination,
    FindGrasps,
    MotionRequest,
)

LEVEL_SINE = 0.1  # of a hinge with the horizontal


class PlanGrasp(CandidatePlanningLeaf):
    """Approaches onto the object, if any those from which it can be put where it goes then.

    Those named in the strategy's `avoid_grasps` are left out. With `sides`, those from which it can be put down turned:
    with the first of these sides up that one grasp can bring up.
    """

    ROLE = Role.PLAN_GRASP
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to take hold of."),
        "hinged": PortInformation(
            data_type=str, required=False, description="What the handle belongs to: a level hinge turns in the fingers."
        ),
        "opening": PortInformation(
            data_type=float, required=False, description="Of what slides, to which it is moved then by its handle."
        ),
        "destination": PortInformation(
            data_type=str, required=False, description="Entity or region where it goes then; as at `plan_place`."
        ),
        "relation": PortInformation(data_type=str, default_value="inside", description="`inside` or `on`."),
        "near": PortInformation(
            data_type=tuple, required=False, description="Point to stay close to, world frame [m]."
        ),
        "near_radius_m": Port(data_type=float, above=0.0, default_value=0.12, description="How close [m]."),
        "heading": PortInformation(
            data_type=float, required=False, description="Turn about the vertical that it has then [rad]."
        ),
        "sides": PortInformation(
            data_type=tuple, default_value=(), description="Directions in its frame, one of which shall point up then."
        ),
        "hover_m": Port(data_type=float, minimum=0.0, default_value=0.08, description="Length of the approach [m]."),
        "beside": BESIDE,
    }
    OUTPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Checked candidates, nearest first."),
        "up": PortInformation(data_type=tuple, required=False, description="The side that points up then."),
    }

    def count_candidates(self) -> int:
        """Number of sides."""
        return len(self.read("sides")) or 1

    def compose(self) -> MotionRequest | Status:
        """One request for each side."""
        whole = self.belief.entities.get(self.find("hinged") or "")
        axis = find_hinge(whole) if whole is not None else None
        destination, near = self.find("destination"), self.find_point("near")
        return self.request(
            FindGrasps,
            object=self.read("object"),
            avoid=self.context.session.strategy.avoid_grasps,
            hover_m=self.read("hover_m"),
            along=(axis[0], axis[1], axis[2]) if axis is not None and abs(axis[2]) < LEVEL_SINE else None,
            moves=self._list_moves(whole),
            then=None
            if destination is None
            else Destination(
                name=destination,
                relation=find_relation(self.read("relation")),
                near=near,
                up=self._get_up(),
                heading_rad=self.find("heading"),
                near_radius_m=self.read("near_radius_m"),
            ),
        )

    def on_found(self, answer: Approaches) -> Status:
        """Write the approaches, name the labels."""
        self.write("approaches", answer)
        if (up := self._get_up()) is not None:
            self.write("up", up)
        return self.succeed("", labels=[approach.label for approach in answer.approaches])

    def _list_moves(self, whole: Entity | None) -> tuple[Array, ...]:
        opening, mechanism = self.find("opening"), whole.mechanism if whole is not None else None
        if whole is None or opening is None or mechanism is None or mechanism.kind == "hinge":
            return ()
        return compute_way(whole, mechanism, opening)

    def _get_up(self) -> tuple[float, float, float] | None:
        return tuple(self.read("sides")[self.tried]) if self.read("sides") else None
