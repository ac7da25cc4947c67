"""`paos lint`: every problem of every file, with its place, what was found, what is possible, the nearest name."""

import os
import re
from pathlib import Path

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.lint import FileKind, find_kind
from tests.command_line import assert_refused

ROOT = Path(__file__).resolve().parents[2]
GRAPH = """\
goal: broken
objective: Nothing of this can run.
scene: tabletop/cubes_and_trays
targets: {arm: panda}
colour: red
sessions:
  red:
    skill: pick_and_plase
    target: arm
    with: {object: red_cube, destination: red_tray}
    accept: ["insde(red_cube, red_tray)"]
"""
RED, BLUE = (
    "red: {surface: plastic, rgba: [0.82, 0.16, 0.14, 1]",
    "blue: {surface: plastic, rgba: [0.12, 0.33, 0.78, 1]",
)


@pytest.fixture
def write(tmp_path):
    def write(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.slow
def test_everything_that_ships_is_clean(paos):
    folders = [
        "goal_graphs",
        "trees",
        "skills",
        "scenes",
        "robots",
        "faults",
        "protocol",
        "examples/projects/01_yaml_skill",
        "examples/projects/03_policy_server",
        "examples/projects/04_two_arms",
        "examples/projects/07_fetch_and_sort",
        "examples/projects/08_meta_world",
        "examples/projects/11_workbench",
        "benchmarks/crafter_parts/library",
        "benchmarks/luanti_parts/library",
        "benchmarks/scienceworld_parts/library",
        "benchmarks/nle_parts/library",
    ]
    result = paos("lint", *[ROOT / folder for folder in folders])
    assert (result.code, result.err) == (ExitCode.GOAL_MET, "")
    assert int(result.out.split()[0]) > 250, "of each folder some files are checked"


def test_problems_of_several_files_are_reported_in_their_order(paos, write):
    first = write("a.yaml", "goal: [")
    second = write("b.yaml", "goal: x\ngoal: y\n")
    result = paos("lint", first, second)
    lines = result.err.splitlines()
    assert lines[0].startswith(f"{first}:")
    assert "SYNTAX" in lines[0]
    twice = "DUPLICATE_NAME: found 'goal'; expected each key once. Rename or remove one; the first is on line 1."
    assert lines[1] == f"{second}:2:1: {twice}"
    assert lines[-1] == "2 files checked, 2 problems"


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(5)
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("goal_graphs/bomb.yaml", BOMB),
        ("safety.yaml", BOMB),
        ("faults/bomb.yaml", BOMB),
        ("SKILL.md", f"---\n{BOMB}---\n"),
        ("TARGETS.md", f"---\nphy: targets/1\n---\n## a\n```yaml\n{BOMB}```\n"),
    ],
)
def test_aliases_that_stand_for_more_than_memory_holds_are_a_problem(paos, write, name, text):
    assert_refused(paos("lint", write(name, text)), "SYNTAX: found more than 100000 values")


@pytest.mark.parametrize("name", ["a.yaml", "SESSIONS.md", "safety.yaml", "SKILL.md"])
@pytest.mark.parametrize(
    "make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda path: path.symlink_to(path.name)]
)
def test_a_file_that_is_no_regular_file_is_a_problem_and_not_waited_for(paos, tmp_path, name, make):
    make(tmp_path / name)
    assert_refused(paos("lint", tmp_path / name), f"{name}: UNREADABLE_FILE")


SKILL = """\
---
skill: dance
description: Nothing.
tree: pick_and_plaice
parameters:
  object: {type: entity}
guarantees: ["inside(${objekt}, red_tray)"]
---
# Dance
"""


