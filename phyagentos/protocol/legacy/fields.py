"""Every field of the 0.1.x documents: what it becomes here, or why it is ignored.

The names follow the published schema (`runtime_sessions_v1` and its companions) and the paper's section 3. Upstream:
nothing. Downstream: `remarks`, which reports each field of a file by this table; docs/import.md prints it, and a test
compares.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class To:
    """The field is read; `what` says where its value goes."""

    what: str


@dataclass(frozen=True, slots=True)
class No:
    """The field is ignored; `why` says so in one clause."""

    why: str


Table: TypeAlias = "Mapping[str, To | No | Table]"

_STAMPED = No("the journal stamps its own records")
_CLAIM = No("a claim is a lease with an epoch of ours; theirs has ended")
_ENDPOINT = No("an endpoint belongs to the target or the policy, not to a session")
_ADAPTER = No("preflight makes the adapter plan")
_CHUNKS = No("chunks belong to the policy's skill")
_SENSING = No("sensing is described by sensors.yaml and perception.yaml")
_SAFETY = No("no limit is imported: safety.yaml asks for the source of each number")
_TOOLS = No("the guard and the target decide what may be called, not a list in a document")
_BENCHMARK = No("benchmarks are their own files here")
_MATCHED = No("skills and targets are matched by what one needs and the other offers")
_TEXT = No("free text, kept as a comment: write it as a predicate")
_OBSERVED = No("what a target offers is named after `provides` in sensors.yaml")
_ACTION = No("actions are set-points of joints and gripper here; describe yours in target.yaml")

SESSION: Table = {
    "session_id": To("name of the node (`sessions.<name>`)"),
    "parent_session_id": No("a child here begins from evidence of its parent, and theirs left none"),
    "replan_attempt": No("budgets begin anew"),
    "goal_id": To("one goal graph for each"),
    "parent_goal_id": No("goals do not nest here"),
    "horizon": No("nothing here depends on it"),
    "depends_on": To("`after`, where the other session is pending too"),
    "target_ref": To("`target`"),
    "skillruntime_ref": To("`skill`"),
    "skill_ref": To("`skill` (older name of the field)"),
    "task_description": To("`objective`"),
    "status": To("pending ones become nodes, all others history"),
    "priority": To("`priority`: low -1, normal 0, high 1"),
    "created_at": _STAMPED,
    "updated_at": _STAMPED,
    "claimed_by": _CLAIM,
    "claim_token": _CLAIM,
    "timeouts": {
        "queue_timeout_s": No("a node waits `defaults.queue_s`; theirs was never enforced"),
        "preflight_timeout_s": No("a limit of the goal here, `defaults.preflight_s`; theirs was never enforced"),
        "execute_timeout_s": To("`timeout_s`"),
        "policy_timeout_s": No("a limit of the goal here, `defaults.policy_s`"),
    },
    "retry": {
        "max_retries": To("`max_replans`"),
        "attempted": No("budgets begin anew"),
    },
    "routing": {
        "target_endpoint": _ENDPOINT,
        "policy_endpoint": _ENDPOINT,
        "adapter_resolution": _ADAPTER,
        "adapter_overrides": _ADAPTER,
        "adapter": _ADAPTER,
    },
    "execution": {
        "max_steps": No("an execution is bounded by `timeout_s`; their steps counted policy calls"),
        "control_hz": No("the control period belongs to the target; theirs had no effect"),
        "replan_every": _CHUNKS,
        "replan_every_steps": _CHUNKS,
        "action_chunk_mode": _CHUNKS,
        "chunk_switch_mode": _CHUNKS,
        "steps": No("a list of commands is a behaviour tree here: write it in trees/"),
        "timeline": No("a list of commands is a behaviour tree here: write it in trees/"),
        "reset_policy": No("nothing resets a world between sessions here"),
    },
    "runtime_hints": {
        "perception_queries": _SENSING,
        "force_environment_refresh": No("every session observes before and after"),
        "preferred_replan_every_steps": _CHUNKS,
        "gateway_action": No("there is no gateway"),
    },
    "safety_profile": {
        "profile": _SAFETY,
        "workspace_bounds": _SAFETY,
        "stop_on_policy_timeout": No("a silent skill is always stopped"),
    },
    "verification_profile": No("every session is verified on evidence"),
    "verification": {
        "mode": No("every session is verified on evidence"),
        "goal": _TEXT,
        "success_criteria": _TEXT,
        "constraints": _TEXT,
        "evidence_policy": No("every session leaves the same complete bundle"),
        "contract_origin": No("nothing here depends on it"),
    },
    "benchmark": _BENCHMARK,
    "result": No("a pending session has none; those of the others stand in HISTORY.md, as claims"),
}

TARGET: Table = {
    "id": To("name of the target"),
    "target_class": No("every target is a process of its own here"),
    "target_kind": To("`kind`; `game` becomes `debug`"),
    "type": To("`kind` (older name of the field)"),
    "backend": No("the model is a MuJoCo file: name it in `model`"),
    "benchmark": _BENCHMARK,
    "benchmark_capabilities": _BENCHMARK,
    "embodiment": To("`embodiment`"),
    "enabled": No("a target that is in robots/ can be used; remove its folder to disable it"),
    "workspace": No("a target has no workspace of its own here"),
    "supported_skillruntimes": _MATCHED,
    "supported_skills": _MATCHED,
    "adapter": _ADAPTER,
    "runtime": {
        "target_runtime": No("the model is a MuJoCo file: name it in `model`"),
        "target_endpoint": No("the watchdog starts a target's process itself"),
        "target_adapter": _ADAPTER,
        "runtime_contract_ref": To("the contract whose `control_hz` is read"),
    },
    "observation": _OBSERVED,
    "perception": _SENSING,
    "config": No("free-form settings of their class"),
}

SKILL: Table = {
    "id": To("name of the skill"),
    "runtime": No("names a Python class of theirs; a skill here is a behaviour tree"),
    "runtime_kind": To("`kind`"),
    "category": No("nothing here depends on it"),
    "loop_mode": No("follows from `kind`"),
    "agent_exposure": _TOOLS,
    "supported_target_kinds": _MATCHED,
    "supported_target_types": _MATCHED,
    "policy": _CHUNKS,
    "policy_client": _CHUNKS,
    "observation_contract": _OBSERVED,
    "input_contract": _OBSERVED,
    "output_contract": _ACTION,
    "target_tool_policy": _TOOLS,
    "supports_chunk": _CHUNKS,
    "default_replan_every": _CHUNKS,
    "adapter_requirements": _ADAPTER,
    "requires": No("sensors and outputs of theirs; write `requires` and `needs` in SKILL.md"),
    "benchmark": _BENCHMARK,
}

CONTRACT: Table = {
    "target_id": To("the target that it belongs to"),
    "target_adapter": _ADAPTER,
    "observation": _OBSERVED,
    "action_contract": {
        "id": _ACTION,
        "accepted_representations": _ACTION,
        "shape": _ACTION,
        "dtype": _ACTION,
        "normalized": _ACTION,
        "frame": _ACTION,
        "control_mode": _ACTION,
        "control_hz": To("`control_period_s`, where a whole number of physics steps fits into it"),
        "components": _ACTION,
        "chunk": _CHUNKS,
    },
    "safety": {
        "require_target_side_validation": No("the target always validates"),
        "workspace_bounds_ref": _SAFETY,
        "max_translation_per_step_m": _SAFETY,
        "max_rotation_per_step_rad": _SAFETY,
        "max_linear_velocity_mps": _SAFETY,
        "max_angular_velocity_radps": _SAFETY,
        "gripper_range": _SAFETY,
        "stop_on_nan": No("the guard always refuses what is not finite"),
        "stop_on_timeout": No("a silent commander is always stopped"),
        "operator_override_required": _SAFETY,
    },
    "capabilities": _ADAPTER,
}


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of document.

    Attributes:
        version: What its key `version` says.
        fields: Of one entry.
        lists: Keys under which the entries stand, the present name first; none: the document is one entry.
        id: The field that must be unique.
    """

    version: str
    fields: Table
    lists: tuple[str, ...]
    id: str


