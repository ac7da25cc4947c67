"""Commands about memory: `show`, `why`, `forget` an entry; `promote` one to a skill, and `revoke` that."""

import getpass
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.explaining import Space
from phyagentos.cli.reply import Reply
from phyagentos.operations import promote as promotion
from phyagentos.operations import recall
from phyagentos.operations.promote import Promoted, Revoked
from phyagentos.operations.recall import Forgotten, Memories, Provenance
from phyagentos.protocol.sessions.memory_entries import EntryState, MemoryEntry

Entry = Annotated[str, typer.Argument(help="Id of a lesson or fact, as LESSONS.md and KNOWLEDGE.md give it.")]


def show(
    workspace: Space,
    words: Annotated[
        list[str] | None, typer.Argument(help="Kinds of objects, causes, scenes; all without any.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Hypotheses, expired and retracted entries too.")] = False,
) -> Reply[Memories]:
    """Lessons in force and what was counted, the most useful first."""
    found = recall.recall(workspace, words or (), everything=everything)
    count, more = len(found.entries), f"; {found.hidden} more with --all" if found.hidden else ""
    note = f"{count} entr{'y' if count == 1 else 'ies'} of {found.version}{more}"
    return Reply(found, "\n".join(map(_describe, found.entries)), [note])


def why(entry: Entry, workspace: Space) -> Reply[Provenance]:
    """Where an entry comes from: failures, corrections and their verdicts, and the edits by people."""
    found = recall.trace_entry(workspace, entry)
    return Reply(found, "\n".join(_explain(found)))


def forget(
    entry: Entry,
    workspace: Space,
    reason: Annotated[str, typer.Option("--reason", "-r", help="Why it shall not count any more.")],
) -> Reply[Forgotten]:
    """Retract an entry: it is kept with the reason, and used no more."""
    found = recall.forget(workspace, entry, reason=reason, by=getpass.getuser())
    return Reply(found, f"{entry}: retracted; {found.version} does without it")


def promote(
    entry: Entry,
    workspace: Space,
    name: Annotated[str, typer.Option(help="Of the skill and its tree.")],
    into: Annotated[Path, typer.Option(help="Project that gets skills/NAME and trees/NAME.yaml.", file_okay=False)],
    trials: Annotated[int, typer.Option(help="Known starts that it must succeed on first.", min=1)] = 3,
) -> Reply[Promoted]:
    """Make a skill of a sequence of sessions that has proved itself; nothing is written unless it passes again."""
    found = promotion.promote(workspace, entry, into, name, trials=trials)
    return Reply(found, f"{name}: success on {trials} known starts; wrote {', '.join(map(str, found.files))}")


def revoke(
    name: Annotated[str, typer.Argument(help="A skill that `paos memory promote` wrote.")],
    from_: Annotated[Path, typer.Option("--from", help="Project folder that holds it.", file_okay=False)],
) -> Reply[Revoked]:
    """Take a promoted skill and its tree out of a project; its lesson stays as it is."""
    found = promotion.revoke(from_, name)
    return Reply(found, f"{name}: taken out; its lesson {found.entry} still advises, until `paos memory forget`")


def _describe(each: MemoryEntry) -> str:
    mark = "" if each.state is EntryState.ACTIVE else f" [{each.state}{': ' + each.reason if each.reason else ''}]"
    return f"{each.id}{mark}\n    {each.statement}\n    {each.supported} for, {each.contradicted} against"


def _explain(found: Provenance) -> Iterator[str]:
    entry = found.entry
    yield f"{entry.id}: {entry.state}\n  says        {entry.statement}"
    if entry.reason:
        yield f"  because     {entry.reason}"
    sure = f"at least {entry.confidence:.0%} sure"
    yield f"  counts      {entry.supported} for, {entry.contradicted} against, {sure}"
    if found.baseline:
        yield f"  baseline    {found.baseline} without it"
    for each in found.episodes:
        advised = ", advised by it" if each.advised_by else ""
        yield f"  episode     {each.session}: {' '.join(filter(None, (each.verdict.value, each.cause)))}"
        yield f"              {each.objective} {each.strategy or 'the default strategy of the skill'}{advised}"
        yield f"              {each.evidence}"
    for edit in found.edits:
        said = " ".join(filter(None, ("retracted." if edit.retracts else "", edit.reason, edit.note)))
        yield f"  said        {edit.by or 'unknown'}: {said or 'where it holds was changed'}"
