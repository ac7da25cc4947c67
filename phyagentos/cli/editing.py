"""`paos edit`: SESSIONS.md in an editor, without concurrent rendering."""

import os
import shlex
import subprocess
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.outcome import Exit, ExitCode, print_note, print_result
from phyagentos.clock import SystemClock
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.edits.merge import Merge
from phyagentos.store.edits.reading import decode
from phyagentos.store.edits.rejections import format_refusal
from phyagentos.store.journal import choose_partition
from phyagentos.store.views.history import History

DEFAULT_EDITOR = "vi"


def edit(
    workspace: Annotated[Path, typer.Argument(help="Folder of the run.")] = Path(),
    editor: Annotated[str, typer.Option(help="Command that edits a file; $VISUAL, $EDITOR or vi by default.")] = "",
) -> int:
    """Edit SESSIONS.md, with or without a runtime: limits and priority of pending sessions, ends, new sessions."""
    place = Workspace.open(workspace)
    partition = place.sessions / choose_partition(place.sessions)
    partition.mkdir(parents=True, exist_ok=True)
    with closing(EditIntake(place, SystemClock(), adopts=False)) as edits, closing(History(partition)) as history:
        merged = _edit_copy(edits, history, place.sessions_document.name, _choose_editor(editor))
        _publish(edits, history)
    return _report(merged, place.sessions_document.name, place.rejected_document)


def _edit_copy(edits: EditIntake, history: History, name: str, command: list[str]) -> Merge:
    """Let a person change a fresh rendering; the file is not replaced meanwhile."""
    with edits.file.hold(wait=False) as is_free:
        if not is_free:
            print_note(f"{name} is being edited or rendered elsewhere; waiting")
    with edits.file.hold(wait=True), tempfile.TemporaryDirectory(prefix="paos-edit-") as scratch:
        history.read_new()
        copy = Path(scratch) / name
        copy.write_text(history.render(history.build_page()), encoding="utf-8")
        try:
            code = subprocess.run([*command, str(copy)], check=False).returncode
        except OSError as error:
            raise Exit(ExitCode.INVALID_INPUT, f"{command[0]}: {error.strerror}. Name an editor: --editor") from error
        if code != 0:
            raise Exit(ExitCode.INVALID_INPUT, f"{command[0]} ended with {code}; nothing was changed")
        try:
            text = decode(copy.read_bytes())
        except OSError as error:
            why = f"the editor left no file: {error.strerror}; nothing was changed"
            raise Exit(ExitCode.INVALID_INPUT, why) from error
        return edits.take_text(text, history)


def _publish(edits: EditIntake, history: History) -> None:
    """Show the result, where no runtime does; what came out may be an edit that was saved without `paos edit`."""
    for _ in range(2):
        edits.file.put(history.render(history.build_page(edits.notes)))
        if not any(merged.accepted or merged.refused for merged in edits.take_file(history, at_once=True)):
            return


def _report(merged: Merge, name: str, rejected: Path) -> ExitCode:
    for change in merged.accepted:
        print_result(f"{name}:{change.line}: {change.summary}")
    for refusal in merged.refused:
        print_note(format_refusal(refusal, name))
    if merged.refused:
        print_note(f"{len(merged.refused)} refused; every word of it is in {rejected}")
        return ExitCode.INVALID_INPUT
    if not merged.accepted:
        print_note("nothing was changed")
    return ExitCode.GOAL_MET


def _choose_editor(given: str) -> list[str]:
    text = given or os.environ.get("VISUAL") or os.environ.get("EDITOR") or DEFAULT_EDITOR
    try:
        command = shlex.split(text)
    except ValueError as error:
        raise Exit(ExitCode.INVALID_INPUT, f"--editor {text!r}: {error}") from error
    if not command:
        raise Exit(ExitCode.INVALID_INPUT, "--editor is empty; name a command")
    return command
