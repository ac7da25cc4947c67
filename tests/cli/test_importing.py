"""`paos import`: an old workspace becomes drafts that lint accepts; wrong input is refused and nothing is written."""

import json
from pathlib import Path

from phyagentos.cli.outcome import ExitCode

FIXTURE = Path(__file__).resolve().parents[1] / "protocol" / "legacy_fixtures" / "old"


def test_the_drafts_of_an_old_workspace_pass_lint(paos, tmp_path):
    result = paos("import", FIXTURE, "-w", tmp_path / "w")
    assert result.code == ExitCode.GOAL_MET
    assert "3 pending sessions became nodes, 3 others history; " in result.out

    project = tmp_path / "w" / "imported" / "old" / "project"
    checked = paos("lint", project)
    assert (checked.code, checked.err) == (ExitCode.GOAL_MET, "")
    assert "goal_graphs" in {path.name for path in project.iterdir()}
    assert result.err == f"next: paos lint {project}\n"


def test_a_draft_can_be_compiled_before_it_is_completed(paos, tmp_path):
    paos("import", FIXTURE, "-w", tmp_path / "w")
    graph = tmp_path / "w" / "imported" / "old" / "project" / "goal_graphs" / "tidy_kitchen.yaml"
    result = paos("compile", graph)
    assert (result.code, result.err) == (ExitCode.GOAL_MET, "")
    assert "unstated()" in result.out


def test_every_remark_is_in_the_json_and_equal_ones_share_a_line(paos, tmp_path):
    report = json.loads(paos("import", FIXTURE, "-w", tmp_path / "w", "--json").out)
    lines = paos("import", FIXTURE, "-w", tmp_path / "w", "--name", "again").out.splitlines()[:-1]

    groups = {(each["kind"], each["field"], each["reason"]) for each in report["remarks"]}
    assert len(lines) == len(groups) < len(report["remarks"])
    assert any(line.endswith("(and 2 more)") for line in lines)
    assert report["targets"] == ["robots/libero_real_remote/target.yaml", "robots/minecraft_java_env/target.yaml"]
    assert all(each["address"].rsplit(":", 2)[1].isdigit() for each in report["remarks"])


def test_wrong_input_ends_with_two_and_writes_nothing(paos, tmp_path):
    path = tmp_path / "SESSIONS.md"
    path.write_text("# Runtime\n\n```yaml\nversion: runtime_sessions_v1\nsessions:\n  - {session_id: a\n```\n")
    result = paos("import", path, "-w", tmp_path / "w")

    assert result.code == ExitCode.INVALID_INPUT
    assert f"{path}:" in result.err
    assert "YAML_SYNTAX" in result.err
    assert "Traceback" not in result.err
    assert not (tmp_path / "w").exists()


def test_a_source_that_is_not_there_is_told(paos, tmp_path):
    result = paos("import", tmp_path / "nowhere", "-w", tmp_path / "w")
    assert result.code == ExitCode.INVALID_INPUT
    assert "UNREADABLE_FILE" in result.err


def test_an_import_goes_into_no_folder_that_is_something_else(paos, tmp_path):
    (tmp_path / "w").mkdir()
    (tmp_path / "w" / "thesis.tex").write_text("x")
    result = paos("import", FIXTURE, "-w", tmp_path / "w")

    assert result.code == ExitCode.INVALID_INPUT
    assert "NOT_A_WORKSPACE" in result.err
    assert [path.name for path in (tmp_path / "w").iterdir()] == ["thesis.tex"]


def test_a_name_that_leads_elsewhere_is_refused(paos, tmp_path):
    result = paos("import", FIXTURE, "-w", tmp_path / "w", "--name", "../elsewhere")
    assert result.code == ExitCode.INVALID_INPUT
    assert not (tmp_path / "w").exists()
