"""The generator of unseen worlds: what it draws, what it calls feasible, and how it counts."""

import ast
import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from benchmarks.oracle.feasible import find_ambiguity, find_contradiction, list_obstacles
from benchmarks.oracle.scorers import UNSEEN
from benchmarks.unseen_parts.figures import Tally, find_interval
from benchmarks.unseen_parts.records import NodeRecord, SessionRecord, begin_record, mark_open
from benchmarks.worlds import projects
from benchmarks.worlds.cases import Case, Node
from benchmarks.worlds.files import render_scene
from benchmarks.worlds.forms import Form, Solid, make_box, make_vessel
from benchmarks.worlds.goals import draw_case
from benchmarks.worlds.rooms import COMPOUND, Room, SceneObject
from benchmarks.worlds.trials import draw as draw_trial
from phyagentos.bench.records import EpisodeRecord
from phyagentos.operations.lint import lint_paths

PARTS = Path(projects.__file__).parents[1]
PURE = (
    *(f"worlds.{name}" for name in ("forms", "rooms", "cases", "faults", "impossible", "goals", "instances", "files")),
    *(f"oracle.{name}" for name in ("moment", "predicates", "acceptance", "conditions", "feasible", "skill_facts")),
)

CASES = [draw_case(seed) for seed in range(12)]


def test_seed_gives_the_same_case_whatever_was_drawn_before():
    assert [draw_case(seed) for seed in (7, 3)] == [CASES[7], CASES[3]]
    assert len({json.dumps(render_scene(case.room, "x"), default=float) for case in CASES}) == len(CASES)


def test_what_begins_tilted_is_not_to_be_kept_upright_all_through():
    """Such a goal is broken before anything moves: it was counted as one that can be met."""
    cases = [draw_case(seed, COMPOUND) for seed in range(1_005_118, 1_005_122)]
    kept = [text for case in cases for text in case.constraints if text.startswith("upright(")]
    tilted = {item.name for case in cases for item in case.room.movable if any(item.euler_rad)}
    assert "yellow_can" in tilted
    assert not [text for text in kept if text[len("upright(") : -1] in tilted]


@pytest.mark.slow
def test_scenes_goals_and_faults_pass_lint(tmp_path):
    for case in CASES[:6]:
        projects.write_case(case, tmp_path / case.name)
    found = lint_paths([tmp_path / case.name for case in CASES[:6]])
    assert not found.problems
    assert len(found.checked) == 18


@pytest.mark.parametrize("module", PURE)
def test_judge_and_feasibility_import_nothing_of_the_package(module):
    tree = ast.parse((PARTS / f"{module.replace('.', '/')}.py").read_text())
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    own = {f"benchmarks.{name}" for name in PURE}
    assert not [name for name in names if name.startswith("phyagentos")]
    assert not [name for name in names if name.startswith("benchmarks") and name not in own]


# -- feasible ----------------------------------------------------------------------------------------------------------


def make_object(name="thing", form=None, at=(0.5, 0.0), **rest):
    form = form or make_box(0.04, 0.04, 0.04)
    return SceneObject(name, form, (*at, form.bottom_m), None, "red", (0.8, 0.1, 0.1), **rest)


def find_why(item, node, *others):
    tray = make_object("tray", make_vessel(0.12, 0.16, 0.02, "tray"), (0.5, 0.3), fixed=True)
    room = Room(0, {each.name: each for each in (tray, item, *others)}, {}, ())
    return list_obstacles(Case(0, room, (node,)), node)


PUT = Node("n1", "pick_and_place", {"object": "thing", "destination": "tray"}, ("inside(thing, tray)",))


@pytest.mark.parametrize(
    ("item", "said"),
    [
        (make_object(), None),
        (make_object(form=make_box(0.079, 0.11, 0.05)), None),
        (make_object(form=make_box(0.081, 0.11, 0.05)), "81 mm wide"),
        (make_object(at=(0.8, 0.3)), None),
        (make_object(at=(0.8, 0.5)), "0.94 m from the base"),
        (make_object(mass_kg=2.3, grip=(0.9, 1.0)), "the arm carries 2.27 kg"),
        (make_object(mass_kg=2.2, grip=(0.12, 0.15)), "friction of both fingers"),
        (make_object(mass_kg=2.2, grip=(0.12, 0.16)), None),
    ],
)
def test_reach_opening_payload_and_friction_decide(item, said):
    found = find_why(item, PUT)
    assert (said is None) == (found == [])
    assert said is None or said in found[0]


