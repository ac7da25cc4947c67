"""A goal run from a script: both planes in processes of their own, followed to the verdict, then read."""

import pytest

import phyagentos as paos

pytestmark = pytest.mark.journey


def test_a_script_runs_a_goal_to_its_verdict_and_reads_what_happened(tmp_path):
    report = paos.run("press_button", seed=7, workspace=tmp_path / "w")

    assert report.goal is not None
    assert (report.goal.goal, report.goal.verdict, report.exit_code) == ("press_button-7", "success", 0)
    assert report.workspace == str(tmp_path / "w")
    workspace = paos.open_workspace(report.workspace)
    (session,) = workspace.goals["press_button-7"].sessions
    assert (session.node, session.state, session.verdict) == ("press", "succeeded", "success")
    assert "press_button-7: success" in workspace.why()
    replay = workspace.replay("press")
    assert abs(replay.pose(replay.time_s[-1]).qpos - replay.qpos[0]).max() > 0.005  # the button has moved
    assert replay.tree_at(replay.time_s[-1])[next(iter(replay.tree_at(replay.time_s[-1])))] == "SUCCESS"
