"""CALVIN's adapter against a recorded description of a scene: instructions, figures and boxes, without simulation."""

import json
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from benchmarks.calvin import compute_figures, is_ended, read_results, score
from benchmarks.calvin_parts.project import read_world, translate, write_project
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.protocol.capabilities.library import Library, find_shipped_root

ROOT = find_shipped_root()
TASKS = re.compile(
    r"(rotate|push|lift)_(red|blue|pink)_block|move_slider|place_in_(slider|drawer)|push_into_drawer|"
    r"turn_(on|off)_(lightbulb|led)|unstack_block|stack_block"
)
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def describe(name, kind, at_m, half_m=(0.02, 0.02, 0.02), *, movable=True, **more):
    """An entity as the wire has it, of one box."""
    shape = {"kind": "box", "size_m": half_m, "pose": {"position_m": [0.0, 0.0, 0.0], "quaternion_wxyz": UPRIGHT}}
    pose = {"position_m": at_m, "quaternion_wxyz": UPRIGHT}
    return {"name": name, "kind": kind, "movable": movable, "shapes": [shape], "pose": pose, **more}


def slide(at_m, axis, share, kind="slide", **more):
    pose = {"position_m": at_m, "quaternion_wxyz": UPRIGHT}
    return {"joint": share, "mechanism": {"kind": kind, "axis": axis, "travel": 0.2, "closed": pose, **more}}


def record(*, held="", lit=0.0, red_m=(0.34, -0.35, 0.22)):
    """What the kit says of a table with a drawer, a sliding door and two lamps."""
    room = {"center_m": [0.0, 0.0, 0.05], "half_m": [0.2, 0.08, 0.05]}
    half = {"opens_at": 0.5, "closes_at": 0.5}
    door, drawer, led = [0.55, -0.2, 0.3], [0.4, -0.5, 0.1], [0.62, -0.2, 0.4]
    entities = [
        describe("block_red", "block", [*red_m]),
        describe("block_blue", "block", [0.34, -0.0, 0.22]),
        describe("table", "table", [0.46, -0.34, 0.1], (0.2, 0.5, 0.1), movable=False),
        describe("sliding_door", "door", door, **slide(door, [0.0, 1.0, 0.0], 0.0)),
        describe("sliding_door_handle", "handle", [0.5, -0.2, 0.3], part_of="sliding_door"),
        describe("drawer", "drawer", drawer, (0.1, 0.1, 0.01), interior=room, **slide(drawer, [-1.0, 0.0, 0.0], 0.0)),
        describe("drawer_handle", "handle", [0.3, -0.5, 0.1], part_of="drawer"),
        describe("led_light", "lamp", led, **slide(led, [0.0, 0.0, -1.0], lit, "toggle", **half)),
        describe("button", "button", [0.34, -0.2, 0.22], part_of="led_light", **slide(led, [0.0, 0.0, -1.0], 0.0)),
    ]
    return [each | {"held_by": "calvin"} if each["name"] == held else each for each in entities]


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calvin")
    told = {"tool": {"flange_to_tool_m": 0.247}, "sequences": {"0": {"entities": record()}}}
    write_project(folder, told, "ws://127.0.0.1:7001")
    assert "ws://127.0.0.1:7001" in (folder / "robots" / "calvin" / "target.yaml").read_text()
    return Catalogue.read(Library((folder, ROOT)))


