"""The rest of a goal is planned anew where no alternative is left: nodes and edges in records, graph and TASK.md."""

import msgspec
import pytest
import yaml

from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.tasks import TASK, Relation, iter_edges

from .conftest import Play, add_skills, check_report, get_order, make_world, put

ROW = """
    goal: row
    objective: Red, then green.
    scene: table
    targets: {arm: panda}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
      green:
        after: [red]
        skill: pick_and_place
        target: arm
        with: {object: green_cube, destination: green_tray}
    accept: ["inside(red_cube, red_tray)", "inside(green_cube, green_tray)"]
    """
TAKEN = "anew1_pick_red_cube"


def no_way(world, session):
    return Play(world=world, ended=Ended.SKILL_FAILED, code="NO_IK", leaf="pick_and_place/pick/plan_grasp")


@pytest.fixture
def row(write_graph):
    return write_graph(ROW)


def test_other_skills_make_up_for_a_node_that_no_alternative_repairs(make_stage, row):
    stage = make_stage({"red": no_way, "red.r1": no_way})
    report = stage.pursue(row)

    goal = stage.make_mission().ledger.goals["row-7"]
    nodes = {"red": "rescued", "green": "skipped", TAKEN: "done"}
    assert (report.verdict, report.nodes | nodes) == ("success", report.nodes)

    assert goal.nodes["anew1_place_red_cube"].after == (TAKEN,)
    relations = {(edge.before, edge.step): edge.relation for edge in iter_edges(goal)}
    assert relations["red", TAKEN] is Relation.ON_FAILURE
    assert TAKEN in (stage.workspace.root / TASK.file).read_text()


def test_a_goal_that_cannot_be_planned_ends_as_before(make_stage, write_graph):
    graph = write_graph(ROW.replace('accept: ["inside(red', 'accept: ["near(red_cube, bottle, 0.1)", "inside(red'))
    report = make_stage({"red": no_way, "red.r1": no_way}).pursue(graph)
    check_report(report, {"": "NO_IK"}, verdict="failure", exit_code=1)


def test_no_plan_is_made_once_the_replans_are_spent(make_stage, write_graph):
    graph = write_graph(ROW.replace("with: {object: red_cube", "max_replans: 0\n        with: {object: red_cube"))
    stage = make_stage({"red": no_way})

    assert stage.pursue(graph).verdict == "failure"
    assert [session.node for session in stage.runtime.ran] == ["red"]


def test_what_stands_on_an_object_is_moved_before_another_way_is_tried(make_stage, row):
    world = put(make_world(), "yellow_cube", (0.4, 0.3, 0.06))
    stage = make_stage({"red": no_way}, world=world)
    report = stage.pursue(row)

    assert report.verdict == "success"
    assert [session.id for session in report.sessions if ".red" in session.id] == ["row-7.red"]
    ran = [(session.skill, session.parameters["object"]) for session in stage.runtime.ran]
    assert ran.index(("pick", "yellow_cube")) < ran.index(("pick_and_place", "red_cube"), 1)
    assert "not on(yellow_cube, red_cube)" in stage.make_mission().ledger.goals["row-7"].nodes["red"].reason


def test_what_another_node_is_about_to_move_out_of_its_place_is_waited_for(make_stage, write_graph):
    def lose(world, session):
        return Play(world=world, ended=Ended.SKILL_FAILED, code="GRASP_LOST", leaf="pick_and_place/place/carry")

    world = put(make_world(), "red_cube", (0.4, 0.0, 0.06))
    stage = make_stage({"red": lose, "green": no_way}, world=world)
    report = stage.pursue(write_graph(ROW.replace("        after: [red]\n", "")))

    assert report.verdict == "success"
    ran = [(session.id, session.parameters["object"]) for session in stage.runtime.ran]
    assert {name for _, name in ran[1 + ran.index(("row-7.red.r1", "red_cube")) :]} == {"green_cube"}


def test_what_a_node_that_fans_out_would_bring_about_is_no_part_of_the_rest(make_stage, write_graph):
    text = ROW.replace('    accept: ["inside(red_cube, red_tray)", "inside(green_cube, green_tray)"]\n', "").rstrip()
    each = """
      each:
        after: [green]
        foreach: {thing: "inside(${thing}, red_tray)"}
        skill: pick_and_place
        target: arm
        with: {object: "${thing}", destination: blue_tray}
    """
    report = make_stage({"red": no_way, "red.r1": no_way}).pursue(write_graph(text + each))

    assert (report.verdict, report.nodes["red"]) == ("success", "rescued")


MAKE = """
    description: Has so many of an item.
    tree: make
    parameters: {object: {type: string}, count: {type: integer}}
    guarantees: ["holds(${object}) >= ${count}"]
    needs: {actions: [joint_position], capabilities: [manipulation]}
    """
FLOOR = """
    goal: floor
    objective: Two planks.
    scene: table
    targets: {arm: panda}
    sessions:
      planks: {skill: make, target: arm, with: {object: plank, count: 2}}
    accept: ["holds(plank) >= 2"]
    """


def test_a_tool_that_broke_in_use_is_made_again_before_the_session_is_tried_again(make_stage, library, write_graph):
    add_skills(library, {"make": MAKE})
    book = [{"item": "plank", "needs": ["axe"]}, {"item": "axe", "lasts": 2}]
    (library.roots[0] / "skills" / "make" / "recipes.yaml").write_text(yaml.safe_dump({"recipes": book}))

    def carry(world, **items):
        arm = world.targets["panda"]
        return msgspec.structs.replace(
            world, targets={"panda": msgspec.structs.replace(arm, inventory={**(arm.inventory or {}), **items})}
        )

    def make(world, session):
        return Play(world=carry(world, **{session.parameters["object"]: session.parameters["count"]}))

    def wear(world, session):
        return Play(world=carry(world, axe=0, plank=1), ended=Ended.SKILL_FAILED, code="CALL_FAILED", leaf="make")

    names = ("planks", "anew1_make_axe", "anew1_make_plank")
    stage = make_stage(dict.fromkeys(names, make) | {"planks": wear}, world=carry(make_world(), axe=1))
    report = stage.pursue(write_graph(FLOOR))

    assert get_order(stage) == [*names]
    assert report.verdict == "success"
