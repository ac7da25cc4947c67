"""JSON Schemas of every authored file, made from the same models that read them.

Editors use them through `# yaml-language-server: $schema=…`; `protocol/schemas/` holds them, and a test compares.
"""

import json
from collections.abc import Callable
from pathlib import Path

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.schema import Authored

BASE = "https://json-schema.org/draft/2020-12/schema"


def _goal_graph() -> type[Authored]:
    from phyagentos.agent.goal_spec import GoalSpec

    return GoalSpec


def _tree() -> type[Authored]:
    from phyagentos.protocol.trees import TreeHeader

    return TreeHeader


def _scene() -> type[Authored]:
    from phyagentos.protocol.scenes import SceneSpec

    return SceneSpec


def _faults() -> type[Authored]:
    from phyagentos.protocol.faults import FaultFile

    return FaultFile


def _skill() -> type[Authored]:
    from phyagentos.protocol.skill_runtimes import SkillRuntime

    return SkillRuntime


def _target() -> type[Authored]:
    from phyagentos.protocol.targets import TargetProfile

    return TargetProfile


def _setting(name: str) -> Callable[[], type[Authored]]:
    def model() -> type[Authored]:
        from phyagentos.protocol.settings import SETTINGS_FILES

        return SETTINGS_FILES[f"{name}.yaml"]

    return model


_MODELS: dict[str, Callable[[], type[Authored]]] = {
    "faults": _faults,
    "goal_graph": _goal_graph,
    "perception": _setting("perception"),
    "runtime_contract": _setting("runtime_contract"),
    "safety": _setting("safety"),
    "scene": _scene,
    "sensors": _setting("sensors"),
    "skill": _skill,
    "target": _target,
    "tree": _tree,
}


def names_of_schemas() -> list[str]:
    """Every kind that has a schema, sorted."""
    return sorted(_MODELS)


def render_schema(kind: str) -> str:
    """The schema as indented JSON.

    Raises:
        DefinitionError: For an unknown kind.
    """
    if kind not in _MODELS:
        raise DefinitionError(
            Problem(
                code="UNKNOWN_SCHEMA",
                address="paos schema",
                found=repr(kind),
                expected=format_names(_MODELS),
                hint=format_hint(kind, _MODELS),
            )
        )
    schema = {"$schema": BASE, **_MODELS[kind]().model_json_schema(by_alias=True)}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def write_schemas(folder: Path) -> list[Path]:
    """Write `<kind>.schema.json` for every kind; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for kind in names_of_schemas():
        path = folder / f"{kind}.schema.json"
        path.write_text(render_schema(kind), encoding="utf-8")
        paths.append(path)
    return paths
