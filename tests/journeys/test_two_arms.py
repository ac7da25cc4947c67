"""Two arms at one table, in one simulated time: what ends the work of one, and what that is to the other."""

import os
import shutil
import signal
from functools import cache

import msgspec
import pytest

from phyagentos.assembly.paths import make_socket_folder
from phyagentos.clock import SystemClock
from phyagentos.fork_server import start_python
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId, Scene, Session, SessionId
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal
from tests.following import wait_until
from tests.strangers import wait_in_the_backlog

pytestmark = pytest.mark.journey

ARMS = ("left_arm", "right_arm")
LIMIT_S = 90.0
ENDS = ("finish", "confirm_cancel", "reconcile")
CLOCK = SystemClock()


class TwoArms:
    """A watched workspace with two simulated arms; what its journal says, in order."""

    def __init__(self, root, project, scene, *options):
        self.scene = scene
        self.workspace = Workspace.create(root / "w", Library.open(project))
        command = ["-m", "phyagentos", "watch", "--workspace", str(root / "w"), "--no-pictures"]
        self._command, self._log = [*command, *options], root / "watch.log"
        self.start()
        self.journal = Journal(self.workspace.root, side=Side.AGENT, by="journey", clock=CLOCK)
        self.follower = Follower(self.journal.folder)
        self.round = 0
        self.begin_round()

    def start(self):
        with self._log.open("ab") as log:
            self.process = start_python(self._command, log)

    def begin_round(self):
        """Sessions from now on are of a scene of their own; what others did is forgotten."""
        self.round += 1
        self.told: list[tuple[str, str]] = []
        self.executions: dict[str, dict] = {}
        self.logged = {arm: len(self.read_log(arm)) for arm in ARMS}

    def name(self, id):
        return f"{id}-{self.round}" if id else ""

    def read_log(self, arm):
        log = self.workspace.logs / f"receive-{arm}.jsonl"
        return log.read_text() if log.exists() else ""

    def submit(self, id, arm, skill, **parameters):
        session = Session(
            id=SessionId(self.name(id)),
            goal=GoalId(""),
            node="",
            objective="",
            skill=skill,
            target=arm,
            parameters=parameters,
            accept=(),
            scene=Scene(name=self.scene, seed=1, episode=self.name("both")),
            seed=1,
        )
        self.journal.commit([Entry(session.id, "submit", msgspec.to_builtins(session))])

    def wait_for(self, id, *events):
        def has_come():
            for record in self.follower.read_new():
                told = record.id.removesuffix(f"-{self.round}")
                self.told.append((told, record.ev))
                if "execution" in (record.body or {}):
                    self.executions[told] = record.body["execution"]
            return {(id, event) for event in events} & {*self.told}

        wait_until(has_come, f"{id} {events}", LIMIT_S)

    def wait_until_both_move(self):
        wait_until(lambda: all('"Command"' in self.read_log(arm)[self.logged[arm] :] for arm in ARMS))

    def wait_until_both_stand(self):
        """One is paused, and the other waits for it."""
        beats = self.workspace.heartbeats
        wait_until(lambda: {find_heartbeat(beats, arm).phase for arm in ARMS} == {"paused"})

    def signal(self, kind, session):
        drop_signal(self.workspace.signals, Signal(kind=kind, session=self.name(session), by="test"), CLOCK)

    def end_round(self):
        """Until both arms are free for the next one."""
        for id in ("left", "right"):
            self.wait_for(id, *ENDS)

    def find_span(self, id):
        return self.told.index((id, "start")), self.told.index((id, "finish"))

    def stop(self):
        self.process.terminate()
        self.process.wait(30)
        self.journal.close()
        self.follower.close()


