"""One goal from its request to its verdict: proposed, decided on, followed in the journal, cancelled.

What decides on it is what decides on the proposals of every other program: a person, a policy file of the operator, or
the operator's list of goals that may be called. Nothing of ROS is imported here.
"""

import queue
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ros2_goals.framework import Framework, Gone, Record, Refused
from ros2_goals.processes import end

CANCEL, TURN = object(), object()  # what a queue of events holds beside records
_FINAL = {"succeeded", "failed", "replanned", "unverified", "rejected", "cancelled"}  # states of a session
_LOOK_S = 1.0  # between two looks at what no record says: a denial, a process that ended
_TRIES = 3  # to reach the tools, which are started anew
_END_S = 30.0  # for a run to end after the verdict, then it is ended


@dataclass(frozen=True)
class Request:
    """A goal as it is called; `graph` is a name or YAML, or else `words` say in `scene` what is wanted."""

    graph: str = ""
    words: str = ""
    scene: str = ""
    parameters: Sequence[str] = ()
    seed: int = 0

    def parse_parameters(self) -> dict[str, str]:
        """By name; raises `Refused`."""
        pairs = [each.partition("=") for each in self.parameters]
        if wrong := [name for name, equals, _ in pairs if not (name and equals)]:
            raise Refused(f"parameters: found {', '.join(map(repr, wrong))}; expected KEY=VALUE")
        return {name: value for name, _, value in pairs}


@dataclass(frozen=True)
class Rules:
    """What decides on goals that are called.

    Attributes:
        permitted: Names of goal graphs of the library that run without a further decision.
        policy: A policy file that decides at level `submit`; where it is None, another process decides.
    """

    permitted: frozenset[str] = frozenset()
    policy: Path | None = None


@dataclass(frozen=True)
class Progress:
    """A record of the journal about a goal, as it is shown to a caller."""

    at: str
    node: str
    session: str
    event: str
    state: str
    verdict: str


@dataclass(frozen=True)
class Outcome:
    """How a goal ended; the verdict is empty where nothing was decided."""

    goal: str = ""
    verdict: str = ""
    reason: str = ""
    failed_criteria: Sequence[str] = ()
    causes: Sequence[str] = ()
    evidence: Sequence[str] = ()


@dataclass
class Pursuit:
    """One goal that is called; `events` takes records, `TURN` once it is the first in the line, and `CANCEL`."""

    framework: Framework
    rules: Rules
    request: Request
    show: Callable[[Progress], object]
    events: "queue.SimpleQueue[Any]" = field(default_factory=queue.SimpleQueue)
    name: str = ""
    has_begun: bool = False
    is_cancelled: bool = False
    _is_over: bool = False
    _is_concluded: bool = False
    _child: "subprocess.Popen[str] | None" = None
    _live: set[str] = field(default_factory=set)
    _printed: Any = None

    def carry_out(self) -> Outcome:
        """Wait for its turn, propose it, follow it to its end; a refusal is an outcome too."""
        while (event := self.events.get()) is not TURN:
            if event is CANCEL:
                return Outcome(verdict="cancelled", reason="cancelled while it waited for its turn")
        with tempfile.TemporaryFile("w+", encoding="utf-8") as self._printed:
            try:
                self._propose()
                outcome = self._follow()
                self._is_concluded = True
            except Refused as error:
                outcome = Outcome(self.name, reason=str(error))
            finally:
                self._clear_up()
        return outcome

    def _clear_up(self) -> None:
        """Leave nothing that moves for a caller that is answered."""
        if self.name and not self._is_concluded:
            with suppress(Refused):
                self._cancel()
        if self._child is None or not self.has_begun:  # one without this goal ends by itself, or serves others
            return
        try:
            self._child.wait(_END_S)
        except subprocess.TimeoutExpired:
            end(self._child, _END_S)

    def _propose(self) -> None:
        """Propose it to whom the rules name, and start what decides where that is a process of this node."""
        graph, is_grounded = self.request.graph, True
        if self.request.words:
            graph, is_grounded = understand(self.framework, self.request)
        overrides = self.request.parse_parameters()
        is_permitted = graph in self.rules.permitted and not any(each.startswith("targets.") for each in overrides)
        by_policy = self.framework.level == "submit" and is_grounded and not is_permitted
        propose, seed, why = "submit" if by_policy else "propose", self.request.seed, "called as a ROS 2 action"
        done = self.framework.tools.call(propose, graph=graph, overrides=overrides, seed=seed, reason=why)
        self.name = done["proposal"]
        pipes = {"stderr": self._printed}
        if is_permitted:
            why = "in the list of goals that may be called as an action"
            self._child = self.framework.start("approve", self.name, "--yes", "--reason", why, **pipes)
        elif by_policy and self.rules.policy is not None:
            self._child = self.framework.start("approve", "--policy", str(self.rules.policy), "--once-idle", **pipes)

    def _follow(self) -> Outcome:
        while not (self._is_over and not self._live):
            try:
                event = self.events.get(timeout=_LOOK_S)
            except queue.Empty:
                if (outcome := self._look()) is not None:
                    return outcome
                continue
            if event is CANCEL:
                self.is_cancelled = True
                self._cancel()
            elif event is not TURN:
                self._take(event)
        return self._conclude(self._ask()["report"])

    def _take(self, record: Record) -> None:
        """A record of the journal: shown where it is about this goal."""
        id, event, to = record["id"], record["ev"], record["to"]
        kind, _, rest = id.rpartition(":")
        if kind == "goal" and rest == self.name:
            node, session, state = "", "", event.removeprefix("goal_")
            self.has_begun = True
            self._is_over |= event in {"goal_verdict", "goal_cancelled"}
        elif kind == "node" and rest.startswith(f"{self.name}/"):
            node, session, state = rest.removeprefix(f"{self.name}/"), "", event.removeprefix("node_")
        elif not kind and id.startswith(f"{self.name}."):
            node, session, state = id.removeprefix(f"{self.name}.").partition(".")[0], id, to
            (self._live.discard if to in _FINAL else self._live.add)(id)
        else:
            return
        judged = record["body"].get("attempt")  # of a session that is repeated: a number
        verdict = judged["verdict"] if isinstance(judged, dict) else record["body"].get("verdict", "")
        self.show(Progress(record["at"], node, session, event, state, verdict))
        if event == "goal_submitted" and self.is_cancelled:
            self._cancel()

    def _cancel(self) -> None:
        """End it: the goal with its sessions, or what would begin it, or the proposal."""
        if self.has_begun:
            try:
                self.framework.stop("cancel", subject=self.name, reason="requested by the caller of the action")
            except Refused:
                if self._child is not None:  # the tools are gone or the goal is over; this ends it in either case
                    self._child.terminate()
            return
        denied = self.framework.run("deny", self.name, "--reason", "cancelled by the caller of the action")
        if "error" in denied and self._child is not None:  # it is approved, and may begin; its first record ends it too
            self._child.terminate()

    def _look(self) -> Outcome | None:
        """What no record says: a denial, a run that ended, and the verdict where the journal is no longer followed."""
        ended = self._child.poll() if self._child is not None else None
        try:
            found = self._ask()
        except Gone:
            found = {"state": "unknown"}
        if found["state"] == "denied":
            verdict = "cancelled" if self.is_cancelled else ""
            return Outcome(self.name, verdict, f"denied: {found['decision']['reason']}")
        if report := found.get("report"):
            self.has_begun = True
            if found["is_over"] and all(each["state"] in _FINAL for each in report["sessions"]):
                return self._conclude(report)
        if ended is None or self._is_over:
            return None
        if self.has_begun:  # nothing pursues it any more
            with suppress(Refused):
                self.framework.stop("cancel", subject=self.name, reason="its run ended without a verdict")
        verdict, why = ("cancelled", "cancelled before it began") if self.is_cancelled else ("", self._read_printed())
        return Outcome(self.name, verdict, f"its run ended with code {ended}: {why}")

    def _ask(self) -> Record:
        """How it stands; raises `Refused`."""
        for _ in range(_TRIES):
            with suppress(Gone):
                return self.framework.tools.call("wait", id=self.name, timeout_s=0.0)
        raise Gone(f"{self.name}: the tools of {self.framework.root} do not answer")

    def _read_printed(self) -> str:
        self._printed.seek(0)
        return " | ".join(self._printed.read().splitlines()[-3:])

    def _conclude(self, report: Record) -> Outcome:
        """The outcome that a report shows."""
        folders = [self.framework.root / "evidence" / each["id"] for each in report["sessions"]]
        return Outcome(
            self.name,
            report["verdict"],
            report["reason"],
            [*dict.fromkeys(_iter_failed(report))],
            [f"{each['id']} {each['cause']} {each['reason']}" for each in report["sessions"] if each["cause"]],
            [str(each) for each in folders if each.is_dir()],
        )


