"""Hand edits of SESSIONS.md while it is rendered a hundred times a second: which way of publishing loses some?

    python benchmarks/edits.py --edits 150

Three editors (one renames a new file over the old, one truncates and writes in place, one moves the old away and writes
a new one) make their edits one after the other, while another process publishes. An edit is merged when the journal has
it, refused when SESSIONS.rejected.md has it, else it is lost. Plain rename never looks; compare-then-rename looks just
before; exchange is what the runtime does.
"""

import argparse
import multiprocessing
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from benchmarks.runner import finish
from phyagentos.bench.report import Ask
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.edits.reading import decode
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.views.history import History
from phyagentos.store.views.sessions import END_MARK

PERIOD_S = 0.01
THINKING_S = 0.06  # longest time between reading and saving
TRIES = 10_000  # at reading a whole file
PAUSE_S = 0.002  # between the pieces of one save
AFTER_S = 0.5  # the publisher goes on for so long after the last edit


def make_session(id: str) -> Session:
    """A contract."""
    return Session(
        id=id, goal="bench", node="n", objective="wave", skill="wave", target="panda", parameters={},
        accept=("upright(a)",), scene=Scene(name="s", seed=0, episode="e"), seed=0,
    )  # fmt: skip


# -- editors -----------------------------------------------------------------------------------------------------------


def save_by_rename(path: Path, text: str) -> None:
    """A new file over the old one, as `sed -i` does."""
    temporary = path.with_name("4913.new")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def save_in_place(path: Path, text: str) -> None:
    """Truncate and write again, in pieces, as nano does."""
    third = len(text) // 3
    with path.open("w", encoding="utf-8") as file:
        for piece in (text[:third], text[third : 2 * third], text[2 * third :]):
            file.write(piece)
            file.flush()
            pause(PAUSE_S)


def save_beside(path: Path, text: str) -> None:
    """Move the old file away as a backup, then write a new one, as vim does with backups on."""
    path.replace(path.with_name(f"{path.name}~"))
    pause(PAUSE_S)
    save_in_place(path, text)


STYLES: dict[str, Callable[[Path, str], None]] = {
    "renames over": save_by_rename,
    "writes in place": save_in_place,
    "moves away, rewrites": save_beside,
}


def pause(seconds: float) -> None:
    """Wait; no clock can be passed to an editor."""
    time.sleep(seconds)  # noqa: TID251 - stands in for a person


def edit(path: Path, number: int, save: Callable[[Path, str], None], chance: random.Random) -> None:
    """One edit: give session `e<number>` the priority `number + 1`."""
    for _ in range(TRIES):
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        before, heading, after = text.partition(f"## e{number:05d}\n")
        if heading and END_MARK in after:
            break
        pause(PAUSE_S)  # an earlier save was half done when it was published over
    else:
        raise SystemExit(f"no session e{number:05d} in {path}")
    pause(chance.uniform(0.0, THINKING_S))
    save(path, before + heading + after.replace("priority: 0\n", f"priority: {number + 1}\n", 1))


# -- publishers --------------------------------------------------------------------------------------------------------


class Publisher:
    """Renders whatever changed; a subclass knows how it reaches the disk."""

    def __init__(self, workspace: Workspace, lane: Path) -> None:
        self.path = workspace.sessions_document
        self.history = History(lane)
        self.edits = EditIntake(workspace, SystemClock())
        self.published = b""

    def turn(self) -> None:
        """Publish once."""
        self.history.read_new()
        self.look()
        text = self.history.render(self.history.build_page())
        publish(self.path, text)
        self.published = text.encode()

    def look(self) -> None:
        """Plain rename does not look."""

    def close(self) -> None:
        """Let go of the journal."""
        self.history.close()
        self.edits.close()


class Comparing(Publisher):
    """Reads the file just before it renames over it."""

    def look(self) -> None:
        """Merge what differs from what was published."""
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:  # an editor has moved it away
            return
        if self.published not in {b"", data}:
            self.edits.take_text(decode(data), self.history, is_whole=END_MARK.encode() in data)


class Exchanging(Publisher):
    """Swaps, and looks at what comes out, as the runtime does."""

    def turn(self) -> None:
        """Publish once."""
        self.history.read_new()
        self.edits.take(self.history)
        self.edits.file.put(self.history.render(self.history.build_page(self.edits.notes)))

    def close(self) -> None:
        """Take in what is left."""
        self.turn()
        self.edits.take(self.history, at_once=True)
        super().close()


PUBLISHERS = {"plain rename": Publisher, "compare, then rename": Comparing, "exchange + merge": Exchanging}


def run_publisher(root: Path, kind: str, ready: Event, stop: Event, rate: "Synchronized[float]") -> None:
    """The publishing process: one change and one rendering a period."""
    workspace, clock = Workspace.open(root), SystemClock()
    agent = Journal(root, side=Side.AGENT, by="agent", clock=clock, durable=False)
    publisher = PUBLISHERS[kind](workspace, agent.folder)
    begin_s, count = time.perf_counter(), 0
    while not stop.is_set():
        id = f"c{os.getpid()}.{count}"
        agent.commit([Entry(id, "submit", msgspec.to_builtins(make_session(id)))])
        agent.commit([Entry(id, "cancel")])
        publisher.turn()
        count += 1
        ready.set()
        pause(max(0.0, begin_s + count * PERIOD_S - time.perf_counter()))
    rate.value = count / (time.perf_counter() - begin_s)
    publisher.close()
    agent.close()


