"""A start from a checkpoint reads only the end of a lane; it believes no damage either, wherever that lies."""

import random
from collections import Counter

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.store.history import fold

from . import damages
from .patient import Patient
from .workloads import list_live

pytestmark = pytest.mark.slow

WORKLOAD = ("batch", "claim", "archive", "batch", "claim", "rotate", "submit", "checkpoint", "batch")


class KeptPatient(Patient):
    """A lane with an archived segment, a checkpoint, and records behind it."""

    def __init__(self, root):
        super().__init__(root, WORKLOAD)
        self.checkpoint = self.folder / "checkpoint.md"
        self.whole[self.checkpoint] = self.checkpoint.read_bytes()
        self.live = list_live(fold(self.follow()[0]))
        assert "archive" in self.paths[0].parts

    def start(self, damage):
        """What a writer makes of the damage: `refused`, `harmless`, `cut` or `accepted`."""
        found, _, message = self.follow()
        try:
            journal = self.open()
            live = list_live(journal.open_ledger())
            journal.close()
        except ExecutionError as error:
            if error.code != "JOURNAL_DAMAGED" or damage.path == self.checkpoint:
                raise
            return "refused"
        if live == self.live:
            return "harmless"
        is_last = damage.path == self.paths[-1]
        torn = is_last and damages.may_be_torn(self.whole[damage.path], damage.data)
        return "cut" if torn and not message and live == list_live(fold(found)) else "accepted"


@pytest.fixture
def patient(memory):
    return KeptPatient(memory / "w")


def test_a_start_from_a_checkpoint_believes_no_damage(patient, scale, figures):
    rng, told = random.Random(22), Counter(dict.fromkeys(("damages", "refused", "harmless", "cut", "accepted"), 0))
    for _ in range(scale(400, 20_000)):
        damage = damages.draw([*patient.paths, patient.checkpoint], rng)
        damage.path.write_bytes(damage.data)
        try:
            outcome = patient.start(damage)
            told.update(("damages", outcome))
            assert outcome != "accepted", (damage.kind, damage.path.name, damage.offset)
        finally:
            patient.heal()
    figures(**told)
    assert told["refused"] > 0
    assert told["harmless"] > 0
