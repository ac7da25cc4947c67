"""What the agent tells of its next session before that is submitted: the very contract, or nothing."""

import pytest

from phyagentos.agent.memory.advice import Advice
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.outlook import Outlook

CHAIN = """
    goal: chain
    objective: One after the other.
    scene: table
    targets: {arm: panda}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
      green:
        skill: pick_and_place
        target: arm
        after: [red]
        with: {object: green_cube, destination: green_tray}
    accept: ["inside(red_cube, red_tray)", "inside(green_cube, green_tray)"]
    """


def find_expected(stage, graph, **more):
    """The mission waits for a runtime that does nothing, until it gives up."""
    stage.runtime.paused = True
    with pytest.raises(ExecutionError, match="RUNTIME_LOST"):
        stage.make_mission(is_runtime_alive=lambda _: False, **more).run(graph, seed=7)
    stage.runtime.paused = False
    return Outlook(stage.workspace.cache).find("panda")


def test_what_is_expected_is_the_very_contract_that_is_submitted_then(make_stage, write_graph):
    stage, graph = make_stage(), write_graph(CHAIN)

    expected = find_expected(stage, graph)
    stage.runtime.on_change(None, None)
    stage.pursue(graph)

    assert expected.node == "green"
    assert stage.runtime.ran[1] == expected


@pytest.mark.parametrize(
    "graph",
    [
        CHAIN.replace("        after: [red]\n", ""),
        CHAIN.replace("destination: green_tray", 'destination: green_tray, near: "${red.outputs.place_site}"'),
        CHAIN.partition("      green:")[0] + '    accept: ["inside(red_cube, red_tray)"]\n',
    ],
    ids=["two live", "needs what the first gives", "nothing follows"],
)
def test_nothing_is_expected_where_it_cannot_be_told(make_stage, write_graph, graph):
    assert find_expected(make_stage(), write_graph(graph)) is None


def test_memory_is_asked_of_what_is_submitted_not_of_what_is_expected(make_stage, write_graph):
    asked = []

    class Advisor:
        def advise(self, session, world):
            asked.append(session.node)
            return Advice()

    assert find_expected(make_stage(), write_graph(CHAIN), advisor=Advisor()).node == "green"
    assert asked == ["red"]
