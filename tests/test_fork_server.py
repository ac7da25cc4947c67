"""Processes that a fork server starts behave as new interpreters do."""

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from phyagentos.fork_server import ADDRESS, FORKED_FOR, Fork, fork_server, start_python
from tests.following import wait_until

SHOWS = """
import json, os, pathlib, sys
facts = [sys.argv, os.getcwd(), os.getsid(0) == os.getpid(), os.environ["SAID"], sys.stdin.read()]
os.write(int(sys.argv[1]), json.dumps(facts).encode())
print("printed"); print("wrong", file=sys.stderr)
sys.exit(3)
"""


@pytest.fixture(scope="module")
def address():
    """Of a server that has loaded nothing; it serves where a test says so."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(ADDRESS, raising=False)
        with fork_server(["json"]):
            yield os.environ[ADDRESS]


@pytest.fixture(params=["interpreter", "fork"])
def environment(request, address, tmp_path):
    """What a child begins with; its module is in its folder."""
    own = {name: value for name, value in os.environ.items() if name != ADDRESS}
    return own | ({ADDRESS: address} if request.param == "fork" else {}) | {"SAID": request.param}


def start(tmp_path, environment, source, *arguments, **options):
    (tmp_path / "requested.py").write_text(source)
    with (tmp_path / "log").open("ab") as log:
        command = ["-m", "requested", *map(str, arguments)]
        child = start_python(command, log, environment=environment, folder=tmp_path, **options)
    assert isinstance(child, Fork) == (environment["SAID"] == "fork")
    return child


def test_a_child_has_the_arguments_folder_environment_files_and_code_that_are_requested(tmp_path, environment):
    reads, writes = os.pipe()
    child = start(tmp_path, environment, SHOWS, writes, pass_fds=[writes], has_input=True)
    os.close(writes)
    child.stdin.write(b"a line")
    child.stdin.close()
    with os.fdopen(reads) as pipe:
        said = pipe.read()
    assert said.startswith(f'[["{tmp_path / "requested.py"}", "{writes}"], "{tmp_path}", true, "{environment["SAID"]}"')
    assert said.endswith('"a line"]')
    assert child.wait(60) == 3
    assert child.poll() == 3
    assert sorted((tmp_path / "log").read_text().split()) == ["printed", "wrong"]


ENDINGS = {
    "sys.exit()": (0, ""),
    "sys.exit(5)": (5, ""),
    "sys.exit('that is wrong')": (1, "that is wrong"),
    "raise ValueError('not so')": (1, "ValueError: not so"),
    "": (0, ""),
}
BEFORE = """
import atexit, sys, threading, time
atexit.register(print, "at the end")
threading.Thread(target=lambda: (time.sleep(0.05), print("by a thread"))).start()
"""


@pytest.mark.parametrize("source", ENDINGS)
def test_it_ends_with_its_code_once_threads_and_exit_handlers_are_done_and_all_is_printed(
    tmp_path, environment, source
):
    code, printed = ENDINGS[source]
    assert start(tmp_path, environment, BEFORE + source).wait(60) == code
    log = (tmp_path / "log").read_text()
    assert printed in log
    assert "by a thread\nat the end\n" in log


def test_a_fork_does_not_take_down_what_it_has_loaded(tmp_path, environment):
    source = """
import os
class Kept:
    def __del__(self, write=os.write):
        write(1, b"taken down")
kept = Kept()
"""
    assert start(tmp_path, environment, source).wait(60) == 0
    assert ((tmp_path / "log").read_text() == "taken down") == (environment["SAID"] == "interpreter")


@pytest.mark.parametrize("end", ["terminate", "kill"])
def test_it_ends_when_told_and_its_code_is_the_signal(tmp_path, environment, end):
    child = start(tmp_path, environment, "import time; time.sleep(60)")
    assert child.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.01)
    getattr(child, end)()
    assert child.wait(60) == -(signal.SIGTERM if end == "terminate" else signal.SIGKILL)


def test_its_process_id_is_taken_until_its_requester_lets_it_go(tmp_path, environment):
    child = start(tmp_path, environment, "")
    if isinstance(child, Fork):
        child.wait(60)  # subprocess frees it here
    os.kill(child.pid, 0)
    child.wait(60)


def test_where_another_environment_is_requested_a_new_interpreter_starts(tmp_path, address):
    other = os.environ | {ADDRESS: address, "PYTHONPATH": str(tmp_path), "SAID": "interpreter"}
    assert start(tmp_path, other, "").wait(60) == 0


def test_so_it_does_where_the_server_is_gone(tmp_path):
    gone = os.environ | {ADDRESS: str(tmp_path / "nothing"), "SAID": "interpreter"}
    assert start(tmp_path, gone, "").wait(60) == 0


ENDS = """
import os, sys, time
from phyagentos.assembly.process_tuning import end_with
assert end_with(int(sys.argv[1]))
print("ready", flush=True)
time.sleep(60)
"""


def test_a_child_that_ends_with_its_requester_does(tmp_path, environment):
    (tmp_path / "requested.py").write_text(ENDS)
    asks = (
        "import os, sys, time; from phyagentos.fork_server import start_python;"
        f"child = start_python(['-m', 'requested', str(os.getpid())], open({str(tmp_path / 'log')!r}, 'wb'));"
        "print(child.pid, flush=True); time.sleep(60)"
    )
    requester = subprocess.Popen(
        [sys.executable, "-c", asks], env=environment, cwd=tmp_path, stdout=subprocess.PIPE, text=True
    )
    pidfd = os.pidfd_open(int(requester.stdout.readline()))
    wait_until(lambda: "ready" in (tmp_path / "log").read_text(), "the child")
    requester.kill()
    requester.communicate()
    assert select.select([pidfd], [], [], 60.0)[0]
    os.close(pidfd)


def test_a_process_whose_module_is_loaded_waits_for_that_and_another_one_for_nothing(tmp_path, monkeypatch):
    source = "import sys\nif __name__ == '__main__': print('colorsys' in sys.modules)"
    for name in ("named", "other"):
        (tmp_path / f"{name}.py").write_text(source)
    monkeypatch.delenv(ADDRESS, raising=False)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with fork_server(["colorsys", "named"]), (tmp_path / "log").open("ab") as log:
        for name in ("other", "named"):
            assert start_python(["-m", name], log).wait(60) == 0
    assert (tmp_path / "log").read_text().split() == ["False", "True"]


def test_a_process_that_waits_for_the_last_of_what_is_loaded_starts_then(tmp_path, monkeypatch):
    (tmp_path / "last.py").write_text("if __name__ == '__main__': print('started')")
    monkeypatch.delenv(ADDRESS, raising=False)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with fork_server(["last"]), (tmp_path / "log").open("ab") as log:
        assert start_python(["-m", "last"], log).wait(60) == 0
    assert (tmp_path / "log").read_text() == "started\n"


def test_its_server_ends_with_the_block_and_its_folder_goes():
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(ADDRESS, raising=False)
        with fork_server([]):
            folder = Path(os.environ[ADDRESS]).parent
            assert folder.exists()
        assert not folder.exists()
        assert ADDRESS not in os.environ
        assert FORKED_FOR not in os.environ
