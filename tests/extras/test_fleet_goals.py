"""A goal over hosts that share no folder: arms of one world that a third machine serves, each on a host of its own."""

import contextlib
import json
import shutil
import subprocess
import sys

import pytest

from benchmarks.fleet_parts.stage import choose_port
from phyagentos.assembly.paths import TOKENS
from phyagentos.fleet.server_settings import ALL
from phyagentos.operations.fleet import prepare_server
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.handshake import make_key

pytest.importorskip("nats", reason="needs the extra `fleet`: make test-extras")
pytestmark = [pytest.mark.extras, pytest.mark.slow]

ARMS = ("left_arm", "right_arm")
EXAMPLE = find_shipped_root() / "examples" / "projects" / "04_two_arms"
LIMIT_S = 900.0


class Machines:
    """Folders with a project and a workspace each, and what runs in them; all of it ends in the end."""

    def __init__(self, folder, stack):
        self.folder, self._stack = folder, stack

    def add(self, name):
        shutil.copytree(EXAMPLE, self.folder / name / "project")
        return self.folder / name / "project"

    def start(self, name, *command, **pipes):
        log = self._stack.enter_context((self.folder / f"{name}.log").open("ab"))
        place = self.folder / name / "project"
        process = subprocess.Popen(
            command, cwd=place if place.is_dir() else None, **({"stdout": log} | pipes), stderr=log
        )
        self._stack.enter_context(process)
        self._stack.callback(process.terminate)
        return process

    def paos(self, name, *words, **pipes):
        place = ("--workspace", str(self.folder / name / "w"))
        return self.start(name, sys.executable, "-m", "phyagentos", *words, *place, **pipes)


@pytest.fixture
def machines(tmp_path):
    with contextlib.ExitStack() as stack:
        yield Machines(tmp_path, stack)


def serve_table(machines, keys):
    """The world, where the simulator is; endpoints of the arms."""
    machines.add("table")
    place = ("--workspace", str(machines.folder / "table" / "w"), "--target", "table")
    command = ["-m", "phyagentos.assembly.processes", "world", *place]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    table = machines.start("table", sys.executable, *command, "--socket", "ws://127.0.0.1:0", **pipes)
    table.stdin.write("".join(f"{arm} {key}\n" for arm, key in keys.items()).encode())
    table.stdin.flush()
    return {arm: table.stdout.readline().decode().strip() for arm in ARMS}


def join(machines, url, arm, endpoint, key):
    """A host whose arm is in that world."""
    project = machines.add(arm)
    for each in ARMS:
        profile = project / "robots" / each / "target.yaml"
        text = profile.read_text(encoding="utf-8")
        profile.write_text(text.replace("world: table\n", f"world: table\ndriver: remote\nendpoint: {endpoint}\n"))
    secret = Workspace.create(machines.folder / arm / "w", Library.open(project)).root / TOKENS / arm
    secret.parent.mkdir(parents=True)
    secret.touch(mode=0o600)
    secret.write_text(key, encoding="ascii")
    machines.paos(arm, "fleet", "join", "--server", url, "--name", arm, "--target", arm)


def test_two_arms_of_one_world_sort_together_from_two_hosts(machines):
    prepared = prepare_server(machines.folder / "server", f"127.0.0.1:{choose_port()}")
    url, keys = prepared.urls[ALL], {arm: make_key().hex() for arm in ARMS}
    machines.start("server", *prepared.command)
    endpoints = serve_table(machines, keys)
    machines.add("hub")
    machines.paos("hub", "fleet", "lead", "--server", url)
    for arm in ARMS:
        join(machines, url, arm, endpoints[arm], keys[arm])
    options = ("--seed", "0", "--memory", "none", "--json")
    agent = machines.paos("hub", "agent", "goal_graphs/sort_together.yaml", *options, stdout=subprocess.PIPE)
    printed, _ = agent.communicate(timeout=LIMIT_S)

    report = json.loads(printed)
    assert report["verdict"] == "success"
    commands = {arm: (machines.folder / arm / "w" / "logs" / f"receive-{arm}.jsonl").read_text() for arm in ARMS}
    assert all('"Command"' in each for each in commands.values())
