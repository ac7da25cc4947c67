"""The tools of one workspace: each calls the function behind a command, and none commands a robot.

No tool starts a session, resets a stop, decides on a proposal, or writes limits, evidence or verdicts.
"""

import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import pydantic
from msgspec.structs import asdict

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.mission.report import build_report, report_session
from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.agent.tools.registry import Answer, Level, Tool
from phyagentos.assembly.project import admit_python, get_file, parse_overrides
from phyagentos.bench.matrix import compile_suite
from phyagentos.clock import Clock
from phyagentos.errors import relocate
from phyagentos.operations import preflight, recall, stop
from phyagentos.operations.approve import as_file
from phyagentos.operations.compile import describe_graph
from phyagentos.operations.lint import lint_file
from phyagentos.operations.plan import PlannedGraph, plan
from phyagentos.operations.status import read_status
from phyagentos.operations.why import why
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.skill_runtimes import AgentCall
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.documents.schema import read_text, read_yaml
from phyagentos.protocol.sessions.agent_calls import CallFiles
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.subjects import get_session

WAIT_MAX_S = 50.0  # clients give up on a call after a minute
_WAIT_STEP_S = 0.1
_NAME = re.compile(r"[a-z][a-z0-9_]{0,79}")
_Handler = TypeVar("_Handler", bound=Callable[..., Answer])
_Text = Annotated[str, pydantic.Field(max_length=1 << 17, description="YAML, or the name of a goal graph that ships.")]
_Word = Annotated[str, pydantic.Field(max_length=250)]
_Words = Annotated[str, pydantic.Field(max_length=2000)]
_Seed = Annotated[int, pydantic.Field(ge=0, lt=2**63)]
_Seconds = Annotated[float, pydantic.Field(ge=0.0, le=WAIT_MAX_S)]
_NONE: dict[str, str] = {}
_About = "Values of the graph's parameters, and targets.ROLE."
_Overrides = Annotated[dict[str, str], pydantic.Field(max_length=100, description=_About)]


def _tool(level: Level = Level.READ, **facts: bool) -> Callable[[_Handler], _Handler]:
    """Marks a method as a tool."""

    def mark(handler: _Handler) -> _Handler:
        handler.__dict__["declared"] = (level, facts)
        return handler

    return mark


