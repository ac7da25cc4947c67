"""What memory says a first attempt needs is done before it: another skill, another target, or what comes first."""

import pytest

from phyagentos.agent.memory.advisor import Advice, NoAdvice
from phyagentos.protocol.sessions.means import Means, Preparation
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy

from .conftest import TWO, Play, add_skills, put
from .test_recovery_missions import MORE_SKILLS, make_table_world, move_away

SLOW = Strategy(speed=0.5)
CLEAR = Preparation(purpose="clear", skill="set_aside", kind="cube")
SHOVE = """
    description: Brings an object into a container otherwise.
    tree: shove
    parameters: {object: {type: entity}, destination: {type: place}}
    guarantees: ["inside(${object}, ${destination})"]
    needs: {actions: [joint_position], capabilities: [manipulation]}
    """


class Told(NoAdvice):
    """Advises the node `red`, as a memory with one lesson."""

    def __init__(self, means, **otherwise):
        plain = Advice(strategy=SLOW, reasons=("slowly",), sources=("lesson-2",))
        self.advice = Advice(means=means, reasons=("because",), sources=("lesson-1",), otherwise=plain)

    def begin(self, graph, snapshot):
        return snapshot or "memory/7-abc"

    def advise(self, session):
        return self.advice if session.node == "red" else Advice()


@pytest.fixture
def library(library):
    return add_skills(library, {**MORE_SKILLS, "shove": SHOVE})


def crowd(world, name="yellow_cube"):
    """A cube beside the red one."""
    return put(world, name, (0.4, 0.22, 0.02))


def pursue(make_stage, graph, means, script=None, world=None):
    stage = make_stage(script or {}, world=world or crowd(make_table_world()))
    report = stage.make_mission(advisor=Told(means)).run(graph, seed=7)
    return stage, report, [s for s in stage.runtime.ran if s.node == "red"]


def test_what_is_in_the_way_is_cleared_before_the_first_attempt(make_stage, two):
    stage, report, (clear, attempt) = pursue(make_stage, two, Means(prepare=(CLEAR,)), {"red": move_away})
    assert report.verdict == "success"
    assert (clear.skill, clear.purpose, clear.parameters["object"]) == ("set_aside", "clear", "yellow_cube")
    assert (attempt.skill, attempt.parent, attempt.purpose) == ("pick_and_place", clear.id, "")
    assert clear.advised_by == attempt.advised_by == ("lesson-1",)
    assert report.replans == 0, "nothing has failed"
    status = stage.make_mission().ledger.goals["two-7"]
    assert status.memory == "memory/7-abc"


def test_what_a_finished_node_has_placed_is_not_cleared_away(make_stage, two):
    world = crowd(make_table_world(), "green_cube")
    script = {"green": lambda world, session: Play(world=put(world, "green_cube", (0.55, 0.0, 0.03)))}
    near = put(world, "red_cube", (0.5, 0.05, 0.02))
    _, _, (attempt,) = pursue(make_stage, two, Means(prepare=(CLEAR,)), script, near)
    assert attempt.skill == "pick_and_place"


def test_another_skill_must_keep_the_promise_of_the_node(make_stage, two):
    _, report, (attempt,) = pursue(make_stage, two, Means(skill="shove"))
    assert report.verdict == "success"
    assert (attempt.skill, attempt.accept) == ("shove", ("inside(red_cube, red_tray)",))
    assert (attempt.parent, attempt.advised_by) == (None, ("lesson-1",))


RED_ALONE = TWO[: TWO.index("      green:")] + TWO[TWO.index("      red:") :].replace("after: [green]", "").replace(
    ', "inside(green_cube, green_tray)"', ""
)
PREPARED = [("set_aside", "clear"), ("pick_and_place", "")]
PREPARE = Means(prepare=(CLEAR,))


