"""A link to a server that can be cut, delayed, lose or double messages: a forwarder in a thread of its own.

It forwards NATS protocol frame by frame: what TCP would send again is lost for good here, which is worse.
"""

import asyncio
import contextlib
import random
import threading

LOOK_S = 0.02
_MESSAGES = frozenset({b"PUB", b"HPUB", b"MSG", b"HMSG"})


class Link:
    """Forwards connections at `port` to the server's port.

    Attributes:
        is_cut: Nothing passes, and nothing is closed: as a pulled cable.
        delay_s: By which everything comes later.
        loses_answers: What the server answers is lost; end it with `break_off`, for the rest makes no sense.
        loss: Share of messages that are lost, either direction.
        copies: How often each other one comes.
    """

    def __init__(self, upstream: int) -> None:
        self.is_cut, self.delay_s, self.loses_answers = False, 0.0, False
        self.loss, self.copies = 0.0, 1
        self._chance = random.Random(upstream)
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
        self.is_cut, self.delay_s, self.loss, self.copies = False, 0.0, 0.0, 1
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
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        writing = asyncio.ensure_future(self._write(queue, writer))
        with contextlib.suppress(OSError, EOFError):
            while True:
                data = await reader.readuntil(b"\r\n")
                if is_message := data.split(maxsplit=1)[:1] != [] and data.split(maxsplit=1)[0] in _MESSAGES:
                    data += await reader.readexactly(int(data.split()[-1]) + 2)
                is_lost = (self.loses_answers and is_answer) or (is_message and self._chance.random() < self.loss)
                if not is_lost:
                    queue.put_nowait((self._loop.time() + self.delay_s, data * (self.copies if is_message else 1)))
        writing.cancel()
        writer.close()

    async def _write(self, queue: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
        while not writer.is_closing():
            due_s, data = await queue.get()
            await asyncio.sleep(max(0.0, due_s - self._loop.time()))
            await self._stand_still()
            writer.write(data)

    async def _stand_still(self) -> None:
        while self.is_cut:
            await asyncio.sleep(LOOK_S)

    def _close_all(self) -> None:
        for writer in self._writers:
            writer.close()
