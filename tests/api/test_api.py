"""`import phyagentos as paos`: what a script reads of a recorded workspace, and what it asks of a run."""

import base64
import json
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest

import phyagentos as library
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.operations import run as running
from phyagentos.protocol.sessions.evidence import TRACE
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth
from tests.api.conftest import GOAL

ROOT = Path(__file__).resolve().parents[2]
POLICY = """---
skill: echo
description: Answers with what it is shown.
kind: policy
action_space: {representation: joint_position, joints: [a, b, c], rate_hz: 50, chunk_length: 2}
policy:
  policy: echo/1
  endpoint: openpi://127.0.0.1:0
  observations: {joint_state: {modality: proprioception, shape: [n_joints], rate_hz: 50, key: observation/state}}
  inference_s: 0.1
---
# Echo
"""
EVIL = '<script>alert("x")</script>&"\'<img src=x onerror=y>'


@pytest.fixture
def demo(stored):
    return library.open_workspace(stored)


def find_codes(call, *arguments, **named):
    with pytest.raises(DefinitionError) as refused:
        call(*arguments, **named)
    return {problem.label for problem in refused.value.problems}


@pytest.mark.slow
def test_a_workspace_is_opened_without_a_plane_a_solver_a_simulator_or_an_array(stored):
    code = f"import phyagentos, sys; phyagentos.open_workspace({str(stored)!r}); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = set(done.stdout.split())
    heavy = {"numpy", "mujoco", "networkx", "scipy", "ompl", "casadi", "numba", "py_trees", "typer", "rich", "PIL"}
    assert not loaded & heavy
    rooms = {".".join(name.split(".")[:2]) for name in loaded if name.startswith("phyagentos.")}
    below = {"api", "clock", "errors", "geometry", "overtime", "plugins", "protocol", "store", "wording"}
    assert rooms == {f"phyagentos.{name}" for name in below}


def test_sessions_say_how_they_ended_and_what_was_done_differently(demo):
    assert [(each.node, each.state, each.verdict) for each in demo] == [
        ("red", "replanned", "replan"),
        ("green", "succeeded", "success"),
        ("blue", "succeeded", "success"),
        ("red", "succeeded", "success"),
    ]
    lost, again = demo["red"], demo[f"{GOAL}.red.r1"]
    assert (lost.parent, lost.children, again.parent) == (None, (again.id,), lost.id)
    assert not lost.strategy
    assert str(again.strategy) == "with another grasp (not yaw 0°) at half speed"
    assert (lost.criteria[0].text, lost.criteria[0].truth) == ("inside(red_cube, red_tray)", Truth.FALSE)
    assert lost.evidence == demo.root / "evidence" / lost.id
    assert lost.status.execution.code == "GRASP_LOST"


def test_goals_hold_their_sessions(demo):
    assert list(demo.goals) == [GOAL]
    goal = demo.goals[GOAL]
    assert (goal.verdict, goal.workspace) == ("success", demo.root)
    assert {each.id for each in goal.sessions} == set(demo.sessions)


def test_no_view_can_be_changed(demo):
    changes = ((demo, "root"), (demo["red"], "state"), (demo.goals[GOAL], "verdict"), (demo["red"].tree, "svg"))
    for view, name in changes:
        with pytest.raises(AttributeError):
            setattr(view, name, "")


def test_a_session_without_evidence_has_no_trajectory_and_no_replay(demo, tmp_path):
    gone = replace(demo["green"], evidence=tmp_path)
    with pytest.raises(ExecutionError, match="EVIDENCE_DAMAGED"):
        _ = gone.trajectory
    with pytest.raises(ExecutionError, match="EVIDENCE_DAMAGED"):
        demo.replay("green")  # its scene model was not stored


def test_a_replay_shows_joints_and_tree_at_any_moment_from_evidence_alone(demo):
    played, session = demo.replay("red"), demo["red"]
    assert (np.diff(played.time_s) >= 0).all()
    course = session.trajectory
    middle = len(course["time_s"]) // 2
    at_s = float(course["time_s"][middle])
    np.testing.assert_allclose(played.pose(at_s).qpos, course["q_measured"][middle])
    trace = [json.loads(line) for line in (session.evidence / TRACE).read_text().splitlines()]
    assert played.tree_at(trace[0]["time_s"] - 0.01) == {}
    assert played.tree_at(at_s)["pick_and_place"] == "RUNNING"
    at_end = played.tree_at(float(played.time_s[-1]))
    assert at_end["pick_and_place"] == "FAILURE"
    assert at_end == {event["path"]: event["status"] for event in trace}


@pytest.mark.parametrize("subject", ["", "red", "blue", GOAL])
def test_why_is_what_the_command_prints(demo, paos, subject):
    assert demo.why(subject) + "\n" == paos("why", *([subject] if subject else []), "-w", demo.root).out


