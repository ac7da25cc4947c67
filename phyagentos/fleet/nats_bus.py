"""The port over NATS JetStream: the one place that imports it.

One stream a lane, in which the number of a message is the number of its record: the server takes a record behind the
one before it or not at all. Four key-value stores; an object store a lane. Each writes under subjects of its own, so
that a server with `server.py`'s rights refuses what is another's; a claim is compared and set over all who may write
it. Only the hub makes streams. News are plain subscriptions, which may miss some: everything is read anew after each
break and every few seconds.
"""

import asyncio
import base64
import contextlib
import hashlib
import os
import threading
from collections.abc import Awaitable, Callable, Collection, Coroutine, Mapping, Sequence
from functools import partial
from itertools import takewhile
from typing import TypeVar

import msgspec
import nats
import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.js import JetStreamContext, api
from nats.js.object_store import ObjectStore

from phyagentos.clock import SystemClock
from phyagentos.fleet.bus import HUB, Bucket, BusLost, Frame, Stored, decode_key, encode_key, hide_token, read_cards
from phyagentos.fleet.subjects import LANE, NEWS, locate, locate_claim, name_evidence, name_inbox, name_lane, name_store

CALL_S = 5.0
RETRY_S = 0.2
PING_S = 2.0  # a peer that answers neither of two is gone: a cut cable closes no connection
RESCAN_S = 5.0
HEARD_MAX = 4096  # records of a lane that wait to be read; others are asked for
TOGETHER = 64  # requests on their way at once
CHUNK_BYTES = 1 << 17  # of an object in one message
SEGMENT = "Segment"
_WRONG_SEQUENCE = 10071
_IN_PROCESS = frozenset({10158, 10164})  # a copy, or another message there, is not stored yet: undecided
_ID = "Nats-Msg-Id"
_LAST, _OF = "Nats-Expected-Last-Subject-Sequence", "Nats-Expected-Last-Subject-Sequence-Subject"
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class NatsBus:
    """One connection, kept up for good by a thread of its own.

    Args:
        url: Of the servers, `nats://[user:password@]host:port`, several with commas; `tls://` encrypts.
        name: Shown by the server.
        role: `HUB`, which makes the streams and hears everything; the lane of a host; or another, which only looks.
        targets: Whose offers a host listens to; None for one that is no host.
    """

    def __init__(self, url: str, *, name: str, role: str = HUB, targets: Collection[str] | None = None) -> None:
        self._url, self._name, self._shown = url, name, hide_token(url)
        self._role, self._token, self._is_hub = role, encode_key(role), role == HUB
        self._wanted = {bucket: [">"] for bucket in Bucket}
        if targets is not None:
            self._wanted = {Bucket.OFFERS: [f"{encode_key(each)}.>" for each in targets], Bucket.STOPS: [">"]}
        self._views: dict[Bucket, dict[str, Stored]] = {bucket: {} for bucket in Bucket}
        self._changed: dict[Bucket, set[str]] = {bucket: set() for bucket in Bucket}  # since a look at all began
        self._acts: dict[Bucket, Callable[[bytes], None]] = {}
        self._ends: dict[str, int] = {}
        self._heard: dict[str, dict[int, Frame]] = {}  # records of lanes that came as news, until they are read
        self._bundles = 0
        self._news = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._client = Client()
        self._js: JetStreamContext
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

    def find_end(self, lane: str) -> int:
        """As of the port."""
        return self._ends.get(encode_key(lane), 0)

    def fileno(self) -> int:
        """As of the port."""
        return self._news

    def drain(self) -> None:
        """As of the port."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._news)

    def ring(self) -> None:
        """As of the port."""
        with contextlib.suppress(OSError):  # closed since
            os.eventfd_write(self._news, 1)

    @property
    def bundles(self) -> int:
        """As of the port."""
        return self._bundles

    def view(self, bucket: Bucket) -> Mapping[str, Stored]:
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
        self.put_all({(bucket, key): value})

    def put_all(self, values: Mapping[tuple[Bucket, str], bytes | None]) -> None:
        """As of the port."""
        self._call(lambda: _gather(values, lambda key: self._put(*key, values[key])))

    def open_all(self, bucket: Bucket, values: Mapping[str, bytes]) -> dict[str, int | None]:
        """As of the port."""
        found = self._call(lambda: _gather(values, lambda key: self._swap(bucket, key, values[key], 0)))
        return dict(zip(values, found, strict=True))

    def swap(self, bucket: Bucket, key: str, value: bytes, revision: int) -> int | None:
        """As of the port."""
        return self._call(lambda: self._swap(bucket, key, value, revision))

    def count(self, lane: str) -> int:
        """As of the port."""
        return self._call(lambda: self._count(lane))

    def append(self, lane: str, after: int, frames: Sequence[Frame]) -> None:
        """As of the port."""
        self._call(lambda: self._append(lane, after, frames))

    def read(self, lane: str, after: int, up_to: int) -> list[Frame]:
        """As of the port."""
        return self._call(lambda: self._read(lane, after, up_to), 4 * CALL_S)

    def read_all(self, wanted: Mapping[str, tuple[int, int]]) -> dict[str, list[Frame]]:
        """As of the port."""
        found = self._call(lambda: _gather(wanted, lambda lane: self._read(lane, *wanted[lane])), 4 * CALL_S)
        return dict(zip(wanted, found, strict=True))

    def store(self, name: str, data: bytes) -> None:
        """As of the port."""
        self._call(lambda: self._store(name, data), 4 * CALL_S)

    def load(self, lane: str, name: str) -> bytes | None:
        """As of the port."""
        return self._call(lambda: self._load(lane, name), 4 * CALL_S)

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
            asyncio.run_coroutine_threadsafe(self._let_go(), self._loop).result(CALL_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        news, self._news = self._news, -1  # its number may be another file's soon
        os.close(news)

    async def _let_go(self) -> None:
        with contextlib.suppress(Exception):
            await self._client.close()
        left = asyncio.all_tasks() - {asyncio.current_task()}
        for each in left:
            each.cancel()
        await asyncio.gather(*left, return_exceptions=True)

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
                if not self._is_ready and self._is_hub:
                    await asyncio.wait_for(self._provide_stores(), CALL_S)
                await asyncio.wait_for(self._rescan(), 2 * CALL_S)
                self._is_ready = True
                self._bundles += 1  # or so many: news may have been missed
                self.ring()
                await asyncio.sleep(RESCAN_S if self._client.is_connected else RETRY_S)
            except Exception as error:  # whatever a server answers: nothing else brings the connection back
                is_new = isinstance(error, nats.js.errors.NotFoundError)
                self._is_ready, self._why = False, ": `paos fleet lead` has not run yet" if is_new else f": {error}"
                await asyncio.sleep(RETRY_S)

    async def _connect(self) -> None:
        async def lost() -> None:
            self._is_ready = False

        async def note(error: Exception) -> None:
            self._why = f": {error}"  # such as a subject that is another's; each call reports its own

        self._client = await nats.connect(
            self._url.split(","),
            name=self._name,
            inbox_prefix=name_inbox(self._role),
            connect_timeout=2,
            allow_reconnect=True,
            max_reconnect_attempts=-1,
            reconnect_time_wait=RETRY_S,
            ping_interval=int(PING_S),
            max_outstanding_pings=2,
            disconnected_cb=lost,
            error_cb=note,
        )
        self._js = self._client.jetstream(timeout=CALL_S)
        for bucket, keys in self._wanted.items():
            for key in keys:
                await self._client.subscribe(f"{NEWS}{locate(bucket)}{key}", cb=partial(self._hear, bucket))
        if self._is_hub:
            await self._client.subscribe(f"{NEWS}{LANE}>", cb=self._hear_lane)
            await self._client.subscribe(f"{NEWS}$O.>", cb=self._hear_bundle)

    async def _provide_stores(self) -> None:
        """After each break: the server may have come back without its disk. Rollups could empty a store: none here."""
        self._known_lanes = set()
        for bucket in Bucket:
            await self._provide(name_store(bucket), [f"{locate(bucket)}>"], max_msgs_per_subject=1)

    async def _provide(self, stream: str, subjects: list[str], **settings: int | bool) -> None:
        """A stream that makes news of what it has taken: what it refused is not heard, nor anything too early."""
        replicas = min(3, len(self._url.split(",")))
        config = api.StreamConfig(name=stream, subjects=subjects, num_replicas=replicas, allow_direct=True)
        news = api.RePublish(src=subjects[0], dest=f"{NEWS}{subjects[0]}")
        await self._js.add_stream(config, deny_delete=True, discard=api.DiscardPolicy.NEW, republish=news, **settings)

    async def _hear(self, bucket: Bucket, message: Msg) -> None:
        key = message.subject.removeprefix(f"{NEWS}{locate(bucket)}")
        revision = int((message.headers or {}).get("Nats-Sequence", "0"))
        self._note(bucket, _find_key(bucket, key), found := Stored(message.data, revision, _find_writer(key)))
        with contextlib.suppress(KeyError, OSError):  # what an act did not do, the next look does
            self._acts[bucket](message.data)
        if self._is_hub and bucket is Bucket.HOSTS:
            with contextlib.suppress(nats.errors.Error, TimeoutError):
                for card in read_cards({key: found}):
                    await self._provide_lane(card.host)

    def _note(self, bucket: Bucket, key: str, value: Stored | None) -> None:
        self._changed[bucket].add(key)
        if value is None:
            self._views[bucket].pop(key, None)
        else:
            self._views[bucket][key] = value
        self.ring()

    async def _hear_lane(self, message: Msg) -> None:
        lane, headers = message.subject.removeprefix(f"{NEWS}{LANE}"), message.headers or {}
        seq, heard = int(headers.get("Nats-Sequence", "0")), self._heard.setdefault(lane, {})
        if len(heard) < HEARD_MAX:
            heard[seq] = Frame(headers.get(SEGMENT, ""), message.data)
        self._ends[lane] = max(self._ends.get(lane, 0), seq)
        self.ring()

    async def _hear_bundle(self, _: Msg) -> None:
        self._bundles += 1
        self.ring()

    async def _rescan(self) -> None:
        for bucket, keys in self._wanted.items():
            self._changed[bucket] = set()
            found: dict[str, Stored] = {}
            for key in keys:
                names = await self._list_keys(bucket, key)
                values = await _gather(names, partial(self._get, bucket))
                found |= {name: each for name, each in zip(names, values, strict=True) if each is not None}
            newer = {key: self._views[bucket].get(key) for key in self._changed[bucket]}
            self._views[bucket] = {key: each for key, each in (found | newer).items() if each is not None}
        for card in read_cards(self._views[Bucket.HOSTS]) if self._is_hub else ():
            self._ends[encode_key(card.host)] = await self._count(card.host)

    async def _list_keys(self, bucket: Bucket, key: str) -> list[str]:
        prefix = locate(bucket)
        info = await self._js.stream_info(name_store(bucket), subjects_filter=f"{prefix}{key}")
        names = [each.removeprefix(prefix) for each in info.state.subjects or {}]
        return [*dict.fromkeys(_find_key(bucket, each) for each in names)]

    async def _get(self, bucket: Bucket, key: str) -> Stored | None:
        """As the leader has it: a copy may be behind."""
        try:
            found = await self._js.get_last_msg(name_store(bucket), _cover(bucket, key))
        except nats.js.errors.NotFoundError:
            return None
        return Stored(found.data or b"", found.seq or 0, _find_writer(found.subject or ""))

    async def _swap(self, bucket: Bucket, key: str, value: bytes, revision: int) -> int | None:
        """A claim stands under the subject of its writer; the latest of all is the one that counts."""
        subject = f"{locate(bucket)}{key}" if bucket is not Bucket.CLAIMS else locate_claim(key, self._token)
        try:
            return await self._publish(subject, value, {_LAST: str(revision), _OF: _cover(bucket, key)})
        except nats.js.errors.APIError as error:
            if error.err_code == _WRONG_SEQUENCE:
                return None
            raise

    async def _publish(self, subject: str, value: bytes, headers: dict[str, str]) -> int:
        """The number of a message behind another one; of one that comes twice, each copy has the answer of the first.

        Without an id the second copy is refused, and a cluster says so before it has stored the first.
        """
        headers = {_ID: os.urandom(12).hex()} | headers
        while True:
            try:
                return int((await self._js.publish(subject, value, timeout=CALL_S, headers=headers)).seq)
            except nats.js.errors.APIError as error:
                if error.err_code not in _IN_PROCESS:
                    raise
            await asyncio.sleep(RETRY_S / 10.0)

    async def _put(self, bucket: Bucket, key: str, value: bytes | None) -> None:
        if value is not None:
            await self._js.publish(f"{locate(bucket)}{key}", value, timeout=CALL_S)
            return
        await self._js.purge_stream(name_store(bucket), subject=_cover(bucket, key))
        self._note(bucket, key, None)

    async def _provide_lane(self, lane: str) -> str:
        """The stream of a lane, which the hub makes, with the store of its evidence."""
        token, stream = encode_key(lane), name_lane(lane)
        if self._is_hub and lane not in self._known_lanes:
            await self._provide(stream, [f"{LANE}{token}"])
            objects = name_evidence(token)
            await self._provide(f"OBJ_{objects}", [f"$O.{objects}.M.>", f"$O.{objects}.C.>"], allow_rollup_hdrs=True)
            self._known_lanes.add(lane)
        return stream

    async def _count(self, lane: str) -> int:
        return int((await self._js.stream_info(await self._provide_lane(lane))).state.last_seq)

    async def _append(self, lane: str, after: int, frames: Sequence[Frame]) -> None:
        stream, subject = await self._provide_lane(lane), f"{LANE}{encode_key(lane)}"

        async def send(number: int) -> None:
            frame, seq = frames[number], after + 1 + number
            headers = {
                _ID: f"{lane}.{seq}",
                "Nats-Expected-Last-Sequence": str(seq - 1),
                "Nats-Expected-Stream": stream,
                SEGMENT: frame.segment,
            }
            if (found := await self._publish(subject, frame.data, headers)) != seq:
                raise nats.errors.Error(f"record {seq} of lane {lane} became message {found}")

        await _gather(range(len(frames)), send)

    async def _read(self, lane: str, after: int, up_to: int) -> list[Frame]:
        stream, heard = await self._provide_lane(lane), self._heard.pop(encode_key(lane), {})

        async def load(seq: int) -> Frame | None:
            if seq in heard:
                return heard[seq]
            try:
                message = await self._js.get_msg(stream, seq=seq, direct=True)
            except nats.js.errors.NotFoundError:  # it was heard, and refused
                return None
            return Frame((message.headers or {}).get(SEGMENT, ""), message.data or b"")

        found = takewhile(bool, await _gather(range(after + 1, up_to + 1), load))
        return [frame for frame in found if frame is not None]

    async def _store(self, name: str, data: bytes) -> None:
        """An object is listed once all its chunks are there. What broke off goes on, and nothing is taken back.

        `ObjectStore.put` removes the chunks when the answer to the list is lost, though the list may be there.
        """
        objects, place, sha256 = self._open_objects(self._token), name_evidence(self._token), hashlib.sha256(data)
        with contextlib.suppress(nats.js.errors.NotFoundError):
            await objects.get_info(name)
            return
        chunks, last, sent = f"$O.{place}.C.{sha256.hexdigest()}", 0, 0
        with contextlib.suppress(nats.js.errors.NotFoundError):
            last = (await self._js.get_last_msg(f"OBJ_{place}", chunks)).seq or 0
            found = await self._js.stream_info(f"OBJ_{place}", subjects_filter=chunks)
            sent = (found.state.subjects or {}).get(chunks, 0)
        for at in range(CHUNK_BYTES * sent, len(data), CHUNK_BYTES):
            last = await self._publish(chunks, data[at : at + CHUNK_BYTES], {_LAST: str(last)})
        info = api.ObjectInfo(
            name=name,
            bucket=place,
            nuid=sha256.hexdigest(),
            size=len(data),
            chunks=-(-len(data) // CHUNK_BYTES),
            digest=f"SHA-256={_encode(sha256.digest())}",
        )
        listed, headers = msgspec.json.encode(info.as_dict()), {api.Header.ROLLUP: "sub"}
        await self._js.publish(f"$O.{place}.M.{_encode(name.encode())}", listed, timeout=CALL_S, headers=headers)

    async def _load(self, lane: str, name: str) -> bytes | None:
        objects, stream = self._open_objects(encode_key(lane)), name_evidence(encode_key(lane))
        try:
            info = await objects.get_info(name)
        except nats.js.errors.NotFoundError:
            return None
        with contextlib.suppress(nats.js.errors.NotFoundError, nats.js.errors.DigestMismatchError):
            last = await self._js.get_last_msg(f"OBJ_{stream}", f"$O.{stream}.C.{info.nuid}")
            return (last if info.chunks == 1 else await objects.get(name)).data or b""  # a consumer takes round trips
        return b""  # empty, or damaged: its sum shows it

    def _open_objects(self, token: str) -> ObjectStore:
        return ObjectStore(name=name_evidence(token), stream=f"OBJ_{name_evidence(token)}", js=self._js)


def _encode(data: bytes) -> str:
    """As in the names and sums of an object store."""
    return base64.urlsafe_b64encode(data).decode()


def _cover(bucket: Bucket, key: str) -> str:
    """The subject of a value; of a claim, those of all its writers."""
    return locate_claim(key, "*") if bucket is Bucket.CLAIMS else f"{locate(bucket)}{key}"


def _find_key(bucket: Bucket, subject: str) -> str:
    """Of a subject behind that of the bucket; several may write a claim."""
    return subject.partition(".")[0] if bucket is Bucket.CLAIMS else subject


def _find_writer(subject: str) -> str:
    """The last token names it where several may write."""
    return decode_key(subject.rpartition(".")[2])


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
