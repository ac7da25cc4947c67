"""Sessions without work: what the fleet itself costs, from the submission to the claim and from end to end.

    python -m benchmarks.fleet_parts.noop ROOT URL NAME    # one simulated host, until its input ends

Host and hub are those of `paos fleet`; a runtime that does nothing stands for each watchdog, and an agent that accepts
everything for the agent plane. Each host has one target, and one session at a time waits for it or runs: the time to
the claim is no time in a queue. Without a host the same agent and runtime share one workspace.

What a session and a heartbeat cost the server and the hub is measured beside it, and multiplied: what many robots need.
"""

import contextlib
import datetime
import math
import os
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.fleet_parts.stage import choose_port
from benchmarks.runner import show
from phyagentos.clock import SystemClock
from phyagentos.fleet.bus import Bucket, Bus
from phyagentos.fleet.host import BY, FleetHost
from phyagentos.fleet.hub import FleetHub
from phyagentos.fleet.server_settings import ALL
from phyagentos.operations.fleet import open_bus, prepare_server, take_turns
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import Latch, is_latched
from phyagentos.protocol.sessions.lifecycle import SessionState, Side
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.records import Record
from phyagentos.store.watch import Watch
from phyagentos.testing import make_contract

LIMIT_S, STOP_LIMIT_S = 1500.0, 10.0
IDLE_S = 10.0  # for what heartbeats alone cost
ROBOTS, SESSIONS_PER_H = 1000, 20.0  # what is computed on paper, one target a host
ATTEMPT = {"attempt": msgspec.to_builtins(Attempt(verdict=Verdict.SUCCESS, criteria=()))}


class Runtime:
    """Carries out what waits, without doing anything."""

    def __init__(self, workspace: Workspace, partition: str) -> None:
        self._workspace = workspace
        self._journal = Journal(
            workspace.root, side=Side.RUNTIME, by="runtime", clock=SystemClock(), partition=partition
        )
        self.folder = self._journal.folder

    def turn(self) -> bool:
        """Claim and finish; whether there was anything to do."""
        new = [each for each in self._journal.read_new() if each.ev == "submit"]
        for record in new:
            id = record.id
            done = Execution(ended=Ended.COMPLETED, evidence=f"evidence/{id}")
            self._journal.commit([Entry(id, "claim"), Entry(id, "check", None, 1), Entry(id, "start", None, 1)])
            (folder := self._workspace.evidence / id).mkdir()
            (folder / "execution.json").write_bytes(msgspec.json.encode(done))
            body = {"execution": msgspec.to_builtins(done)}
            self._journal.commit([Entry(id, "halt", None, 1), Entry(id, "finish", body, 1)], durable=False)
        return bool(new)


class Agent:
    """Submits a session to each target that has none, and accepts what is finished."""

    def __init__(self, workspace: Workspace, partition: str, targets: list[str], sessions: int) -> None:
        self.journal = Journal(workspace.root, side=Side.AGENT, by="agent", clock=SystemClock(), partition=partition)
        self._targets, self._left = dict.fromkeys(targets, ""), sessions
        self._open = 0

    def turn(self) -> bool:
        """One look; whether it goes on."""
        entries = []
        for record in self.journal.read_new():
            if record.to == SessionState.AWAITING_VERIFICATION:
                entries += [Entry(record.id, "verify"), Entry(record.id, "accept", ATTEMPT)]
                self._targets[record.id.split(".")[1].partition("-")[0]] = ""
                self._open -= 1
        for target in [name for name, id in self._targets.items() if not id][: self._left]:
            contract = make_contract(id=f"noop.{target}-{self._left}", goal="noop", target=target)
            entries.append(Entry(contract.id, "submit", dict(msgspec.to_builtins(contract))))
            self._targets[target] = contract.id
            self._left, self._open = self._left - 1, self._open + 1
        self.journal.commit(entries)
        return bool(self._left or self._open)

    def run(self) -> None:
        """Until every session has its verdict."""
        with Watch([self.journal.folder]) as watch:
            while self.turn():
                watch.drain()
                watch.wait(0.1) if not self.turn() else None


def run_host(root: Path, url: str, name: str) -> None:
    """One simulated host, until standard input ends."""
    workspace, ends = Workspace.create(root, Library(())), threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ends.set()), daemon=True).start()
    journal = Journal(root, side=Side.AGENT, by=BY, clock=SystemClock(), partition=name)
    runtime = Runtime(workspace, name)
    with open_bus(url, name, name, (name,)) as bus:
        host = FleetHost(workspace, journal, bus, SystemClock(), {name: ("pick_and_place",)})
        take_turns(lambda: host.turn() | runtime.turn(), bus, journal.folder, ends)


