"""What a request to cancel means for each session that it names. Upstream: signals. Downstream: the watchdog."""

from collections.abc import Iterator

from phyagentos.protocol.sessions.lifecycle import find_cancel
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.sessions.stop_signals import EVERY_SESSION
from phyagentos.store.ledger import Ledger


def iter_cancellable(ledger: Ledger, named: str) -> Iterator[tuple[SessionId, str]]:
    """Sessions that can be cancelled, each with the trigger: at once, or by bringing the target to rest first.

    Args:
        ledger: As it stands.
        named: A session, or `*` for all.
    """
    for status in list(ledger.live_sessions()):
        id, trigger = status.contract.id, find_cancel(status.state)
        if named in {EVERY_SESSION, id} and trigger is not None:
            yield id, trigger
