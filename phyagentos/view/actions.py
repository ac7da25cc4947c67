"""What a page may do: the use cases behind commands of the CLI, each with the fields of a form."""

import getpass
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from phyagentos.assembly.project import admit_python
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, get_known
from phyagentos.operations import answer, recall, stop
from phyagentos.operations.approve import as_file, deny
from phyagentos.operations.lint import lint_file
from phyagentos.operations.request_change import request_change
from phyagentos.operations.submit import submit_graph, submit_proposal
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.workspace.workspace import Workspace

GRAPH_MAX = 1 << 18  # bytes
STOP = "estop"
Form = Mapping[str, str]
_NumberT = TypeVar("_NumberT", int, float)
_NUMBERS: dict[type, str] = {int: "a whole number", float: "a number"}


@dataclass(frozen=True, slots=True)
class Action:
    """One action.

    Attributes:
        command: Words of the command that does the same; `{field}` is a field of the form.
        needs: Fields that may not be empty.
        act: What is done in the workspace at a path, with a form of clean texts; its result is shown.
        said: What came of it, in a sentence; with fields likewise.
    """

    command: str
    needs: tuple[str, ...]
    act: Callable[[Path, Form], object]
    said: str


@dataclass(frozen=True, slots=True)
class Done:
    """What came of an action: a sentence, the command that does the same, and the result of its use case."""

    said: str
    command: str
    result: object


def perform(workspace: Workspace, name: str, form: Form) -> Done:
    """Carry out one action.

    Raises:
        DefinitionError: `UNKNOWN_NAME`; `MISSING_VALUE` for an empty field; whatever its use case finds wrong.
        ExecutionError: As its use case does.
    """
    action = get_known("action", "actions", name, ACTIONS)
    if missing := [field for field in action.needs if not form.get(field, "").strip()]:
        raise DefinitionError.of("MISSING_VALUE", name, "nothing", ", ".join(missing))
    fields = {"reason": "", **{key: clean(value) for key, value in form.items()}}
    result = action.act(workspace.root, fields)
    command = f"paos {action.command.format_map(fields)} -w {workspace.root}"
    return Done(action.said.format_map(fields), command, result)


def _estop(root: Path, form: Form) -> object:
    return stop.estop(root, reason=form["reason"] or "pressed on the page", by=f"page, {getpass.getuser()}")


def _change(root: Path, form: Form) -> object:
    limits = {name: _read_number(name, form[name], float) for name in ("timeout_s", "stall_s") if form.get(name)}
    priority = _read_number("priority", form["priority"], int) if form.get("priority") else None
    return request_change(root, form["session"], limits=limits, priority=priority)


def _answer(root: Path, form: Form) -> object:
    number = _read_number("question", form["question"], int)
    return answer.answer(root, form["subject"], form["says"], by=getpass.getuser(), question=number)


def _read_number(name: str, text: str, kind: type[_NumberT]) -> _NumberT:
    try:
        return kind(text)
    except ValueError as error:
        raise DefinitionError.of("INVALID_VALUE", name, text[:100], _NUMBERS[kind]) from error


def _lint(root: Path, form: Form) -> object:
    """Raises DefinitionError with every problem of a goal graph."""
    if (size := len(form["graph"].encode())) > GRAPH_MAX:
        raise DefinitionError.of("TOO_LARGE", "graph", f"{size} bytes", f"at most {GRAPH_MAX}")
    admit_python(root, is_trusted=False)
    with as_file(form["graph"]) as file:
        if problems := lint_file(file, library=Workspace(root).library()):
            raise DefinitionError(problems)
    return {"problems": []}


def _submit(root: Path, form: Form) -> object:
    _lint(root, form)
    return submit_graph(root, form["graph"], SystemClock())


ACTIONS = {
    STOP: Action("estop", (), _estop, "The emergency stop is latched: every target halts."),
    "reset": Action(
        "estop --reset --reason='{reason}'",
        ("reason",),
        lambda root, form: stop.reset_estop(root, reason=form["reason"]),
        "The emergency stop is reset.",
    ),
    "cancel": Action(
        "cancel {session} --reason='{reason}'",
        ("session",),
        lambda root, form: stop.cancel(form["session"], root, reason=form["reason"]),
        "{session} is being cancelled.",
    ),
    "pause": Action(
        "pause {session} --reason='{reason}'",
        ("session",),
        lambda root, form: stop.pause(form["session"], root, reason=form["reason"]),
        "{session} will rest at the end of its present motion.",
    ),
    "resume": Action(
        "resume {session}",
        ("session",),
        lambda root, form: stop.resume(form["session"], root),
        "{session} goes on.",
    ),
    "approve": Action(
        "approve {proposal} --yes",
        ("proposal", "sha256"),
        lambda root, form: submit_proposal(root, form["proposal"], form["sha256"], SystemClock(), by=getpass.getuser()),
        "{proposal} is approved and runs.",
    ),
    "deny": Action(
        "deny {proposal} --reason='{reason}'",
        ("proposal", "reason"),
        lambda root, form: deny(root, form["proposal"], by=getpass.getuser(), reason=form["reason"]),
        "{proposal} is refused.",
    ),
    "answer": Action(
        "answer {subject} {says} --question {question}",
        ("subject", "says", "question"),
        _answer,
        "Your answer is recorded: {says}.",
    ),
    "contest": Action(
        "contest {session} --because '{because}'",
        ("session", "because"),
        lambda root, form: answer.contest(root, form["session"], because=form["because"], by=getpass.getuser()),
        "What you say of {session} is recorded beside its verdict.",
    ),
    "retract": Action(
        "memory forget {entry} --reason='{reason}'",
        ("entry", "reason"),
        lambda root, form: recall.forget(root, form["entry"], reason=form["reason"], by=getpass.getuser()),
        "{entry} counts no longer.",
    ),
    "amend": Action("edit", ("session",), _change, "{session} is changed."),
    "lint": Action("lint GRAPH", ("graph",), _lint, "No problem was found."),
    "submit": Action("run GRAPH", ("graph",), _submit, "The goal is submitted."),
}
