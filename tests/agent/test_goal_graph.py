"""Goal graphs: what they expand to, and every problem of a bad one at its place."""

import re
from dataclasses import replace

import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import check_goal_graph, read_goal_graph, render_mermaid
from phyagentos.agent.mission.worklist import GoalDag
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.skill_runtimes import Parameter, SkillRuntime

GOOD = """
    goal: good
    objective: Everything at once.
    scene: table
    targets: {arm: panda, someone: any}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
      beside:
        skill: pick_and_place
        target: someone
        with: {object: blue_cube, destination: red_tray, near: "${red.outputs.place_site}"}
      each:
        foreach: {cube: [green_cube, yellow_cube]}
        after: [red]
        skill: pick_and_place
        with: {object: "${cube}", destination: green_tray}
        accept: ["inside(${cube}, green_tray)"]
      last:
        after: [each, "each-green_cube"]
        skill: pick
        with: {object: red_cube}
    accept: ["count(inside(*, green_tray)) >= 2"]
    """

BAD = """
    goal: bad
    objective: Wrong in every way.
    scene: tabel
    targets: {arm: pandy}
    constraints: ["upright(bottel)"]
    sessions:
      one:
        skill: pick_and_plaze
        target: arm
        with: {object: red_cube, destination: red_tray}
      two:
        skill: pick_and_place
        target: nobody
        with: {object: red_cube, destination: red_tray}
      three:
        after: [tow]
        skill: pick_and_place
        with: {objekt: red_cube, destination: [1, 2], speed: 7}
        accept: ["insid(red_cube, red_tray)", "tilt(red_cube)"]
      four:
        skill: pick_and_place
        with: {object: rd_cube, destination: red_tray, near: "${five.outputs.place_sight}"}
      five:
        skill: pick_and_place
        with: {object: blue_cube, destination: "${red.outputs.place_site}"}
      six:
        foreach: {cube: [red_cube]}
        skill: {guarantees: "open(${cube})"}
        requires: ["visible(${cub})"]
    """


def test_a_graph_expands_fan_out_and_derives_edges_from_data(write_graph, catalogue):
    graph = read_goal_graph(write_graph(GOOD), catalogue)
    assert graph.order == ("red", "beside", "each-green_cube", "each-yellow_cube", "last")
    assert graph.nodes["beside"].after == ("red",)
    assert graph.nodes["last"].after == ("each-green_cube", "each-yellow_cube")
    assert graph.nodes["each-green_cube"].spec.accept == ("inside(green_cube, green_tray)",)
    assert GoalDag(graph, "tidy-7").find_after("red") == {"beside", "each-green_cube", "each-yellow_cube", "last"}
    assert graph.choices["beside"].target == "panda"


PROBLEMS = [
    ("UNKNOWN_NAME (scene)", "3:1", r"found 'tabel'; expected table. Did you mean 'table'\?"),
    ("UNKNOWN_NAME (target)", "4:11", r"found 'pandy'; expected any, panda. Did you mean 'panda'\?"),
    ("UNKNOWN_NAME (skill)", "8:5", r"found 'pick_and_plaze'; .* Did you mean 'pick_and_place'\?"),
    ("UNKNOWN_NAME (target)", "13:5", r"found 'nobody'; expected any, arm, panda"),
    ("UNKNOWN_NAME (node)", "16:13", r"found 'tow'; .* Did you mean 'two'\?"),
    ("UNKNOWN_NAME (parameter)", "18:12", r"found 'objekt'; .* Did you mean 'object'\?"),
    ("MISSING_VALUE", "18:5", r"found no 'object' for skill 'pick_and_place'; expected entity"),
    ("INVALID_VALUE", "18:30", r"found \[1, 2\]; expected a name"),
    ("INVALID_VALUE", "18:51", r"found 7; expected at most 1.0"),
    (
        "UNKNOWN_NAME (predicate)",
        "19:14",
        r"found 'insid' at column 1 of 'insid\(red_cube, red_tray\)'.*Did you mean 'inside'\?",
    ),
    ("INVALID_VALUE", "19:43", r"found 'tilt' at column 1"),
    (
        "UNKNOWN_NAME (output)",
        "22:52",
        r"found 'place_sight' of node 'five' .*expected place_site. Did you mean 'place_site'\?",
    ),
    ("UNKNOWN_NAME (node)", "25:31", r"found 'red' in \$\{red.outputs.place_site\}"),
    (
        "NO_CANDIDATE",
        "28:5",
        r"that guarantees 'open\(red_cube\)'.*; expected one of .*No skill guarantees .*; write one: docs/",
    ),
    ("UNKNOWN_NAME (reference)", "29:16", r"found \$\{cub\}; .*Did you mean 'cube'\?"),
]


