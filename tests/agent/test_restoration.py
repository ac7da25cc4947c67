"""What the world has undone: when it counts, which nodes are opened again for it, and what waits for them."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.recovery_parts.baselines import NoRetry, restart
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.agent.mission import goal_controller
from phyagentos.agent.repair.regressions import find_regressions
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.testing import make_contract

from .conftest import INSPECT, add_skills, check_report, get_order, hold, make_unmet, make_world, put, slip, succeed

HEAD = """
    goal: again
    objective: What is done stays done.
    scene: table
    sessions:
"""
ROW = """
      green: {skill: pick_and_place, with: {object: green_cube, destination: green_tray}, max_replans: REPLANS}
      blue: {skill: pick_and_place, with: {object: blue_cube, destination: blue_tray}, after: [green]}
      red:
        skill: pick_and_place
        with: {object: red_cube, destination: red_tray}
        after: [blue]
        priority: 5
        requires: ["inside(green_cube, green_tray)"]
"""
AWAY = (0.45, 0.1, 0.02)
SKILLS = {
    "inspect": INSPECT,
    "put_after_green": """
        description: Puts an object into a container once the green one is in its own.
        tree: pick_and_place
        parameters: {object: {type: entity}, destination: {type: place}}
        requires: ["inside(green_cube, green_tray)"]
        guarantees: ["inside(${object}, ${destination})"]
        needs: {actions: [joint_position], capabilities: [manipulation]}
        """,
}


@pytest.fixture
def library(library):
    return add_skills(library, SKILLS)


@pytest.fixture
def row(write_graph) -> Path:
    return write_graph(HEAD + ROW.replace("REPLANS", "2"))


def take_out(name, act=succeed):
    """While the skill acts, an object is taken out of its tray."""

    def play(world, session):
        done = act(world, session)
        return replace(done, world=put(done.world, name, AWAY))

    return play


def make_session(skill: str, *accept: str, **parameters: str) -> Session:
    return make_contract(skill=skill, accept=accept, parameters=parameters)


def see(now):
    return {"panda": (now, make_world())}


@pytest.mark.parametrize(
    ("later", "is_undone"),
    [
        (make_session("photograph", "visible(red_cube)", object="red_cube"), True),
        (make_session("photograph", "upright(red_cube)", "visible(red_cube)", object="red_cube"), True),
        (make_session("pick_and_place", "inside(green_cube, green_tray)", object="green_cube"), True),
        (make_session("pick_and_place", object="green_cube", destination="green_tray", near="red_cube"), True),
        (make_session("pick_and_place", object="red_cube", destination="green_tray"), False),
        (make_session("pick", object="red_cube"), False),
        (make_session("learned", "inside(red_cube, green_tray)", item="red_cube"), False),
        (make_session("learned", "moved(red_cube)", item="red_cube"), False),
        (make_session("learned", "not moved(red_cube)", item="red_cube"), True),
        (make_session("learned", "visible(red_cube)", item="red_cube"), True),
        (make_session("learned", "upright(red_cube)", item="green_cube"), True),
    ],
)
def test_a_later_node_takes_an_object_up_again_by_what_it_is_to_bring_about(catalogue, later, is_undone):
    promises = {name: skill.guarantees for name, skill in catalogue.skills.items()} | {"learned": ()}
    finished = {"red": make_session("pick_and_place", "inside(red_cube, red_tray)", object="red_cube"), "later": later}
    now = put(hold(make_world()), "red_cube", AWAY)
    after = {"red": frozenset({"later"}), "later": frozenset()}
    assert ("red" in find_regressions(finished, after.__getitem__, promises, see(now))) == is_undone


def test_only_a_node_that_comes_after_takes_an_object_up_again(catalogue):
    promises = {name: skill.guarantees for name, skill in catalogue.skills.items()}
    finished = {
        tray: make_session("pick_and_place", f"inside(red_cube, {tray})", object="red_cube", destination=tray)
        for tray in ("red_tray", "green_tray")
    }
    now = put(make_world(), "red_cube", (0.6, 0.0, 0.03))
    assert list(find_regressions(finished, lambda _: frozenset(), promises, see(now))) == ["red_tray"]
    after = {"red_tray": frozenset({"green_tray"}), "green_tray": frozenset()}
    assert find_regressions(finished, after.__getitem__, promises, see(now)) == {}


def test_only_lasting_facts_are_undone(catalogue):
    finished = {"pick": make_session("pick", "holding(panda, red_cube)", object="red_cube")}
    assert find_regressions(finished, lambda _: frozenset(), {"pick": ()}, see(hold(make_world()))) == {}


LOOKED_AT = """
      red: {skill: pick_and_place, with: {object: red_cube, destination: red_tray}}
      check: {skill: inspect, with: {object: red_cube}, after: [red]}
