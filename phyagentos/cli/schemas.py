"""JSON Schemas of every authored file and of every document, made from the same models that read them.

Editors use those of authored files through `# yaml-language-server: $schema=…`. The schema of a document describes its
front matter with one more key, `blocks`: heading -> YAML block. Beside them are those of what commands print with
`--json`. `protocol/schemas/` holds them all; a test compares.
The pages of `docs/documents/` have the fields of each as Markdown tables.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from phyagentos.cli.results import ANSWERING, build_result_schema
from phyagentos.errors import get_known
from phyagentos.operations.schema_fields import iter_structures, list_fields
from phyagentos.protocol.documents.markdown import render_table
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored

RESULTS = "results/"  # of a command, its words joined by underscores: `results/store_check`
BASE = "https://json-schema.org/draft/2020-12/schema"


class ShownSchema(msgspec.Struct, frozen=True, kw_only=True):
    """Every kind that has a schema, and the schema of the one that is asked for."""

    kinds: tuple[str, ...]
    schema: Fields = {}


def show(kind: str) -> ShownSchema:
    """The schema of a kind, none without it; raises DefinitionError `UNKNOWN_NAME`."""
    kinds = (*names_of_schemas(), *names_of_results())
    return ShownSchema(kinds=kinds, schema=build_schema(kind) if kind else {})


def names_of_schemas() -> list[str]:
    """Every kind that has a schema, sorted."""
    return sorted(_builders())


def names_of_results() -> list[str]:
    """The schema of each command's result, sorted."""
    return sorted(f"{RESULTS}{command.replace(' ', '_')}" for command in ANSWERING)


def render_schema(kind: str) -> str:
    """The schema as indented JSON."""
    return json.dumps({"$schema": BASE, **build_schema(kind)}, indent=2, ensure_ascii=False) + "\n"


def build_schema(kind: str) -> Fields:
    """The schema as data; raises DefinitionError for an unknown kind."""
    if kind.startswith(RESULTS):
        return build_result_schema(kind.removeprefix(RESULTS).replace("_", " "))
    return get_known("schema", "paos schema", kind, _builders())()


def _builders() -> dict[str, Callable[[], Fields]]:
    from phyagentos.agent.goals.spec import GoalFile
    from phyagentos.bench.suite_file import Suite
    from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
    from phyagentos.protocol.capabilities.targets import TargetProfile
    from phyagentos.protocol.capabilities.trees import TreeHeader
    from phyagentos.protocol.documents.document import build_schema as build_document_schema
    from phyagentos.protocol.documents.struct_schema import build_authored_schema
    from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
    from phyagentos.protocol.world.faults import FaultFile
    from phyagentos.protocol.world.scenes import SceneSpec
    from phyagentos.store.document_registry import FORMATS

    def build_authored(model: type[Authored]) -> Fields:
        schema, definitions = build_authored_schema(model)
        return {"$defs": definitions, **schema} if definitions else schema

    models: dict[str, type[Authored]] = {
        "faults": FaultFile,
        "goal_graph": GoalFile,
        "scene": SceneSpec,
        "skill": SkillRuntime,
        "suite": Suite,
        "target": TargetProfile,
        "tree": TreeHeader,
        **{Path(name).stem: model for name, model in SETTINGS_FILES.items()},
    }
    authored = {kind: partial(build_authored, model) for kind, model in models.items()}
    documents = {each.name: partial(build_document_schema, each) for each in FORMATS.values()}
    return {**authored, **documents}


def render_fields(kind: str) -> str:
    """One table for each structure of a kind, the outermost first; raises DefinitionError for an unknown kind."""
    schema = build_schema(kind)
    definitions = schema.get("$defs", {})
    tables = []
    for title, structure in iter_structures(schema, definitions):
        rows = ((f"`{name}`", *row) for name, row in list_fields(structure, definitions).items())
        tables.append(f"**{title}**\n\n{render_table(('field', 'is', 'default', 'meaning'), rows)}")
    return "\n".join(tables)
