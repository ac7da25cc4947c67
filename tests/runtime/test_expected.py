"""What the agent will probably submit next is checked before, which changes nothing but the time that it takes."""

import msgspec
import pytest

from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.sessions.outlook import Outlook
from phyagentos.protocol.sessions.session import Scene
from phyagentos.runtime.worker.orders import Check, Checked, send

from .test_ahead import tell
from .test_watchdog import PLAN, TOOLS, ScriptedWorker, make_session, stand  # noqa: F401 - a fixture


def expect(stand, session) -> None:  # noqa: F811
    Outlook(stand.workspace.cache).expect(session)


def test_what_is_expected_is_checked_before_it_is_submitted_and_started_when_it_is(stand):  # noqa: F811
    expect(stand, make_session("g.b"))
    stand.submit(make_session("g.a"))
    stand.watch(worker := ScriptedWorker())
    stand.wait_for("g.a", "awaiting_verification")

    stand.submit(make_session("g.b"))
    stand.wait_for("g.b", "awaiting_verification")

    assert tell(worker) == [(kind, id) for id in ("g.a", "g.b") for kind in ("Check", "Run")]
    assert [order.is_expected for order in worker.orders if isinstance(order, Check)] == [False, True]
    assert stand.events("g.b") == ["submit", "claim", "start", "finish"]


@pytest.mark.parametrize(
    "changes",
    [
        {"parameters": {"object": "another"}},
        {"id": "g.c"},
    ],
)
def test_what_was_expected_otherwise_is_checked_anew(stand, changes):  # noqa: F811
    expected = make_session("g.b")
    expect(stand, expected)
    stand.submit(make_session("g.a"))
    stand.watch(worker := ScriptedWorker())
    stand.wait_for("g.a", "awaiting_verification")

    submitted = msgspec.structs.replace(expected, **changes)
    stand.submit(submitted)
    stand.wait_for(submitted.id, "awaiting_verification")

    checked = [(order.session, order.is_expected) for order in worker.orders if isinstance(order, Check)]
    assert checked[1:3] == [(expected, True), (submitted, False)]


def test_an_expected_session_that_fails_its_check_is_not_refused_for_that(stand):  # noqa: F811
    def check(order: Check) -> Checked:
        problem = Problem(code="X", address=order.session.id, found="too early")
        if order.is_expected:
            return Checked(session=order.session.id, plan=None, tools=None, problems=(problem,))
        return Checked(session=order.session.id, plan=PLAN, tools=TOOLS)

    expect(stand, make_session("g.b"))
    stand.submit(make_session("g.a"))
    stand.watch(ScriptedWorker(on_check=check))
    stand.wait_for("g.a", "awaiting_verification")

    stand.submit(make_session("g.b"))

    stand.wait_for("g.b", "awaiting_verification")


class LateWorker(ScriptedWorker):
    """Answers a check that came too early only when it is told to, and then with a problem."""

    def send(self, order) -> None:
        if isinstance(order, Check) and order.is_expected:
            self.orders.append(order)
        else:
            super().send(order)

    def answer(self) -> None:
        problem = Problem(code="X", address="g.b", found="too early")
        send(self._theirs, Checked(session="g.b", plan=None, tools=None, problems=(problem,)))


def test_nor_is_one_that_was_submitted_before_its_early_check_was_answered(stand):  # noqa: F811
    expect(stand, make_session("g.b"))
    stand.submit(make_session("g.a"))
    stand.watch(worker := LateWorker())
    stand.wait_for("g.a", "awaiting_verification")
    stand.submit(make_session("g.b"))
    stand.clock.sleep(0.2)  # until its turn has come

    worker.answer()

    stand.wait_for("g.b", "awaiting_verification")
    assert tell(worker) == [("Check", "g.a"), ("Run", "g.a"), ("Check", "g.b"), ("Check", "g.b"), ("Run", "g.b")]


@pytest.mark.parametrize(
    "changes",
    [
        {"scene": Scene(name="elsewhere", seed=0, episode="g")},
        {"lookahead": LookaheadRequest(threshold=0.5)},
        {"resources": ("tray",)},
        {"goal": "another"},
        {"id": "g.a"},
    ],
)
def test_nothing_is_checked_before_it_is_submitted_that_may_disturb_what_runs(stand, changes):  # noqa: F811
    expect(stand, msgspec.structs.replace(make_session("g.b"), **changes))
    stand.submit(make_session("g.a"))
    stand.watch(worker := ScriptedWorker())

    stand.wait_for("g.a", "awaiting_verification")

    assert tell(worker) == [("Check", "g.a"), ("Run", "g.a")]
