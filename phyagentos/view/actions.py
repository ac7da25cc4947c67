"""What a page may do: the emergency stop at once, everything else by the command of the CLI, whose answer is shown."""

import getpass
import hashlib
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.sessions import estop
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.inbox import read_request

WAIT_S = 60.0  # for the answer of a command that only writes a record
GRAPH_MAX = 1 << 18  # bytes
STOP = "estop"
OTHERS = (STOP, "reset", "amend", "lint", "submit")  # that are not one command with the fields of the form


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """One action by a command.

    Attributes:
        command: Its words; `{field}` is a field of the form.
        needs: Fields that may not be empty.
        is_long: Whether it moves a robot to a verdict: it goes on when the page ends, and its output is a log.
    """

    command: tuple[str, ...]
    needs: tuple[str, ...]
    is_long: bool = False


ACTIONS = {
    "cancel": Action(command=("cancel", "{session}", "--reason={reason}"), needs=("session",)),
    "pause": Action(command=("pause", "{session}", "--reason={reason}"), needs=("session",)),
    "resume": Action(command=("resume", "{session}"), needs=("session",)),
    "approve": Action(command=("approve", "{proposal}", "--yes"), needs=("proposal",), is_long=True),
    "deny": Action(command=("deny", "{proposal}", "--reason={reason}"), needs=("proposal", "reason")),
    "retract": Action(command=("memory", "forget", "{entry}", "--reason={reason}"), needs=("entry", "reason")),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """What came of an action: the command that does the same, and what it said."""

    command: str
    output: str
    is_met: bool = True


def perform(workspace: Workspace, name: str, form: Mapping[str, str]) -> Done:
    """Carry out one action.

    Raises:
        DefinitionError: `UNKNOWN_NAME`; `MISSING_PARAMETER` for an empty field; what an amendment or a graph lacks.
    """
    match name:
        case "estop":
            return _stop(workspace, form)
        case "reset":
            _require(name, form, ("reason",))
            kept = estop.reset(workspace.signals.parent, clean(form["reason"]), SystemClock())
            return Done(command=f"paos estop --reset --reason … -w {workspace.root}", output=f"reset; kept in {kept}")
        case "amend":
            _require(name, form, ("session",))
            return _amend(workspace, form)
        case "lint" | "submit":
            _require(name, form, ("graph",))
            return _submit(workspace, form["graph"], runs=name == "submit")
    if name not in ACTIONS:
        raise DefinitionError.unknown("UNKNOWN_NAME", "actions", name, (*ACTIONS, *OTHERS))
    action = ACTIONS[name]
    _require(name, form, action.needs)
    fields = {"reason": "", **{key: clean(value) for key, value in form.items()}}
    words = [word.format_map(fields) for word in action.command]
    return _run(workspace, words, log=f"view-{name}" if action.is_long else "")


def _stop(workspace: Workspace, form: Mapping[str, str]) -> Done:
    reason = clean(form.get("reason", "")) or "pressed on the page"
    wanted = estop.Latch(by=f"page, {getpass.getuser()}", reason=reason, at=SystemClock().wall_iso())
    estop.latch(workspace.signals.parent, wanted)
    return Done(command=f"paos estop -w {workspace.root}", output=f"latched: {workspace.signals.parent / estop.LATCH}")


def _amend(workspace: Workspace, form: Mapping[str, str]) -> Done:
    """A request for other limits or priority of a session that is pending, as any writer may drop one."""
    limits = {name: _read_number(name, form[name]) for name in ("timeout_s", "stall_s") if form.get(name)}
    asked: dict[str, Any] = {"kind": "amend", "session": clean(form["session"])}
    if limits:
        asked["limits"] = limits
    if form.get("priority"):
        asked["priority"] = _read_number("priority", form["priority"], int)
    data = yaml.safe_dump(asked, sort_keys=False).encode()
    temporary = workspace.inbox / "tmp" / f"view-{hashlib.sha256(data).hexdigest()[:12]}-{os.getpid()}.yaml"
    temporary.write_bytes(data)
    try:
        read_request(temporary)
    except DefinitionError:
        temporary.unlink()
        raise
    place = temporary.replace(workspace.inbox / "new" / temporary.name)
    return Done(command=f"paos edit {workspace.root}", output=f"asked: {place}; SESSIONS.md shows what became of it")


def _read_number(name: str, text: str, kind: type[float] = float) -> float:
    try:
        return kind(text)
    except ValueError as error:
        raise DefinitionError.of("INVALID_VALUE", name, text, "a number") from error


def _submit(workspace: Workspace, graph: str, *, runs: bool) -> Done:
    """Lint a goal graph, and submit it if it is sound: to the runtime that is there, or with both planes."""
    if len(graph.encode()) > GRAPH_MAX:
        raise DefinitionError.of("TOO_LARGE", "graph", f"{len(graph.encode())} bytes", f"at most {GRAPH_MAX}")
    folder = workspace.cache / "view" / "goal_graphs"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"graph_{hashlib.sha256(graph.encode()).hexdigest()[:8]}.yaml"
    publish(path, graph.replace("\r\n", "\n"))
    checked = _run(workspace, ["lint", str(path)], names_workspace=False)
    if not (checked.is_met and runs):
        return checked
    command = "agent" if is_held(workspace.root / WATCHDOG_LOCK) else "run"
    return _run(workspace, [command, str(path)], log="view-submit")


def _run(workspace: Workspace, words: list[str], *, log: str = "", names_workspace: bool = True) -> Done:
    words += ["-w", str(workspace.root)] if names_workspace else []
    shown = " ".join(["paos", *words])
    command = [sys.executable, "-m", "phyagentos", *words]
    if log:
        with (workspace.logs / f"{log}.log").open("ab") as file:
            subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, start_new_session=True)
        return Done(command=shown, output=f"begun; what it says is in logs/{log}.log")
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=WAIT_S, check=False
    )
    return Done(command=shown, output=f"{done.stdout}{done.stderr}".strip(), is_met=done.returncode == 0)


def _require(name: str, form: Mapping[str, str], fields: tuple[str, ...]) -> None:
    for field in fields:
        if not form.get(field, "").strip():
            raise DefinitionError.of("MISSING_PARAMETER", name, "nothing", field)
        if form[field].startswith("-") and field != "graph":  # no option of a command
            raise DefinitionError.of(
                "INVALID_PARAMETER", f"{name}.{field}", form[field], "a text that begins otherwise"
            )
