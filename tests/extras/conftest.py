"""A browser, and a replanned session for it to show."""

import pytest
import yaml

from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.protocol.workspace.workspace import Workspace
from tests.extras import viewing


@pytest.fixture(scope="session")
def browser(pytestconfig):
    """The system's Chromium, without a window."""
    api = pytest.importorskip("playwright.sync_api", reason="needs Playwright: `make test-extras`")
    pytest.importorskip("viser", reason="needs the extra `view`: `make test-extras`")
    with api.sync_playwright() as playwright:
        path = pytestconfig.option.chromium
        browser = playwright.chromium.launch(executable_path=path, args=[*viewing.WHAT_CHROMIUM_NEEDS])
        yield browser
        browser.close()


@pytest.fixture
def visits(browser):
    """Opens pages. In the end: none asked another host for anything, no script of them failed, no dialog came."""
    visits = viewing.Visits(browser)
    yield visits
    visits.end()


@pytest.fixture(scope="session")
def replanned(browser, tmp_path_factory):
    """A workspace after a real run: a cube slips, the session is replanned, the goal is met; a proposal waits."""
    root = tmp_path_factory.mktemp("replanned") / "w"
    words = ("--seed", 7, "--faults", "faults/slip.yaml", "--memory", "workspace", "-w", root)
    viewing.carry_out("run", "goal_graphs/tidy_table.yaml", *words)
    return _propose(Workspace.open(root))


def _propose(workspace):
    graph = yaml.safe_load((viewing.ROOT / "goal_graphs" / "tidy_table.yaml").read_text(encoding="utf-8"))
    asked = Proposal(goal="tidy_table", seed=3, by="somebody", at="2026-11-26", reason="again, please", graph=graph)
    Proposals(workspace.proposals).put(encode_proposal(asked))
    return workspace


@pytest.fixture(scope="session")
def axe(pytestconfig):
    """The script of axe-core."""
    return viewing.read_axe(pytestconfig.option.axe)
