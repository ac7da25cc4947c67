"""What `--json` prints is what the published schema of the command says."""

import json
from pathlib import Path

import jsonschema
import pytest

from phyagentos.cli.results import build_result_schema, iter_commands

ROOT = Path(__file__).resolve().parents[2]
ANYWHERE = {
    "list": ("list", "skills"),
    "describe": ("describe", "predicate"),
    "schema": ("schema", "scene"),
    "lifecycle": ("lifecycle", "--target"),
    "codes": ("codes",),
    "compile": ("compile", "tidy_table"),
    "lint": ("lint", ROOT / "goal_graphs" / "tidy_table.yaml"),
    "tree show": ("tree", "show", "pick_and_place"),
    "export mermaid": ("export", "mermaid", "statechart"),
    "export bt-xml": ("export", "bt-xml", "pick"),
    "robot list": ("robot", "list"),
    "robot check": ("robot", "check", "panda"),
}
IN_A_WORKSPACE = {
    "why": ("why", "red"),
    "graph": ("graph",),
    "status": ("status",),
    "cancel": ("cancel", "tidy-7"),
    "pause": ("pause", "all"),
    "resume": ("resume", "all"),
    "estop": ("estop",),
    "approve": ("approve",),
    "memory show": ("memory", "show"),
    "evidence verify": ("evidence", "verify"),
}
OF_A_JOURNAL = ("check", "repair", "compact", "stats")


def validate(command: str, text: str) -> None:
    jsonschema.validate(json.loads(text), build_result_schema(command))


@pytest.mark.parametrize("command", ANYWHERE)
def test_the_schema_holds_anywhere(paos, command):
    validate(command, paos(*ANYWHERE[command], "--json").out)


def test_the_schema_holds_in_a_workspace(paos, replanned):
    root = replanned.workspace.root
    for command, words in IN_A_WORKSPACE.items():
        validate(command, paos(*words, "-w", root, "--json").out)
    for name in OF_A_JOURNAL:
        validate(f"store {name}", paos("store", name, root, "--json").out)


def test_a_schema_refuses_another_result(paos):
    with pytest.raises(jsonschema.ValidationError):
        validate("lint", paos("list", "skills", "--json").out)


def test_no_command_promises_just_anything():
    assert [
        command for command, _ in iter_commands() if build_result_schema(command).keys() <= {"title", "$defs"}
    ] == []
