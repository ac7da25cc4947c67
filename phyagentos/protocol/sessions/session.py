"""A session: the unit of scheduling, preflight, execution, evidence and acceptance. Its document is SESSIONS.md.

The contract is written once, with the `submit` record; a person may amend limits and priority while it is pending, then
it never changes. Later records carry what happens to it (see `lifecycle`). Paper sections 3.1 and 3.5.
"""

import re
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, NewType

import msgspec

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.documents.document import DocumentFormat, FrontMatter
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.idealisations import Idealisation

SessionId = NewType("SessionId", str)
GoalId = NewType("GoalId", str)
GOAL_ID_MAX, NODE_MAX = 100, 100  # letters: `<goal>.<node>.r<k>` names a folder, so with more 255 must be enough
PRIORITY_MAX = 1_000_000
_GOAL_ID = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{GOAL_ID_MAX - 1}}}")


def check_goal_id(id: str, address: str) -> GoalId:
    """The id of a goal, which names files and folders; raises DefinitionError `INVALID_VALUE` at `address`."""
    if _GOAL_ID.fullmatch(id) is None:
        expected = f"letters, digits, '.', '_', '-', the first a letter or digit, at most {GOAL_ID_MAX}"
        raise DefinitionError.of("INVALID_VALUE", address, repr(id), expected)
    return GoalId(id)


class Ended(StrEnum):
    """How the execution of a session ended, which does not show whether the objective was met."""

    COMPLETED = "completed"
    """The skill ran to its end and reported success."""
    SKILL_FAILED = "skill_failed"
    """The skill ran to its end and reported failure."""
    TIMED_OUT = "timed_out"
    """The contract's time limit was reached."""
    STALLED = "stalled"
    """The target or the skill made no progress."""
    RUNNER_LOST = "runner_lost"
    """The worker process died."""
    TARGET_LOST = "target_lost"
    """The target no longer answered."""
    SAFETY_STOP = "safety_stop"
    """A safety layer or a violated constraint stopped the execution."""
    CANCELLED = "cancelled"
    """An end was requested."""


ALREADY_MET = "ALREADY_MET"
"""Code of a completed execution that commanded nothing, because the acceptance was true before it."""
INTERRUPTED = frozenset({Ended.TIMED_OUT, Ended.STALLED, Ended.RUNNER_LOST, Ended.TARGET_LOST, Ended.SAFETY_STOP})
"""Ends in the middle of a motion: the hand may still hold what another session would let fall."""


class ResetPolicy(StrEnum):
    """When the world of a target may be begun anew for a session of another episode."""

    NEVER = "never"
    """Never: it acts in the episode that stands there, or in a world in which none has begun."""
    BETWEEN_GOALS = "between_goals"
    """Once every other goal of that target is over."""
    ON_NEW_EPISODE = "on_new_episode"
    """Whenever it belongs to another episode."""


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Bounds that the watchdog enforces.

    Attributes:
        timeout_s: Longest execution in the target's own time [s].
        wall_timeout_s: Longest execution by the wall clock, thinking included [s].
        queue_s: Longest wait for a free target, by the wall clock [s].
        preflight_s: Longest check before it starts, by the wall clock [s].
        heartbeat_s: Longest silence of the runner, by the wall clock [s].
        stall_s: Longest time without a control period while the runner reports that it acts, by the wall clock [s].
        think_s: Longest time in which it waits for a planner and no control period passes, by the wall clock [s].
        policy_s: Longest wait for an answer of a policy server, by the wall clock [s].
    """

    timeout_s: float = 60.0
    wall_timeout_s: float = 120.0
    queue_s: float = 3600.0
    preflight_s: float = 120.0
    heartbeat_s: float = 10.0
    stall_s: float = 20.0
    think_s: float = 90.0
    policy_s: float = 10.0


class Scene(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Which world a session acts in, and what its goal calls the objects in it.

    Attributes:
        name: Scene file, without suffix (`tabletop/cubes_and_trays`).
        seed: Seed of the scene's randomisation.
        episode: Sessions of one episode share one world; a new episode begins with a fresh one.
        described: Names for unnamed objects, each with the description that one of them fits (`a red box`).
    """

    name: str
    seed: int
    episode: str
    described: dict[str, str] = {}


