"""A server in memory, and connections to it that break: what the port promises, without NATS."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

from phyagentos.fleet.bus import HUB, Bucket, BusLost, Frame, Stored


class FakeServer:
    """What the server holds; revisions grow over all buckets."""

    def __init__(self):
        self.values: dict[Bucket, dict[str, Stored]] = {bucket: {} for bucket in Bucket}
        self.lanes: dict[str, list[Frame]] = defaultdict(list)
        self.objects: dict[str, bytes] = {}
        self.buses: list[FakeBus] = []
        self.revision = 0
        self.loses_offers = False  # the answers to them
        self.lost: set[Bucket] = set()  # without a leader: nothing can be written there

    def write(self, bucket, key, value, by=HUB):
        self.revision += 1
        self.values[bucket][key] = Stored(value, self.revision, by)
        for bus in self.buses:
            if bus.is_connected and bucket in bus.acts:
                bus.acts[bucket](value)
        return self.revision


class FakeBus:
    """One connection, by which its role writes under its own subjects; `loses_answers` lets a call arrive and fail."""

    def __init__(self, server: FakeServer, role: str = HUB):
        self.server, self.role, self.is_connected, self.loses_answers = server, role, True, False
        self.acts: dict[Bucket, Callable[[bytes], None]] = {}
        server.buses.append(self)

    def find_end(self, lane: str) -> int:
        return len(self.server.lanes[lane])

    def fileno(self) -> int:
        return -1

    def drain(self) -> None:
        pass

    def ring(self) -> None:
        pass

    @property
    def bundles(self) -> int:
        return len(self.server.objects)

    def view(self, bucket: Bucket) -> Mapping[str, Stored]:
        return dict(self.server.values[bucket])

    def on_change(self, bucket: Bucket, act: Callable[[bytes], None]) -> None:
        self.acts[bucket] = act

    def get(self, bucket: Bucket, key: str) -> Stored | None:
        self._look()
        return self.server.values[bucket].get(key)

    def put(self, bucket: Bucket, key: str, value: bytes) -> None:
        self._look()
        if bucket in self.server.lost:
            raise BusLost("no leader")
        self.server.write(bucket, key, value, self.role)
        self._answer()
        if self.server.loses_offers and bucket is Bucket.OFFERS:
            raise BusLost("no answer")

    def swap(self, bucket: Bucket, key: str, value: bytes, revision: int) -> int | None:
        self._look()
        found = self.server.values[bucket].get(key, Stored(b"", 0, ""))
        new = self.server.write(bucket, key, value, self.role) if found.revision == revision else None
        self._answer()
        return new

    def put_all(self, values) -> None:
        self._look()
        for (bucket, key), value in values.items():
            self.server.values[bucket].pop(key, None) if value is None else self.put(bucket, key, value)

    def open_all(self, bucket, values):
        return {key: self.swap(bucket, key, value, 0) for key, value in values.items()}

    def count(self, lane: str) -> int:
        self._look()
        return len(self.server.lanes[lane])

    def append(self, lane: str, after: int, frames: Sequence[Frame]) -> None:
        self._look()
        for number, frame in enumerate(frames, after):
            if number != len(self.server.lanes[lane]):
                raise BusLost("wrong last sequence")
            self.server.lanes[lane].append(frame)
        self._answer()

    def read(self, lane: str, after: int, up_to: int) -> list[Frame]:
        self._look()
        return self.server.lanes[lane][after:up_to]

    def read_all(self, wanted):
        return {lane: self.read(lane, *span) for lane, span in wanted.items()}

    def store(self, name: str, data: bytes) -> None:
        self._look()
        self.server.objects.setdefault(name, data)

    def load(self, lane: str, name: str) -> bytes | None:
        self._look()
        return self.server.objects.get(name)

    def close(self) -> None:
        pass

    def _look(self):
        if not self.is_connected:
            raise BusLost("cut")

    def _answer(self):
        if self.loses_answers:
            raise BusLost("no answer")
