"""The port over NATS JetStream: the one place that imports it.

One stream a lane, in which the number of a message is the number of its record: the server takes a record behind the
one before it or not at all. Four key-value stores, one object store. News are plain subscriptions, which may miss some:
everything is read anew after each break and every few seconds.
"""

import asyncio
import contextlib
import os
import threading
from collections.abc import Awaitable, Callable, Collection, Coroutine, Mapping, Sequence
from functools import partial
from itertools import takewhile
from typing import TypeVar

import nats
import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.js import JetStreamContext, api
from nats.js.kv import KeyValue
from nats.js.object_store import ObjectStore

from phyagentos.clock import SystemClock
from phyagentos.fleet.bus import Bucket, BusLost, Frame, HostCard, Stored, encode_key, hide_token, iter_read

CALL_S = 5.0
RETRY_S = 0.2
PING_S = 2.0  # a peer that answers neither of two is gone: a cut cable closes no connection
RESCAN_S = 5.0
TOGETHER = 64  # requests on their way at once
SEGMENT = "Segment"
LANE = "paos.lane."
_WRONG_SEQUENCE = frozenset({10071, 10164})
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class NatsBus:
    """One connection, kept up for good by a thread of its own.

    Args:
        url: Of the server, `nats://[user:password@]host:port`.
        name: Shown by the server.
        targets: Offers for others are not listened to; None for all, and for claims as well.
    """

    def __init__(self, url: str, *, name: str, targets: Collection[str] | None = None) -> None:
        self._url, self._name, self._shown = url, name, hide_token(url)
        offers = [">"] if targets is None else [f"{encode_key(each)}.>" for each in targets]
        self._wanted = {Bucket.OFFERS: offers, Bucket.HOSTS: [">"], Bucket.STOPS: [">"]}
        self._wanted |= {Bucket.CLAIMS: [">"]} if targets is None else {}
        self._views: dict[Bucket, dict[str, bytes]] = {bucket: {} for bucket in Bucket}
        self._acts: dict[Bucket, Callable[[bytes], None]] = {}
        self._ends: dict[str, int] = {}
        self._news = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._client = Client()
        self._js: JetStreamContext
        self._stores: dict[Bucket, KeyValue] = {}
        self._objects: ObjectStore
        self._known_lanes: set[str] = set()
        self._is_ready, self._why = False, ""
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="fleet", daemon=True)
        self._thread.start()
        self._keeper = asyncio.run_coroutine_threadsafe(self._keep_up(), self._loop)

    @property
    def is_connected(self) -> bool:
        """As of the port."""
        return self._is_ready and self._client.is_connected

    @property
    def ends(self) -> Mapping[str, int]:
        """As of the port."""
        return self._ends

    def fileno(self) -> int:
        """As of the port."""
        return self._news

    def drain(self) -> None:
        """As of the port."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._news)

    def view(self, bucket: Bucket) -> Mapping[str, bytes]:
        """As of the port."""
        return dict(self._views[bucket])

    def on_change(self, bucket: Bucket, act: Callable[[bytes], None]) -> None:
        """As of the port."""
        self._acts[bucket] = act

    def get(self, bucket: Bucket, key: str) -> Stored | None:
        """As of the port."""
        return self._call(lambda: self._get(bucket, key))

    def put(self, bucket: Bucket, key: str, value: bytes) -> None:
        """As of the port."""
        self._call(lambda: self._stores[bucket].put(key, value))

    def swap(self, bucket: Bucket, key: str, value: bytes, revision: int) -> int | None:
        """As of the port."""
        return self._call(lambda: self._swap(bucket, key, value, revision))

    def remove(self, bucket: Bucket, key: str) -> None:
        """As of the port."""
        self._views[bucket].pop(key, None)
        self._call(lambda: self._js.purge_stream(f"KV_paos_{bucket}", subject=f"$KV.paos_{bucket}.{key}"))

    def count(self, lane: str) -> int:
        """As of the port."""
        return self._call(lambda: self._count(lane))

    def append(self, lane: str, after: int, frames: Sequence[Frame]) -> None:
        """As of the port."""
        self._call(lambda: self._append(lane, after, frames))

    def read(self, lane: str, after: int, up_to: int) -> list[Frame]:
        """As of the port."""
        return self._call(lambda: self._read(lane, after, up_to), 4 * CALL_S)

    def store(self, name: str, data: bytes) -> None:
        """As of the port."""
        self._call(lambda: self._store(name, data), 4 * CALL_S)

    def load(self, name: str) -> bytes | None:
        """As of the port."""
        return self._call(lambda: self._load(name), 4 * CALL_S)

    def wait(self, timeout_s: float) -> None:
        """Wait for the connection; raises BusLost."""
        for _ in range(int(timeout_s / RETRY_S)):
            if self.is_connected:
                return
            SystemClock().sleep(RETRY_S)
        raise BusLost(f"no NATS server with JetStream answers at {self._shown}{self._why}")

    def close(self) -> None:
        """As of the port."""
        self._keeper.cancel()
        with contextlib.suppress(Exception):
            asyncio.run_coroutine_threadsafe(self._client.close(), self._loop).result(CALL_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        os.close(self._news)

    def _call(self, work: Callable[[], Coroutine[object, None, _Result]], timeout_s: float = CALL_S) -> _Result:
        if not self.is_connected:
            raise BusLost(f"the NATS server at {self._shown} does not answer{self._why}")
        future = asyncio.run_coroutine_threadsafe(work(), self._loop)
        try:
            return future.result(timeout_s)
        except (nats.errors.Error, TimeoutError, OSError) as error:
            future.cancel()
            raise BusLost(f"the NATS server at {self._shown}: {type(error).__name__} {error}") from error

    async def _keep_up(self) -> None:
        """Connect, then read everything anew after each break and now and then."""
        while True:
            try:
                if not self._client.is_connected and not self._client.is_reconnecting:
                    await self._connect()
                if not self._is_ready:
                    await asyncio.wait_for(self._provide_stores(), CALL_S)
                await asyncio.wait_for(self._rescan(), 2 * CALL_S)
                self._is_ready = True
                self._ring()
                await asyncio.sleep(RESCAN_S if self._client.is_connected else RETRY_S)
            except (nats.errors.Error, TimeoutError, OSError) as error:
                self._is_ready, self._why = False, f": {error}"
                await asyncio.sleep(RETRY_S)

    async def _connect(self) -> None:
        async def lost() -> None:
            self._is_ready = False

        async def ignore(_: Exception) -> None:
            """Each call reports its own."""

        self._client = await nats.connect(
            self._url,
            name=self._name,
            connect_timeout=2,
            allow_reconnect=True,
            max_reconnect_attempts=-1,
            reconnect_time_wait=RETRY_S,
            ping_interval=int(PING_S),
            max_outstanding_pings=2,
            disconnected_cb=lost,
            error_cb=ignore,
        )
        self._js = self._client.jetstream(timeout=CALL_S)
        for bucket, keys in self._wanted.items():
            hear = self._hear_claim if bucket is Bucket.CLAIMS else partial(self._hear, bucket)
            for key in keys:
                await self._client.subscribe(f"$KV.paos_{bucket}.{key}", cb=hear)
        await self._client.subscribe(f"{LANE}>", cb=self._hear_lane)

    async def _provide_stores(self) -> None:
        """After each break: the server may have come back without its disk."""
        self._known_lanes = set()
        for bucket in Bucket:
            self._stores[bucket] = await self._js.create_key_value(bucket=f"paos_{bucket}", history=1, direct=True)
        self._objects = await self._js.create_object_store(bucket="paos_evidence")

    async def _hear(self, bucket: Bucket, message: Msg) -> None:
        key = message.subject.removeprefix(f"$KV.paos_{bucket}.")
        self._views[bucket][key] = message.data
        with contextlib.suppress(KeyError, OSError):  # what an act did not do, the next look does
            self._acts[bucket](message.data)
        self._ring()

    async def _hear_claim(self, message: Msg) -> None:
        """A claim that the server refuses is heard, too: what stands there is asked for."""
        key = message.subject.removeprefix(f"$KV.paos_{Bucket.CLAIMS}.")
        with contextlib.suppress(nats.errors.Error, TimeoutError):  # the next look at everything finds it
            if (found := await self._get(Bucket.CLAIMS, key)) is not None:
                self._views[Bucket.CLAIMS][key] = found.value
                self._ring()

    async def _hear_lane(self, message: Msg) -> None:
        lane, _, seq = (message.headers or {}).get("Nats-Msg-Id", "").rpartition(".")
        if lane:
            self._ends[lane] = max(self._ends.get(lane, 0), int(seq))
            self._ring()

    def _ring(self) -> None:
        os.eventfd_write(self._news, 1)

    async def _rescan(self) -> None:
        for bucket, keys in self._wanted.items():
            found: dict[str, bytes] = {}
            for key in keys:
                names = await self._list_keys(bucket, key)
                values = await _gather(names, partial(self._get, bucket))
                found |= {name: each.value for name, each in zip(names, values, strict=True) if each is not None}
            self._views[bucket] = found
        for card in iter_read(self._views[Bucket.HOSTS].values(), HostCard):
            self._ends[card.lane] = await self._count(card.lane)

    async def _list_keys(self, bucket: Bucket, key: str) -> list[str]:
        prefix = f"$KV.paos_{bucket}."
        info = await self._js.stream_info(f"KV_paos_{bucket}", subjects_filter=f"{prefix}{key}")
        return [each.removeprefix(prefix) for each in info.state.subjects or {}]

    async def _get(self, bucket: Bucket, key: str) -> Stored | None:
        try:
            entry = await self._stores[bucket].get(key)
        except nats.js.errors.KeyNotFoundError:
            return None
        return Stored(entry.value or b"", entry.revision or 0)

    async def _swap(self, bucket: Bucket, key: str, value: bytes, revision: int) -> int | None:
        try:
            return int(await self._stores[bucket].update(key, value, last=revision))
        except nats.js.errors.KeyWrongLastSequenceError:
            return None

    async def _provide(self, lane: str) -> str:
        stream = f"paos_lane_{encode_key(lane)}"
        if lane not in self._known_lanes:
            subject = f"{LANE}{encode_key(lane)}"
            await self._js.add_stream(
                api.StreamConfig(name=stream, subjects=[subject], allow_direct=True, deny_delete=True)
            )
            self._known_lanes.add(lane)
        return stream

    async def _count(self, lane: str) -> int:
        return int((await self._js.stream_info(await self._provide(lane))).state.last_seq)

    async def _append(self, lane: str, after: int, frames: Sequence[Frame]) -> None:
        stream, subject = await self._provide(lane), f"{LANE}{encode_key(lane)}"

        async def send(number: int) -> None:
            frame, seq = frames[number], after + 1 + number
            headers = {
                "Nats-Msg-Id": f"{lane}.{seq}",
                "Nats-Expected-Last-Sequence": str(seq - 1),
                SEGMENT: frame.segment,
            }
            ack = await self._js.publish(subject, frame.data, timeout=CALL_S, stream=stream, headers=headers)
            if ack.seq != seq:
                raise nats.errors.Error(f"record {seq} of lane {lane} became message {ack.seq}")

        await _gather(range(len(frames)), send)

    async def _read(self, lane: str, after: int, up_to: int) -> list[Frame]:
        stream = await self._provide(lane)

        async def load(seq: int) -> Frame | None:
            try:
                message = await self._js.get_msg(stream, seq=seq, direct=True)
            except nats.js.errors.NotFoundError:  # it was heard, and refused
                return None
            return Frame((message.headers or {}).get(SEGMENT, ""), message.data or b"")

        found = takewhile(bool, await _gather(range(after + 1, up_to + 1), load))
        return [frame for frame in found if frame is not None]

    async def _store(self, name: str, data: bytes) -> None:
        try:
            await self._objects.get_info(name)
        except nats.js.errors.NotFoundError:
            await self._objects.put(name, data)

    async def _load(self, name: str) -> bytes | None:
        try:
            return (await self._objects.get(name)).data or b""
        except nats.js.errors.NotFoundError:
            return None


async def _gather(items: Collection[_Item], work: Callable[[_Item], Awaitable[_Result]]) -> list[_Result]:
    """The results of the work for each, in order; begun in order, a bounded number at once."""
    slots, found = asyncio.Semaphore(TOGETHER), list[_Result]()

    async def do(item: _Item) -> _Result:
        async with slots:
            return await work(item)

    for each in await asyncio.gather(*map(do, items), return_exceptions=True):
        if isinstance(each, BaseException):
            raise each
        found.append(each)
    return found
