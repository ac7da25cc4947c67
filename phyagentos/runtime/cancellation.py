"""What a request to cancel means for each session that it names. Upstream: signals. Downstream: the watchdog."""

from collections.abc import Iterator

from phyagentos.protocol.lifecycle import SessionState
from phyagentos.protocol.sessions import SessionId
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.store.mailbox import EVERY_SESSION

_AT_ONCE = frozenset({SessionState.PENDING, SessionState.AWAITING_VERIFICATION, SessionState.VERIFYING})
_BY_RUNTIME = frozenset({SessionState.CLAIMED, SessionState.PREFLIGHT, SessionState.RUNNING, SessionState.HALTING})


def iter_cancellable(ledger: Ledger, named: str) -> Iterator[tuple[SessionId, str]]:
    """Sessions that can be cancelled, each with the trigger: at once, or by bringing the target to rest first.

    Args:
        ledger: As it stands.
        named: A session, or `*` for all.
    """
    for status in list(ledger.live_sessions()):
        id, state = status.contract.id, SessionState(status.state)
        if named in {EVERY_SESSION, id} and state in _AT_ONCE | _BY_RUNTIME:
            yield id, "cancel" if state in _AT_ONCE else "request_cancel"
