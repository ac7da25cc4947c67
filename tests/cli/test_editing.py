"""`paos edit`: with any editor, with or without a runtime."""

import fcntl
import os
import threading

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.workspaces import read_ledger
from tests.command_line import assert_ended, assert_refused


@pytest.fixture
def pending(run):
    run.begin()
    run.submit("red")
    return run


def contract_of(run):
    return read_ledger(run.workspace.root).sessions["tidy-7.red"].contract


def test_a_limit_is_changed_with_sed(pending, paos):
    assert_ended(
        paos("edit", pending.workspace.root, "--editor", "sed -i 's/timeout_s: 60.0/timeout_s: 75/'"),
        ExitCode.GOAL_MET,
        out=['tidy-7.red: amend {"limits": {"timeout_s": 75.0}}'],
    )
    assert contract_of(pending).limits.timeout_s == 75.0
    assert "timeout_s: 75.0" in pending.workspace.sessions_document.read_text()


def test_what_is_refused_is_told_with_its_line(pending, paos):
    assert_refused(
        paos("edit", pending.workspace.root, "--editor", "sed -i 's/^state: pending/state: succeeded/'"),
        "SESSIONS.md:",
        "state: a state follows from records, and a verdict from evidence. Possible: limits",
        "1 refused; every word of it is in",
    )
    assert "state: succeeded" in pending.workspace.rejected_document.read_text()


@pytest.mark.parametrize(
    ("editor", "code", "told"),
    [
        ("true", ExitCode.GOAL_MET, "nothing was changed"),
        ("false", ExitCode.INVALID_INPUT, "false ended with 1; nothing was changed"),
        ("no-such-editor", ExitCode.INVALID_INPUT, "no-such-editor: No such file or directory. Name an editor"),
        ("sed 's/", ExitCode.INVALID_INPUT, "No closing quotation"),
        ("rm", ExitCode.INVALID_INPUT, "the editor left no file"),
    ],
)
def test_an_editor_that_changes_nothing_or_fails_leaves_everything_as_it_was(pending, paos, editor, code, told):
    before = contract_of(pending)
    result = paos("edit", pending.workspace.root, "--editor", editor)

    assert (result.code, contract_of(pending)) == (code, before)
    assert told in result.err


def test_the_editor_of_the_environment_is_used(pending, paos, monkeypatch):
    monkeypatch.delenv("VISUAL", raising=False)
    monkeypatch.setenv("EDITOR", "sed -i 's/^priority: 0/&/; s/  priority: 0/  priority: 2/'")
    paos("edit", pending.workspace.root)

    assert contract_of(pending).priority == 2


@pytest.mark.slow
def test_it_waits_for_another_one_to_finish(pending, paos):
    lock = pending.workspace.edits / ".lock"
    lock.parent.mkdir()
    fd = os.open(lock, os.O_RDWR | os.O_CREAT)
    fcntl.flock(fd, fcntl.LOCK_EX)
    timer = threading.Timer(0.3, os.close, [fd])
    timer.start()
    result = paos("edit", pending.workspace.root, "--editor", "true")
    timer.join()

    assert result.code == ExitCode.GOAL_MET
    assert "waiting" in result.err


def test_a_folder_that_is_no_workspace_is_refused(tmp_path, paos):
    assert_refused(paos("edit", tmp_path, "--editor", "true"), "NOT_A_WORKSPACE")