def test_every_problem_is_reported_at_its_place_with_what_was_found_and_what_is_possible(write_graph, catalogue):
    found = check_goal_graph(write_graph(BAD), catalogue)
    problems = {(each.label, each.address.rpartition("graph.yaml:")[2]): str(each) for each in found}
    assert problems.keys() == {(label, place) for label, place, _ in PROBLEMS}
    assert [each for each in PROBLEMS if not re.search(each[2], problems[each[:2]])] == []


def test_an_unknown_entity_is_found_in_arguments_and_in_predicates(write_graph, catalogue):
    text = GOOD.replace("object: red_cube, destination: red_tray}", "object: rd_cube, destination: red_tray}")
    text = text.replace("inside(*, green_tray)", "inside(*, gren_tray)")
    problems = check_goal_graph(write_graph(text), catalogue)
    assert [problem.label for problem in problems] == ["UNKNOWN_NAME (object)", "UNKNOWN_NAME (object)"]
    assert "'gren_tray' at column 17" in str(problems[0])
    assert "Did you mean 'red_cube'?" in str(problems[1])


@pytest.mark.parametrize(
    ("change", "overrides", "told"),
    [
        pytest.param(
            ("  red:\n", "  red:\n        after: [last]\n"),
            {},
            r"CYCLE: found .*last -> .*each-\w+ -> last|CYCLE: found red -> .* -> red",
            id="a cycle is printed as the cycle",
        ),
        pytest.param(
            ("after: [red]", "aftr: [red]"),
            {},
            r"graph.yaml:\d+:5: UNKNOWN_NAME \(key\): found 'aftr'.*Did you mean 'after'\?",
            id="an unknown key with the nearest one",
        ),
        pytest.param(
            ("destination: red_tray, near:", "destination:"),
            {},
            r"output 'red\.outputs\.place_site', which is a point; expected a place",
            id="an output of the wrong type",
        ),
        pytest.param(
            ("${red.outputs.place_site}", "${each.outputs.place_site}"),
            {},
            r"INVALID_VALUE.*each-green_cube.outputs.place_site",
            id="a reference to a whole fan-out is ambiguous",
        ),
        pytest.param(
            ("", ""), {"targets.arm": "ur5"}, r"UNKNOWN_NAME \(target\): found 'ur5'", id="an override is checked too"
        ),
        pytest.param(
            ("", ""),
            {"targets.amr": "panda"},
            r"targets.amr: UNKNOWN_NAME \(role\): found 'amr'; expected arm, someone. Did you mean 'arm'\?",
            id="an override of a role that the graph has not",
        ),
        pytest.param(("", ""), {"targets.arm.left": "panda"}, "INVALID_VALUE", id="an override below a role"),
        pytest.param(
            ("", ""), {"objective": "["}, r"--set objective:\d+:\d+: SYNTAX", id="an override that is no YAML"
        ),
    ],
)
def test_a_graph_that_cannot_be_read_is_refused_with_the_reason(write_graph, catalogue, change, overrides, told):
    text = GOOD.replace(*change) if change[0] else GOOD
    with pytest.raises(DefinitionError, match=told):
        read_goal_graph(write_graph(text), catalogue, overrides)


def test_overrides_replace_single_values(write_graph, catalogue):
    graph = read_goal_graph(write_graph(GOOD), catalogue, {"defaults.max_replans": "5", "targets.arm": "panda"})
    assert graph.max_replans("red") == 5


def test_mermaid_shows_edges_outputs_and_choices(write_graph, catalogue):
    drawing = render_mermaid(read_goal_graph(write_graph(GOOD), catalogue))
    assert 'n0 -- "place_site" --> n1' in drawing
    assert "n0 --> n2" in drawing
    assert '<br/>pick_and_place on panda"]' in drawing


def test_nothing_to_accept_is_a_problem(write_graph, catalogue, tmp_path):
    idle = catalogue.skills["pick"].model_copy(update={"guarantees": ()})
    changed = replace(catalogue, skills={**catalogue.skills, "pick": idle})
    with pytest.raises(DefinitionError, match=r"MISSING_VALUE.*a session without a criterion can never succeed"):
        read_goal_graph(write_graph(GOOD), changed)


