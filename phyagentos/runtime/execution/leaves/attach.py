"""Measure how a held object sits in the hand, so that motions carry it along as part of the arm."""

from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.loads import measure_payload
from phyagentos.runtime.motion.requests import Payload


class Attach(Leaf):
    """From now on the object counts as part of the hand, at its believed pose. Nothing is welded."""

    ROLE = Role.CARRY
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the held entity.")}
    OUTPUT_PORTS = {"payload": PortInformation(data_type=Payload, description="What is held, and how.")}

    def on_start(self) -> Status:
        """Measure once."""
        name = self.read("object")
        entity = self.get_entity(name)
        if not self.context.is_holding(name):
            return self.fail(FailureCode.GRASP_MISSED, f"{name} is not between the fingers", object=name)
        payload = measure_payload(entity, self.context.step.target, self.context.profile)
        self.write("payload", payload)
        return self.succeed("", object=name, in_hand_m=list(payload.tcp_T_entity.position_m))
