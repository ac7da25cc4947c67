"""The messages on which a verdict rests: of the first seconds since the beginning, and of the last ones."""

import threading
import time
from collections import deque
from pathlib import Path
from typing import NamedTuple

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

EDGE_S = 3.5  # `paos verify --bag` reads pictures of the first and the last three seconds
_STEP_S = 1.0  # a clock that steps back so far has jumped
_TYPES = get_typestore(Stores.ROS2_HUMBLE)  # the types kept here are the same in every later distribution


class Message(NamedTuple):
    """One message as DDS carried it, and when it was received [ns], by the clock of ROS."""

    topic: str
    type: str
    received_ns: int
    data: bytes


class Recent:
    """Keeps messages, from any thread; of a latched topic the latest (of each frame), from before the beginning too.

    A clock that jumps back makes a new beginning.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latched: dict[tuple[str, ...], Message] = {}
        self._first: list[Message] = []
        self._last: deque[Message] = deque()
        self._heard_s, self._newest_ns = float("-inf"), 0

    def keep(self, message: Message, *, is_latched: bool) -> None:
        """Add one; what is neither among the first nor among the last seconds any more is dropped."""
        with self._lock:
            if is_latched:
                transforms = getattr(_TYPES.deserialize_cdr(message.data, message.type), "transforms", ())
                key = (message.topic, *(each.child_frame_id for each in transforms))
                self._latched[key] = message
                return
            if message.received_ns < self._newest_ns - _STEP_S * 1e9:
                self._forget()
            self._heard_s, self._newest_ns = time.monotonic(), message.received_ns
            begin_ns = (self._first[0] if self._first else message).received_ns
            if message.received_ns - begin_ns <= EDGE_S * 1e9:
                self._first.append(message)
                return
            self._last.append(message)
            while message.received_ns - self._last[0].received_ns > EDGE_S * 1e9:
                self._last.popleft()

    def begin(self) -> None:
        """Forget all but latched messages: criteria that compare with the beginning compare with now."""
        with self._lock:
            self._forget()

    def _forget(self) -> None:
        self._first.clear()
        self._last.clear()
        self._heard_s, self._newest_ns = float("-inf"), 0

    def find_silence(self) -> float:
        """How long no message was received [s]; infinite before the first."""
        return time.monotonic() - self._heard_s

    def write(self, bag: Path) -> None:
        """Write a bag of what is kept; the folder must not exist."""
        with self._lock:
            kept = [*self._first, *self._last]
            begin_ns = min((each.received_ns for each in kept), default=0)
            kept += [each._replace(received_ns=begin_ns) for each in self._latched.values()]
        with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            types = {each.topic: each.type for each in kept}
            topics = {topic: writer.add_connection(topic, kind, typestore=_TYPES) for topic, kind in types.items()}
            for each in sorted(kept, key=lambda each: each.received_ns):
                writer.write(topics[each.topic], each.received_ns, each.data)
