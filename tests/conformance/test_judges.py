"""Every judge that ships or is installed satisfies what is required of judges."""

import pytest

from phyagentos.agent.judging.judges.judge_registry import JudgeDefinition
from phyagentos.assembly.verification import JUDGES
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth
from phyagentos.testing import check_judge


@pytest.mark.parametrize("name", JUDGES.names())
def test_a_judge_is_named_repeatable_reading_only_and_fails_closed(name, tmp_path):
    check_judge(JUDGES.load(name), tmp_path)


class Rash:
    """Calls everything true, whatever was observed."""

    name = "rash/1"

    def judge(self, bundle):
        return [Criterion(text="all well", kind="rash", truth=Truth.TRUE, evidence="e.json", because="it is")]


class Nameless(Rash):
    name = "rash"


@pytest.mark.parametrize(("judge", "message"), [(Rash, "was not observed"), (Nameless, "names no version")])
def test_a_judge_that_does_not_satisfy_it_is_found(judge, message, tmp_path):
    with pytest.raises(AssertionError, match=message):
        check_judge(JudgeDefinition(name="rash", open=lambda _: judge(), description="Rash."), tmp_path)
