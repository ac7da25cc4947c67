"""The start of a connection to a target: version, size limit and the token of the epoch, on every transport alike.

The supervisor makes a token for each commander (an epoch of the connection) and hands it to both ends over inherited
descriptors: never in argv, in the environment or in a file that others can read. Only the newest token admits.
"""

import hmac
import secrets
from collections.abc import Callable

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import MESSAGE_MAX_BYTES, Channel, PeerChannel

WIRE_VERSION = 3  # grows when a message changes its meaning; preflight compares it too
TOKEN_BYTES = 32
GREETING_S = 2.0  # until the first message of a client
_PATIENCE_S = 10.0  # until the answer to it; a target finishes its halt first


class Hello(msgspec.Struct, frozen=True, tag=True):
    """The first message of a client, with its wire version and longest message. Reply: `Welcome` or `Denied`."""

    version: int
    token: bytes
    max_bytes: int = MESSAGE_MAX_BYTES


class Grant(msgspec.Struct, frozen=True, tag=True):
    """The next token, as the only message of a supervisor that adopts a running target.

    It is accepted from one process alone, identified by the kernel: the holder of the watchdog's lock.
    """

    token: bytes


class Welcome(msgspec.Struct, frozen=True, tag=True):
    """The connection is open; wire version and longest message of the target."""

    version: int = WIRE_VERSION
    max_bytes: int = MESSAGE_MAX_BYTES


class Denied(msgspec.Struct, frozen=True, tag=True):
    """The connection is refused. Codes: `BAD_TOKEN`, `VERSION_MISMATCH`, `MALFORMED`."""

    code: str
    message: str


_ENCODER = msgspec.msgpack.Encoder()
_GREETINGS: msgspec.msgpack.Decoder[Hello | Grant] = msgspec.msgpack.Decoder(Hello | Grant)
_ANSWERS: msgspec.msgpack.Decoder[Welcome | Denied] = msgspec.msgpack.Decoder(Welcome | Denied)


def make_token() -> bytes:
    """An unguessable token."""
    return secrets.token_bytes(TOKEN_BYTES)


class Tokens:
    """The newest token admits a client to one target; an empty one admits none.

    Args:
        is_supervisor: Whether a process, by its id, may grant a token.
    """

    def __init__(self, token: bytes = b"", is_supervisor: Callable[[int], bool] = lambda _pid: False) -> None:
        self._token, self._is_supervisor = token, is_supervisor

    def renew(self, token: bytes) -> None:
        """Admit this token only; raises ValueError when it is of another length."""
        if len(token) != TOKEN_BYTES:
            raise ValueError(f"a token of {len(token)} bytes; {TOKEN_BYTES} are needed")
        self._token = token

    def admit(self, channel: PeerChannel) -> None:
        """Read the first message of a client and answer it.

        Raises:
            ConnectionError: The client is not admitted, or was a supervisor, which sends nothing else.
            EOFError: The client is gone; also OSError.
        """
        reply: Welcome | Denied
        try:
            greeting = _GREETINGS.decode(channel.recv_bytes())
            reply = self._judge(greeting, channel.find_peer())
        except (msgspec.MsgspecError, ValueError) as error:
            greeting, reply = None, Denied("MALFORMED", f"the first message is no greeting: {error}")
        channel.send_bytes(_ENCODER.encode(reply))
        if not isinstance(greeting, Hello) or isinstance(reply, Denied):
            raise ConnectionRefusedError

    def _judge(self, greeting: Hello | Grant, peer: int) -> Welcome | Denied:
        if isinstance(greeting, Grant):
            if not self._is_supervisor(peer):
                return Denied("BAD_TOKEN", f"process {peer} does not supervise this target, so it grants no token")
            self.renew(greeting.token)
            return Welcome()
        if not self._token or not hmac.compare_digest(greeting.token, self._token):
            return Denied("BAD_TOKEN", "the token is not that of the present epoch")
        if greeting.version != WIRE_VERSION:
            found = f"the client speaks version {greeting.version} of the wire, the target version {WIRE_VERSION}"
            return Denied("VERSION_MISMATCH", f"{found}; start both from the same installation")
        return Welcome()


def greet(channel: Channel, token: bytes) -> Welcome:
    """Open a connection, as a client.

    Raises:
        ExecutionError: `BAD_TOKEN`, `VERSION_MISMATCH`; `TARGET_LOST` without an answer.
    """
    return _open(channel, Hello(version=WIRE_VERSION, token=token))


def grant(channel: Channel, token: bytes) -> None:
    """Give a running target its next token, as its supervisor.

    Raises:
        ExecutionError: `BAD_TOKEN` when it has another supervisor; `TARGET_LOST` without an answer.
    """
    _open(channel, Grant(token=token))


def _open(channel: Channel, greeting: Hello | Grant) -> Welcome:
    try:
        channel.send_bytes(_ENCODER.encode(greeting))
        if not channel.poll(_PATIENCE_S):
            raise ExecutionError("TARGET_LOST", f"no answer to the greeting within {_PATIENCE_S} s")
        reply = _ANSWERS.decode(channel.recv_bytes())
    except (EOFError, OSError, msgspec.MsgspecError) as error:
        raise ExecutionError("TARGET_LOST", "the target closed the connection before it was open") from error
    if isinstance(reply, Denied):
        raise ExecutionError(reply.code, reply.message)
    return reply
