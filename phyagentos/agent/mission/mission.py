"""The mission: the loop of the agent plane, which submits, waits and judges until the goal has its verdict.

The loop holds no state of its own: the controller decides from the records, so a mission may be killed and run again.
"""

import dataclasses
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Protocol

from phyagentos.agent.goals.amendment import encode_graph, find_graph
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.compiler import SessionCompiler
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.agent.memory.advisor import Advisor, NoAdvice
from phyagentos.agent.mission.goal_controller import GoalController
from phyagentos.agent.mission.patience import Patience
from phyagentos.agent.mission.report import MissionReport, build_report
from phyagentos.agent.mission.task_document import TaskDocument
from phyagentos.agent.repair.recovery_policies import GraphRepair, RepairPolicy
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.sessions.lifecycle import Fenced, IllegalTransition
from phyagentos.protocol.sessions.session import GoalId, check_goal_id
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import IllegalEvent
from phyagentos.store.forecast_record import find_distrusted
from phyagentos.store.history import Histories
from phyagentos.store.journal import Journal
from phyagentos.store.ledger import Ledger
from phyagentos.store.turn_marks import TurnMarks
from phyagentos.store.watch import Watch

WAIT_S = 0.2  # longest time before a request to cancel is noticed
PUBLISH_PERIOD_S = 0.2  # a person reads no faster
PUBLISH_SHARE = 0.01  # of the time at most: with many goals TASK.md is long
SYNC_AFTER_S = 0.02  # without news; until then the runtime's next start, which waits for the disk, covers a verdict
GATHER_S = 0.02  # so long may a verdict wait for others, while every target has more to do than that
GATHER_FROM = 32  # sessions that wait for each target: at a millisecond a session there is no end within that time
_LOG = logging.getLogger(__name__)
TRIES = 20  # at a batch that another writer made out of date


class MissionObserver(Protocol):
    """Follows a mission, for a terminal or a benchmark recorder."""

    def on_change(self, goal: GoalStatus, ledger: Ledger) -> None:
        """New records were taken in; runs in the loop's thread, must return soon and change nothing."""


