"""What rots is located or refused, never believed."""

import random

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.store.follower import Follower

from . import damages
from .patient import Patient
from .workloads import identify

pytestmark = pytest.mark.slow


@pytest.fixture
def patient(memory):
    return Patient(memory / "w")


def test_every_damage_is_located_or_looks_like_a_torn_write(patient, scale, figures):
    rng = random.Random(3)
    for number in range(scale(2_000, 100_000)):
        patient.suffer(damages.draw(patient.paths, rng), opens_journal=number % 10 == 0)
    figures(**patient.counts)
    assert patient.accepted == []
    assert patient.counts["located"] > 0.9 * patient.counts["damages"]


def test_a_last_record_of_full_length_with_a_wrong_crc_is_refused_and_not_cut(patient, scale, figures):
    rng = random.Random(4)
    path = patient.paths[-1]
    begin, end = damages.find_records(patient.whole[path])[-2:]
    for _ in range(scale(100, 2_000)):
        changed = bytearray(patient.whole[path])
        offset = rng.randrange(begin, end)
        changed[offset] ^= 1 << rng.randrange(8)
        patient.suffer(damages.Damage("flip_bit", path, bytes(changed), offset), opens_journal=True)
    figures(**patient.counts)
    assert patient.counts["located"] == patient.counts["damages"]


def test_a_reader_that_met_damage_misses_nothing_once_it_is_healed(patient, scale, figures):
    rng, met = random.Random(6), 0
    for _ in range(scale(100, 2_000)):
        damage = damages.draw(patient.paths, rng)
        damage.path.write_bytes(damage.data)
        follower, found = Follower(patient.folder), []
        try:
            found += follower.read_new()
        except ExecutionError:
            met += 1
        patient.heal()
        found += follower.read_new()
        follower.close()
        assert [identify(record) for record in found] == patient.told, (damage.kind, damage.path, damage.offset)
    figures(damages=scale(100, 2_000), met=met)
    assert met > 50
