"""The bridges from one action space to another: chosen, with every problem at once, and applied to every chunk.

A malformed chunk, or one that jumps further than the target's velocity permits, is refused with a code. Only a clamp
that the contract allows repairs, and is recorded.
"""

from dataclasses import dataclass, replace

import numpy as np

from phyagentos.errors import Problem
from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, UNIT_ROTATIONS, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, Unconvertible, name_columns
from phyagentos.runtime.actions.bridges.columns import (
    ClampBridge,
    GripperBridge,
    JointOrderBridge,
    ProjectionBridge,
    UnitBridge,
)
from phyagentos.runtime.actions.bridges.resampling import ResampleBridge
from phyagentos.runtime.actions.bridges.rotations import (
    FrameBridge,
    RotationBridge,
    ToAbsoluteBridge,
    decode_rotation,
    find_bad_rotation,
)
from phyagentos.runtime.actions.bridges.tool_poses import ArmKinematics, ToolPoseBridge
from phyagentos.runtime.actions.violations import Intervention, Violation, ViolationCode

JUMP_TOLERANCE = 0.01  # of the velocity limit: rounding of interpolated rows
# In the order of a chain: changes are summed before anything that is not linear, and a clamp has the last word.
BRIDGES = Plugins[type[ActionBridge]](
    "phyagentos.bridges",
    {
        "unit": UnitBridge,
        "rotation": RotationBridge,
        "to_absolute": ToAbsoluteBridge,
        "frame": FrameBridge,
        "tool_pose": ToolPoseBridge,
        "projection": ProjectionBridge,
        "joint_order": JointOrderBridge,
        "gripper": GripperBridge,
        "resample": ResampleBridge,
        "clamp": ClampBridge,
    },
)


@dataclass(frozen=True, slots=True)
class Bridged:
    """A chunk as the target takes it, with the clamps on the way."""

    rows: Array
    interventions: tuple[Intervention, ...] = ()


@dataclass(frozen=True, slots=True)
class BridgeChain:
    """Bridges in the order in which a chunk passes them; inversion runs in reverse."""

    source: ActionSpace
    target: ActionSpace
    links: tuple[ActionBridge, ...] = ()

    def apply(self, rows: Array, before: Array, velocity: Array | None = None) -> Bridged | Violation:
        """Convert one chunk, or refuse it.

        Args:
            rows: (k, width of the source and its padding), float64, 1 <= k <= chunk_length; with a batch (1, k, ...).
            before: (width of the target,) standing set-point.
            velocity: (arm of the target,) at which it goes on, per second; unknown without it.
        """
        if self.source.batch and rows.ndim == 3 and len(rows) == 1:
            rows = rows[0]
        violation = self._check_form(rows)
        if violation is not None:
            return violation
        rows = rows[:, : self.source.width]
        anchors = [before]
        for link in reversed(self.links):
            anchors.append(link.invert(anchors[-1][None])[0])
        anchors.reverse()
        interventions: list[Intervention] = []
        for link, anchor in zip(self.links, anchors[1:], strict=True):
            try:
                if isinstance(link, ResampleBridge):
                    converted = link.refine(rows, anchor, velocity)
                else:
                    converted = link.apply(rows, anchor)
            except Unconvertible as refused:
                return refused.violation
            interventions += link.find_interventions(rows, converted)
            rows = converted
            if not len(rows):
                words = f"it is shorter than one row of the target, at {self.target.rate_hz:g} Hz"
                return Violation(ViolationCode.WRONG_SHAPE, "chunk", 0.0, 1.0, "rows of the target", words=words)
        return self._check_jumps(rows, before) or Bridged(rows, tuple(interventions))

    def _check_form(self, rows: Array) -> Violation | None:
        source = self.source
        width, most = source.width + source.padding, source.chunk_length
        if rows.ndim != 2 or rows.shape[1] != width or not 1 <= len(rows) <= most:
            wanted = f"{(*((1,) if source.batch else ()), most, width)}: {most} rows at most"
            words = f"found {rows.shape}; expected {wanted}, each of {source.describe_columns()}"
            return Violation(ViolationCode.WRONG_SHAPE, "chunk", rows.size, most * width, "numbers", words=words)
        if rows.dtype != np.float64:
            return Violation(ViolationCode.WRONG_SHAPE, "chunk", float(rows.dtype.itemsize), 8.0, "bytes a number")
        if not np.isfinite(rows).all():
            row, column = np.argwhere(~np.isfinite(rows))[0]
            where, found = (*name_columns(source), *["padding"] * source.padding)[column], float(rows[row, column])
            words = f"found {found}, which is no finite number"
            return Violation(ViolationCode.NOT_FINITE, where, found, np.inf, "", int(row), words)
        if source.representation == "tool_pose":
            columns = rows[:, POSITION_WIDTH : source.arm_width]
            row = find_bad_rotation(columns, source)
            if row >= 0:
                length = float(np.linalg.norm(columns[row]))
                return Violation(ViolationCode.ROTATION_INVALID, source.rotation, length, 1.0, "length", int(row))
        return None

    def _check_jumps(self, rows: Array, before: Array) -> Violation | None:
        target = self.target
        if not target.velocity_max:
            return None
        steps = compute_steps(rows, before, target)
        limit = np.asarray(target.velocity_max) / target.rate_hz * (1.0 + JUMP_TOLERANCE)
        if (steps <= limit).all():
            return None
        row, column = np.unravel_index(int((steps / limit).argmax()), steps.shape)
        joints = target.representation == "joint_position"
        where = target.joints[column] if joints else ("position", "rotation")[column]
        unit = target.angle_unit if joints else (target.length_unit, "rad")[column]
        found, most = float(steps[row, column]), float(limit[column])
        words = f"jumps by {found:.4g} {unit}; at most {most:.4g} {unit} from row to row"
        return Violation(ViolationCode.DISCONTINUOUS, where, found, most, unit, int(row), words)

    def __str__(self) -> str:
        """`frame base->world . units deg->rad . resample 10->50 Hz`; `identity` when nothing is converted."""
        return " . ".join(map(str, self.links)) or "identity"


