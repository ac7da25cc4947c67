"""Goals of shipped and generated scenes: what is planned, in which order, and what is missing where nothing can be."""

from dataclasses import replace as replace_slots

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from benchmarks.worlds.kinematics import find_fault
from benchmarks.worlds.puzzles import SOLVABLE, UNSOLVABLE, write_task
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.answers import PlannedGoal, UnreachableReason, Unsolvable
from phyagentos.agent.planning.planned import plan_goal, write_graph
from phyagentos.assembly.scene_start import draw_start
from phyagentos.protocol.capabilities.library import Library

pytestmark = pytest.mark.sim  # scenes are drawn; nothing is stepped

LIBRARY = Library.open()
CATALOGUE = Catalogue.read(LIBRARY)


def plan(scene, *accept, steps=(), constraints=(), targets=None, catalogue=CATALOGUE):
    targets = {"arm": "panda"} if targets is None else targets
    fields = {"goal": "g", "objective": "o", "scene": scene, "targets": targets}
    wanted = WantedGoal(**fields, accept=accept, steps=steps, constraints=constraints)
    return plan_goal(wanted, catalogue, draw_start(LIBRARY, scene, targets.values(), 0))


def list_sessions(planned):
    assert isinstance(planned, PlannedGoal), planned
    return [(step.skill, *(v for v in step.parameters.values() if isinstance(v, str))) for step in planned.steps]


def find_missing(planned):
    assert isinstance(planned, Unsolvable), planned
    assert planned.is_proven
    (missing,) = planned.missing
    assert missing.describe()
    return missing.lack, missing.names


def test_a_tower_is_built_from_its_bottom_although_its_top_is_named_first():
    planned = plan("tabletop/stacking", "on(blue_block, red_block)", "on(red_block, pad)")
    assert list_sessions(planned) == [("stack", "red_block", "pad"), ("stack", "blue_block", "red_block")]
    assert planned.steps[1].after == (planned.steps[0].name,)
    assert any("which the goal wants" in reason for reason in planned.steps[0].reasons)


def test_what_is_put_into_a_drawer_is_put_in_while_it_is_open():
    planned = plan("tabletop/drawer", "closed(drawer)", steps=[("inside(green_cube, drawer)",)])
    assert [session[0] for session in list_sessions(planned)] == ["open_drawer", "pick_and_place", "close_drawer"]


def test_what_stands_on_an_object_is_set_aside_before_that_is_taken():
    planned = plan("tabletop/panel_and_stack", "on(lower_block, upper_block)")
    assert [session[:2] for session in list_sessions(planned)] == [
        ("set_aside", "upper_block"),
        ("stack", "lower_block"),
    ]


def test_what_stands_at_a_wanted_point_is_moved_first():
    planned = plan("recovery/workshop", "at(carton, (0.36, -0.2, 0.03), 0.05)", "inside(green_cube, green_tray)")
    by_object = {step.parameters["object"]: step for step in planned.steps}
    assert by_object["carton"].after == (by_object["green_cube"].name,)


def test_independent_sessions_have_no_order():
    planned = plan("tabletop/cubes_and_trays", "inside(red_cube, red_tray)", "inside(green_cube, green_tray)")
    assert [step.after for step in planned.steps] == [(), ()]


def test_what_several_sessions_bring_about_together_is_accepted_by_none_of_them_alone():
    planned = plan("tabletop/cubes_and_trays", "inside(red_cube, red_tray) and inside(green_cube, green_tray)")
    assert [step.accept for step in planned.steps] == [(), ()]


def test_a_goal_that_is_met_needs_no_session():
    assert list_sessions(plan("tabletop/stacking", "on(red_block, table)")) == []


@pytest.mark.parametrize(
    ("accept", "more", "lack", "name"),
    [
        ("near(red_cube, blue_cube, 0.05)", {}, UnreachableReason.PREDICATE, ""),
        ("docked(arm, red_tray)", {}, UnreachableReason.CAPABILITY, "panda lacks capability driving for drive_to"),
        (
            "inside(red_cube, red_tray)",
            {"targets": {"dog": "go2"}},
            UnreachableReason.CAPABILITY,
            "capability manipulation",
        ),
        ("inside(red_cube, bottle)", {}, UnreachableReason.ARGUMENT, "pick_and_place"),
        (
            "inside(red_cube, red_tray)",
            {"constraints": ["not moved(red_cube)"]},
            UnreachableReason.CONSTRAINT,
            "not moved",
        ),
    ],
)
def test_what_is_missing_is_named(accept, more, lack, name):
    found, names = find_missing(plan("tabletop/cubes_and_trays", accept, **more))
    assert found is lack
    assert name in "; ".join(names)


