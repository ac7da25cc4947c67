"""Leaves about what the fingers hold: whether, how, and what an earlier session has left in them."""

import math

from phyagentos.protocol.world.free_spot import find_free_spot, find_support
from phyagentos.protocol.world.predicates.geometry import compute_lowest
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.loads import measure_payload
from phyagentos.runtime.execution.tree_check import Names
from phyagentos.runtime.motion.requests import Payload
from phyagentos.runtime.perception.world_model import BELIEF, HAND


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
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world as observed", object=name)
        if not self.context.is_holding(name):
            return self.fail(FailureCode.GRASP_MISSED, f"{name} is not between the fingers", object=name)
        payload = measure_payload(entity, self.context.step.target, self.context.profile)
        self.write("payload", payload)
        return self.succeed("", object=name, in_hand_m=list(payload.tcp_T_entity.position_m))


class Detach(Leaf):
    """From now on the object is an entity of the world again. Fails when the fingers still hold it."""

    ROLE = Role.RELEASE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the released entity.")}
    OUTPUT_PORTS = {
        "site": PortInformation(data_type=tuple, required=False, description="Where it stands, world frame [m].")
    }

    def on_start(self) -> Status:
        """Look once."""
        name = self.read("object")
        if self.context.is_holding(name):
            return self.fail(FailureCode.STILL_HELD, f"{name} is still between the fingers", object=name)
        entity = self.context.world.observe(BELIEF).entities.get(name)
        if entity is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world as observed", object=name)
        self.write("site", entity.pose.position_m)
        return self.succeed("", object=name, position_m=list(entity.pose.position_m))


class VerifyGrasp(Leaf):
    """Is the object between the fingers that press?"""

    ROLE = Role.VERIFY
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity."),
        "after": PortInformation(
            data_type=str, default_value="close", description="`close` (a miss) or `lift` and later (a loss)."
        ),
    }

    def on_start(self) -> Status:
        """Judge the latest step."""
        name = self.read("object")
        step = self.context.step
        held = self.context.world.observe(HAND).targets[self.context.session.target].holding
        if name in held:
            return self.succeed("", object=name, width_m=step.target.gripper_width_m)
        code = FailureCode.GRASP_MISSED if self.read("after") == "close" else FailureCode.GRASP_LOST
        pressing = "press on something that is not" if step.target.is_gripping else "press on nothing: no"
        instead = f"hold {', '.join(held)}, not {name}" if held else f"{pressing} {name}"
        return self.fail(
            code,
            f"the fingers, {1e3 * step.target.gripper_width_m:.1f} mm apart, {instead}",
            object=name,
            width_m=step.target.gripper_width_m,
        )


class FindHeld(Leaf):
    """The thing between the fingers that has to leave them first; none where nothing is confirmed to be held.

    A part of something fixed, as a handle, is no such thing: the hand may just open.
    """

    ROLE = Role.PLAN_ROOM
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity that needs the hand.")}
    OUTPUT_PORTS = {
        "things": PortInformation(data_type=Names, description="What is held."),
        "support": PortInformation(data_type=str, required=False, description="Entity to set it down on."),
        "to": PortInformation(
            data_type=tuple, required=False, description="Where about, world frame [m]; anywhere if unset."
        ),
    }

    def on_start(self) -> Status:
        """Ask the hand, and look for a free spot under it."""
        now, profile = self.context.world.observe(BELIEF), self.context.profile
        holding = self.context.world.observe(HAND).targets[self.context.session.target].holding
        held = [each for each in holding if each in now.entities and not now.entities[each].part_of][:1]
        self.write("things", Names(held))
        for name in held:
            lowest_m = profile.workspace_m[0][2] if profile.workspace_m is not None else -math.inf
            drop_m = compute_lowest(now.entities[name]) - lowest_m
            if (support := find_support(now, name, drop_m)) is None:
                message = f"{name} is held, and nothing under it is there to set it down on"
                return self.fail("NO_FREE_SITE", message, object=name)
            self.write("support", support.name)
            spot = find_free_spot(now, name, (), profile.mount_position_m, profile.grasp_band_m, drop_m)
            if spot is not None:
                self.write("to", spot)
        return self.succeed("", held=held, things=[each for each in held if each != self.read("object")])