def read(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


BROKEN = "goal_graphs/broken.yaml"
POLICY = "skills/pick_by_state/SKILL.md"
LIMITS, UNSOURCED = read("protocol/safety.yaml"), re.compile("source: .*")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        pytest.param(
            BROKEN, GRAPH, [":5:1: UNKNOWN_NAME (key): found 'colour'; expected ", "objective"], id="an unknown key"
        ),
        pytest.param(
            BROKEN,
            GRAPH.replace("colour: red", "described: {parcel: a rde bxo, red_cube: a box, unknown_2: a can}").replace(
                "object: red_cube", "object: parcle"
            ),
            [
                ":5:13: UNKNOWN_NAME (word): found 'rde' at column 3 of 'a rde bxo'; expected black, ",
                "'bxo' at column 7 of 'a rde bxo'; expected ball, box, can, thing. Did you mean 'box'?",
                "INVALID_VALUE: found 'red_cube'",
                "INVALID_VALUE: found 'unknown_2'",
            ],
            id="a description is checked word by word",
        ),
        pytest.param(
            BROKEN,
            GRAPH.replace("colour: red\n", ""),
            [
                ":7:5: UNKNOWN_NAME (skill): found 'pick_and_plase'",
                "Did you mean 'pick_and_place'?",
                "UNKNOWN_NAME (predicate): found 'insde' at column 1",
                "Did you mean 'inside'?",
                "1 file checked, 2 problems",
            ],
            id="all problems of a graph are reported at once",
        ),
        pytest.param(
            "shopping.yaml",
            "tre: [milk]\n",
            [":1:1: INVALID_VALUE: found top-level keys tre", "Did you mean 'tree'?"],
            id="a file of no kind names the kinds",
        ),
        pytest.param("nowhere.yaml", None, [": UNREADABLE_FILE"], id="a missing file"),
        pytest.param(
            "SESSIONS.md",
            "# Sessions\n\n## one\n\n```yaml\nstate: pending\nstate: running\n```\n",
            [":7:1: DUPLICATE_NAME: found 'state'"],
            id="a document is checked in its YAML blocks",
        ),
        pytest.param(
            "perception.yaml",
            "sensing: truth\npipelines:\n  world:\n    sensors: [simulator_stat]\n    produces: [entity_poses]\n",
            [":4:15: UNKNOWN_NAME (sensor): found 'simulator_stat'", "Did you mean 'simulator_state'?"],
            id="a perception pipeline may only use sensors that exist",
        ),
        pytest.param("safety.yaml", UNSOURCED.sub("source: ''", LIMITS, 1), ["MISSING_VALUE"], id="an unsourced limit"),
        pytest.param(
            "skills/dance/SKILL.md",
            SKILL,
            [
                ":4:1: UNKNOWN_NAME (tree): found 'pick_and_plaice'",
                "Did you mean 'pick_and_place'?",
                "UNKNOWN_NAME (parameter): found '${objekt}'",
                "Did you mean 'object'?",
            ],
            id="a skill is checked against its parameters and trees",
        ),
        pytest.param(
            POLICY,
            read(f"examples/projects/10_train_policy/{POLICY}").replace(
                "begins_after: start_over, aim: aim", "begins_after: start_ove, aim: near"
            ),
            [
                ":29:68: UNKNOWN_NAME (skill): found 'start_ove'",
                "Did you mean 'start_over'?",
                ":29:93: UNKNOWN_NAME (parameter): found 'near'; expected aim, destination, object",
            ],
            id="what a policy asks for its next attempt must exist",
        ),
        pytest.param(
            "goal_graphs/insert_peg.yaml",
            read("goal_graphs/insert_peg.yaml").replace("socket: socket}", "socket: peg}"),
            [":11:25: INVALID_VALUE: found 'peg', of kind peg; expected of kind socket: socket"],
            id="a thing of a kind that the skill does not take",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_every_problem_at_its_place(paos, write, tmp_path, name, text, said):
    write("sensors.yaml", read("protocol/sensors.yaml"))
    if text is not None:
        write(name, text)
    places = [f"{tmp_path / name}{each}" if each.startswith(":") else each for each in said]
    assert_refused(paos("lint", tmp_path / name), *places)


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("x.yaml", "goal: x\n", FileKind.GOAL_GRAPH),
        ("x.yaml", "tree: x\n", FileKind.TREE),
        ("x.yaml", "scene: x\n", FileKind.SCENE),
        ("trees/x.yaml", "a: [", FileKind.TREE),
        ("sensors.yaml", "", FileKind.SETTINGS),
        ("skills/x/SKILL.md", "", FileKind.SKILL),
        ("LOG.md", "", FileKind.DOCUMENT),
        ("README.md", "", None),
        ("x.yaml", "- 1\n", None),
    ],
)
def test_a_kind_is_found_by_name_then_keys_then_folder(write, name, text, kind):
    assert find_kind(write(name, text)) is kind


