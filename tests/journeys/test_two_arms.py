"""Two arms and one tray: each arm has its own queue, and what both reach they use in turn."""

import re
import shutil
import subprocess
import sys

import msgspec
import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId, Scene, Session, SessionId
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal

pytestmark = pytest.mark.journey

ARMS = ("left_arm", "right_arm")
LIMIT_S = 60.0
CLOCK = SystemClock()


class TwoArms:
    """A watched workspace with two simulated arms; what its journal tells, in order."""

    def __init__(self, root):
        project = root / "project"
        for arm in ARMS:
            shutil.copytree(find_shipped_root() / "robots" / "panda", project / "robots" / arm)
            replace(project / "robots" / arm / "target.yaml", "target: panda", f"target: {arm}")
        self.workspace = Workspace.create(root / "w", Library.open(project))
        replace(self.workspace.runtime_contract, "resources: []", "resources: [tray]")
        limits = self.workspace.safety.read_text()
        (own,) = re.findall(r"(?ms)^  panda:\n(.*)", limits)
        self.workspace.safety.write_text(limits + "".join(f"\n  {arm}:\n{own}" for arm in ARMS))
        command = [sys.executable, "-m", "phyagentos", "watch", "--workspace", str(root / "w"), "--no-pictures"]
        with (root / "watch.log").open("wb") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        self.journal = Journal(self.workspace.root, side=Side.AGENT, by="journey", clock=CLOCK)
        self.follower = Follower(self.journal.folder)
        self.told: list[tuple[str, str]] = []

    def submit(self, id, arm, skill, *resources, **parameters):
        session = Session(
            id=SessionId(id),
            goal=GoalId(""),
            node="",
            objective="",
            skill=skill,
            target=arm,
            parameters=parameters,
            accept=(),
            scene=Scene(name="tabletop/cubes_and_trays", seed=1, episode=arm),
            seed=1,
            resources=resources,
        )
        self.journal.commit([Entry(session.id, "submit", msgspec.to_builtins(session))])

    def wait_for(self, id, event):
        deadline_s = CLOCK.now_s() + LIMIT_S
        while (id, event) not in self.told:
            assert CLOCK.now_s() < deadline_s, f"{id} never came to {event}: {self.told}"
            CLOCK.sleep(0.01)
            self.told += [(record.id, record.ev) for record in self.follower.read_new()]

    def signal(self, kind, session):
        drop_signal(self.workspace.signals, Signal(kind=kind, session=session, by="test"), CLOCK)

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


@pytest.fixture
def two_arms(tmp_path):
    arms = TwoArms(tmp_path)
    yield arms
    arms.stop()


def test_two_arms_work_side_by_side_and_take_turns_at_what_both_reach(two_arms):
    two_arms.submit("long", "left_arm", "pick_and_place", "tray", object="red_cube", destination="red_tray")
    two_arms.submit("first", "right_arm", "home")  # so that both arms get ready at once
    two_arms.wait_for("long", "start")
    two_arms.signal("pause", "long")  # it keeps its arm and the tray until it is told to go on
    two_arms.submit("free", "right_arm", "home")
    two_arms.submit("needy", "right_arm", "home", "tray")
    two_arms.submit("behind", "left_arm", "home")
    two_arms.wait_for("free", "finish")
    two_arms.signal("resume", "long")
    two_arms.wait_for("needy", "finish")
    two_arms.wait_for("behind", "finish")

    long, free, needy, behind = map(two_arms.find_span, ("long", "free", "needy", "behind"))
    assert long[0] < free[0] < free[1] < long[1]  # two arms at once
    assert long[1] < needy[0]  # one tray, in turn, though the other arm was idle
    assert long[1] < behind[0]  # one arm, in turn
