"""A TCP relay on this machine that delays, loses and cuts what passes: the network between a worker and its target."""

import contextlib
import socket
import threading
import time

CHUNK = 1 << 16


class FaultyNetwork:
    """Relays every connection from `port` to another port of this machine, in threads of its own.

    Attributes:
        to_port: Where new connections are led to.
        delay_s: Added to everything that passes, each way [s].
        is_lossy: Whether what arrives is lost without a word; connections stay open, as behind a pulled cable.
        passed: Bytes that went towards the target.
    """

    def __init__(self, to_port: int) -> None:
        self.to_port, self.delay_s, self.is_lossy, self.passed = to_port, 0.0, False, 0
        self._is_cut, self._is_closed = False, False
        self._open: set[socket.socket] = set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """End every connection, and each new one at once, until `mend`."""
        self._is_cut = True
        for end in list(self._open):
            self._end(end)

    def mend(self) -> None:
        """Let everything pass again; what was lost stays lost."""
        self._is_cut, self.is_lossy, self.delay_s = False, False, 0.0

    def close(self) -> None:
        """End every connection and listen no more."""
        self._is_closed = True
        self.cut()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            if self._is_cut:
                near.close()
                continue
            try:
                far = socket.create_connection(("127.0.0.1", self.to_port))
            except OSError:
                near.close()
                continue
            self._open |= {near, far}
            for ends in ((near, far), (far, near)):
                threading.Thread(target=self._relay, args=ends, daemon=True).start()

    def _relay(self, source: socket.socket, sink: socket.socket) -> None:
        is_towards_target = sink.getpeername()[1] == self.to_port
        with contextlib.suppress(OSError):
            while data := source.recv(CHUNK):
                if self.delay_s:
                    time.sleep(self.delay_s)  # noqa: TID251 - the delay itself
                if not self.is_lossy:
                    self.passed += len(data) * is_towards_target
                    sink.sendall(data)
        for end in (source, sink):
            self._end(end)

    def _end(self, end: socket.socket) -> None:
        self._open.discard(end)
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()
