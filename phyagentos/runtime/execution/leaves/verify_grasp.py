"""Judge a grasp by what the hand measures: the fingers press on something as wide as the object."""

from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.ports import Port
from phyagentos.runtime.perception.world_model import HAND


class VerifyGrasp(Leaf):
    """Is the object between the fingers that press?"""

    ROLE = Role.VERIFY
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity."),
        "after": Port(
            data_type=str,
            choices=("close", "lift"),
            default_value="close",
            description="`close` (a miss) or `lift` and later (a loss).",
        ),
    }

    def on_start(self) -> Status:
        """Judge the latest step."""
        name = self.read("object")
        step = self.context.step
        held = self.context.world.observe(HAND).targets[self.context.session.target].holding
        if name in held:
            return self.succeed("", object=name, width_m=step.target.gripper_width_m)
        pressing = "press on something that is not" if step.target.is_gripping else "press on nothing: no"
        instead = f"hold {', '.join(held)}, not {name}" if held else f"{pressing} {name}"
        return self.fail(
            code=FailureCode.GRASP_MISSED if self.read("after") == "close" else FailureCode.GRASP_LOST,
            message=f"the fingers, {1e3 * step.target.gripper_width_m:.1f} mm apart, {instead}",
            object=name,
            width_m=step.target.gripper_width_m,
        )
