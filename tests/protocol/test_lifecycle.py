"""The session's statechart, driven at random."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.protocol.sessions.lifecycle import (
    FINAL_STATES,
    REVIEW,
    SESSION_TRANSITIONS,
    IllegalTransition,
    SessionState,
    Side,
    build_machine,
    compile_table,
    compute_next_state,
    find_cancel,
    render_mermaid,
)

TRIGGERS = sorted({row.trigger for row in SESSION_TRANSITIONS})
EVENTS = st.lists(st.tuples(st.sampled_from(TRIGGERS), st.sampled_from(list(Side))), max_size=40)


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
                compute_next_state("s", state, trigger, side)
            assert (caught.value.state, caught.value.trigger, caught.value.side) == (state, trigger, side)
        else:
            assert state not in FINAL_STATES or (trigger == REVIEW and expected == state)
            assert compute_next_state("s", state, trigger, side) == expected
            state = expected


@given(st.sampled_from(sorted(FINAL_STATES)), st.sampled_from(TRIGGERS), st.sampled_from(list(Side)))
def test_a_final_state_is_final(state, trigger, side):
    if allows(state, trigger, side):
        assert (trigger, side, compute_next_state("s", state, trigger, side)) == (REVIEW, Side.AGENT, state)
        return
    possible = "none" if state in {SessionState.REJECTED, SessionState.CANCELLED} else REVIEW
    with pytest.raises(IllegalTransition, match=rf"Possible: {possible}, the state is final.*new child session"):
        compute_next_state("s", state, trigger, side)


def test_every_row_is_refused_to_every_side_that_it_does_not_name():
    refused = 0
    for row in SESSION_TRANSITIONS:
        for source in row.sources:
            for side in set(Side) - set(row.by):
                with pytest.raises(IllegalTransition, match=f"{side} asked for '{row.trigger}' in state '{source}'"):
                    compute_next_state("s", source.value, row.trigger, side.value)
                refused += 1

    assert refused > 30


def test_every_state_can_be_reached_and_every_other_than_final_can_be_left():
    reached = {row.dest for row in SESSION_TRANSITIONS} | {SessionState.PENDING}
    left = {source for row in SESSION_TRANSITIONS for source in row.sources if row.dest != source}

    assert reached == set(SessionState)
    assert left == set(SessionState) - FINAL_STATES


def test_a_trigger_from_one_state_leads_to_one_state_only():
    rows = [(source, row.trigger) for row in SESSION_TRANSITIONS for source in row.sources]

    assert len(rows) == len(set(rows)) == len(compile_table())


def test_an_end_can_be_asked_for_until_there_is_one_or_nobody_knows_how_it_ended():
    triggers = {state: trigger for state in SessionState if (trigger := find_cancel(state)) is not None}

    assert set(SessionState) - set(triggers) == FINAL_STATES | {SessionState.CANCELLING, SessionState.OUTCOME_UNKNOWN}
    assert {compute_next_state("s", state, triggers[state], side) for state in triggers for side in Side} == {
        SessionState.CANCELLED,
        SessionState.CANCELLING,
    }


def test_the_machine_has_no_back_doors():
    assert sorted(build_machine().events) == TRIGGERS


def test_the_diagram_shows_every_row():
    lines = {line.strip() for line in render_mermaid().splitlines()}

    for row in SESSION_TRANSITIONS:
        for source in row.sources:
            assert f"{source} --> {row.dest}: {row.trigger} ({', '.join(row.by)})" in lines
    assert {f"{state} --> [*]" for state in FINAL_STATES} <= lines
    assert len(lines) == 2 + len(compile_table()) + len(FINAL_STATES)
