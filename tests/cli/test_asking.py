"""`paos ask`: from a request to a graph that lints, and to a run only where it was approved."""

import contextlib
import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.cli import asking
from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.run import RunReport
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.views.environment import render_environment
from tests.chat_server import ChatServer
from tests.command_line import assert_ended

CUBES = ("--scene", "tabletop/cubes_and_trays")
REQUEST = "put every cube into the tray of its colour, and keep the bottle upright"
SHORT = "put the red cube into the red tray"
FOREIGN = "el cubo rojo en la bandeja roja"
REPORT = RunReport(exit_code=0, workspace="w", wall_s=1.0, pictures={}, goal=None)
GOAL = {"goal": {"accept": ["inside(red_cube, red_tray)"]}}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("PHYAGENTOS_MODEL_URL", "PHYAGENTOS_MODEL", "PHYAGENTOS_MODEL_KEY"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.fixture
def runs(monkeypatch):
    """What would be run, instead of running it."""
    requests = []

    def note(request, **_):
        requests.append(request)
        return REPORT

    monkeypatch.setattr(asking, "run_shown", note)
    return requests


@pytest.fixture
def model(monkeypatch):
    server = ChatServer([GOAL])
    monkeypatch.setenv("PHYAGENTOS_MODEL_URL", server.url)
    monkeypatch.setenv("PHYAGENTOS_MODEL", "m-1")
    yield server
    server.close()


@pytest.mark.slow
def test_a_request_becomes_a_graph_that_lints_and_nothing_runs_unapproved(paos, runs):
    asked = paos("ask", REQUEST, *CUBES)
    folder = Path("workspaces/put_every_cube_into_the_tray_of_its-0-1")
    graph = folder / "requests" / "put_every_cube_into_the_tray_of_its.yaml"

    assert asked.code == ExitCode.GOAL_MET
    assert runs == []
    assert f"paos run {graph} -w {folder}\n" in asked.err
    assert "upright(bottle)" in asked.out
    assert "LEFT OUT yellow_cube" in asked.out
    assert "because pick_and_place guarantees inside(red_cube, red_tray)" in asked.out
    assert paos("lint", graph).code == ExitCode.GOAL_MET
    assert set(yaml.safe_load(graph.read_text(encoding="utf-8"))["accept"]) == {
        f"inside({colour}_cube, {colour}_tray)" for colour in ("red", "green", "blue")
    }
    assert paos("plan", graph.with_suffix(".goal.yaml")).code == ExitCode.GOAL_MET


def test_yes_approves_and_runs_as_paos_run_does_and_json_holds_its_report(paos, runs):
    words = ("--yes", "--json", "--seed", "3", "-w", "w", "-o", "mine.yaml", "--no-pictures")
    found = json.loads(paos("ask", REQUEST, *CUBES, *words).out)
    (order,) = runs

    assert (order.graph, order.seed, order.workspace, order.pictures) == (Path("mine.yaml"), 3, Path("w"), False)
    assert order.memory == "none", "PHYAGENTOS_MEMORY of the tests"
    assert found["understood"]
    assert found["goal"]["constraints"] == ["upright(bottle)"]
    assert set(found["left_out"]) == {"yellow_cube"}
    assert len(found["sessions"]) == 3
    assert found["report"]["workspace"] == REPORT.workspace


@pytest.mark.slow
def test_json_alone_approves_nothing(paos, runs):
    found = json.loads(paos("ask", SHORT, *CUBES, "--json").out)

    assert Path(found["graph"]).is_file()
    assert runs == []


@pytest.mark.slow
def test_questions_end_with_code_2_and_their_candidates_and_can_be_answered(paos, runs):
    asked = paos("ask", "put the cube in the red tray", *CUBES, "--json", "--yes")
    (question,) = json.loads(asked.out)["questions"]

    assert asked.code == ExitCode.INVALID_INPUT
    assert question["candidates"] == ["red_cube", "green_cube", "blue_cube", "yellow_cube"]
    assert runs == []
    assert not Path("workspaces").exists()
    answer = f"{question['key']}=green_cube"
    answered = paos("ask", "put the cube in the red tray", *CUBES, "--json", "--answer", answer)
    assert json.loads(answered.out)["goal"]["accept"] == ["inside(green_cube, red_tray)"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("request_", "kind", "words"),
    [
        ("make coffee", "word", "coffee"),
        ("lift the red cube by 10 cm", "measure", "10 cm"),
        ("open the bottle", "rigid", "open(bottle)"),
    ],
)
def test_what_cannot_be_done_ends_with_code_2_and_is_named(paos, request_, kind, words):
    asked = paos("ask", request_, *CUBES, "--json")

    assert asked.code == ExitCode.INVALID_INPUT
    assert (kind, words) in [(lack["kind"], lack["words"]) for lack in json.loads(asked.out)["lacks"]]
    assert words in paos("ask", request_, *CUBES).out


@pytest.mark.slow
def test_a_goal_without_a_plan_says_what_is_missing(paos):
    assert_ended(paos("ask", "put everything into the red tray", *CUBES), ExitCode.GOAL_NOT_MET, out=["red_tray"])
    assert not Path("workspaces").exists()


@pytest.mark.slow
def test_a_first_request_is_about_the_scene_of_the_project_else_of_the_first_example(paos, monkeypatch):
    assert "tabletop/cubes_and_trays" in paos("ask", SHORT).out
    paos("init", "mine")
    monkeypatch.chdir("mine")
    assert "in desk" in paos("ask", "put the block into the box").out


@pytest.mark.slow
def test_as_before_takes_the_request_before_of_the_workspace_that_is_named_else_the_newest(paos):
    paos("ask", SHORT, *CUBES, "-w", "first")
    paos("ask", "put the green cube into the green tray", *CUBES)
    again = ("ask", "as before, and put the blue cube into the blue tray")

    named, newest = json.loads(paos(*again, "-w", "first", "--json").out), paos(*again)

    assert named["goal"]["accept"] == ["inside(red_cube, red_tray)", "inside(blue_cube, blue_tray)"]
    assert named["before"] == "first/requests/put_the_red_cube_into_the_red_tray.goal.yaml"
    assert "the request before: workspaces/put_the_green_cube_into_the_green_tray-0-1/requests/" in newest.err


@pytest.mark.slow
def test_another_graph_of_the_same_name_is_not_overwritten(paos):
    paos("ask", "put the cube into the red tray", *CUBES, "-w", "w", "--answer", "the cube@4=red_cube")
    paos("ask", "put the cube into the red tray", *CUBES, "-w", "w", "--answer", "the cube@4=blue_cube")

    name = "put_the_cube_into_the_red_tray"
    assert sorted(path.name for path in Path("w/requests").iterdir()) == [
        f"{name}.goal.yaml",
        f"{name}.yaml",
        f"{name}_2.goal.yaml",
        f"{name}_2.yaml",
    ]


def test_a_robot_that_is_not_there_is_refused(paos):
    assert "UNKNOWN_NAME (target)" in paos("ask", SHORT, *CUBES, "--robot", "hal").err
    assert json.loads(paos("ask", SHORT, *CUBES, "--robot", "ur5e", "--json").out)["goal"]["targets"] == {
        "robot": "ur5e"
    }


@pytest.mark.slow
def test_the_graph_can_be_shown_as_mermaid(paos):
    assert "flowchart LR" in paos("ask", SHORT, *CUBES, "--mermaid").out


@pytest.mark.slow
def test_a_model_is_asked_only_for_words_that_the_grammar_does_not_know(paos, model):
    paos("ask", SHORT, *CUBES)
    paos("ask", "put the cube into the red tray", *CUBES)
    paos("ask", "open the bottle", *CUBES)
    assert model.asked == []

    found = json.loads(paos("ask", FOREIGN, *CUBES, "--json").out)

    assert found["goal"]["accept"] == ["inside(red_cube, red_tray)"]
    assert len(model.asked) == 1


@pytest.mark.slow
def test_answers_of_a_model_are_kept_and_replace_it(paos, model, monkeypatch):
    paos("ask", FOREIGN, *CUBES, "-o", "mine.yaml")
    monkeypatch.delenv("PHYAGENTOS_MODEL_URL")

    assert paos("ask", FOREIGN, *CUBES).code == ExitCode.INVALID_INPUT
    again = paos("ask", FOREIGN, *CUBES, "--model-answers", "mine.answers.json", "--json")
    assert json.loads(again.out)["goal"]["accept"] == ["inside(red_cube, red_tray)"]
    other = paos("ask", f"{FOREIGN} y azul", *CUBES, "--model-answers", "mine.answers.json")
    assert other.code == ExitCode.INVALID_INPUT


def test_a_goal_that_a_model_alone_has_chosen_runs_by_no_approval_in_advance(paos, model, monkeypatch):
    monkeypatch.setattr("phyagentos.cli.asking.run_shown", lambda *_, **__: pytest.fail("it was run"))
    asked = paos("ask", FOREIGN, *CUBES, "--yes")

    assert_ended(asked, ExitCode.INVALID_INPUT, err=["--yes approves no goal that a model alone has chosen"])


def test_a_model_without_its_name_is_refused(paos, model, monkeypatch):
    monkeypatch.delenv("PHYAGENTOS_MODEL")

    assert "PHYAGENTOS_MODEL" in paos("ask", FOREIGN, *CUBES).err


def _ask_in_terminal(approval: bytes, *words: str, before: bytes = b"") -> tuple[int, str]:
    """The command in a terminal of its own; what is pressed before the approval is asked for is no approval."""
    script = (
        "from phyagentos.cli import asking; from phyagentos.operations.run import RunReport;"
        "report = RunReport(exit_code=0, workspace='w', wall_s=1.0, pictures={}, goal=None);"
        "asking.run_shown = lambda request, **_: print('RUNS', request.graph) or report;"
        "from phyagentos.cli.app import main; main()"
    )
    near, far = pty.openpty()
    command = [sys.executable, "-c", script, "ask", *words]
    with subprocess.Popen(command, stdin=far, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as asked:
        try:
            os.write(near, before)
            while "run it?" not in asked.stderr.readline():
                assert asked.poll() is None
            for _ in range(100):  # it may begin to listen a moment later
                os.write(near, approval)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    asked.wait(0.1)
                    break
            return asked.returncode, asked.stdout.read()
        finally:
            asked.kill()
            os.close(near)
            os.close(far)


@pytest.mark.slow
def test_a_key_press_in_the_terminal_approves():
    assert "RUNS" in _ask_in_terminal(b"y", SHORT, *CUBES)[1]


@pytest.mark.slow
def test_questions_are_put_in_the_terminal_and_another_key_approves_nothing():
    code, out = _ask_in_terminal(b"n", "put the cube into the red tray", *CUBES, before=b"9\n2\n")

    assert code == ExitCode.GOAL_MET
    assert "inside(green_cube, red_tray)" in out
    assert "RUNS" not in out


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("where is the bottle?", "bottle is on table"),
        ("is the bottle upright?", "upright(bottle) is true: bottle leans 0°"),
        ("how many cubes are there?", "4: "),
        ("what can you do?", "put the"),
    ],
)
def test_a_question_is_answered_and_the_snapshot_is_named(paos, question, said):
    asked = paos("ask", question, *CUBES)
    assert (asked.code, said in asked.out, "the start of the scene" in asked.out) == (ExitCode.GOAL_MET, True, True)


