"""The worker process of one target: checks and runs sessions, one at a time, as long as it lives. Paper section 3.4.

Upstream: the watchdog's orders. Downstream: preflight, the runner and, through the handle, the world. Everything
that is slow to start (planner, target, leaves) is started once and kept warm.
"""

import contextlib
from typing import Any

import msgspec
import numpy as np

from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.channel import Channel
from phyagentos.protocol.library import Library
from phyagentos.protocol.markdown import publish
from phyagentos.protocol.sessions import Ended, Execution, Scene
from phyagentos.protocol.views.environment import render_environment
from phyagentos.protocol.workspace import Workspace
from phyagentos.runtime.adapter_plan import AdapterPlan
from phyagentos.runtime.dispatch import Check, Checked, Finished, Ready, Reconcile, Run, Stop, receive_order, send
from phyagentos.runtime.execution.registry import LeafRegistry
from phyagentos.runtime.execution.tree_check import check_tree
from phyagentos.runtime.handle import TargetSessionHandle
from phyagentos.runtime.heartbeat import HeartbeatWriter
from phyagentos.runtime.perception import Perception
from phyagentos.runtime.preflight import Preflight
from phyagentos.runtime.runner import SessionRunner


class WorkerLoop:
    """Answers the watchdog until it is gone.

    Args:
        control: To the watchdog.
        handle: To the world.
        preflight: What sessions are checked against.
        runner: Carries them out.
        perception: Looks at the world for preconditions and reconciliation.
        heartbeat: Says what is going on.
        library: Where trees are.
        registry: Where leaves are.
        workspace: Where ENVIRONMENT.md is published.
    """

    def __init__(
        self,
        *,
        control: Channel,
        handle: TargetSessionHandle,
        preflight: Preflight,
        runner: SessionRunner,
        perception: Perception,
        heartbeat: HeartbeatWriter,
        library: Library,
        registry: LeafRegistry,
        workspace: Workspace,
    ) -> None:
        self._control = control
        self._handle = handle
        self._preflight = preflight
        self._runner = runner
        self._perception = perception
        self._heartbeat = heartbeat
        self._library = library
        self._registry = registry
        self._workspace = workspace
        self._plan: AdapterPlan | None = None
        self._stop_reason: str | None = None

    def run(self) -> None:
        """Serve until the watchdog closes the connection."""
        self._heartbeat.beat(phase="idle")
        send(self._control, Ready())
        while True:
            try:
                order = receive_order(self._control)
            except (EOFError, OSError):
                return
            if isinstance(order, Check):
                send(self._control, self._check(order))
            elif isinstance(order, Run):
                send(self._control, Finished(session=order.session.id, execution=self._execute(order)))
                self._publish_environment(order.session.scene)
                self._heartbeat.beat(phase="idle")
            elif isinstance(order, Reconcile):
                send(self._control, Finished(session=order.session.id, execution=self._reconcile(order)))

    def _check(self, order: Check) -> Checked:
        session = order.session
        self._plan, self._stop_reason = None, None
        self._heartbeat.beat(phase="loading", session=session.id, epoch=order.epoch)
        try:
            problems = self._find_problems(order)
            if problems:
                return Checked(session=session.id, plan=None, tools=None, problems=tuple(problems))
            self._plan, tools = self._preflight.plan(session, self._handle.describe())
        except DefinitionError as error:
            return Checked(session=session.id, plan=None, tools=None, problems=error.problems)
        except ExecutionError as error:
            problem = Problem(code=error.code, address=f"{session.id}: target {session.target}", found=str(error))
            return Checked(session=session.id, plan=None, tools=None, problems=(problem,))
        return Checked(session=session.id, plan=self._plan, tools=tools)

    def _find_problems(self, order: Check) -> list[Problem]:
        session, preflight = order.session, self._preflight
        problems = preflight.find_contract_problems(session)
        if problems:
            return problems
        tree = preflight.skills[session.skill].tree
        problems = [
            *check_tree(tree, self._library, self._registry),
            *preflight.find_target_problems(session, self._handle.describe()),
        ]
        if problems:
            return problems
        self._handle.load(session.scene, _read_state(order.restore))
        return preflight.find_world_problems(session, self._perception.perceive(self._handle.observe(), session.scene))

    def _execute(self, order: Run) -> Execution:
        if self._plan is None:
            return Execution(ended=Ended.SKILL_FAILED, evidence="", code="NOT_CHECKED", message="run without preflight")
        return self._runner.run(
            order.session,
            order.epoch,
            msgspec.to_builtins(self._plan),
            evidence=order.evidence,
            cancel=self._find_stop_reason,
            beat=self._heartbeat.beat,
        )

    def _publish_environment(self, scene: Scene) -> None:
        """ENVIRONMENT.md: the world as the session left it."""
        with contextlib.suppress(ExecutionError):
            environment = self._perception.perceive(self._handle.observe(), scene)
            publish(self._workspace.environment, render_environment(environment))

    def _find_stop_reason(self) -> str | None:
        """Whether the watchdog wants an end; asked in every turn of the runner's loop."""
        while self._stop_reason is None and self._control.poll():
            order = receive_order(self._control)
            if isinstance(order, Stop):
                self._stop_reason = order.reason
        return self._stop_reason

    def _reconcile(self, order: Reconcile) -> Execution:
        """Look at the world a lost runner left behind, and say how it was lost."""
        try:
            self._handle.load(order.session.scene)
            return self._runner.observe_only(
                order.session, order.epoch, ended=Ended.RUNNER_LOST, evidence=order.evidence, reason=order.reason
            )
        except ExecutionError as error:
            return Execution(
                ended=Ended.TARGET_LOST, evidence=order.evidence, code=error.code, message=f"{order.reason}; {error}"
            )


def _read_state(path: str) -> "np.ndarray[Any, np.dtype[np.float64]] | None":
    """The recorded state vector of an evidence file, or None for an empty path."""
    if not path:
        return None
    with np.load(path) as recorded:
        return np.asarray(recorded["state"], dtype=np.float64)
