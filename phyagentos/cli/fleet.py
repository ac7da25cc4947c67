"""`paos fleet`: targets on other hosts, over NATS JetStream."""

import shlex
import signal
from pathlib import Path
from threading import Event
from typing import Annotated

import typer

from phyagentos.assembly.project import admit_python
from phyagentos.cli.arguments import TrustPython
from phyagentos.cli.outcome import ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.fleet.hub import LEASE_S
from phyagentos.operations import fleet
from phyagentos.operations.fleet import FleetServer, FleetStatus, FleetStop, HostLine
from phyagentos.protocol.documents.plain_text import clean

Server = Annotated[str, typer.Option(help="URL, as `paos fleet server` prints it.", envvar="PHYAGENTOS_FLEET")]
Space = Annotated[Path, typer.Option("--workspace", "-w", help="Its own folder; created when missing.")]


def server(
    store: Annotated[Path, typer.Option(help="Folder of the server.")] = Path("fleet"),
    listen: Annotated[str, typer.Option(help="Address and port; with --settings as they say.")] = fleet.LISTEN,
    settings: Annotated[Path | None, typer.Option(help="Servers, hosts, TLS: see docs/howto/fleet.md.")] = None,
    member: Annotated[str, typer.Option(help="Which of the servers of --settings this is.")] = "",
) -> Reply[FleetServer]:
    """Prepare a NATS server with JetStream for one fleet: its URLs, and the command that runs it."""
    found = fleet.prepare_server(store.resolve(), listen, settings=settings, member=member)
    lines = [shlex.join(found.command), *(f"{role}: {url}" for role, url in found.urls.items())]
    return Reply(found, "\n".join(lines), folds=False)


def lead(
    workspace: Space,
    server: Server,
    lease: Annotated[float, typer.Option(help="How long a host may hold a shared target unheard [s].")] = LEASE_S,
) -> None:
    """Place the sessions of an agent's workspace on the hosts of a fleet, in place of `paos watch`; Ctrl-C ends."""
    fleet.lead_fleet(workspace, server, _end_on_signals(), print_note, lease)


def join(
    workspace: Space,
    server: Server,
    name: Annotated[str | None, typer.Option(help="Of this host in the fleet; that of the machine by default.")] = None,
    target: Annotated[list[str] | None, typer.Option(help="To offer; all of TARGETS.md by default.")] = None,
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Render nothing.")] = False,
    page: Annotated[str, typer.Option(help="Address of the page of this workspace, for people.")] = "",
    trust_python: TrustPython = False,
) -> None:
    """Carry out sessions of a fleet on targets of this host, in its own workspace; Ctrl-C ends."""
    admit_python(workspace, is_trusted=trust_python, announce=print_note)
    ends, pictures = _end_on_signals(), not no_pictures
    fleet.join_fleet(workspace, server, ends, print_note, name=name, targets=target or (), pictures=pictures, page=page)


def status(server: Server) -> Reply[FleetStatus]:
    """Hosts of a fleet: targets, load, records, whether they are alive and stopped."""
    found = fleet.read_status(server)
    return Reply(found, "\n".join([*map(_render_host, found.hosts), f"{found.offers} sessions are open"]))


def stop(server: Server, reason: Annotated[str, typer.Option(help="Why.", callback=clean)] = "") -> Reply[FleetStop]:
    """Latch the emergency stop on every host at once; each host alone resets it."""
    found = fleet.stop_fleet(server, reason=reason)
    notes = [f"no answer from {each}: it latches when it is back; use the stop of its robots" for each in found.silent]
    code = ExitCode.INTERNAL_ERROR if found.silent else ExitCode.GOAL_MET
    return Reply(found, f"latched on {', '.join(found.stopped) or 'no host'}", notes, code)


def _render_host(line: HostLine) -> str:
    card, state = line.card, ("stopped" if line.card.is_stopped else "alive") if line.is_alive else "silent"
    return f"{card.host}: {state}, {', '.join(sorted(card.targets))}; {card.load} sessions, {line.records} records"


def _end_on_signals() -> Event:
    ends = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ends.set())
    return ends