"""


def test_what_was_taken_away_while_it_was_looked_at_is_done_again(make_stage, write_graph):
    stage = make_stage({"check": take_out("red_cube")})
    report = stage.pursue(write_graph(HEAD + LOOKED_AT))
    assert (report.verdict, get_order(stage), report.replans) == ("success", ["red", "check", "red.r1"], 1)


@pytest.mark.parametrize("more", [{"policy": NoRetry()}, {"verifier": SessionVerifier(mode=VerificationMode.ENFORCE)}])
def test_what_was_taken_away_and_may_not_be_restored_is_a_goal_not_met(make_stage, write_graph, more):
    stage = make_stage({"check": take_out("red_cube")})
    report = stage.make_mission(**more).run(write_graph(HEAD + LOOKED_AT), seed=7)
    assert (report.verdict, get_order(stage)) == ("failure", ["red", "check"])
    assert "inside(red_cube, red_tray) no longer holds" in report.reason


CARRY = "      {0}: {{skill: pick_and_place, with: {{object: red_cube, destination: {0}}}, after: {1}}}\n"


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        pytest.param("[]", {"verdict": "failure", "reasons": {"": "no longer holds"}}, id="two nodes contradict"),
        pytest.param("[red_tray]", {"verdict": "success", "replans": 0}, id="a later node carries it on"),
    ],
)
def test_an_object_in_another_place_is_undone_unless_a_later_node_carried_it_there(
    make_stage, write_graph, after, expected
):
    graph = write_graph(HEAD + CARRY.format("red_tray", "[]") + CARRY.format("green_tray", after))
    check_report(make_stage().pursue(graph), **expected)


def test_a_child_waits_for_what_is_restored_however_far_back_and_whatever_its_priority(make_stage, row):
    stage = make_stage({"red": take_out("green_cube", slip)})
    ran = ["green", "blue", "red", "green.r1", "red.r1"]
    states = ["succeeded", "succeeded", "replanned", "succeeded", "succeeded"]
    check_report(stage.pursue(row), verdict="success", sessions=list(zip(ran, states, strict=True)), replans=2)
    assert get_order(stage) == ran


def test_what_the_skill_requires_and_an_earlier_node_had_achieved_is_restored_for_its_child(make_stage, write_graph):
    by_skill = """
      green: {skill: pick_and_place, with: {object: green_cube, destination: green_tray}}
      red: {skill: put_after_green, with: {object: red_cube, destination: red_tray}, after: [green]}
    """
    stage = make_stage({"red": take_out("green_cube", slip)})
    report = stage.pursue(write_graph(HEAD + by_skill))
    assert (report.verdict, get_order(stage)) == ("success", ["green", "red", "green.r1", "red.r1"])


def test_a_full_restart_that_this_process_has_loaded_leaves_other_repairs_as_they_are(make_stage, row, monkeypatch):
    monkeypatch.setattr(goal_controller, "Recovery", goal_controller.Recovery)  # as it was, afterwards
    restart()
    stage = make_stage({"red": take_out("green_cube", slip)})
    stage.pursue(row)
    assert get_order(stage) == ["green", "blue", "red", "green.r1", "red.r1"]


def test_what_is_undone_again_and_again_is_restored_no_more_often_than_its_node_may_have_children(make_stage, row):
    class Thief:
        def on_change(self, goal, ledger):
            if any(status.contract.node == "red" for status in ledger.iter_pending()):
                stage.runtime.world = put(stage.runtime.world, "green_cube", AWAY)
            stage.runtime.on_change(goal, ledger)

    stage = make_stage({"blue": take_out("green_cube")})
    report = stage.make_mission(observers=[Thief()]).run(row, seed=7)
    assert report.verdict == "failure"
    assert len([each for each in report.sessions if each.node == "green"]) <= 3


ONCE, TWICE = (HEAD + ROW.replace("REPLANS", count) for count in ("0", "2"))
LOSE = take_out("green_cube", slip)
DONE = [("green", "succeeded"), ("blue", "succeeded")]
RESTORED = [*DONE, ("red", "rejected"), ("green.r1", "succeeded")]


@pytest.mark.parametrize(
    ("graph", "stage", "expected"),
    [
        pytest.param(
            ONCE,
            {"script": {"red": LOSE}},
            {"verdict": "failure", "sessions": [*DONE, ("red", "replanned"), ("red.r1", "rejected")]},
            id="a child keeps what the node itself requires and is refused when nothing can restore it",
        ),
        pytest.param(
            TWICE,
            {"script": {"blue": take_out("green_cube")}},
            {"verdict": "success", "sessions": [*RESTORED, ("red.r1", "succeeded")], "replans": 2},
            id="what a node requires and one before it had achieved is restored before its first session",
        ),
        pytest.param(
            TWICE,
            {
                "script": {"blue": take_out("green_cube")},
                "refuse": {"red": make_unmet("inside(green_cube, green_tray)")},
            },
            {"verdict": "failure", "sessions": [*RESTORED, ("red.r1", "rejected")]},
            id="a refusal that no restoration mends ends the node",
        ),
    ],
)
def test_what_a_node_requires_is_restored_where_that_is_possible(make_stage, write_graph, graph, stage, expected):
    check_report(make_stage(**stage).pursue(write_graph(graph)), **expected)


def test_what_waits_for_a_restoration_that_fails_is_blocked_and_says_by_whom(make_stage, row):
    stage = make_stage({"red": LOSE, "green.r1": LOSE, "green.r2": LOSE})
    nodes = {"green": "blocked", "blue": "done", "red": "blocked"}
    check_report(stage.pursue(row), verdict="failure", nodes=nodes)
    reason = stage.make_mission().ledger.goals["again-7"].nodes["red"].reason
    assert reason == "it waits for green, which is blocked"