class Session(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The contract of one session, immutable once it is claimed.

    Attributes:
        id: Unique: `<goal>.<node>` plus `.r<k>` for the k-th child.
        goal: The goal it serves; empty for a session that a person submitted by hand.
        node: The node of the goal graph; empty without a goal.
        parent: The session that this one revises, else None.
        attempt: 0 for the first session of a node, then 1, 2, ...
        objective: In words, for people.
        skill: Name in SKILLRUNTIME.md.
        target: Name in TARGETS.md.
        parameters: The skill's arguments, fully substituted.
        acts_on: The parameter that names what it acts on; empty where its skill declares none.
        requires: Predicates that must hold before it starts.
        hold: Predicates that must hold all through.
        accept: Predicates that decide acceptance.
        scene: The world it acts in.
        seed: Root of every random choice of this session.
        limits: Bounds.
        strategy: What is done differently from the skill's own way.
        priority: Larger runs first; a waiting session gains priority with time (`RuntimeContract.ageing_per_min`).
        resources: What it must have for itself while it runs, beside its target (a tray that two arms reach).
        reset_policy: When its target's world may be begun anew for it.
        purpose: Empty when it pursues the objective of its node; `inspect` or `clear` when it prepares that.
        advice: What memory advised for the strategy, one sentence each.
        advised_by: Ids of the entries of memory that this rests on.
        lookahead: What is to be simulated before it starts; None for nothing.
        goal_left_s: Simulated time that the goal's budget left for it [s]; None where that bounds nothing.
        unless_met: Whether it ends with `ALREADY_MET`, and nothing is commanded, when its acceptance is true before.
        interchangeable: Groups of objects that the goal lets stand for each other.
        coming: Objects that the goal brings to the same place, in other sessions: room is left for them.
        kept: Objects that are not moved to make room, since the goal says something about them.
    """

    id: SessionId
    goal: GoalId
    node: str
    objective: str
    skill: str
    target: str
    parameters: Fields
    accept: tuple[str, ...]
    scene: Scene
    seed: int
    parent: SessionId | None = None
    attempt: int = 0
    requires: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    limits: Limits = Limits()
    strategy: Strategy = DEFAULT_STRATEGY
    priority: int = 0
    resources: tuple[str, ...] = ()
    reset_policy: ResetPolicy = ResetPolicy.ON_NEW_EPISODE
    acts_on: str = ""
    purpose: str = ""
    advice: tuple[str, ...] = ()
    advised_by: tuple[str, ...] = ()
    lookahead: LookaheadRequest | None = None
    goal_left_s: float | None = None
    unless_met: bool = False
    interchangeable: tuple[tuple[str, ...], ...] = ()
    coming: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()

    @property
    def execution_s(self) -> float:
        """Longest execution in the target's own time [s]: its own limit, or what the goal's budget left."""
        own_s = self.limits.timeout_s
        return own_s if self.goal_left_s is None else min(own_s, self.goal_left_s)

    def find_object(self, world: Environment) -> str | None:
        """The movable object that it acts on; without a declared one, the first among its arguments. None without any.

        Of a list, the first.
        """
        declared = self.parameters.get(self.acts_on)
        return world.find_movable(self.parameters.values() if declared is None else (declared,))

    def make_view(
        self, now: Environment, initial: Environment | None, metrics: Mapping[str, float] | None = None
    ) -> View:
        """What its predicates are evaluated on: the world `now` against `initial`, as its goal agreed on names."""
        return View(
            now=now, initial=initial, target=self.target, metrics=metrics or {}, interchangeable=self.interchangeable
        )

    def explain_time(self) -> str:
        """`the contract allows 60.0 s of simulated time`: the limit that decides."""
        if self.execution_s < self.limits.timeout_s:
            return f"BUDGET: the goal's budget leaves {self.execution_s:g} s of simulated time"
        return f"the contract allows {self.limits.timeout_s} s of simulated time"


class Amendment(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """What a person changes of a contract that is not claimed yet; the body of the `amend` record.

    Attributes:
        limits: Limits that change, in seconds, by name.
        priority: The new one, None for as before.
    """

    limits: dict[str, Annotated[float, msgspec.Meta(gt=0)]] = {}
    priority: int | None = None


def apply_amendment(contract: Session, amendment: Amendment) -> Session:
    """The contract as amended; unknown limits are left out."""
    known = {name: value for name, value in amendment.limits.items() if name in Limits.__struct_fields__}
    priority = contract.priority if amendment.priority is None else amendment.priority
    return msgspec.structs.replace(
        contract, limits=msgspec.structs.replace(contract.limits, **known), priority=priority
    )


class Execution(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the runtime reports when a session leaves `running`; the body of the `finish` record.

    Attributes:
        ended: How the execution ended.
        evidence: Folder of the bundle, relative to the workspace.
        outputs: Values that later nodes may use (`place_site`).
        leaf: Path of the leaf that decided the end, empty when all succeeded.
        code: Coded reason; empty when completed, unless nothing was to be done (`ALREADY_MET`).
        message: One sentence for people.
        sim_time_s: Simulated time spent [s].
        interventions: Number of safety interventions.
        ticks: Control periods commanded.
        open_criteria: What the acceptance speaks of and the last look did not show; the target waits for the verdict.
        driver: What moved the target, as it described itself; empty in records of before, and when nothing was moved.
        idealisations: What of the target and its world was simpler than reality, as it described itself.
        is_final: Whether the leaf that failed says that another attempt would meet the same.
        led_by: Who took the arm over in its midst; empty without a take-over.
        defect: Where a person's own code raised the error that ended it: `file:line`, or the server that has it.
    """

    ended: Ended
    evidence: str
    outputs: Fields = {}
    leaf: str = ""
    code: str = ""
    message: str = ""
    sim_time_s: float = 0.0
    interventions: int = 0
    ticks: int = 0
    open_criteria: tuple[str, ...] = msgspec.field(default=(), name="undecided")
    driver: str = ""
    idealisations: tuple[Idealisation, ...] = ()
    is_final: bool = False
    led_by: str = ""
    defect: str = ""

    @property
    def is_idle(self) -> bool:
        """Whether nothing was to be done, and nothing was commanded."""
        return self.ended is Ended.COMPLETED and self.code == ALREADY_MET


class SessionStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A session as it stands: the fold of its records.

    Attributes:
        contract: As submitted and amended.
        asked_by: Who submitted it.
        state: A state of the lifecycle table.
        epoch: Fencing token of the latest claim.
        claimed_by: Who holds it.
        execution: Present once it has left `running`.
        attempts: Judgements so far, those included that were added after the verdict.
        reason: Why it was rejected, cancelled or lost, for people.
        problems: Why it was rejected, for programs; empty in journals that kept the sentence alone.
        updated_at: Wall time of the latest record that changed its state, UTC.
    """

    contract: Session
    state: str
    asked_by: str = ""
    epoch: int = 0
    claimed_by: str = ""
    execution: Execution | None = None
    attempts: tuple[Attempt, ...] = ()
    reason: str = ""
    problems: tuple[Problem, ...] = ()
    updated_at: str = ""

    @property
    def decision(self) -> Attempt | None:
        """The judgement that decided; None before the verdict."""
        return next((attempt for attempt in reversed(self.attempts) if not attempt.is_review), None)


SESSIONS = DocumentFormat(
    name="sessions",
    file="SESSIONS.md",
    summary="Every live session and the latest finished ones: contract, state, execution, judgements.",
    block=SessionStatus,
    key="contract.id",
    front=FrontMatter,
)
