"""After a repair the lane works again, holds what could be proved, and no record that was never written."""

import random
import shutil
from collections import Counter

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.store.follower import Follower
from phyagentos.store.recovery.inspection import inspect_partition
from phyagentos.store.recovery.repair import repair_partition
from phyagentos.store.segments import SystemIO
from phyagentos.testing import ManualClock

from . import damages, second_reader
from .test_damage_and_checkpoint import KeptPatient
from .workloads import DAY_S, LANE, identify

pytestmark = pytest.mark.slow

OWN_EVENTS = {"lost", "repair"}


def test_every_damage_can_be_repaired_and_nothing_is_made_up(memory, scale, figures):
    rng, told = random.Random(31), Counter()
    whole = KeptPatient(memory / "whole")
    for _ in range(scale(80, 4_000)):
        damage = damages.draw([*whole.paths, whole.checkpoint], rng)
        root = memory / "w"
        shutil.copytree(whole.root, root)
        (root / damage.path.relative_to(whole.root)).write_bytes(damage.data)
        try:
            stands = repair_and_read(root, whole)
        except Exception as error:
            error.add_note(f"{damage.kind} of {damage.path.name} at {damage.offset}")
            raise
        kept = [identity for identity in stands if identity[2] not in OWN_EVENTS]
        told["made_up"] += len(set(kept) - set(whole.told))
        told["kept"] += len(kept)
        told["lost_and_said_so"] += sum(identity[2] == "lost" for identity in stands)
        told["damages"] += 1
        shutil.rmtree(root)
    figures(**told)
    assert told["made_up"] == 0
    assert told["kept"] > 0.5 * told["damages"] * len(whole.told)


def repair_and_read(root, whole):
    """Repair with every loss accepted; identities of all records, on which both readers agree."""
    folder, clock = root / "sessions" / LANE, ManualClock(whole.clock.now_s() + DAY_S)
    repair_partition(folder, accept_loss=True, by="operator", clock=clock, file_io=SystemIO())
    found = inspect_partition(folder)
    assert found.is_whole, [str(each) for each in found.findings]
    follower = Follower(folder)
    try:
        stands = [identify(record) for record in follower.read_new()]
    except ExecutionError as error:
        raise AssertionError(f"not whole after a repair: {error}") from error
    finally:
        follower.close()
    assert stands == [second_reader.identify(record) for record in second_reader.read_lane(root, LANE)]
    assert [seq for seq, *_ in stands] == list(range(1, len(stands) + 1))
    return stands
