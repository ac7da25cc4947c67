"""The inbox: one YAML file, one request; what became of it is told by folders."""

import os
import re

import pytest

from phyagentos.store.edits import edit_intake, inbox
from tests.protocol.test_regular_files import lay_sparse

CONTRACT = """kind: submit
contract:
  objective: wave
  skill: wave
  target: panda
  accept: ["upright(bottle)"]
  scene: {name: tabletop/cubes_and_trays, seed: 7}
"""


def drop(stand, name, text):
    """As any program does: write beside, rename in."""
    temporary = stand.workspace.inbox / "tmp" / name
    temporary.write_bytes(text if isinstance(text, bytes) else text.encode())
    temporary.replace(stand.workspace.inbox / "new" / name)
    stand.settle()


def names(stand, folder):
    path = stand.workspace.inbox / folder
    return sorted(each.name for each in path.iterdir()) if path.exists() else []


def test_a_contract_is_submitted_under_the_name_of_its_file(stand):
    drop(stand, "wave-1.yaml", CONTRACT)

    status = stand.sessions["wave-1"]
    assert (status.state, status.asked_by, status.contract.scene.seed) == ("pending", "operator", 7)
    assert "## wave-1\n" in stand.text
    assert (names(stand, "new"), names(stand, "done")) == ([], ["wave-1.yaml"])


def test_a_session_is_amended_and_cancelled(stand):
    drop(stand, "1", "{kind: amend, session: a, limits: {timeout_s: 9}, priority: 2}")
    drop(stand, "2", "kind: cancel\nsession: b\nreason: supper\n")

    assert (stand.sessions["a"].contract.limits.timeout_s, stand.sessions["a"].contract.priority) == (9.0, 2)
    assert (stand.sessions["b"].state, stand.sessions["b"].reason) == ("cancelled", "supper")
    assert names(stand, "done") == ["1", "2"]


def test_a_request_that_stands_already_is_done(stand):
    for name in ("wave-1.yaml", "again.yaml"):
        drop(stand, name, CONTRACT.replace("contract:", "contract:\n  id: w") if name == "again.yaml" else CONTRACT)
    drop(stand, "third.yaml", CONTRACT.replace("contract:", "contract:\n  id: w"))
    drop(stand, "cancel", "{kind: cancel, session: a}")
    drop(stand, "cancel", "{kind: cancel, session: a}")

    assert names(stand, "refused") == []
    assert len(names(stand, "done")) == 5
    assert [record.ev for record in stand.pens["runtime"].read_new() if record.side == "operator"] == ["submit"] * 2 + [
        "cancel"
    ]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "kind: submitt\n",
            r"r.yaml:1:1: UNKNOWN_NAME \(request\): found 'submitt'; expected amend, cancel, submit. Did you mean",
        ),
        ("- kind\n", r"r.yaml.*UNKNOWN_NAME \(request\): found no 'kind'"),
        ("kind: [\n", r"r.yaml.*SYNTAX"),
        ("", r"UNKNOWN_NAME \(request\)"),
        (b"\xff\xfe\x00", r"UNREADABLE_FILE"),
        ("kind: cancel\nsesion: a\n", r"r.yaml:2:1: UNKNOWN_NAME \(key\): found 'sesion'.*Did you mean 'session'"),
        ("kind: cancel\nsession: nobody\n", r"asked for 'cancel' in state 'unknown'"),
        ("kind: amend\nsession: a\nlimits: {timeout_s: -1}\n", r"r.yaml:3:10: INVALID_VALUE.*> 0"),
        ("kind: amend\nsession: a\nlimits: {timout_s: 1}\n", r"found 'timout_s'.*Did you mean 'timeout_s'"),
        (
            CONTRACT.replace("skill: wave", "skil: wave"),
            r"r.yaml:4:3: UNKNOWN_NAME \(key\): found 'skil'.*MISSING_VALUE: .*'skill'",
        ),
        (CONTRACT.replace("  objective", "  goal: g\n  objective"), r"r.yaml:3:3: NOT_PERMITTED: found 'goal'"),
        (CONTRACT.replace("upright(bottle)", "upright("), r"r.yaml:6:\d+: SYNTAX"),
        (CONTRACT.replace("  objective", "  id: a\n  objective"), r"asked for 'submit' in state 'pending'"),
        ("kind: cancel\nsession: !!binary x\n", r"SYNTAX|INVALID_VALUE"),
        ("kind: cancel\nsession: a\nreason: 2026-99-99\n", r"r.yaml:3:9: SYNTAX"),
        ("? [a]\n: b\n", r"r.yaml:1:3: SYNTAX"),
    ],
)
def test_a_request_that_cannot_be_done_is_put_aside_with_the_reason(stand, text, reason):
    drop(stand, "r.yaml", text)
    stand.settle(5)

    assert names(stand, "refused") == ["r.yaml", "r.yaml.reason.md"]
    told = (stand.workspace.inbox / "refused" / "r.yaml.reason.md").read_text()
    assert re.search(reason, told, re.DOTALL), told
    assert "Nothing was done." in told
    kept = (stand.workspace.inbox / "refused" / "r.yaml").read_bytes()
    assert kept == (text if isinstance(text, bytes) else text.encode())


ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(8)
)
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{n + 1}: &a{n + 1} {{<<: [{', '.join([f'*a{n}'] * 9)}]}}\n" for n in range(8))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("kind: submit\na: !!bool x\n", r"r.yaml:2:4: SYNTAX"),
        ("kind: submit\na: !!timestamp x\n", r"r.yaml:2:4: SYNTAX"),
        (f"kind: submit\n{ALIASES}", r"r.yaml:.*aliases"),
        (f"kind: submit\n{MERGES}", r"r.yaml:.*aliases"),
        (CONTRACT + f"  parameters:\n{ALIASES}".replace("\n", "\n    ").rstrip(), r"r.yaml:.*aliases"),
        ("kind: submit\na: &a [*a]\n", r"r.yaml:.*alias"),
        ("[" * 100_000 + "]" * 100_000, r"r.yaml:.*levels"),
    ],
)
def test_no_file_holds_up_who_reads_it(stand, text, reason):
    drop(stand, "r.yaml", text)
    drop(stand, "s.yaml", "{kind: cancel, session: a}")

    assert re.search(reason, (stand.workspace.inbox / "refused" / "r.yaml.reason.md").read_text())
    assert stand.sessions["a"].state == "cancelled"


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (os.mkfifo, "no regular file"),
        (lambda path: path.symlink_to(path.name), "symbolic link"),
        (lambda path: path.symlink_to("/proc/kmsg"), "symbolic link"),
        (lay_sparse, "more than 1048576 bytes"),
        (lambda path: path.write_text("k: v\n" * 100_000), "more than 10000 values"),
    ],
)
def test_what_is_no_small_regular_file_is_put_aside_unread(stand, make, reason):
    make(stand.workspace.inbox / "new" / "r.yaml")
    drop(stand, "s.yaml", "{kind: cancel, session: a}")

    assert reason in (stand.workspace.inbox / "refused" / "r.yaml.reason.md").read_text()
    assert names(stand, "new") == []
    assert stand.sessions["a"].state == "cancelled"


