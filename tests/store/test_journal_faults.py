"""What dies, fails or rots: nothing acknowledged is lost, nothing damaged is believed."""

import errno
import threading

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Entry
from phyagentos.store.segments import SystemIO


class FaultyIO(SystemIO):
    """The real calls, until told otherwise."""

    def __init__(self):
        self.bytes_per_write = 1 << 30
        self.bytes_left = 1 << 30
        self.sync_error = None
        self.truncate_error = None
        self.syncs = 0

    def write(self, fd, data):
        if self.bytes_left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = super().write(fd, data[: min(self.bytes_per_write, self.bytes_left)])
        self.bytes_left -= taken
        return taken

    def truncate(self, fd, size):
        if self.truncate_error is not None:
            raise self.truncate_error
        super().truncate(fd, size)

    def fdatasync(self, fd):
        self.syncs += 1
        if self.sync_error is not None:
            raise self.sync_error
        super().fdatasync(fd)


def read_segment(journal):
    (path,) = journal.folder.glob("*.md")
    return path


def test_a_torn_tail_is_cut_and_recorded(open_journal, submit):
    agent = open_journal()
    agent.commit([submit("s"), submit("t")])
    path = read_segment(agent)
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
    path = read_segment(agent)
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
    agent.commit([submit("s")])
    agent.commit([submit("t")])
    agent.close()
    path = read_segment(agent)
    data = bytearray(path.read_bytes())
    start = data.index(b"<!-- phy1") if place == "first" else data.rindex(b"<!-- phy1")
    data[start + 60] ^= 4
    path.write_bytes(data)

    with pytest.raises(
        ExecutionError, match=rf"JOURNAL_DAMAGED: .*{path.name}, offset {start}: record \d is not as it was"
    ):
        open_journal()

    assert path.read_bytes() == data
    assert path.with_name(f"{path.stem}.{start}.damaged").read_bytes() == data[start:]


def test_a_running_follower_reports_damage_in_what_comes_next(open_journal, submit):
    agent, reader = open_journal(), open_journal(Side.RUNTIME)
    agent.commit([submit("s")])
    path = read_segment(agent)
    path.write_bytes(path.read_bytes().replace(b"red cube", b"blue cub"))

    with pytest.raises(ExecutionError, match="JOURNAL_DAMAGED"):
        reader.read_new()
    path.write_bytes(b"")
    with pytest.raises(ExecutionError, match="the file ends here, but record 0 ended at"):
        reader.read_new()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_every_flipped_byte_of_a_segment_is_refused(open_journal, submit, data):
    agent = open_journal()
    path = read_segment(agent)
    if b"phy1" not in path.read_bytes():
        agent.commit([submit("s")])
        agent.commit([Entry("s", "cancel", {"reason": "no"}), submit("t")])
    whole = path.read_bytes()
    changed = bytearray(whole)
    changed[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.sampled_from([1, 4, 64, 128]))
    path.write_bytes(changed)
    try:
        with pytest.raises(ExecutionError, match="JOURNAL_DAMAGED"):
            open_journal()
    finally:
        path.write_bytes(whole)


def test_short_writes_are_finished(open_journal, submit):
    io = FaultyIO()
    io.bytes_per_write = 7
    agent = open_journal(file_io=io)
    agent.commit([submit("s"), submit("t")])

    assert [record.id for record in open_journal().read_new()] == ["s", "t"]


@pytest.mark.parametrize("room", [0, 1, 40, 41, 300, 700])
@pytest.mark.parametrize("can_truncate", [True, False])
def test_a_full_disk_records_nothing_and_the_next_commit_works(open_journal, submit, room, can_truncate):
    io = FaultyIO()
    agent, reader = open_journal(file_io=io), open_journal()
    agent.commit([submit("s")])
    io.bytes_left = room
    io.truncate_error = None if can_truncate else OSError(errno.EIO, "Input/output error")

    with pytest.raises(ExecutionError, match=r"JOURNAL_WRITE_FAILED: .*No space left on device. Nothing was recorded"):
        agent.commit([submit("t"), submit("u")])

    assert [record.id for record in reader.read_new()] == ["s"]
    io.bytes_left, io.truncate_error = 1 << 30, None
    agent.commit([submit("t")])
    assert [record.id for record in reader.read_new() if record.ev != "repair"] == ["t"]
    assert [record.id for record in agent.read_new() if record.ev != "repair"] == ["s", "t"]


def test_a_failed_sync_is_final_for_the_process_and_no_one_else(open_journal, submit):
    io = FaultyIO()
    agent = open_journal(file_io=io, durable=True)
    io.sync_error = OSError(errno.EIO, "Input/output error")

    with pytest.raises(ExecutionError, match=r"JOURNAL_NOT_DURABLE: .*end this process"):
        agent.commit([submit("s")])
    io.sync_error = None
    with pytest.raises(ExecutionError, match="JOURNAL_NOT_DURABLE"):
        agent.commit([submit("t")])

    assert open_journal().commit([submit("t")])[0].seq == 2


def test_threads_that_wait_together_share_a_sync(open_journal, submit):
    class SlowIO(FaultyIO):
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
    io, other = FaultyIO(), FaultyIO()
    open_journal(file_io=io, durable=True).commit([submit(f"s{number}") for number in range(64)])
    open_journal(file_io=other).commit([submit("t")])

    assert (io.syncs, other.syncs) == (1, 0)
