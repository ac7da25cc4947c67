"""The end of sessions whose goal is cancelled, where no process is left to end them."""

import contextlib

from phyagentos.protocol.sessions.lifecycle import IllegalTransition, find_cancel
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger


def cancel_unheld(goal: GoalId, ledger: Ledger, journal: Journal) -> None:
    """Cancel the sessions of a cancelled goal that no process holds: those that wait for a target, or for a verdict.

    Nothing else would end them where neither agent nor runtime is left.
    """
    for _ in range(5):  # a plane may make records out of date
        for record in journal.read_new():
            ledger.apply(record)
        live = [each for each in ledger.live_sessions() if each.contract.goal == goal]
        unheld = [each.contract.id for each in live if find_cancel(each.state) == "cancel"]
        if not unheld:
            return
        with contextlib.suppress(IllegalTransition):  # a plane was faster
            journal.commit([Entry(id, "cancel", {"reason": "its goal is cancelled"}) for id in unheld])
