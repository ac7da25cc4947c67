"""The leaves that ship, by the names that trees use."""

from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.leaves.attach import Attach
from phyagentos.runtime.execution.leaves.detach import Detach
from phyagentos.runtime.execution.leaves.drive_to import DriveTo
from phyagentos.runtime.execution.leaves.fail import Fail
from phyagentos.runtime.execution.leaves.find_held import FindHeld
from phyagentos.runtime.execution.leaves.find_opening import FindOpening
from phyagentos.runtime.execution.leaves.gripper import CloseGripper, OpenGripper
from phyagentos.runtime.execution.leaves.is_sharp import IsSharp
from phyagentos.runtime.execution.leaves.locate import Locate
from phyagentos.runtime.execution.leaves.look import Look
from phyagentos.runtime.execution.leaves.move_home import MoveHome
from phyagentos.runtime.execution.leaves.move_level import MoveLevel
from phyagentos.runtime.execution.leaves.move_linear import MoveLinear
from phyagentos.runtime.execution.leaves.move_posture import MovePosture
from phyagentos.runtime.execution.leaves.move_to import MoveTo
from phyagentos.runtime.execution.leaves.plan_carry import PlanCarry
from phyagentos.runtime.execution.leaves.plan_grasp import PlanGrasp
from phyagentos.runtime.execution.leaves.plan_insert import PlanInsert
from phyagentos.runtime.execution.leaves.plan_line import PlanLine
from phyagentos.runtime.execution.leaves.plan_place import PlanPlace
from phyagentos.runtime.execution.leaves.plan_pour import PlanPour
from phyagentos.runtime.execution.leaves.plan_push import PlanPush
from phyagentos.runtime.execution.leaves.plan_reach import PlanReach
from phyagentos.runtime.execution.leaves.plan_retreat import PlanRetreat
from phyagentos.runtime.execution.leaves.plan_room import PlanRoom
from phyagentos.runtime.execution.leaves.plan_touch import PlanTouch
from phyagentos.runtime.execution.leaves.plan_wipe import PlanWipe
from phyagentos.runtime.execution.leaves.verify_grasp import VerifyGrasp
from phyagentos.runtime.execution.leaves.wait import Wait


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