def test_the_names_of_the_library_are_offered_before_it_is_loaded(tmp_path):
    code = "import phyagentos, sys; print(*dir(phyagentos)); assert 'phyagentos.api' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert set(library.__all__) < set(done.stdout.split())
    assert [name for name in library.__all__ if not hasattr(library, name)] == []


def test_a_name_that_is_not_there_is_refused_with_what_there_is(demo, tmp_path):
    assert find_codes(demo.__getitem__, "rad") == find_codes(demo.why, "rad") == {"UNKNOWN_NAME (session)"}
    assert find_codes(library.open_workspace, tmp_path) == {"NOT_A_WORKSPACE"}
    with pytest.raises(DefinitionError, match="Did you mean 'red'"):
        demo.replay("rad")
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = library.nonsense


def read_picture(figure):
    """The SVG in the image that a notebook shows, parsed."""
    image = ElementTree.fromstring(figure._repr_html_().replace(">", "/>"))
    kind, _, data = image.get("src").partition(";base64,")
    assert kind == "data:image/svg+xml"
    return image.get("alt"), ElementTree.fromstring(base64.b64decode(data))


def test_notebooks_show_a_tree_with_how_each_node_ended(demo):
    lost, other = demo["red"].tree, demo["green"].tree
    assert lost.title == "Behaviour tree pick_and_place"
    assert any("plan_grasp" in text for text in ElementTree.fromstring(lost.svg).itertext())
    assert "pick_and_place <b>FAILURE</b>" in lost._repr_html_()
    assert "pick_and_place <b>SUCCESS</b>" in other._repr_html_()
    trace = [json.loads(line) for line in (demo["green"].evidence / TRACE).read_text().splitlines()]
    assert other.html.count("<b>SUCCESS</b>") == len({each["path"] for each in trace if each["status"] == "SUCCESS"})
    assert "detach <b>SUCCESS</b>" in other.html
    assert "detach <b></b>" in lost.html  # the cube was gone by then
    assert "set_aside <b>" not in lost.html  # inside of what was not reached
    waiting = replace(demo["red"], status=msgspec.structs.replace(demo["red"].status, execution=None))
    assert "SUCCESS" not in waiting.tree.html


@pytest.mark.parametrize(
    ("skill", "code"), [("pick", ""), ("echo", "UNKNOWN_NAME (tree)"), ("gone", "UNKNOWN_NAME (skill)")]
)
def test_a_skill_without_a_tree_is_refused(stored, tmp_path, skill, code):
    root = shutil.copytree(stored, tmp_path / "w", ignore=shutil.ignore_patterns("evidence"))
    (root / "library" / "skills" / "echo").mkdir()
    (root / "library" / "skills" / "echo" / "SKILL.md").write_text(POLICY)
    session = library.open_workspace(root)["red"]
    contract = msgspec.structs.replace(session.status.contract, skill=skill)
    other = replace(session, status=msgspec.structs.replace(session.status, contract=contract))
    if code:
        assert find_codes(lambda: other.tree) == {code}
    else:
        assert "plan_grasp <b></b>" in other.tree.html


def test_notebooks_show_verdicts_with_the_numbers_that_decided(demo):
    shown = demo["red"]._repr_html_()
    assert f"<b>{GOAL}.red</b>: replan GRASP_LOST" in shown
    assert "<td>✗<td>accept<td><code>inside(red_cube, red_tray)</code><td>" in shown
    whole = demo.goals[GOAL]._repr_html_()
    assert f"<b>{GOAL}</b>: success" in whole
    assert whole.endswith(demo.goals[GOAL].graph._repr_html_())


def test_notebooks_show_a_report_and_a_workspace_in_short(demo, asked):
    shown = library.run("tidy_table", seed=3)._repr_html_()
    assert shown.startswith(f"<p><b>{GOAL}</b>: success ")
    assert shown.count("<tr>") == len(demo.sessions)
    assert demo._repr_html_() == demo.goals[GOAL]._repr_html_()


def test_nothing_that_a_document_says_becomes_markup(demo):
    criterion = Criterion(text=EVIL, kind=EVIL, truth=Truth.FALSE, because=EVIL)
    numbers = Criterion(text="t", kind="accept", truth=Truth.FALSE, measured={EVIL: EVIL})
    status = msgspec.structs.replace(demo["red"].status, attempts=(), reason=EVIL)
    session = replace(demo["red"], id=EVIL, state=EVIL, verdict="", criteria=(criterion, numbers), status=status)
    node = msgspec.structs.replace(demo.goals[GOAL].status.nodes["blue"], objective=EVIL)
    evil = GoalStatus(id=EVIL, objective=EVIL, reason=EVIL, criteria=(criterion,), nodes={EVIL: node})
    goal = replace(demo.goals[GOAL], id=EVIL, verdict=EVIL, status=evil)
    for html in (session._repr_html_(), goal._repr_html_()):
        assert "<script" not in html
        assert "onerror=y>" not in html
    _, graph = read_picture(goal.graph)
    assert not [each.tag for each in graph.iter() if each.tag.rpartition("}")[2] in {"script", "image", "img"}]
    assert EVIL in set(graph.itertext())


