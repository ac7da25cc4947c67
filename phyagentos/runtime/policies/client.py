"""Requests of one session to its policy, in a thread, since the session's loop must never block.

The scheme of an endpoint names its wire: the project's own, openpi's, a model in this process, or that of a package.
"""

import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from pathlib import Path
from typing import TypeVar

import msgspec
import pydantic
from typing_extensions import override

from phyagentos.errors import DefectError, DefinitionError, ExecutionError
from phyagentos.network.deadline import Deadline
from phyagentos.protocol.capabilities.policy_descriptors import MODEL_SCHEME, POLICY_WIRES, PolicyDescriptor, Stream
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.model_inputs import arrange
from phyagentos.runtime.policies.policy_server import Policy, answer
from phyagentos.runtime.policies.transport import PolicyService, Transport, open_transport

ASK_S = 3.0  # a server that needs longer for its descriptor will not keep a control rate
BEATS = 4  # signs of life within the longest silence
_UNLIMITED_S = 1e9

Expected = TypeVar("Expected", wire.Introduction, wire.Started, wire.Chunk)


def ask_policy(endpoint: str) -> PolicyDescriptor | None:
    """The descriptor of the server at an endpoint, the handshake of preflight; None where it says nothing of itself.

    Raises:
        ExecutionError: `POLICY_UNREACHABLE`, `POLICY_LOST` or `POLICY_FAILED`.
    """
    service = open_service(endpoint, {})
    try:
        told = _exchange(service, wire.Introduce(), wire.Introduction, ASK_S, _UNLIMITED_S).descriptor
        return PolicyDescriptor.model_validate({**told, "endpoint": endpoint}) if told else None
    except pydantic.ValidationError as error:
        raise ExecutionError("POLICY_FAILED", f"{endpoint} describes no policy: {error}") from error
    finally:
        service.close()


class PolicyClient:
    """Requests chunks, one at a time, and watches the server in between; it connects with the first request.

    Args:
        endpoint: Of the policy.
        timeout_s: Longest wait for one reply, by the wall [s].
        streams: What it is shown.
        heartbeat_s: Longest silence of the server, by the wall [s]; None watches it only while it is asked.
        inference_s: How much longer it may be silent in the midst of a request [s].
    """

    def __init__(
        self,
        endpoint: str,
        timeout_s: float,
        streams: Mapping[str, Stream] | None = None,
        heartbeat_s: float | None = None,
        inference_s: float = 0.0,
    ) -> None:
        self._endpoint, self._timeout_s, self._streams = endpoint, timeout_s, streams or {}
        self._heartbeat_s, self._inference_s = heartbeat_s, inference_s
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="policy")
        self._service: PolicyService | None = None
        self._pending: Future[wire.Chunk] | None = None
        self._probe: Future[None] | None = None
        self._heard_s = time.perf_counter()
        self._closed = threading.Event()

    @property
    def is_waiting(self) -> bool:
        """Whether a request is out."""
        return self._pending is not None

    @property
    def metadata(self) -> Mapping[str, object]:
        """What the server says of itself, where its wire has that."""
        found = getattr(self._service, "metadata", {})
        return {key: each for key, each in found.items() if not isinstance(each, dict)}  # a descriptor is compared

    def ask(self, request: wire.Infer, start: wire.Start | None = None) -> None:
        """Send a request; `start` goes before the first one of a session."""
        if start is not None and self._heartbeat_s is not None:
            start = msgspec.structs.replace(start, beat_s=self._heartbeat_s / BEATS)
        self._pending = self._thread.submit(self._ask, request, start)

    def poll(self) -> wire.Chunk | None:
        """The reply, once; None while it is outstanding.

        Raises:
            ExecutionError: `POLICY_UNREACHABLE`, `POLICY_LOST` or `POLICY_FAILED`.
        """
        if self._pending is None or not self._pending.done():
            return None
        done, self._pending = self._pending, None
        self._heard_s = time.perf_counter()
        return done.result()

    def watch(self) -> None:
        """Probe the server when it has been silent for a while; raises as `poll`."""
        if self._heartbeat_s is None or self._service is None:
            return
        if self._probe is not None:
            if self._probe.done():
                done, self._probe = self._probe, None
                self._heard_s = time.perf_counter()
                done.result()
        elif self._pending is None and time.perf_counter() - self._heard_s > self._heartbeat_s / 2:
            self._probe = self._thread.submit(self._watch, self._service, self._heartbeat_s / 2)

    def wait(self, timeout_s: float) -> None:
        """Sleep until the reply is here, at most `timeout_s` [s]."""
        if self._pending is not None:
            wait_for((self._pending,), timeout_s)

    def close(self) -> None:
        """Close the connection; the reply to an outstanding request is dropped."""
        self._closed.set()
        self._pending = None
        self._thread.shutdown(wait=False, cancel_futures=True)
        if self._service is not None:
            self._service.close()

    def _ask(self, request: wire.Infer, start: wire.Start | None) -> wire.Chunk:
        if self._service is None:
            self._service = open_service(self._endpoint, self._streams)
        if self._closed.is_set():
            self._service.close()
        silence_s = _UNLIMITED_S if self._heartbeat_s is None else self._heartbeat_s + self._inference_s
        try:
            if start is not None:
                _exchange(self._service, start, wire.Started, self._timeout_s, silence_s)
            chunk = _exchange(self._service, request, wire.Chunk, self._timeout_s, silence_s)
        except ExecutionError as error:
            raise self._name_stall(error, silence_s) from error
        if chunk.sequence != request.sequence:
            raise ExecutionError(
                "POLICY_FAILED", message=f"chunk {chunk.sequence} came where {request.sequence} was requested"
            )
        return chunk

    def _watch(self, service: PolicyService, silence_s: float) -> None:
        try:
            service.probe(silence_s)
        except ExecutionError as error:
            raise self._name_stall(error, silence_s) from error

    def _name_stall(self, error: ExecutionError, silence_s: float) -> ExecutionError:
        """A silence within the heartbeat's limit is that of a server that stalls."""
        if error.code != "POLICY_LOST" or not isinstance(error.__cause__, TimeoutError) or silence_s > self._timeout_s:
            return error
        return ExecutionError(
            "POLICY_LOST",
            message=f"{self._endpoint}: {str(error).removeprefix('POLICY_LOST: ')}; heartbeat_s: {self._heartbeat_s:g}",
        )