def test_many_requests_are_taken_in_several_turns(stand, monkeypatch):
    monkeypatch.setattr(inbox, "TURN_S", -1.0)  # one a turn
    for number in range(5):
        (stand.workspace.inbox / "new" / str(number)).write_text("{kind: cancel, session: a}")
    stand.settle(1)
    assert len(names(stand, "done")) == 1
    stand.settle(4)
    assert len(names(stand, "done")) == 5


@pytest.mark.parametrize("name", ["n" * 255, "n" * 250 + ".yaml", "n" * 246])
def test_a_long_name_is_refused_as_any_other(stand, name):
    for _ in range(2):
        drop(stand, name, "kind: submitt\n")

    assert names(stand, "new") == []
    assert len(names(stand, "refused")) == 4
    assert sum(each.endswith(".reason.md") for each in names(stand, "refused")) == 2


def test_what_this_program_fails_on_is_refused_with_the_error(stand, monkeypatch):
    def fail(*_):
        raise KeyError("odd")

    monkeypatch.setattr(edit_intake, "plan", fail)
    drop(stand, "r.yaml", "{kind: cancel, session: a}")

    told = (stand.workspace.inbox / "refused" / "r.yaml.reason.md").read_text()
    assert "this program failed on it (KeyError: 'odd')" in told


def test_a_file_that_is_written_straight_into_the_folder_is_waited_for(stand):
    with (stand.workspace.inbox / "new" / "slow.yaml").open("w") as file:
        stand.settle(5)
        file.write("kind: cancel\n")
        file.flush()
        stand.settle(5)
        assert names(stand, "new") == ["slow.yaml"]
        file.write("session: a\n")
    stand.settle()

    assert stand.sessions["a"].state == "cancelled"


def test_what_is_hidden_or_a_folder_is_left_alone(stand):
    (stand.workspace.inbox / "new" / ".hidden").write_text("kind: cancel")
    (stand.workspace.inbox / "new" / "folder").mkdir()
    stand.settle(5)

    assert names(stand, "new") == [".hidden", "folder"]


def test_a_link_is_refused_and_no_word_of_what_it_leads_to_is_told(stand, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("password: [hunter2\n")
    refused = stand.workspace.inbox / "refused"
    refused.mkdir()
    (refused / "link.yaml.reason.md").symlink_to(secret)
    (stand.workspace.inbox / "new" / "link.yaml").symlink_to(secret)
    for _ in range(4):
        stand.settle()

    assert "hunter2" not in (refused / "link.yaml.reason.md").read_text()
    assert secret.read_text() == "password: [hunter2\n"
    assert names(stand, "new") == []
