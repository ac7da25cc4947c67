"""What writes into the journal of a workspace: a pen for each side."""

from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Execution
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Entry, Journal

TRIGGERS = {Verdict.SUCCESS: "accept", Verdict.FAILURE: "refuse", Verdict.REPLAN: "replan"}


class Pens:
    """A new workspace, in which sessions are recorded as both planes would."""

    def __init__(self, root: Path, clock: Clock, library: Library = Library(())) -> None:  # noqa: B008 - holds nothing
        self.workspace, self.clock = Workspace.create(root, library), clock
        self.pens = {side: Journal(root, side=side, by=side.value, clock=clock, durable=False) for side in Side}

    def write(self, side: Side, id: str, ev: str, epoch: int | None = None, /, **body: object) -> None:
        self.commit(side, Entry(id, ev, body or None, epoch))

    def commit(self, side: Side, *entries: Entry) -> None:
        self.pens[side].commit(entries)

    def claim(self, id: str) -> None:
        """From the claim to the start."""
        self.write(Side.RUNTIME, id, "claim")
        self.write(Side.RUNTIME, id, "check", 1)
        self.write(Side.RUNTIME, id, "start", 1)

    def finish(self, id: str, **facts: object) -> None:
        execution = Execution(evidence=f"evidence/{id}", **facts)
        self.write(Side.RUNTIME, id, "halt", 1)
        self.write(Side.RUNTIME, id, "finish", 1, execution=msgspec.to_builtins(execution))

    def decide(self, id: str, attempt: Attempt) -> None:
        self.write(Side.AGENT, id, "verify")
        self.write(Side.AGENT, id, TRIGGERS[attempt.verdict], attempt=msgspec.to_builtins(attempt))

    def close(self) -> None:
        for pen in self.pens.values():
            pen.close()
