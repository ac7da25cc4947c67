"""A link to the server that can be cut, delayed, or lose the answers: a forwarder of TCP in a thread of its own."""

import asyncio
import contextlib
import threading

LOOK_S = 0.02


class Link:
    """Forwards connections at `port` to the server's port.

    Attributes:
        is_cut: Nothing passes, and nothing is closed: as a pulled cable.
        delay_s: By which everything comes later.
        loses_answers: What the server answers is lost; end it with `break_off`, for the rest makes no sense.
    """

    def __init__(self, upstream: int) -> None:
        self.is_cut, self.delay_s, self.loses_answers = False, 0.0, False
        self._upstream = upstream
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self.port = asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result(10)

    def break_off(self) -> None:
        """Close every connection."""
        self._loop.call_soon_threadsafe(self._close_all)

    def mend(self) -> None:
        """Let everything pass again; after lost answers on new connections."""
        loses, self.loses_answers = self.loses_answers, False
        self.is_cut, self.delay_s = False, 0.0
        if loses:
            self.break_off()

    async def _listen(self) -> int:
        server = await asyncio.start_server(self._forward, "127.0.0.1", 0)
        return int(server.sockets[0].getsockname()[1])

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await self._stand_still()
        try:
            other_reader, other_writer = await asyncio.open_connection("127.0.0.1", self._upstream)
        except OSError:
            writer.close()
            return
        self._writers |= {writer, other_writer}
        asks = self._pump(reader, other_writer, is_answer=False)
        answers = self._pump(other_reader, writer, is_answer=True)
        await asyncio.gather(asks, answers)
        self._writers -= {writer, other_writer}

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, is_answer: bool) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(1 << 16):
                await self._stand_still()
                if not (self.loses_answers and is_answer):
                    self._loop.call_later(self.delay_s, self._write, writer, data)
        writer.close()

    def _write(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        if not writer.is_closing():
            writer.write(data)

    async def _stand_still(self) -> None:
        while self.is_cut:
            await asyncio.sleep(LOOK_S)

    def _close_all(self) -> None:
        for writer in self._writers:
            writer.close()
