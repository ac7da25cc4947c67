"""Ask for ways to take hold of an object."""

from phyagentos.runtime.execution.leaf import PortInformation, Role, Status
from phyagentos.runtime.execution.planning import ApproachPlanningLeaf
from phyagentos.runtime.motion.requests import Approaches, FindGrasps, MotionRequest


class PlanGrasp(ApproachPlanningLeaf):
    """Approaches from above onto the object; those named in the strategy's `avoid_grasps` are left out."""

    ROLE = Role.PLAN_GRASP
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to take hold of."),
        "hover_m": PortInformation(data_type=float, default_value=0.08, description="Length of the approach [m]."),
    }
    OUTPUT_PORTS = {"approaches": PortInformation(data_type=Approaches, description="Checked ways, nearest first.")}

    def compose(self) -> MotionRequest | Status:
        """One request."""
        return FindGrasps(
            world=self.world(),
            object=self.read("object"),
            q_rad=self.context.commands.q_rad,
            seed=self.context.draw_seed(self.path),
            avoid=self.context.session.strategy.avoid_grasps,
            hover_m=self.read("hover_m"),
        )