@pytest.mark.parametrize(
    ("graph", "means", "stage", "ran", "sources"),
    [
        pytest.param(
            TWO,
            PREPARE,
            {"world": make_table_world()},
            PREPARED[1:],
            ("lesson-2",),
            id="where nothing stands in the way nothing is cleared and the lesson is not counted",
        ),
        pytest.param(
            TWO,
            PREPARE,
            {"script": {"red": lambda world, session: Play(world=world, ended=Ended.STALLED)}},
            PREPARED,
            ("lesson-1",),
            id="a preparation that fails is followed by the attempt",
        ),
        pytest.param(
            TWO.replace("BUDGET", "budget: {sessions: 2}"),
            PREPARE,
            {},
            PREPARED[1:],
            ("lesson-2",),
            id="nothing is prepared beyond the budget of the goal",
        ),
        pytest.param(
            RED_ALONE,
            PREPARE,
            {"script": {"red.r1": move_away}},
            [("inspect", "inspect"), *PREPARED],
            ("lesson-1",),
            id="before anything was seen a look comes first",
        ),
        *(
            pytest.param(TWO, means, {}, PREPARED[1:], ("lesson-2",), id=f"{means} that cannot be had")
            for means in (Means(skill="inspect"), Means(skill="gone"), Means(target="gone"))
        ),
    ],
)
def test_what_is_advised_is_done_where_it_can_be_and_is_counted_only_then(
    make_stage, write_graph, graph, means, stage, ran, sources
):
    _, report, found = pursue(make_stage, write_graph(graph.replace("BUDGET", "")), means, **stage)
    assert report.verdict == "success"
    assert [(session.skill, session.purpose) for session in found] == ran
    assert (found[-1].advised_by, found[-1].strategy) == (
        sources,
        SLOW if sources == ("lesson-2",) else DEFAULT_STRATEGY,
    )


def test_a_contract_by_other_means_keeps_conditions_and_limits(make_stage, write_graph):
    text = TWO.replace("BUDGET", 'constraints: ["height(bottle) < 0.5"]').replace(
        "max_replans", "timeout_s: 33, max_replans"
    )
    _, _, (shoved,) = pursue(make_stage, write_graph(text), Means(skill="shove"))
    assert (shoved.hold, shoved.limits.timeout_s) == (("height(bottle) < 0.5",), 33.0)


YELLOW = """
      yellow:
        after: [green]
        skill: pick_and_place
        target: arm
        with: {object: yellow_cube, destination: blue_tray}
    accept:"""


@pytest.fixture
def three(write_graph):
    """Red and yellow in either order, red first as it is written."""
    return write_graph(TWO.replace("BUDGET", "").replace("\n    accept:", YELLOW))


def test_what_another_node_moves_anyway_is_waited_for_and_not_cleared(make_stage, three):
    stage, report, (attempt,) = pursue(make_stage, three, Means(prepare=(CLEAR,)))
    assert report.verdict == "success"
    assert [session.node for session in stage.runtime.ran] == ["green", "yellow", "red"]
    assert (attempt.skill, attempt.purpose) == ("pick_and_place", "")
    journal = "".join(path.read_text() for path in stage.workspace.sessions.rglob("*.md"))
    assert journal.count("yellow comes first: it moves yellow_cube, as lesson-1 wants") == 1


def test_a_node_is_prepared_after_all_when_the_one_before_it_fails(make_stage, three):
    failing = {f"yellow{n}": lambda world, session: Play(world=world, ended=Ended.STALLED) for n in ("", ".r1", ".r2")}
    stage, _, ran = pursue(make_stage, three, Means(prepare=(CLEAR,)), {**failing, "red": move_away})
    assert [session.skill for session in ran] == ["set_aside", "pick_and_place"]
    assert stage.runtime.ran[-1].node == "red"


@pytest.mark.parametrize(
    ("means", "skill", "source"), [(Means(skill="shove"), "shove", "lesson-1"), (PREPARE, "pick_and_place", "lesson-2")]
)
def test_where_nothing_can_look_first_another_skill_is_taken_and_nothing_prepared(
    make_stage, write_graph, monkeypatch, means, skill, source
):
    monkeypatch.setattr("phyagentos.agent.repair.looking.find_look", lambda *_: None)
    _, _, (attempt,) = pursue(make_stage, write_graph(RED_ALONE.replace("BUDGET", "")), means)
    assert (attempt.skill, attempt.advised_by) == (skill, (source,))
