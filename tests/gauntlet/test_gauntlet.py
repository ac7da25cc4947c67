"""Every lie about our own code and evidence turns the tests red that stand beside it; the truth leaves them green."""

import pytest

from tests.gauntlet.running import run_tests
from tests.gauntlet.sabotages import SABOTAGES

pytestmark = pytest.mark.sim

NODES = list(dict.fromkeys(node for sabotage in SABOTAGES for node in sabotage.tests))
PLANTED = {sabotage.name: sabotage for sabotage in SABOTAGES}


def test_a_named_test_of_every_file_is_green_here_while_nobody_lies():
    """The others are green in the suite itself; `python -m tests.gauntlet` runs them all."""
    honest = {node.partition("::")[0]: node for node in reversed(NODES)}.values()
    run = run_tests(honest)

    assert [node for node in honest if not run.is_green(node)] == [], run.output[-4000:]


@pytest.mark.parametrize("name", PLANTED)
def test_a_lie_turns_every_test_red_that_is_named_beside_it(name):
    run = run_tests(PLANTED[name].tests, PLANTED[name])

    found = {node: "red" if run.is_red(node) else "not red" for node in PLANTED[name].tests}
    assert found == dict.fromkeys(PLANTED[name].tests, "red"), run.output[-4000:]
