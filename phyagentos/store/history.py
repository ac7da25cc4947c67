"""The whole history of one session, goal or node, archived or not, without reading the journal.

Sealed segments are found by the index, the open one is searched; every record is checked as by a follower.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing
from pathlib import Path

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, REVIEW, list_triggers
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.store import segments
from phyagentos.store.admission import GOAL_PREFIX, NODE_PREFIX, GoalEvent
from phyagentos.store.follower import Follower
from phyagentos.store.index import HistoryIndex, RecordPosition
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import HEADER_BYTES, Record, read_record, scan_records

KIN = ("parent", "child")  # in the body of `child_of`


class Histories(AbstractContextManager["Histories"]):
    """Looks up histories in one partition `sessions/<partition>`; close it, or use it in a `with` block.

    Methods raise ExecutionError: `JOURNAL_DAMAGED`, `INDEX_UNAVAILABLE`.
    """

    def __init__(self, folder: Path) -> None:
        self.index = HistoryIndex(folder)
        self._folder = folder

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the index."""
        self.index.close()

    def find(self, id: str) -> list[Record]:
        """Records of a session id, `goal:<goal id>` or `node:<goal id>/<node>`, oldest first; empty when unknown."""
        self.index.extend()
        begin = b'- {"id":%b,' % msgspec.json.encode(id)
        records = self.read_sealed(id)
        if records and _is_closed(records[-1]):
            return records
        for data, _ in self._iter_unsealed_segments():
            at = data.find(begin)
            while at >= 0:
                found = read_record(data, at - HEADER_BYTES)
                if found is not None and found[0].id == id:
                    records.append(found[0])
                at = data.find(begin, at + 1)
        return records

    def fold_around(self, id: SessionId) -> Ledger | None:
        """A session, its goal, and the other sessions of its node; None when no such session was ever submitted."""
        records = self.find(id)
        if not records or records[0].ev != "submit":
            return None
        contract = records[0].contract
        if contract.goal:
            of_node = self.find(f"{NODE_PREFIX}{contract.goal}/{contract.node}")
            kin = _find_kin(of_node)
            records += self.find(f"{GOAL_PREFIX}{contract.goal}") + of_node
            records += [record for each in sorted(kin - {id}) for record in self.find(each)]
        return fold(sorted(records, key=lambda record: record.seq))

    def fold_goal(self, id: GoalId) -> Ledger | None:
        """A goal, its nodes and all their sessions; None when it was never submitted."""
        records = self.find(f"{GOAL_PREFIX}{id}")
        if not records:
            return None
        for node in fold(records).goals[id].nodes:
            of_node = self.find(f"{NODE_PREFIX}{id}/{node}")
            records += of_node
            records += [record for each in {f"{id}.{node}", *_find_kin(of_node)} for record in self.find(each)]
        return fold(sorted(records, key=lambda record: record.seq))

    def read_sealed(self, id: str) -> list[Record]:
        """Those of them that the index knows."""
        try:
            return [self._read(place, id) for place in self.index.find(id)]
        except (ExecutionError, OSError):  # the index does not fit the segments
            self.index.rebuild()
            return [self._read(place, id) for place in self.index.find(id)]

    def iter_unsealed(self, last_seq: int) -> Iterator[Record]:
        """Every record behind the index, up to `last_seq`."""
        for data, front in self._iter_unsealed_segments():
            head = len(front.encode())
            for record in scan_records(data[head:], front.first_seq - 1).records:
                if record.seq > last_seq:
                    return
                yield record

    def find_status(self, id: SessionId) -> SessionStatus | None:
        """A session as it stands now, None when it is unknown."""
        return fold(self.find(id)).sessions.get(id)

    def _read(self, place: RecordPosition, id: str) -> Record:
        with os.fdopen(segments.open_segment(self._folder, place.segment), "rb") as file:
            data = os.pread(file.fileno(), place.length, place.offset)
        found = read_record(data, 0)
        if found is None or found[0].id != id:
            path = segments.locate(self._folder, place.segment)
            raise segments.damage(path, place.offset, f"a record of {id} is not as it was written")
        return found[0]

    def _iter_unsealed_segments(self) -> Iterator[tuple[bytes, segments.Front]]:
        """Contents and front matter of the segments that the index does not hold: mostly the one being written."""
        name = self.index.last_segment
        names = [] if name else segments.list_all_segments(self._folder)
        following = segments.find_next_segment(self._folder, name) if name else next(iter(names), None)
        while following is not None:
            data = segments.read_segment(self._folder, following)
            yield data, segments.read_front(segments.locate(self._folder, following), data)
            following = segments.find_next_segment(self._folder, following)


def _find_kin(of_node: Sequence[Record]) -> set[str]:
    """Sessions that the records of a node name."""
    return {str(body[name]) for record in of_node if (body := record.body or {}) for name in KIN if name in body}


def _is_closed(latest: Record) -> bool:
    """Whether nothing can follow: a session that is over may still be judged once more."""
    is_final = latest.to in FINAL_STATES and REVIEW not in list_triggers(str(latest.to))
    return is_final or latest.ev == GoalEvent.GOAL_VERDICT


def fold(records: Sequence[Record]) -> Ledger:
    """The state that some records alone lead to."""
    ledger = Ledger(forgets=False)
    for record in records:
        ledger.apply(record)
    return ledger


def fold_partition(folder: Path) -> Ledger:
    """The state of every session and goal of a partition; empty where there is no such folder."""
    if not folder.is_dir():
        return fold(())
    with closing(Follower(folder)) as follower:
        return fold(follower.read_new())
