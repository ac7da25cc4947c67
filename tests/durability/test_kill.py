"""kill -9 of random writers: what `commit` returned stands, and nobody sees half of anything."""

import pytest

from .processes import run_module

pytestmark = pytest.mark.slow


def test_random_writers_are_killed_and_nothing_acknowledged_is_lost(memory, scale, figures):
    kills = scale(200, 20_000)
    answer = run_module("kill_rounds", "--scratch", memory, "--kills", kills)
    counts = answer["counts"]
    figures(**counts)
    assert answer["errors"] == []
    assert counts["kills"] == kills
    assert counts["acknowledged"] > kills
    assert counts["repairs"] > 0
    assert counts["archived"] > 0 or kills < 1_000  # chance, in a few rounds
    for fault in ("lost", "vanished", "broken_batches", "readers_differ", "folds_differ"):
        assert counts[fault] == 0, fault
