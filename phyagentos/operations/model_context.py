"""What a model would be shown of a workspace: request, world, open nodes, verdicts, capabilities, lessons, limits."""

from pathlib import Path

from phyagentos.agent.context.context import Context, build_context
from phyagentos.agent.context.of_workspace import iter_sections
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.subjects import get_goal


def read_context(workspace: Path, goal: str = "", *, purpose: str = "plan", budget_tokens: int = 8_000) -> Context:
    """The context of a goal, the latest one without a name; raises `UNKNOWN_NAME`, and for an unknown purpose."""
    ledger = read_ledger(workspace)
    known = ledger.goals if goal else dict(list(ledger.goals.items())[-1:])
    status = get_goal(goal, str(workspace), known) if known or goal else None
    return build_context(purpose, iter_sections(Workspace.open(workspace), ledger, status), budget_tokens)