def _iter_failed(report: Record) -> Iterator[str]:
    """Criteria of the goal that do not hold; where none was judged, those of the last session of each node."""
    last = {each["node"]: each for each in report["sessions"]}
    for each in report["criteria"] or [each for session in last.values() for each in session["criteria"]]:
        if each["truth"] != "true":
            yield f"{each['text']}: {each['truth']}, {each['because']}"


def understand(framework: Framework, request: Request) -> tuple[str, bool]:
    """The goal graph of a request in words as YAML, and whether words of the request name it; raises `Refused`."""
    scene = ["--scene", request.scene] if request.scene else []
    found = framework.run("ask", request.words, "--seed", str(request.seed), *scene)
    if found.get("graph"):
        return Path(found["graph"]).read_text(encoding="utf-8"), bool(found["is_grounded"])
    unclear = [
        f"{each['words']!r} ({each['kind']}: {', '.join(each.get('candidates') or each.get('possible') or ['?'])})"
        for each in (*found.get("questions", ()), *found.get("lacks", ()))
    ]
    why = found.get("error") or found.get("answer") or f"unclear: {', '.join(unclear) or found}"
    raise Refused(f"{request.words!r} is no goal here; {why}. Possible: {', '.join(found.get('examples', ()))}")


class Line:
    """The goals that wait for their turn, in the order in which they came; the first one runs."""

    def __init__(self) -> None:
        self._line: list[Pursuit] = []
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._line)

    def enter(self, pursuit: Pursuit) -> None:
        """Join it at its end."""
        with self._lock:
            self._line.append(pursuit)
            if len(self._line) == 1:
                pursuit.events.put(TURN)

    def leave(self, pursuit: Pursuit) -> None:
        """Leave it; the next one has its turn where the first one left."""
        with self._lock:
            was_first = self._line[0] is pursuit
            self._line.remove(pursuit)
            if was_first and self._line:
                self._line[0].events.put(TURN)

    def put(self, event: object) -> None:
        """Hand a record to the goal that runs, or `CANCEL` to all."""
        with self._lock:
            for each in self._line if event is CANCEL else self._line[:1]:
                each.events.put(event)

    def find_present(self) -> Pursuit | None:
        """The goal that runs."""
        with self._lock:
            return self._line[0] if self._line else None
