"""The authoring formats of goal graphs and of goals without a plan, as frozen models that also give the JSON Schema."""

import re
from functools import partial
from typing import Annotated, Any, Literal

import pydantic

from phyagentos.protocol.capabilities.skill_runtimes import Parameter
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import AlsoCalled, Authored, admit
from phyagentos.protocol.predicates.syntax import HUMAN
from phyagentos.protocol.sessions.forecasters import find_forecaster
from phyagentos.protocol.sessions.lookahead import DEFAULT_FORECASTER
from phyagentos.protocol.sessions.session import PRIORITY_MAX, ResetPolicy

NODE_NAME = r"^[a-z][a-z0-9_]*$"
NAME_MAX = 80  # letters of a goal or node as authored; ids add a seed, or the values of a fan-out
REFERENCE = re.compile(r"\$\{\s*([^{}]+?)\s*\}")
REPEATS = AlsoCalled(("retries", "retry", "attempts", "max_attempts", "max_retries", "repeats"))


class Promise(Authored):
    """A skill named by what it must bring about; the selector finds it."""

    guarantees: str


class LookaheadSpec(Authored):
    """What is foreseen before a session starts.

    Attributes:
        samples: Rollouts at most, each in a world of its own; clear cases take fewer.
        threshold: Least chance of success with which a session is worth a try.
        forecasters: Asked in this order; the first that answers decides, the others are recorded beside it.
    """

    samples: int = pydantic.Field(default=16, ge=1, le=1000)
    threshold: float = pydantic.Field(default=0.7, ge=0.0, le=1.0)
    forecasters: tuple[Annotated[str, pydantic.AfterValidator(partial(admit, check=find_forecaster))], ...] = (
        pydantic.Field(default=(DEFAULT_FORECASTER,), min_length=1, validate_default=True)
    )


class Defaults(Authored):
    """Defaults of every node that declares nothing else.

    Attributes:
        timeout_s: Longest execution in the target's time [s].
        wall_timeout_s: Longest execution by the wall clock, thinking included [s].
        queue_s: Longest wait for a free target, by the wall clock [s].
        preflight_s: Longest check before a session starts, by the wall clock [s].
        heartbeat_s: Longest silence of a runner, by the wall clock [s].
        stall_s: Longest time without a control period while a runner reports that it acts, by the wall clock [s].
        think_s: Longest time without a control period while it waits for a planner, by the wall clock [s].
        policy_s: Longest wait for an answer of a policy server, by the wall clock [s].
        answer_s: Longest wait for a person's answer to a question (`human`), by the wall clock [s]; none where
            no person can answer, as without a terminal.
        max_replans: Children that a node may have.
        reset_policy: When a target's world may be begun anew for this goal.
        lookahead: What is foreseen before a session starts; nothing when it is absent.
    """

    timeout_s: float = pydantic.Field(default=60.0, gt=0)
    wall_timeout_s: float = pydantic.Field(default=120.0, gt=0)
    queue_s: float = pydantic.Field(default=3600.0, gt=0)
    preflight_s: float = pydantic.Field(default=120.0, gt=0)
    heartbeat_s: float = pydantic.Field(default=10.0, gt=0)
    stall_s: float = pydantic.Field(default=20.0, gt=0)
    think_s: float = pydantic.Field(default=90.0, gt=0)
    policy_s: float = pydantic.Field(default=10.0, gt=0)
    answer_s: float = pydantic.Field(default=600.0, ge=0)
    max_replans: Annotated[int, REPEATS] = pydantic.Field(default=2, ge=0)
    reset_policy: ResetPolicy = ResetPolicy.ON_NEW_EPISODE
    lookahead: LookaheadSpec | None = None


class Budget(Authored):
    """What a whole goal may cost, first attempts included; nothing is submitted beyond it.

    Attributes:
        sessions: Sessions that may be submitted.
        sim_time_s: Simulated time of all executions; none begins, and none goes on, beyond it [s].
    """

    sessions: int | None = pydantic.Field(default=None, ge=1)
    sim_time_s: float | None = pydantic.Field(default=None, gt=0)


