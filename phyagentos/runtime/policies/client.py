"""Requests of one session to its policy server, in a thread, since the session's loop must never block."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from typing import TypeVar

import pydantic

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.transport import Transport, open_transport

ASK_S = 3.0  # a server that needs longer for its descriptor will not keep a control rate

Expected = TypeVar("Expected", wire.Introduction, wire.Started, wire.Chunk)


def ask_policy(endpoint: str) -> PolicyDescriptor:
    """The descriptor of the server at an endpoint; the handshake of preflight.

    Raises:
        ExecutionError: `POLICY_UNREACHABLE`, `POLICY_LOST` or `POLICY_FAULT`.
    """
    transport = open_transport(endpoint)
    try:
        reply = _exchange(transport, wire.Introduce(), wire.Introduction, ASK_S)
    finally:
        transport.close()
    try:
        return PolicyDescriptor.model_validate({**reply.descriptor, "endpoint": endpoint})
    except pydantic.ValidationError as error:
        raise ExecutionError("POLICY_FAULT", f"{endpoint} describes no policy: {error}") from error


class PolicyClient:
    """Requests chunks, one at a time.

    Args:
        endpoint: Of the server; connected to with the first request.
        timeout_s: Longest wait for one reply, by the wall [s].
    """

    def __init__(self, endpoint: str, timeout_s: float) -> None:
        self._endpoint, self._timeout_s = endpoint, timeout_s
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="policy")
        self._transport: Transport | None = None
        self._pending: Future[wire.Chunk] | None = None
        self._closed = threading.Event()

    @property
    def is_waiting(self) -> bool:
        """Whether a request is out."""
        return self._pending is not None

    def ask(self, request: wire.Infer, start: wire.Start | None = None) -> None:
        """Send a request; `start` goes before the first one of a session."""
        self._pending = self._thread.submit(self._ask, request, start)

    def poll(self) -> wire.Chunk | None:
        """The reply, once; None while it is outstanding.

        Raises:
            ExecutionError: `POLICY_UNREACHABLE`, `POLICY_LOST` or `POLICY_FAULT`.
        """
        if self._pending is None or not self._pending.done():
            return None
        done, self._pending = self._pending, None
        return done.result()

    def wait(self, timeout_s: float) -> None:
        """Sleep until the reply is here, at most `timeout_s` [s]."""
        if self._pending is not None:
            wait_for((self._pending,), timeout_s)

    def close(self) -> None:
        """Close the connection; the reply to an outstanding request is dropped."""
        self._closed.set()
        self._pending = None
        self._thread.shutdown(wait=False, cancel_futures=True)
        if self._transport is not None:
            self._transport.close()

    def _ask(self, request: wire.Infer, start: wire.Start | None) -> wire.Chunk:
        if self._transport is None:
            self._transport = open_transport(self._endpoint)
        if self._closed.is_set():
            self._transport.close()
        if start is not None:
            _exchange(self._transport, start, wire.Started, self._timeout_s)
        chunk = _exchange(self._transport, request, wire.Chunk, self._timeout_s)
        if chunk.sequence != request.sequence:
            message = f"chunk {chunk.sequence} came where {request.sequence} was asked for"
            raise ExecutionError("POLICY_FAULT", message)
        return chunk


def _exchange(transport: Transport, request: wire.Request, kind: type[Expected], timeout_s: float) -> Expected:
    reply = wire.decode_reply(transport.exchange(wire.encode(request), timeout_s))
    if not isinstance(reply, kind):
        raise ExecutionError("POLICY_FAULT", f"{type(request).__name__} was answered by {type(reply).__name__}")
    return reply
