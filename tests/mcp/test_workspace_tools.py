"""The tools of a workspace, as declared: each does what the command does, and none starts or permits anything."""

import json
import re
from pathlib import Path

import msgspec
import pytest
import yaml

from phyagentos.agent.tools.proposals import Proposals
from phyagentos.agent.tools.registry import Level
from phyagentos.errors import DefinitionError
from phyagentos.mcp.protocol_server import build_registry
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import read_latch
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = Library.open(ROOT)
TIDY = (ROOT / "goal_graphs" / "tidy_table.yaml").read_text(encoding="utf-8")
READING = {"look", "lint", "plan", "compile", "preflight", "wait", "why", "recall"}
STOPS = {"cancel", "pause", "estop"}


@pytest.fixture
def workspace(tmp_path):
    return Workspace.create(tmp_path / "w", LIBRARY)


@pytest.fixture
def registry(workspace):
    return build_registry(workspace.root, Level.SUBMIT)


def refuse(registry, name, **arguments):
    with pytest.raises(DefinitionError) as refused:
        registry.call(name, arguments)
    return refused.value.problems[0]


def list_files(root):
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in root.rglob("*")
        if path.is_file() and "logs" not in path.parts and ".cache" not in path.parts
    }


def test_the_levels_are_as_documented_and_no_tool_lets_anything_go_on(workspace):
    offered = {level: {tool.name for tool in build_registry(workspace.root, level).list_offered()} for level in Level}
    assert offered[Level.READ] == READING | STOPS
    assert offered[Level.PROPOSE] == offered[Level.READ] | {"propose", "step"}
    assert offered[Level.SUBMIT] == offered[Level.PROPOSE] | {"submit"}
    assert not offered[Level.SUBMIT] & {"resume", "reset", "approve", "deny", "verify", "judge", "edit"}


def test_every_tool_declares_what_it_does_and_takes(registry):
    for tool in registry.list_offered():
        assert re.fullmatch(r"[a-z_]+", tool.name)
        assert tool.description.endswith(".")
        assert tool.arguments.model_json_schema()["type"] == "object"
        assert tool.is_read_only == (tool.name in READING)
        assert tool.is_stop == (tool.name in STOPS)
        assert tool.is_destructive == (tool.name in {"cancel", "estop"})


@pytest.mark.slow
def test_every_tool_refuses_hostile_arguments_and_changes_nothing(registry, workspace):
    hostile = [
        {"subject": {"$ref": "x"}, "graph": 1, "goal": [], "text": None, "id": [], "words": 2, "session": 3},
        {"graph": "../../etc/passwd\n", "text": "\0", "id": "../" * 80, "subject": "../../x", "session": "-w /"},
        {
            "graph": "a: &a [*a]",
            "goal": "goal: ../../x",
            "text": "x: " + "[" * 100_000,
            "id": "*",
            "subject": "*",
            "session": "\n",
        },
        {"graph": "\x1b[2J", "text": "!!python/object/apply:os.system ['true']", "id": "", "subject": "\0"},
    ]
    before = list_files(workspace.root)
    for tool in registry.list_offered():
        if tool.name == "estop":  # stops whatever it is given
            continue
        if not tool.is_stop:
            assert refuse(registry, tool.name, no_such_key=1).label in {"UNKNOWN_NAME (key)", "MISSING_VALUE"}
        for arguments in hostile:
            own = {key: value for key, value in arguments.items() if key in tool.arguments.model_fields}
            needed = {"reason": "r"} if tool.name in {"propose", "submit"} else {}
            if tool.name == "lint" and isinstance(own["text"], str):
                assert registry.call("lint", own).facts["problems"]
            elif own:
                assert refuse(registry, tool.name, **own | needed).code
    assert list_files(workspace.root) == before


def test_compile_shows_the_sessions_of_a_name_or_of_a_text(registry):
    named, written = (registry.call("compile", {"graph": graph}).facts for graph in ("tidy_table", TIDY))
    assert named == written
    assert [each.node for each in named["sessions"]] == ["red", "green", "blue"]


@pytest.mark.slow
def test_a_goal_without_a_plan_becomes_a_graph_that_compiles_or_what_is_missing(registry):
    wanted = {"goal": "put_red", "objective": "Red into its tray.", "scene": "tabletop/cubes_and_trays"}
    wanted |= {"accept": ["inside(red_cube, red_tray)"]}
    planned = registry.call("plan", {"goal": yaml.safe_dump(wanted), "seed": 7}).facts
    compiled = registry.call("compile", {"graph": planned["graph"]}).facts
    assert [each.skill for each in compiled["sessions"]] == ["pick_and_place"]
    impossible = wanted | {"accept": ["inside(red_cube, red_tray)", "not inside(red_cube, red_tray)"]}
    assert registry.call("plan", {"goal": yaml.safe_dump(impossible)}).facts["graph"] == ""
    assert refuse(registry, "plan", goal="goal: x").code == "MISSING_VALUE"


