"""The episodic level: one compact record for each judged session. Paper section 4.3.

An episode repeats nothing of the evidence; it points there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from phyagentos.agent.goals.selector import begins_with_holding
from phyagentos.agent.judging.causes import Cause, CauseClass, find_refusal
from phyagentos.agent.judging.diagnosis import find_violated
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.placed_scenes import name_plain
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime, find_roles
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.memory_entries import Embodiment, Risk
from phyagentos.protocol.sessions.session import Ended, Execution, Session, SessionId, SessionStatus
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene

JUDGED = frozenset({SessionState.SUCCEEDED, SessionState.FAILED, SessionState.REPLANNED})
CAUSES_OF_SAFETY = frozenset(cause for cause in Cause if cause.kind is CauseClass.SAFETY)
_NO_SESSIONS: Mapping[SessionId, SessionStatus] = {}
INTERRUPTIONS = frozenset({Cause.RUNNER_LOST, Cause.TARGET_LOST, Cause.CANCELLED})
SMALL_M, LARGE_M = 0.03, 0.07  # longest half side of what a hand calls small and large


class Features(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a session is about; empty where the inventory does not know it."""

    object: str = ""
    object_kind: str = ""
    object_color: str = ""
    object_size: str = ""
    destination: str = ""
    destination_kind: str = ""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Declarations of skills, inventories of scenes and bodies of targets, by name."""

    skills: Mapping[str, SkillRuntime]
    scenes: Mapping[str, Path]
    targets: Mapping[str, TargetProfile]
    _read: dict[str, SceneSpec | None] = field(default_factory=dict)

    def describe(self, session: Session) -> Features:
        """The features of a contract; what the inventory does not know stays empty."""
        scene = self._find_scene(session.scene.name)
        skill = self.skills.get(session.skill)
        item, place = (str(session.parameters.get(key, "")) for key in (find_roles(skill) if skill else ("", "")))
        body = scene.bodies.get(item) if scene else None
        made = item if skill is not None and skill.recipes else ""  # what is carried is named by its kind
        return Features(
            object=item,
            object_kind=body.kind if body else made,
            object_color=body.color if body else "",
            object_size=_compute_size(body) if body else "",
            destination=place,
            destination_kind=_find_kind(scene, place),
        )

    def describe_target(self, name: str) -> Embodiment:
        """The body of a target, as far as experience depends on it."""
        profile = self.targets.get(name)
        if profile is None:
            return Embodiment()
        gripper = profile.gripper
        return Embodiment(
            kind=profile.embodiment,
            grip_width_m=gripper.max_width_m,
            grip_force_n=gripper.force_n,
            control_period_s=profile.control_period_s,
        )

    def _find_scene(self, placed: str) -> SceneSpec | None:
        name = name_plain(placed)
        if name not in self._read:
            try:
                self._read[name] = read_scene(self.scenes[name]) if name in self.scenes else None
            except (DefinitionError, OSError):  # reported where the goal is linted
                self._read[name] = None
        return self._read[name]


def _compute_size(body: Body) -> str:
    longest_m = max(max(solid.size_m) for solid in body.shapes)
    return "small" if longest_m < SMALL_M else "large" if longest_m > LARGE_M else "medium"


def _find_kind(scene: SceneSpec | None, place: str) -> str:
    if scene is None:
        return ""
    if place in scene.bodies:
        return scene.bodies[place].kind
    return "region" if place in scene.regions else ""


class Episode(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One session, ended and judged.

    Attributes:
        seed: Of the scene: sessions of one seed begin from the same start.
        verdict: By the evidence, also where the mode of verification let something else decide.
        evidence: Bundle, relative to the workspace; its whole path where the memory is outside.
        judged_at: Wall time of the verdict, UTC; distinguishes sessions of one name in two workspaces.
        begun: Wall time at which its goal was submitted, UTC: sessions of one run have the same.
        prepared: Whether sessions before it prepared it, and none was an attempt.
        risk: What was at stake; None in records of before.
        violated: Conditions that were to hold all through and did not.
    """

    session: str
    goal: str
    node: str
    objective: str
    skill: str
    target: str
    scene: str
    seed: int
    verdict: Verdict
    parent: str | None = None
    body: Embodiment = Embodiment()
    features: Features = Features()
    strategy: Strategy = DEFAULT_STRATEGY
    advised_by: tuple[str, ...] = ()
    cause: str = ""
    purpose: str = ""
    sensing: str = ""
    evidence: str = ""
    judged_at: str = ""
    graph: str = ""
    begun: str = ""
    parameters: Fields = {}
    prepared: bool = False
    resumes: bool = False
    risk: Risk | None = None
    safety: tuple[str, ...] = ()
    violated: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Distinguishes it from every other episode."""
        return f"{self.session} {self.judged_at}"

    @property
    def is_success(self) -> bool:
        """Whether its verdict is success."""
        return self.verdict is Verdict.SUCCESS

    @property
    def is_interrupted(self) -> bool:
        """Whether an outside event ended it; then it speaks neither for its way nor against it."""
        return not self.is_success and self.cause in INTERRUPTIONS

    @property
    def is_first(self) -> bool:
        """Whether it is the first attempt of its node."""
        return (self.parent is None or self.prepared) and not self.purpose


def find_key(status: SessionStatus) -> str:
    """The key of a session's episode."""
    return f"{status.contract.id} {status.updated_at}"


