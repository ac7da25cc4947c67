#!/usr/bin/env python
"""Counts the hops of the three ways through a run: node to motor, camera to verdict, verdict to child.

A hop is a call from one function of `phyagentos` to another, or a message between two processes (the journal carries
messages, too). One goal with one node is run for real, with a slip, so that its first session is replanned. A probe
records the call stacks at a few waypoints on each way; between two waypoints of one process the hops are the calls
below the deepest function that is on both stacks: returning costs nothing. Messages are followed by their bytes.

The way from node to motor is that of the order. What a leaf asks of the planner beside it is a way of its own, from
question to rows; it is counted and printed, too.

    python tools/count_hops.py                   # this tree
    python tools/count_hops.py --root OTHER_TREE # another one, for instance an earlier commit

Ends with one JSON line; exit code 1 when a way is longer than asked, 2 when a waypoint was not found: functions that
were renamed are added to `NAMES`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ASKED = {"node_to_motor": 40, "camera_to_verdict": 40, "verdict_to_child": 40}

GOAL = """\
goal: one_node
objective: Put the red cube into the red tray.
scene: tabletop/cubes_and_trays
targets: {arm: panda}
defaults: {timeout_s: 600, max_replans: 2}
sessions:
  red:
    skill: pick_and_place
    target: arm
    with: {object: red_cube, destination: red_tray}
    accept: ["inside(red_cube, red_tray)"]
