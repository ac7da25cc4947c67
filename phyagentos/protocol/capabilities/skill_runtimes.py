"""Skills: SKILL.md front matter in, SKILLRUNTIME.md out. Paper sections 3.4 and 3.6.

A skill declares its needs, its guarantees and what carries it out, a tree, a policy or an agent that directs it call by
call; it holds no code and no limits.
"""

import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal, TypeGuard

import pydantic

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.recipes import RECIPES, Recipe, read_recipes
from phyagentos.protocol.documents.document import DocumentFormat, split_front_matter
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored, Located, misfit, parse_library_yaml, read_text, validate
from phyagentos.protocol.predicates.meaning import read_statement
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.syntax import Variable, iter_calls
from phyagentos.protocol.settings.operations import Operation

_NUMERIC: dict[str, tuple[type, ...]] = {
    "number": (int, float),
    "integer": (int,),
    "boolean": (bool,),
    "string": (str,),
    "entity": (str,),
    "place": (str,),
    "posture": (str,),
}


class AgentCall(Authored):
    """One decision of an agent.

    Attributes:
        call: `observe` the world as perceived; `invoke_tool`; `query_state`, whether a predicate is true; `wait` and
            hold still; `finish` with a claim, which is recorded and never believed.
        tool: Of `invoke_tool`, one of the session's tools.
        arguments: Of the tool.
        predicate: Of `query_state`.
        seconds: Of `wait`, of the target's time [s].
        claim: Of `finish`.
        reason: Why, in words.
        when: In a procedure, a predicate without whose truth the step is passed over.
    """

    call: Literal["observe", "invoke_tool", "query_state", "wait", "finish"]
    tool: str = ""
    arguments: Fields = {}
    predicate: str = pydantic.Field(default="", max_length=1000)
    seconds: float = pydantic.Field(default=0.0, ge=0.0, le=60.0)
    claim: Literal["success", "failure"] = "success"
    reason: str = pydantic.Field(default="", max_length=1000)
    when: str = ""


class AgentLoop(Authored):
    """How an agent directs a session.

    Attributes:
        tools: Skills with a tree that it may invoke.
        calls: Most that it may make, refused ones included.
        procedure: Steps of the embedded agent; without any an outside one decides (`paos mcp`).
    """

    tools: tuple[str, ...] = pydantic.Field(min_length=1)
    calls: int = pydantic.Field(default=20, ge=1, le=1000)
    procedure: tuple[AgentCall, ...] = ()


ParameterType = Literal[
    "entity", "entities", "place", "point", "points", "posture", "number", "integer", "string", "boolean"
]


class ParameterRole(StrEnum):
    """What an argument is to its skill, where planning, repair and judging have to know it."""

    OBJECT = "object"
    """What the skill acts on."""
    SUPPORT = "support"
    """What the object stands on afterwards; found from the world where no one says it."""
    BROKEN = "broken"
    """Conditions that were once violated where the session is to run, from memory; empty without."""


class Parameter(Authored):
    """One argument of a skill.

    `entity` is the name of an object, `place` of an object with an interior or of a region, `point` three metres in the
    world frame; `entities` and `points` are lists of them, at least one. `posture` is a name of the target's profile.

    Attributes:
        type: What it takes.
        description: One sentence for people.
        role: What it is to the skill. A skill without a declared object acts on the first movable object among its
            arguments; without a declared support, it is the parameter that is called so.
        unit: Of a number.
        default: Value of an argument that is left out.
        optional: Whether it may be left out without a default.
        choices: The only values, where there are few.
        kinds: Kinds of the objects that it may name; any without.
        mechanism: How the object that it names has to move, where that matters.
        minimum: Smallest number.
        maximum: Largest number.
    """

    type: ParameterType
    description: str = ""
    role: ParameterRole | None = None
    unit: str = ""
    default: Any = None
    optional: bool = False
    choices: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    mechanism: Literal["slide", "hinge", "toggle"] | None = None
    minimum: float | None = None
    maximum: float | None = None

    @pydantic.model_validator(mode="after")
    def _check_default(self) -> "Parameter":
        if self.minimum is not None and self.maximum is not None and self.minimum > self.maximum:
            raise misfit("minimum", f"at most the maximum, {self.maximum:g}", "Exchange the two.")
        if self.default is not None and (expected := find_mismatch(self, self.default)):
            raise misfit("default", expected, f"Write one that fits type {self.type}, or leave it out.")
        return self

    @property
    def is_needed(self) -> bool:
        """Whether it must be given."""
        return not self.optional and self.default is None


