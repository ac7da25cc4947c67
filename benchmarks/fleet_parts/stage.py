"""A fleet of processes with a folder each and no path in common: servers, hub, hosts; restarted as a manager would."""

import asyncio
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

from benchmarks.fleet_parts.links import Link
from phyagentos.clock import Clock
from phyagentos.operations.fleet import prepare_server
from phyagentos.store.follower import Follower
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

LIBRARY = Path(__file__).resolve().parents[1] / "library"
HOSTS = {"h1": "counter", "h2": "counter", "h3": "solo"}  # two share a target, one has its own
SERVERS = "abc"
SETTINGS = """
servers:
  a: {{listen: {}, cluster: {}}}
  b: {{listen: {}, cluster: {}}}
  c: {{listen: {}, cluster: {}}}
hosts: {}
"""
DISK_BYTES = 48 << 20  # of a host whose disk can be filled
FILLER = "filler"
SHIFTED = """import time

for name, unit in {"time": 1, "time_ns": 10**9}.items():
    setattr(time, name, lambda real=getattr(time, name), unit=unit: real() + SHIFT * unit)
"""
CLOCK_OFF_S = 3600
LEASE_S = 4.0  # shorter than a session, so that one which goes on under a lost claim shows
SLOWLY = """
import threading

import numpy as np

from phyagentos.runtime.execution.leaf import Leaf, Role, Status

PERIODS, PAUSE_S = 400, 0.025  # a session holds its target for ten seconds
STEP = 0.02 / PERIODS


class Advance(Leaf):
    ROLE = Role.MOVE
    _left = PERIODS

    def on_start(self):
        self._left = PERIODS
        return self.on_running()

    def on_running(self):
        if not self._left:
            return self.succeed()
        self._left -= 1
        threading.Event().wait(PAUSE_S)
        commands = self.context.commands
        q = commands.q_rad + STEP * np.linspace(0.0, 1.0, commands.n_steps + 1)[1:, None]
        commands.set_arm(q, np.zeros_like(q))
        return Status.RUNNING


def register(registry):
    registry.register("advance_one_step", Advance)
"""
GRAPH = """
goal: chaos
objective: Steps on two slides.
scene: counter
targets: {shared: counter, own: solo}
defaults: {timeout_s: 30, max_replans: 2}
sessions:
  s0: {skill: advance, target: shared}
  s1: {skill: advance, target: shared, after: [s0]}
  o0: {skill: advance, target: own}
accept: ["height(mark) >= -0.5"]
"""


def prepare_project(folder: Path) -> Path:
    """The counter of the benchmarks, twice, with slow steps; its graph."""
    shutil.copytree(LIBRARY, folder)
    (folder / "skills" / "advance" / "behaviours.py").write_text(SLOWLY)
    shutil.copytree(folder / "robots" / "counter", folder / "robots" / "solo")
    profile = folder / "robots" / "solo" / "target.yaml"
    profile.write_text(profile.read_text().replace("target: counter", "target: solo"))
    safety = folder / "protocol" / "safety.yaml"
    text = safety.read_text()
    safety.write_text(text + text[text.index("  counter:\n") :].replace("  counter:", "  solo:"))
    graph = folder / "goal_graphs" / "chaos.yaml"
    graph.write_text(GRAPH)
    return graph