def test_every_shipped_goal_graph_is_free_of_problems(monkeypatch):
    monkeypatch.undo()
    root = find_shipped_root()
    catalogue = Catalogue.read(Library((root,)))
    files = sorted((root / "goal_graphs").glob("*.yaml"))
    assert files
    assert [str(p) for file in files for p in check_goal_graph(file, catalogue)] == []


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        (
            "destination: red_tray}",
            "destination: bottle}",
            "13:30",
            "found inside 'bottle', which is solid; expected an",
        ),
        (
            '["inside(red_cube, red_tray)"]',
            '["inside(red_cube, bottle)"]',
            "14:14",
            "found inside 'bottle', which is solid",
        ),
        (
            '["inside(red_cube, red_tray)"]',
            '["inside(wall, red_tray)"]',
            "14:14",
            "found 'wall', which is fixed, inside",
        ),
    ],
)
def test_what_cannot_be_put_there_is_told_before_anything_runs(monkeypatch, tmp_path, old, new, place, message):
    monkeypatch.undo()
    path = tmp_path / "tidy_table.yaml"
    path.write_text((find_shipped_root() / "goal_graphs" / "tidy_table.yaml").read_text().replace(old, new, 1))
    (problem,) = check_goal_graph(path, Catalogue.read(Library((find_shipped_root(),))))
    assert str(problem).startswith(f"{path}:{place}: INVALID_VALUE: {message}")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("goal: good", f"goal: {'g' * 81}", r"1:1: INVALID_VALUE: found 'g{81}'; expected at most 80 letters"),
        ("  last:", f"  {'n' * 81}:", r"20:3: INVALID_VALUE: found 'n{81}'; expected at most 80 lower-case letters"),
        ("yellow_cube]", f"{'v' * 100}]", r"15:5: INVALID_VALUE: found 'each-v{100}'; expected values that make"),
        ("skill: pick\n", "skill: pick\n        priority: 1000001\n", r"23:5: INVALID_VALUE: found 1000001"),
        (
            "objective: Everything at once.",
            "objective: 2001-99-99",
            r"2:12: SYNTAX: found '2001-99-99', which is no date",
        ),
        (
            'near: "${red.outputs.place_site}"',
            "near: [.nan, 0, 0]",
            r"\d+:\d+: INVALID_VALUE: found \[nan, 0, 0\]; expected three numbers",
        ),
    ],
)
def test_what_the_planes_could_not_take_is_a_problem_of_the_file(write_graph, catalogue, old, new, message):
    assert old in GOOD
    problems = "\n".join(map(str, check_goal_graph(write_graph(GOOD.replace(old, new)), catalogue)))
    assert re.search(rf"yaml:{message}", problems), problems


@pytest.mark.parametrize(
    ("worlds", "code", "sentence"),
    [
        ("{table: [arm, right]}", "", ""),
        ("{table: [arm, righd]}", "UNKNOWN_NAME (target)", r"found 'righd'; expected .*right.* Did you mean 'right'\?"),
        ("{table: [arm, right], shelf: [panda]}", "WORLD_CONFLICT", "found 'panda' in 'table' and in 'shelf'"),
        ("{table: [arm, alone]}", "WORLD_CONFLICT", "found 'alone' in a world of its own; expected the world 'table'"),
        (
            "{shelf: [arm]}",
            "WORLD_CONFLICT",
            "'panda' in the world 'table'; .* Write `world: shelf` into robots/panda/",
        ),
        ("{table: [arm, page]}", "WORLD_CONFLICT", "found driver 'debug' of 'page' in the shared world 'table'"),
    ],
)
def test_a_goal_says_which_targets_stand_in_one_world(write_graph, catalogue, worlds, code, sentence):
    panda = catalogue.targets["panda"]
    changes = {"panda": {}, "right": {}, "alone": {"world": ""}, "page": {"kind": "debug"}}
    targets = {
        name: panda.model_copy(update={"target": name, "world": "table", **each}) for name, each in changes.items()
    }
    own = replace(catalogue, targets=targets)
    text = GOOD.replace("    sessions:\n", f"    worlds: {worlds}\n    sessions:\n", 1)

    problems = check_goal_graph(write_graph(text), own)

    assert [problem.label for problem in problems] == [code] * bool(code)
    assert not code or re.search(sentence, str(problems[0]))


def test_a_posture_that_the_target_does_not_have_is_a_problem_with_the_nearest_name(write_graph, catalogue):
    reach = SkillRuntime(
        skill="reach", description="d", tree="reach", parameters={"posture": Parameter(type="posture")}
    )
    panda = catalogue.targets["panda"].model_copy(update={"postures": {"fist": (1.0,), "open_hand": (0.0,)}})
    catalogue = replace(catalogue, skills={"reach": reach}, targets={"panda": panda})
    text = """
        goal: g
        objective: o
        scene: table
        sessions: {a: {skill: reach, target: panda, with: {posture: %s}, accept: ["in_posture(target, fist)"]}}
        """
    assert check_goal_graph(write_graph(text % "fist"), catalogue) == []
    (problem,) = check_goal_graph(write_graph(text % "openhand"), catalogue)
    assert (problem.label, problem.hint) == ("UNKNOWN_NAME (posture)", "Did you mean 'open_hand'?")
