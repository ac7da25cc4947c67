"""The session's statechart, driven at random."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.protocol.sessions import lifecycle
from phyagentos.protocol.sessions.lifecycle import (
    EARLIER_TRANSITIONS,
    FINAL_STATES,
    REVIEW,
    SESSION_TRANSITIONS,
    Fenced,
    IllegalTransition,
    SessionEvent,
    SessionState,
    Side,
    build_statechart,
    find_cancel,
    fire,
    list_triggers,
    render_mermaid,
)

TRIGGERS = sorted({row.trigger for row in SESSION_TRANSITIONS})
EVENTS = st.lists(st.tuples(st.sampled_from(TRIGGERS), st.sampled_from(list(Side))), max_size=40)


def lead(id, state, trigger, side, **more):
    """Where an event leads."""
    return fire(SessionEvent(id, str(state), more.pop("epoch", 1), trigger, side, **more)).state


def allows(state, trigger, side):
    return next(
        (row.dest for row in SESSION_TRANSITIONS if row.trigger == trigger and state in row.sources and side in row.by),
        None,
    )


@given(EVENTS)
def test_no_sequence_of_events_leaves_the_table(events):
    state = SessionState.PENDING
    for trigger, side in events:
        expected = allows(state, trigger, side)
        if expected is None:
            with pytest.raises(IllegalTransition) as caught:
                lead("s", state, trigger, side)
            assert (caught.value.state, caught.value.trigger, caught.value.side) == (state, trigger, side)
        else:
            assert state not in FINAL_STATES or (trigger == REVIEW and expected == state)
            assert lead("s", state, trigger, side) == expected
            state = expected


@given(st.sampled_from(sorted(FINAL_STATES)), st.sampled_from(TRIGGERS), st.sampled_from(list(Side)))
def test_a_final_state_is_final(state, trigger, side):
    if allows(state, trigger, side):
        assert (trigger, side, lead("s", state, trigger, side)) == (REVIEW, Side.AGENT, state)
        return
    possible = "none" if state in {SessionState.REJECTED, SessionState.CANCELLED} else REVIEW
    with pytest.raises(IllegalTransition, match=rf"Possible: {possible}, the state is final.*new child session"):
        lead("s", state, trigger, side)


def test_every_row_is_refused_to_every_side_that_it_does_not_name():
    refused = 0
    for row in SESSION_TRANSITIONS:
        for source in row.sources:
            for side in set(Side) - set(row.by):
                with pytest.raises(IllegalTransition, match=f"{side} asked for '{row.trigger}' in state '{source}'"):
                    lead("s", source.value, row.trigger, side.value)
                refused += 1

    assert refused > 30


def test_every_state_can_be_reached_and_every_other_than_final_can_be_left():
    reached = {row.dest for row in SESSION_TRANSITIONS} | {SessionState.PENDING}
    left = {source for row in SESSION_TRANSITIONS for source in row.sources if row.dest != source}

    assert reached == set(SessionState)
    assert left == set(SessionState) - FINAL_STATES


def test_a_trigger_from_one_state_leads_to_one_state_only():
    every = (*SESSION_TRANSITIONS, *EARLIER_TRANSITIONS)
    rows = [(source, row.trigger) for row in every for source in row.sources]

    assert len(rows) == len(set(rows))


def test_a_session_can_be_cancelled_until_it_has_ended_or_was_lost():
    triggers = {state: trigger for state in SessionState if (trigger := find_cancel(state)) is not None}

    moments = {SessionState.CLAIMED, SessionState.VERIFYING}  # entered and left in one batch
    ending = {SessionState.CANCELLING, SessionState.OUTCOME_UNKNOWN}
    assert set(SessionState) - set(triggers) == FINAL_STATES | ending | moments
    assert {lead("s", state, triggers[state], side) for state in triggers for side in Side} == {
        SessionState.CANCELLED,
        SessionState.CANCELLING,
    }


def test_the_machine_has_no_back_doors():
    assert sorted(build_statechart().machine.events) == TRIGGERS


@given(st.sampled_from(SESSION_TRANSITIONS), st.sampled_from(list(Side)), st.integers(0, 3), st.integers(0, 3))
def test_a_stale_epoch_is_refused_to_the_runtime_and_only_a_claim_begins_another(row, side, epoch, token):
    event = SessionEvent("s", row.sources[0].value, epoch, row.trigger, side, token)
    if side is Side.RUNTIME and token != epoch:
        with pytest.raises(Fenced, match=f"came with epoch {token}, but epoch {epoch} is in force"):
            fire(event)
    elif side in row.by:
        assert (fire(event).state, event.epoch) == (row.dest, epoch + (row.trigger == "claim"))


def test_a_row_that_leaves_a_final_state_is_refused_by_the_machine(monkeypatch):
    wrong = lifecycle.Row("amend", (SessionState.SUCCEEDED,), SessionState.PENDING, (Side.OPERATOR,))
    monkeypatch.setattr(lifecycle, "SESSION_TRANSITIONS", (wrong, *SESSION_TRANSITIONS))
    chart = build_statechart.__wrapped__()

    assert not chart.fire(SessionEvent("s", "succeeded", 1, "amend", "operator"), "amend")
    assert chart.fire(SessionEvent("s", "pending", 1, "amend", "operator"), "amend")


@pytest.mark.parametrize("row", EARLIER_TRANSITIONS, ids=lambda row: f"{row.sources[0]}-{row.trigger}")
def test_rows_of_earlier_journals_are_checked_and_never_recorded_again(row):
    (source,) = row.sources
    assert lead("s", source.value, row.trigger, row.by[0], is_past=True) == row.dest
    with pytest.raises(IllegalTransition, match=f"'{row.trigger}' in state '{source}'"):
        lead("s", source.value, row.trigger, row.by[0])
    assert row.trigger not in list_triggers(source)


def test_the_diagram_shows_every_row():
    lines = {line.strip() for line in render_mermaid().splitlines()}

    for row in SESSION_TRANSITIONS:
        for source in row.sources:
            assert f"{source} --> {row.dest}: {row.trigger} ({', '.join(row.by)})" in lines
    assert {f"{state} --> [*]" for state in FINAL_STATES} <= lines
    assert len(lines) == 2 + sum(len(row.sources) for row in SESSION_TRANSITIONS) + len(FINAL_STATES)
