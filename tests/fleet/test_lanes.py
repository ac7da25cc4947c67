"""A lane on another host: the same bytes, whatever is sent twice or breaks off."""

import re
from pathlib import Path

import msgspec
import pytest

import phyagentos
from phyagentos.errors import ExecutionError
from phyagentos.fleet.bus import BusLost
from phyagentos.fleet.lanes import LanePublisher, LaneReader, LaneReplica
from phyagentos.operations.store import check_journal
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import ManualClock, make_contract

from .fake_bus import FakeBus, FakeServer


def fill(journal, count, first=0):
    """Batches of one and of two records."""
    for number in range(first, first + count):
        contract = make_contract(id=f"g.{number}", objective="“ünïcode” <!-- phy1")
        journal.commit([Entry(contract.id, "submit", dict(msgspec.to_builtins(contract)))])
        journal.commit([Entry(contract.id, "cancel", {"reason": "a"})])
    return journal.read_new()


@pytest.fixture
def clock():
    return ManualClock(1e6)


@pytest.fixture
def journal(tmp_path, clock):
    journal = Journal(tmp_path / "w", side=Side.AGENT, by="a", clock=clock, partition="h1", segment_bytes=2500)
    yield journal
    journal.close()


@pytest.fixture
def bus():
    return FakeBus(FakeServer())


def copy(bus, root):
    replica = LaneReplica(root, "h1")
    replica.take(bus.read("h1", replica.seq, bus.count("h1")))
    replica.close()
    return replica


def publish_all(journal, bus, seq):
    publisher = LanePublisher(journal, bus)
    while publisher.publish(seq):
        pass


def list_bytes(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.*.md")}


def test_a_replica_has_the_same_segments_byte_by_byte(journal, clock, bus, tmp_path):
    fill(journal, 6)
    clock.advance(86_400.0)
    last = fill(journal, 2, first=6)[-1].seq
    publish_all(journal, bus, last)
    replica = copy(bus, tmp_path / "copy")

    assert len(list_bytes(journal.folder)) > 2
    assert list_bytes(replica.folder) == list_bytes(journal.folder)
    assert check_journal(tmp_path / "copy").is_whole


def test_it_grows_with_its_original_and_takes_up_where_it_was_killed(journal, bus, tmp_path):
    last = fill(journal, 3)[-1].seq
    publish_all(journal, bus, last)
    replica = copy(bus, tmp_path / "copy")
    segment = max(list_bytes(replica.folder))
    with (replica.folder / segment).open("r+b") as file:
        file.truncate(file.seek(0, 2) - 10)  # a write that its process did not survive

    last = fill(journal, 2, first=3)[-1].seq
    publish_all(journal, bus, last)
    copy(bus, tmp_path / "copy")

    assert list_bytes(replica.folder) == list_bytes(journal.folder)


def test_what_arrived_and_was_not_answered_counts_once(journal, bus):
    last = fill(journal, 3)[-1].seq
    publisher, bus.loses_answers = LanePublisher(journal, bus), True
    with pytest.raises(BusLost):
        publisher.publish(last)
    bus.loses_answers = False
    publisher.publish(last)

    assert bus.server.lanes["h1"] == LaneReader(journal.folder).read(0, last)


def test_a_server_that_lost_its_disk_is_filled_again(journal, bus):
    last = fill(journal, 3)[-1].seq
    publish_all(journal, bus, last)
    bus.server.lanes.clear()

    publish_all(journal, bus, last)

    assert bus.count("h1") == last


def test_a_lane_of_the_same_name_that_is_another_one_is_refused(journal, bus, tmp_path):
    publish_all(journal, bus, fill(journal, 3)[-1].seq)
    other = Journal(tmp_path / "other", side=Side.AGENT, by="b", clock=ManualClock(2e6), partition="h1")
    with pytest.raises(ExecutionError, match="another journal of this name"):
        publish_all(other, bus, fill(other, 4)[-1].seq)
    other.close()


def test_a_damaged_frame_is_written_nowhere(journal, bus, tmp_path):
    publish_all(journal, bus, fill(journal, 1)[-1].seq)
    lane = bus.server.lanes["h1"]
    lane[1] = lane[1]._replace(data=lane[1].data.replace(b'"a"', b'"b"'))
    with pytest.raises(ExecutionError, match="record 2 arrived damaged"):
        copy(bus, tmp_path / "copy")


def test_a_record_that_is_gone_from_the_segments_is_named(journal):
    last = fill(journal, 6)[-1].seq
    min(journal.folder.glob("*.*.md")).unlink()
    with pytest.raises(ExecutionError, match="JOURNAL_DAMAGED"):
        LaneReader(journal.folder).read(0, last)


def test_one_module_alone_knows_nats():
    package = Path(phyagentos.__file__).parent
    found = [
        path.stem
        for path in package.rglob("*.py")
        if re.search(r"^\s*(import|from) nats", path.read_text(), re.MULTILINE)
    ]
    assert found == ["nats_bus"]
