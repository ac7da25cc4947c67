"""Serves a policy over openpi's WebSocket protocol, to this project's sessions and to `openpi-client` alike.

Each connection is one episode. Pings are answered while the model thinks; one thread asks the model, one request at a
time, whatever the number of clients.
"""

import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.policies import openpi_codec, wire
from phyagentos.runtime.policies.policy_server import Policy

HEALTH = "/healthz"
MESSAGE_MAX_BYTES = 2**26  # some pictures
INTERNAL_ERROR = 1011  # of a WebSocket's end


def serve_openpi(policy: Policy, descriptor: PolicyDescriptor, on_ready: Callable[[str], None] = print) -> None:
    """Serve until interrupted; the endpoint's port 0 takes a free one. `on_ready` is called with the endpoint."""
    parts = urlsplit(descriptor.endpoint)
    model = ThreadPoolExecutor(max_workers=1, thread_name_prefix="model")

    def receive(connection: ServerConnection) -> None:
        try:
            _Episode(connection, policy, descriptor, model).run()
        except ConnectionClosed:
            return

    door = serve(
        receive,
        parts.hostname or "127.0.0.1",
        parts.port or 0,
        process_request=_answer_health,
        compression=None,
        max_size=MESSAGE_MAX_BYTES,
    )
    with door:
        host, port = door.socket.getsockname()[:2]
        on_ready(f"openpi://{host}:{port}")
        door.serve_forever()


def _answer_health(connection: ServerConnection, request: Request) -> Response | None:
    return connection.respond(HTTPStatus.OK, "OK\n") if request.path == HEALTH else None


class _Episode:
    """One connection. A client that says nothing of its session is numbered by its requests."""

    def __init__(
        self, connection: ServerConnection, policy: Policy, descriptor: PolicyDescriptor, model: ThreadPoolExecutor
    ) -> None:
        self._connection, self._policy, self._descriptor, self._model = connection, policy, descriptor, model
        self._count, self._rows = 0, 0

    def run(self) -> None:
        descriptor = self._descriptor.model_dump(mode="json")
        self._connection.send(openpi_codec.encode({openpi_codec.EXTENSION: 1, "descriptor": descriptor}))
        while True:
            frame = self._connection.recv()
            try:
                began_s = time.perf_counter()
                answer = self._model.submit(self._answer, frame).result()
                answer["server_timing"] = {"infer_ms": 1e3 * (time.perf_counter() - began_s)}
                self._connection.send(openpi_codec.encode(answer))
            except ConnectionClosed:
                raise
            except Exception as error:  # whatever a model raises must reach the client in words
                told = str(error) if isinstance(error, ExecutionError) else "".join(traceback.format_exception(error))
                self._connection.send(told[-wire.FAULT_MAX :])
                self._connection.close(INTERNAL_ERROR, "the policy has failed")
                return

    def _answer(self, frame: str | bytes) -> Fields:
        if isinstance(frame, str):
            raise ExecutionError("MALFORMED", "a text frame; observations are binary ones")
        observations = openpi_codec.decode(frame)
        told = observations.pop(openpi_codec.EXTENSION, None)
        asked: Fields = {"session": "openpi", "sequence": self._count, "rows_done": self._rows, "time_s": 0.0}
        start: Fields = {"parameters": {}, "seed": 0}
        if isinstance(told, dict):
            asked |= {name: told[name] for name in asked if name in told}
            start |= {name: told[name] for name in start if name in told}
        instruction = str(observations.get(openpi_codec.PROMPT, ""))
        if not self._count:
            self._policy.start(wire.Start(session=str(asked["session"]), instruction=instruction, **start))
        arrays = {str(key): np.asarray(value) for key, value in observations.items() if not isinstance(value, str)}
        rows, done = self._policy.infer(wire.Infer(observations=arrays, **asked))
        rows = np.asarray(rows, dtype=np.float64)
        self._count, self._rows = self._count + 1, self._rows + len(rows)
        own = {"sequence": asked["sequence"], "done": bool(done)}
        return {openpi_codec.ACTIONS: rows, openpi_codec.EXTENSION: own}