def find_episode(
    status: SessionStatus, surroundings: Surroundings, sessions: Mapping[SessionId, SessionStatus] = _NO_SESSIONS
) -> Episode | None:
    """The episode of a session; None while its verdict is open, when it serves no goal, or its skill did not end it.

    A session that preflight refused for what no second try changes is one, too. `sessions` are those of its goal.
    """
    decision, contract, execution = status.decision, status.contract, status.execution
    refused = find_refusal(status.problems) if status.state == SessionState.REJECTED else None
    is_judged = status.state in JUDGED and decision is not None
    if (
        not contract.goal
        or not (is_judged or refused)
        or (execution is not None and (execution.is_idle or execution.led_by))
    ):
        return None
    skill = surroundings.skills.get(contract.skill)
    found = (decision.found or decision.verdict) if decision is not None and is_judged else Verdict.FAILURE
    cause = decision.cause if decision is not None and is_judged else str(refused)
    return Episode(
        session=contract.id,
        goal=contract.goal,
        node=contract.node,
        parent=contract.parent,
        objective=contract.objective,
        skill=contract.skill,
        target=contract.target,
        body=surroundings.describe_target(contract.target),
        scene=contract.scene.name,
        seed=contract.scene.seed,
        features=surroundings.describe(contract),
        strategy=contract.strategy,
        advised_by=contract.advised_by,
        verdict=found,  # in an audit the controller's word decides; it is no experience
        cause=cause,
        purpose=contract.purpose,
        sensing=decision.sensing if decision is not None else "",
        evidence=execution.evidence if execution is not None else "",
        judged_at=status.updated_at,
        parameters=contract.parameters,
        prepared=_is_prepared(contract, sessions),
        resumes=skill is not None and begins_with_holding(skill),
        risk=Risk.GUARDED if contract.hold else Risk.NORMAL,
        safety=_find_safety(cause, execution),
        violated=tuple(each.text for each in find_violated(decision.criteria)) if decision is not None else (),
    )


def _is_prepared(contract: Session, sessions: Mapping[SessionId, SessionStatus]) -> bool:
    """Whether it has parents, and every one prepared an attempt."""
    parents = []
    parent = sessions.get(contract.parent) if contract.parent else None
    while parent is not None:
        parents.append(parent.contract)
        parent = sessions.get(parent.contract.parent) if parent.contract.parent else None
    return bool(parents) and parents[-1].parent is None and all(each.purpose for each in parents)


def _find_safety(cause: str, execution: Execution | None) -> tuple[str, ...]:
    """What stopped it for safety; what a guard changed stands in the events of its bundle."""
    if execution is None or cause not in CAUSES_OF_SAFETY:
        return ()
    return (execution.code if execution.ended is Ended.SAFETY_STOP and execution.code else cause,)