KINDS = {
    kind.version: kind
    for kind in (
        Kind("runtime_sessions_v1", SESSION, ("sessions",), "session_id"),
        Kind("runtime_target_registry_v1", TARGET, ("targets",), "id"),
        Kind("runtime_skill_registry_v1", SKILL, ("skillruntimes", "skills"), "id"),
        Kind("runtime_target_contract_v1", CONTRACT, (), "target_id"),
    )
}
KEPT = {
    "runtime_sensor_config_v1": "sensors are described anew in sensors.yaml: each needs a rate and a frame",
    "runtime_perception_config_v1": "perception is described anew in perception.yaml",
    "runtime_lessons_v1": "a failure log of theirs; lessons here rest on verdicts",
    "runtime_session_history_v1": "a log of theirs; the journal here has its own",
}
"""Documents that are copied and not converted, with the reason."""


def iter_rows(table: Table, prefix: str = "") -> Iterator[tuple[str, To | No]]:
    """Every field with its dotted path."""
    for name, field in table.items():
        if isinstance(field, To | No):
            yield f"{prefix}{name}", field
        else:
            yield from iter_rows(field, f"{prefix}{name}.")


def render_tables() -> str:
    """The four tables in Markdown, as docs/import.md prints them."""
    parts = []
    for kind in KINDS.values():
        rows = [
            f"| `{name}` | {field.what} |" if isinstance(field, To) else f"| `{name}` | ignored: {field.why} |"
            for name, field in iter_rows(kind.fields)
        ]
        parts.append("\n".join([f"### `{kind.version}`\n", "| theirs | ours |", "| --- | --- |", *rows]))
    return "\n\n".join(parts) + "\n"
