"""One goal as it ended, judged, from which every figure is computed."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml

from benchmarks.oracle.acceptance import decide, find_broken, iter_named, judge_end, open_judge
from benchmarks.oracle.feasible import find_ambiguity, find_contradiction, list_obstacles
from benchmarks.oracle.moment import read_time
from benchmarks.oracle.predicates import CLEAR
from benchmarks.worlds.cases import Case, Node
from benchmarks.worlds.faults import find_struck, is_lasting
from phyagentos.bench.records import EpisodeRecord
from phyagentos.bench.records import SessionRecord as EpisodeSession

TWINS = "looks as"
UNNAMED = re.compile(r"\bunknown_\d+\b")
LOOK_AGAIN = "EVIDENCE_MISSING"
STILL_RAD = 0.02  # joints that turn less have not been commanded anywhere


class SessionRecord(EpisodeSession, frozen=True, kw_only=True):
    """One session and what the recorded world says of it.

    Attributes:
        truth: `met`, `unmet`, or `open` where two honest judges may differ; empty without a recorded end.
        against: What decided against it, as `predicate: value in tolerances`.
        moved: Whether the arm moved.
        is_open: Whether it was unknown whether the objective was met, and a later session of the node looked or tried.
        is_clear: Whether the truth is farther from turning over than cameras may be off.
    """

    truth: str
    against: tuple[str, ...] = ()
    moved: bool = False
    is_open: bool = False
    is_clear: bool = True

    @property
    def is_judged(self) -> bool:
        """Whether a verdict stands beside a recorded end."""
        return bool(self.verdict) and self.truth != ""

    @property
    def is_clearly_met(self) -> bool:
        """Clearly met, and not one that only asked to look again."""
        return self.truth == "met" and self.is_clear and not self.is_open

    @property
    def is_false_success(self) -> bool:
        """Said to be met, and it is not."""
        return self.verdict == "success" and self.truth == "unmet"

    @property
    def is_false_failure(self) -> bool:
        """Said at last not to be met, or still not known, and it clearly is met."""
        return self.is_judged and self.verdict != "success" and self.is_clearly_met


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeRecord:
    """One node.

    Attributes:
        feasible: `yes`, `no`, or `open`: a claim that is false, or nearly so, before anything moves, or twins.
        why: What makes it infeasible.
        first: Whether its first session was judged a success and is one.
        after: Names of nodes before it.
    """

    name: str
    skill: str
    feasible: str
    why: str
    first: bool
    after: tuple[str, ...] = ()

    @property
    def is_ambiguous(self) -> bool:
        """Whether it names one of two objects that nobody could tell apart."""
        return TWINS in self.why


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalRecord:
    """One goal.

    Attributes:
        kind: `plain`, `fault` or `impossible`.
        ended: `over`, `crashed` or `hung`.
        truth: Of its own acceptance at the end of its last session, as of a session; empty where it has none.
        feasible: `yes`, `no`, or `open` where a false claim, a lasting fault or a twin spoils it.
        unstruck: Faults that never struck: the goal shows nothing about them.
        error: What a crash said.
    """

    seed: int
    kind: str
    faults: tuple[str, ...]
    ended: str
    unstruck: tuple[str, ...] = ()
    verdict: str = ""
    reason: str = ""
    truth: str = ""
    against: tuple[str, ...] = ()
    feasible: str = "yes"
    nodes: tuple[NodeRecord, ...] = ()
    sessions: tuple[SessionRecord, ...] = ()
    error: str = ""

    @property
    def blocked(self) -> frozenset[str]:
        """Nodes that were not begun, behind one that cannot be met or that claims what is false."""
        begun, blocked = {session.node for session in self.sessions}, set[str]()
        hopeless = {node.name for node in self.nodes if node.feasible != "yes"}
        for node in self.nodes:  # each stands after those that it needs
            if node.name not in begun and not (hopeless | blocked).isdisjoint(node.after):
                blocked.add(node.name)
        return frozenset(blocked)

    @property
    def is_false_success(self) -> bool:
        """Said to be met, and it is not."""
        return self.verdict == "success" and self.truth == "unmet"

    @property
    def is_met(self) -> bool:
        """Said to be met, and it is."""
        return self.verdict == "success" and self.truth != "unmet"

    @property
    def is_refused(self) -> bool:
        """An infeasible goal: no session of a node that cannot be met moved the arm, and a reason is given."""
        hopeless = {node.name for node in self.nodes if node.feasible == "no"}
        moved = any(session.moved for session in self.sessions if session.node in hopeless)
        return self.ended == "over" and self.verdict != "success" and bool(self.reason) and not moved


@dataclass(frozen=True, slots=True)
class Recorder:
    """Judges one episode that has ended from its bundles.

    Attributes:
        case: What was asked.
        run: Folder of the run.
        told: The record of the episode.
    """

    case: Case
    run: Path
    told: EpisodeRecord

    def record(self) -> GoalRecord:
        """The line of this goal."""
        sessions = mark_open([self._record_session(each) for each in self.told.sessions])
        ended = [bundle for each in self.told.sessions if has_end(bundle := self.run / each.bundle)]
        nodes = tuple(self._record_node(node, sessions, ended[:1]) for node in self.case.nodes)
        truth, against = "", tuple[str, ...]()
        if ended:
            last = max(ended, key=lambda bundle: read_time(bundle / "terminal.npz"))
            truth, against = judge_end(self.case, last, ended[0])
        return begin_record(
            self.case,
            self.told,
            truth=truth,
            against=against,
            feasible=self._weigh(nodes),
            unstruck=self._find_unstruck(),
            nodes=nodes,
            sessions=sessions,
        )

    def _weigh(self, nodes: tuple[NodeRecord, ...]) -> str:
        if any(node.feasible == "no" for node in nodes) or find_contradiction(self.case):
            return "no"
        is_spoilt = any(is_lasting(fault) for fault in self.case.faults)
        return "open" if is_spoilt or any(node.feasible == "open" for node in nodes) else "yes"

    def _find_unstruck(self) -> tuple[str, ...]:
        """Faults of the case of whose kind and body no bundle records a strike; `*` is any camera."""
        files = [self.run / each.bundle / "faults.json" for each in self.told.sessions]
        strikes = [each for file in files if file.exists() for each in json.loads(file.read_text())]
        struck = {(each["kind"], body) for each in strikes for body in ("*", each["details"].get("body"))}
        names = [(str(fault["kind"]), find_struck(fault)) for fault in self.case.faults]
        return tuple(f"{kind} {body}" for kind, body in names if (kind, body) not in struck)

    def _record_session(self, told: EpisodeSession) -> SessionRecord:
        bundle, truth, against, is_clear = self.run / told.bundle, "", tuple[str, ...](), False
        if has_end(bundle):
            judge = open_judge(self.case.room, bundle, broken=find_broken(self.case))
            asked = list_asked(bundle, told)
            truth, against = decide(judge, asked, self.case.interchangeable)
            named = iter_named(judge, asked, self.case.interchangeable)
            is_clear = max((min(values.values()) for values in named if values), default=0.0) >= CLEAR
        found = {"truth": truth, "against": against, "moved": has_moved(bundle), "is_clear": is_clear}
        return SessionRecord(**msgspec.structs.asdict(told), **found)

    def _record_node(self, node: Node, sessions: tuple[SessionRecord, ...], begun: list[Path]) -> NodeRecord:
        why = "; ".join(list_obstacles(self.case, node))
        feasible = "no" if why else "yes"
        if not why and (why := find_ambiguity(self.case, node)):
            feasible = "open"
        if node.is_claim and begun:
            judge = open_judge(self.case.room, begun[0], at="initial")
            truth, against = decide(judge, node.accept, self.case.interchangeable)
            feasible, why = (feasible, why) if truth == "met" else ("open", "; ".join(against))
        first = next((s for s in sessions if s.node == node.name and s.attempt == 0), None)
        met = first is not None and first.verdict == "success" and first.truth != "unmet"
        return NodeRecord(name=node.name, skill=node.skill, feasible=feasible, why=why, first=met, after=node.after)


def has_end(bundle: Path) -> bool:
    """Whether a session was executed, and left the state in which it ended."""
    return all((bundle / name).exists() for name in ("scene.mjb", "initial.npz", "terminal.npz"))


def list_asked(bundle: Path, told: EpisodeSession) -> list[str]:
    """What a session was to meet: by its contract, and by the verdict, which a look gives about another session too.

    `moved` of that other session counts from a beginning that this bundle does not hold, and is left out; so is what is
    said of objects without a name, whose bodies nobody can tell.
    """
    accept = yaml.safe_load((bundle / "contract.yaml").read_text())["session"].get("accept", [])
    judged = [each.text for each in told.criteria if each.kind == "accept"]
    asked = dict.fromkeys([*accept, *(text for text in judged if "moved(" not in text)])
    return [text for text in asked if not UNNAMED.search(text)]


def mark_open(sessions: list[SessionRecord]) -> tuple[SessionRecord, ...]:
    """Mark each session that asked to look again and was followed by another one of its node."""
    later: set[str] = set()
    marked = []
    for session in reversed(sessions):
        marked.append(msgspec.structs.replace(session, is_open=session.cause == LOOK_AGAIN and session.node in later))
        later |= {session.node} if session.truth else set()
    return tuple(reversed(marked))


def begin_record(case: Case, told: EpisodeRecord, **rest: Any) -> GoalRecord:
    """A record with what is known of a case, and of its episode, without a look at its bundles."""
    kind = "impossible" if case.detail else "fault" if case.faults else "plain"
    faults = tuple(f"{fault['kind']} {find_struck(fault)}" for fault in case.faults)
    known = {name: getattr(told, name) for name in ("ended", "verdict", "reason", "error")}
    return GoalRecord(seed=case.seed, kind=kind, faults=faults, **known | rest)


def has_moved(bundle: Path) -> bool:
    """Whether the arm left the posture in which a session began."""
    path = bundle / "trajectory.npz"
    if not path.exists():
        return False
    with np.load(path) as stored:
        q = stored["q_measured"]
    return bool(len(q) and np.abs(q - q[0]).max() > STILL_RAD)


def iter_findings(record: GoalRecord) -> Iterator[str]:
    """What a person should look at, in words."""
    for session in record.sessions:
        if session.is_false_success or session.is_false_failure:
            kind = "FALSE SUCCESS" if session.is_false_success else "false failure"
            told = "; ".join(session.against) or session.reason
            yield f"{kind}: seed {record.seed}, {session.id} ({session.skill}): {told}"
    if record.is_false_success:
        yield f"FALSE SUCCESS of the goal: seed {record.seed}: {'; '.join(record.against)}"
    for fault in record.unstruck:
        yield f"fault never struck: seed {record.seed}, {fault}"
    if record.ended != "over":
        yield f"{record.ended}: seed {record.seed}: {record.error[-300:]}"
