"""The link from a worker to its target: requests and replies in order, over a channel or within this process."""

from collections import deque
from collections.abc import Callable

from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import VERBS, Trait
from phyagentos.runtime.targets.server import Loopback

REPLY_TIMEOUT_S = 10.0  # a control period takes milliseconds
SLOW_TIMEOUT_S = 120.0  # a scene with meshes compiles in seconds


class TargetLink:
    """Requests are answered in the order in which they are sent; commands and captures may be sent ahead.

    Attributes:
        shares_time: Whether a motion may wait for other targets.
        is_ending: Called while it waits: whether the session is to end.

    Raises:
        ExecutionError: `TARGET_LOST` from every method when the target is gone or silent.
    """

    def __init__(self, connection: Channel) -> None:
        self.shares_time = False
        self.is_ending: Callable[[], bool] = lambda: False
        self.connection = connection
        self._local = connection if isinstance(connection, Loopback) else None
        self._sent: deque[wire.Command | wire.Capture] = deque()  # whose replies were not collected
        self._replies: deque[wire.Reply] = deque()  # to the oldest of them, where another request followed

    def clear(self) -> None:
        """Forget what was sent: another session begins."""
        self._sent.clear()
        self._replies.clear()

    @property
    def n_sent(self) -> int:
        """Number of requests whose replies were not collected."""
        return len(self._sent)

    @property
    def n_commands(self) -> int:
        """Commands among them."""
        return sum(isinstance(each, wire.Command) for each in self._sent)

    def ask(self, request: wire.Request) -> wire.Reply:
        """Send one request; its reply."""
        while len(self._replies) < len(self._sent):  # of earlier ones, which are answered first
            self._replies.append(self._receive(self._sent[len(self._replies)]))
        if self._local is None:
            wire.send_request(self.connection, request)
        return self._receive(request)

    def send(self, request: wire.Command | wire.Capture) -> None:
        """Send one request; `collect` returns its reply."""
        if self._local is not None:
            self._local.send_ahead(request)
        else:
            try:
                self.connection.send_bytes(wire.REQUESTS.encode(request))
            except OSError as error:
                raise ExecutionError("TARGET_LOST", "the target closed the connection") from error
        self._sent.append(request)

    def collect(self) -> wire.Reply:
        """The reply to the oldest request that was sent."""
        request = self._sent.popleft()
        return self._replies.popleft() if self._replies else self._receive(request)

    def _receive(self, request: wire.Request) -> wire.Reply:
        """The next reply, which is that of `request`."""
        if self._local is not None:
            return self._local.ask(request, self.is_ending)
        traits = VERBS[type(request)].traits
        if self.shares_time and Trait.MOVES in traits:
            return wire.await_reply(self.connection, wire.SHARED_TIMEOUT_S, self.is_ending)
        return wire.await_reply(self.connection, SLOW_TIMEOUT_S if Trait.SLOW in traits else REPLY_TIMEOUT_S)