class Cost(NamedTuple):
    """What has been used up so far: messages to and from the server, bytes that it stores, CPU of both [s]."""

    messages: float
    stored: float
    server_s: float
    hub_s: float

    def since(self, before: "Cost", per: float) -> "Cost":
        """The share of one."""
        return Cost(*((now - then) / per for now, then in zip(self, before, strict=True)))


class Server(NamedTuple):
    """A running server, whose monitor tells what it does."""

    url: str
    monitor: int
    pid: int

    def read(self) -> Cost:
        """As of now; the hub is this process, and the agent with it."""
        traffic, stored = (self._ask(each) for each in ("varz", "jsz"))
        clock = os.sysconf("SC_CLK_TCK")
        times = Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[11:13]
        messages = traffic["in_msgs"] + traffic["out_msgs"]
        return Cost(messages, stored["bytes"], sum(map(int, times)) / clock, time.process_time())

    def _ask(self, what: str) -> dict[str, float]:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.monitor}/{what}", timeout=10) as answer:
            found: dict[str, float] = msgspec.json.decode(answer.read())
        return found


@contextlib.contextmanager
def open_fleet(folder: Path, hosts: list[str]) -> Iterator[Server]:
    """A server and hosts in processes of their own."""
    prepared, monitor = prepare_server(folder / "server", f"127.0.0.1:{choose_port()}"), choose_port()
    module = [sys.executable, "-m", "benchmarks.fleet_parts.noop"]
    with contextlib.ExitStack() as stack, (folder / "log").open("ab") as log:
        server = stack.enter_context(subprocess.Popen([*prepared.command, "-m", str(monitor)], stderr=log))
        stack.callback(server.terminate)
        for name in hosts:
            arguments = [*module, str(folder / name), prepared.urls[ALL], name]
            host = stack.enter_context(subprocess.Popen(arguments, stdin=subprocess.PIPE, stderr=log))
            stack.callback(host.stdin.close)
        yield Server(prepared.urls[ALL], monitor, server.pid)


def time_stop(folder: Path, hosts: list[str], bus: Bus) -> float:
    """From the operator's stop to the latch on the disk of the last host [ms]."""
    clock, left = SystemClock(), {Workspace(folder / name).signals.parent for name in hosts}
    begun_s = clock.now_s()
    bus.put(Bucket.STOPS, "stop", msgspec.json.encode(Latch(by="benchmark", at=clock.wall_iso())))
    while left and clock.now_s() - begun_s < STOP_LIMIT_S:
        left -= {each for each in left if is_latched(each)}
    return 1e3 * (clock.now_s() - begun_s) if not left else math.inf


class Timed(NamedTuple):
    """Every record of the hub's lane, and of the hosts' as the hub has them; the stop of all [ms]; what one costs."""

    records: list[Record]
    stop_ms: float
    session: Cost
    heartbeat: Cost


def time_fleet(folder: Path, sessions: int, hosts: list[str], idle_s: float = 0.0) -> Timed:
    """Sessions on these hosts, after they have stood idle for some time."""
    workspace, ends = Workspace.create(folder / "hub", Library(())), threading.Event()
    agent = Agent(workspace, "hub", hosts, sessions)
    journal = Journal(workspace.root, side=Side.RUNTIME, by=BY, clock=SystemClock(), partition="hub")
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(open_fleet(folder, hosts))
        bus = stack.enter_context(open_bus(server.url, "hub"))
        hub = stack.enter_context(contextlib.closing(FleetHub(workspace, journal, bus, SystemClock())))
        stack.callback(journal.close)
        stack.callback(agent.journal.close)
        leading = threading.Thread(target=lambda: take_turns(hub.turn, bus, journal.folder, ends))
        leading.start()
        clock, begun_s = SystemClock(), SystemClock().now_s()
        while len(bus.view(Bucket.HOSTS)) < len(hosts) and clock.now_s() - begun_s < LIMIT_S:
            clock.sleep(0.2)
        clock.sleep(2.0)
        rested = server.read()
        clock.sleep(idle_s)
        begun, begun_s = server.read(), clock.now_s()
        beat = begun.since(rested, max(1.0, idle_s * len(hosts)))
        agent.run()
        beats = (clock.now_s() - begun_s) * len(hosts)
        session = Cost(
            *(
                total - beats / sessions * each
                for total, each in zip(server.read().since(begun, sessions), beat, strict=True)
            )
        )
        ends.set()
        leading.join()
        records = [*read(journal.folder), *(each for name in hosts for each in read_replica(hub, name))]
        return Timed(records, time_stop(folder, hosts, bus), session, beat)


