"""Ways to a policy, by the scheme of its endpoint: the project's wire, openpi's, or a model in this process."""

import time
from collections.abc import Mapping
from pathlib import Path

from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.network.deadline import Deadline
from phyagentos.protocol.capabilities.policy_descriptors import MODEL_SCHEME, Stream
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.model_inputs import arrange
from phyagentos.runtime.policies.policy_service import PolicyService
from phyagentos.runtime.policies.server import Policy, answer
from phyagentos.runtime.policies.transport import Transport, open_transport


def open_service(endpoint: str, streams: Mapping[str, Stream]) -> PolicyService:
    """Connect to a policy that takes these streams; raises ExecutionError `POLICY_UNREACHABLE`."""
    scheme = endpoint.partition(":")[0]
    if scheme in {"openpi", "openpis"}:
        from phyagentos.runtime.policies.openpi_client import OpenpiService  # a worker without such a policy needs none

        return OpenpiService(endpoint, streams)
    if scheme == MODEL_SCHEME:
        from phyagentos.runtime.policies.onnx_policy import OnnxPolicy

        return LocalService(OnnxPolicy(Path(endpoint.removeprefix(f"{MODEL_SCHEME}:"))), streams)
    return OwnWire(open_transport(endpoint))


class OwnWire(PolicyService):
    """A server of the project's own wire."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    @override
    def exchange(self, request: wire.Request, timeout_s: float, silence_s: float) -> wire.Reply:
        deadline = Deadline(timeout_s)
        data = self._transport.exchange(wire.encode(request), min(timeout_s, silence_s))
        while isinstance(reply := wire.decode_reply(data), wire.Beat):
            try:
                left_s = deadline.compute_left_s()
            except TimeoutError:
                message = f"the policy server is at work for longer than {timeout_s:g} s"
                raise ExecutionError("POLICY_LOST", message) from None
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
