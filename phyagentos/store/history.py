"""The whole history of one session, goal or node, archived or not: only segments that name it are parsed.

Of a segment that names it every record is checked, as by a follower.
"""

import contextlib
import mmap
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing
from pathlib import Path

import msgspec

from phyagentos.protocol.sessions.session import GoalId, SessionId
from phyagentos.store import segments
from phyagentos.store.admission import GOAL_PREFIX, NODE_PREFIX
from phyagentos.store.follower import Follower
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record, Tail, scan_records

KIN = ("parent", "child")  # in the body of `child_of`
_BEGINNING = re.compile(rb'^- \{"id":("(?:[^"\\]|\\.)*"),"ev":"(?:goal_submitted|submit)"', re.MULTILINE)


class Histories(AbstractContextManager["Histories"]):
    """Looks up histories in one partition `sessions/<partition>`; use it in a `with` block.

    Methods raise ExecutionError: `JOURNAL_DAMAGED`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._maps: dict[str, mmap.mmap] = {}

    def __exit__(self, *_: object) -> None:
        """Close the segments."""
        for each in self._maps.values():
            each.close()

    def find(self, id: str) -> list[Record]:
        """Records of a session id, `goal:<goal id>` or `node:<goal id>/<node>`, oldest first; empty when unknown."""
        begin = b'\n- {"id":%b,' % msgspec.json.encode(id)
        names = segments.list_all_segments(self._folder)
        named = [name for name in names if self._map(name).find(begin) >= 0]
        return [each for name in named for each in self._read(name, is_last=name == names[-1]) if each.id == id]

    def iter_begun(self) -> Iterator[str]:
        """Every id of a session or goal (`goal:<goal id>`) that was ever submitted, and rarely some other text."""
        for name in segments.list_all_segments(self._folder):
            for match in _BEGINNING.finditer(self._map(name)):
                with contextlib.suppress(msgspec.DecodeError):  # words in a body
                    yield msgspec.json.decode(match[1], type=str)

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

    def _map(self, name: str) -> mmap.mmap:
        with os.fdopen(segments.open_segment(self._folder, name), "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if not size:
                raise segments.damage(segments.locate(self._folder, name), 0, "it is empty")
            if name not in self._maps or len(self._maps[name]) != size:
                self._maps[name] = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return self._maps[name]

    def _read(self, name: str, *, is_last: bool) -> Sequence[Record]:
        data, path = self._map(name)[:], segments.locate(self._folder, name)
        front = segments.read_front(path, data)
        head = len(front.encode())
        scan = scan_records(data[head:], front.first_seq - 1)
        if scan.tail is Tail.DAMAGED or (scan.tail is Tail.TORN and not is_last):
            raise segments.damage(path, head + scan.end, "a record is not as it was written")
        return scan.records


def _find_kin(of_node: Sequence[Record]) -> set[str]:
    """Sessions that the records of a node name."""
    return {str(body[name]) for record in of_node if (body := record.body or {}) for name in KIN if name in body}


def fold(records: Sequence[Record]) -> Ledger:
    """The state that some records alone lead to."""
    ledger = Ledger(forgets=False)
    ledger.extend(records)
    return ledger


def fold_partition(folder: Path) -> Ledger:
    """The state of every session and goal of a partition; empty where there is no such folder."""
    if not folder.is_dir():
        return fold(())
    with closing(Follower(folder)) as follower:
        return fold(follower.read_new())
