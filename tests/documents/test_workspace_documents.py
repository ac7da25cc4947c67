"""After a whole run every document of the workspace is what its reader and its schema say, and tells what happened."""

import subprocess
import sys

import pytest
import yaml

from phyagentos.operations.lint import lint_paths
from phyagentos.protocol.capabilities.targets import TARGETS, Health
from phyagentos.protocol.documents.document import iter_blocks, read_document
from phyagentos.protocol.sessions.runtime_signal import RUNTIME_SIGNAL, RuntimeState
from phyagentos.protocol.sessions.tasks import TASK, NodeState
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.store.document_registry import FORMATS

from .values import check_schema

pytestmark = pytest.mark.journey


@pytest.fixture(scope="module")
def workspace(tmp_path_factory, root):
    """`tidy_table` with one of its three cubes, which slips."""
    folder = tmp_path_factory.mktemp("documents") / "w"
    graph = yaml.safe_load((root / "goal_graphs" / "tidy_table.yaml").read_text())
    graph["sessions"] = {"red": graph["sessions"]["red"]}
    path = folder.with_name("tidy_table.yaml")
    path.write_text(yaml.safe_dump(graph | {"accept": [text for text in graph["accept"] if "red" in text]}))
    command = [sys.executable, "-m", "phyagentos", "run", str(path), "--seed", "7"]
    command += ["--faults", str(root / "faults" / "slip.yaml"), "--workspace", str(folder), "--no-pictures"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_lint_accepts_every_document_and_setting_of_the_workspace(workspace):
    paths = [workspace / name for name in (*FORMATS, *SETTINGS_FILES)]
    found = lint_paths(paths)
    assert (found.checked, found.problems) == (tuple(map(str, paths)), ())


@pytest.mark.parametrize("file", FORMATS)
def test_every_document_is_what_its_schema_says(workspace, file):
    check_schema((workspace / file).read_text(encoding="utf-8"), file)


@pytest.mark.parametrize("file", [name for name in FORMATS if name not in {"LESSONS.md", "KNOWLEDGE.md", "LOG.md"}])
def test_every_document_that_programs_write_has_something_to_tell(workspace, file):
    assert list(iter_blocks((workspace / file).read_text(encoding="utf-8")))


def test_the_task_tells_what_was_asked_what_went_wrong_and_what_was_done_about_it(workspace):
    text = (workspace / "TASK.md").read_text(encoding="utf-8")
    (goal,) = read_document(text, TASK).blocks.values()

    assert goal.verdict == "success"
    assert {node.state for node in goal.nodes.values()} == {NodeState.DONE}
    (replan,) = goal.nodes["red"].replans
    assert (replan.session, replan.child) == goal.nodes["red"].sessions
    assert "with another grasp" in replan.reason
    assert "GRASP_LOST" in text.split("what is done differently")[1]
    for criterion in goal.criteria:
        assert (workspace / criterion.evidence).is_file()
        assert f"]({criterion.evidence})" in text
    for session in goal.nodes["red"].sessions:
        assert f"[{session}](evidence/{session})" in text
        assert (workspace / "evidence" / session).is_dir()


def test_nothing_claims_to_live_after_the_end(workspace):
    signs = read_document((workspace / "RUNTIME_SIGNAL.md").read_text(encoding="utf-8"), RUNTIME_SIGNAL).blocks["Signs"]
    targets = read_document((workspace / "TARGETS.md").read_text(encoding="utf-8"), TARGETS).blocks

    assert signs.runtime is RuntimeState.ENDED
    assert {worker.health for worker in signs.workers.values()} == {Health.STOPPED}
    assert targets["panda"].health.state is Health.STOPPED


def test_the_log_ends_with_the_verdict_of_the_goal(workspace):
    lines = (workspace / "LOG.md").read_text(encoding="utf-8").splitlines()
    assert "goal verdict success" in lines[-1]
