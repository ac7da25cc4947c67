"""Every way a command can end has its own code, and no traceback unless asked for."""

import json
import os
import re
import subprocess
import sys

import pytest

from phyagentos.assembly.planes import Plane
from phyagentos.cli.app import COMMANDS, SECTIONS, read_summary
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.results import ANSWERING
from phyagentos.clock import SystemClock
from phyagentos.operations import listing
from tests.command_line import assert_ended, assert_refused


def test_help_and_version_succeed(paos):
    shown, version = paos("--help"), paos("--version")
    assert (shown.code, version.code, version.out[:11]) == (0, 0, "phyagentos ")


@pytest.mark.parametrize(
    ("raised", "options", "code", "said"),
    [
        pytest.param(
            ZeroDivisionError("planted"),
            (),
            ExitCode.INTERNAL_ERROR,
            r"paos: ZeroDivisionError: planted. Add --debug for the traceback.\n",
            id="a defect of this program is one line",
        ),
        pytest.param(
            ZeroDivisionError("planted"),
            ("--debug",),
            ExitCode.INTERNAL_ERROR,
            r"(?s).*Traceback \(most recent call last\).*",
            id="debug shows the traceback",
        ),
        pytest.param(KeyboardInterrupt(), (), ExitCode.INTERRUPTED, r"(?s).*", id="Ctrl-C is 130"),
    ],
)
def test_what_ends_a_command_has_its_code_and_a_line(paos, monkeypatch, raised, options, code, said):
    def fail(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr(listing, "list_names", fail)
    monkeypatch.delenv("PAOS_DEBUG", raising=False)
    result = paos(*options, "list", "leaves")
    assert (result.code, bool(re.fullmatch(said, result.err))) == (code, True), result.err


@pytest.mark.slow
def test_a_plane_is_stopped_with_everything_it_printed_in_its_log(tmp_path):
    plane = Plane("agent", ["no_such_graph", "--workspace", str(tmp_path / "w")], tmp_path)
    clock = SystemClock()
    while plane.find_exit_code() is None:
        clock.sleep(0.02)
    plane.stop(clock)
    assert plane.find_exit_code() == ExitCode.INVALID_INPUT
    assert "no_such_graph: UNKNOWN_NAME (file)" in plane.log.read_text(encoding="utf-8")


SHOW_TREE = [sys.executable, "-m", "phyagentos", "tree", "show", "pick_and_place"]


@pytest.mark.slow
def test_a_result_is_printed_in_any_encoding_and_as_json_loses_nothing(paos):
    narrow = os.environ | {"PYTHONIOENCODING": "latin-1"}
    shown, exact = (
        subprocess.run(command, env=narrow, capture_output=True, check=True).stdout.decode("latin-1")
        for command in (SHOW_TREE, [*SHOW_TREE, "--json"])
    )
    assert "\\u2192 pick_and_place" in shown
    assert json.loads(exact) == json.loads(paos(*SHOW_TREE[3:], "--json").out)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("redirection", "code", "said"),
    [
        ("2>&1 | true", 0, ""),
        (">&-", 0, ""),
        ("2>&- >/dev/null", 0, ""),
        (">/dev/full", 4, "standard output: no room is left"),
    ],
)
def test_where_a_result_goes_to_changes_no_exit_code_but_that_of_one_that_is_lost(redirection, code, said):
    command = f"set -o pipefail; {' '.join(SHOW_TREE)} {redirection}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, said in done.stderr) == (code, True), done


