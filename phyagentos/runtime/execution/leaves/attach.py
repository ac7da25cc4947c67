"""Measure how a held object sits in the hand, so that motions carry it along as part of the arm."""

from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.motion.requests import Payload
from phyagentos.runtime.perception.world_model import BELIEF


class Attach(Leaf):
    """From now on the object counts as part of the hand, at its believed pose. Nothing is welded."""

    ROLE = Role.CARRY
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the held entity.")}
    OUTPUT_PORTS = {"payload": PortInformation(data_type=Payload, description="What is held, and how.")}

    def on_start(self) -> Status:
        """Measure once."""
        name = self.read("object")
        environment = self.context.world.observe(BELIEF)
        entity = environment.entities.get(name)
        if entity is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world", object=name)
        if not self.context.is_holding(name):
            return self.fail(FailureCode.GRASP_MISSED, f"{name} is not between the fingers", object=name)
        world_T_tcp = compute_matrix(self.context.step.target.tcp)
        tcp_T_entity = compute_pose(compute_inverse(world_T_tcp) @ compute_matrix(entity.pose))
        width_m = self.context.step.target.gripper_width_m
        self.write("payload", Payload(entity=name, tcp_T_entity=tcp_T_entity, width_m=width_m))
        return self.succeed("", object=name, in_hand_m=list(tcp_T_entity.position_m))
