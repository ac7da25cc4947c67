"""Whether a session fits a target: the checks in order, and the grant. Paper sections 3.4 and 4.5."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.capabilities.action_spaces import describe_target_space
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.bridges.chain import BridgeChain, compile_chain
from phyagentos.runtime.actions.bridges.tool_poses import describe_frames
from phyagentos.runtime.preflight.adapter_plan import (
    AdapterPlan,
    TargetToolManifest,
    describe_skill_tool,
    make_tools,
)
from phyagentos.runtime.preflight.arguments import (
    iter_ambiguity_problems,
    iter_contradictions,
    iter_limit_problems,
    iter_name_problems,
    iter_parameter_problems,
    iter_posture_problems,
    iter_precondition_problems,
    iter_predicate_problems,
)
from phyagentos.runtime.preflight.findings import locate, make_problem
from phyagentos.runtime.preflight.needs import (
    find_exposed,
    iter_ability_problems,
    iter_handshake_problems,
    iter_live_ability_problems,
    iter_operation_problems,
    iter_resource_problems,
    iter_timing_problems,
    iter_version_problems,
)
from phyagentos.runtime.preflight.policy_checks import AskPolicy, iter_policy_problems, iter_served_problems
from phyagentos.runtime.preflight.safety_limits import (
    iter_live_safety_problems,
    iter_safety_problems,
    iter_start_problems,
    iter_tool_problems,
)
from phyagentos.runtime.preflight.sensing import iter_frame_problems, iter_sensing_problems
from phyagentos.runtime.preflight.settings import Settings
from phyagentos.runtime.targets.wire import Description

_MOVERS = {"builtin": "tree", "policy": "policy", "agent_loop": "agent"}  # kind of skill -> what commands
RUNNABLE = ("builtin", "policy", "agent_loop")


@dataclass(frozen=True, slots=True, kw_only=True)
class Preflight:
    """The documents against which sessions on one target are checked.

    This runtime can run skills of these `kinds`. `ask_policy` asks a policy server for its descriptor; None where no
    client is installed.
    """

    skills: dict[str, SkillRuntime]
    profile: TargetProfile
    settings: Settings
    kinds: tuple[str, ...] = RUNNABLE
    ask_policy: AskPolicy | None = None

    def find_contract_problems(self, session: Session) -> list[Problem]:
        """Problems on paper, without the live target."""
        settings, profile = self.settings, self.profile
        problems: list[Problem] = []
        if session.target != profile.target:
            problems.append(Problem.unknown("target", "target", session.target, [profile.target]))
        problems += iter_limit_problems(session, settings.limits)
        problems += iter_predicate_problems(session)
        problems += iter_resource_problems(session, settings.contract)
        skill = self.skills.get(session.skill)
        problems += iter_posture_problems(session, skill, profile)
        if skill is None:
            problems.append(Problem.unknown("skill", "skill", session.skill, self.skills))
        else:
            problems += iter_parameter_problems(session, skill)
        problems += iter_safety_problems(settings.limits, profile)
        problems += iter_timing_problems(profile, settings.contract)
        if skill is not None:
            problems += self._iter_skill_problems(skill)
            if skill.policy is not None and self.ask_policy is not None:
                problems += iter_served_problems(skill, self.ask_policy)
        return locate(session, problems)

    def find_target_problems(self, session: Session, live: Description) -> list[Problem]:
        """Differences between the live target and the documents."""
        problems = (
            *iter_handshake_problems(self.profile, self.settings.contract, live),
            *iter_live_safety_problems(self.settings.limits, self.profile, live),
        )
        return locate(session, problems)

    def find_scene_problems(self, session: Session, live: Description) -> list[Problem]:
        """Frames and cameras that a skill needs of the loaded scene."""
        skill = self.skills.get(session.skill)
        if skill is None:
            return []
        problems = (
            *iter_frame_problems(skill, self.settings.sensors, self.settings.perception, live.cameras),
            *iter_live_ability_problems(skill, self.profile, live),
        )
        return locate(session, problems)

    def find_world_problems(
        self, session: Session, live: Description, now: Environment, *, is_fresh: bool = True
    ) -> list[Problem]:
        """Names that are not in the world, preconditions that do not hold, a tool at a forbidden place.

        The world is fresh while nothing has moved in it.
        """
        skill = self.skills.get(session.skill)
        problems = [
            *iter_name_problems(session, skill, now, is_fresh=is_fresh),
            *iter_precondition_problems(session, now),
            *iter_ambiguity_problems(session, skill, now),
            *iter_contradictions(session, now),
            *iter_start_problems(self.settings.limits, self.profile, now),
            *iter_tool_problems(self.profile, live, now),
        ]
        return locate(session, problems)

    def plan(self, session: Session, live: Description) -> tuple[AdapterPlan, TargetToolManifest]:
        """The execution path that is granted to a session without problems."""
        skill = self.skills[session.skill]
        chain = self._compile_bridges(skill)
        policy, loop = skill.policy, skill.loop
        tools_of_agent = tuple(self.skills[name] for name in loop.tools) if loop is not None else ()
        seen = live.observations if policy is None else tuple(policy.observations)
        plan = AdapterPlan(
            target_adapter=f"target_adapter://{self.profile.kind}/{session.target}",
            skill_runtime=f"skillruntime://{session.skill}",
            tree=skill.tree,
            observation_path=(*seen, f"perception://{self.settings.perception.sensing}"),
            action_path=(_MOVERS[skill.kind], "guard", *live.actions),
            action_bridges=tuple(map(str, chain.links)) if isinstance(chain, BridgeChain) else (),
            policy_adapter="" if policy is None else f"policy_adapter://{policy.policy}@{policy.endpoint}",
            agent_tools=tuple(each.skill for each in tools_of_agent),
        )
        exposed = (find_exposed(each, self.profile, self.settings.contract) for each in (skill, *tools_of_agent))
        granted = tuple(dict.fromkeys(itertools.chain(*exposed)))
        of_agent = map(describe_skill_tool, tools_of_agent)
        return plan, TargetToolManifest(expose=granted, tools=(*make_tools(granted, self.profile, live), *of_agent))

    def _iter_skill_problems(self, skill: SkillRuntime) -> Iterator[Problem]:
        settings, profile = self.settings, self.profile
        if skill.kind not in self.kinds:
            yield make_problem("NOT_OFFERED", "skill.kind", repr(skill.kind), expected=format_names(self.kinds))
        yield from iter_version_problems(skill)
        yield from iter_ability_problems(skill, profile)
        yield from iter_operation_problems(skill, profile, settings.contract)
        yield from iter_sensing_problems(skill, profile, settings.sensors, settings.perception, settings.contract)
        for name in skill.loop.tools if skill.loop is not None else ():
            tool = self.skills.get(name)
            if tool is None or tool.kind != "builtin":
                possible = (each.skill for each in self.skills.values() if each.kind == "builtin")
                yield Problem.unknown("skill", "skill.loop.tools", name, possible)
            else:
                yield from self._iter_skill_problems(tool)
        if skill.kind == "policy":
            yield from iter_policy_problems(skill, profile, settings.sensors, settings.perception.embedded.max_age_s)
        chain = self._compile_bridges(skill)
        if not isinstance(chain, BridgeChain):
            own = (each for each in chain if skill.action_space or each.address.startswith("target."))
            yield from (_locate_space(skill, each) for each in own)

    def _compile_bridges(self, skill: SkillRuntime) -> BridgeChain | tuple[Problem, ...]:
        """From the skill's action space to the target's; or why there is no way."""
        if skill.action_space is None and not self.profile.arm.joints:
            return ()  # it acts by procedures alone
        target = describe_target_space(self.profile)
        return compile_chain(skill.action_space or target, target, describe_frames(self.profile))


def _locate_space(skill: SkillRuntime, problem: Problem) -> Problem:
    """A problem of an action space, with the address of the skill or target."""
    side, _, field = problem.address.rpartition(".")
    whose = "target" if side == "target" else "skill"
    return msgspec.structs.replace(
        problem, address=f"{whose}.action_space.{field}", triggered_by=f"skill {skill.skill}: action_space"
    )
