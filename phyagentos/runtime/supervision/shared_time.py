"""Advance of simulated time in worlds that several targets share, as far as the runtime plane decides it.

In lockstep, time stands while a session is checked or awaits its start on a free target, while a verdict is open, and
until the agent has acted on what ended: a goal's next step never depends on how fast its planes are. In between, each
world receives the running sessions, and advances while it finds the same ones. A target that repeats itself bit for bit
begins its next session when the agent has acted on the last one: what is ready by then does not depend on it either.
"""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import UNJUDGED_STATES, SessionState, Side
from phyagentos.protocol.sessions.session import GoalId, SessionId
from phyagentos.runtime.supervision.target_phase import Phase
from phyagentos.runtime.supervision.target_supervisor import TargetSupervisor
from phyagentos.runtime.targets.agreement import AgreementSender
from phyagentos.store.journal import Record
from phyagentos.store.ledger import Ledger
from phyagentos.store.turn_marks import TurnMarks

AGENT_S = 60.0  # of wall time, after which an agent that does not act is taken for gone
LOOK_S = 0.002  # between two looks at the agent's mark
_ENDED = frozenset({SessionState.AWAITING_VERIFICATION, SessionState.REJECTED, SessionState.CANCELLED})
_AT_WORK = frozenset({Phase.RUNNING, Phase.RECONCILING})


class SharedTime:
    """The worlds of one workspace that several targets share: by name, their targets and the path of a socket.

    `marks` show how far the agent has acted. The targets `in_turn` begin no session before it has.
    """

    def __init__(
        self,
        worlds: Mapping[str, tuple[Collection[str], Path]],
        marks: TurnMarks,
        clock: Clock,
        in_turn: Collection[str] = (),
    ) -> None:
        self._targets = {name: frozenset(targets) for name, (targets, _) in worlds.items()}
        self._senders = {name: AgreementSender(path) for name, (_, path) in worlds.items()}
        self._sent: dict[str, dict[str, str] | None] = {}
        self._marks, self._clock, self._in_turn = marks, clock, frozenset(in_turn)
        self._ended: dict[SessionId, tuple[int, float]] = {}  # with the record's number, and since when [s]

    def take_in(self, record: Record) -> None:
        """Note a session that ended."""
        if (self._senders or self._in_turn) and record.side == Side.RUNTIME and record.to in _ENDED:
            self._ended[SessionId(record.id)] = record.seq, self._clock.now_s()

    def update(
        self, supervisors: Mapping[str, TargetSupervisor], ledger: Ledger, has_waiting: Callable[[str], bool]
    ) -> float:
        """Send every world its running sessions where they changed; returns the longest wait for the next call [s]."""
        again_s = LOOK_S if self._in_turn and self._find_open_goals(self._in_turn, ledger) else float("inf")
        for name, targets in self._targets.items():
            open_goals = self._find_open_goals(targets, ledger)
            running = None if open_goals else find_running(targets, supervisors, has_waiting)
            if open_goals:
                again_s = LOOK_S
            if (name not in self._sent or self._sent[name] != running) and self._senders[name].send(running):
                self._sent[name] = running
        return again_s

    def holds_back(self, target: str, ledger: Ledger) -> bool:
        """Whether the agent has yet to act on what ended on a target that begins its sessions in turn."""
        return target in self._in_turn and bool(self._find_open_goals((target,), ledger))

    def close(self) -> None:
        """Close the sockets."""
        for sender in self._senders.values():
            sender.close()

    def _find_open_goals(self, targets: Collection[str], ledger: Ledger) -> set[GoalId]:
        """Goals whose agent has not yet judged and acted on what ended on these targets."""
        found: set[GoalId] = set()
        for id, (seq, since_s) in list(self._ended.items()):
            status = ledger.sessions.get(id)
            goal = ledger.goals.get(status.contract.goal) if status is not None else None
            is_over = goal is not None and bool(goal.verdict)  # its agent acts no more
            is_gone = is_over or self._clock.now_s() - since_s > AGENT_S
            if status is None or not status.contract.goal or is_gone:
                del self._ended[id]
            elif status.contract.target in targets:
                is_judged = status.state not in UNJUDGED_STATES
                if is_judged and self._marks.read(status.contract.goal) >= seq:
                    del self._ended[id]
                else:
                    found.add(status.contract.goal)
        return found


def find_running(
    targets: Collection[str], supervisors: Mapping[str, TargetSupervisor], has_waiting: Callable[[str], bool]
) -> dict[str, str] | None:
    """The session that runs on each target; None while one is about to start, or to be observed."""
    running: dict[str, str] = {}
    for target in targets:
        supervisor = supervisors.get(target)
        if supervisor is None:
            continue
        if supervisor.phase is Phase.CHECKING or (
            supervisor.phase is Phase.STARTING and (has_waiting(target) or supervisor.lost is not None)
        ):
            return None
        if supervisor.phase is Phase.IDLE and has_waiting(target) and not supervisor.is_free():
            return None
        if supervisor.phase in _AT_WORK and supervisor.session is not None:
            running[target] = supervisor.session.id
    return running
