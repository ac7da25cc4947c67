"""Ticks a behaviour tree as a skill runtime, and keeps its trace.

While the planner works the tree is not ticked: ticks, events and trajectories do not depend on the machine's speed.
"""

from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Parallel, Selector, Sequence
from py_trees.decorators import Decorator

from phyagentos.protocol.documents.plain_data import Fields, to_plain
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.leaf import FailureCode
from phyagentos.runtime.execution.skill_runtime import Failure, SkillStatus, TickResult
from phyagentos.runtime.execution.tree_loader import BuiltTree

IDLE_TICKS_MAX = 1000  # ticks in a row that neither command nor think; a tree may retry a few times without moving

_STATUS = {
    Status.RUNNING: SkillStatus.RUNNING,
    Status.SUCCESS: SkillStatus.SUCCEEDED,
    Status.FAILURE: SkillStatus.FAILED,
    Status.INVALID: SkillStatus.FAILED,
}


class TreeSkillRuntime:
    """A `SkillRuntime` of a behaviour tree built for this session and context."""

    def __init__(self, tree: BuiltTree, context: SkillContext) -> None:
        self._tree = tree
        self._context = context
        self._events: list[TraceEvent] = []
        self._seen: list[tuple[Status, int]] = [(Status.INVALID, 0)] * len(tree.nodes)
        self._watching = [each.behaviour for each in tree.nodes if _watches(each.behaviour)]
        self._commands = 0
        self._idle = 0
        self._stuck = False

    def tick(self) -> TickResult:
        """One tick of the tree, unless the planner is still working."""
        context = self._context
        if self._is_thinking():
            return TickResult(SkillStatus.RUNNING, None, self._find_active(), thinking=True)
        self._tree.root.tick_once()
        self._record()
        status = _STATUS[self._tree.root.status]
        if status is not SkillStatus.RUNNING:
            return TickResult(status, None, self._find_active())
        points = context.commands.take()
        thinking = points is None and self._is_thinking()
        self._commands += points is not None
        self._idle = self._idle + 1 if points is None and not thinking else 0
        if self._idle > IDLE_TICKS_MAX:
            self._stuck = True
            return TickResult(SkillStatus.FAILED, None, self._find_active())
        return TickResult(
            status,
            points,
            self._find_active(),
            thinking,
            goes_on=context.commands.goes_on and not any(each.status is Status.RUNNING for each in self._watching),
        )

    def wait(self, timeout_s: float) -> None:
        """Sleep until the planner answers."""
        self._context.planner.wait(timeout_s)

    def halt(self) -> None:
        """Interrupt the tree and cancel the planner."""
        if self._tree.root.status is Status.RUNNING:
            self._tree.root.stop(Status.INVALID)
            self._record()
        if not self._context.planner.is_free:
            self._context.planner.cancel()

    def read_outputs(self) -> Fields:
        """The outputs that were written, as plain data."""
        values = self._tree.values
        return {name: _export(values[key]) for name, key in self._tree.output_keys.items() if key in values}

    def find_failure(self) -> Failure | None:
        """The deepest node that decided the failure."""
        if self._stuck:
            message = f"the tree ran {IDLE_TICKS_MAX} ticks without commanding or thinking"
            return Failure(self._find_active(), FailureCode.STALLED, message)
        if self._tree.root.status is not Status.FAILURE:
            return None
        decided = _find_decisive(self._tree.root)
        node = next(node for node in self._tree.nodes if node.behaviour is decided)
        code = str(getattr(decided, "code", "")) or f"{node.type.upper()}_FAILED"
        message = str(getattr(decided, "message", "")) or f"{node.path} failed"
        return Failure(node.path, code, message, bool(getattr(decided, "is_final", False)))

    def trace(self) -> tuple[TraceEvent, ...]:
        """The changes so far."""
        return tuple(self._events)

    def close(self) -> None:
        """Drop the tree's values."""
        self._tree.values.clear()

    def _is_thinking(self) -> bool:
        planner = self._context.planner
        return not planner.is_free and not planner.wait(0.0)

    def _find_active(self) -> str:
        """Path of the deepest running node."""
        running = [node.path for node in self._tree.nodes if node.behaviour.status is Status.RUNNING]
        return running[-1] if running else ""

    def _record(self) -> None:
        for index, node in enumerate(self._tree.nodes):
            behaviour = node.behaviour
            now = (behaviour.status, 0 if node.recurs else getattr(behaviour, "activations", 0))
            if now != self._seen[index]:
                self._seen[index] = now
                event = TraceEvent(
                    tick=self._commands,
                    time_s=self._context.time_s,
                    path=node.path,
                    leaf=node.type,
                    status=behaviour.status.value,
                    declared_role=getattr(behaviour, "ROLE", None),
                    code=str(getattr(behaviour, "code", "")),
                    message=str(getattr(behaviour, "message", "")),
                    numbers=dict(getattr(behaviour, "numbers", {})),
                )
                self._events.append(event)


def _watches(node: Behaviour) -> bool:
    """Whether another branch may decide while one moves: each period's outcome is needed before the next is sent."""
    return isinstance(node, Parallel) or (isinstance(node, Sequence | Selector) and not node.memory)


def _export(value: Any) -> Any:
    """An output as plain data for a contract: a pose as seven numbers, a tuple as a list."""
    if isinstance(value, Pose):
        return [*value.position_m, *value.quaternion_wxyz]
    plain = to_plain(value)
    return list(plain) if isinstance(plain, tuple) else plain


def _find_decisive(node: Behaviour) -> Behaviour:
    """Follow the failed children down; a node that failed by itself, such as a timeout, decides."""
    if getattr(node, "code", ""):
        return node
    if isinstance(node, Composite):
        failed = [child for child in node.children if child.status is Status.FAILURE]
        if failed:
            return _find_decisive(failed[-1])
    if isinstance(node, Decorator) and node.decorated.status is Status.FAILURE:
        return _find_decisive(node.decorated)
    return node
