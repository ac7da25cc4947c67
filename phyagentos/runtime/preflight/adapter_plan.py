"""What preflight grants: how a session will be executed, with which operations of the target. Paper section 3.4.

Upstream: preflight. Downstream: the runner, the handle, the journal's start record and the evidence bundle.
"""

from collections.abc import Iterator
from typing import Any, Literal

import msgspec


class AdapterPlan(msgspec.Struct, frozen=True, kw_only=True):
    """The resolved execution path of one session.

    Attributes:
        target_adapter: Who encodes commands for the target (`target_adapter://simulation/panda`).
        skill_runtime: Who produces them (`skillruntime://pick_and_place`).
        tree: Behaviour tree of a builtin skill; empty for a policy.
        observation_path: What is sensed, in the order it travels.
        action_path: What is commanded, in the order it travels.
        action_bridges: Conversions between the two; empty when skill and target speak the same language.
        policy_adapter: Who speaks with the policy server; empty for a tree.
        validation_mode: `strict`: nothing is repaired silently.
    """

    target_adapter: str
    skill_runtime: str
    tree: str
    observation_path: tuple[str, ...]
    action_path: tuple[str, ...]
    action_bridges: tuple[str, ...] = ()
    policy_adapter: str = ""
    validation_mode: str = "strict"

    def __str__(self) -> str:
        """One line each: who, what is seen, what is commanded, over which bridges."""
        return "\n".join(
            (
                f"skill    {self.skill_runtime}" + (f" (tree {self.tree})" if self.tree else ""),
                f"target   {self.target_adapter}",
                *((f"policy   {self.policy_adapter}",) if self.policy_adapter else ()),
                f"observes {' > '.join(self.observation_path)}",
                f"commands {' > '.join(self.action_path)}",
                f"bridges  {' . '.join(self.action_bridges) or 'identity'}",
            )
        )


class Tool(msgspec.Struct, frozen=True, kw_only=True):
    """One operation of the target.

    Attributes:
        name: Of the operation.
        description: One sentence.
        arguments: JSON Schema (2020-12) of its arguments, an object.
    """

    name: str
    description: str
    arguments: dict[str, Any]


class TargetToolManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The operations of the target that the session may use; the handle refuses every other one.

    Attributes:
        expose: Their names.
        tools: The same with the schemas of their arguments.
    """

    expose: tuple[str, ...]
    tools: tuple[Tool, ...] = ()
    validation_mode: str = "strict"

    def __str__(self) -> str:
        """One line for each tool: name, arguments, what it does."""
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


def _describe_arguments(tool: Tool) -> Iterator[str]:
    for name, schema in tool.arguments["properties"].items():
        shape = []
        while schema.get("type") == "array":
            shape.append(str(schema["maxItems"] if "maxItems" in schema else len(schema["prefixItems"])))
            schema = schema["items"] or schema["prefixItems"][0]
        choices = f" of {', '.join(map(str, schema['enum']))}" if "enum" in schema else ""
        optional = "" if name in tool.arguments["required"] else "?"
        yield f"{name}{optional}{f' [{chr(215).join(shape)}]' if shape else ''}{choices}"
