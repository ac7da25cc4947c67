"""Compatibility preflight: everything that can be known before a motor moves. Paper sections 3.4 and 4.5.

Upstream: the watchdog's claim. Downstream: an adapter plan for the runner, or every problem at once. Documents are
compared first, then the live target is asked what it is, then the session's preconditions are judged on a fresh look at
its world.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.sessions import Session
from phyagentos.protocol.skill_runtimes import SkillRuntime, find_mismatch, problem_unknown_skill
from phyagentos.protocol.targets import TargetProfile
from phyagentos.protocol.verdicts import Truth
from phyagentos.runtime.adapter_plan import EXPOSED_TOOLS, AdapterPlan, TargetToolManifest
from phyagentos.runtime.targets.wire import Description


@dataclass(frozen=True, slots=True)
class Preflight:
    """The documents against which sessions are checked.

    Attributes:
        skills: SKILLRUNTIME.md, by name.
        profile: Of the one target this worker commands.
        sensing: Which pipeline of perception observes (`truth`, `perceived`).
    """

    skills: Mapping[str, SkillRuntime]
    profile: TargetProfile
    sensing: str = "truth"

    def find_contract_problems(self, session: Session) -> list[Problem]:
        """What is wrong with the contract on paper, without asking the target."""
        if session.target != self.profile.target:
            return [_problem(session, "TARGET_UNKNOWN", "target", session.target, self.profile.target)]
        skill = self.skills.get(session.skill)
        if skill is None:
            return [problem_unknown_skill(f"{session.id}: skill", session.skill, list(self.skills))]
        if skill.kind != "builtin":
            return [_problem(session, "SKILL_KIND_UNSUPPORTED", "skill.kind", skill.kind, "builtin")]
        return [*self._find_missing_abilities(session, skill), *_find_parameter_problems(session, skill)]

    def _find_missing_abilities(self, session: Session, skill: SkillRuntime) -> Iterator[Problem]:
        needs, profile = skill.needs, self.profile
        offers = (
            ("OBSERVATION", "observations", needs.observations, profile.observations),
            ("ACTION", "actions", needs.actions, profile.actions),
            ("CAPABILITY", "capabilities", needs.capabilities, profile.capabilities),
        )
        for code, name, needed, offered in offers:
            for need in needed:
                if need not in offered:
                    address = f"skill.needs.{name}"
                    yield _problem(session, f"{code}_UNAVAILABLE", address, need, format_names(offered))

    def find_target_problems(self, session: Session, live: Description) -> list[Problem]:
        """Where the live target differs from what TARGETS.md says of it."""
        steps = round(self.profile.control_period_s / self.profile.physics_step_s)
        pairs: dict[str, tuple[Any, Any]] = {
            "target": (live.target, self.profile.target),
            "n_joints": (live.n_joints, len(self.profile.arm.joints)),
            "steps_per_command": (live.steps_per_command, steps),
            "physics_step_s": (live.physics_step_s, self.profile.physics_step_s),
        }
        return [
            _problem(session, "TARGET_MISMATCH", f"target.{name}", str(found), str(expected))
            for name, (found, expected) in pairs.items()
            if found != expected
        ]

    def find_world_problems(self, session: Session, now: Environment) -> list[Problem]:
        """Names that are not in the world, and preconditions that do not hold in it."""
        problems = list(_find_name_problems(session, self.skills[session.skill], now))
        for text in session.requires:
            try:
                evaluation = parse_predicate(text).evaluate(View(now=now, initial=now, target=session.target))
            except DefinitionError as error:
                problems += error.problems
                continue
            if evaluation.truth is not Truth.TRUE:
                problems.append(
                    Problem(
                        code="PRECONDITION_UNMET",
                        address=f"{session.id}: requires",
                        found=f"{text} is {evaluation.truth}",
                        expected="true",
                        hint=evaluation.because,
                    )
                )
        return problems

    def plan(self, session: Session, live: Description) -> tuple[AdapterPlan, TargetToolManifest]:
        """The execution path that is granted."""
        plan = AdapterPlan(
            target_adapter=f"target_adapter://{self.profile.kind}/{session.target}",
            skill_runtime=f"skillruntime://{session.skill}",
            tree=self.skills[session.skill].tree,
            observation_path=(*live.observations, f"perception://{self.sensing}"),
            action_path=("tree", "guard", *live.actions),
        )
        return plan, TargetToolManifest(expose=EXPOSED_TOOLS)


def _problem(session: Session, code: str, field: str, found: str, expected: str) -> Problem:
    return Problem(code=code, address=f"{session.id}: {field}", found=repr(found), expected=expected)


def _find_parameter_problems(session: Session, skill: SkillRuntime) -> Iterator[Problem]:
    for name in session.parameters:
        if name not in skill.parameters:
            yield Problem(
                code="PARAMETER_UNKNOWN",
                address=f"{session.id}: parameters.{name}",
                found=repr(name),
                expected=format_names(skill.parameters),
                hint=format_hint(name, skill.parameters),
            )
    for name, parameter in skill.parameters.items():
        value = session.parameters.get(name)
        if value is None:
            if not parameter.optional and parameter.default is None:
                yield _problem(session, "PARAMETER_MISSING", f"parameters.{name}", "nothing", parameter.type)
        elif reason := find_mismatch(parameter, value):
            yield _problem(session, "PARAMETER_INVALID", f"parameters.{name}", str(value), reason)


def _find_name_problems(session: Session, skill: SkillRuntime, now: Environment) -> Iterator[Problem]:
    known = {"entity": set(now.entities), "place": {*now.entities, *now.regions}}
    for name, parameter in skill.parameters.items():
        value = session.parameters.get(name)
        if parameter.type in known and isinstance(value, str) and value not in known[parameter.type]:
            yield Problem(
                code="ENTITY_UNKNOWN",
                address=f"{session.id}: parameters.{name}",
                found=repr(value),
                expected=format_names(known[parameter.type]),
                hint=format_hint(value, known[parameter.type]),
            )
