"""The live view of a run: the DAG with each session's state, the active leaf, verdicts with their criteria.

Its rows are a fold of the journal and of the heartbeats: on a terminal a table that redraws itself, above it what has
been decided; elsewhere plain lines, one per change.
"""

import sys
from collections.abc import Iterable, Sequence

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text
from typing_extensions import override

from phyagentos.cli.outcome import writing
from phyagentos.operations.progress import Row, RunFold
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import count_criteria

_STYLES = {  # of states and verdicts
    "green": ("succeeded", "done", "success"),
    "red": ("failed", "failure", "rejected", "blocked"),
    "yellow": ("replanned", "replan", "unverified"),
    "magenta": ("cancelled",),
    "bold cyan": ("running",),
    "dim": ("waiting",),
}
PIPE_WIDTH = 160  # characters of a table that no terminal bounds
UNBOUNDED = 4096  # of what is read by programs line by line
INDENT = 4  # columns before a criterion
GAP, TIME = 2, 11  # columns between two of a table, and of a time, `at 1234.5 s`
COLOURS = {Truth.TRUE: "green", Truth.FALSE: "red", Truth.UNKNOWN: "yellow"}


class CleanConsole(Console):
    """A console whose only control sequences are its own: names and reasons of others command no terminal."""

    @override
    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments of what is shown, without unfit characters."""
        for each in super().render(renderable, options):
            yield each if each.control else Segment(clean(each.text), each.style)

    @override
    def _write_buffer(self) -> None:
        with writing(self.file):
            super()._write_buffer()


class RunConsole:
    """Shows a run while it goes on; a context manager. When quiet, it shows nothing."""

    def __init__(self, title: str, *, quiet: bool = False) -> None:
        is_terminal = sys.stderr is not None and sys.stderr.isatty()
        self._console = CleanConsole(stderr=True, quiet=quiet, highlight=False, soft_wrap=not is_terminal)
        redraws = self._console.is_terminal and not quiet
        self._live = Live(console=self._console, auto_refresh=False, transient=True) if redraws else None
        self._title = title
        self._fold: RunFold | None = None
        self._printed: dict[str, str] = {}
        self._notes: set[str] = set()

    def __enter__(self) -> "RunConsole":
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    @property
    def rows(self) -> list[Row]:
        """Those of the fold that was shown last, as it is now."""
        return self._fold.rows() if self._fold is not None else []

    def show(self, fold: RunFold) -> None:
        """Bring the view up to date."""
        self._fold, rows = fold, fold.rows()
        for row in rows:
            self._print_change(row)
        if self._live is not None:
            self._live.start()  # with the first picture: until then notes go to the terminal as they are
            world = Text(fold.describe_world(), "dim", no_wrap=True, overflow="ellipsis")
            self._live.update(Group(build_progress_table(self._title, rows, self._console.width), world), refresh=True)

    def pause(self) -> None:
        """Let the table stand still until it is shown again: a person types."""
        if self._live is not None:
            self._live.stop()

    def print_line(self, text: str, style: str = "") -> None:
        """One line above the table."""
        self._console.print(Text(text, style=style))

    def print_once(self, text: str, style: str = "", *, even_quiet: bool = False) -> None:
        """The same, unless it was printed before."""
        if text not in self._notes:
            self._notes.add(text)
            (Console(stderr=True, soft_wrap=True) if even_quiet else self._console).print(Text(text, style=style))

    def _print_change(self, row: Row) -> None:
        """Print what changed about a row since the last call."""
        if row.session is None or self._printed.get(row.name) == row.state:
            return
        self._printed[row.name] = row.state
        if not row.is_final:
            if self._live is None:
                self.print_line(f"{row.name}: {row.state}")
            return
        self._console.print(
            Text.assemble(f"{row.name}: ", (row.state, choose_style(row, row.state)), f"  {describe(row)}")
        )
        if row.session.decision is not None:
            print_criteria(row.session.decision.criteria, self._console)


def build_progress_table(title: str, rows: list[Row], width: int = PIPE_WIDTH) -> Table:
    """The DAG as an indented table of so many columns; what a row does gives way first, then its name."""
    states = max((len(row.state) for row in rows), default=5)
    room = width - max(states, 5) - 3 * GAP - TIME
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, header_style="dim", padding=(0, GAP, 0, 0)
    )
    table.add_column("session", no_wrap=True, overflow="ellipsis", max_width=room // 2)
    table.add_column("state", no_wrap=True)
    named = [("  " * (row.depth + _is_child(row)) + row.name) for row in rows]
    longest = min(max(map(len, (*named, "session"))), room // 2)
    table.add_column("doing", no_wrap=True, overflow="ellipsis", max_width=max(room - longest, 1))
    table.add_column("time", no_wrap=True, justify="right")
    for row, name in zip(rows, named, strict=True):
        beat = row.beat
        doing = f"{beat.phase} {'/'.join(beat.leaf.split('/')[-2:])}" if beat is not None else summarise(row)
        ran = f"{row.sim_time_s:.1f} s" if row.sim_time_s else ""
        time = f"at {beat.sim_time_s:.1f} s" if beat is not None else ran  # by the clock of its target while it runs
        table.add_row(name, Text(row.state, choose_style(row, row.state)), doing, time)
    return table


def _is_child(row: Row) -> bool:
    return row.session is not None and row.session.contract.parent is not None


def summarise(row: Row) -> str:
    """Why a row stands where it does, on a third of a line."""
    session = row.session
    if session is None:
        return row.reason or (f"after {', '.join(row.after)}" if row.after else "")
    attempt = session.decision
    if attempt is None:
        return describe(row)
    execution = session.execution
    if attempt.verdict is not Verdict.SUCCESS:
        facts = (attempt.cause, execution.code, execution.leaf) if execution is not None else (attempt.cause,)
        return " ".join(dict.fromkeys(filter(None, facts)))
    held = sum(criterion.truth is Truth.TRUE for criterion in attempt.criteria)
    return f"{count_criteria(held, len(attempt.criteria))}{tell_failure(row)}"


def tell_failure(row: Row) -> str:
    """How the execution of a session that is judged a success failed; empty where it did not."""
    execution = row.session.execution if row.session is not None else None
    if row.verdict != Verdict.SUCCESS or execution is None or execution.ended is Ended.COMPLETED:
        return ""
    return f", but the execution failed: {' '.join(filter(None, (execution.ended, execution.code, execution.message)))}"


def choose_style(row: Row, word: str) -> str:
    """The style of its state or verdict: a success that the execution does not share is no plain one."""
    style = next((style for style, words in _STYLES.items() if word in words), "")
    return "yellow" if tell_failure(row) else style


def describe(row: Row) -> str:
    """Why a row stands where it does, in a sentence."""
    if row.session is None:
        return ""
    attempt = row.session.decision
    if attempt is not None:
        return " ".join(part for part in (attempt.cause, attempt.reason) if part) + tell_failure(row)
    execution = row.session.execution
    if row.session.problems:  # the goal's reason, or the report, has the sentences
        return ", ".join(dict.fromkeys(problem.code for problem in row.session.problems))
    return row.session.reason or (f"{execution.ended.value} {execution.code}".strip() if execution is not None else "")


def print_criteria(criteria: Iterable[Criterion], console: Console, said: str = "") -> None:
    """Judged criteria, each once, with the numbers that decided them unless those were said before.

    On a terminal what is broken off is indented, too.
    """
    for truth, text, sentence in dict.fromkeys((each.truth, each.text, each.sentence) for each in criteria):
        why = "" if sentence in said else f"  {sentence}"
        line = Text.assemble((truth.mark, COLOURS[truth]), f" {text}", (why, "dim"))
        if console.is_terminal and line.cell_len + INDENT > console.width:
            console.print(Padding(line, (0, 0, 0, INDENT)))
        else:
            console.print(Text.assemble(" " * INDENT, line))


def build_table(head: Sequence[str], rows: Iterable[Sequence[str | Text]]) -> Table:
    """Aligned columns, folded where the terminal is narrow; texts are shown as they are."""
    table = Table(*head, box=None, pad_edge=False, header_style="dim", show_header=any(head), padding=(0, GAP, 0, 0))
    for column in table.columns:
        column.overflow = "fold"
    for row in rows:
        table.add_row(*(Text(each) if isinstance(each, str) else each for each in row))
    return table
