"""`paos mcp`: the tools and resources of a workspace, served to an agent."""

from typing import Annotated

import typer

from phyagentos.agent.tools.registry import Level
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import print_note
from phyagentos.errors import needs_extra
from phyagentos.protocol.workspace.workspace import Workspace

_HTTP_HELP = "Serve streamable HTTP on this port of 127.0.0.1, not stdio; 0 for a free one. A token is printed."


def serve(
    workspace: Space,
    level: Annotated[Level, typer.Option(help="How far clients may go.")] = Level.READ,
    http: Annotated[int | None, typer.Option(help=_HTTP_HELP, min=0, max=65535)] = None,
) -> None:
    """Serve the tools of a workspace to an agent, over stdio or HTTP, until it hangs up or Ctrl-C."""
    with needs_extra("mcp", "paos mcp"):
        import mcp.server.lowlevel  # noqa: F401
    from phyagentos.mcp.protocol_server import serve

    root = Workspace.open(workspace).root
    print_note(f"tools of {root} up to level {level}")
    serve(root, level, http, print_note)
