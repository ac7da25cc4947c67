"""The leaves that ship, by the names that trees use."""

from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.leaves.control import Fail, Wait
from phyagentos.runtime.execution.leaves.find_opening import FindOpening
from phyagentos.runtime.execution.leaves.gripper import CloseGripper, OpenGripper
from phyagentos.runtime.execution.leaves.held import Attach, Detach, FindHeld, VerifyGrasp
from phyagentos.runtime.execution.leaves.lines import PlanInsert, PlanLine, PlanReach, PlanRetreat, PlanWipe
from phyagentos.runtime.execution.leaves.moves import DriveTo, MoveHome, MoveLevel, MoveLinear, MovePosture, MoveTo
from phyagentos.runtime.execution.leaves.placing import PlanGrasp, PlanPlace, PlanRoom
from phyagentos.runtime.execution.leaves.pushing import PlanPush, PlanTouch
from phyagentos.runtime.execution.leaves.sight import IsSharp, Locate, Look
from phyagentos.runtime.execution.leaves.vessels import PlanCarry, PlanPour


def register_builtin(registry: LeafRegistry) -> None:
    """Register every leaf that ships."""
    registry.register("attach", Attach)
    registry.register("close_gripper", CloseGripper)
    registry.register("detach", Detach)
    registry.register("drive_to", DriveTo)
    registry.register("fail", Fail)
    registry.register("find_held", FindHeld)
    registry.register("find_opening", FindOpening)
    registry.register("is_sharp", IsSharp)
    registry.register("locate", Locate)
    registry.register("look", Look)
    registry.register("move_home", MoveHome)
    registry.register("move_level", MoveLevel)
    registry.register("move_linear", MoveLinear)
    registry.register("move_posture", MovePosture)
    registry.register("move_to", MoveTo)
    registry.register("open_gripper", OpenGripper)
    registry.register("plan_carry", PlanCarry)
    registry.register("plan_grasp", PlanGrasp)
    registry.register("plan_insert", PlanInsert)
    registry.register("plan_line", PlanLine)
    registry.register("plan_place", PlanPlace)
    registry.register("plan_pour", PlanPour)
    registry.register("plan_push", PlanPush)
    registry.register("plan_reach", PlanReach)
    registry.register("plan_retreat", PlanRetreat)
    registry.register("plan_room", PlanRoom)
    registry.register("plan_touch", PlanTouch)
    registry.register("plan_wipe", PlanWipe)
    registry.register("verify_grasp", VerifyGrasp)
    registry.register("wait", Wait)
