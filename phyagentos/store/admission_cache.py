"""What a writer knows of sessions and goals for admission, and how it recalls the rest.

In memory is what is live, and what was touched since the last sealed segment; what ended before is looked up in the
index, so that an id is never used twice and the memory does not grow. What the checkpoint passed over is read when
first asked for, which a process that submits nothing never does.
"""

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from phyagentos.errors import ExecutionError
from phyagentos.store.admission import GOAL_PREFIX, Admission, Known, read_known
from phyagentos.store.checkpoint import Checkpoint
from phyagentos.store.follower import Follower
from phyagentos.store.records import JOURNAL_ID, Record

if TYPE_CHECKING:
    from phyagentos.store.history import Histories


class NotCached(Exception):
    """Something is asked for that has to be read first, which must not happen while the partition is locked."""


class AdmissionCache:
    """Admission facts of one journal, whose cursor began at a checkpoint, None for the first record.

    `segment` is that which was written when it last forgot something.
    """

    def __init__(self, folder: Path, checkpoint: Checkpoint | None) -> None:
        self.admission = Admission(self._recall)
        self._folder = folder
        self._histories: Histories | None = None
        self.segment = ""
        self._passed_seq = 0  # what stands before was never seen here
        self._is_whole = checkpoint is None  # whatever is not in memory never was
        self._is_warm = checkpoint is None
        if checkpoint is not None:
            self._passed_seq, self.segment = checkpoint.position.seq, checkpoint.position.segment
            image = checkpoint.image
            live: dict[str, Known] = {
                each.status.contract.id: Known(each.status.state, each.status.epoch, each.span.last_seq)
                for each in image.sessions
                if not each.is_over
            }
            open_goals = {
                GOAL_PREFIX + each.status.id: Known("", 0, each.span.first_seq)
                for each in image.goals
                if not each.is_over
            }
            self.admission.restore({**live, **open_goals})

    @property
    def histories(self) -> "Histories":
        """Looks up what is not in memory."""
        from phyagentos.store.history import Histories  # late: who submits nothing needs no index

        if self._histories is None:
            self._histories = Histories(self._folder)
        return self._histories

    def knows(self, id: str) -> bool:
        """Whether a session or goal of this id was ever submitted."""
        try:
            return self.admission.knows(id)
        except NotCached:
            self.warm_up()
            return self.admission.knows(id)

    def warm_up(self) -> None:
        """Read what the checkpoint passed over; raises `JOURNAL_DAMAGED`."""
        try:
            self.histories.index.extend()
        except ExecutionError as error:
            if error.code != "INDEX_UNAVAILABLE":
                raise
            with closing(Follower(self._folder)) as follower:  # no index: everything stays in memory
                self._learn(follower.read_new())
            self._is_whole = True
        else:
            self._learn(self.histories.iter_unsealed(self._passed_seq))
        self._is_warm = True

    def _learn(self, records: Iterable[Record]) -> None:
        self.admission.restore({each.id: known for each in records if (known := read_known(each)) is not None})

    def shrink(self, segment: str) -> None:
        """Let go of what ended before `segment` began; what cannot be looked up stays."""
        if self.segment:
            try:
                self.histories.index.extend()
            except ExecutionError:
                return
            self.admission.forget(self.histories.index.last_seq)
            self._is_whole = False
        self.segment = segment

    def close(self) -> None:
        """Close the files."""
        if self._histories is not None:
            self._histories.close()

    def _recall(self, id: str) -> Known | None:
        if self._is_whole or id == JOURNAL_ID:
            return None
        if not self._is_warm:
            raise NotCached
        return next(filter(None, map(read_known, reversed(self.histories.read_sealed(id)))), None)
