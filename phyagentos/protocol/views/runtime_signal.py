"""RUNTIME_SIGNAL.md: who is alive, what each target is doing at this moment, and how to ask for a stop.

Upstream: heartbeat files. Downstream: people. Rendered by the watchdog, at most twice a second, without fsync: it is
not true for longer than that.
"""

from collections.abc import Iterable
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.heartbeats import Heartbeat, find_heartbeat
from phyagentos.protocol.markdown import publish, render_table
from phyagentos.protocol.workspace import Workspace

PERIOD_S = 0.5

_HEAD = """# Signals of the runtime

What each worker said last. A person asks for an end with `paos cancel`, or by dropping a YAML file into `signals/new/`:
`{kind: cancel, session: "*", by: <who>}`.

"""


def render_runtime_signal(beats: Iterable[Heartbeat], at: str) -> str:
    """The document.

    Args:
        beats: The latest of each target.
        at: Wall time, UTC.
    """
    rows = (
        (
            beat.target,
            beat.phase,
            beat.session or "-",
            str(beat.epoch),
            str(beat.tick),
            f"{beat.sim_time_s:.2f} s",
            beat.leaf or "-",
            str(beat.pid),
            str(beat.sequence),
        )
        for beat in beats
    )
    columns = ("target", "phase", "session", "epoch", "commands", "simulated time", "leaf", "process", "beat")
    return f"{_HEAD}As of {at}.\n\n{render_table(columns, rows)}"


class RuntimeSignal:
    """Keeps RUNTIME_SIGNAL.md of one workspace in step with its heartbeats."""

    def __init__(self, workspace: Workspace, clock: Clock) -> None:
        self._path: Path = workspace.runtime_signal
        self._heartbeats = workspace.heartbeats
        self._clock = clock
        self._published_at_s = -PERIOD_S
        self._published: list[Heartbeat] = []

    def refresh(self) -> None:
        """Publish when something changed and it is time."""
        now_s = self._clock.now_s()
        if now_s - self._published_at_s < PERIOD_S:
            return
        found = (find_heartbeat(self._heartbeats, path.stem) for path in sorted(self._heartbeats.glob("*.json")))
        beats = [beat for beat in found if beat is not None]
        if beats != self._published:
            publish(self._path, render_runtime_signal(beats, self._clock.wall_iso()))
            self._published, self._published_at_s = beats, now_s
