"""Many goals on the ordinary path: one warm runtime plane in a process of its own. Paper section 4.4."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phyagentos.agent.repair.recovery_policies import RepairPolicy
from phyagentos.assembly.agent_plane import Agent, MemoryUse, open_agent
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import Clock
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace


@contextmanager
def open_bench(
    workspace: Workspace,
    clock: Clock,
    *,
    faults: Path | None = None,
    pictures: bool = False,
    sense: Sensing | None = None,
    verify: VerificationMode | None = None,
    memory: Path | None = None,
    memory_use: MemoryUse = MemoryUse.NONE,
    policy: RepairPolicy | None = None,
) -> Iterator[Agent]:
    """Both planes of a workspace, the agent in this process; arguments as of `start_watch` and `open_agent`."""
    with (
        start_watch(workspace, faults=faults, pictures=pictures, sense=sense).running(clock) as plane,
        open_agent(
            workspace,
            clock,
            by="bench",
            verify=verify,
            memory=memory,
            memory_use=memory_use,
            policy=policy,
            is_runtime_alive=plane.is_alive,
        ) as agent,
    ):
        yield agent
