"""The grant of preflight: a session's execution path and the operations of the target. Paper sections 3.4 and 4.2."""

from collections.abc import Iterable, Iterator
from typing import Literal

import msgspec

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.settings.operations import Operation
from phyagentos.runtime.targets.wire import Description

_PURPOSES: dict[Operation, str] = {
    "apply": "Carry out one control period of set-points.",
    "observe": "Look; time does not move.",
    "halt": "Come to rest by the target's own means, and hold.",
    "settle": "Hold still for some time of the target.",
    "render": "Take a picture; time does not move.",
    "reset": "Begin the scene anew.",
    "home": "Go to the home posture.",
}


class AdapterPlan(msgspec.Struct, frozen=True, kw_only=True):
    """The resolved execution path of one session.

    Attributes:
        target_adapter: Encodes commands for the target (`target_adapter://simulation/panda`).
        skill_runtime: Produces them (`skillruntime://pick_and_place`).
        tree: Behaviour tree of a builtin skill; empty for a policy.
        observation_path: From the target on.
        action_path: Towards the target.
        action_bridges: Conversions between action spaces; empty when skill and target share one.
        policy_adapter: Talks to the policy server; empty for a tree.
        agent_tools: Skills that an agent may invoke where it directs the session.
        validation_mode: `strict`: nothing is repaired silently.
        refused: Why it may not act; granted only to see that its objective is met already. Empty where it may act.
    """

    target_adapter: str
    skill_runtime: str
    tree: str
    observation_path: tuple[str, ...]
    action_path: tuple[str, ...]
    action_bridges: tuple[str, ...] = ()
    policy_adapter: str = ""
    agent_tools: tuple[str, ...] = ()
    validation_mode: str = "strict"
    refused: tuple[Problem, ...] = ()

    def __str__(self) -> str:
        return "\n".join(
            (
                f"skill    {self.skill_runtime}" + (f" (tree {self.tree})" if self.tree else ""),
                f"target   {self.target_adapter}",
                *((f"policy   {self.policy_adapter}",) if self.policy_adapter else ()),
                *((f"agent    {', '.join(self.agent_tools)}",) if self.agent_tools else ()),
                f"observes {' > '.join(self.observation_path)}",
                f"commands {' > '.join(self.action_path)}",
                f"bridges  {' . '.join(self.action_bridges) or 'identity'}",
            )
        )


class Tool(msgspec.Struct, frozen=True, kw_only=True):
    """One operation of the target.

    Attributes:
        description: One sentence.
        arguments: JSON Schema (2020-12) of its arguments, an object.
    """

    name: str
    description: str
    arguments: Fields


class TargetToolManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The operations of the target that the session may use; the handle refuses every other one.

    Attributes:
        tools: The exposed ones with the schemas of their arguments.
    """

    expose: tuple[str, ...]
    tools: tuple[Tool, ...] = ()
    validation_mode: str = "strict"

    def __str__(self) -> str:
        return "\n".join(
            f"{tool.name}({', '.join(_describe_arguments(tool))}): {tool.description}" for tool in self.tools
        )


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One motion of a dry run.

    Attributes:
        motion: What was tried (`grasp red_cube`).
        outcome: Only `impossible` rejects a session.
        code: Why there is no motion, empty when there is one.
        message: One sentence for people.
        ms: What it cost, wall time [ms].
    """

    motion: str
    outcome: Literal["possible", "impossible", "undecided"]
    code: str = ""
    message: str = ""
    ms: float = 0.0


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the examination of one session: a plan, or every problem.

    Attributes:
        plan: None when there is any problem.
        tools: None when there is any problem.
        trials: Of the dry run; empty where none was made.
        ms: What it cost, wall time [ms], without the loading of a scene.
    """

    plan: AdapterPlan | None
    tools: TargetToolManifest | None
    problems: tuple[Problem, ...] = ()
    trials: tuple[Trial, ...] = ()
    ms: float = 0.0


def _describe_arguments(tool: Tool) -> Iterator[str]:
    for name, schema in tool.arguments["properties"].items():
        shape = []
        while schema.get("type") == "array":
            shape.append(str(schema["maxItems"] if "maxItems" in schema else len(schema["prefixItems"])))
            schema = schema["items"] or schema["prefixItems"][0]
        choices = f" of {', '.join(map(str, schema['enum']))}" if "enum" in schema else ""
        optional = "" if name in tool.arguments["required"] else "?"
        yield f"{name}{optional}{f' [{chr(215).join(shape)}]' if shape else ''}{choices}"


def make_tools(granted: Iterable[Operation], profile: TargetProfile, live: Description) -> tuple[Tool, ...]:
    """One tool for each operation, in this order; shapes and ranges are those of the live target."""
    schemas: dict[Operation, Fields] = {
        "apply": _make_apply(profile, live),
        "halt": _make_object({"category": {"enum": [1, 2]}}, required=()),
        "settle": _make_object({"duration_s": {"type": "number", "exclusiveMinimum": 0}}),
        "render": _make_object(
            {
                "camera": {"enum": list(live.cameras)},
                "width": {"type": "integer", "minimum": 1},
                "height": {"type": "integer", "minimum": 1},
            },
            required=("camera",),
        ),
    }
    return tuple(
        Tool(name=each, description=_PURPOSES[each], arguments=schemas.get(each, _make_object({}))) for each in granted
    )


def describe_skill_tool(skill: SkillRuntime) -> Tool:
    """A skill as a tool of an agent."""
    point: Fields = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
    text: Fields = {"type": "string"}
    shapes: dict[str, Fields] = dict.fromkeys(("entity", "place", "posture", "string"), text)
    shapes |= {
        "point": point,
        "points": {"type": "array", "items": point},
        "entities": {"type": "array", "items": text},
    }
    properties = {
        name: {**shapes.get(each.type, {"type": each.type}), "description": each.description}
        for name, each in skill.parameters.items()
    }
    return Tool(name=skill.skill, description=skill.description, arguments=_make_object(properties, skill.needed))


def _make_apply(profile: TargetProfile, live: Description) -> Fields:
    rows = live.steps_per_command
    joints = [
        {"title": name, "type": "number", "minimum": low, "maximum": high}
        for name, low, high in zip(profile.arm.joints, live.q_min_rad, live.q_max_rad, strict=False)
    ]
    speeds = [{"type": "number", "minimum": -each, "maximum": each} for each in profile.arm.velocity_rad_s]
    return _make_object(
        {
            "q_rad": _make_rows(rows, _make_tuple(joints)),
            "qd_rad_s": _make_rows(rows, _make_tuple(speeds)),
            "gripper_width_m": _make_rows(
                rows, each={"type": "number", "minimum": 0, "maximum": profile.gripper.max_width_m}
            ),
        }
    )


def _make_tuple(items: list[Fields]) -> Fields:
    return {"type": "array", "prefixItems": items, "minItems": len(items), "items": False}


def _make_rows(count: int, each: Fields) -> Fields:
    return {"type": "array", "items": each, "minItems": count, "maxItems": count}


def _make_object(properties: Fields, required: Iterable[str] | None = None) -> Fields:
    needed = list(properties if required is None else required)
    return {"type": "object", "properties": properties, "required": needed, "additionalProperties": False}
