"""What a writer knows of sessions and goals for admission, and how it recalls the rest.

In memory is what is live, and what was touched since the last sealed segment. Of what ended before only its id is
remembered, as eight bytes of its hash, so that an id is never used twice; the journal itself answers where the hash is
known. What a checkpoint passed over is read when first needed, which a process that submits nothing never does.
"""

from pathlib import Path

from phyagentos.store.admission import GOAL_PREFIX, Admission, Known, read_known
from phyagentos.store.checkpoint import Checkpoint
from phyagentos.store.records import JOURNAL_ID


class NotCached(Exception):
    """An id must be looked up in the segments first, which must not happen while the partition is locked."""


class AdmissionCache:
    """Admission facts of one journal, whose cursor began at a checkpoint, None for the first record.

    `segment` is that which was written when it last forgot something.
    """

    def __init__(self, folder: Path, checkpoint: Checkpoint | None) -> None:
        self.admission = Admission(self._recall)
        self._folder = folder
        self.segment = ""
        self._used: set[int] = set()  # hashes of the ids that are not in memory
        self._is_warm = checkpoint is None  # whatever is neither in memory nor among the hashes never was
        if checkpoint is not None:
            self.segment, image = checkpoint.position.segment, checkpoint.image
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

    def knows(self, id: str) -> bool:
        """Whether a session or goal of this id was ever submitted."""
        try:
            return self.admission.knows(id)
        except NotCached:
            self.warm_up()
            return self.admission.knows(id)

    def warm_up(self) -> None:
        """Read every id that was ever submitted; raises `JOURNAL_DAMAGED`."""
        from phyagentos.store.history import Histories  # late: who submits nothing needs none

        with Histories(self._folder) as histories:
            self._used.update(map(hash, histories.iter_begun()))
        self._is_warm = True

    def shrink(self, segment: str, first_seq: int) -> None:
        """Let go of what ended before `segment`, which begins with `first_seq`."""
        if self.segment:
            self._used.update(map(hash, self.admission.forget(first_seq - 1)))
        self.segment = segment

    def _recall(self, id: str) -> Known | None:
        if id == JOURNAL_ID:
            return None
        if not self._is_warm:
            raise NotCached
        if hash(id) not in self._used:
            return None
        from phyagentos.store.history import Histories

        with Histories(self._folder) as histories:
            return next(filter(None, map(read_known, reversed(histories.find(id)))), None)
