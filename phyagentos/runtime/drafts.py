"""What of a session needs neither authority nor the world: services and tree, made before its start is recorded.

Upstream: the worker, while the watchdog records that a session may start. Downstream: the runner, which opens the
session with its draft, or with a fresh one where the guess was wrong.
"""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.library import Library
from phyagentos.protocol.safety import TargetLimits
from phyagentos.protocol.sessions import Session
from phyagentos.protocol.targets import TargetProfile
from phyagentos.runtime.execution.context import SkillContext, make_context
from phyagentos.runtime.execution.registry import LeafRegistry
from phyagentos.runtime.execution.skill_runtime import SkillRuntime
from phyagentos.runtime.execution.tree_loader import build_tree
from phyagentos.runtime.execution.tree_runtime import TreeSkillRuntime
from phyagentos.runtime.handle import TargetSessionHandle
from phyagentos.runtime.perception.port import Perception
from phyagentos.runtime.perception.senses import SessionSenses
from phyagentos.runtime.policies.policies import Policies
from phyagentos.runtime.targets.wire import Description

if TYPE_CHECKING:
    from phyagentos.runtime.motion.process import Planner


@dataclass(frozen=True, slots=True)
class _Draft:
    """A session that could be opened.

    Attributes:
        description: The target, as it described itself then.
        context: Its services, which have not begun.
        skill: Who decides; a policy is opened with its session.
    """

    session: Session
    plan: Mapping[str, Any]
    description: Description
    context: SkillContext
    skill: TreeSkillRuntime | Policies


class Drafts:
    """Makes ready what sessions on one target decide with, and keeps the latest until it is opened.

    Args:
        handle: The door to the target; a draft only asks what the target is.
        planner: Answers motion requests; stays warm between sessions.
        perception: Turns observations into snapshots.
        registry: Leaves for trees.
        library: Where trees are found.
        profile: The target.
        limits: Of the target, from safety.yaml.
        policies: Opens skills that a policy server carries out.
    """

    def __init__(
        self,
        *,
        handle: TargetSessionHandle,
        planner: "Planner",
        perception: Perception,
        registry: LeafRegistry,
        library: Library,
        profile: TargetProfile,
        limits: TargetLimits,
        policies: Policies | None = None,
    ) -> None:
        self._handle, self._planner, self._perception = handle, planner, perception
        self._registry, self._library = registry, library
        self._profile, self._limits, self._policies = profile, limits, policies
        self._kept: _Draft | None = None

    def keep(self, session: Session, plan: Mapping[str, Any]) -> None:
        """Make a draft of a session that may start soon; what is wrong with it is told when it is opened."""
        self._kept = None
        with contextlib.suppress(DefinitionError, ExecutionError):
            self._kept = self._make(session, plan)

    def open(
        self, session: Session, plan: Mapping[str, Any], initial: Environment
    ) -> tuple[SkillContext, SkillRuntime]:
        """The services and the skill of a session that has authority.

        Args:
            session: The contract.
            plan: The adapter plan as plain data.
            initial: The world as it was shown to the session.

        Raises:
            DefinitionError: With every problem of its tree.
            ExecutionError: Of a policy server, or `TARGET_LOST`.
        """
        draft, self._kept = self._kept, None
        description = self._handle.describe()
        if draft is None or (draft.session, draft.plan) != (session, plan) or draft.description is not description:
            draft = self._make(session, plan)
        context = draft.context
        context.begin(self._handle.step, initial, description)
        skill = draft.skill.open(session, context) if isinstance(draft.skill, Policies) else draft.skill
        return context, skill

    def _make(self, session: Session, plan: Mapping[str, Any]) -> _Draft:
        description = self._handle.describe()
        context = make_context(
            session,
            profile=self._profile,
            limits=self._limits,
            description=description,
            planner=self._planner,
            senses=SessionSenses(self._handle, self._perception, session.scene),
        )
        if self._policies is not None and plan.get("policy_adapter"):
            return _Draft(session, plan, description, context, self._policies)
        tree = build_tree(str(plan["tree"]), session.parameters, context, self._library, self._registry)
        return _Draft(session, plan, description, context, TreeSkillRuntime(tree, context))
