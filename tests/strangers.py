"""A process of the same user that waits in the backlog of a target, for the moment in which its commander is gone."""

import contextlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.runtime.channel import connect
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Grant, Hello, make_key, mint

PAUSE_S = 0.05


@dataclass(slots=True)
class Told:
    """How often the strangers said something, and every answer that they got."""

    sent: int = 0
    heard: list[bytes] = field(default_factory=list)


@contextmanager
def wait_in_the_backlog(socket: Path, session: str, epoch: int = 2) -> Iterator[Told]:
    """Two at a time, all through the block: they begin a session, greet, and grant a key of their own."""
    key, over, told = make_key(), threading.Event(), Told()
    words = cycle(
        [
            wire.REQUESTS.encode(wire.Begin(session=session, epoch=epoch)),
            msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION, token=mint(key))),
            msgspec.msgpack.encode(Grant(key=key)),
        ]
    )

    def wait() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError, EOFError), connect(socket) as stranger:
                stranger.send_bytes(next(words))
                told.sent += 1
                told.heard.append(stranger.recv_bytes())
            SystemClock().sleep(PAUSE_S)

    for _ in range(2):
        threading.Thread(target=wait, daemon=True).start()
    try:
        yield told
    finally:
        over.set()
