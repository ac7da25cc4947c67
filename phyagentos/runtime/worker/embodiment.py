"""A target for the sessions of its worker, and how a session's skill is opened on it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phyagentos.clock import Clock, SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime as Skill
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.agent_calls import CallFiles
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.execution.context import NeighbourAccess, SkillContext, open_context
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.skill_runtime import SkillRuntime
from phyagentos.runtime.execution.taken_over import Leader
from phyagentos.runtime.execution.tree_loader import build_tree
from phyagentos.runtime.execution.tree_runtime import TreeSkillRuntime
from phyagentos.runtime.perception.world_model import WorldModel
from phyagentos.runtime.policies.policy_runtime import Policies
from phyagentos.runtime.worker.agent_loop import AgentLoopRuntime

if TYPE_CHECKING:
    from phyagentos.runtime.motion.process import Planner


@dataclass(frozen=True, slots=True, kw_only=True)
class Embodiment:
    """One target, whose scene is loaded: commanded through its handle, perceived by its world model."""

    handle: TargetSessionHandle
    world: WorldModel
    profile: TargetProfile
    limits: TargetLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class SkillLoader:
    """Opens the skill of a session.

    Attributes:
        policies: Opens skills that a policy server carries out; None without one.
        skills: SKILLRUNTIME.md, by name, for those that an agent directs.
        loops: Folder of the files between their sessions and outside agents; `clock` is for waiting for these.
    """

    planner: "Planner"
    library: Library
    registry: LeafRegistry
    policies: Policies | None = None
    skills: Mapping[str, Skill] = field(default_factory=dict)
    loops: Path = Path("loops")
    clock: Clock = field(default_factory=SystemClock)

    def open_context(
        self, session: Session, target: Embodiment, initial: Environment, evidence: Path | None = None
    ) -> SkillContext:
        """Services for the skill of a session, from the snapshot at its start."""
        return open_context(
            session,
            profile=target.profile,
            limits=target.limits,
            description=target.handle.describe(),
            planner=self.planner,
            initial=initial,
            world=target.world,
            start_rad=target.handle.start_rad,
            cell=NeighbourAccess(read_neighbours=target.handle.read_neighbours, announce=target.handle.announce),
            calls=target.handle,
            evidence=evidence,
        )

    def open(self, session: Session, plan: Mapping[str, Any], context: SkillContext) -> SkillRuntime:
        """A policy where the adapter plan names one, an agent's loop where it names tools, else a behaviour tree."""
        if plan.get("policy_adapter") and self.policies is not None:
            return self.policies.open(session, context)
        if (loop := self.skills[session.skill].loop if plan.get("agent_tools") else None) is not None:
            return AgentLoopRuntime(
                loop=loop,
                tools={name: self.skills[name] for name in loop.tools},
                context=context,
                open_tree=self._open_tree,
                files=CallFiles(self.loops / session.id),
                clock=self.clock,
            )
        return self._open_tree(str(plan["tree"]), context)

    def open_leader(self, leader: Leader, context: SkillContext) -> SkillRuntime:
        """What follows a person; raises DefinitionError where this target cannot take the person's commands."""
        assert self.policies is not None, "whatever runs sessions of people can run policies"
        return self.policies.open_leader(leader, context)

    def _open_tree(self, tree: str, context: SkillContext) -> SkillRuntime:
        """The tree of the context's session."""
        return TreeSkillRuntime(
            tree=build_tree(tree, context.session.parameters, context, self.library, self.registry), context=context
        )
