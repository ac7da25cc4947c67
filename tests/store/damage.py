"""What rots in a journal, and what is done about it."""

from contextlib import closing

from phyagentos.store.checkpoint import read_ledger, write_checkpoint
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Entry
from phyagentos.store.maintenance import Maintenance
from phyagentos.store.records import encode_record
from phyagentos.store.recovery.repair import repair_partition
from phyagentos.store.segments import SystemIO
from phyagentos.testing import ManualClock

from .conftest import make_submit
from .readers import HashingFollower


def mend(folder, *, accept_loss=True, **options):
    return repair_partition(
        folder,
        **({"accept_loss": accept_loss, "by": "repair", "clock": ManualClock(1e6), "file_io": SystemIO()} | options),
    )


def fill(journal, count=12):
    """Two records a batch: a submission, and the cancellation of the one before."""
    for number in range(count):
        ending = [Entry(f"s{number - 1}", "cancel")] if number else []
        journal.commit([make_submit(f"s{number}"), *ending])


def segments_of(journal):
    return sorted(journal.folder.glob("[0-9]*.md"))


def segment_of(journal, seq):
    (path,) = (path for path in segments_of(journal) if b"<!-- phy1 %010d" % seq in path.read_bytes())
    return path


def start_of(path, seq):
    return path.read_bytes().index(b"<!-- phy1 %010d" % seq)


def flip(path, *places):
    """Change a bit of the byte at each place."""
    data = bytearray(path.read_bytes())
    for place in places:
        data[place] ^= 4
    path.write_bytes(data)


def spoil(path, seq, *, at=60):
    """Change one byte of a record; where it begins."""
    start = start_of(path, seq)
    flip(path, start + at)
    return start


def read_all(folder):
    """Every record of a partition."""
    with closing(Follower(folder)) as follower:
        return follower.read_new()


def frames_of(folder):
    """Number -> bytes of every record a reader accepts, with that reader's word on the end."""
    follower = HashingFollower(folder)
    records = follower.read_new()
    follower.close()
    return {record.seq: encode_record(record) for record in records}, records, str(follower.tail)


def checkpoint(folder):
    ledger, position = read_ledger(folder)
    write_checkpoint(folder, ledger, position, SystemIO(), durable=False)
    return ledger


def tidy(folder, io=None, *, durable=False):
    """Write a checkpoint and archive, as a journal does now and then."""
    ledger, position = read_ledger(folder)
    if position is not None:
        Maintenance(folder, ManualClock(), io or SystemIO(), durable=durable).tidy(ledger, position)
    return ledger
