"""A worker that cannot work: it answers every check with the reasons, so that sessions are rejected and not left lying.

Upstream: the assembly, where the settings of a target cannot be read. Downstream: the watchdog, which records the
rejection. Nothing is commanded and no target is asked.
"""

from collections.abc import Sequence

import msgspec

from phyagentos.errors import Problem
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.worker.orders import Check, Checked, Ready, receive_order, send


def serve_refusals(control: Channel, problems: Sequence[Problem]) -> None:
    """Refuse every session until the watchdog is gone, or asks for what only a worker can do.

    Args:
        control: To the watchdog.
        problems: Why.
    """
    send(control, Ready())
    while True:
        try:
            order = receive_order(control)
        except (EOFError, OSError):
            return
        if not isinstance(order, Check):
            return
        id = order.session.id
        told = tuple(msgspec.structs.replace(problem, address=f"{id}: {problem.address}") for problem in problems)
        send(control, Checked(session=id, plan=None, tools=None, problems=told))
