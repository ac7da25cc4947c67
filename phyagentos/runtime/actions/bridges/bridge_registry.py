"""The bridges that ship, in the order in which a chain asks them; preflight and the conformance suite read this list.

Changes are added up before anything that is not linear, and taken again at the very end. A clamp is the last look at
absolute rows.
"""

from phyagentos.runtime.actions.bridges.bridge import ActionBridge
from phyagentos.runtime.actions.bridges.clamping import ClampBridge
from phyagentos.runtime.actions.bridges.deltas import ToAbsoluteBridge, ToDeltaBridge
from phyagentos.runtime.actions.bridges.frames import FrameBridge
from phyagentos.runtime.actions.bridges.gripper import GripperBridge
from phyagentos.runtime.actions.bridges.joints import JointOrderBridge
from phyagentos.runtime.actions.bridges.projection import ProjectionBridge
from phyagentos.runtime.actions.bridges.resampling import ResampleBridge
from phyagentos.runtime.actions.bridges.rotations import RotationBridge
from phyagentos.runtime.actions.bridges.units import UnitBridge

BRIDGES: tuple[type[ActionBridge], ...] = (
    UnitBridge,
    RotationBridge,
    ToAbsoluteBridge,
    FrameBridge,
    ProjectionBridge,
    JointOrderBridge,
    GripperBridge,
    ResampleBridge,
    ClampBridge,
    ToDeltaBridge,
)
