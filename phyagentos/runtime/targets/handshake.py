"""The start of a connection to a target and of each epoch on it: version, size limit and tokens, on every transport.

The supervisor makes a key for each commander and hands it to the target over an inherited descriptor: never in argv, in
the environment or in a file that others can read. The commander gets tokens that are minted from the key: one to
connect, and one for each epoch of a session that it is ordered to run. It cannot mint the token of another epoch, and
the next key ends its connection.
"""

import hmac
import secrets
from collections.abc import Callable

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import MESSAGE_MAX_BYTES, Channel, PeerChannel

WIRE_VERSION = 5  # grows when a message changes its meaning; preflight compares it too
KEY_BYTES = 32
GREETING_S = 2.0  # until the first message of a client
_PATIENCE_S = 10.0  # until the answer to it; a target finishes its halt first


class Hello(msgspec.Struct, frozen=True, tag=True):
    """The first message of a client, with its wire version and longest message. Reply: `Welcome` or `Denied`."""

    version: int
    token: bytes
    max_bytes: int = MESSAGE_MAX_BYTES


class Grant(msgspec.Struct, frozen=True, tag=True):
    """The next key, for a client by its process id, as the only message of a supervisor that adopts a running target.

    It is accepted from one process alone, identified by the kernel: the holder of the watchdog's lock.
    """

    key: bytes
    commander: int = 0


class Welcome(msgspec.Struct, frozen=True, tag=True):
    """The connection is open; wire version and longest message of the target."""

    version: int = WIRE_VERSION
    max_bytes: int = MESSAGE_MAX_BYTES


class Denied(msgspec.Struct, frozen=True, tag=True):
    """The connection is refused. Codes: `NOT_SECURED`, `VERSION_MISMATCH`, `MALFORMED`."""

    code: str
    message: str


_ENCODER = msgspec.msgpack.Encoder()
_GREETINGS: msgspec.msgpack.Decoder[Hello | Grant] = msgspec.msgpack.Decoder(Hello | Grant)
_ANSWERS: msgspec.msgpack.Decoder[Welcome | Denied] = msgspec.msgpack.Decoder(Welcome | Denied)


def make_key() -> bytes:
    """An unguessable key."""
    return secrets.token_bytes(KEY_BYTES)


def mint(key: bytes, session: str = "", epoch: int = 0) -> bytes:
    """The token of one epoch of a session, by HMAC-SHA256; without a session, the one to connect with."""
    return hmac.digest(key, f"{epoch} {session}".encode(), "sha256")


class Tokens:
    """What admits a client to one target, and its sessions: the tokens of the newest key; none without a key.

    `is_supervisor` is whether a process, by its id, may grant a key.
    """

    def __init__(self, key: bytes = b"", is_supervisor: Callable[[int], bool] = lambda _pid: False) -> None:
        self._key, self._is_supervisor = key, is_supervisor
        self._commander = 0
        self._admitted = b""  # the key by which the present client came in

    @property
    def is_stale(self) -> bool:
        """Whether there is a newer key than the one by which the present client came in."""
        return self._admitted is not self._key

    def expects(self, peer: int) -> bool:
        """Whether a process may say anything: any one while the commander's id is not known, else it or a supervisor.

        Asked before anything is read, so a stranger cannot even hold the target up by half a message.
        """
        return self._commander in {0, peer} or self._is_supervisor(peer)

    def renew(self, key: bytes, commander: int = 0) -> None:
        """Admit by tokens of this key only, and only from the process `commander` unless that is 0.

        Raises:
            ValueError: The key is of another length.
        """
        if len(key) != KEY_BYTES:
            raise ValueError(f"a key of {len(key)} bytes; {KEY_BYTES} are needed")
        self._commander, self._key = commander, key

    def permits(self, session: str, epoch: int, token: bytes) -> bool:
        """Whether a token is that of the epoch, of the newest key."""
        return bool(self._key) and hmac.compare_digest(token, mint(self._key, session, epoch))

    def admit(self, channel: PeerChannel) -> None:
        """Read the first message of a client and answer it.

        Raises:
            ConnectionError: The client is not admitted, or was a supervisor, which sends nothing else.
            EOFError: The client is gone; also OSError.
        """
        reply: Welcome | Denied
        try:
            greeting = _GREETINGS.decode(channel.recv_bytes())
            key = self._key  # a newer one may come at any time
            reply = self._judge(greeting, channel.find_peer(), key)
        except (msgspec.MsgspecError, ValueError) as error:
            greeting, reply = None, Denied("MALFORMED", f"the first message is no greeting: {error}")
        channel.send_bytes(_ENCODER.encode(reply))
        if not isinstance(greeting, Hello) or isinstance(reply, Denied):
            raise ConnectionRefusedError
        self._admitted = key

    def _judge(self, greeting: Hello | Grant, peer: int, key: bytes) -> Welcome | Denied:
        if isinstance(greeting, Grant):
            if not self._is_supervisor(peer):
                return Denied("NOT_SECURED", f"process {peer} does not supervise this target, so it grants no key")
            self.renew(greeting.key, greeting.commander)
            return Welcome()
        if not key or not hmac.compare_digest(greeting.token, mint(key)):
            return Denied("NOT_SECURED", "the token is not that of the present commander")
        if greeting.version != WIRE_VERSION:
            found = f"the client speaks version {greeting.version} of the wire, the target version {WIRE_VERSION}"
            return Denied("VERSION_MISMATCH", f"{found}; start both from the same installation")
        return Welcome()


def greet(channel: Channel, token: bytes) -> Welcome:
    """Open a connection, as a client.

    Raises:
        ExecutionError: `NOT_SECURED`, `VERSION_MISMATCH`; `TARGET_LOST` without an answer.
    """
    return _open(channel, Hello(version=WIRE_VERSION, token=token))


def grant(channel: Channel, key: bytes, commander: int = 0) -> None:
    """Give a running target its next key, and the process that it is for, as its supervisor.

    Raises:
        ExecutionError: `NOT_SECURED` when it has another supervisor; `TARGET_LOST` without an answer.
    """
    _open(channel, Grant(key=key, commander=commander))


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
