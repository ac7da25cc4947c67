"""Serves a policy to sessions, over tcp, one session at a time; examples/projects/03_policy_server has a small one."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection, Listener
from typing import Protocol, cast
from urllib.parse import urlsplit

import numpy as np

from phyagentos.errors import ExecutionError, find_place, is_defect, list_foreign_errors
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.runtime.policies import wire

GONE = (EOFError, OSError)
BEAT_MIN_S = 0.01  # no client gets more beats than it can read


class Policy(Protocol):
    """A model that turns observations into actions."""

    def start(self, request: wire.Start) -> None:
        """A session begins; forget the last one."""

    def infer(self, request: wire.Infer) -> tuple[wire.Array, bool]:
        """Rows (k, width) of the next chunk, and whether they are the last ones."""


def serve_policy(policy: Policy, descriptor: PolicyDescriptor, on_ready: Callable[[str], None] = print) -> None:
    """Serve until interrupted, where the descriptor's endpoint is (`tcp://127.0.0.1:5555`; port 0 takes a free one).

    `on_ready` is called with the endpoint once clients can connect.
    """
    parts = urlsplit(descriptor.endpoint)
    model = ThreadPoolExecutor(max_workers=1, thread_name_prefix="model")
    with Listener((parts.hostname or "127.0.0.1", parts.port or 0)) as listener:
        host, port = cast(tuple[str, int], listener.address)
        on_ready(f"tcp://{host}:{port}")
        while True:
            with contextlib.suppress(*GONE), listener.accept() as connection:
                _converse(connection, policy, descriptor, model)


def answer(request: wire.Request, policy: Policy, descriptor: PolicyDescriptor | None = None) -> wire.Reply:
    """The reply to one request; an error of the model, and an invalid chunk, becomes a `Fault`."""
    try:
        if isinstance(request, wire.Introduce):
            return wire.Introduction(descriptor={} if descriptor is None else descriptor.model_dump(mode="json"))
        if isinstance(request, wire.Start):
            policy.start(request)
            return wire.Started()
        rows, done = policy.infer(request)
        return wire.Chunk(sequence=request.sequence, rows=np.asarray(rows, dtype=np.float64), done=bool(done))
    except list_foreign_errors() as error:  # whatever a model raises must reach the session as an attributed fault
        return wire.Fault(
            message=f"{type(error).__name__}: {error}",
            place=find_place(error, type(policy), policy.infer) if is_defect(error) else "",
        )


def _converse(connection: Connection, policy: Policy, descriptor: PolicyDescriptor, model: ThreadPoolExecutor) -> None:
    beat_s = None
    while True:
        try:
            request = wire.decode_request(connection.recv_bytes())
            if isinstance(request, wire.Start) and request.beat_s > 0.0:
                beat_s = max(request.beat_s, BEAT_MIN_S)
            reply = _await(model.submit(answer, request, policy, descriptor), connection, beat_s)
        except ExecutionError as error:
            reply = wire.Fault(message=str(error))
        connection.send_bytes(wire.encode(reply))


def _await(reply: "Future[wire.Reply]", connection: Connection, beat_s: float | None) -> wire.Reply:
    """The reply; until it is there, a beat every `beat_s` [s]."""
    while True:
        try:
            return reply.result(beat_s)
        except TimeoutError:
            connection.send_bytes(wire.encode(wire.KeepAlive()))
