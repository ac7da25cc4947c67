"""What the watchdog waits for, together: records, signals, answers of workers.

Upstream: the watchdog. Downstream: the kernel's poll.
"""

import select
from collections.abc import Collection, Iterator

from phyagentos.runtime.supervision.target_phase import Phase
from phyagentos.runtime.supervision.target_supervisor import TargetSupervisor
from phyagentos.store.watch import Watch

_WITHOUT_WORKER = frozenset({Phase.RESTING, Phase.BROKEN})


class EventPoller:
    """Wakes when there is something to do.

    Args:
        watches: Of folders.
    """

    def __init__(self, *watches: Watch) -> None:
        self._poll = select.poll()
        self._watches = {watch.fileno(): watch for watch in watches}
        self._supervisors: dict[int, TargetSupervisor] = {}
        for fd in self._watches:
            self._poll.register(fd, select.POLLIN)

    def wait(self, supervisors: Collection[TargetSupervisor], timeout_s: float) -> Iterator[Watch | TargetSupervisor]:
        """What there is news of, at the latest after `timeout_s` [s]; the news of a folder are taken away.

        Args:
            supervisors: Their workers may answer.
            timeout_s: Longest wait [s].
        """
        alive = {each.worker.connection.fileno(): each for each in supervisors if each.phase not in _WITHOUT_WORKER}
        for fd in self._supervisors.keys() - alive.keys():
            self._poll.unregister(fd)
        for fd in alive.keys() - self._supervisors.keys():
            self._poll.register(fd, select.POLLIN)
        self._supervisors = alive
        for fd, _ in self._poll.poll(1e3 * timeout_s):
            if fd in self._watches:
                self._watches[fd].drain()
                yield self._watches[fd]
            else:
                yield alive[fd]
