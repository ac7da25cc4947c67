"""Opens policies as skills of one target."""

from collections.abc import Mapping
from dataclasses import dataclass

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.action_spaces import describe_target_space
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.runtime.actions.bridges.chain import BridgeChain
from phyagentos.runtime.actions.bridges.compilation import compile_chain
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.policies.client import PolicyClient
from phyagentos.runtime.policies.observations import Observer
from phyagentos.runtime.policies.policy_runtime import PolicyParts, PolicySkillRuntime


@dataclass(frozen=True, slots=True, kw_only=True)
class Policies:
    """The policy skills of a workspace.

    Attributes:
        skills: SKILLRUNTIME.md, by name.
        late_max_s: How late a camera's frame may come; `embedded.max_age_s` of perception.yaml [s].
        is_realtime: Whether the world keeps real time.
    """

    skills: Mapping[str, SkillRuntime]
    profile: TargetProfile
    sensors: Sensors
    handle: TargetSessionHandle
    late_max_s: float
    is_realtime: bool

    def open(self, session: Session, context: SkillContext) -> PolicySkillRuntime:
        """The policy of a session that preflight has passed; its server is connected to with the first request.

        Raises:
            DefinitionError: When the documents have changed since, so that there is no such policy any more.
        """
        skill = self.skills[session.skill]
        target = describe_target_space(self.profile)
        chain = compile_chain(skill.action_space or target, target)
        if not isinstance(chain, BridgeChain):
            raise DefinitionError(chain)
        assert skill.policy is not None, "preflight refuses a policy skill without a policy"
        parts = PolicyParts(
            descriptor=skill.policy,
            chain=chain,
            observer=Observer(
                streams=skill.policy.observations,
                sensors=self.sensors,
                handle=self.handle,
                late_max_s=self.late_max_s,
                health=context.initial.sensors,
            ),
            client=PolicyClient(skill.policy.endpoint, session.limits.policy_s),
            is_realtime=self.is_realtime,
        )
        return PolicySkillRuntime(parts, context)