class Output(Authored):
    """A value a skill leaves behind, for data edges of the goal graph.

    Attributes:
        type: What it is.
        description: One sentence for people.
    """

    type: ParameterType
    description: str = ""


class Needs(Authored):
    """What a target must offer.

    Attributes:
        observations: Names of the target's `observations`.
        actions: Names of the target's `actions`.
        capabilities: Names of the target's `capabilities`.
        operations: Operations besides commanding, observing, halting and settling.
        resources: What no session on another target may use meanwhile; names of runtime_contract.yaml.
        phyagentos: Versions of this software that can run it, as in `>=0.2,<1` (PEP 440); empty for any.
    """

    observations: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    capabilities: tuple[str, ...] = ()
    operations: tuple[Operation, ...] = ()
    resources: tuple[str, ...] = ()
    phyagentos: str = ""


class PromotedWay(Authored):
    """A strategy that has proved itself as the default of a skill in one scope; written by memory, never by hand.

    Attributes:
        entry: Of KNOWLEDGE.md, which names its evidence.
        scene: Name of the scene; empty for any, as below.
        target: Name of the target.
        object: Kind of the object that is acted on.
        destination: Kind of the place where it goes.
        strategy: What is done differently.
        rate: First attempts that succeeded when it was promoted.
    """

    entry: str
    scene: str = ""
    target: str = ""
    object: str = ""
    destination: str = ""
    strategy: Fields
    rate: str = ""


class Learned(Authored):
    """Where a skill comes from that memory has proved; `paos memory promote` writes it.

    Attributes:
        entry: The lesson, of LESSONS.md.
        memory: Snapshot of the memory.
        rate: First attempts that succeeded with it.
        sessions: With which it was verified, and tried again as one skill.
        seeds: Of the starts of these.
    """

    entry: str
    memory: str
    rate: str = ""
    sessions: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()


class SkillRuntime(Authored):
    """The front matter of one SKILL.md.

    Predicates may refer to parameters as `${name}`.

    Attributes:
        skill: Its name; also the folder's.
        description: One sentence for people.
        kind: `builtin` is carried out by a behaviour tree, `policy` by a policy server, `agent_loop` is directed by an
            agent, call by call.
        tree: Name of the tree of a builtin skill.
        parameters: By name.
        outputs: By name.
        requires: Predicates that must hold before it starts.
        hold: Predicates that must hold all through.
        guarantees: Predicates that hold after success; they are judged, never believed.
        recipes: What it makes of what, beside those of `recipes.yaml` in its folder; with any it is planned by amounts.
        needs: Of its target.
        action_space: How a policy speaks; a tree of leaves speaks the target's own language.
        policy: The policy server of a `policy`.
        loop: What the agent of an `agent_loop` may do.
        promoted: Ways that have become its default somewhere.
        learned: Of a skill that was promoted from a sequence of sessions.
    """

    skill: str = pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$")
    description: str
    kind: Literal["builtin", "policy", "agent_loop"] = "builtin"
    tree: str
    parameters: dict[str, Parameter] = {}
    outputs: dict[str, Output] = {}
    requires: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    guarantees: tuple[str, ...] = ()
    recipes: tuple[Recipe, ...] = ()
    needs: Needs = Needs()
    action_space: ActionSpace | None = None
    policy: PolicyDescriptor | None = None
    loop: AgentLoop | None = None
    promoted: tuple[PromotedWay, ...] = ()
    learned: Learned | None = None

    @property
    def needed(self) -> list[str]:
        """Arguments that must be given."""
        return [name for name, each in self.parameters.items() if each.is_needed]

    def accepts(self, names: Iterable[str]) -> bool:
        """Whether these arguments are all that must be given, and no others than it has."""
        return {*self.needed} <= {*names} <= self.parameters.keys()

    def fits(self, arguments: Mapping[str, object]) -> bool:
        """Whether it accepts these arguments, and each of their values."""
        return self.accepts(arguments) and not any(
            find_mismatch(self.parameters[key], value) for key, value in arguments.items()
        )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _drop_tree(cls, data: Any) -> Any:
        """Only a builtin skill names a tree."""
        has_none = isinstance(data, dict) and data.get("kind") in {"policy", "agent_loop"}
        return {"tree": "", **data} if has_none else data

    @pydantic.model_validator(mode="after")
    def _check_loop(self) -> "SkillRuntime":
        if (self.loop is None) is (self.kind == "agent_loop"):
            raise misfit("", "a block `loop` with `kind: agent_loop`, and with no other kind")
        return self


