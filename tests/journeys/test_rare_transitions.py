"""Rare rows of both statecharts, with real processes: workers that die, hang or are deaf, and operators that cancel."""

import json
import threading
from pathlib import Path

import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Limits
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision import target_supervisor, watchdog
from phyagentos.runtime.supervision.workers import Worker
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import make_contract
from tests.following import Followed, wait_until

from .reached import read_phase_arrows

pytestmark = pytest.mark.journey

CLOCK = SystemClock()
PATIENCE_S = 30.0
STARTED = ["submit", "claim", "check", "start"]


class Stand:
    """A workspace with one target, a watchdog in a thread, and scripted worker processes."""

    def __init__(self, root: Path) -> None:
        self.workspace = Workspace.create(root, Library(()))
        self._plan = root / "plan.json"
        self._pens = {side: Journal(root, side=side, by=side.value, clock=CLOCK) for side in Side}
        self._followed = Followed(self._pens[Side.AGENT].read_new)
        self._watchdog = watchdog.Watchdog(
            workspace=self.workspace,
            journal=self._pens[Side.RUNTIME],
            hire=self._hire,
            clock=CLOCK,
            publish=lambda: None,
            rest_s=0.01,
        )
        self._thread = threading.Thread(target=self._watchdog.run, daemon=True)

    def _hire(self, target: str) -> Worker:
        script = ["-m", "tests.journeys.scripted_worker", str(self._plan)]
        return Worker(target, world=None, worker=script, logs=self.workspace.logs, socket=Path())

    def play(self, *plan: dict[str, str], **limits: float) -> None:
        """Submit one session to a target whose worker processes behave as planned."""
        self._plan.write_text(json.dumps([*plan]))
        self.record(Side.AGENT, "submit", make_contract(goal="", limits=Limits(**limits)))
        self._thread.start()

    def record(self, side: Side, event: str, body: object = None) -> None:
        self._pens[side].commit([Entry("g.a", event, body)])

    def cancel(self) -> None:
        drop_signal(self.workspace.signals, Signal(kind="cancel", session="g.a", by="test"), CLOCK)

    def wait_for(self, state: str) -> list[str]:
        """Follow the session to a state; its events so far."""
        self._followed.wait_for("g.a", state)
        return self._followed.events("g.a")

    def wait_for_phase(self, *arrow: str) -> None:
        wait_until(lambda: arrow in read_phase_arrows(self.workspace.root), str(arrow))

    def close(self) -> None:
        self._watchdog.stop()
        self._thread.join(PATIENCE_S)
        for pen in self._pens.values():
            pen.close()


@pytest.fixture
def stand(tmp_path, monkeypatch):
    monkeypatch.setattr(watchdog, "POLL_S", 0.02)
    monkeypatch.setattr(target_supervisor, "STOP_GRACE_S", 0.3)
    stand = Stand(tmp_path / "w")
    yield stand
    stand.close()


@pytest.mark.parametrize(
    ("plan", "events", "phases"),
    [
        (
            [{"check": "die"}, {}],
            ["submit", "claim", "check", "lose", "reconcile"],
            [("checking", "lose", "starting"), ("reconciling", "free", "idle")],
        ),
        ([{"run": "die"}, {}], [*STARTED, "lose", "reconcile"], [("running", "lose", "starting")]),
        (
            [{"run": "die"}, {"reconcile": "die"}, {}],
            [*STARTED, "lose", "reconcile"],
            [("reconciling", "lose", "resting"), ("resting", "replace", "starting")],
        ),
        (
            [{"run": "die"}, {"reconcile": "die"}],
            [*STARTED, "lose", "reconcile"],
            [("reconciling", "lose", "broken")],
        ),
        (
            [{"run": "die"}, {"reconcile": "lost"}],
            [*STARTED, "lose", "reconcile"],
            [("reconciling", "give_up", "broken")],
        ),
        (
            [{"check": "slow lost"}, {}],
            ["submit", "claim", "check", "release", *STARTED[1:], "halt", "finish"],
            [("checking", "replace", "starting")],
        ),
        ([{"start": "die"}, {}], [*STARTED, "halt", "finish"], [("starting", "lose", "resting")]),
    ],
    ids=["dies checking", "dies running", "dies observing", "never observes", "loses targets", "loses one", "dies"],
)
def test_what_a_worker_leaves_is_observed_and_judged(stand, plan, events, phases):
    stand.play(*plan)
    assert stand.wait_for("awaiting_verification") == events
    for phase in phases:
        stand.wait_for_phase(*phase)


@pytest.mark.parametrize(
    ("plan", "limits", "events", "phase"),
    [
        ([{"check": "refuse"}], {}, ["submit", "claim", "check", "reject"], ("checking", "free", "idle")),
        (
            [{"check": "hang"}, {}],
            {"preflight_s": 0.2},
            ["submit", "claim", "check", "reject"],
            ("checking", "replace", "starting"),
        ),
        ([{"check": "refuse and leave"}, {}], {}, ["submit", "claim", "check", "reject"], ("idle", "lose", "starting")),
        ([{"start": "die"}], {}, ["submit", "reject"], ("starting", "lose", "broken")),
    ],
    ids=["refused", "checked too long", "refused by a worker that leaves", "no worker starts"],
)
def test_a_session_of_which_nothing_was_commanded_is_rejected(stand, plan, limits, events, phase):
    stand.play(*plan, **limits)
    assert stand.wait_for("rejected") == events
    stand.wait_for_phase(*phase)


def test_a_pending_session_is_amended_and_cancelled(stand):
    stand.record(Side.AGENT, "submit", make_contract(goal=""))
    stand.record(Side.OPERATOR, "amend", {"limits": {"timeout_s": 9.0}})
    stand.record(Side.OPERATOR, "cancel", {"reason": "enough"})
    stand._thread.start()
    assert stand.wait_for("cancelled") == ["submit", "amend", "cancel"]


@pytest.mark.parametrize(
    ("plan", "state", "events"),
    [
        ({"check": "until stopped"}, "preflight", STARTED[:3]),
        ({"run": "until stopped"}, "running", STARTED),
    ],
)
def test_a_session_is_cancelled_once_its_target_is_at_rest(stand, plan, state, events):
    stand.play(plan)
    stand.wait_for(state)
    stand.cancel()
    assert stand.wait_for("cancelled") == [*events, "request_cancel", "confirm_cancel"]


def test_a_session_that_awaits_its_verdict_is_cancelled_at_once(stand):
    stand.play({})
    stand.wait_for("awaiting_verification")
    stand.cancel()
    assert stand.wait_for("cancelled") == [*STARTED, "halt", "finish", "cancel"]


def test_a_worker_that_does_not_stop_is_lost(stand):
    stand.play({"run": "deaf"}, {}, wall_timeout_s=0.2)
    stand.wait_for("halting")
    assert stand.wait_for("awaiting_verification") == [*STARTED, "halt", "lose", "reconcile"]


def test_so_is_one_whose_session_is_cancelled_meanwhile(stand, monkeypatch):
    monkeypatch.setattr(target_supervisor, "STOP_GRACE_S", 2.0)
    stand.play({"run": "deaf"}, {}, wall_timeout_s=0.2)
    stand.wait_for("halting")
    stand.cancel()
    events = [*STARTED, "halt", "request_cancel", "lose", "reconcile"]
    assert stand.wait_for("awaiting_verification") == events