def _exchange(
    service: PolicyService, request: wire.Request, kind: type[Expected], timeout_s: float, silence_s: float
) -> Expected:
    reply = service.exchange(request, timeout_s, silence_s)
    if isinstance(reply, wire.Fault):
        message = reply.message[: wire.FAULT_MAX]
        raise (
            DefectError("POLICY_FAILED", message, reply.place)
            if reply.place
            else ExecutionError("POLICY_FAILED", message)
        )
    if not isinstance(reply, kind):
        raise ExecutionError("POLICY_FAILED", f"{type(request).__name__} was answered by {type(reply).__name__}")
    return reply


def open_service(endpoint: str, streams: Mapping[str, Stream]) -> PolicyService:
    """Connect to a policy that takes these streams; raises ExecutionError `POLICY_UNREACHABLE`."""
    try:
        open_wire = POLICY_WIRES.load(endpoint.partition(":")[0], endpoint)
    except DefinitionError as error:
        raise ExecutionError("POLICY_UNREACHABLE", str(error)) from error
    service: PolicyService = open_wire(endpoint, streams)
    return service


def open_own_wire(endpoint: str, _streams: Mapping[str, Stream]) -> PolicyService:
    """A server of the project's own wire; raises ExecutionError `POLICY_UNREACHABLE`."""
    return OwnWire(open_transport(endpoint))


def open_model(endpoint: str, streams: Mapping[str, Stream]) -> PolicyService:
    """A model in this process: `onnx:FILE`."""
    from phyagentos.runtime.policies.onnx_policy import OnnxPolicy

    return LocalService(OnnxPolicy(Path(endpoint.removeprefix(f"{MODEL_SCHEME}:"))), streams)


class OwnWire(PolicyService):
    """A server of the project's own wire."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    @override
    def exchange(self, request: wire.Request, timeout_s: float, silence_s: float) -> wire.Reply:
        deadline = Deadline(timeout_s)
        data = self._transport.exchange(wire.encode(request), min(timeout_s, silence_s))
        while isinstance(reply := wire.decode_reply(data), wire.KeepAlive):
            try:
                left_s = deadline.compute_left_s()
            except TimeoutError:
                raise ExecutionError(
                    "POLICY_LOST", message=f"the policy server is at work for longer than {timeout_s:g} s"
                ) from None
            data = self._transport.exchange(None, min(left_s, silence_s))
        return reply

    @override
    def probe(self, silence_s: float) -> None:
        self._transport.exchange(wire.encode(wire.Introduce()), silence_s)

    @override
    def close(self) -> None:
        self._transport.close()


class LocalService(PolicyService):
    """A model in this process, shown what it takes by its own names."""

    def __init__(self, policy: Policy, streams: Mapping[str, Stream]) -> None:
        self._policy, self._streams = policy, streams

    @override
    def exchange(self, request: wire.Request, timeout_s: float, silence_s: float) -> wire.Reply:
        if isinstance(request, wire.Introduce):
            return wire.Introduction(descriptor={})
        if isinstance(request, wire.Infer):
            request = arrange(request, self._streams)
        began_s, reply = time.perf_counter(), answer(request, self._policy)
        if (took_s := time.perf_counter() - began_s) > timeout_s:
            raise ExecutionError("POLICY_LOST", f"the model took {took_s:.3g} s; {timeout_s:g} s are allowed")
        return reply

    @override
    def probe(self, silence_s: float) -> None:
        """It lives as this process does."""

    @override
    def close(self) -> None:
        """Nothing is open."""
