"""Ask for a straight push of an object along its support."""

from phyagentos.protocol.predicates.relations import list_inside
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import PlanningLeaf
from phyagentos.runtime.motion.requests import Approaches, FindPush, MotionRequest


class PlanPush(PlanningLeaf[Approaches]):
    """Ways of the closed fingers: down behind the object, straight on until it stands at the goal."""

    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to push."),
        "to": PortInformation(data_type=tuple, description="Where its centre shall be, world frame [m]."),
        "approaches": PortInformation(
            data_type=Approaches, required=False, description="Not used; trees of recorded workspaces give it."
        ),
    }
    OUTPUT_PORTS = {"ways": PortInformation(data_type=Approaches, description="Ways, one to be reached and followed.")}

    def compose(self) -> MotionRequest | Status:
        """One request, with the fingers as they stand."""
        name, to = self.read("object"), self.read("to")
        now = self.belief
        entity = self.get_entity(name)
        return self.request(
            FindPush,
            object=name,
            to_m=(float(to[0]), float(to[1])),
            ignore=(entity.part_of, *list_inside(entity.part_of, now)) if entity.part_of else (),  # all moves with it
            width_m=self.context.step.target.gripper_width_m,
        )

    def on_answer(self, answer: Approaches) -> Status:
        """Write the ways."""
        self.write("ways", answer)
        return self.succeed("", labels=[approach.label for approach in answer.approaches])
