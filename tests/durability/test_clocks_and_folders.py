"""Clocks that jump, a queue of events that overflows, folders and files that are moved away under an open journal."""

import re
import shutil
from pathlib import Path

import pytest

import phyagentos
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.watch import Watch
from phyagentos.testing import ManualClock

from . import second_reader
from .workloads import DAY_S, LANE, NOON_S, identify, make_submit

pytestmark = pytest.mark.slow

PACKAGE = Path(phyagentos.__file__).parent
HOUR_S = 3600.0
MIDNIGHT_S = 12 * DAY_S
LEAP_DAY_S = 18_321 * DAY_S  # 2020-02-29
JUMPS_S = {
    "an hour ahead": (0.0, HOUR_S, 0.0),
    "an hour back": (0.0, -HOUR_S, 0.0),
    "back over midnight": (MIDNIGHT_S - NOON_S + 60.0, -120.0, 240.0, -HOUR_S),
    "back by a month, then on": (0.0, -31 * DAY_S, 32 * DAY_S),
    "into a leap day and out": (LEAP_DAY_S - NOON_S, DAY_S, -DAY_S),
}


def open_two(root, clock):
    options = {"partition": LANE, "clock": clock, "durable": False}
    agent = Journal(root, side=Side.AGENT, by="agent", **options)
    return agent, Journal(root, side=Side.RUNTIME, by="runtime", **options)


def check_order(root, told):
    """Both readers find what was told, in the order in which it was told, and segments sort as they were written."""
    follower = Follower(root / "sessions" / LANE)
    assert [identify(record) for record in follower.read_new()] == told
    follower.close()
    assert [second_reader.identify(record) for record in second_reader.read_lane(root, LANE)] == told
    assert [seq for seq, *_ in told] == list(range(1, len(told) + 1))


@pytest.mark.parametrize("jumps", JUMPS_S.values(), ids=JUMPS_S)
def test_a_wall_clock_that_jumps_changes_neither_order_nor_epochs(memory, scale, figures, jumps):
    clock = ManualClock(NOON_S)
    agent, runtime = open_two(memory, clock)
    told, number = [], 0
    for _ in range(scale(5, 100)):
        for jump_s in jumps:
            clock.advance(jump_s)
            told += agent.commit([make_submit(f"s{number}")]) + runtime.commit([Entry(f"s{number}", "claim")])
            assert told[-1].epoch == 1
            number += 1
        clock.advance(-sum(jumps))
    figures(jumps=number, segments=len(second_reader.find_segments(memory, LANE)))
    check_order(memory, [identify(record) for record in told])


def test_nothing_that_decides_reads_a_wall_time_back():
    for folder in ("agent", "runtime", "protocol/store"):
        for path in (PACKAGE / folder).rglob("*.py"):
            if path.name == "queues.py":  # who is older must survive a restart; it orders, and ends nothing
                continue
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"fromisoformat|strptime|\.timestamp\(", text), (
                f"{path}: leases and limits are monotonic"
            )


def test_a_day_of_more_than_999_segments_keeps_its_order(memory):
    options = {"partition": LANE, "clock": ManualClock(NOON_S), "durable": False, "segment_bytes": 1}
    Journal(memory, side=Side.AGENT, by="first", **options).close()
    (first,) = second_reader.find_segments(memory, LANE)
    late = first.with_stem(first.stem.replace(".001", ".997"))  # 996 more would have come before
    late.write_bytes(first.read_bytes().replace(first.stem.encode(), late.stem.encode()))
    first.unlink()
    agent = Journal(memory, side=Side.AGENT, by="agent", **options)
    told = [identify(agent.commit([make_submit(f"s{number}")])[0]) for number in range(5)]
    names = [path.stem[-5:].lstrip(".") for path in second_reader.find_segments(memory, LANE)]
    assert names == ["2.997", "2.998", "2.999", "1000", "1001", "1002"]
    check_order(memory, told)


@pytest.mark.parametrize("moved", ["workspace", "sessions", "lane"])
def test_a_folder_that_is_moved_away_stops_writers_and_readers_and_loses_nothing(memory, figures, moved):
    root = memory / "w"
    agent, runtime = open_two(root, ManualClock(NOON_S))
    told = [identify(record) for record in agent.commit([make_submit("a"), make_submit("b")])]
    runtime.read_new()
    place = {"workspace": root, "sessions": root / "sessions", "lane": agent.folder}[moved]
    with Watch([agent.folder], poll_s=0.01) as watch:
        place.rename(memory / "elsewhere")
        assert watch.wait(10.0)  # so a reader that waits comes to look

    for _ in range(2):
        with pytest.raises(ExecutionError, match=rf"WRITE_FAILED: {agent.folder}.* open it again"):
            agent.commit([make_submit("c")])
    with pytest.raises(ExecutionError, match="WRITE_FAILED"):
        runtime.read_new()

    (memory / "elsewhere").rename(place)
    told += [identify(record) for record in agent.commit([make_submit("c")])]
    assert [identify(record) for record in runtime.read_new()] == told[2:]
    figures(acknowledged=len(told), lost=0)
    check_order(root, told)


def test_a_writer_in_a_moved_folder_does_not_fork_the_truth(memory):
    root = memory / "w"
    old, reader = open_two(root, ManualClock(NOON_S))
    before = [identify(record) for record in old.commit([make_submit("a")])]
    reader.read_new()
    root.rename(memory / "elsewhere")
    new, _ = open_two(root, ManualClock(NOON_S))
    told = [identify(record) for record in new.commit([make_submit("b")])]

    with pytest.raises(ExecutionError, match="WRITE_FAILED"):
        old.commit([make_submit("c")])
    with pytest.raises(ExecutionError, match="WRITE_FAILED"):
        reader.read_new()

    check_order(memory / "elsewhere", before)
    check_order(root, told)


@pytest.mark.parametrize("name", [".lock", "segment"])
def test_a_file_that_was_replaced_under_an_open_journal_stops_its_writers(memory, name):
    agent, runtime = open_two(memory, ManualClock(NOON_S))
    told = [identify(record) for record in agent.commit([make_submit("a")])]
    (segment,) = agent.folder.glob("*.md")
    path = segment if name == "segment" else agent.folder / name
    shutil.copy(path, memory / "copy")
    (memory / "copy").replace(path)  # as an editor saves it, or `git checkout` does

    for journal, entry in ((agent, make_submit("b")), (runtime, Entry("a", "claim"))):
        with pytest.raises(ExecutionError, match=rf"WRITE_FAILED: {path.parent}.* open it again"):
            journal.commit([entry])

    check_order(memory, told)
    late, _ = open_two(memory, ManualClock(NOON_S))
    told += [identify(record) for record in late.commit([make_submit("b")])]
    check_order(memory, told)