def test_without_a_skill_for_it_the_precondition_is_named():
    skills = {name: each for name, each in CATALOGUE.skills.items() if name not in {"open_drawer", "open_hinged"}}
    planned = plan("tabletop/drawer", "inside(green_cube, drawer)", catalogue=replace_slots(CATALOGUE, skills=skills))
    assert find_missing(planned) == (UnreachableReason.PRECONDITION, ("open(drawer)",))


def test_no_skill_is_known_by_name():
    renamed = {f"{name}_x": each.model_copy(update={"skill": f"{name}_x"}) for name, each in CATALOGUE.skills.items()}
    catalogue = replace_slots(CATALOGUE, skills=renamed)
    planned = plan("tabletop/drawer", "closed(drawer)", steps=[("inside(green_cube, drawer)",)], catalogue=catalogue)
    assert [session[0] for session in list_sessions(planned)] == ["open_drawer_x", "pick_and_place_x", "close_drawer_x"]


@pytest.mark.parametrize("family", UNSOLVABLE)
def test_what_cannot_be_reached_is_said_with_its_reason(family, tmp_path):
    task = write_task(family, 0, tmp_path)
    assert find_missing(plan_goal(task.wanted, CATALOGUE, task.world))[0] == task.lack


@given(family=st.sampled_from(sorted(SOLVABLE)), seed=st.integers(0, 10_000))
@settings(
    max_examples=6,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_every_plan_of_a_random_world_is_valid_in_every_order_that_it_allows(family, seed, tmp_path):
    task = write_task(family, seed, tmp_path)
    planned = plan_goal(task.wanted, CATALOGUE, task.world)
    assert isinstance(planned, PlannedGoal), planned
    path = tmp_path / "graph.yaml"
    path.write_text(write_graph(planned))
    graph = read_goal_graph(path, Catalogue.read(Library.open(tmp_path)))
    assert set(graph.nodes) == {step.name for step in planned.steps}
    assert find_fault(task.wanted, graph, task.world, seed) == ""


def test_without_a_named_robot_it_is_one_that_is_sure_to_be_here():
    planned = plan("tabletop/cubes_and_trays", "inside(red_cube, red_tray)", targets={"arm": "any"})
    assert planned.roles == {"arm": "panda"}


def test_what_stands_on_its_head_is_stood_up_where_it_stands_unless_the_goal_says_where():
    scene = "tabletop/sponge_and_stool"
    assert list_sessions(plan(scene, "upright(stool)")) == [("stand_up", "stool", "table")]
    assert ("stand_up", "stool", "table") in list_sessions(plan(scene, "upright(stool)", "not inside(*, spot)"))
    assert ("stand_up", "stool", "dish") in list_sessions(plan(scene, "upright(stool)", "on(stool, dish)"))


def test_an_empty_top_bears_a_row_and_what_stands_on_it_in_the_middle_is_set_aside_first():
    both = plan("tabletop/stacking", "on(blue_block, pad)", "on(yellow_block, pad)")
    assert [skill for skill, *_ in list_sessions(both)] == ["stack", "stack"]
    stool = plan("tabletop/sponge_and_stool", "on(stool, dish)")
    assert [session[:2] for session in list_sessions(stool)] == [("set_aside", "sponge"), ("stack", "stool")]


@pytest.mark.parametrize(("first", "second"), [("stop", "start"), ("start", "stop")])
def test_what_the_last_step_adds_comes_after_the_step_before_it(first, second):
    accept = (f"closed({first})", f"closed({second})")
    planned = plan("tabletop/panel_and_stack", *accept, steps=[accept[:1]])
    assert [session[1] for session in list_sessions(planned)] == [first, second]
    assert planned.steps[1].after == (planned.steps[0].name,)


def test_a_place_is_not_wiped_with_what_lies_in_it():
    planned = plan("tabletop/sponge_and_stool", "not inside(*, spot)", "on(sponge, dish)")
    assert list_sessions(planned) == [("wipe", "sponge", "spot", "table", "dish")]
