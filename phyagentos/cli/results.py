"""What each command prints with `--json`: the struct of its operation, and its JSON Schema.

The type is that of the command's reply. A command that loads its operation only when it runs, or prints as it goes on,
names it here.
"""

import inspect
import pkgutil
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin

import msgspec

from phyagentos.cli.app import PLACES, SERVERS
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.struct_schema import REFERENCE

LATE = {  # command -> types below phyagentos; the result is one of them
    "run": ("operations.run:RunReport",),
    "ask": (
        "operations.ask:Asked",
        "operations.ask:NotUnderstood",
        "operations.ask:Answered",
        "agent.planning.answers:Unsolvable",
    ),
    "agent": ("agent.mission.report:MissionReport",),
    "plan": ("operations.plan:PlannedGraph", "agent.planning.answers:Unsolvable"),
    "why": ("operations.why:Explanation",),
    "graph": ("operations.goal_graph:StandingGraph",),
    "context": ("agent.context.context:Context",),
    "logs": ("operations.logs:LogLine",),
    "store follow": ("operations.store:RecordLine",),
    "init": ("operations.init:NewProject",),
    "lint": ("operations.lint:LintReport",),
    "compile": ("operations.compile:CompiledGraph",),
}


ANSWERING = {command: place for command, place in PLACES.items() if command not in SERVERS}
"""Every command that has a result, as it is typed (`store check`), and its function below `phyagentos.cli`."""


def list_types(command: str) -> list[Any]:
    """The types of a command's result, which is one of them; raises DefinitionError `UNKNOWN_NAME`."""
    if command not in ANSWERING:
        raise DefinitionError.unknown("schema", "paos schema", command, ANSWERING)
    if command in LATE:
        return [pkgutil.resolve_name(f"phyagentos.{place}") for place in LATE[command]]
    function = pkgutil.resolve_name(f"phyagentos.cli.{ANSWERING[command]}")
    (found,) = get_args(inspect.signature(function).return_annotation)
    return list(get_args(found)) if get_origin(found) is UnionType else [found]


def build_result_schema(command: str) -> Fields:
    """The JSON Schema of what `paos COMMAND --json` prints; raises DefinitionError `UNKNOWN_NAME`."""
    types = list_types(command)
    schemas, definitions = msgspec.json.schema_components(types, schema_hook=_describe_path, ref_template=REFERENCE)
    own = schemas[0] if len(schemas) == 1 else {"anyOf": list(schemas)}
    return {"title": f"paos {command} --json", "$defs": definitions, **own}


def _describe_path(kind: type) -> Fields:
    if not issubclass(kind, Path):
        raise NotImplementedError
    return {"type": "string"}
