"""The leaves that ship, by the names that trees use."""

from phyagentos.runtime.execution.leaf import Leaf
from phyagentos.runtime.execution.leaves.attach import Attach
from phyagentos.runtime.execution.leaves.call import Call
from phyagentos.runtime.execution.leaves.detach import Detach
from phyagentos.runtime.execution.leaves.drive_to import DriveTo
from phyagentos.runtime.execution.leaves.fail import Fail
from phyagentos.runtime.execution.leaves.find_held import FindHeld
from phyagentos.runtime.execution.leaves.find_opening import FindOpening
from phyagentos.runtime.execution.leaves.gripper import CloseGripper, OpenGripper
from phyagentos.runtime.execution.leaves.is_sharp import IsWellLocalized
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

BUILTIN: dict[str, type[Leaf]] = {
    "attach": Attach,
    "call": Call,
    "close_gripper": CloseGripper,
    "detach": Detach,
    "drive_to": DriveTo,
    "fail": Fail,
    "find_held": FindHeld,
    "find_opening": FindOpening,
    "is_sharp": IsWellLocalized,
    "locate": Locate,
    "look": Look,
    "move_home": MoveHome,
    "move_level": MoveLevel,
    "move_linear": MoveLinear,
    "move_posture": MovePosture,
    "move_to": MoveTo,
    "open_gripper": OpenGripper,
    "plan_carry": PlanCarry,
    "plan_grasp": PlanGrasp,
    "plan_insert": PlanInsert,
    "plan_line": PlanLine,
    "plan_place": PlanPlace,
    "plan_pour": PlanPour,
    "plan_push": PlanPush,
    "plan_reach": PlanReach,
    "plan_retreat": PlanRetreat,
    "plan_room": PlanRoom,
    "plan_touch": PlanTouch,
    "plan_wipe": PlanWipe,
    "verify_grasp": VerifyGrasp,
    "wait": Wait,
}
