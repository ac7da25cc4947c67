"""Every lie about our own code and evidence turns the tests red that stand beside it; the truth leaves them green."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.gauntlet.running import run_tests
from tests.gauntlet.sabotages import SABOTAGES

pytestmark = [pytest.mark.sim, pytest.mark.alone]  # as many processes as there are cores

HONEST = "honest"
NODES = list(dict.fromkeys(node for sabotage in SABOTAGES for node in sabotage.tests))
PLANTED = {sabotage.name: sabotage for sabotage in SABOTAGES}


class Runs:
    """Pytest processes, as many at a time as there are cores; those that will be asked for are begun ahead."""

    def __init__(self, ahead):
        self._pool = ThreadPoolExecutor(os.cpu_count())
        self._begun = {}
        for name in ahead:
            self._begin(name)

    def _begin(self, name):
        if name not in self._begun:
            sabotage = PLANTED.get(name)
            nodes = sabotage.tests if sabotage is not None else NODES
            self._begun[name] = self._pool.submit(run_tests, nodes, sabotage)
        return self._begun[name]

    def get(self, name):
        return self._begin(name).result()

    def close(self):
        self._pool.shutdown(cancel_futures=True)


@pytest.fixture(scope="module")
def runs(request):
    mine = [item for item in request.session.items if item.module is request.module]
    asked = [item.callspec.params["name"] if hasattr(item, "callspec") else HONEST for item in mine]
    is_one_of_many = "PYTEST_XDIST_WORKER" in os.environ  # each of them knows every test, and runs only some
    runs = Runs([] if is_one_of_many else asked)
    yield runs
    runs.close()


def test_every_named_test_is_green_while_nobody_lies(runs):
    run = runs.get(HONEST)

    assert [node for node in NODES if not run.is_green(node)] == [], run.output[-4000:]


@pytest.mark.parametrize("name", PLANTED)
def test_a_lie_turns_every_test_red_that_is_named_beside_it(runs, name):
    run = runs.get(name)

    found = {node: "red" if run.is_red(node) else "not red" for node in PLANTED[name].tests}
    assert found == dict.fromkeys(PLANTED[name].tests, "red"), run.output[-4000:]
