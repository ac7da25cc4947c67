"""What rots is located or refused, never believed."""

import random
from collections import Counter

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.store import records
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


@pytest.mark.parametrize("kind", damages.KINDS)
def test_every_kind_of_damage_is_met_in_every_file(patient, scale, figures, kind):
    rng = random.Random(kind)
    for path in patient.paths:
        for _ in range(scale(4, 200)):
            patient.suffer(damages.draw([path], rng, kind), opens_journal=True)
    figures(**patient.counts)
    assert patient.accepted == []


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


@pytest.mark.parametrize("number", [0, 1])
def test_a_missing_segment_is_located(patient, number):
    patient.paths[number].unlink()
    for look in (patient.follow, patient.open):
        try:
            *_, message = look()
        except ExecutionError as error:
            message = str(error)
        assert "JOURNAL_DAMAGED" in message
        assert damages.find_place(message)[0] <= patient.paths[number + 1].stem


def test_a_store_without_checksums_is_caught(memory, scale, figures, monkeypatch):
    monkeypatch.setattr(records, "compute_crc", lambda *_: 0)
    rng, caught, runs = random.Random(8), 0, scale(1, 20)
    told = Counter()
    for number in range(runs):
        patient = Patient(memory / f"w{number}")
        for _ in range(100):
            patient.suffer(damages.draw(patient.paths, rng), opens_journal=False)
        caught += patient.counts["accepted"] > 0
        told += patient.counts
    figures(runs=runs, caught=caught, **told)
    assert caught == runs


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