def test_a_run_orders_what_the_command_orders(asked, monkeypatch, paos, tmp_path):
    from phyagentos.cli import mission_run as shown

    report = library.run(
        "tidy_table",
        seed=3,
        workspace=str(tmp_path / "w"),
        faults="slip",
        overrides={"targets.arm": "panda"},
        world_mode="realtime",
        verify="audit",
        sense="truth",
        prior="shapes",
        memory="none",
        speed=0.5,
        pictures=False,
        trust_python=True,
    )
    assert (report.goal.goal, report.goal.verdict) == (GOAL, "success")

    class Noted(Exception): ...

    def note(order, *_):
        asked.append(order)
        raise DefinitionError.of("INVALID_VALUE", "here")

    monkeypatch.setattr(shown, "run_goal", note)
    options = ["--seed", "3", "-w", tmp_path / "w", "--faults", "slip", "--set", "targets.arm=panda"]
    options += ["--world-mode", "realtime", "--verify", "audit", "--sense", "truth", "--prior", "shapes"]
    paos("run", "tidy_table", *options, "--memory", "none", "--speed", 0.5, "--no-pictures", "--trust-python")
    assert asked[0] == asked[1]


CUBES = "tabletop/cubes_and_trays"
COMPILE = ("compile", "tidy_table", "--set", "targets.arm=ur5e")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "command"),
    [
        (lambda w: library.why("red", workspace=w), ("why", "red", "-w", "{}")),
        (library.status, ("status", "-w", "{}")),
        (lambda _: library.compile("tidy_table", overrides={"targets.arm": "ur5e"}), COMPILE),
        (lambda _: library.lint(ROOT / "goal_graphs"), ("lint", ROOT / "goal_graphs")),
        (lambda _: library.plan(ROOT / "tests/api/put_red.goal.yaml"), ("plan", ROOT / "tests/api/put_red.goal.yaml")),
        (lambda _: library.ask("make coffee", scene=CUBES), ("ask", "make coffee", "--scene", CUBES)),
    ],
    ids=["why", "status", "compile", "lint", "plan", "ask"],
)  # fmt: skip
def test_a_function_returns_what_its_command_prints_as_json(stored, paos, call, command):
    printed = paos(*(str(word).format(stored) for word in command), "--json").out
    assert json.loads(msgspec.json.encode(call(stored))) == json.loads(printed)


def test_a_request_becomes_a_graph_in_a_workspace_that_a_run_takes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = library.ask("put the cube into the red tray", scene=CUBES)
    (question,) = asked.questions
    found = library.ask("put the cube into the red tray", scene=CUBES, answers={question.key: "red_cube"})
    assert found.goal["accept"] == ["inside(red_cube, red_tray)"]
    assert Path(found.graph).is_relative_to(found.workspace)
    assert library.open_workspace(found.workspace).goals == {}


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"goal_graph": "tidy_tabel"}, "UNKNOWN_NAME (file)"),
        ({"faults": "slipp"}, "UNKNOWN_NAME (file)"),
        ({"overrides": {"cube.of": "red"}}, "INVALID_VALUE"),
        ({"overrides": {"cube": "red"}}, "UNKNOWN_NAME (parameter)"),
        ({"sense": "truht"}, "UNKNOWN_NAME (sense)"),
        ({"speed": 0.0}, "INVALID_VALUE"),
    ],
)
def test_a_run_that_cannot_begin_is_refused_before_a_folder_is_made(tmp_path, monkeypatch, options, code):
    monkeypatch.chdir(tmp_path)
    assert code in find_codes(library.run, **{"goal_graph": "tidy_table"} | options)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_run_raises_what_python_raises_for_an_interrupt(asked, monkeypatch):
    def run_goal(order, interrupts, clock):
        interrupts.count = 1
        return SimpleNamespace(workspace=None, goal=None)

    monkeypatch.setattr(running, "run_goal", run_goal)
    with pytest.raises(KeyboardInterrupt):
        library.run("tidy_table")


def test_interrupts_are_left_alone_outside_the_main_thread():
    failures = []

    def count():
        try:
            with running.Interrupts().counted() as interrupts:
                failures.append(interrupts.count)
        except ValueError as error:
            failures.append(error)

    thread = threading.Thread(target=count)
    thread.start()
    thread.join()
    assert failures == [0]