NO_EFFECT = "targets.amr: UNKNOWN_NAME (role): found 'amr'; expected arm. Did you mean 'arm'?"
NEAREST = "found no such file; expected a path or a name in goal_graphs/. Did you mean 'tidy_table'?"
SEED_MAX = str(2**63 - 1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("why", "red", "-w", "nowhere"), "NOT_A_WORKSPACE"),
        *(((command, "tidy_tabel"), NEAREST) for command in ("run", "lint")),
        (("run", "quite_other"), "UNKNOWN_NAME (file): found no such file; expected a path, or one of: carry_cup"),
        (("fly",), "No such command 'fly'"),
        (("doctor", "nowhere"), "UNKNOWN_NAME (folder)"),
        (("help", "zzyzx"), "alike, approve, backup"),
        (("run", "tidy_table", "--verify", "sometimes"), "recovery"),
        (("run", "tidy_table", "--seed", "abc"), "found 'abc'; expected a whole number"),
        (("list", "robot"), "found 'robot'; expected one of graphs, leaves"),
        (("memory", "list"), "No such command 'list'. There are show, why, forget"),
        (("bench", "compare", "a", "b"), "NOT_A_WORKSPACE: found no such file; expected the folder of a run"),
        (("robot", "new", __file__), "found a file called '.py'; expected a model of a robot: .xml"),
        (
            ("compile", "tidy_table", "--set", "arm=panda"),
            "--set arm: UNKNOWN_NAME (parameter): found 'arm'; expected targets.arm",
        ),
        *(((command, "tidy_table", "--set", "targets.amr=panda"), NO_EFFECT) for command in ("compile", "run")),
        *(((command, "tidy_table", "--seed", 2**63), SEED_MAX) for command in ("run", "agent", "preflight")),
    ],
)
def test_invalid_input_is_named_and_is_json_where_json_is_asked_for(paos, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    result = paos(*arguments, "--json")
    found = json.loads(result.out)
    assert found["exit_code"] == result.code == ExitCode.INVALID_INPUT
    assert said in found["error"]
    assert said in result.err
    assert "Traceback" not in result.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_list_of_commands_loads_none_of_them_and_says_what_each_says_of_itself(paos):
    code = "import sys, phyagentos.cli.app as a; sys.argv = ['paos', '-h']\ntry: a.main()\nfinally: print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Behaviour trees." in done.stdout
    assert "paos run tidy_table" in done.stdout
    assert [line[:-1] for line in done.stdout.splitlines() if re.fullmatch(r"[A-Z]\w+:", line)][1:] == list(SECTIONS)
    assert not {"pydantic", "numpy", "yaml", "rich"} & set(done.stdout.split())
    for name in COMMANDS:
        line, shown = read_summary(name), paos(name, "--help")
        assert name in done.stdout
        assert len(line) > 20
        assert line in " ".join(shown.out.split()), name
        assert_ended(shown, ExitCode.GOAL_MET, out=["Usage:"])


def test_every_command_with_an_end_has_json(paos):
    for command in ANSWERING:
        assert "--json" in paos(*command.split(), "--help").out, command
    assert len(ANSWERING) > 60


@pytest.mark.parametrize(
    ("words", "nearest"),
    [
        (("rnu",), "Did you mean 'run'?"),
        (("store", "chekc"), "Did you mean 'check'?"),
        (("run", "tidy_table", "--sed", "3"), "Did you mean '--seed'"),
        (("tree", "show", "pick_and_plaec"), "Did you mean 'pick_and_place'?"),
        (("schema", "goal_grap"), "Did you mean 'goal_graph'?"),
    ],
)
def test_a_slip_in_a_command_an_option_or_a_name_gets_the_nearest_name(paos, words, nearest):
    result = paos(*words)
    assert (result.code, nearest in result.err) == (ExitCode.INVALID_INPUT, True), result.err


def test_problems_of_lint_are_json(paos, tmp_path):
    (tmp_path / "a.yaml").write_text("goal: a\n")
    result = paos("lint", tmp_path / "a.yaml", "--json")
    assert result.code == ExitCode.INVALID_INPUT
    assert "MISSING_VALUE" in {problem["code"] for problem in json.loads(result.out)["problems"]}


@pytest.mark.parametrize("command", [("init",), ("run", "tidy_table", "-w"), ("watch", "-w")])
def test_a_place_that_cannot_be_written_is_a_user_error(paos, tmp_path, command):
    (tmp_path / "file").write_text("")
    assert_refused(
        paos(*command, tmp_path / "file" / "below"),
        f"{tmp_path / 'file' / 'below'}",
        "name a place that can be read and written",
    )


def test_ctrl_c_while_the_program_is_imported_leaves_no_traceback(tmp_path):
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt\n")  # as if it came just then
    path = os.pathsep.join([str(tmp_path), *sys.path])
    command = [sys.executable, "-m", "phyagentos", "list", "leaves"]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (ExitCode.INTERRUPTED, "")


def test_a_parameter_is_given_by_its_name_and_a_bad_value_is_invalid_input(paos):
    given = paos("compile", "put_away", "--set", "thing=carton")
    assert "carry: pick_and_place(object=carton, destination=green_tray)" in given.out
    assert "push: push(object=carton, to=[0.4, -0.1, 0.02]) on panda  after carry on failure" in given.out
    assert_refused(
        paos("compile", "put_away", "--set", "thing=cartn"), "--set thing:1:1: UNKNOWN_NAME (object): found 'cartn'"
    )


def test_a_robot_whose_model_is_not_here_is_named_before_anything_starts(paos, tmp_path, monkeypatch):
    monkeypatch.delenv("PHYAGENTOS_MODELS", raising=False)
    assert_refused(
        paos("run", "drive_and_pick", "-w", tmp_path / "w"), "UNREADABLE_FILE: found", "Set PHYAGENTOS_MODELS"
    )
    assert not (tmp_path / "w").exists()
