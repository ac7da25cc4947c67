"""WebSocket connections without a thread of their own: the library's protocol over a plain socket.

The thread that steps a simulation reads its client itself, between two steps: a thread beside it would take the
interpreter from it in the middle of one. What cannot wait is done by one more thread, which sleeps: it lets clients
in, keeps those alive that wait for their turn, and answers pings while a request takes longer than `LOOK_S`.
"""

import contextlib
import select
import socket
import ssl
import struct
import threading
import time
from collections import deque
from typing import Any

from websockets.frames import CloseCode, Frame, Opcode, apply_mask  # type: ignore[attr-defined]  # compiled where it can be
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from target_server import wire
from target_server.served import Client
from target_server.wire import MESSAGE_MAX_BYTES

OPEN_S = 5.0  # until a client has said that it speaks WebSocket
PING_S = 5.0  # between two pings, and until the answer: a dead connection makes room for the next client
CLOSE_S = 0.5  # for the last words
LOOK_S = 1.0
BACKLOG = 8  # clients that wait for their turn
READ_AHEAD = 8  # messages that may wait for theirs; a client sends one or two
CHUNK_BYTES = 2**12
DRAIN_BYTES = 2**18  # at a time, of what nobody reads any more: who says too much must get to read why
READ_S = 0.005  # of reading at a time: pings without end must not keep a body from its stops
MESSAGE = 0x82  # first byte of a frame that is a whole binary message (RFC 6455, 5.2)
MASKED = 0x80  # in its second byte, as in every frame of a client
MASK_BYTES = 4
LONG = {126: 4, 127: 10}  # bytes of its head, without the mask, by what stands for a length that needs more than one
_LATER = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