def test_one_of_two_alike_objects_is_warned_of_with_both_names(paos, write):
    shipped = read("scenes/tabletop/cubes_and_trays.yaml")
    write(
        "scenes/alike.yaml",
        shipped.replace("scene: tabletop/cubes_and_trays", "scene: alike").replace(BLUE, RED.replace("red", "blue")),
    )
    text = GRAPH.replace("colour: red\n", "").replace("pick_and_plase", "pick_and_place").replace("insde", "inside")
    text = text.replace("tabletop/cubes_and_trays", "alike")
    path = write("goal_graphs/broken.yaml", text)
    result = paos("lint", path)
    assert (result.code, "1 file checked, no problem") == (ExitCode.GOAL_MET, result.out.strip())
    assert f"warning: {path}:10:14: AMBIGUOUS: found 'red_cube', which looks as blue_cube does" in result.err

    agreed = write("goal_graphs/broken.yaml", text + "interchangeable: [[red_cube, blue_cube]]\n")
    assert paos("lint", agreed).err == ""
    wrong = write("goal_graphs/broken.yaml", text + "interchangeable: [[red_cube, green_cube, ghost]]\n")
    assert_refused(
        paos("lint", wrong),
        "SCENE_INVALID: found 'green_cube' in ['red_cube', 'green_cube', 'ghost']",
        "UNKNOWN_NAME (object): found 'ghost'",
    )