def time_alone(folder: Path, sessions: int) -> list[Record]:
    """The same agent and runtime over one workspace, without a fleet."""
    workspace, ends = Workspace.create(folder / "alone", Library(())), threading.Event()
    agent, runtime = Agent(workspace, "alone", ["alone"], sessions), Runtime(workspace, "alone")

    def serve() -> None:
        with Watch([runtime.folder]) as watch:
            while not ends.is_set():
                watch.drain()
                if not runtime.turn():
                    watch.wait(0.1)

    serving = threading.Thread(target=serve)
    serving.start()
    agent.run()
    ends.set()
    serving.join()
    return read(runtime.folder)


def read(folder: Path) -> list[Record]:
    """Every record of a partition."""
    follower = Follower(folder)
    records = follower.read_new()
    follower.close()
    return records


def read_replica(hub: FleetHub, lane: str) -> list[Record]:
    """Every record of a lane as the hub has it."""
    return read(hub.get_replica_root(lane) / "sessions" / lane)


def sum_up(records: list[Record], sessions: int) -> tuple[float, float, float]:
    """Sessions a second, and median and 99th percentile from the submission to the claim of its host [ms]."""

    def find(event: str) -> dict[str, float]:
        found: dict[str, float] = {}
        for each in records:  # of a fleet the hub stands before its hosts
            if each.ev == event and not (event == "submit" and each.id in found):
                found[each.id] = datetime.datetime.fromisoformat(each.at).timestamp()
        return found

    submitted, claimed, accepted = find("submit"), find("claim"), find("accept")
    if len(accepted) < sessions:
        return math.nan, math.nan, math.nan
    waits_ms = [1e3 * (claimed[id] - submitted[id]) for id in submitted]
    return (
        sessions / (max(accepted.values()) - min(submitted.values())),
        float(np.percentile(waits_ms, 50)),
        float(np.percentile(waits_ms, 99)),
    )


def compute_on_paper(timed: Timed, sessions: int) -> dict[str, float]:
    """Constants as measured, of a session and a heartbeat, and what `ROBOTS` hosts of one target need by them.

    A session without work has next to no evidence, so that storage is what the fleet itself adds. Of what grows, the
    CPU of the hub, which is one thread, and of the server, which has several, decide what is too slow first.
    """
    session, beat = timed.session, timed.heartbeat
    in_lanes = sum(each.id.startswith("noop.") for each in timed.records) / sessions
    rate = SESSIONS_PER_H / 3600.0  # of one robot [1/s]
    hub, server = (beat[at] + rate * session[at] for at in (3, 2))
    figures = {f"{name}_per_session": value for name, value in session._asdict().items()}
    figures |= {f"{name}_per_heartbeat": value for name, value in beat._asdict().items()}
    figures |= {
        "records_per_session": in_lanes,
        "paper_robots": float(ROBOTS),
        "paper_sessions_per_h": SESSIONS_PER_H,
        "paper_streams": float(2 * ROBOTS + len(Bucket)),
        "paper_messages_per_s": ROBOTS * (beat.messages + rate * session.messages),
        "paper_stored_gb_per_day": 86400.0 * ROBOTS * rate * session.stored / 1e9,
        "paper_hub_cores": ROBOTS * hub,
        "paper_server_cores": ROBOTS * server,
        "paper_robots_of_one_hub": 1.0 / hub,
        "paper_robots_of_a_server_core": 1.0 / server,
    }
    return figures


def measure_noop(folder: Path, sessions: int, hosts: int) -> dict[str, float]:
    """Without a fleet, on one host and on all of them."""
    figures, rows = {}, []
    for name, count in (("alone", 0), ("one_host", 1), ("hosts", hosts)):
        place = folder / name
        place.mkdir()
        some = sessions if count != 1 else max(1, sessions // max(1, hosts))
        names = [f"t{n}" for n in range(count)]
        if count:
            timed = time_fleet(place, some, names, IDLE_S if count == hosts else 0.0)
            records, stop_ms = timed.records, timed.stop_ms
            figures |= compute_on_paper(timed, some) if count == hosts else {}
        else:
            records, stop_ms = time_alone(place, some), 0.0
        rate, median_ms, p99_ms = sum_up(records, some)
        figures |= {f"noop_per_s_{name}": rate, f"claim_ms_{name}": median_ms, f"claim_p99_ms_{name}": p99_ms}
        figures |= {f"stop_ms_{name}": stop_ms} if count else {}
        rows.append((name, count, some, f"{rate:.1f}", f"{median_ms:.1f}", f"{p99_ms:.1f}", f"{stop_ms:.0f}"))
    show(
        "sessions without work",
        ("fleet", "hosts", "sessions", "1/s", "to the claim [ms]", "p99 [ms]", "stop of all [ms]"),
        rows,
    )
    return figures


if __name__ == "__main__":
    run_host(Path(sys.argv[1]), sys.argv[2], sys.argv[3])
