"""Sessions to store: a contract of some 650 bytes, and its eight records from submission to verdict."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Execution, Scene, Session
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.segments import SystemIO

LANE = "bench"
CLOCK = SystemClock()
BATCH = 250  # sessions that are stored together where only their number matters
_CONTRACT = Session(
    id="",
    goal="",
    node="red",
    objective="Put the red cube into the red tray",
    skill="pick_and_place",
    target="panda",
    parameters={"object": "red_cube", "destination": "red_tray", "place_site": [0.41, -0.2, 0.03]},
    accept=("inside(red_cube, red_tray)", "not moved(blue_cube)"),
    requires=("visible(red_cube)",),
    hold=("upright(bottle)",),
    scene=Scene(name="tabletop/cubes_and_trays", seed=7, episode="tidy-7"),
    seed=7,
)
_PLAN = {"plan": {"bridges": ["joint_velocity"], "rate_hz": 50.0}, "tools": ["move_joints", "grip"]}
_EXECUTION = Execution(
    ended=Ended.COMPLETED, evidence="evidence/s", outputs={"place_site": [0.1, 0.2, 0.3]}, sim_time_s=7.25, ticks=362
)
_ATTEMPT = Attempt(
    verdict=Verdict.SUCCESS,
    criteria=(
        Criterion(
            text="inside(red_cube, red_tray)",
            kind="accept",
            truth=Truth.TRUE,
            measured={"distance_m": 0.012},
            evidence="environment_after.json",
            at_s=7.3,
        ),
    ),
    reason="every criterion is true",
)


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder on the disk of the working directory: the temporary one may be held in memory."""
    with tempfile.TemporaryDirectory(prefix=".bench-store-", dir=Path.cwd()) as folder:
        yield Path(folder)


def open_pair(root: Path, *, durable: bool, file_io: SystemIO | None = None) -> tuple[Journal, Journal]:
    """The agent's journal and the runtime's."""
    sides = ((Side.AGENT, "agent"), (Side.RUNTIME, "watchdog"))
    agent, runtime = (
        Journal(root, side=side, by=by, clock=CLOCK, durable=durable, partition=LANE, file_io=file_io)
        for side, by in sides
    )
    return agent, runtime


def submit(id: str) -> Entry:
    """The first record."""
    return Entry(id, "submit", msgspec.to_builtins(msgspec.structs.replace(_CONTRACT, id=id)))


def claim(id: str) -> Entry:
    """The second."""
    return Entry(id, "claim")


def start(id: str) -> list[Entry]:
    """The third and the fourth."""
    return [Entry(id, "check", epoch=1), Entry(id, "start", _PLAN, 1)]


def finish(id: str) -> list[Entry]:
    """The fifth and the sixth."""
    return [Entry(id, "halt", epoch=1), Entry(id, "finish", {"execution": _EXECUTION}, 1)]


def verdict(id: str) -> list[Entry]:
    """The seventh and the eighth."""
    return [Entry(id, "verify", None, 1), Entry(id, "accept", {"attempt": _ATTEMPT}, 1)]


def prepare_life(agent: Journal, runtime: Journal, id: str) -> list[tuple[Journal, list[Entry], bool]]:
    """One session as the two planes record it: eight records, four commits, three of them durable.

    The watchdog records claim and check together with the start that it leads to (see `runtime.supervision.watchdog`).
    """
    return [
        (agent, [submit(id)], True),
        (runtime, [claim(id), *start(id)], True),
        (runtime, finish(id), False),
        (agent, verdict(id), True),
    ]


def store_many(root: Path, count: int, *, name: str = "s") -> None:
    """Whole lives of many sessions, in batches; a checkpoint stands behind the last one."""
    agent, runtime = open_pair(root, durable=False)
    ledger = runtime.open_ledger()
    for first in range(0, count, BATCH):
        ids = [f"{name}{number}" for number in range(first, min(first + BATCH, count))]
        agent.commit([submit(id) for id in ids])
        runtime.commit([claim(id) for id in ids])
        for step in (start, finish):
            runtime.commit([entry for id in ids for entry in step(id)])
        agent.commit([entry for id in ids for entry in verdict(id)])
        for record in runtime.read_new():
            ledger.apply(record)
    runtime.close()
    agent.close()