class After(Authored):
    """An edge from the node that comes first; a bare name is one that waits for its success.

    Attributes:
        node: Name under `sessions`, or of one of the nodes that it became.
        on: What must have become of it.
    """

    node: str
    on: Literal["success", "failure"] = "success"


def _read_edge(value: object) -> object:
    """A bare name as a mapping; and the key `on`, which YAML 1.1 takes for a truth value."""
    if isinstance(value, dict):
        return {"on" if key is True else key: item for key, item in value.items()}
    return {"node": value} if isinstance(value, str) else value


Edge = Annotated[After, pydantic.BeforeValidator(_read_edge, json_schema_input_type=str | After)]


class Question(Authored):
    """A criterion that a person judges after the session.

    Attributes:
        human: The question; yes means that the criterion holds.
    """

    human: Annotated[str, pydantic.StringConstraints(strip_whitespace=True, min_length=1)]


def _read_criterion(value: object) -> object:
    """A question as the text of its criterion."""
    return f"{HUMAN} {Question.model_validate(value).human}" if isinstance(value, dict) else value


Criterion = Annotated[str, pydantic.BeforeValidator(_read_criterion, json_schema_input_type=str | Question)]


class NodeSpec(Authored):
    """One node as authored.

    Attributes:
        skill: Name in SKILLRUNTIME.md, or what it must guarantee.
        target: A role of `targets`, a name in TARGETS.md, or `any`.
        arguments: Arguments of the skill (`with`); may hold `${variable}` and `${node.outputs.name}`.
        after: Nodes that must be done before; `{node: x, on: failure}` for one that must have failed.
        foreach: Variable -> values; one node per value (per combination when there are several variables). Instead of
            values a predicate with the variable: everything that is seen to fit once the node is ready.
        when: What must be true once the node is ready; else it is left out, and what waits for it goes on.
        requires: Preconditions, beside those of the skill.
        hold: Conditions that must hold all through, beside those of the skill and the goal's constraints.
        accept: Acceptance criteria, beside what the skill guarantees.
        objective: In words, for people; written from skill and arguments when empty.
        timeout_s: Overrides the default.
        max_replans: Overrides the default.
        priority: Larger runs first; a waiting session gains priority with time.
        resources: What it must have for itself while it runs, beside those of the skill; see runtime_contract.yaml.
        lookahead: Overrides the default; `false` for no look-ahead.
        even_if_met: Act although the acceptance is true before: the action itself is wanted.
    """

    skill: str | Promise
    target: str = "any"
    arguments: Annotated[Fields, AlsoCalled(("args", "params", "inputs"))] = pydantic.Field(
        default_factory=dict, alias="with"
    )
    after: Annotated[tuple[Edge, ...], AlsoCalled(("depends_on", "needs", "dependencies"))] = ()
    foreach: dict[str, tuple[str | int | float | bool, ...] | str] = {}
    when: tuple[str, ...] = ()
    requires: Annotated[tuple[str, ...], AlsoCalled(("preconditions", "pre"))] = ()
    hold: Annotated[tuple[str, ...], AlsoCalled(("invariants", "constraints"))] = ()
    accept: Annotated[tuple[Criterion, ...], AlsoCalled(("postconditions", "post", "success", "criteria"))] = ()
    objective: str = ""
    timeout_s: float | None = pydantic.Field(default=None, gt=0)
    max_replans: Annotated[int | None, REPEATS] = pydantic.Field(default=None, ge=0)
    priority: int = pydantic.Field(default=0, ge=-PRIORITY_MAX, le=PRIORITY_MAX)
    resources: tuple[str, ...] = ()
    lookahead: LookaheadSpec | Literal[False] | None = None
    even_if_met: bool = False


class GraphParameter(Parameter):
    """A parameter of a goal graph; with its default the graph can be checked, and run alone."""

    default: Any