def mount_disk(folder: Path) -> bool:
    """A small disk of its own, where this is permitted."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "none", str(folder)]
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


def choose_port() -> int:
    """One that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Stage:
    """Processes by name: the servers, `hub`, one for each host, and the `agent` of the present goal."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self.folder, self._clock = folder, clock
        self.graph = prepare_project(folder / "project")
        addresses = [f"127.0.0.1:{choose_port()}" for _ in range(2 * len(SERVERS))]
        settings = folder / "fleet.yaml"
        settings.write_text(SETTINGS.format(*addresses, [*HOSTS]))
        servers = {each: prepare_server(folder / each, settings=settings, member=each) for each in SERVERS}
        ports = [int(each.rpartition(":")[2]) for each in addresses[::2]]
        self._urls = servers["a"].urls
        self.links = {name: [Link(port) for port in ports] for name in ("hub", *HOSTS)}
        self._commands = {name: [*each.command] for name, each in servers.items()}
        self._commands["hub"] = self._paos("hub", "lead", "--lease", str(LEASE_S))
        for host, target in HOSTS.items():
            own = ("--name", host, "--target", target, "--no-pictures", "--trust-python")
            self._commands[host] = self._paos(host, "join", *own)
        self._shifted: set[str] = set()
        self._shifted_path = os.pathsep.join((str(folder / "shifted"), os.environ.get("PYTHONPATH", "")))
        (folder / "shifted").mkdir()
        (folder / "shifted" / "sitecustomize.py").write_text(SHIFTED.replace("SHIFT", str(CLOCK_OFF_S)))
        self.mounted = [host for host in HOSTS if mount_disk(folder / host)]
        self._log = (folder / "processes.log").open("ab")
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._not_before_s: dict[str, float] = {}

    def _paos(self, name: str, verb: str, *options: str) -> list[str]:
        user = self._urls[name].split("@")[0]
        url = ",".join(f"{user}@127.0.0.1:{link.port}" for link in self.links[name])
        place = ("--workspace", str(self.folder / name), "--server", url)
        return [sys.executable, "-m", "phyagentos", "fleet", verb, *place, *options]

    def find_leader(self, *, steps_down: bool = False) -> str:
        """The server that leads the claims; as it was, where it steps down."""
        import nats  # of the extra `fleet`

        subject = "$JS.API.STREAM.LEADER.STEPDOWN.KV_paos_claims" if steps_down else ""

        async def ask() -> str:
            client = await nats.connect(self._urls["hub"].split(","), connect_timeout=2)
            try:
                found = await client.request("$JS.API.STREAM.INFO.KV_paos_claims", timeout=2.0)
                if subject:
                    await client.request(subject, timeout=2.0)
                return str(json.loads(found.data)["cluster"]["leader"])
            finally:
                await client.close()

        with contextlib.suppress(nats.errors.Error, OSError, KeyError, TimeoutError):
            return asyncio.run(ask())
        return SERVERS[0]

    def shift_clock(self, name: str, *, is_off: bool) -> None:
        """Start a process anew with a clock that is off, or right again."""
        self._shifted = self._shifted | {name} if is_off else self._shifted - {name}
        self.kill(name, 0.0)

    def fill_disk(self, name: str) -> None:
        """Use up the disk of a host."""
        with contextlib.suppress(OSError), (self.folder / name / FILLER).open("wb", buffering=0) as file:
            while True:
                file.write(bytes(1 << 16))

    def empty_disk(self, name: str) -> None:
        """Let it have room again."""
        (self.folder / name / FILLER).unlink(missing_ok=True)

    def tend(self) -> None:
        """Start what does not run and may."""
        for name, command in self._commands.items():
            process = self._processes.get(name)
            if (process is None or process.poll() is not None) and self._clock.now_s() >= self._not_before_s.get(
                name, 0.0
            ):
                self._not_before_s[name] = self._clock.now_s() + 1.0
                others = {"PYTHONPATH": self._shifted_path} if name in self._shifted else {}
                self._processes[name] = subprocess.Popen(
                    command,
                    stdout=self._log,
                    stderr=self._log,
                    cwd=self.folder / "project",
                    start_new_session=True,
                    env=os.environ | others,
                )

    def pursue(self, number: int) -> None:
        """Let an agent pursue the goal of a case; None of an earlier one is left."""
        options = ["--seed", str(number), "--goal", f"chaos-{number}", "--memory", "none", "--trust-python"]
        command = [
            sys.executable,
            "-m",
            "phyagentos",
            "agent",
            str(self.graph),
            "--workspace",
            str(self.folder / "hub"),
        ]
        self._commands["agent"] = [*command, *options]
        self._not_before_s["agent"] = 0.0

    def dismiss_agent(self) -> None:
        """Its goal is over."""
        self._commands.pop("agent", None)
        if (process := self._processes.pop("agent", None)) is not None:
            process.terminate()
            process.wait()

    def kill(self, name: str, rest_s: float, *, alone: bool = False) -> None:
        """`kill -9` a process, unless `alone` with everything that has its folder open; it rests for a while."""
        self._not_before_s[name] = self._clock.now_s() + rest_s
        for pid in [self._processes[name].pid, *([] if alone else self.find_processes(name))]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def send(self, name: str, number: signal.Signals) -> None:
        """A signal to the process itself."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._processes[name].pid, number)

    def find_processes(self, name: str) -> list[int]:
        """Every process that names the folder of a host or the hub, agents left out."""
        if name not in self.links:
            return []
        found = []
        for place in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                line = (place / "cmdline").read_bytes()
                if f"{self.folder / name}\0".encode() in line and b"\0agent\0" not in line:
                    found.append(int(place.name))
        return found

    def read(self, name: str, lane: str = "") -> tuple[Ledger, list[Record]]:
        """The journal of a host or the hub, or the replica of a lane that the hub has."""
        root = self.folder / name / "fleet" / lane if lane else self.folder / name
        ledger, records = Ledger(forgets=False), list[Record]()
        for folder in (root / "sessions").glob("[!ac]*"):
            follower = Follower(folder)
            records += follower.read_new()
            follower.close()
        ledger.extend(records)
        return ledger, records

    def close(self) -> None:
        """End everything."""
        self.dismiss_agent()
        for process in self._processes.values():
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
                process.terminate()
        for name, process in self._processes.items():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20)
            self.kill(name, 1e9)
            process.wait()
        for host in self.mounted:
            subprocess.run(["umount", "-l", str(self.folder / host)], check=False)
        self._log.close()
