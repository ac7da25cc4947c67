"""What dies, fails or rots: nothing acknowledged is lost, nothing damaged is believed."""

import threading

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.segments import SystemIO

from .damage import segments_of, spoil


class CountingIO(SystemIO):
    """Counts the waits for the disk."""

    syncs = 0

    def fdatasync(self, fd):
        self.syncs += 1
        super().fdatasync(fd)


def test_a_torn_tail_is_cut_and_recorded(open_journal, submit):
    agent = open_journal()
    agent.commit([submit("s"), submit("t")])
    (path,) = segments_of(agent)
    whole = path.read_bytes()
    path.write_bytes(whole + b"<!-- phy1 0000000003 000900 00000000 -->\n- half of")
    assert [record.seq for record in agent.read_new()] == [1, 2]  # a follower waits

    late = open_journal(Side.RUNTIME, "late")

    repair = late.read_new()[-1]
    assert (repair.seq, repair.id, repair.ev, repair.body["cut_bytes"]) == (3, "journal", "repair", 50)
    assert path.read_bytes().startswith(whole)
    assert [record.ev for record in agent.read_new()] == ["repair"]


def test_half_a_batch_is_cut_as_a_whole(open_journal, submit):
    agent = open_journal()
    agent.commit([submit("s")])
    (path,) = segments_of(agent)
    before = path.read_bytes()
    agent.commit([submit("t"), submit("u")])
    agent.close()
    after = path.read_bytes()
    path.write_bytes(after[: after.rindex(b"<!-- phy1")])  # the writer died between the two

    late = open_journal()

    assert [record.id for record in late.read_new()] == ["s", "journal"]
    assert path.read_bytes().startswith(before)
    assert late.commit([submit("t")])[0].seq == 3


@pytest.mark.parametrize("place", ["first", "last"])
def test_damage_is_located_and_nothing_is_touched(open_journal, submit, place):
    agent = open_journal()
    for id in ("s", "t"):
        agent.commit([submit(id)])
    agent.close()
    (path,) = segments_of(agent)
    start = spoil(path, {"first": 1, "last": 2}[place])
    data = path.read_bytes()

    with pytest.raises(
        ExecutionError, match=rf"JOURNAL_DAMAGED: .*{path.name}, offset {start}: record \d is not as it was"
    ):
        open_journal()

    assert path.read_bytes() == data
    assert path.with_name(f"{path.stem}.{start}.damaged").read_bytes() == data[start:]


def test_a_running_follower_reports_damage_in_what_comes_next(open_journal, submit):
    agent, reader = open_journal(), open_journal(Side.RUNTIME)
    agent.commit([submit("s")])
    (path,) = segments_of(agent)
    path.write_bytes(path.read_bytes().replace(b"red cube", b"blue cub"))

    with pytest.raises(ExecutionError, match="JOURNAL_DAMAGED"):
        reader.read_new()
    path.write_bytes(b"")
    with pytest.raises(ExecutionError, match="the file ends here, but record 0 ended at"):
        reader.read_new()


def test_threads_that_wait_together_share_a_sync(open_journal, submit):
    class SlowIO(CountingIO):
        def fdatasync(self, fd):
            super().fdatasync(fd)
            gate.wait(5)

    gate = threading.Event()
    io = SlowIO()
    agent = open_journal(file_io=io, durable=True)
    threads = [threading.Thread(target=agent.commit, args=([submit(f"s{number}")],)) for number in range(8)]
    for thread in threads:
        thread.start()
    while len(list(open_journal().read_new())) < 8:
        pass
    gate.set()
    for thread in threads:
        thread.join()

    assert io.syncs < 8
    assert sorted(record.id for record in agent.read_new()) == [f"s{number}" for number in range(8)]


def test_one_commit_needs_one_sync_and_none_when_not_durable(open_journal, submit):
    io, other = CountingIO(), CountingIO()
    open_journal(file_io=io, durable=True).commit([submit(f"s{number}") for number in range(64)])
    open_journal(file_io=other).commit([submit("t")])

    assert (io.syncs, other.syncs) == (1, 0)
