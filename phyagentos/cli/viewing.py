"""`view`: the page of a workspace in the browser."""

import contextlib
import os
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path
from threading import Event
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer
from typing_extensions import override

from phyagentos.cli.arguments import choose_newest
from phyagentos.cli.outcome import print_note, print_result
from phyagentos.errors import needs_extra
from phyagentos.operations.fleet import watch_fleet

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from phyagentos.view.access import Access

NICE = 10  # a run on the same machine comes first
_SPACE_HELP = "A workspace, the run of a suite, or a folder that holds several; several begin with a list."
_SPACE = typer.Argument(
    metavar="PLACE...", default_factory=lambda: [choose_newest()], show_default="the newest", help=_SPACE_HELP
)
_ACTIONS_HELP = "Let the page cancel, pause, stop, approve, amend, retract and submit; read-only without."


def view(
    workspace: Annotated[list[Path], _SPACE],
    port: Annotated[int, typer.Option(help="0 for a free one.", min=0, max=65535)] = 0,
    host: Annotated[
        str, typer.Option(help="Address to listen on; other machines reach another one than this.")
    ] = "127.0.0.1",
    allow_actions: Annotated[bool, typer.Option("--allow-actions", help=_ACTIONS_HELP)] = False,
    run: Annotated[list[Path] | None, typer.Option(help="Folder of a suite's run, to compare; repeatable.")] = None,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    fleet: Annotated[str, typer.Option(help="URL of a fleet, which has a page too.", envvar="PHYAGENTOS_FLEET")] = "",
) -> None:
    """Show runs in the browser, before, while and after they run, until Ctrl-C; a token is printed."""
    with needs_extra("view", "paos view"):
        from phyagentos.view.site import open_places
    ends, runs = Event(), {path.name: path for path in run or ()}
    with watch_fleet(fleet) if fleet else contextlib.nullcontext() as watch:
        build = open_places(workspace, ends, allows_actions=allow_actions, runs=runs, fleet=watch)
        shown = ", ".join(str(each.resolve()) for each in workspace)
        note = f"{shown}, {'with actions' if allow_actions else 'read-only'}; Ctrl-C ends"
        _serve(build, ends, host, port, note, opens=browser)


def _serve(build: "Callable[[Access], ASGIApp]", ends: Event, host: str, port: int, note: str, *, opens: bool) -> None:
    import uvicorn

    from phyagentos.assembly.graphics import choose_graphics
    from phyagentos.view.access import Access

    os.nice(NICE)
    choose_graphics()  # for pictures that stand in place of a scene
    listening, scenes = socket.create_server((host, port)), socket.create_server((host, 0))
    number, beside = (each.getsockname()[1] for each in (listening, scenes))
    names = {host, socket.gethostname()} if host not in {"127.0.0.1", "localhost"} else {"127.0.0.1", "localhost"}
    name = socket.gethostname() if host in {"0.0.0.0", "::"} else host
    access = Access(frozenset(f"{each}:{number}" for each in names), frozenset({f"{name}:{beside}"}))
    address = f"http://{host}:{number}/?token={access.token}"
    print_result(address)
    print_note(note)
    if opens:
        webbrowser.open(address)
    config = uvicorn.Config(build(access), log_level="warning", ws_max_size=64 << 20, timeout_graceful_shutdown=1)

    class Server(uvicorn.Server):
        @override
        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            ends.set()  # streams end by themselves
            super().handle_exit(sig, frame)

    Server(config).run(sockets=[listening, scenes])
