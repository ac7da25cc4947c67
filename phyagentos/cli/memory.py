"""Commands about memory: `show`, `why`, `forget` an entry; `promote` one to a skill, and `revoke` that."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.cli.arguments import AsJson
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import print_json, print_note, print_result
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import MARKER, Workspace

if TYPE_CHECKING:
    from phyagentos.agent.memory.episodes import Episode
    from phyagentos.agent.memory.experience_log import Edit
    from phyagentos.agent.memory.memory import Memory
    from phyagentos.protocol.sessions.memory_entries import MemoryEntry

Entry = Annotated[str, typer.Argument(help="Id of a lesson or fact, as LESSONS.md and KNOWLEDGE.md give it.")]


def show(
    workspace: Space,
    words: Annotated[list[str] | None, typer.Argument(help="Kinds of things, causes, scenes; all without any.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Hypotheses, expired and retracted entries too.")] = False,
    as_json: AsJson = False,
) -> None:
    """Lessons in force and what was counted, the most useful first."""
    from phyagentos.protocol.sessions.memory_entries import Standing

    version, entries = recall(workspace, words or ())
    shown = [each for each in entries if everything or each.state is Standing.ACTIVE]
    if as_json:
        print_json({"version": version, "entries": shown})
        return
    for each in shown:
        mark = "" if each.state is Standing.ACTIVE else f" [{each.state}{': ' + each.reason if each.reason else ''}]"
        print_result(f"{each.id}{mark}\n    {each.statement}\n    {each.supported} for, {each.contradicted} against")
    hidden = len(entries) - len(shown)
    more = f"; {hidden} more with --all" if hidden else ""
    print_note(f"{len(shown)} entr{'y' if len(shown) == 1 else 'ies'} of {version}{more}")


def recall(root: Path, words: Sequence[str] = ()) -> "tuple[str, list[MemoryEntry]]":
    """The version of a memory, and its entries about all of these words, the most useful first; all without any."""
    with _opened(root) as memory:
        entries: list[MemoryEntry] = [*memory.experience.list_lessons(), *memory.experience.list_facts()]
        if words:
            found = {lesson.id for lesson in memory.search(" ".join(words))}
            texts = {each.id: f"{each.id} {each.statement}".lower() for each in entries}
            found |= {id for id, text in texts.items() if all(word.lower() in text for word in words)}
            entries = [each for each in entries if each.id in found]
        return memory.version, entries


def why(entry: Entry, workspace: Space, as_json: AsJson = False) -> None:
    """Where an entry comes from: failures, corrections and their verdicts, and the edits by people."""
    with _opened(workspace) as memory:
        found = _find(memory, entry, workspace)
        episodes, edits = _trace(memory, entry)
        if as_json:
            print_json({"entry": found, "episodes": episodes, "edits": edits})
            return
        lines = [f"{found.id}: {found.state}", f"  says        {found.statement}"]
        lines += [f"  because     {found.reason}"] if found.reason else []
        lines += [
            f"  counts      {found.supported} for, {found.contradicted} against, at least {found.confidence:.0%} sure"
        ]
        lines += [f"  baseline    {baseline} without it"] if (baseline := getattr(found, "baseline", "")) else []
        for each in episodes:
            advised = ", advised by it" if each.advised_by else ""
            lines += [
                f"  episode     {each.session}: {' '.join(filter(None, (each.verdict.value, each.cause)))}",
                f"              {each.objective} {each.strategy or 'the own way of the skill'}{advised}",
                f"              {each.evidence}",
            ]
        for edit in edits:
            said = " ".join(filter(None, ("retracted." if edit.retracts else "", edit.reason, edit.note)))
            lines.append(f"  said        {edit.by or 'unknown'}: {said or 'where it holds was changed'}")
        print_result("\n".join(lines))


def forget(
    entry: Entry,
    workspace: Space,
    reason: Annotated[str, typer.Option("--reason", "-r", help="Why it shall not count any more.")],
    as_json: AsJson = False,
) -> None:
    """Retract an entry: it is kept with the reason, and used no more."""
    import getpass

    from phyagentos.agent.memory.experience_log import Edit

    with _opened(workspace) as memory:
        _find(memory, entry, workspace)
        memory.record([Edit(entry=entry, retracts=True, reason=reason, by=getpass.getuser())])
        if as_json:
            print_json({"entry": _find(memory, entry, workspace), "version": memory.version})
        else:
            print_result(f"{entry}: retracted; {memory.version} does without it")


def promote(
    entry: Entry,
    workspace: Space,
    name: Annotated[str, typer.Option(help="Of the skill and its tree.")],
    into: Annotated[Path, typer.Option(help="Project that gets skills/NAME and trees/NAME.yaml.", file_okay=False)],
    trials: Annotated[int, typer.Option(help="Known starts that it must succeed on first.", min=1)] = 3,
) -> None:
    """Make a skill of a sequence of sessions that has proved itself; nothing is written unless it passes again."""
    from phyagentos.assembly import learned_skills
    from phyagentos.operations.lint import lint_file

    with _opened(workspace) as memory:
        _find(memory, entry, workspace)
        lesson = memory.experience.corrections.get(entry)
        if lesson is None:
            raise DefinitionError.of("NOT_PROMOTED", str(workspace), entry, "a lesson about what has to come first")
        opened = Workspace.open(workspace)
        files = learned_skills.promote(memory, lesson, opened, into, name, trials=trials, lint=lint_file)
    print_result(f"{name}: success on {trials} known starts; wrote {', '.join(map(str, files))}")


def revoke(
    name: Annotated[str, typer.Argument(help="A skill that `paos memory promote` wrote.")],
    from_: Annotated[Path, typer.Option("--from", help="Project folder that holds it.", file_okay=False)],
) -> None:
    """Take a promoted skill and its tree out of a project; its lesson stays as it is."""
    from phyagentos.assembly.learned_skills import revoke as take_out

    entry = take_out(from_, name).entry
    print_result(f"{name}: taken out; its lesson {entry} still advises, until `paos memory forget`")


@contextmanager
def _opened(root: Path) -> "Iterator[Memory]":
    from phyagentos.agent.memory.memory import Memory
    from phyagentos.assembly.memory_choice import read_choice

    folder = root / "memory"
    if not folder.is_dir() or (root / MARKER).exists():
        workspace = Workspace.open(root)
        chosen = read_choice(workspace)
        folder = chosen.folder / folder.name if chosen is not None and chosen.folder else workspace.memory
    with closing(Memory(folder, clock=SystemClock(), by="paos memory", side=Side.OPERATOR)) as memory:
        yield memory


def _find(memory: "Memory", entry: str, root: Path) -> "MemoryEntry":
    """The entry as it is recorded; raises `UNKNOWN_ENTRY`."""
    experience = memory.experience
    if (found := experience.find(entry)) is not None:
        return found
    known = [*experience.corrections, *experience.cautions, *experience.patterns, *experience.facts]
    expected = format_names(known[:20]) if known else "nothing is remembered yet"
    raise DefinitionError.of("UNKNOWN_ENTRY", str(root), repr(entry), expected, format_hint(entry, known))


def _trace(memory: "Memory", entry: str) -> "tuple[list[Episode], list[Edit]]":
    """The episodes that an entry rests on, oldest first, and the edits of it."""
    from phyagentos.agent.memory.episodes import Episode
    from phyagentos.agent.memory.semantic import find_pattern_id

    lesson = memory.experience.corrections.get(entry)
    named = {session for chain in (lesson.chains if lesson else ()) for session in (chain.failed, chain.corrected)}
    named.update(caution.sessions if (caution := memory.experience.cautions.get(entry)) is not None else ())
    episodes: list[Episode] = []
    edits: list[Edit] = []
    for event in memory.read_all():
        if not isinstance(event, Episode):
            edits += [event] if event.entry == entry else []
        elif event.session in named or entry in event.advised_by or find_pattern_id(event) == entry:
            episodes.append(event)
    return episodes, edits