# -- one cell ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """How the edits of one editor fared with one way of publishing."""

    merged: int
    refused: int
    lost: int
    publishes_per_s: float


def measure(kind: str, style: str, edits: int, seed: int, kills: int) -> Cell:
    """All edits of one editor in one workspace, while the publisher is killed now and then."""
    with tempfile.TemporaryDirectory(prefix="edits-") as scratch:
        return measure_in(Path(scratch) / "w", kind, style, edits, seed, kills)


def sum_up(cells: list[Cell]) -> Cell:
    """All rounds together, at the rate of the slowest."""
    return Cell(
        sum(cell.merged for cell in cells),
        sum(cell.refused for cell in cells),
        sum(cell.lost for cell in cells),
        min(cell.publishes_per_s for cell in cells),
    )


def measure_in(root: Path, kind: str, style: str, edits: int, seed: int, kills: int) -> Cell:
    """As `measure`, in a given folder."""
    workspace = Workspace.create(root, Library(()))
    journal = Journal(root, side=Side.AGENT, by="bench", clock=SystemClock(), durable=False)
    names = [f"e{number:05d}" for number in range(edits)]
    journal.commit([Entry(name, "submit", msgspec.to_builtins(make_session(name))) for name in names])
    context = multiprocessing.get_context("spawn")
    ready, stop, rate = context.Event(), context.Event(), context.Value("d", 0.0)

    def start() -> BaseProcess:
        ready.clear()
        process = context.Process(target=run_publisher, args=(root, kind, ready, stop, rate))
        process.start()
        while not ready.wait(1.0):
            check_alive(process)
        return process

    process = start()
    chance = random.Random(seed)
    for number in range(edits):
        if kills and number and number % max(1, edits // (kills + 1)) == 0:
            process.kill()
            process.join()
            process = start()
        check_alive(process)
        edit(workspace.sessions_document, number, STYLES[style], chance)
        pause(chance.uniform(0.0, PERIOD_S))
    pause(AFTER_S)
    stop.set()
    process.join()
    history = History(journal.folder)
    history.read_new()
    path = workspace.rejected_document
    told = path.read_text(encoding="utf-8") if path.exists() else ""
    sessions = history.ledger.sessions
    merged = {n for n, name in enumerate(names) if sessions[name].contract.priority == n + 1}
    refused = {n for n in range(edits) if f"priority: {n + 1}\n" in told} - merged
    history.close()
    journal.close()
    return Cell(len(merged), len(refused), edits - len(merged) - len(refused), rate.value)


def check_alive(process: BaseProcess) -> None:
    """End here when the publisher has died."""
    if not process.is_alive():
        raise SystemExit("the publisher ended before its time")


ASKED = {"exchange_lost": Ask(0, at_least=False), "exchange_renderings_per_s": Ask(50, at_least=True)}


def main() -> int:
    """Run, show, and exit with whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edits", type=int, default=150, help="of each editor")
    parser.add_argument(
        "--rounds", type=int, default=1, help="repetitions, each in a workspace and with a seed of its own"
    )
    parser.add_argument("--kills", type=int, default=0, help="how often the publisher is killed and started again")
    parser.add_argument("--only", choices=PUBLISHERS, help="one way of publishing")
    given = parser.parse_args()
    kinds = [given.only] if given.only else list(PUBLISHERS)
    cells: dict[tuple[str, str], Cell] = {}
    for kind in kinds:
        for style in STYLES:
            rounds = [measure(kind, style, given.edits, seed, given.kills) for seed in range(given.rounds)]
            cells[kind, style] = sum_up(rounds)
    table = Table(title=f"{given.edits * given.rounds} edits of each editor: merged + refused, lost")
    for column in ("publishing", *(f"editor {style}" for style in STYLES), "renderings/s"):
        table.add_column(column)
    for kind in kinds:
        row = [cells[kind, style] for style in STYLES]
        shown = [f"{cell.merged} + {cell.refused}, {cell.lost} lost" for cell in row]
        table.add_row(kind, *shown, f"{min(cell.publishes_per_s for cell in row):.0f}")
    Console().print(table)
    figures = {"edits": float(given.edits * given.rounds * len(STYLES))}
    for kind in kinds:
        name, row = kind.split()[0].rstrip(","), [cells[kind, style] for style in STYLES]
        figures[f"{name}_lost"] = float(sum(cell.lost for cell in row))
        figures[f"{name}_renderings_per_s"] = min(cell.publishes_per_s for cell in row)
    asked = {name: ask for name, ask in ASKED.items() if name in figures}
    return finish(figures, asked)


if __name__ == "__main__":
    sys.exit(main())