def test_compile_takes_overrides_and_refuses_paths_in_them(registry):
    found = registry.call("compile", {"graph": TIDY, "overrides": {"targets.arm": "ur5e"}}).facts
    assert {each.target for each in found["sessions"]} == {"ur5e"}
    assert refuse(registry, "compile", graph=TIDY, overrides={"defaults.max_replans": "9"}).code == "INVALID_VALUE"


def test_problems_stand_in_the_text_that_was_given(registry):
    problem = refuse(registry, "compile", graph=TIDY.replace("skill: pick_and_place", "skill: pick_and_plaice", 1))
    assert (problem.label, problem.address) == ("UNKNOWN_NAME (skill)", "goal_graph.yaml:11:5")
    found = registry.call("lint", {"text": TIDY.replace("scene:", "secne:")}).facts["problems"]
    assert "UNKNOWN_NAME (key)" in {each.label for each in found}
    assert all(each.address.startswith("goal_graph.yaml:") for each in found)
    assert not registry.call("lint", {"text": TIDY}).facts["problems"]


def test_a_suite_is_checked_with_the_goal_graphs_that_it_names(registry):
    score = "score: {red: {in_tray: [red_cube, red_tray]}}"
    suite = f"suite: s\nobjective: O.\ntasks:\n  tidy: {{graph: tidy_tabel, {score}}}\nseeds: {{count: 1}}\n"
    (problem,) = registry.call("lint", {"text": suite}).facts["problems"]
    assert (problem.code, problem.hint) == ("UNKNOWN_NAME", "Did you mean 'tidy_table'?")


@pytest.mark.parametrize("path", ["/etc/passwd", "../secret", "goal_graphs/tidy_table.yaml", "~/x"])
def test_a_path_is_a_text_and_never_read(registry, path):
    assert refuse(registry, "compile", graph=path).code in {"INVALID_VALUE", "MISSING_VALUE", "SYNTAX"}


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["propose", "submit"])
def test_a_proposal_is_a_file_and_no_session(registry, workspace, tool):
    facts = registry.call(tool, {"graph": "tidy_table", "seed": 3, "reason": "tidy, please"}).facts
    proposed = Proposals(workspace.proposals).read(facts["proposal"])
    assert proposed.sha256 == facts["sha256"]
    assert proposed.proposal.decider == {"propose": "person", "submit": "policy"}[tool]
    assert proposed.proposal.graph["sessions"].keys() == {"red", "green", "blue"}
    assert not (workspace.proposals / "decisions").exists()
    assert not [path for path in workspace.sessions.rglob("*") if path.is_file() and path.stat().st_size]
    waiting = registry.call("wait", {"id": facts["proposal"], "timeout_s": 0}).facts
    assert waiting["state"] == "waits for a decision"


def test_a_proposal_holds_what_it_includes(registry, workspace):
    facts = registry.call("propose", {"graph": "put_away", "reason": "x"}).facts
    sessions = Proposals(workspace.proposals).read(facts["proposal"]).proposal.graph["sessions"]
    assert [each["include"] for each in sessions.values() if isinstance(each.get("include"), str)] == []


def test_a_goal_that_cannot_run_is_not_proposed(registry, workspace):
    assert refuse(registry, "propose", graph=TIDY.replace("red_cube", "rde_cube"), reason="x")
    assert not workspace.proposals.exists()


def test_a_denial_reaches_who_proposed(registry, workspace, paos):
    name = registry.call("propose", {"graph": "tidy_table", "reason": "x"}).facts["proposal"]
    assert paos("deny", name, "-w", workspace.root, "--reason", "not today").code == 0
    facts = registry.call("wait", {"id": name}).facts
    assert (facts["state"], facts["decision"]["reason"]) == ("denied", "not today")


@pytest.mark.parametrize("arguments", [{}, {"reason": "smoke"}, {"reason": {"a": 1}, "more": [2]}])
def test_the_emergency_stop_stops_whatever_it_is_given(workspace, arguments):
    build_registry(workspace.root, Level.READ).call("estop", arguments)
    assert read_latch(workspace.signals.parent).by == "mcp"


def test_every_call_is_recorded(registry, workspace):
    registry.call("look", {})
    refuse(registry, "propose", graph="x")
    lines = (workspace.logs / "tools.jsonl").read_text().splitlines()
    assert [(json.loads(line)["tool"], json.loads(line).get("code")) for line in lines] == [
        ("look", None),
        ("propose", "MISSING_VALUE"),
    ]


def test_look_why_and_recall_answer_with_plain_data(registry, workspace):
    look = registry.call("look", {}).facts
    assert look["standing"].goals == {}
    assert refuse(registry, "why").label == "UNKNOWN_NAME (goal)"
    assert registry.call("recall", {"words": "red cube"}).facts["entries"] == ()
    assert msgspec.json.encode(look)
