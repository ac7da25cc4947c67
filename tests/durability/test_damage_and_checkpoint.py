"""A start from a checkpoint reads only the end of a lane; it believes no damage either, wherever that lies."""

import random
from collections import Counter

import pytest

from phyagentos.errors import ExecutionError

from . import damages
from .patient import Patient
from .workloads import fold, list_live

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


def test_archived_segments_are_held_to_the_same(patient, scale, figures):
    rng = random.Random(21)
    for _ in range(scale(300, 20_000)):
        patient.suffer(damages.draw(patient.paths, rng), opens_journal=False)
    figures(**patient.counts)
    assert patient.accepted == []


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


def test_an_end_that_a_checkpoint_has_seen_cannot_go_missing(patient, scale, figures):
    last = patient.paths[-1]
    rng, refused = random.Random(23), 0
    places = damages.find_records(patient.whole[last])
    seen = int(patient.whole[patient.checkpoint].split(b"\noffset: ")[1].split(b"\n")[0])
    cuts = [place for place in places if place < seen]
    cuts += [rng.randrange(places[0], seen) for _ in range(scale(20, 1_000))]
    for cut in cuts:
        last.write_bytes(patient.whole[last][:cut])
        with pytest.raises(ExecutionError, match=rf"JOURNAL_DAMAGED: .*{last.name}, offset \d+: .*checkpoint"):
            patient.open()
        refused += 1
        patient.heal()
    last.unlink()
    with pytest.raises(ExecutionError, match=r"JOURNAL_DAMAGED: .*checkpoint"):
        patient.open()
    figures(damages=len(cuts) + 1, refused=refused + 1)
