"""What a command finds is what its published schema says: of every command that has `--json`.

The fixture `paos` validates the result of each command that a test calls. The tables below call what is cheap, and name
where the rest is called, so that a new command is asked for by existing.
"""

import re
from pathlib import Path

import jsonschema
import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.results import ANSWERING, LATE, build_result_schema
from tests.published_results import check_printed
from tests.stored_workspace import unpack_stored

ROOT = Path(__file__).resolve().parents[2]
ANYWHERE = {
    "plan": ("plan", ROOT / "tests" / "api" / "put_red.goal.yaml"),
    "runs": ("runs",),
    "init": ("init", "mine"),
    "list": ("list", "skills"),
    "describe": ("describe", "predicate"),
    "schema": ("schema", "scene"),
    "lifecycle": ("lifecycle", "--target"),
    "codes": ("codes",),
    "help": ("help", "make", "the", "arm", "slower"),
    "compile": ("compile", "tidy_table"),
    "lint": ("lint", ROOT / "goal_graphs" / "tidy_table.yaml"),
    "tree show": ("tree", "show", "pick_and_place"),
    "export mermaid": ("export", "mermaid", "statechart"),
    "export bt-xml": ("export", "bt-xml", "pick"),
    "robot list": ("robot", "list"),
    "robot show": ("robot", "show", "panda"),
    "robot check": ("robot", "check", "panda"),
    "scene check": ("scene", "check", "tabletop/cubes_and_trays"),
}
IN_A_WORKSPACE = {
    "why": ("why", "red"),
    "graph": ("graph",),
    "status": ("status",),
    "cancel": ("cancel", "tidy-7"),
    "pause": ("pause", "all"),
    "resume": ("resume", "all"),
    "estop": ("estop",),
    "approve": ("approve",),
    "memory show": ("memory", "show"),
    "evidence verify": ("evidence", "verify"),
}
OF_A_JOURNAL = {f"store {name}": ("store", name) for name in ("check", "repair", "compact")}
OF_A_RECORDED_RUN = {
    "context": ("context",),
    "verify": ("verify", "tidy_table-7.red"),
    "judge": ("judge",),
    "export html": ("export", "html"),
    "evidence prune": ("evidence", "prune", "--dry-run"),
    "export mcap": ("export", "mcap", "red"),
}
ELSEWHERE = {  # command -> the test file that calls it
    "run": "tests/examples/test_own_python.py",
    "ask": "tests/cli/test_asking.py",
    "logs": "tests/cli/test_observing.py",
    "store follow": "tests/cli/test_observing.py",
    "contest": "tests/cli/test_answering.py",
    "take-over": "tests/cli/test_explaining.py",
    "scene save": "tests/cli/test_scenes.py",
    "import": "tests/export/test_bt_xml.py",
    "deny": "tests/cli/test_approving.py",
    "amend": "tests/cli/test_amending.py",
    "edit": "tests/cli/test_editing.py",
    "doctor": "tests/cli/test_doctor.py",
    "archive": "tests/cli/test_archives.py",
    "restore": "tests/cli/test_archives.py",
    "memory why": "tests/cli/test_memory.py",
    "memory forget": "tests/cli/test_memory.py",
    "memory revoke": "tests/cli/test_learned_skills.py",
    "robot new": "tests/cli/test_robots.py",
    "robot ros2": "tests/cli/test_robots.py",
    "robot lerobot": "tests/cli/test_robots.py",
    "robot try": "tests/cli/test_robots.py",
    "bench run": "tests/cli/test_project_predicates.py",
    "bench resume": "tests/bench/test_bench_runs.py",
    "bench compare": "tests/bench/test_suites.py",
    "bench setup": "tests/bench/test_bench_runs.py",
}
BY_TYPE = {  # command -> why none is called here: its result has the type of its reply, which mypy checks
    "agent": "needs a runtime plane; its result is `goal` in that of `run`",
    "preflight": "starts a worker and a world; tests/preflight_corpus calls it in a process of its own",
    "rerun": "simulates a session again",
    "answer": "needs an open question; tests/cli/test_answering.py answers one",
    "render": "renders pictures",
    "robot render": "renders pictures",
    "robot calibrate": "needs a person at a real robot; tests/drivers/test_so101.py has an emulated one",
    "scene render": "renders pictures",
    "export video": "renders pictures",
    "export rrd": "needs an extra",
    "export lerobot": "needs an extra",
    "policy replay": "needs a policy",
    "memory promote": "simulates trials of a lesson",
    "bench report": "prints what `bench resume` does",
    "fleet server": "needs NATS; tests/extras/test_fleet.py calls what stands behind it",
    "fleet status": "needs NATS; tests/extras/test_fleet.py calls what stands behind it",
    "fleet stop": "needs NATS; tests/extras/test_fleet.py calls what stands behind it",
}
TABLES = (ANYWHERE, IN_A_WORKSPACE, OF_A_JOURNAL, OF_A_RECORDED_RUN, ELSEWHERE, BY_TYPE)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(paos, table, command, *place):
    done = paos(*table[command], *place, "--json")
    assert done.code != ExitCode.INVALID_INPUT, done.err
    check_printed(command, done.out)


def test_every_command_with_a_result_is_in_one_table():
    named = [command for table in TABLES for command in table]
    assert sorted(named) == sorted(ANSWERING)


@pytest.mark.parametrize("command", ANYWHERE)
def test_the_schema_holds_anywhere(paos, here, command):
    call(paos, ANYWHERE, command)


def test_the_schema_holds_in_a_workspace(paos, replanned):
    root = replanned.workspace.root
    for command in IN_A_WORKSPACE:
        call(paos, IN_A_WORKSPACE, command, "-w", root)
    for command in OF_A_JOURNAL:
        call(paos, OF_A_JOURNAL, command, root)


@pytest.mark.slow
def test_the_schema_holds_for_a_recorded_run(paos, here):
    root = unpack_stored(here)
    call(paos, OF_A_RECORDED_RUN, "judge", root)
    for command in OF_A_RECORDED_RUN.keys() - {"judge"}:
        call(paos, OF_A_RECORDED_RUN, command, "-w", root)


@pytest.mark.parametrize("command", ELSEWHERE)
def test_what_is_dear_is_called_where_it_is_said(command):
    text = (ROOT / ELSEWHERE[command]).read_text(encoding="utf-8")
    words = ", ".join(f'"{word}"' for word in command.split())
    assert re.search(rf"paos\(\s*{words}[,)]", text)


def test_what_is_not_called_has_the_type_of_its_reply():
    assert BY_TYPE.keys() & LATE.keys() == {"agent"}


def test_a_schema_refuses_another_result(paos):
    with pytest.raises(jsonschema.ValidationError):
        check_printed("lint", paos("list", "skills", "--json").out)


def test_no_command_promises_just_anything():
    assert [command for command in ANSWERING if build_result_schema(command).keys() <= {"title", "$defs"}] == []
