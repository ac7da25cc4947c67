"""Chooses the bridges from one action space to another: every problem at once, or a chain."""

from dataclasses import replace

import numpy as np

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, UNIT_ROTATIONS, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Frames
from phyagentos.runtime.actions.bridges.chain import BridgeChain
from phyagentos.runtime.actions.bridges.clamping import ClampBridge
from phyagentos.runtime.actions.bridges.deltas import ToAbsoluteBridge
from phyagentos.runtime.actions.bridges.frames import FrameBridge
from phyagentos.runtime.actions.bridges.gripper import GripperBridge
from phyagentos.runtime.actions.bridges.joints import JointOrderBridge, ProjectionBridge
from phyagentos.runtime.actions.bridges.resampling import ResampleBridge
from phyagentos.runtime.actions.bridges.rotations import RotationBridge
from phyagentos.runtime.actions.bridges.tool_poses import ArmKinematics, ToolPoseBridge
from phyagentos.runtime.actions.bridges.units import UnitBridge

# In the order of a chain: changes are summed before anything that is not linear, and a clamp has the last word.
BRIDGES: tuple[type[ActionBridge], ...] = (
    UnitBridge,
    RotationBridge,
    ToAbsoluteBridge,
    FrameBridge,
    ToolPoseBridge,
    ProjectionBridge,
    JointOrderBridge,
    GripperBridge,
    ResampleBridge,
    ClampBridge,
)


def compile_chain(
    source: ActionSpace, target: ActionSpace, frames: Frames | None = None, arm: ArmKinematics | None = None
) -> BridgeChain | tuple[Problem, ...]:
    """Choose the bridges from one action space to another.

    Args:
        source: What a skill or policy speaks.
        target: What the target takes.
        frames: world_T_frame (4, 4) of the frames that are known, besides `world`.
        arm: Of the target; without it a chain from poses to joints can be printed, not applied.

    Returns:
        The chain, or every problem at once; a problem's address is the field of the action space.
    """
    problems = [*_check_space(source, "source"), *_check_space(target, "target")]
    if source.representation == "joint_position" and target.representation == "tool_pose":
        found, hint = source.representation, "Let the policy command poses of the tool."
        problems.append(
            Problem("REPRESENTATION_UNBRIDGED", "source.representation", found, target.representation, hint)
        )
    if target.delta:
        problems.append(Problem("REPRESENTATION_UNBRIDGED", "target.delta", "changes", "postures"))
    if problems:
        return tuple(problems)
    known = {"world": np.eye(4), **(frames or {})}
    links: list[ActionBridge] = []
    now = source
    for kind in BRIDGES:
        while (planned := kind.plan(now, target, known)) is not None:
            if isinstance(planned, Problem):
                problems.append(planned)
                break
            links.append(replace(planned, arm=arm) if isinstance(planned, ToolPoseBridge) else planned)
            now = planned.target
    if problems:
        return tuple(problems)
    if now.rate_hz == source.rate_hz and now.chunk_length > target.chunk_length:
        expected = f"1 to {target.chunk_length} rows"
        return (Problem("CHUNK_LENGTH", "chunk_length", f"{source.chunk_length} rows", expected, "Shorten the chunk."),)
    return BridgeChain(source, target, tuple(links))


def _check_space(space: ActionSpace, side: str) -> list[Problem]:
    """Contradictions and gaps of a space."""

    def problem(field: str, found: str, expected: str) -> Problem:
        return Problem("ACTION_SPACE_INVALID", f"{side}.{field}", found, expected)

    problems = []
    if space.representation == "joint_position" and len(set(space.joints)) != len(space.joints):
        problems.append(problem("joints", "a joint twice", "each joint once"))
    if space.representation == "joint_position" and not space.joints:
        problems.append(problem("joints", "none", "a name for each column"))
    if space.representation == "tool_pose" and space.rotation == "euler" and not space.euler_order:
        problems.append(problem("euler_order", "none", "three axes such as xyz or ZYX"))
    if space.gripper is not None and space.gripper.closed == space.gripper.open:
        problems.append(problem("gripper", "closed equals open", "two values"))
    columns = len(space.joints) if space.representation == "joint_position" else POSITION_WIDTH
    lengths = {"minimum": columns, "maximum": columns}
    lengths["scale"] = space.arm_width
    lengths["velocity_max"] = columns if space.representation == "joint_position" else 2
    for field, expected in lengths.items():
        found = len(getattr(space, field))
        if found not in (0, expected):
            problems.append(problem(field, f"{found} values", f"{expected}, or none"))
    if space.scale and space.representation == "tool_pose" and space.rotation not in UNIT_ROTATIONS:
        problems.append(problem("scale", f"a scaled {space.rotation}", " or ".join(UNIT_ROTATIONS)))
    return problems