class Connection(Client):
    """One client. Both threads may use it: whoever reads or writes has its lock."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket, self._protocol = connection, ServerProtocol(origins=[None], max_size=MESSAGE_MAX_BYTES)
        self._received, self._fragments = deque[bytes](), list[Any]()
        self._unread = bytearray()  # the beginning of a frame
        self._lock, self._is_over = threading.Lock(), False
        self._patience_s = 0.0  # for one that does not read what it is sent
        self._since_s = self._read_s = self._heard_s = self._pinged_s = time.monotonic()
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(connection, select.POLLIN)
        self._writable.register(connection, select.POLLOUT)

    def fileno(self) -> int:
        """Of its socket."""
        return self._socket.fileno()

    @property
    def is_open(self) -> bool:
        """Whether both ends may send."""
        return not self._is_over and self._protocol.state is State.OPEN

    @property
    def may_stay(self) -> bool:
        """Whether it may wait at the door: it is open, or may yet be, and does not say more than a greeting."""
        is_early = time.monotonic() - self._since_s < OPEN_S and self._protocol.state is State.CONNECTING
        is_coming = is_early and not self._is_over and self._protocol.handshake_exc is None
        n_bytes = sum(map(len, (self._unread, *self._fragments, *self._received)))
        return is_coming or (self.is_open and len(self._received) < READ_AHEAD and n_bytes <= CHUNK_BYTES)

    def serve(self) -> None:
        """Its turn has come."""
        self._patience_s = PING_S

    def poll(self, timeout_s: float) -> bool:
        """Whether a message is there; raises EOFError when the client is gone."""
        with self._lock:
            until_s = time.monotonic() + timeout_s
            self._read()
            while not self._received:
                if not self.is_open:
                    raise EOFError("the client is gone")
                if (left_s := until_s - time.monotonic()) <= 0.0:
                    return False
                self._readable.poll(1e3 * min(left_s, LOOK_S))
                self._read()
                self._keep_alive()
            return True

    def receive(self) -> bytes:
        """The oldest message, after `poll` has said that there is one."""
        return self._received.popleft()

    def send(self, message: bytes) -> None:
        """Send one; a client that is gone is met at the next read."""
        with self._lock:
            if self.is_open:
                self._write(make_head(len(message)) + message)

    def wants_end(self) -> bool:
        """A `Describe` behind the request that is carried out means: end it. Commands may wait before it."""
        with self._lock:
            self._read()
            return not self.is_open or any(map(wire.is_describe, self._received))

    def beat(self) -> None:
        """Send a sign of life."""
        self.send(wire.encode("Beat"))

    def tend(self) -> None:
        """From the other thread: read and answer pings, where the thread that serves it has not for a while."""
        if self._lock.acquire(blocking=False):
            try:
                if not self._patience_s or time.monotonic() - self._read_s > LOOK_S:
                    self._read()
                    self._keep_alive()
            finally:
                self._lock.release()

    def close(self) -> None:
        """End the connection, and wait a moment for the client to do so: what it was sent must not be lost.

        One that still sends, as a message that is too long, gets longer to read why.
        """
        with self._lock:
            self._patience_s, until_s = CLOSE_S, time.monotonic() + OPEN_S
            if self.is_open:
                self._protocol.send_close(CloseCode.NORMAL_CLOSURE)
            self._flush()
            while not self._is_over and time.monotonic() < until_s and self._readable.poll(1e3 * CLOSE_S):
                self._received.clear()
                self._read()
            self.drop()

    def drop(self) -> None:
        """End it at once."""
        self._is_over = True
        self._socket.close()

    def _read(self) -> None:
        """Take what has come, up to a limit, and answer what the protocol itself answers."""
        self._read_s = now_s = time.monotonic()
        while not self._is_over and len(self._received) < READ_AHEAD and now_s - self._read_s < READ_S:
            try:
                data = self._socket.recv(CHUNK_BYTES if self.is_open else DRAIN_BYTES)
            except _LATER:
                return
            except OSError:
                data = b""
            self._heard_s, self._is_over = self._read_s, not data
            if self.is_open:
                self._unread += data
                self._split()
            else:
                self._pass_on(data)
            now_s = time.monotonic()

    def _split(self) -> None:
        """Take what is whole. A frame that is a message is unmasked here; the library gets each other, as it is."""
        while self.is_open and len(self._unread) > 1:
            size = self._unread[1] & ~MASKED
            start = LONG.get(size, 2)
            if start > 2:
                if len(self._unread) < start:
                    return
                size = int.from_bytes(self._unread[2:start], "big")
            end = start + MASK_BYTES + size
            if size > MESSAGE_MAX_BYTES or self._unread[1] < MASKED:  # the library ends the connection
                end = len(self._unread)
            elif len(self._unread) < end:
                return
            frame = bytes(self._unread[:end])
            del self._unread[:end]
            if frame[0] == MESSAGE and frame[1] >= MASKED and size <= MESSAGE_MAX_BYTES and not self._fragments:
                self._received.append(apply_mask(frame[start + MASK_BYTES :], frame[start : start + MASK_BYTES]))
            else:
                self._pass_on(frame)

    def _pass_on(self, data: bytes) -> None:
        """To the library."""
        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            self._take(event)
        self._flush()

    def _take(self, event: Any) -> None:
        """An event of the protocol."""
        if isinstance(event, Request):
            self._protocol.send_response(self._protocol.accept(event))
        elif isinstance(event, Frame) and event.opcode is Opcode.TEXT:
            self._protocol.fail(CloseCode.UNSUPPORTED_DATA, "a text frame; the wire has binary ones only")
        elif isinstance(event, Frame) and event.opcode in {Opcode.BINARY, Opcode.CONT}:
            self._fragments.append(event.data)
            if event.fin:
                self._received.append(b"".join(self._fragments))
                self._fragments.clear()

    def _keep_alive(self) -> None:
        """Ping a client that is silent; one that does not answer in time is gone."""
        now_s = time.monotonic()
        if self._pinged_s > self._heard_s:
            self._is_over = self._is_over or now_s - self._pinged_s > PING_S
        elif now_s - self._heard_s > PING_S and self.is_open:
            self._protocol.send_ping(b"")
            self._flush()
            self._pinged_s = now_s

    def _flush(self) -> None:
        """Write what the library has to say; nothing stands for the end."""
        for data in self._protocol.data_to_send():
            if data:
                self._write(data)
            else:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)

    def _write(self, data: bytes) -> None:
        """All of it, unless the client does not read."""
        while data and not self._is_over:
            try:
                data = data[self._socket.send(data) :]
            except _LATER:
                self._is_over = not self._writable.poll(1e3 * self._patience_s)
            except OSError:
                self._is_over = True


def make_head(size: int) -> bytes:
    """What precedes a message of so many bytes in a frame of a server."""
    if size < min(LONG):
        return bytes((MESSAGE, size))
    return struct.pack("!BBH", MESSAGE, 126, size) if size < 2**16 else struct.pack("!BBQ", MESSAGE, 127, size)


class Door:
    """Lets clients in at a port; 0 takes a free one."""

    def __init__(self, host: str, port: int, tls: ssl.SSLContext | None) -> None:
        self._listener, self._tls = socket.create_server((host, port)), tls
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._coming, self._served = list[Connection](), list[Connection]()
        self._changed, self._is_closed = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="door", daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float) -> Connection | None:
        """The client whose turn it is, None where none is open in time."""
        with self._changed:
            client = self._changed.wait_for(self._find_open, timeout_s)
            if client is not None:
                client.serve()
                self._coming.remove(client)
            self._served = [] if client is None else [client]
            return client

    def close(self) -> None:
        """Let no further client in."""
        self._is_closed = True
        self._listener.shutdown(socket.SHUT_RDWR)  # wakes the thread
        self._thread.join()
        self._listener.close()
        for each in self._coming:
            each.close()

    def _find_open(self) -> Connection | None:
        return next((each for each in self._coming if each.is_open), None)

    def _run(self) -> None:
        """Until it is closed: sleep, but for those that come and those that wait."""
        while not self._is_closed:
            awaited = select.poll()
            with self._changed:
                for number in (self._listener.fileno(), *(each.fileno() for each in self._coming)):
                    awaited.register(number, select.POLLIN)
            awaited.poll(1e3 * LOOK_S)
            with self._changed:
                self._admit()
                for client in (*self._coming, *self._served):
                    client.tend()
                for client in self._coming:
                    if not client.may_stay:
                        client.drop()
                self._coming = [each for each in self._coming if each.may_stay]
                self._changed.notify()

    def _admit(self) -> None:
        """Newcomers, as many as may wait; one takes the place of who has said nothing for longest."""
        with contextlib.suppress(OSError):  # no more, or one that is gone again
            while True:
                connection, _ = self._listener.accept()
                connection.setblocking(False)
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                if len(self._coming) >= BACKLOG:
                    silent = next((each for each in self._coming if not each.is_open), None)
                    if silent is None:
                        connection.close()
                        continue
                    self._coming.remove(silent)
                    silent.drop()
                if self._tls is not None:
                    connection = self._tls.wrap_socket(connection, server_side=True, do_handshake_on_connect=False)
                self._coming.append(Connection(connection))