def test_volume_decides_and_a_ball_may_sink_between_walls():
    long = make_object(form=make_box(0.03, 0.05, 0.25))
    wide = make_object(form=make_box(0.125, 0.07, 0.125))
    assert find_why(long, PUT) == []
    assert "does not go into" in "".join(find_why(make_object(form=make_box(0.075, 0.21, 0.21)), PUT))
    assert find_why(wide, PUT) == []
    assert find_why(make_object(form=Form("ball", (Solid("sphere", (0.035,)),), 0.07)), PUT) == []


def test_a_vessel_that_is_filled_for_good_is_infeasible_and_one_with_a_cube_is_not():
    block = make_object("filling", make_box(0.116, 0.156, 0.03), (0.5, 0.3), on="tray")
    assert "filled by filling" in find_why(make_object(), PUT, block)[0]
    ball = make_object(form=Form("ball", (Solid("sphere", (0.012,)),), 0.024))
    assert "filled by filling" in find_why(ball, PUT, block)[0]  # it would lie on top
    assert find_why(make_object(), PUT, make_object("cube", at=(0.5, 0.3), on="tray")) == []


def test_nothing_stands_on_a_ball():
    node = Node("n1", "stack", {"object": "thing", "support": "ball"}, ("on(thing, ball)",))
    ball = make_object("ball", Form("ball", (Solid("sphere", (0.03,)),), 0.06), (0.4, 0.1))
    assert "no level top" in find_why(make_object(), node, ball)[0]


def test_four_objects_that_cover_more_than_a_flat_tray_have_no_room():
    objects = [make_object(f"box_{letter}", make_box(0.079, 0.079, 0.09), (0.4, 0.1)) for letter in "abcd"]
    nodes = tuple(replace(PUT, arguments={"object": each.name, "destination": "tray"}) for each in objects)
    tray = make_object("tray", make_vessel(0.12, 0.16, 0.02, "tray"), (0.5, 0.3), fixed=True)
    room = Room(0, {each.name: each for each in (tray, *objects)}, {}, ())
    assert list_obstacles(Case(0, room, nodes[:2]), nodes[0]) == []
    assert "have no room" in "".join(list_obstacles(Case(0, room, (*nodes, nodes[0])), nodes[0]))
    deep = make_object("tray", make_vessel(0.12, 0.16, 0.1, "bin"), (0.5, 0.3), fixed=True)
    assert list_obstacles(Case(0, replace(room, objects=room.objects | {"tray": deep}), nodes), nodes[0]) == []


def test_a_name_of_one_of_two_equal_objects_is_left_open():
    room = Room(0, {each.name: each for each in (make_object("thing"), make_object("other"))}, {}, ())
    assert find_ambiguity(Case(0, room, (PUT,)), PUT) == "thing looks as other does"
    room = room.change("other", rgb=(0.1, 0.1, 0.8))
    assert find_ambiguity(Case(0, room, (PUT,)), PUT) == ""


def test_one_object_is_not_in_two_vessels():
    both = replace(PUT, accept=("inside(thing, tray)", "inside(thing, bin)"))
    assert "cannot be in" in find_contradiction(Case(0, Room(0, {}, {}, ()), (both,)))
    assert find_contradiction(Case(0, Room(0, {}, {}, ()), (replace(both, is_claim=True),))) == ""


# -- counting ----------------------------------------------------------------------------------------------------------


def make_session(verdict, truth, **rest):
    told = {"id": "g.n1", "node": "n1", "skill": "pick", "attempt": 0}
    told |= {"target": "panda", "objective": "", "state": "", "bundle": ""}
    return SessionRecord(verdict=verdict, truth=truth, **told | rest)


def make_record(seed, *sessions, feasible="yes", verdict="success", truth="met", **rest):
    node = NodeRecord(name="n1", skill="pick", feasible=feasible, why="", first=truth == "met")
    told = {"nodes": (node,), "sessions": sessions, "feasible": feasible, "verdict": verdict, "truth": truth}
    return begin_record(CASES[seed], make_episode(), **told | {"reason": "because"} | rest)