accept: ["inside(red_cube, red_tray)"]
"""

ROLES = {  # part of the command line -> process
    "motion.process": "planner",
    "processes world": "world",
    "assembly.worker_process": "worker",
    "phyagentos watch": "watchdog",
    "phyagentos agent": "agent",
}

NAMES = {  # waypoint -> qualified names that it has, or had
    "compile": ("SessionCompiler.compile_node",),
    "append to the journal": ("SegmentWriter.append",),
    "apply a record": ("Ledger.apply",),
    "queue": ("Queues.put",),
    "examine": ("Examiner.examine",),
    "find a path": ("find_path",),
    "time it": ("time_path",),
    "command rows": ("CommandBuffer.set_arm",),
    "guard": ("SafetyGuard.judge",),
    "expose": ("SimulatedCamera.capture",),
    "sense": ("Pipeline.sense",),
    "update the belief": ("update_belief",),
    "write what was seen": ("Recorder.write_world", "Recorder.write_terminal"),
    "read the bundle": ("Evidence.read",),
    "judge": ("SessionVerifier.judge",),
    "evaluate": ("PredicateJudge.judge",),
    "choose a repair": ("GraphRepair.choose",),
}


@dataclass(frozen=True, slots=True)
class Event:
    """A waypoint that was reached.

    Attributes:
        at: Monotonic time [ns], the same clock in every process.
        message: Hash of what was sent or received, empty at other waypoints.
        head: First bytes of it; they hold the name of the message.
        stack: Functions of the package, outermost first: number of the frame, file, qualified name.
    """

    at: int
    process: int
    role: str
    name: str
    stack: tuple[tuple[int, str, str], ...]
    message: str = ""
    head: str = ""


@dataclass(frozen=True, slots=True)
class Hop:
    """One step of a way, as it is printed."""

    role: str
    file: str
    name: str


class WaypointMissing(Exception):
    """A way has no event where its next waypoint is looked for."""


class Run:
    """Everything that the probe recorded, by time."""

    def __init__(self, folder: Path) -> None:
        self.events = sorted((event for file in folder.glob("*.jsonl") for event in _read(file)), key=lambda e: e.at)

    def find_call(self, waypoint: str, role: str, after: int, before: int | None = None) -> Event:
        """The first time that a waypoint is called after one moment; the last time before another one."""
        found = [e for e in self.events if e.role == role and e.name in NAMES[waypoint] and e.at > after]
        if before is not None:
            found = [event for event in found if event.at < before][-1:]
        if not found:
            raise WaypointMissing(f"{waypoint!r} in the {role}: none of {', '.join(NAMES[waypoint])} was called")
        return found[0]

    def iter_sent(self, tag: str, role: str, to: str) -> Iterator[tuple[Event, Event]]:
        """Messages of a kind from one process to another, in order: what was sent, and its receipt."""
        receipts = [event for event in self.events if event.name == "Connection._recv_bytes" and event.role == to]
        for sent in self.events:
            if sent.name == "Connection._send_bytes" and sent.role == role and tag in ("", _read_tag(sent.head)):
                same = (
                    e for e in receipts if e.message == sent.message and e.at > sent.at
                )  # a question may come twice
                if (receipt := next(same, None)) is not None:
                    yield sent, receipt

    def find_sent(self, tag: str, role: str, to: str, after: int) -> tuple[Event, Event]:
        """The first message of this kind after a moment."""
        for sent, receipt in self.iter_sent(tag, role, to):
            if sent.at > after:
                return sent, receipt
        raise WaypointMissing(f"message {tag!r} from the {role} to the {to}")

    def find_orders(self) -> list[tuple[Event, Event]]:
        """Messages between watchdog and worker about a session, by time."""
        pairs = [*self.iter_sent("", "watchdog", "worker"), *self.iter_sent("", "worker", "watchdog")]
        pairs = [pair for pair in pairs if _read_tag(pair[0].head) not in {"", "Ready", "Renew"}]
        return sorted(pairs, key=lambda pair: pair[0].at)


class ApproachCandidate:
    """Grows waypoint by waypoint and keeps the hops between them.

    Args:
        run: What was recorded.
        first: Where it begins.
        loop: Class of the function from which the calls to `first` are counted; none of them is when empty.
    """

    def __init__(self, run: Run, first: Event, loop: str = "") -> None:
        self._run, self._last = run, first
        self.hops: list[Hop] = []
        if loop:
            start = next(i for i, (_, _, name) in enumerate(first.stack) if name.startswith(f"{loop}."))
            self._add(first, start + 1)

    @property
    def now(self) -> int:
        """When the latest waypoint was reached."""
        return self._last.at

    def call(self, waypoint: str, role: str, before: int | None = None) -> None:
        """Go on to a function of the same process, or of the one that follows the journal."""
        self._walk(self._run.find_call(waypoint, role, self.now, before))

    def send(self, tag: str, role: str, to: str) -> None:
        """Go on by a message."""
        sent, receipt = self._run.find_sent(tag, role, to, self.now)
        self._walk(sent)
        self.cross(receipt, f"message {tag}")

    def follow(self, role: str) -> None:
        """Go on by the journal: what was written is read by another process."""
        record = self._run.find_call("apply a record", role, self.now)
        self.cross(record, "record of the journal")

    def be_ordered(self) -> None:
        """Go on by every message between watchdog and worker, until rows are commanded.

        The session is examined after the first one, and its start recorded before the last one. Of several in a row to
        the same process the last one counts.
        """
        end = self._run.find_call("command rows", "worker", self.now).at
        pairs = [pair for pair in self._run.find_orders() if self.now < pair[0].at < end]
        following = [*pairs[1:], None]
        kept = [
            pair for pair, after in zip(pairs, following, strict=True) if not after or after[0].role != pair[0].role
        ]
        for number, (sent, receipt) in enumerate(kept):
            if number == len(kept) - 1 and sent.role == "watchdog":
                self.call("append to the journal", "watchdog")
            self._walk(sent)
            self.cross(receipt, f"message {_read_tag(sent.head)}")
            if number == 0 and receipt.role == "worker":
                self.call("examine", "worker")

    def step(self) -> None:
        """Go on to the motors."""
        for event in self._run.events:
            if event.name == "mj_step" and event.process == self._last.process and event.at > self.now:
                return self._walk(event)
        raise WaypointMissing("no physics step after the command")

    def _walk(self, event: Event) -> None:
        if event.process != self._last.process:
            raise WaypointMissing(f"{event.name} was called in another process than {self._last.name}")
        common = 0
        for ours, theirs in zip(self._last.stack, event.stack, strict=False):
            if ours[0] != theirs[0]:
                break
            common += 1
        self._add(event, common)

    def cross(self, event: Event, what: str) -> None:
        """Go on in the process that has received something."""
        self.hops.append(Hop(event.role, "", what))
        self._last = event

    def _add(self, event: Event, first: int) -> None:
        self.hops += [Hop(event.role, file, name) for _, file, name in event.stack[first:]]
        self._last = event


def _read(file: Path) -> Iterator[Event]:
    lines = file.read_text(encoding="utf-8").splitlines()
    command = " ".join(json.loads(lines[0])["command"])
    role = next((role for part, role in ROLES.items() if part in command), "other")
    for line in lines[1:]:
        told = json.loads(line)
        stack = tuple((number, name, function) for number, name, function in told.pop("stack"))
        yield Event(process=int(file.stem), role=role, stack=stack, **told)


def walk_node_to_motor(run: Run) -> ApproachCandidate:
    """From the loop of the mission to the first physics step of the first planned motion."""
    way = ApproachCandidate(run, run.find_call("compile", "agent", 0), loop="Mission")
    way.call("append to the journal", "agent")
    way.follow("watchdog")
    way.call("queue", "watchdog")
    way.be_ordered()
    way.call("command rows", "worker")
    way.call("guard", "worker")
    way.send("Command", "worker", "world")
    way.step()
    return way


def walk_question_to_rows(run: Run) -> ApproachCandidate:
    """From a leaf that asks for its first motion to the rows that it commands."""
    sent, receipt = run.find_sent("PlanMove", "worker", "planner", 0)
    way = ApproachCandidate(run, sent, loop="Leaf")
    way.cross(receipt, "message PlanMove")
    way.call("find a path", "planner")
    way.call("time it", "planner")
    way.send("Motion", "planner", "worker")
    way.call("command rows", "worker")
    return way


def walk_camera_to_verdict(run: Run) -> ApproachCandidate:
    """From the loop of the worker to the last picture of the first session, and on to its verdict in the journal."""
    finished, _ = run.find_sent("Finished", "worker", "watchdog", 0)
    asked = [pair for pair in run.iter_sent("Capture", "worker", "world") if pair[0].at < finished.at]
    if not asked:
        raise WaypointMissing("no picture was asked for before the end of the first session")
    way = ApproachCandidate(run, asked[-1][0], loop="WorkerLoop")
    way.cross(asked[-1][1], "message Capture")
    way.call("expose", "world")
    way.send("Frames", "world", "worker")
    way.call("sense", "worker")
    way.call("update the belief", "worker")
    way.call("write what was seen", "worker")
    way.send("Finished", "worker", "watchdog")
    way.call("append to the journal", "watchdog")
    way.follow("agent")
    way.call("read the bundle", "agent")
    way.call("judge", "agent")
    way.call("evaluate", "agent")
    way.call("append to the journal", "agent")
    return way


def walk_verdict_to_child(run: Run) -> ApproachCandidate:
    """From the judgement of the first session to its child in the journal."""
    chosen = run.find_call("choose a repair", "agent", 0)
    way = ApproachCandidate(run, run.find_call("judge", "agent", 0, before=chosen.at))
    way.call("choose a repair", "agent")
    way.call("compile", "agent")
    way.call("append to the journal", "agent")
    return way


WAYS = {
    "node_to_motor": walk_node_to_motor,
    "camera_to_verdict": walk_camera_to_verdict,
    "verdict_to_child": walk_verdict_to_child,
    "question_to_rows": walk_question_to_rows,
}


def record(root: Path, folder: Path) -> Run:
    """Run the goal with the code of `root` under the probe."""
    (folder / "goal_graphs").mkdir()
    (folder / "hops").mkdir()
    graph = folder / "goal_graphs" / "one_node.yaml"
    graph.write_text(GOAL, encoding="utf-8")
    probe = Path(__file__).resolve().parent / "hop_probe"
    environment = os.environ | {
        "PYTHONPATH": f"{probe}{os.pathsep}{root}",
        "PHYAGENTOS_FORK_SERVER": str(folder / "none"),  # the probe is loaded by each interpreter
        "HOPS_PACKAGE": str(root / "phyagentos"),
        "HOPS_OUT": str(folder / "hops"),
        "HOPS_CALLS": ",".join(name for names in NAMES.values() for name in names),
    }
    command = [sys.executable, "-m", "phyagentos", "run", str(graph), "--workspace", str(folder / "workspace")]
    command += ["--seed", "7", "--faults", str(root / "faults" / "slip.yaml"), "--no-pictures", "--quiet"]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"the run ended with code {done.returncode}:\n{done.stdout}{done.stderr}")
    return Run(folder / "hops")


def print_way(title: str, way: ApproachCandidate) -> None:
    """One line a hop: process, file, function."""
    print(f"{title}: {len(way.hops)} hops")
    for number, hop in enumerate(way.hops, 1):
        print(f"  {number:3}  {hop.role:9}  {hop.file or '->':45}  {hop.name}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run, walk, print; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1], help="tree to measure")
    parser.add_argument("--quiet", action="store_true", help="only the figures")
    given = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="paos-hops-") as folder:
        run = record(given.root.resolve(), Path(folder))
    figures: dict[str, int] = {}
    missing = []
    for title, walk in WAYS.items():
        try:
            way = walk(run)
        except WaypointMissing as error:
            missing.append(f"{title}: {error}")
            continue
        figures[title] = len(way.hops)
        if not given.quiet:
            print_way(title, way)
    kinds = dict.fromkeys(_read_tag(sent.head) for sent, _ in run.find_orders())
    print(f"messages between watchdog and worker: {', '.join(kinds)}")
    if missing:
        print("\n".join(missing), file=sys.stderr)
        return 2
    holds = all(figures[title] <= most for title, most in ASKED.items())
    print(json.dumps({"figures": figures, "asked": {t: f"<= {most}" for t, most in ASKED.items()}, "holds": holds}))
    return 0 if holds else 1


def _read_tag(head: str) -> str:
    """Name of a message: the value of its field `type`, a short string of msgpack, which msgspec writes first."""
    value = head.partition("\xa4type")[2]
    return value[1 : 1 + (ord(value[0]) & 0x1F)] if value else ""


if __name__ == "__main__":
    sys.exit(main())
