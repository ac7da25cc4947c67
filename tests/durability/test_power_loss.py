"""The power goes at any moment: what was acknowledged stands, and nothing that was half written is believed."""

import itertools
import random
import shutil

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.follower import Follower
from phyagentos.store.history import fold
from phyagentos.store.journal import Journal
from phyagentos.store.segments import SystemIO
from phyagentos.testing import ManualClock

from . import second_reader
from .disk_model import Recorder, Step, build_image, read_folder
from .interception import intercept
from .workloads import COMMANDS, LANE, NOON_S, Bench, identify, list_live, make_submit

pytestmark = pytest.mark.slow

WORKLOADS = [names for length in (1, 2, 3) for names in itertools.product(COMMANDS, repeat=length)]
CHANCES = (0.0, 1.0, 0.5, 0.2, 0.8)
LATER_S = NOON_S + 10 * 86_400.0


class SplitIO(SystemIO):
    """The system takes a few bytes at a time."""

    def write(self, fd, data):
        return super().write(fd, data[:300])


class Killed(BaseException):
    """Stands in for kill -9: no handler of the store may catch it."""


def record(root, names, *, die_at=None) -> list[Step]:
    """Steps of a workload; with `die_at`, of one that dies there, and of another process that goes on."""
    root.mkdir()
    seen = itertools.count()

    def on_step(_):
        if next(seen) == die_at:
            raise Killed

    recorder = Recorder(root, on_step=on_step)
    with intercept(recorder):
        bench = Bench(root, lambda records: recorder.steps.append(tell(records)), file_io=SplitIO())
        try:
            for name in names:
                bench.run(name)
        except Killed:
            bench.close()
            heir = Bench(root, lambda records: recorder.steps.append(tell(records)))
            heir.commit(Side.AGENT, [make_submit("heir")])
            heir.run("checkpoint")
            heir.close()
        bench.close()
    everything = build_image(recorder.steps, 1.0, random.Random(0))
    assert everything.files == read_folder(root), "something changed the folder without a call that can be recorded"
    return recorder.steps


def tell(records):
    return Step("ack", told=tuple(identify(record) for record in records))


class Judge:
    """Opens images and counts."""

    def __init__(self, memory, rng):
        self.memory, self.rng = memory, rng
        self.counts = dict.fromkeys(("images", "acknowledged", "lost", "torn_exposed", "refused", "cut"), 0)

    def judge(self, steps, chance, intended):
        """Open one image; `intended` are the identities of everything that was ever written whole."""
        root = self.memory / "image"
        image = build_image(steps, chance, self.rng)
        image.write(root)
        try:
            self._count(root, image, intended)
        finally:
            shutil.rmtree(root)

    def _count(self, root, image, intended):
        folder = root / "sessions" / LANE
        try:
            journal = Journal(
                root, side=Side.RUNTIME, by="after", partition=LANE, clock=ManualClock(LATER_S), durable=False
            )
        except ExecutionError as error:
            if error.code != "JOURNAL_DAMAGED":
                raise
            found = read_before_damage(folder)
            self.counts["refused"] += 1
        else:
            found = journal.read_new()
            journal.close()
            again = Journal(
                root, side=Side.AGENT, by="after", partition=LANE, clock=ManualClock(LATER_S), durable=False
            )
            ledger = again.open_ledger()  # from the checkpoint, where one has survived
            again.commit([make_submit("afterwards")])
            for record in again.read_new():
                ledger.apply(record)
            again.close()
            follower = Follower(folder)
            stands = follower.read_new()
            follower.close()
            whole = [identify(record) for record in stands]
            assert list_live(ledger) == list_live(fold(stands)), "the checkpoint tells another story"
            twice = second_reader.read_lane(root, LANE)
            assert whole == [second_reader.identify(record) for record in twice], "the two readers differ"
        repairs = [record for record in found if record.ev == "repair" and record.by == "after"]
        read = {record.seq: identify(record) for record in found if record not in repairs}
        lost = {seq for seq, identity in image.told.items() if read.get(seq) != identity}
        self.counts["images"] += 1
        self.counts["acknowledged"] += len(image.told)
        self.counts["lost"] += len(lost)
        self.counts["cut"] += len(repairs)
        self.counts["torn_exposed"] += len(set(read.values()) - intended)


def read_before_damage(folder):
    follower = Follower(folder)
    try:
        return follower.advance()
    except ExecutionError:  # the very first segment
        return []
    finally:
        follower.close()


def find_intended(root):
    return {second_reader.identify(record) for record in second_reader.read_lane(root, LANE)}


def test_every_short_workload_survives_a_power_cut_at_every_step(memory, scale, figures):
    rng = random.Random(1)
    judge = Judge(memory, rng)
    budget = scale(600, 20_000)
    for names in WORKLOADS:
        root = memory / "recorded"
        steps = record(root, names)
        intended = find_intended(root)
        cases = list(itertools.product(range(len(steps) + 1), CHANCES))
        for cut, chance in rng.sample(cases, min(len(cases), budget // len(WORKLOADS))):
            judge.judge(steps[:cut], chance, intended)
        shutil.rmtree(root)
    figures(workloads=len(WORKLOADS), **judge.counts)
    assert judge.counts["lost"] == judge.counts["torn_exposed"] == 0


def test_the_power_goes_after_one_writer_was_killed_and_another_went_on(memory, scale, figures):
    rng = random.Random(2)
    judge = Judge(memory, rng)
    plan = [
        ("batch", "rotate"),
        ("rotate", "claim"),
        ("batch", "archive"),
        ("checkpoint", "rotate", "checkpoint"),
        ("defer",),
    ]
    kills = 0
    for names in plan:
        root = memory / "recorded"
        length = len(record(root, names))
        shutil.rmtree(root)
        for die_at in range(length):
            steps = record(root, names, die_at=die_at)
            intended = find_intended(root)
            kills += 1
            for chance in (CHANCES * scale(1, 20))[: scale(4, 100)]:
                judge.judge(steps, chance, intended)
            shutil.rmtree(root)
    figures(deaths=kills, **judge.counts)
    assert judge.counts["lost"] == judge.counts["torn_exposed"] == 0
