"""Messages between a session and a policy server: msgpack, one request, one reply. Paper section 4.3.

Arrays are in C order with their shape (`runtime.codec`). Any language with msgpack can serve a policy;
docs/policies.md has the fields. The version is `protocol.capabilities.policy_descriptors.POLICY_PROTOCOL`.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import POLICY_PROTOCOL
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.codec import Codec

Array = NDArray[np.float64]
FAULT_MAX = 2000  # characters of a fault that are kept


class Introduce(msgspec.Struct, frozen=True, tag=True):
    """Ask for the descriptor. Reply: `Introduction`."""

    protocol: int = POLICY_PROTOCOL


class Start(msgspec.Struct, frozen=True, tag=True):
    """A session begins: forget the last one. Reply: `Started`.

    `instruction` is its objective in words, `seed` the root of its random choices; the client wants a `KeepAlive` every
    `beat_s` [s] while it waits for a reply, 0 for never.
    """

    session: str
    instruction: str
    parameters: Fields
    seed: int
    beat_s: float = 0.0


class Infer(msgspec.Struct, frozen=True, tag=True):
    """Ask for the next chunk; `sequence` counts the requests of a session, from 0. Reply: `Chunk`.

    `rows_done` rows of earlier chunks were carried out; the observations, by the names of the policy's descriptor, were
    made at `time_s` in the target's own time [s].
    """

    session: str
    sequence: int
    rows_done: int
    time_s: float
    observations: dict[str, np.ndarray]


class Introduction(msgspec.Struct, frozen=True, tag=True):
    """The descriptor: the fields of a `PolicyDescriptor`; empty from a server that says nothing of itself."""

    descriptor: Fields


class Started(msgspec.Struct, frozen=True, tag=True):
    """The policy is ready for a session."""


class Chunk(msgspec.Struct, frozen=True, tag=True):
    """Actions (k, width), one after the other at the rate of the policy's own action space.

    The policy has nothing to do after those that are `done`, of which none are needed; no verdict relies on that.
    """

    sequence: int
    rows: Array
    done: bool = False


class KeepAlive(msgspec.Struct, frozen=True, tag="Beat"):
    """The server is at work; the reply follows. Only where the session's `Start` asks for it, over tcp."""


class Fault(msgspec.Struct, frozen=True, tag=True):
    """The policy cannot answer; `place` is where its own code raised an error: `file:line`, or empty."""

    message: str
    place: str = ""


Request = Introduce | Start | Infer
Reply = Introduction | Started | Chunk | KeepAlive | Fault

REQUESTS = Codec[Request](Request, "request")
_REPLIES = Codec[Reply](Reply, "reply")
encode, decode_request = _REPLIES.encode, REQUESTS.decode


def decode_reply(data: bytes) -> Reply:
    """One reply; raises ExecutionError `POLICY_FAILED` for bytes that are none."""
    try:
        return _REPLIES.decode(data)
    except ExecutionError as error:
        raise ExecutionError("POLICY_FAILED", str(error)) from error