class Include(Authored):
    """Another goal graph as a node; the names of its nodes begin with the name of this one.

    Attributes:
        include: Name of a goal graph beside this one, else of the library; or the graph itself.
        arguments: Values of its parameters (`with`); may hold `${parameter}` and `${node.outputs.name}`.
        after: Edges to what begins in it; those on failure to every node of it.
        accept: Judged at the end of the goal; without it the graph's own acceptance is, unless the include waits for a
            failure.
    """

    include: str | Fields
    arguments: Fields = pydantic.Field(default_factory=dict, alias="with")
    after: tuple[Edge, ...] = ()
    accept: tuple[Criterion, ...] | None = None


class AnyOf(Authored):
    """Alternatives as a node: each runs when those before it have failed, and one of them has to succeed.

    The second alternative of node `red` is the node `red-2`.

    Attributes:
        any_of: Nodes without edges, the preferred one first.
        after: Edges to each of them.
        when: Conditions of each.
        requires: Preconditions of each.
        hold: Conditions that must hold all through each.
        accept: Acceptance criteria of each.
    """

    any_of: tuple[Fields, ...] = pydantic.Field(min_length=2)
    after: tuple[Edge, ...] = ()
    when: tuple[str, ...] = ()
    requires: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    accept: tuple[Criterion, ...] = ()


class GoalSpec(Authored):
    """One goal graph as it is pursued: each parameter has its value, and each include has become its nodes.

    Attributes:
        parameters: Values that `--set NAME=VALUE` or an `include` gives; `${name}` stands for one, wherever it is used.
        targets: Role -> name in TARGETS.md, or `any`.
        worlds: World -> roles or targets that stand in it together, as their profiles declare (`world`); a target that
            is not named stands in the world of its profile.
        constraints: Invariants, sampled all through every session.
        sessions: Nodes by name.
        accept: The goal's own acceptance, judged at the end against the goal's first snapshot.
        budget: What the whole goal may cost; without end when empty.
        interchangeable: Groups of objects of equal form that may stand for each other: where nothing tells them apart,
            their names are by agreement.
        described: Names for objects outside the inventory, each with its description (`a red box`).
    """

    version: Literal[1] = 1
    goal: str = pydantic.Field(pattern=NODE_NAME)
    objective: str
    scene: str
    parameters: dict[Annotated[str, pydantic.Field(pattern=NODE_NAME)], GraphParameter] = {}
    targets: dict[str, str] = {}
    worlds: dict[str, tuple[str, ...]] = {}
    constraints: tuple[str, ...] = ()
    defaults: Defaults = Defaults()
    sessions: dict[str, NodeSpec] = pydantic.Field(min_length=1)
    accept: tuple[Criterion, ...] = ()
    budget: Budget = Budget()
    interchangeable: tuple[tuple[str, ...], ...] = ()
    described: dict[Annotated[str, pydantic.Field(pattern=NODE_NAME)], str] = {}


class GoalFile(GoalSpec):
    """One goal graph as authored: `sessions` may hold includes and alternatives."""

    sessions: dict[str, NodeSpec | Include | AnyOf] = pydantic.Field(min_length=1)  # type: ignore[assignment]  # only wider


class WantedGoal(Authored):
    """A goal as predicates; it has the keys of a goal graph that say what is wanted, and no sessions.

    Attributes:
        steps: What must come true before what follows it, in this order; each a list of predicates that hold together.
        accept: What must be true at the end.
        budget: What the whole goal may cost; a plan by amounts keeps it.
    """

    version: Literal[1] = 1
    goal: str = pydantic.Field(pattern=NODE_NAME)
    objective: str
    scene: str
    targets: dict[str, str] = {}
    constraints: tuple[str, ...] = ()
    steps: tuple[tuple[str, ...], ...] = ()
    accept: tuple[str, ...] = pydantic.Field(min_length=1)
    budget: Budget = Budget()


def is_wanted(data: object) -> bool:
    """Whether a YAML mapping is a goal without a plan, which has `accept`; a goal graph has `sessions`."""
    return (
        isinstance(data, dict)
        and {"goal", "accept"} <= data.keys()
        and not any(str(key).startswith("session") for key in data)
    )