@pytest.mark.parametrize(
    ("instruction", "world", "accept", "skills"),
    [
        ("pull the handle to open the drawer", {}, ["open(drawer)"], ["open_drawer"]),
        ("push the sliding door to the left side", {}, ["open(sliding_door)"], ["open_drawer"]),
        ("grasp and lift the red block", {}, ["holding(robot, block_red)"], ["pick"]),
        ("press the button to turn on the led light", {}, ["open(led_light)"], ["switch_on"]),
        ("press the button to turn off the led light", {"lit": 1.0}, ["closed(led_light)"], ["switch_off"]),
        (
            "go push the blue block right",
            {},
            ["at(block_blue, (0.34, -0.5, 0.22), 0.04)"],
            None,
        ),  # 20 cm away is the button, 30 cm away the other block
        ("stack the grasped block", {"held": "block_red"}, ["on(block_red, block_blue)"], None),
        ("remove the stacked block", {"red_m": (0.34, 0.0, 0.26)}, ["not on(block_red, block_blue)"], ["pick"]),
        (
            "take the red block and rotate it to the right",
            {},
            ["turned(block_red, -1.571)", "at(block_red, (0.34, -0.35, 0.22), 0.04)"],
            ["turn"],
        ),
    ],
)
def test_an_instruction_becomes_a_plan_by_effects(catalogue, instruction, world, accept, skills):
    text, reason = translate(instruction, catalogue, read_world(record(**world)))
    assert text, reason
    graph = yaml.safe_load(text)
    assert graph["accept"] == accept
    assert skills is None or [node["skill"] for node in graph["sessions"].values()] == skills


def test_no_code_and_no_setting_is_of_a_task():
    folders = ("phyagentos", "benchmarks", "kits", "skills", "trees", "robots")
    files = [
        path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in {".py", ".yaml", ".md"}
    ]
    calvin = [path for path in files if "calvin" in str(path.relative_to(ROOT)) or path.is_relative_to(ROOT / "skills")]
    assert [str(path) for path in calvin if TASKS.search(path.read_text())] == []


def make_line(sequence, number, **more):
    line = {"sequence": sequence, "number": number, "verdict": "success", "reached": True, "is_first": True}
    return line | more


def test_a_chain_counts_up_to_its_first_failure_and_a_verdict_against_the_oracle_is_a_false_success(tmp_path):
    lines = [
        *(make_line(0, number, is_first=number != 1) for number in range(5)),
        make_line(1, 0),
        make_line(1, 1, reached=False),
        make_line(2, 0),
    ]
    path = tmp_path / "results.jsonl"
    path.write_text("".join(f"{json.dumps(each)}\n" for each in lines) + '{"sequence": 3, "num')
    known = read_results(path)
    assert [is_ended(known[each]) for each in range(3)] == [True, True, False], (
        "a chain that a kill cut off is run again"
    )

    figures = compute_figures([known[0], known[1]])

    assert (figures["average_final"], figures["average_first"], figures["false_successes"]) == (3.0, 1.0, 1.0)
    assert (figures["final_1"], figures["final_2"], figures["first_2"]) == (1.0, 0.5, 0.0)


def test_the_oracle_counts_where_it_was_met_in_any_session_of_the_instruction():
    names = ("a", "a.r1")
    sessions = [
        SimpleNamespace(id=each, sim_time_s=1.0, node=each, verdict="", state="done", cause="", code="", leaf="")
        for each in names
    ]
    report = SimpleNamespace(sessions=sessions, verdict="success", reason="", replans=1, first_attempt_success={})
    line = {"success": False, "task": "t"}
    server = SimpleNamespace(read_outcomes=lambda: {"a": line | {"reached": True}, "a.r1": line | {"reached": False}})
    found = score(report, server)
    assert (found["reached"], found["success"], found["is_first"]) == (True, False, False)


def test_boxes_fill_a_concave_mesh(monkeypatch):
    """An L of two bars, as its triangles are read."""
    monkeypatch.syspath_prepend(str(ROOT / "kits" / "calvin"))
    from calvin_body.meshes import fill

    outline = np.array(((0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0.1, 0.2), (0, 0.2)))
    faces = ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5))
    low, high = (np.column_stack((outline, np.full(6, z))) for z in (0.0, 0.05))
    vertices = np.concatenate((low, high))
    triangles = np.array([*faces, *(tuple(6 + each for each in face) for face in faces)])

    boxes = fill(vertices, triangles)

    volume = sum(float(np.prod(top - bottom)) for bottom, top in boxes)
    assert volume == pytest.approx(0.03 * 0.05)
    assert not any(np.all((bottom < 0.15) & (top > 0.15)) for bottom, top in ((b[:2], t[:2]) for b, t in boxes))
    sys.modules.pop("calvin_body.meshes", None)
