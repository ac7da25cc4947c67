"""What the simulated world did to a session stands in its bundle for the benchmarks; the agent never opens it."""

import sys

import pytest

from phyagentos.protocol.sessions.evidence import FAULTS, write_json

from .conftest import ScriptedRuntime, slip

GRAPH = """
    goal: tidy
    objective: The red cube into its tray.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 1}
    sessions:
      red: {skill: pick_and_place, target: arm, with: {object: red_cube, destination: red_tray}}
    """


class OpenedFiles:
    """Names of the files that this process opens while somebody listens; an audit hook cannot be taken away again."""

    def __init__(self):
        self.names = None
        sys.addaudithook(self._hear)

    def _hear(self, event, arguments):
        if event == "open" and self.names is not None:
            self.names.append(str(arguments[0]).rpartition("/")[2])


@pytest.fixture(scope="module")
def opened_files():
    return OpenedFiles()


@pytest.fixture
def listen(opened_files):
    opened_files.names = names = []
    yield names
    opened_files.names = None


class TellingRuntime(ScriptedRuntime):
    """Leaves in each bundle what was done to the session, as the recorder does."""

    def _leave_bundle(self, session, before, play):
        super()._leave_bundle(session, before, play)
        faults = self._workspace.evidence_of(session.id) / FAULTS
        write_json(faults, [{"kind": "slip", "body": session.parameters["object"]}])


def test_the_agent_judges_diagnoses_and_repairs_without_opening_what_was_injected(make_stage, write_graph, listen):
    stage = make_stage({"red": slip})
    stage.runtime.__class__ = TellingRuntime
    listen.clear()
    report = stage.pursue(write_graph(GRAPH))

    assert [session.state for session in report.sessions] == ["replanned", "succeeded"]
    assert "environment_after.json" in listen  # it does hear what the agent opens
    assert listen.count(FAULTS) == 2  # written twice, by the runtime, and never opened again
