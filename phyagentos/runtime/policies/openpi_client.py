"""A policy behind openpi's WebSocket protocol: `openpi://host:port`, and `openpis://` with TLS.

On connect the server sends its metadata. Each observation is one binary frame, its answer another one; a text frame is
an error in words. The protocol has no numbers: an answer to no request is found before the next request.
"""

import contextlib
import socket
import struct
import time
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
import numpy as np
from typing_extensions import override
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.sync.client import connect

from phyagentos.errors import DefectError, ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import Stream
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.policies import openpi_codec, wire
from phyagentos.runtime.policies.model_inputs import arrange
from phyagentos.runtime.policies.transport import CONNECT_S, REPLY_MAX_BYTES, PolicyService

PINGS = 4  # within the longest silence
OTHER = "another program listens there"
_CLOSE_S = 0.2  # for the last words of a server that may have none
_TIME = struct.Struct("ll")


class OpenpiService(PolicyService):
    """One connection, which is one episode of a policy, and the server's `metadata`.

    Raises ExecutionError `POLICY_UNREACHABLE`.
    """

    def __init__(self, endpoint: str, streams: Mapping[str, Stream]) -> None:
        self._streams, self._start, self._endpoint = streams, wire.Start("", "", {}, 0), endpoint
        self._chunk_key = parse_qs(urlsplit(endpoint).query).get(openpi_codec.ACTIONS, [openpi_codec.ACTIONS])[0]
        limits: Any = {"max_size": REPLY_MAX_BYTES, "open_timeout": CONNECT_S, "close_timeout": _CLOSE_S}
        url = endpoint.replace("openpi", "ws", 1)
        self._opened = contextlib.ExitStack()
        try:
            connecting = connect(url, compression=None, ping_interval=None, proxy=None, **limits)
            self._connection = self._opened.enter_context(connecting)
            self.metadata = self._read(CONNECT_S, CONNECT_S)
        except InvalidHandshake as error:
            raise ExecutionError("POLICY_UNREACHABLE", f"{endpoint}: {OTHER}: it speaks no WebSocket") from error
        except (OSError, EOFError, InvalidURI, ValueError) as error:
            raise ExecutionError("POLICY_UNREACHABLE", f"{endpoint}: {type(error).__name__} {error}") from error
        except ExecutionError as error:
            self.close()
            raise ExecutionError(
                "POLICY_UNREACHABLE", f"{endpoint}: no metadata on connect, or {OTHER}: {error.message}"
            ) from error

    @override
    def exchange(self, request: wire.Request, timeout_s: float, silence_s: float) -> wire.Reply:
        if isinstance(request, wire.Introduce):
            descriptor = self.metadata.get("descriptor")
            return wire.Introduction(descriptor=descriptor if isinstance(descriptor, dict) else {})
        if isinstance(request, wire.Start):
            self._start = request
            return wire.Started()
        self._refuse_unasked()
        message: Fields = {**arrange(request, self._streams).observations}
        message[openpi_codec.PROMPT] = self._start.instruction
        if openpi_codec.EXTENSION in self.metadata:
            asked = msgspec.structs.asdict(self._start) | msgspec.structs.asdict(request)
            message[openpi_codec.EXTENSION] = {name: each for name, each in asked.items() if name != "observations"}
        self._send(openpi_codec.encode(message), timeout_s)
        try:
            return _read_chunk(self._read(timeout_s, silence_s), request.sequence, self._chunk_key)
        except DefectError as error:
            shown = {key: np.asarray(each) for key, each in message.items() if not isinstance(each, str | dict)}
            forms = ", ".join(f"{key} {list(each.shape)} {each.dtype}" for key, each in shown.items())
            hint = "a stream's `key` in SKILL.md names it for the model"
            raise DefectError(error.code, f"{error.message}; it was shown {forms}: {hint}", self._endpoint) from error

    @override
    def probe(self, silence_s: float) -> None:
        try:
            answered = self._connection.ping().wait(silence_s)
        except ConnectionClosed as error:
            raise _explain_end(error) from error
        if not answered:
            message = f"the policy server has answered no ping for {silence_s:g} s"
            raise ExecutionError("POLICY_LOST", message) from TimeoutError()

    @override
    def close(self) -> None:
        self._opened.close()

    def _send(self, data: bytes, timeout_s: float) -> None:
        """Send one frame; a server that does not read blocks for no longer than `timeout_s` [s]."""
        limit = _TIME.pack(int(timeout_s), int(timeout_s % 1.0 * 1e6))
        self._connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
        try:
            self._connection.send(data)
        except ConnectionClosed as error:
            raise _explain_end(error) from error

    def _refuse_unasked(self) -> None:
        try:
            self._connection.recv(0)
        except TimeoutError:
            return
        except ConnectionClosed as error:
            raise _explain_end(error) from error
        raise ExecutionError("POLICY_FAILED", "the policy server sent an answer to no request")

    def _read(self, timeout_s: float, silence_s: float) -> dict[Any, Any]:
        """The next message; an answered ping is a sign of life, as long as `timeout_s` is not over."""
        end_s, heard_s = time.perf_counter() + timeout_s, time.perf_counter()
        try:
            pong = self._connection.ping() if silence_s < timeout_s else None
            while True:
                now_s = time.perf_counter()
                if heard_s + silence_s <= now_s:
                    message = f"the policy server has sent nothing for {silence_s:g} s"
                    raise ExecutionError("POLICY_LOST", message) from TimeoutError()
                if end_s <= now_s:
                    raise ExecutionError("POLICY_LOST", f"the policy server has sent nothing for {timeout_s:g} s")
                try:
                    frame = self._connection.recv(min(end_s - now_s, silence_s / PINGS))
                    break
                except TimeoutError:
                    if pong is not None and pong.is_set():
                        heard_s, pong = time.perf_counter(), self._connection.ping()
        except ConnectionClosed as error:
            raise _explain_end(error) from error
        if isinstance(frame, str):
            raise DefectError("POLICY_FAILED", f"the policy server reports: {frame[: wire.FAULT_MAX]}", self._endpoint)
        try:
            return openpi_codec.decode(frame)
        except ExecutionError as error:
            raise ExecutionError("POLICY_FAILED", str(error).removeprefix("MALFORMED: ")) from error


def _read_chunk(answer: dict[object, Any], sequence: int, key: str) -> wire.Chunk:
    own = answer.get(openpi_codec.EXTENSION)
    own = own if isinstance(own, dict) else {}
    try:
        rows = np.asarray(answer[key], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        found = f"no array under {key!r}; its keys are {', '.join(map(str, answer))[:200]}"
        hint = f"name the one of the chunk at the end of `endpoint`: ?{openpi_codec.ACTIONS}=KEY"
        raise ExecutionError("POLICY_FAILED", f"the policy server answered with {found}; {hint}") from error
    told = own.get("sequence", sequence)
    return wire.Chunk(
        sequence=told if isinstance(told, int) else -1,
        rows=rows[None] if rows.ndim == 1 and rows.size else rows,  # a single action
        done=own.get("done") is True,
    )


def _explain_end(error: ConnectionClosed) -> ExecutionError:
    """Too large an answer is a fault of the server; everything else is its loss."""
    if error.sent is not None and error.sent.code == 1009:
        return ExecutionError("POLICY_FAILED", f"an answer of more than {REPLY_MAX_BYTES} bytes")
    return ExecutionError("POLICY_LOST", f"the policy server has gone: {error}")