def test_a_question_in_a_workspace_is_answered_from_what_was_observed_there(paos, tmp_path):
    world = draw_start(open_library(), "tabletop/cubes_and_trays", ["panda"], 3)
    workspace = Workspace.create(tmp_path / "w", open_library())
    workspace.environment.write_text(render_environment(world), encoding="utf-8")
    asked = paos("ask", "where is the red cube?", *CUBES, "-w", workspace.root)
    x_m, y_m, _ = world.entities["red_cube"].pose.position_m
    assert f"({x_m:.2f}, {y_m:.2f}" in asked.out
    assert str(workspace.environment) in asked.out


@pytest.mark.slow
def test_a_refusal_ends_with_requests_that_are_understood(paos):
    examples = json.loads(paos("ask", "fold the laundry", *CUBES, "--json").out)["examples"]
    assert len(examples) == 2
    assert [paos("ask", each, *CUBES).code for each in examples] == [ExitCode.GOAL_MET] * 2


def test_a_word_that_fits_several_objects_is_asked_back_and_the_likely_one_is_named(paos):
    asked = paos("ask", "put green into the red tray", *CUBES)
    assert "probably green_cube" in asked.out
    assert "=green_cube'" in asked.err


@pytest.mark.slow
def test_a_preview_is_a_picture_of_the_goal_and_nothing_runs_or_asks(paos, runs):
    found = json.loads(paos("ask", SHORT, *CUBES, "--preview", "--json").out)
    clash = paos("ask", SHORT, *CUBES, "--preview", "--yes")
    named = paos("ask", SHORT, *CUBES, "--picture", "mine.png")

    assert Path(found["picture"]).with_suffix(".yaml") == Path(found["graph"])
    assert Path(found["picture"]).read_bytes().startswith(b"\x89PNG")
    assert Path("mine.png").is_file()
    assert "wrote mine.png" in named.err
    assert "run it?" not in named.err
    assert clash.code == ExitCode.INVALID_INPUT
    assert runs == []
