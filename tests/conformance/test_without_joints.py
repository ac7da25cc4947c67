"""A body without joints, started by the driver `kit`: its tools keep authority, stops, arguments and bits."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.drivers.kit import open_kit
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget

MAKER = Path(__file__).resolve().parents[2] / "examples" / "projects" / "11_workbench" / "robots" / "maker"
EMPTY = np.empty((1, 0))

pytestmark = pytest.mark.slow


class Bench:
    """The maker of the example under authority, and one session's count of commands and calls."""

    def __init__(self, folder, log=None):
        self.log = log
        self.is_stopped = False
        driver = open_kit(read_target(folder / "target.yaml"), folder)
        self.target = ServedTarget(driver, ReceiveLog(log), is_estopped=lambda: self.is_stopped)
        self.epoch = 0

    def begin(self, seed=1, snapshot=b""):
        self.epoch, self.commands, self.calls = self.epoch + 1, 0, 0
        self.ask(wire.LoadScene("clearing", seed, f"e{self.epoch}", snapshot))
        assert self.ask(wire.Begin("s", self.epoch)) == wire.Ack()

    def ask(self, request):
        return self.target.handle(request)

    def call(self, tool, session="s", **goal):
        self.calls += 1
        return self.ask(wire.Call(session, self.epoch, self.calls, tool, goal, 1.0))

    def step(self):
        self.commands += 1
        return self.ask(
            wire.Command("s", self.epoch, self.commands, self.target.time_s + 0.4, EMPTY, EMPTY, np.zeros(1))
        )

    def finish(self, tool, **goal):
        progress = self.call(tool, **goal)
        while isinstance(progress, wire.Progress) and not progress.state.has_ended:
            assert isinstance(self.step(), wire.Step)
            progress = self.ask(wire.Follow("s", self.epoch, self.calls))
        return progress

    @property
    def state(self):
        return self.ask(wire.Observe()).target


@pytest.fixture
def bench(tmp_path):
    made = Bench(MAKER, tmp_path / "receive.jsonl")
    yield made
    made.target.close()


def test_each_step_of_a_tool_is_one_command_and_its_end_is_what_it_says(bench):
    bench.begin()
    before = bench.target.time_s
    progress = bench.finish("gather", item="wood", amount=2)

    assert progress.state is wire.CallState.ABORTED
    assert progress.message == "there is no wood here; it is found at a tree"
    assert bench.target.time_s == before, "what cannot begin takes no time"
    assert bench.finish("walk_to", place="tree").state is wire.CallState.SUCCEEDED
    assert bench.finish("gather", item="wood", amount=2).message == "has 2 wood"
    assert bench.state.inventory == {"wood": 2}
    assert bench.target.time_s == pytest.approx(0.1 * bench.commands)


def test_what_a_tool_does_not_take_is_refused_and_nothing_moves(bench):
    bench.begin()
    for goal in ({}, {"place": 3}, {"place": "moon"}, {"place": "tree", "fast": True}):
        refused = bench.call("walk_to", **goal)
        assert (refused.code, bench.target.time_s) == ("REQUEST_INVALID", 0.0), goal
    assert bench.call("fly").code == "REQUEST_INVALID"


def test_a_tool_needs_authority_and_one_is_at_work_at_a_time(bench):
    bench.ask(wire.LoadScene("clearing", 1, "e"))
    bench.calls, bench.epoch = 0, 1
    assert bench.call("wait", steps=3).code == "NO_AUTHORITY"
    assert bench.ask(wire.Begin("s", 1)) == wire.Ack()
    assert bench.call("wait", session="other", steps=3).code == "NO_AUTHORITY"
    assert bench.call("wait", steps=3).state is wire.CallState.RUNNING
    assert bench.call("walk_to", place="tree").state is wire.CallState.RUNNING
    assert bench.ask(wire.Follow("s", 1, bench.calls - 1)).state is wire.CallState.CANCELLED, "the next one takes over"


@pytest.mark.parametrize("how", ["halt", "stop", "cancel"])
def test_a_tool_ends_between_two_steps(bench, how):
    bench.begin()
    bench.call("walk_to", place="bench")
    bench.step()
    at = bench.state.base
    if how == "halt":
        bench.ask(wire.Halt("s", 1))
    elif how == "cancel":
        bench.ask(wire.Cancel("s", 1, bench.calls))
    else:
        bench.is_stopped = True
        assert bench.step().code == "ESTOPPED"
        assert bench.call("eat").code == "ESTOPPED"
    assert at == (2.0, 1.0, 0.0)
    if how != "stop":
        assert bench.ask(wire.Follow("s", 1, bench.calls)).state is wire.CallState.CANCELLED
        assert isinstance(bench.step(), wire.Step)
    assert bench.state.base == at, "nothing moves any more"


def test_calls_stand_in_the_receive_log(bench):
    bench.begin()
    bench.finish("walk_to", place="tree")
    lines = bench.log.read_text()
    assert lines.count('"kind":"Call"') == 1
    assert lines.count('"kind":"Command"') == bench.commands


def test_the_same_snapshot_and_calls_give_the_same_bits_and_another_seed_others(bench):
    def gather():
        bench.finish("walk_to", place="tree")
        bench.finish("gather", item="wood", amount=9)
        return bench.ask(wire.Observe(snapshot=True)).snapshot.data

    ends = []
    bench.begin(seed=1)
    start = bench.ask(wire.Observe(snapshot=True)).snapshot.data
    ends.append(gather())
    for seed, snapshot in ((5, start), (2, b"")):
        bench.ask(wire.End("s", bench.epoch))
        bench.begin(seed, snapshot)
        ends.append(gather())
    assert ends[1] == ends[0]
    assert ends[2] != ends[0]


def test_a_body_that_does_not_start_is_named_with_its_profile(tmp_path):
    folder = tmp_path / "maker"
    shutil.copytree(MAKER, folder)
    (folder / "workbench.py").write_text("raise RuntimeError('no bench')\n")
    with pytest.raises(DefinitionError, match=r"target\.yaml: NO_DRIVER: found exit status 1"):
        open_kit(read_target(folder / "target.yaml"), folder)
    text = (folder / "target.yaml").read_text()
    (folder / "target.yaml").write_text(text.replace("{module: workbench}", "{python: " + sys.executable + "}"))
    with pytest.raises(DefinitionError, match=r"NO_DRIVER: found no settings\.module"):
        open_kit(read_target(folder / "target.yaml"), folder)