def test_what_the_cameras_of_a_rig_cannot_tell_is_warned_of_with_numbers(paos, write):
    """A block of the colours of another, 2.3 mm larger; one out of every picture; distances below what is resolved."""
    desk = read("scenes/tabletop/cubes_and_trays.yaml").replace("tabletop/cubes_and_trays", "rig")
    red = desk[desk.index("  red_cube:") : desk.index("  green_cube:")].replace(" &cube", "")
    tin = red.replace("red_cube", "tin").replace("[0.02,", "[0.0223,", 1)
    far = re.sub(r"place: {[^}]*}", "place: {position_m: [-0.4, 1.9, 0.5]}", red.replace("red_cube", "far"))
    board = (
        red.replace("red_cube", "board").replace("[0.02, 0.02, 0.02]", "[0.05, 0.04, 0.0015]").replace(": red", ": ply")
    )
    desk = desk.replace("  floor: {", "  ply: {rgba: [0.8, 0.62, 0.42, 1]}\n  floor: {", 1)
    write("scenes/rig.yaml", desk.replace("  green_cube:", f"{tin}{far}{board}  green_cube:"))
    graph = read("goal_graphs/tidy_table.yaml").replace("tabletop/cubes_and_trays", "rig")
    more = '"near(tin, far, 0.1)", "at(green_cube, red_tray, 0.001)", "at(blue_cube, red_tray, 0.01)"'
    more += ', "tilt(green_cube) < 0.01", "tilt(blue_cube) < 0.2", "distance(green_cube, red_tray) <= 0.002"'
    more += ', "distance(blue_cube, red_tray) < 0.3", "tilt(red_cube) == 0.1", "not distance(red_cube, red_tray) > 0.1"'
    more += ', "not tilt(blue_cube) > 0.02", "not at(red_cube, red_tray, 0.001)", "not tilt(blue_cube) == 0.1"'
    more += ', "distance(red_cube, blue_tray) > 0.3", "distance(red_cube, blue_tray) < 0.302", "tilt(blue_cube) > 0.1"'
    more += ', "distance(red_cube, bottle) < 10", "near(red_cube, bottle, 5)"'
    graph = graph.replace("timeout_s: 60", "timeout_s: 60000")
    path = write("goal_graphs/tidy_table.yaml", f"{graph[: graph.index('accept:' + chr(10))]}accept: [{more}]")
    result = paos("lint", path)
    assert (result.code, "1 file checked, no problem") == (ExitCode.GOAL_MET, result.out.strip())
    expected = (
        "NOT_OBSERVED: found 'far', which no standing camera sees; expected a place in view of one of left",
        "NOT_OBSERVED: found 'board', 3 mm thin and of a hue like what it may lie on: no camera tells them apart",
        "AMBIGUOUS: found 'tin', which has the colours of far, red_cube and sides that differ by less than 2 mm",
        "UNDECIDABLE: found 1 mm in 'at(green_cube, red_tray, 0.001)'; expected more than ±3 mm",
        "UNDECIDABLE: found < 0.6° in 'tilt(green_cube) < 0.01'; expected more than ±2°",
        "UNDECIDABLE: found <= 2 mm in 'distance(green_cube, red_tray) <= 0.002'; expected more than ±3 mm",
        "UNDECIDABLE: found == 6° in 'tilt(red_cube) == 0.1'",
        "UNDECIDABLE: found > 1° in 'tilt(blue_cube) > 0.02'",
        "INVALID_VALUE: found 10 m in 'distance(red_cube, bottle) < 10'; expected a length within the scene, 3",
        "INVALID_VALUE: found 5 m in 'near(red_cube, bottle, 5)'",
        "SESSION_TOO_LONG: found 60000 s; expected at most 600 s for 'panda' by safety.yaml. For milliseconds",
        "UNDECIDABLE: found 2 mm between the bounds of 'distance(red_cube, blue_tray)'; expected more than 5 mm",
    )
    assert [each for each in expected if each not in result.err] == [], result.err
    assert result.err.count("UNDECIDABLE") == 6, result.err
    write("protocol/perception.yaml", "version: 1\nsensing: truth\npipelines: {}\n")
    assert (paos("lint", path).err.count("NOT_OBSERVED"), result.err.count("0.01)")) == (0, 0)


HURRY = """---
skill: hurry
description: Move home.
tree: hurry
parameters:
  speed: {type: number, default: 50}
needs: {observations: [joint_state], actions: [joint_position]}
---
# Hurry
"""


def test_a_number_out_of_the_range_of_its_port_and_an_object_larger_than_its_tray_are_refused_before_a_run(paos, write):
    shipped = read("scenes/tabletop/cubes_and_trays.yaml")
    big = shipped.replace("tabletop/cubes_and_trays", "big").replace("[0.02, 0.02, 0.02]", "[0.2, 0.09, 0.19]")
    write("scenes/big.yaml", big)
    write("trees/hurry.yaml", 'tree: hurry\ndescription: Move home.\nroot:\n  move_home: {speed: "${speed}"}\n')
    skill = write("skills/hurry/SKILL.md", HURRY)
    session = '  hurry: {skill: hurry, target: arm, with: {speed: 150}, accept: ["visible(red_cube)"]}\n'
    graph = read("goal_graphs/tidy_table.yaml").replace("tabletop/cubes_and_trays", "big")
    path = write("goal_graphs/tidy_table.yaml", graph.replace("sessions:\n", f"sessions:\n{session}"))
    expected = (
        "found 150; expected a number greater than 0 and of at most 1. Fraction of the velocity limits",
        "found 'red_cube' of 18 cm x 38 cm x 40 cm, inside 'red_tray' of 11 cm x 18 cm",
    )
    assert_refused(paos("lint", path), *expected)
    assert_refused(paos("run", path, "-w", path.parents[1] / "w"), *expected)
    assert_refused(paos("lint", skill), f"{skill}:6:25: INVALID_VALUE: found 50; expected a number greater than 0")
