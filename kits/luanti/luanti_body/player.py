"""A client of Luanti without a screen: it joins, acknowledges what it is sent, and is a player of the server then.

The protocol is that of network/connection.h and networkprotocol.h of the engine (5.x, protocol 37 to 41). The first
join of a name registers a verifier of SRP, whatever it is, so that no password is computed in a new world.
"""

import contextlib
import itertools
import socket
import struct
import threading
from collections import defaultdict

PROTOCOL_ID = 0x4F457403
CONTROL, ORIGINAL, SPLIT, RELIABLE = range(4)
ACK, SET_PEER, PING, DISCONNECT = range(4)
HELLO, AUTH_ACCEPT, ACCESS_DENIED, ANNOUNCE_MEDIA = 0x02, 0x03, 0x0A, 0x3C
INIT, INIT2, CLIENT_READY, FIRST_SRP = 0x02, 0x11, 0x43, 0x50
SERIALIZATION, PROTOCOLS, FORMSPEC = 29, (37, 41), 6
FIRST_SEQUENCE = 65500
TICK_S, RESEND_TICKS, PING_TICKS, INIT_TICKS = 0.05, 10, 40, 6
OUT = 2**16


class Player(threading.Thread):
    """Joins on start, and plays until `leave`; what it does in the world is done by the server's mod."""

    def __init__(self, port: int, name: str) -> None:
        super().__init__(daemon=True, name=f"luanti-{name}")
        self._name, self._address = name, ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(TICK_S)
        self._peer, self._is_leaving = 0, threading.Event()
        self._sequences = [itertools.count(FIRST_SEQUENCE) for _ in range(3)]
        self._unanswered: dict[tuple[int, int], bytes] = {}
        self._received: dict[int, set[int]] = defaultdict(set)
        self._parts: dict[tuple[int, int], dict[int, bytes]] = defaultdict(dict)
        self._stage, self.denied = 0, ""

    def leave(self) -> None:
        """Say so, and end."""
        self._is_leaving.set()
        self.join(2.0)

    def run(self) -> None:
        """The thread: receive, answer, send again what was not acknowledged."""
        self._send_reliable(0, b"")
        for tick in itertools.count():
            if self._is_leaving.is_set():
                break
            if tick % INIT_TICKS == 0 and self._peer and self._stage == 0:
                given = struct.pack(">HBHHH", INIT, SERIALIZATION, 0, *PROTOCOLS)
                self._send(1, bytes((ORIGINAL,)) + given + _pack(self._name))
            if tick % RESEND_TICKS == 0:
                for (channel, _), packet in list(self._unanswered.items()):
                    self._send(channel, packet)
            if tick % PING_TICKS == 0 and self._peer:
                self._send(0, bytes((CONTROL, PING)))
            self._receive_all()
        self._send(0, bytes((CONTROL, DISCONNECT)))
        self._socket.close()

    def _receive_all(self) -> None:
        """What has come within a tick."""
        with contextlib.suppress(TimeoutError, ConnectionError):
            for _ in range(OUT):
                packet, _ = self._socket.recvfrom(OUT)
                self._take(packet[6], packet[7:])

    def _send(self, channel: int, data: bytes) -> None:
        self._socket.sendto(struct.pack(">IHB", PROTOCOL_ID, self._peer, channel) + data, self._address)

    def _send_reliable(self, channel: int, data: bytes) -> None:
        number = next(self._sequences[channel]) % OUT
        packet = struct.pack(">BHB", RELIABLE, number, ORIGINAL) + data
        self._unanswered[channel, number] = packet
        self._send(channel, packet)

    def _take(self, channel: int, data: bytes) -> None:
        kind = data[0]
        if kind == CONTROL and data[1] == ACK:
            self._unanswered.pop((channel, *struct.unpack(">H", data[2:4])), None)
        elif kind == CONTROL and data[1] == SET_PEER:
            (self._peer,) = struct.unpack(">H", data[2:4])
        elif kind == RELIABLE:
            (number,) = struct.unpack(">H", data[1:3])
            self._send(channel, struct.pack(">BBH", CONTROL, ACK, number))
            received = self._received[channel]
            if number not in received:
                received.add(number)
                received.discard((number - OUT // 2) % OUT)
                self._take(channel, data[3:])
        elif kind == SPLIT:
            number, count, index = struct.unpack(">HHH", data[1:7])
            parts = self._parts[channel, number]
            parts[index] = data[7:]
            if len(parts) == count:
                del self._parts[channel, number]
                self._answer(b"".join(parts[each] for each in range(count)))
        elif kind == ORIGINAL:
            self._answer(data[1:])

    def _answer(self, message: bytes) -> None:
        """Take the next step of joining."""
        if len(message) < 2:
            return
        (command,) = struct.unpack(">H", message[:2])
        if command == HELLO and self._stage == 0:
            salt, verifier = struct.pack(">H16s", 16, b"phyagentos-agent"), struct.pack(">H32s", 32, b"v" * 32)
            self._stage = 1
            self._send_reliable(1, struct.pack(">H", FIRST_SRP) + salt + verifier + b"\x01")
        elif command == AUTH_ACCEPT and self._stage == 1:
            self._stage = 2
            self._send_reliable(1, struct.pack(">H", INIT2) + _pack(""))
        elif command == ANNOUNCE_MEDIA and self._stage == 2:
            self._stage = 3
            ready = struct.pack(">HBBBB", CLIENT_READY, 5, 6, 1, 0) + _pack("phyagentos")
            self._send_reliable(1, ready + struct.pack(">H", FORMSPEC))
        elif command == ACCESS_DENIED:
            self.denied = message[2:].decode("ascii", "replace")


def _pack(text: str) -> bytes:
    return struct.pack(">H", len(text)) + text.encode()
