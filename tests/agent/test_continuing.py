"""Goals that a workspace knows already: which are gone on with, which are only reported, which are another's."""

import pytest

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.store import ledger as ledger_module

from .conftest import TIDY, put, slip


@pytest.fixture
def begun(make_stage, tidy):
    """A stage on which the runtime was lost in the middle of goal tidy-7."""
    stage = make_stage()
    stage.runtime.paused = True
    with pytest.raises(ExecutionError, match="NOT_RUNNING"):
        stage.make_mission(is_runtime_alive=lambda _: False).run(tidy, seed=7)
    stage.runtime.paused = False
    stage.runtime.on_change(None, None)
    return stage


ANOTHER = {
    "acceptance": TIDY.replace('"inside(green_cube, green_tray)"]', '"inside(blue_cube, blue_tray)"]'),
    "node": TIDY.replace("green:", "grass:"),
    "objective": TIDY.replace("Red and green", "Green and red"),
}


@pytest.mark.parametrize(
    ("text", "goal"),
    [*((text, None) for text in ANOTHER.values()), (ANOTHER["node"], "tidy-7")],
    ids=[*ANOTHER, "its id"],
)
def test_an_open_goal_is_not_gone_on_with_for_another_graph(begun, write_graph, text, goal):
    graph = write_graph(text, "other.yaml")
    before = begun.make_mission().ledger.seq
    with pytest.raises(DefinitionError, match=r"other.yaml: CHANGED: found .* goal tidy-7") as caught:
        begun.make_mission().run(graph, seed=7, goal=goal)

    (problem,) = caught.value.problems
    assert ("tidy-7.yaml" in problem.expected, "--goal" in problem.hint) == (True, True)
    assert begun.make_mission().ledger.seq == before


def test_an_override_makes_another_graph_of_the_same_file(begun, tidy):
    with pytest.raises(DefinitionError, match="CHANGED"):
        begun.make_mission().run(tidy, seed=7, overrides={"objective": "Something else."})


def test_the_same_graph_goes_on_however_its_file_is_written_and_says_so(begun, tidy, caplog):
    tidy.write_text(f"# A comment.\n{tidy.read_text()}\nbudget: {{}}\n")
    report = begun.make_mission().run(tidy, seed=7)

    assert (report.goal, report.verdict) == ("tidy-7", "success")
    assert caplog.messages == ["continues goal tidy-7"]


def test_a_goal_with_overrides_goes_on_with_the_same_overrides(make_stage, tidy):
    stage, overrides = make_stage(), {"objective": "2001-09-09 is the day, é", "sessions.red.timeout_s": "1e-5"}
    stage.runtime.paused = True
    with pytest.raises(ExecutionError, match="NOT_RUNNING"):
        stage.make_mission(is_runtime_alive=lambda _: False).run(tidy, seed=7, overrides=overrides)
    stage.runtime.paused = False
    stage.runtime.on_change(None, None)

    assert stage.make_mission().run(tidy, seed=7, overrides=overrides).verdict == "success"


def test_a_goal_that_is_over_is_reported_however_long_ago(make_stage, tidy, monkeypatch):
    monkeypatch.setattr(ledger_module, "GOALS_KEPT", 2)
    monkeypatch.setattr(ledger_module, "FINISHED_KEPT", 2)
    stage = make_stage({"red": slip})
    first = stage.make_mission().run(tidy, seed=1, goal="job-1")
    stage.runtime.script = {}
    for number in range(2, 7):
        stage.runtime.world = put(stage.runtime.world, "red_cube", (0.4, 0.3, 0.02))
        stage.make_mission().run(tidy, seed=number, goal=f"job-{number}")
    mission = stage.make_mission()
    again = mission.run(tidy, seed=1, goal="job-1")

    assert "job-1" not in mission.ledger.goals
    assert (again.verdict, again.nodes, again.replans) == ("success", first.nodes, 1)
    assert again.sessions == first.sessions
    assert len(again.sessions) == 3


def test_a_goal_that_is_over_is_not_reported_for_another_graph(make_stage, tidy, write_graph):
    stage = make_stage()
    stage.make_mission().run(tidy, seed=1, goal="job-1")
    with pytest.raises(DefinitionError, match="CHANGED"):
        stage.make_mission().run(write_graph(ANOTHER["node"], "other.yaml"), seed=1, goal="job-1")


def test_an_id_that_is_no_name_of_a_file_is_refused(make_stage, tidy, tmp_path):
    stage = make_stage()
    mission = stage.make_mission()
    for goal in ("../../escaped", "a/b", ".", "..", ".hidden", "-x", "a b", "a\n", "é", "", "g" * 101):
        with pytest.raises(DefinitionError, match=r"INVALID_VALUE: found .*; expected letters"):
            mission.run(tidy, seed=7, goal=goal)
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        mission.run(tidy, seed=10**120)
    assert list(stage.workspace.goals.iterdir()) == []
    assert not list(tmp_path.rglob("*escaped*"))
