"""The power of a real file system goes; collected only where `real_disk` works (root, a loop device, mkfs.ext4)."""

import pytest

from .processes import run_module
from .real_disk import OPTIONS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("mount", OPTIONS)
def test_the_power_of_a_real_file_system_goes_and_nothing_acknowledged_is_lost(memory, scale, figures, mount):
    cuts = scale(12, 2_500)
    answer = run_module("power_rounds", "--scratch", memory, "--cuts", cuts, "--mount", mount)
    counts = answer["counts"]
    figures(**counts)
    assert answer["errors"] == []
    assert counts["cuts"] == cuts
    assert counts["acknowledged"] > cuts
    assert counts["refused"] <= max(2, cuts // 20)  # a page of zeros inside the last record: only a person can tell
    for fault in ("lost", "broken_batches", "readers_differ"):
        assert counts[fault] == 0, fault


def test_on_a_real_file_system_too_a_store_that_does_not_sync_is_caught(memory, scale, figures):
    caught, runs = 0, scale(1, 20)
    for seed in range(runs):
        answer = run_module("power_rounds", "--scratch", memory, "--cuts", 10, "--seed", seed, "--no-sync")
        caught += answer["counts"]["lost"] > 0
    figures(runs=runs, caught=caught)
    assert caught == runs
