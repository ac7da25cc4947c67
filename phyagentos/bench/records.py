"""Episodes of a run: the order of one, the record of one that ended, and the append-only log of records.

`episodes.jsonl` is the truth of a run: one line an episode, on the disk before the next step. A line that a kill cut
off is no record, and its episode is begun anew in a folder of its own.
"""

import os
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path

import msgspec

from phyagentos.agent.mission.report import SessionReport
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.durable_files import sync_folder
from phyagentos.protocol.documents.plain_data import Fields

LOG = "episodes.jsonl"
LINE_MAX = 1 << 24  # bytes of a record
AXES = ("task", "state", "policy", "setting", "verification", "phase")  # and the seed
BY_NAME = {"pass" if axis == "phase" else axis: axis for axis in AXES}  # as a suite names them


class Axes(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Where an episode stands in its suite; `phase` is its pass, and `id` begins the name of its folder."""

    id: str
    task: str
    seed: int
    state: str = ""
    policy: str = ""
    setting: str = ""
    verification: str = ""
    phase: str = ""


class Order(Axes, frozen=True, kw_only=True, omit_defaults=True):
    """What one episode is: everything that its process needs, and nothing else decides it.

    Attributes:
        variant: The merged `Variant`, as plain data.
        verification: Mode of verification; empty for that of runtime_contract.yaml.
        score: Part -> condition.
        scored: When each part is asked for: at the `end`, or after the last session of its `node`.
        lineage: Episodes that share experience have the same one.
        chain: Episodes of one chain run one after the other, each with the memory that the one before has left.
        wall_s: Longest wall time [s].
    """

    graph: str
    goal: str
    variant: Fields = {}
    memory: str = "none"
    scorer: str = "simulator"
    score: Fields = {}
    scored: str = "end"
    lineage: str = ""
    chain: str = ""
    wall_s: float = 900.0


class Held(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One part of what decides an episode: the hash of its files, and what it says, where that can be listed."""

    hash: str
    says: tuple[str, ...] = ()


class SessionRecord(SessionReport, frozen=True, kw_only=True, omit_defaults=True):
    """One session of an episode, as its goal's report tells it, and what was measured.

    Attributes:
        bundle: Its evidence, relative to the run's folder.
        taxon: Kind of failure; empty where the objective was met.
        is_met: Whether the part of its node is there after it, as the scorer says; None where it was not asked.
        contacts: Of robots with each other, as the world noted them.
    """

    bundle: str
    taxon: str = ""
    is_met: bool | None = None
    contacts: int = 0
    stages_ms: dict[str, float] = {}
    wall_s: float = 0.0


class EpisodeRecord(Axes, frozen=True, kw_only=True, omit_defaults=True):
    """One episode that ended.

    Attributes:
        ended: `over`; `hung` where it was ended after its wall time, `crashed` where its process died or raised.
        folder: Its own folder, relative to the run's.
        parts: Part of the goal -> whether it is there in the end, as the scorer says.
        first_parts: The same after the first session of the part's node; one that look-ahead refused is none.
        is_met: Whether all parts are there; None where the scorer could not say.
        taxon: Kind of failure; empty where goal and verdict agree on success.
        memory_before: Version of the memory that advised it; `memory_after` when it ended.
        settings: Hash of settings files, goal graph and library of its workspace.
        bits: Hash of every recorded state and trajectory.
        held: Planner, memory, verifier, settings, targets, adapters and skills that decided it.
    """

    at: str
    folder: str
    ended: str = "over"
    error: str = ""
    goal: str = ""
    verdict: str = ""
    reason: str = ""
    replans: int = 0
    parts: dict[str, bool] = {}
    first_parts: dict[str, bool] = {}
    is_met: bool | None = None
    taxon: str = ""
    sessions: tuple[SessionRecord, ...] = ()
    wall_s: float = 0.0
    sim_time_s: float = 0.0
    memory: str = "none"
    memory_before: str = ""
    memory_after: str = ""
    settings: str = ""
    bits: str = ""
    held: dict[str, Held] = {}
    version: str = ""
    host: str = ""

    @property
    def is_first(self) -> bool:
        """Whether the goal is met, and no node was tried twice."""
        return bool(self.is_met) and not self.replans

    @property
    def is_false_success(self) -> bool:
        """Whether the verdict on the goal, or on a session, is a success that the scorer denies."""
        succeeded = [each for each in self.sessions if each.state == "succeeded"]
        return (self.verdict == "success" and self.is_met is False) or any(s.is_met is False for s in succeeded)

    @property
    def is_false_failure(self) -> bool:
        """Whether the verdict denies a success that the scorer sees."""
        return self.ended == "over" and self.verdict != "success" and self.is_met is True


class EpisodeLog:
    """The records of a run, as the episodes ended; opening it cuts a line off that a kill left half written."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOG
        self.records = {record.id: record for record in read_records(folder)}
        is_new = not self._path.exists()
        whole = sum(map(len, _iter_lines(self._path)))
        self._file = self._path.open("ab")
        os.truncate(self._path, whole)
        if is_new:
            sync_folder(folder)

    def append(self, record: EpisodeRecord) -> bool:
        """Keep the record of an episode; False where there is one already. On the disk when this returns."""
        if record.id in self.records:
            return False
        self._file.write(msgspec.json.encode(record) + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.records[record.id] = record
        return True

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_records(folder: Path) -> list[EpisodeRecord]:
    """The record of each episode of a run, however often its line stands there; a line that is not whole is none.

    Raises DefinitionError `CHANGED` for a whole line that is no record, and for two records of one episode.
    """
    path, records = folder / LOG, dict[str, EpisodeRecord]()
    for number, line in enumerate(_iter_lines(path), 1):
        try:
            record = msgspec.json.decode(line, type=EpisodeRecord)
        except msgspec.MsgspecError as error:
            where, expected = f"{path}:{number}", "the record of an episode"
            raise DefinitionError.of("CHANGED", where, str(error), expected) from error
        if records.setdefault(record.id, record) != record:
            expected = "one record of each episode"
            raise DefinitionError.of("CHANGED", f"{path}:{number}", f"another record of {record.id}", expected)
    return [*records.values()]


def _iter_lines(path: Path) -> Iterator[bytes]:
    """The whole lines of a log; raises DefinitionError `TOO_LARGE` for one that no episode has."""
    with path.open("rb") if path.is_file() else BytesIO() as file:
        while line := file.readline(LINE_MAX):
            if not line.endswith(b"\n"):
                if len(line) == LINE_MAX:
                    found = f"a line of more than {LINE_MAX} bytes"
                    raise DefinitionError.of("TOO_LARGE", str(path), found, "the record of an episode")
                return
            yield line


def select(records: Iterable[EpisodeRecord], where: dict[str, str]) -> list[EpisodeRecord]:
    """Those that have these values on these axes, by the names that a suite has for them."""
    return [each for each in records if all(getattr(each, BY_NAME[axis]) == value for axis, value in where.items())]