class Mission:
    """Pursues goals in one workspace, one after the other; its journal is opened for the side `agent`.

    Without others, no advisor changes contracts and graph repair is the policy after a missed objective. The mission
    ends where `is_runtime_alive`, called while a goal waits, is False.
    """

    def __init__(
        self,
        workspace: Workspace,
        journal: Journal,
        *,
        clock: Clock,
        verifier: SessionVerifier | None = None,
        advisor: Advisor | None = None,
        policy: RepairPolicy | None = None,
        observers: Sequence[MissionObserver] = (),
        is_runtime_alive: Callable[[GoalStatus], bool] = lambda _: True,
    ) -> None:
        self._workspace, self._journal, self._clock = workspace, journal, clock
        self._verifier = verifier or SessionVerifier()
        self._advisor, self._policy = advisor or NoAdvice(), policy or GraphRepair()
        self._observers, self._is_runtime_alive = observers, is_runtime_alive
        self.patience: Patience | None = None  # of verdicts with people; without it none is waited for
        self._cancelled = threading.Event()
        self._turns = TurnMarks(workspace.cache)
        self._next_publish_s = 0.0
        self._published_seq = -1
        self._is_durable = True  # what was recorded last, as far as this process knows
        self.ledger = journal.open_ledger()
        self.restrict: Callable[[Catalogue], Catalogue] = lambda whole: whole  # what goals may use, repairs included

    def run(
        self, graph_file: Path, *, seed: int, overrides: Mapping[str, str] | None = None, goal: GoalId | None = None
    ) -> MissionReport:
        """Pursue a goal graph to its verdict, and keep a copy; continues a goal that the workspace already holds.

        Its id is `<graph>-<seed>` by default, with a further number when that one has its verdict.

        Raises:
            DefinitionError: With every problem of the graph; `INVALID_VALUE`; `CHANGED`. Nothing was recorded.
            ExecutionError: `NOT_RUNNING`, or an error of the journal.
        """
        catalogue = self._read_catalogue()
        graph = read_goal_graph(graph_file, catalogue, overrides)
        self._read()
        chosen = choose_goal(f"{graph.name}-{seed}", self.ledger, self._journal) if goal is None else goal
        id = check_goal_id(chosen, "goal id")
        file = self._workspace.goal_file_of(id)
        if self._journal.knows(f"goal:{id}"):
            self._check_same(graph, read_goal_graph(file, catalogue), graph_file, id)
            return self.resume(id)
        if graph.bundle is not None:
            replace_durably(file, encode_graph(graph.bundle))
        elif file.resolve() != graph_file.resolve():
            replace_durably(file, graph_file.read_bytes())
        controller = self._make_controller(SessionCompiler(graph=graph, catalogue=catalogue, goal=id, seed=seed))
        self._journal.commit(controller.open())
        return self._pursue(controller)

    def resume(self, goal: GoalId) -> MissionReport:
        """Continue a goal of the workspace; one that has its verdict is only reported.

        Raises:
            DefinitionError: `UNKNOWN_NAME`, or problems of the graph as it was submitted.
        """
        self._read()
        if goal not in self.ledger.goals:
            return self._report_past(goal)
        if not is_spent(goal, self.ledger, self._journal):
            _LOG.warning("continues goal %s", goal)
        catalogue = self._read_catalogue()
        return self._pursue(self._continue(goal, catalogue))

    def _continue(self, goal: GoalId, catalogue: Catalogue) -> GoalController:
        """The controller of a goal from its records, with the graph that it has now."""
        status = self.ledger.goals[goal]
        graph = read_goal_graph(find_graph(self._workspace, status), catalogue)
        return self._make_controller(SessionCompiler(graph=graph, catalogue=catalogue, goal=goal, seed=status.seed))

    def _report_past(self, goal: GoalId) -> MissionReport:
        """Report of a goal that the ledger has evicted."""
        with Histories(self._journal.folder) as histories:
            past = histories.fold_goal(goal)
        if past is None:
            raise DefinitionError.unknown("goal", str(self._workspace.goals), goal, self.ledger.goals)
        return build_report(past.goals[goal], past, wall_s=0.0)

    def cancel(self) -> None:
        """Cancel live sessions and halt their targets. Callable from any thread."""
        self._cancelled.set()

    def _read_catalogue(self) -> Catalogue:
        return self.restrict(Catalogue.of_workspace(self._workspace))

    def _make_controller(self, compiler: SessionCompiler) -> GoalController:
        self.ledger.keep_goal(compiler.goal)  # the report comes after the verdict
        if compiler.asks_ahead:
            compiler = dataclasses.replace(compiler, distrusted=find_distrusted(self._workspace, compiler.goal))
        evidence = Evidence(self._workspace.root)
        return GoalController(
            compiler, self.ledger, evidence, self._verifier, self._advisor, self._policy, self.patience
        )

    def _check_same(self, graph: GoalGraph, own: GoalGraph, graph_file: Path, goal: GoalId) -> None:
        """Refuse a goal id that belongs to another graph (`own`)."""
        if own.spec == graph.spec:
            return
        expected, hint = (
            f"the graph of {self._workspace.goal_file_of(goal)}",
            "Name another goal with --goal or --seed.",
        )
        is_over = is_spent(goal, self.ledger, self._journal)
        if not is_over:
            hint = f"Run that one to continue it, cancel it with 'paos cancel {goal}', or name another with --goal."
        found = f"another graph (overrides included) than that of goal {goal}, which is {'over' if is_over else 'open'}"
        raise DefinitionError.of("CHANGED", str(graph_file), found, expected, hint)

    def _pursue(self, goal: GoalController) -> MissionReport:
        begin_s, refused = self._clock.now_s(), 0
        with (
            Watch([self._journal.folder], clock=self._clock) as watch,
            closing(TaskDocument(self._workspace, self._clock)) as task,
        ):
            while True:
                self._read(goal)
                if goal.is_over:
                    break
                if goal.status.file != goal.file:
                    goal = self._continue(goal.goal, self._read_catalogue())
                if self._cancelled.is_set():
                    entries = goal.cancel()
                else:
                    edits = task.take()
                    entries = [each for edit in edits for each in goal.take_edit(edit)] or goal.decide()
                if entries:
                    try:
                        self._journal.commit(entries, durable=False)
                    except (IllegalTransition, Fenced, IllegalEvent):
                        refused += 1
                        if refused == TRIES or not self._read(goal):  # else another writer was faster
                            raise
                        continue
                    refused, self._is_durable = 0, False
                    watch.drain()  # before the look: what comes after it wakes the wait
                    continue
                self._turns.note(goal.goal, self.ledger.seq)
                self._publish(task)
                if not self._wait(watch) and not self._is_runtime_alive(goal.status):
                    self._give_up(goal)
                if goal.worklist.count_waiting() >= GATHER_FROM:
                    self._clock.sleep(GATHER_S)
            self._journal.sync()
            self._publish(task, at_once=True)
        return build_report(goal.status, self.ledger, self._clock.now_s() - begin_s)

    def _wait(self, watch: Watch) -> bool:
        """Wait for a change; whether there was one. Without news the journal is synced first."""
        if not self._is_durable:
            if watch.wait(SYNC_AFTER_S):
                return True
            self._journal.sync()
            self._is_durable = True
        return watch.wait(WAIT_S)

    def _give_up(self, goal: GoalController) -> None:
        self._read(goal)
        waiting = ", ".join(status.contract.id for status in goal.iter_live())
        message = f"goal {goal.goal}: no watchdog runs {waiting}"
        remedy = "Start 'paos watch' and run it again; it continues from its records."
        if goal.status.is_cancelled:
            message = f"goal {goal.goal} is cancelled, but no watchdog brings {waiting} to rest"
            remedy = f"Start 'paos watch', and the agent again with '--goal {goal.goal}': that ends them."
        if waiting:
            raise ExecutionError("NOT_RUNNING", f"{message}. {remedy}")

    def _read(self, goal: GoalController | None = None) -> int:
        """Take in new records; how many there were."""
        records = self._journal.read_new()
        for record in records:
            self.ledger.apply(record)
            if goal is not None:
                goal.worklist.take_in(record)
        if records and goal is not None and goal.goal in self.ledger.goals:
            for observer in self._observers:
                observer.on_change(goal.status, self.ledger)
        return len(records)

    def _publish(self, task: TaskDocument, *, at_once: bool = False) -> None:
        """TASK.md, when something changed and it is time."""
        now_s = self._clock.now_s()
        is_early = now_s < self._next_publish_s and not at_once
        if is_early or (self.ledger.seq == self._published_seq and not task.is_touched()):
            return
        task.publish(self.ledger)
        self._published_seq = self.ledger.seq
        cost_s = self._clock.now_s() - now_s
        self._next_publish_s = now_s + max(PUBLISH_PERIOD_S, cost_s / PUBLISH_SHARE)


def choose_goal(name: str, ledger: Ledger, journal: Journal) -> GoalId:
    """The first free id of this name, or that of a goal that is not over."""
    id, number = GoalId(name), 2
    while is_spent(id, ledger, journal):
        id, number = GoalId(f"{name}-{number}"), number + 1
    return id


def is_spent(id: GoalId, ledger: Ledger, journal: Journal) -> bool:
    """Whether a goal of this id is over; the ledger evicts old goals."""
    goal = ledger.goals.get(id)
    return bool(goal.verdict) or goal.is_cancelled if goal else journal.knows(f"goal:{id}")