def replace(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """The shipped scene, watched, in either mode; each is made when it is first asked for."""

    @cache
    def make(mode):
        folder = tmp_path_factory.mktemp(f"table-{len(made)}")
        shutil.copytree(find_shipped_root() / "examples" / "projects" / "04_two_arms", folder / "project")
        if mode == "realtime":
            slow_down(folder / "project")
        made.append(TwoArms(folder, folder / "project", "two_arms", "--world-mode", mode))
        return made[-1]

    made = []
    yield make
    for arms in made:
        arms.stop()


@pytest.fixture
def one_table(tables):
    """Both arms at work at one table, each with its cube."""

    def start(mode="lockstep"):
        started.append(arms := tables(mode))
        arms.begin_round()
        arms.submit("left", "left_arm", "pick_and_place", object="red_cube", destination="red_tray")
        arms.submit("right", "right_arm", "pick_and_place", object="blue_cube", destination="blue_tray")
        arms.wait_for("left", "start")
        arms.wait_for("right", "start")
        arms.wait_until_both_move()
        return arms

    started = []
    yield start
    for arms in started:
        arms.end_round()


def slow_down(project):
    """Control periods of 0.1 s, so that a machine with much to do still meets them."""
    shutil.copy(find_shipped_root() / "protocol" / "runtime_contract.yaml", project / "protocol")
    for file in ("protocol/runtime_contract.yaml", *(f"robots/{arm}/target.yaml" for arm in ARMS)):
        replace(project / file, "control_period_s: 0.02", "control_period_s: 0.1")
    replace(project / "protocol" / "safety.yaml", "value: 0.1\n      unit: s", "value: 0.5\n      unit: s")
    replace(project / "protocol" / "safety.yaml", "value: 50.0\n      unit: 1/s", "value: 10.0\n      unit: 1/s")


def test_at_one_table_an_adopted_world_listens_to_no_stranger_while_its_workers_are_replaced(one_table):
    """First all of them, with their watchdog; then one, which has its key over the socket."""
    arms = one_table()
    starts = arms.read_log("right_arm").count('"process_start"')
    socket = make_socket_folder(arms.workspace.root) / "right_arm.world"
    with wait_in_the_backlog(socket, arms.name("right")) as told:
        arms.process.kill()
        arms.process.wait()
        arms.start()
        arms.end_round()
        assert {arms.executions[name]["ended"] for name in ("left", "right")} == {"runner_lost"}

        one_table()
        os.kill(find_heartbeat(arms.workspace.heartbeats, "right_arm").pid, signal.SIGKILL)
        arms.end_round()

    assert [arms.executions[name]["ended"] for name in ("left", "right")] == ["completed", "runner_lost"]
    assert (told.sent > 2, told.heard) == (True, [])
    assert arms.read_log("right_arm").count('"process_start"') == starts, "it is the same world"


@pytest.mark.parametrize("ended", ["cancelled", "runner_lost"])
def test_at_one_table_an_arm_that_waits_for_a_paused_one_is_stopped_all_the_same(one_table, ended):
    arms = one_table()
    arms.signal("pause", "left")
    arms.wait_until_both_stand()
    if ended == "cancelled":
        arms.signal("cancel", "right")
    else:
        os.kill(find_heartbeat(arms.workspace.heartbeats, "right_arm").pid, signal.SIGKILL)
    arms.wait_for("right", *ENDS)

    assert arms.executions["right"]["ended"] == ended
    assert ("left", "finish") not in arms.told
    arms.signal("resume", "left")
    arms.wait_for("left", "finish")
    assert arms.executions["left"]["ended"] == "completed"


@pytest.mark.alone
def test_at_one_table_both_work_in_real_time_until_an_emergency_stop_ends_both(one_table):
    arms = one_table("realtime")
    arms.wait_for("left", "finish")
    arms.wait_for("right", "finish")

    assert [arms.executions[name]["ended"] for name in ("left", "right")] == ["completed", "completed"]
    spans = [arms.find_span(name) for name in ("left", "right")]
    assert max(start for start, _ in spans) < min(end for _, end in spans)  # at once

    one_table("realtime")
    arms.signal("estop", "")
    arms.wait_for("left", "finish")
    arms.wait_for("right", "finish")
    assert [arms.executions[name]["code"] for name in ("left", "right")] == ["ESTOPPED", "ESTOPPED"]
