"""An episode tells what the evidence says of a session, whoever decided about it."""

import pytest
from msgspec.structs import replace

from phyagentos.agent.memory.episodes import Surroundings, find_episode
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import ALREADY_MET, Ended, Execution, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.testing import make_contract


def make_status(state, *attempts):
    contract = make_contract(parameters={"object": "cube"}, accept=("holding(panda, cube)",))
    execution = Execution(ended=Ended.COMPLETED, evidence="evidence/g.n")
    return SessionStatus(contract=contract, state=state, execution=execution, attempts=attempts)


@pytest.fixture
def surroundings():
    return Surroundings(skills={}, scenes={}, targets={})


def test_what_an_audit_let_pass_is_remembered_as_the_failure_that_was_found(surroundings):
    audited = Attempt(
        verdict=Verdict.SUCCESS, found=Verdict.REPLAN, criteria=(), cause="GRASP_LOST", mode=VerificationMode.AUDIT
    )
    episode = find_episode(make_status(SessionState.SUCCEEDED, audited), surroundings)

    assert (episode.verdict, episode.is_success, episode.cause) == (Verdict.REPLAN, False, "GRASP_LOST")


def test_what_an_audit_held_up_is_remembered_as_the_success_that_was_found(surroundings):
    audited = Attempt(verdict=Verdict.FAILURE, found=Verdict.SUCCESS, criteria=(), mode=VerificationMode.AUDIT)

    assert find_episode(make_status(SessionState.FAILED, audited), surroundings).is_success


def test_what_nobody_judged_is_no_episode(surroundings):
    skipped = Attempt(verdict=Verdict.UNVERIFIED, criteria=(), mode=VerificationMode.OFF)

    assert find_episode(make_status(SessionState.UNVERIFIED, skipped), surroundings) is None


def test_a_session_that_had_nothing_to_do_or_that_a_person_led_is_no_experience(surroundings):
    met = Attempt(verdict=Verdict.SUCCESS, found=Verdict.SUCCESS, criteria=())
    status = make_status(SessionState.SUCCEEDED, met)
    led = replace(status, execution=replace(status.execution, led_by="ada"))
    idle = replace(status, execution=replace(status.execution, code=ALREADY_MET))

    assert find_episode(status, surroundings) is not None
    assert find_episode(idle, surroundings) is None
    assert find_episode(led, surroundings) is None


def test_a_judgement_that_was_added_later_changes_no_episode(surroundings):
    decided = Attempt(verdict=Verdict.FAILURE, found=Verdict.FAILURE, criteria=(), cause="GRASP_LOST")
    added = Attempt(verdict=Verdict.SUCCESS, found=Verdict.SUCCESS, criteria=(), is_review=True)

    assert not find_episode(make_status(SessionState.FAILED, decided, added), surroundings).is_success
