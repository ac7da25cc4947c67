"""Commands about sessions and goals that ran: `why`, `graph`, `context`."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import asdict

from phyagentos.cli.arguments import choose_newest
from phyagentos.cli.reply import Reply
from phyagentos.protocol.sessions.tasks import Relation

_SHORT = "The part after the goal is enough."
Id = Annotated[str, typer.Argument(metavar="SESSION", help=f"A session id. {_SHORT}")]
_IN = typer.Option("--workspace", "-w", default_factory=choose_newest, show_default="the newest", help="Its folder.")
Space = Annotated[Path, _IN]
Subject = Annotated[str, typer.Argument(metavar="SESSION|NODE|GOAL", help=f"The latest goal without. {_SHORT}")]


def why(workspace: Space, subject: Subject = "") -> Reply[object]:
    """Explain a verdict: the layer, the leaf and the number that decided it; of a goal or node, the first cause."""
    from phyagentos.operations.why import why

    found = why(workspace, subject)
    return Reply(found, "\n".join(found.explanation))


def show_graph(
    workspace: Space,
    goal: Annotated[str, typer.Argument(metavar="GOAL", help="Its id; not needed where there is one goal.")] = "",
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
) -> Reply[object]:
    """Show a goal's graph as it stands: every attempt at a node, and what comes before it."""
    from phyagentos.operations.goal_graph import show_graph

    found = show_graph(workspace, goal)
    lines = [f"{found.goal}: {found.objective or found.graph} ({found.verdict or 'no verdict yet'})"]
    width = max((len(step.name) for step in found.steps), default=0)
    for step in found.steps:
        relations = {each.before: each.relation for each in found.edges if each.step == step.name}
        before = [name if how is Relation.AFTER else f"{name} ({how})" for name, how in relations.items()]
        after = f"  after {', '.join(before)}" if before else ""
        lines.append(f"  {step.name:<{width}}  {step.state:<11}{after}".rstrip())
    return Reply(found, found.mermaid if mermaid else "\n".join(lines), folds=not mermaid)


def show_context(
    workspace: Space,
    goal: Annotated[str, typer.Argument(metavar="GOAL", help="Its id; the latest one without.")] = "",
    for_: Annotated[str, typer.Option("--for", help="plan, verify or repair.")] = "plan",
    budget: Annotated[int, typer.Option(help="Most tokens of the text, of three bytes each.")] = 8_000,
) -> Reply[object]:
    """Print what a model would be shown: request, world, open nodes, verdicts, capabilities, lessons, limits."""
    from phyagentos.operations.model_context import read_context

    found = read_context(workspace, goal, purpose=for_, budget_tokens=budget)
    facts = asdict(found) | {"tokens": found.tokens, "sha256": found.sha256}
    return Reply(facts, found.text, [f"{found.tokens} of {budget} tokens, sha256 {found.sha256}"], folds=False)