SKILLRUNTIME = DocumentFormat(
    name="skillruntime",
    file="SKILLRUNTIME.md",
    summary="Every skill that a workspace can run: parameters, conditions, promises, needs, and its behaviour tree.",
    block=SkillRuntime,
    key="skill",
)


def read_skill(path: Path) -> tuple[SkillRuntime, Located]:
    """Read `skills/<name>/SKILL.md`; raises DefinitionError with every problem at file:line:column."""
    front, first_line = split_front_matter(read_text(path), str(path))
    located = parse_library_yaml(front, str(path), first_line)
    skill = validate(SkillRuntime, located)
    if skill.skill != path.parent.name:
        expected, hint = f"the folder's name {path.parent.name!r}", f"Write {path.parent.name!r}, or rename the folder."
        raise DefinitionError(located.problem("INVALID_VALUE", ("skill",), repr(skill.skill), expected, hint))
    if (book := path.with_name(RECIPES)).is_file():
        skill = skill.model_copy(update={"recipes": (*skill.recipes, *read_recipes(book))})
    return skill, located


def find_roles(skill: SkillRuntime) -> tuple[str, str]:
    """Parameters of the object that a skill acts on, and of the place where it goes; empty where it promises none.

    `inside(${object}, ${destination})` relates the two; `holding(target, ${object})` names an object alone.
    """
    named = {key for key, each in skill.parameters.items() if each.type in {"entity", "place"}}
    calls = (call for text in skill.guarantees for call in iter_calls(parse_predicate(text, template=True).formula))
    parts = ((said.object, said.place) for said in map(read_statement, calls))
    related = ([each.path for each in both if isinstance(each, Variable) and each.path in named] for both in parts)
    item, place, *_ = [*max(related, key=len, default=[]), "", ""]
    return find_parameter(skill, ParameterRole.OBJECT) or item, place


def find_parameter(skill: SkillRuntime, role: ParameterRole) -> str:
    """The parameter with a role; empty where the skill has none, or does not declare what it acts on."""
    declared = next((key for key, each in skill.parameters.items() if each.role is role), "")
    return declared or (role.value if role is ParameterRole.SUPPORT and role.value in skill.parameters else "")


def find_mismatch(parameter: Parameter, value: object) -> str:
    """What the value of a parameter should have been; empty when it fits."""
    if parameter.type == "point":
        return "" if _is_point(value) else "three numbers [m] in the world frame"
    if parameter.type in {"entities", "points"}:
        fits = _is_point if parameter.type == "points" else lambda each: isinstance(each, str)
        wanted = "points, each three numbers [m]" if parameter.type == "points" else "names"
        return "" if isinstance(value, list | tuple) and value and all(map(fits, value)) else f"a list of {wanted}"
    if parameter.type in {"number", "integer"} and not _is_number(value):
        return parameter.type
    if not isinstance(value, _NUMERIC[parameter.type]):
        return "a name" if parameter.type in {"entity", "place", "posture"} else parameter.type
    if parameter.choices and value not in parameter.choices:
        return " or ".join(map(repr, parameter.choices))
    if not _is_number(value):
        return ""
    if not math.isfinite(value):
        return "a finite number"
    if parameter.minimum is not None and value < parameter.minimum:
        return f"at least {parameter.minimum} {parameter.unit}".rstrip()
    if parameter.maximum is not None and value > parameter.maximum:
        return f"at most {parameter.maximum} {parameter.unit}".rstrip()
    return ""


def _is_point(value: object) -> bool:
    if not isinstance(value, list | tuple) or len(value) != 3:
        return False
    return all(_is_number(item) and math.isfinite(item) for item in value)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