@dataclass(frozen=True, slots=True)
class WorkspaceTools:
    """The tools of the workspace at `root`; `by` names the client in what is recorded."""

    root: Path
    clock: Clock
    by: str = "mcp"
    _one_preflight: threading.Lock = field(default_factory=threading.Lock)

    def declare(self) -> tuple[Tool, ...]:
        """Every tool, whatever the level."""
        marked = [(name, each.declared) for name, each in vars(WorkspaceTools).items() if hasattr(each, "declared")]
        return tuple(Tool.of(getattr(self, name), level, **facts) for name, (level, facts) in marked)

    @_tool()
    def look(self) -> Answer:
        """What is known of the world, how the workspace stands, and the latest picture."""
        workspace = Workspace.open(self.root)
        pictures = sorted(workspace.evidence.glob(f"*/{PICTURE_AFTER}"), key=lambda path: path.lstat().st_mtime_ns)
        known = read_text(workspace.environment) if workspace.environment.exists() else ""
        return Answer({"standing": read_status(self.root), "environment": known}, tuple(pictures[-1:]))

    @_tool()
    def lint(self, text: _Text) -> Answer:
        """Check an authored file (a goal graph, a tree, a scene, faults, a suite); every problem with its place."""
        with as_file(text) as file:
            problems = lint_file(file, library=Workspace.open(self.root).library(), check_suite=compile_suite)
        return Answer({"problems": relocate(problems, file.parent)})

    @_tool()
    def plan(self, goal: _Text, seed: _Seed = 0, from_now: bool = False) -> Answer:
        """Plan a goal that says what must come true (YAML) by the effects of skills; a goal graph, or what is missing.

        It begins with the scene of that seed, or `from_now` with the world as observed last.
        """
        library, world = Workspace.open(self.root).library(), self.root if from_now else None
        with as_file(goal) as file:
            found = plan(file, seed=seed, workspace=world, library=library)
        if isinstance(found, PlannedGraph):
            return Answer(asdict(found))
        return Answer({"graph": "", "is_proven": found.is_proven, "missing": found.missing})

    @_tool()
    def compile(self, graph: _Text, overrides: _Overrides = _NONE) -> Answer:
        """The sessions that a goal graph would make; starts nothing."""
        return Answer(asdict(describe_graph(self._compile(graph, overrides)[0])))

    @_tool()
    def preflight(self, graph: _Text, overrides: _Overrides = _NONE, seed: _Seed = 0) -> Answer:
        """Check each session of a goal graph against its robot, which does not move."""
        with self._one_preflight, _as_graph(graph) as file:
            admit_python(self.root, is_trusted=False)
            texts = [f"{key}={value}" for key, value in overrides.items()]
            found = preflight.check(str(file), self.root, seed=seed, overrides=texts)
        return Answer({"fits": not found.refused, "sessions": found.sessions})

    @_tool(Level.PROPOSE)
    def propose(self, graph: _Text, reason: _Words, overrides: _Overrides = _NONE, seed: _Seed = 0) -> Answer:
        """Propose a goal. Nothing runs before a person has approved it."""
        return self._propose("person", graph, reason, overrides, seed)

    @_tool(Level.SUBMIT)
    def submit(self, graph: _Text, reason: _Words, overrides: _Overrides = _NONE, seed: _Seed = 0) -> Answer:
        """Propose a goal on which a policy of the operator decides, without a person."""
        return self._propose("policy", graph, reason, overrides, seed)

    @_tool()
    def wait(self, id: _Word, timeout_s: _Seconds = WAIT_MAX_S) -> Answer:
        """Wait for the decision on a proposal (also the id of its goal), the end of a goal or session, or your turn."""
        deadline_s = self.clock.now_s() + timeout_s
        while True:
            facts = self._describe(id)
            if facts["is_over"] or facts.get("turn") or self.clock.now_s() >= deadline_s:
                return Answer(facts)
            self.clock.sleep(_WAIT_STEP_S)

    @_tool(Level.PROPOSE)
    def step(self, session: _Word, turn: int, call: AgentCall) -> Answer:
        """Answer the turn of an approved session that you direct, as `wait` shows it; gives the next, or the end."""
        id = get_session(session, read_ledger(self.root).sessions)  # of this workspace, so no path
        given = call.model_dump(mode="json", exclude_defaults=True)
        CallFiles(Workspace.open(self.root).loops / id).answer(turn, given)
        return self.wait(id)

    @_tool()
    def why(self, subject: _Word = "") -> Answer:
        """Explain the verdict on a goal, node or session from the evidence; the latest goal without a name."""
        return Answer(asdict(why(self.root, subject)))

    @_tool()
    def recall(self, words: _Words = "") -> Answer:
        """Lessons and facts that earlier verdicts taught, about all of these words."""
        return Answer(asdict(recall.recall(self.root, words.split())))

    @_tool(is_stop=True, is_destructive=True)
    def cancel(self, subject: _Word, reason: _Words = "") -> Answer:
        """End a goal, a session or `all`: the robot is halted. It cannot be taken up again."""
        return Answer(asdict(stop.cancel(subject, self.root, reason=clean(reason), by=self.by)))

    @_tool(is_stop=True)
    def pause(self, session: _Word = "all", reason: _Words = "") -> Answer:
        """Let a session, or all, rest at the end of its present motion. Only a person lets it go on."""
        return Answer(asdict(stop.pause(session, self.root, reason=clean(reason), by=self.by)))

    @_tool(is_stop=True, is_destructive=True)
    def estop(self, reason: Any = "") -> Answer:
        """Stop every robot of the workspace at once. Only a person resets it."""
        return Answer(asdict(stop.estop(self.root, reason=clean(str(reason))[:500], by=self.by)))

    def _compile(self, text: str, overrides: Mapping[str, str]) -> tuple[GoalGraph, Any]:
        """The graph, and its bundle: all that would run, needing no other file."""
        catalogue = Catalogue.of_workspace(Workspace.open(self.root))
        with _as_graph(text) as file:
            graph = read_goal_graph(file, catalogue, _read_overrides(overrides))
            return graph, graph.bundle if graph.bundle is not None else read_yaml(file).data

    def _propose(
        self, decider: Literal["person", "policy"], text: str, reason: str, overrides: Mapping[str, str], seed: int
    ) -> Answer:
        graph, bundle = self._compile(text, overrides)
        asked: Fields = {"by": self.by, "at": self.clock.wall_iso(), "reason": reason, "decider": decider}
        proposed = encode_proposal(Proposal(goal=graph.name, seed=seed, graph=bundle, **asked))
        Proposals(Workspace.open(self.root).proposals).put(proposed)
        ask = f"paos approve {proposed.name} -w {self.root}" if decider == "person" else "a policy decides"
        return Answer({"proposal": proposed.name, "sha256": proposed.sha256, "decider": decider, "next": ask})

    def _describe(self, id: str) -> Fields:
        """A proposal without a decision or with a denial; else the report of its goal, or of a session."""
        workspace, ledger = Workspace.open(self.root), read_ledger(self.root)
        if (goal := ledger.goals.get(GoalId(id))) is not None:
            is_over, report = bool(goal.verdict) or goal.is_cancelled, build_report(goal, ledger, 0.0)
            return {"state": "over" if is_over else "running", "is_over": is_over, "report": report}
        proposals = Proposals(workspace.proposals)
        if proposals.has(id):
            decision = proposals.find_decision(proposals.read(id))
            state = "waits for a decision" if decision is None else decision.decision
            return {"state": state, "is_over": state == "denied", "decision": decision and decision.model_dump()}
        status = ledger.sessions[get_session(id, ledger.sessions)]
        is_over, turn = status.state in FINAL_STATES, CallFiles(workspace.loops / status.contract.id).find_turn()
        return {"state": status.state, "is_over": is_over, "turn": turn, "report": report_session(status)}


@contextmanager
def _as_graph(text: str) -> Iterator[Path]:
    """The file of a goal graph that is given by its text, or by a name of the library."""
    if _NAME.fullmatch(text):
        yield get_file(Path("goal_graphs", f"{text}.yaml"), "goal_graphs")
    else:
        with as_file(text) as file:
            yield file


def _read_overrides(given: Mapping[str, str]) -> dict[str, str]:
    return parse_overrides([f"{key}={value}" for key, value in given.items()])
