"""The record `amend`: what an operator may change of a contract, and when; and what a session by hand may not be."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.protocol.sessions.session import Limits
from phyagentos.store.journal import Entry

from .histories import fold


def test_limits_and_priority_change_and_all_else_stays(open_journal, submit, contract):
    open_journal().commit([submit("s"), submit("t", priority=1)])
    operator = open_journal(Side.OPERATOR)
    operator.commit([Entry("s", "amend", {"limits": {"timeout_s": 5}, "priority": 2})])
    operator.commit([Entry("s", "amend", {"limits": {"queue_s": 6.5}})])
    ledger = fold(operator.read_new())

    assert ledger.sessions["s"].contract == contract("s", limits=Limits(timeout_s=5.0, queue_s=6.5), priority=2)
    assert (ledger.sessions["s"].state, ledger.sessions["s"].epoch) == ("pending", 0)
    assert [status.contract.id for status in ledger.iter_pending()] == ["s", "t"]


@pytest.mark.parametrize(
    ("entries", "side", "state"),
    [
        ([], Side.AGENT, "pending"),
        ([], Side.RUNTIME, "pending"),
        ([Entry("s", "claim")], Side.OPERATOR, "claimed"),
    ],
)
def test_only_an_operator_amends_and_only_what_is_pending(open_journal, submit, entries, side, state):
    open_journal().commit([submit("s")])
    open_journal(Side.RUNTIME).commit(entries)
    with pytest.raises(IllegalTransition, match=f"{side} asked for 'amend' in state '{state}'"):
        open_journal(side).commit([Entry("s", "amend", {"priority": 2})])


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"limits": {"timout_s": 5}}, r"found 'timout_s'; expected heartbeat_s.*Did you mean 'timeout_s'"),
        ({"limits": {"timeout_s": 0}}, r"INVALID_VALUE.*> 0"),
        ({"limits": {"timeout_s": "soon"}}, r"Expected `float`, got `str`"),
        ({"priority": 1.5}, r"Expected `int"),
        ({"skill": "wave"}, r"unknown field `skill`"),
    ],
)
def test_an_amendment_that_is_none_is_refused(open_journal, submit, body, message):
    open_journal().commit([submit("s")])
    operator = open_journal(Side.OPERATOR)
    with pytest.raises(DefinitionError, match=message):
        operator.commit([Entry("s", "amend", body)])

    assert fold(operator.read_new()).sessions["s"].contract.priority == 0
