"""`paos edit`: SESSIONS.md in an editor, without concurrent rendering."""

import os
import shlex
import subprocess
from contextlib import closing
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from phyagentos.cli.outcome import Exit, ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.clock import SystemClock
from phyagentos.protocol.documents.body_codec import render_flow
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.scratch import open_scratch
from phyagentos.store.edits.edit_intake import EditIntake, Outcome, edit_by_hand
from phyagentos.store.journal import choose_partition
from phyagentos.store.shared_file import decode
from phyagentos.store.views.page_history import History

DEFAULT_EDITOR = "vi"


class Edited(msgspec.Struct, frozen=True, kw_only=True):
    """What was recorded of an edit, and what was refused, every word of which is in `rejected`."""

    recorded: tuple[str, ...]
    refused: tuple[str, ...]
    rejected: Path | None = None


def edit(
    workspace: Annotated[Path, typer.Argument(help="Folder of the run.")] = Path(),
    editor: Annotated[str, typer.Option(help="Command that edits a file; $VISUAL, $EDITOR or vi by default.")] = "",
) -> Reply[Edited]:
    """Edit SESSIONS.md, with or without a runtime: limits and priority of pending sessions, ends, new sessions."""
    place = Workspace.open(workspace)
    name, command = place.sessions_document.name, _choose_editor(editor)
    partition = place.sessions / choose_partition(place.sessions)
    partition.mkdir(parents=True, exist_ok=True)

    def change(text: str) -> str:
        with open_scratch("paos-edit") as scratch:
            return _run_editor(command, scratch / name, text)

    def note_wait() -> None:
        print_note(f"{name} is being edited or rendered elsewhere; waiting")

    with closing(EditIntake(place, SystemClock(), adopts=False)) as edits, closing(History(partition)) as history:
        return _report(edit_by_hand(edits, history, change, on_wait=note_wait), name, place.rejected_document)


def _run_editor(command: list[str], copy: Path, text: str) -> str:
    """The text as a person left it."""
    copy.write_text(text, encoding="utf-8")
    try:
        code = subprocess.run([*command, str(copy)], check=False).returncode
    except OSError as error:
        raise Exit(ExitCode.INVALID_INPUT, f"{command[0]}: {error.strerror}. Name an editor: --editor") from error
    if code != 0:
        raise Exit(ExitCode.INVALID_INPUT, f"{command[0]} ended with {code}; nothing was changed")
    try:
        return decode(copy.read_bytes())
    except OSError as error:
        why = f"the editor left no file: {error.strerror}; nothing was changed"
        raise Exit(ExitCode.INVALID_INPUT, why) from error


def _report(outcome: Outcome, name: str, rejected: Path) -> Reply[Edited]:
    bodies = [f" {render_flow(entry.body)}" if entry.ev == "amend" else "" for entry in outcome.recorded]
    recorded = tuple(f"{entry.id}: {entry.ev}{body}" for entry, body in zip(outcome.recorded, bodies, strict=True))
    refused = tuple(f"{name}:{refusal}" for refusal in outcome.refused)
    found = Edited(recorded=recorded, refused=refused, rejected=rejected if refused else None)
    if refused:
        notes = [*refused, f"{len(refused)} refused; every word of it is in {rejected}"]
        return Reply(found, "\n".join(recorded), notes, ExitCode.INVALID_INPUT)
    return Reply(found, "\n".join(recorded), [] if recorded else ["nothing was changed"])


def _choose_editor(given: str) -> list[str]:
    text = given or os.environ.get("VISUAL") or os.environ.get("EDITOR") or DEFAULT_EDITOR
    try:
        command = shlex.split(text)
    except ValueError as error:
        raise Exit(ExitCode.INVALID_INPUT, f"--editor {text!r}: {error}") from error
    if not command:
        raise Exit(ExitCode.INVALID_INPUT, "--editor is empty; name a command")
    return command
