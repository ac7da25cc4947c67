"""The published schema of what a command finds, which every command called in a test is held to."""

import functools
import json
import os

import jsonschema
import msgspec

from phyagentos.cli.results import ANSWERING, build_result_schema

ERROR = {"exit_code", "error", "problems"}


@functools.cache
def load_validator(command: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(build_result_schema(command))


def find_command(words) -> str:
    """The command that is called, with its group; empty where it has no result."""
    known = set(ANSWERING)
    typed = [" ".join([str(word) for word in words if str(word)[:1] != "-"][:count]) for count in (2, 1)]
    return next((each for each in typed if each in known), "")


def check_result(command: str, found: object) -> None:
    """A struct is what the schema of its command says."""
    load_validator(command).validate(json.loads(msgspec.json.encode(found, enc_hook=os.fspath)))


def check_printed(command: str, text: str) -> None:
    """What was printed with `--json` is what the schema says; what follows prints one object a line."""
    for each in text.splitlines() if command in {"logs", "store follow"} else filter(None, [text]):
        if not (isinstance(data := json.loads(each), dict) and data.keys() == ERROR):
            load_validator(command).validate(data)