def make_episode(**rest):
    return EpisodeRecord(id="unseen-1", task="unseen", seed=1, at="", folder="", **rest)


def test_figures_count_verdicts_against_truth():
    records = [
        make_record(3, make_session("success", "met")),
        make_record(4, make_session("success", "unmet"), truth="unmet"),
        make_record(5, make_session("replan", "met"), make_session("replan", "open"), verdict="failure", truth="unmet"),
        make_record(6, feasible="no", verdict="failure", truth=""),
        make_record(8, make_session("replan", "unmet", moved=True), feasible="no", verdict="failure", truth="unmet"),
        begin_record(CASES[9], make_episode(ended="hung")),
    ]
    figures = Tally(records).build_figures()
    assert figures["goals"] == 6
    assert figures["judged_sessions"] == 5
    assert figures["false_successes"] == 2  # a session, and its goal
    assert figures["judged_unmet_in_truth"] == 2
    assert figures["judged_open"] == 1
    assert figures["false_failures"] == 0.5
    assert figures["infeasible_refused"] == 0.5
    assert figures["feasible_goals_met"] == 0.25
    assert figures["hung"] == 1
    assert figures["false_success_bound"] > 2 / 5


@pytest.mark.parametrize(
    ("before", "begun", "counted"),
    [
        ("no", ("n1",), ["n3"]),
        ("open", ("n1",), ["n3"]),
        ("yes", ("n1",), ["n1", "n2", "n3"]),
        ("no", ("n1", "n2"), ["n2", "n3"]),
    ],
)
def test_a_node_behind_one_that_cannot_be_met_counts_only_if_it_was_begun(before, begun, counted):
    feasible = {"n1": before, "n2": "yes", "n3": "yes"}
    nodes = tuple(
        NodeRecord(name=name, skill="pick", feasible=each, why="", first=False, after=("n1",) if name == "n2" else ())
        for name, each in feasible.items()
    )
    record = make_record(3, *(make_session("failure", "unmet", node=name) for name in begun), nodes=nodes)

    assert [node.name for node in Tally([record]).first_attempts] == counted


def test_a_session_that_asks_to_look_again_is_no_false_failure_when_a_look_follows():
    sessions = [make_session("replan", "met", cause="EVIDENCE_MISSING", id=id) for id in ("g.n1", "g.n1.r1")]
    assert [session.is_false_failure for session in mark_open(sessions)] == [False, True]
    other = make_session("success", "met", node="n2")
    assert mark_open([sessions[0], other])[0].is_false_failure


def test_what_is_met_by_less_than_cameras_can_tell_is_no_false_failure():
    assert not make_session("replan", "met", is_clear=False).is_false_failure
    assert make_session("success", "unmet", is_clear=False).is_false_success


def test_where_every_camera_lies_no_false_failure_is_counted():
    record = make_record(3, make_session("replan", "met"), make_session("success", "unmet"))
    assert Tally([record]).build_figures()["false_failures"] == 1.0
    blind = Tally([replace(record, faults=("blackout *",))]).build_figures()
    assert blind["false_failures"] != blind["false_failures"]  # NaN: nothing to count
    assert blind["false_successes"] == 1


def test_interval_is_exact():
    assert find_interval(0, 1000)[1] == pytest.approx(1 - 0.025 ** (1 / 1000))
    assert find_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("drawn", [projects.draw_unseen, projects.draw_slick, projects.draw_compound, draw_trial])
def test_a_drawn_project_tells_its_scorer_which_case_it_is_and_passes_lint(drawn, tmp_path):
    seed = 1_500_006
    graph = drawn(seed, tmp_path / "project")
    case = projects.read_case(tmp_path / "project")
    assert not lint_paths([tmp_path / "project"]).problems
    assert (case.seed, graph.stem) == (seed, case.name)
    assert yaml.safe_load(graph.read_text())["accept"] == list(case.accept)
    assert len(yaml.safe_load((tmp_path / "project" / "faults.yaml").read_text())["faults"]) == len(case.faults)
    assert UNSEEN.score({"goal": "accept"}, tmp_path / "workspace", None) == {"goal": False}