def compute_steps(rows: Array, before: Array, space: ActionSpace) -> Array:
    """Distance of each row from the one before.

    (k, n_joints) of joints; (k, 2) of poses: distance and angle [rad].
    """
    if space.representation == "joint_position":
        return np.abs(np.diff(rows[:, : space.arm_width], axis=0, prepend=before[None, : space.arm_width]))
    columns = slice(POSITION_WIDTH, space.arm_width)
    known = np.concatenate((before[None], rows))
    distance = np.linalg.norm(np.diff(known[:, :POSITION_WIDTH], axis=0), axis=1)
    turns = decode_rotation(known[:, columns], space)
    angle = (turns[1:] * turns[:-1].inv()).magnitude()
    return np.stack((distance, angle), axis=1)


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
            Problem(
                "ACTION_SPACE_MISMATCH",
                "source.representation",
                found,
                target.representation,
                hint,
                kind="representation",
            )
        )
    if target.delta:
        problems.append(Problem("ACTION_SPACE_MISMATCH", "target.delta", "changes", "postures", kind="representation"))
    if problems:
        return tuple(problems)
    known = {"world": np.eye(4), **(frames or {})}
    links: list[ActionBridge] = []
    now = source
    for kind in list_bridges():
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
        return (
            Problem(
                "ACTION_SPACE_MISMATCH", "chunk_length", f"{source.chunk_length} rows", expected, "Shorten the chunk."
            ),
        )
    return BridgeChain(source, target, tuple(links))


def list_bridges() -> list[type[ActionBridge]]:
    """Shipped bridges and those of installed packages, in the order of a chain; raises as `Plugins.load`."""
    found, order = BRIDGES.load_all(), list(BRIDGES.shipped)
    places = {name: order.index(name) if name in order else order.index(found[name].BEFORE) - 0.5 for name in found}
    return [found[name] for name in sorted(found, key=places.__getitem__)]


def _check_space(space: ActionSpace, side: str) -> list[Problem]:
    """Contradictions and gaps of a space."""

    def problem(field: str, found: str, expected: str) -> Problem:
        return Problem("ACTION_SPACE_MISMATCH", f"{side}.{field}", found, expected)

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
