"""Contracts: fully substituted, deduplicated, with seeds of their own."""

import pytest

from phyagentos.agent.goals.compiler import Revision, SessionCompiler
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.session import GoalId, ResetPolicy, SessionId
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.world.seeds import compute_seed

GRAPH = """
    goal: g
    objective: o
    scene: table
    targets: {arm: any}
    constraints: ["upright(bottle)"]
    defaults: {timeout_s: 45, wall_timeout_s: 90, max_replans: 1}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
        requires: ["not holding(arm, red_cube)"]
        accept: ["inside( red_cube , red_tray )", "not moved(bottle)"]
        timeout_s: 20
      blue:
        skill: pick_and_place
        target: arm
        objective: Put ${object} beside the red cube.
        with: {object: blue_cube, destination: red_tray, near: "${red.outputs.place_site}"}
        accept: ["at(blue_cube, ${red.outputs.place_site}, 0.2)"]
      hand:
        skill: pick
        with: {object: yellow_cube}
    """


@pytest.fixture
def compile_graph(write_graph, catalogue):
    """Makes the compiler of a graph, whose text may be changed before."""

    def make(old: str = "", new: str = "") -> SessionCompiler:
        graph = read_goal_graph(write_graph(GRAPH.replace(old, new) if old else GRAPH), catalogue)
        return SessionCompiler(graph=graph, catalogue=catalogue, goal=GoalId("g-7"), seed=7)

    return make


@pytest.fixture
def compiler(compile_graph) -> SessionCompiler:
    return compile_graph()


LOOK = Revision(parent=SessionId("g-7.red"), purpose="inspect")


def test_a_contract_holds_what_skill_node_and_goal_say_each_once(compiler):
    session = compiler.compile_node("red", outputs={})
    assert session.id == "g-7.red"
    assert session.requires == ("visible(red_cube)", "not holding(panda, red_cube)")
    assert session.accept == ("inside(red_cube, red_tray)", "not moved(bottle)")
    assert session.hold == ("upright(bottle)",)
    assert (session.limits.timeout_s, session.limits.wall_timeout_s) == (20, 90)
    assert (session.scene.name, session.scene.seed, session.scene.episode) == ("table", 7, "g-7")
    assert session.parameters == {"object": "red_cube", "destination": "red_tray", "speed": 1.0}
    assert session.objective == "Pick and place: object red_cube, destination red_tray, speed 1."


def test_a_contract_names_what_else_comes_to_its_place_and_what_must_stay(compile_graph):
    compiler = compile_graph("timeout_s: 20", 'hold: ["visible(green_cube)"]')
    red, blue, hand = (compiler.compile_node(name) for name in ("red", "blue", "hand"))
    assert (red.coming, blue.coming, hand.coming) == (("blue_cube",), ("red_cube",), ())
    assert "bottle" in red.kept
    assert not {"red_cube", "blue_cube", "green_cube"} & set(blue.kept)
    assert hand.kept == ()
    assert compiler.compile_node("red", outputs={}, attempt=1, revision=LOOK).coming == ()


@pytest.mark.parametrize(("key", "stays"), [("accept", False), ("hold", True)])
def test_what_is_not_in_the_hand_in_the_end_may_be_moved_meanwhile(write_graph, catalogue, key, stays):
    text = GRAPH.replace(
        "with: {object: yellow_cube}",
        f'with: {{object: blue_cube}}\n        {key}: ["not holding(target, yellow_cube)"]',
    )
    assert ("yellow_cube" in read_goal_graph(write_graph(text), catalogue).kept) is stays


@pytest.mark.parametrize(
    ("node", "change", "unless_met"),
    [
        ("red", ("", ""), True),
        ("hand", ("", ""), False),  # holding passes: the act is wanted
        ("red", ("timeout_s: 20", "even_if_met: true"), False),
        ("red", ("not moved(bottle)", "metric(ticks) >= 9"), False),
    ],
)
def test_a_node_that_wants_a_state_is_not_acted_on_where_it_is_met(compile_graph, node, change, unless_met):
    compiler = compile_graph(*change)
    assert compiler.compile_node(node, outputs={}).unless_met is unless_met
    assert not compiler.compile_node(node, outputs={}, attempt=1, revision=LOOK).unless_met


def test_limits_of_supervision_resources_and_resets_reach_the_contract(write_graph, catalogue):
    text = GRAPH.replace("max_replans: 1}", "stall_s: 3, think_s: 9, preflight_s: 40, reset_policy: between_goals}")
    graph = read_goal_graph(write_graph(text.replace("timeout_s: 20", "resources: [tray]")), catalogue)
    session = SessionCompiler(graph=graph, catalogue=catalogue, goal=GoalId("g-7"), seed=7).compile_node(
        "red", outputs={}
    )

    assert (session.limits.stall_s, session.limits.think_s, session.limits.preflight_s) == (3, 9, 40)
    assert session.resources == ("tray",)
    assert session.reset_policy is ResetPolicy.BETWEEN_GOALS


def test_the_word_target_becomes_the_target_of_the_session(compiler):
    assert compiler.compile_node("hand", outputs={}).accept == ("holding(panda, yellow_cube)",)


def test_outputs_fill_parameters_with_values_and_predicates_with_text(compiler):
    session = compiler.compile_node("blue", outputs={"red": {"place_site": [0.5, 0.25, 0.0]}})
    assert session.parameters["near"] == [0.5, 0.25, 0.0]
    assert "at(blue_cube, (0.5, 0.25, 0), 0.2)" in session.accept
    assert session.objective == "Put blue_cube beside the red cube."


def test_a_missing_output_is_an_error_that_names_it(compiler):
    with pytest.raises(DefinitionError, match=r"MISSING_VALUE: found no value for red\.outputs\.place_site"):
        compiler.compile_node("blue", outputs={"red": {}})


def test_a_preview_leaves_data_edges_as_they_are_written(compiler):
    blue = next(session for session in compiler.preview() if session.node == "blue")
    assert blue.parameters["near"] == "${red.outputs.place_site}"


def test_every_attempt_has_a_seed_and_an_id_of_its_own(compiler):
    revision = Revision(parent=SessionId("g-7.red"), strategy=Strategy(speed=0.5), requires=("visible(red_cube)",))
    child = compiler.compile_node("red", outputs={}, attempt=1, revision=revision)
    assert (child.id, child.parent, child.attempt) == ("g-7.red.r1", "g-7.red", 1)
    assert child.seed == compute_seed(7, "node", "red", "attempt", 1)
    assert child.seed != compiler.compile_node("red", outputs={}).seed
    assert child.requires == ("visible(red_cube)",)
    assert child.strategy == Strategy(speed=0.5)
