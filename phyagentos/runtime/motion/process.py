"""The planner process and the port through which a worker plans.

A process of its own, so that no search holds up a tick. One request at a time. Cancelling raises
a flag that every search polls; a planner that does not react within the grace, or died, is replaced.
"""

import argparse
import gc
import os
import queue
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.fork_server import start_python
from phyagentos.protocol.documents.schema import Corners
from phyagentos.runtime.channel import SPIN_S, Child
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.motion.requests import Approaches, Cancel, MotionAnswer, MotionRequest, NoPlan, Timing
from phyagentos.runtime.motion.tool_bounds import ANYWHERE, ToolBounds

if TYPE_CHECKING:
    from phyagentos.runtime.motion.planner import MotionPlanner

CANCEL_GRACE_S = 0.5
CLOSE_GRACE_S = 2.0
COMPILE_MAX_S = 60.0  # of a machine with much else to do
GRAPHICS = "MUJOCO_GL"
KEPT = 4  # latest answers that are remembered, by the bytes of their requests

_REQUESTS = Codec[MotionRequest | Cancel](MotionRequest | Cancel, "motion request")
_ANSWERS = Codec[MotionAnswer](MotionAnswer, "answer")


class Planner(Protocol):
    """Answers motion requests, one at a time."""

    @property
    def is_free(self) -> bool:
        """Whether a request may be submitted: `poll` returned the previous answer, or its cancellation is over."""

    def submit(self, request: MotionRequest) -> None:
        """Start a request; the previous one must have been answered or cancelled."""

    def poll(self) -> MotionAnswer | None:
        """The answer, once; None while there is none."""

    def wait(self, timeout_s: float) -> bool:
        """Sleep until there is an answer, at most `timeout_s` [s]; returns whether there is one."""

    def cancel(self) -> None:
        """Cancel the request, if there is one: its answer becomes `NoPlan` with code CANCELLED."""

    def close(self) -> None:
        """Release processes and files."""


class LocalPlanner:
    """The port without a process: plans when polled. For tests and scripts."""

    def __init__(self, planner: "MotionPlanner | NoModel") -> None:
        self._planner = planner
        self._request: MotionRequest | None = None
        self._cancelled = False

    @property
    def is_free(self) -> bool:
        """Whether there is no request, or a cancelled one."""
        return self._request is None or self._cancelled

    def submit(self, request: MotionRequest) -> None:
        """Store the request."""
        self._request, self._cancelled = request, False

    def poll(self) -> MotionAnswer | None:
        """Answer it now."""
        request, self._request = self._request, None
        return None if request is None else self._planner.answer(request, lambda: self._cancelled)

    def wait(self, timeout_s: float) -> bool:
        """There is an answer as soon as there is a request."""
        return self._request is not None

    def cancel(self) -> None:
        """Answer with CANCELLED."""
        self._cancelled = True

    def close(self) -> None:
        """Nothing to release."""


class NoModel:
    """The motion functions of a target without a model: every request is refused."""

    def answer(self, request: MotionRequest, should_cancel: Callable[[], bool] | None = None) -> NoPlan:
        """Refuse it."""
        return _refuse("REQUEST_INVALID", "The target has no model to plan with.")


class PlannerProcess:
    """A planner in its own process, replaced when it dies or ignores a cancellation.

    `bounds` are of its tool, `neighbours` the profiles of the other robots of its world, by name; motions use
    `speed`, a share of the limits.
    """

    def __init__(
        self,
        profile_file: Path,
        bounds: ToolBounds = ANYWHERE,
        neighbours: Mapping[str, Path] | None = None,
        speed: float = 1.0,
    ) -> None:
        command = ["-m", "phyagentos.runtime.motion.process", "--profile", str(profile_file)]
        command += ["--speed", str(speed)]
        command += ["--bounds", msgspec.json.encode(bounds).decode()]
        command += [f"--neighbour={name}={file}" for name, file in (neighbours or {}).items()]
        self._start = partial(Child, command, spin_s=SPIN_S)
        self._clock = SystemClock()
        self._pending = False
        self._deadline_s: float | None = None
        self._child = self._start()

    @property
    def pid(self) -> int:
        """Of the process that works at present."""
        return self._child.pid

    @property
    def is_free(self) -> bool:
        """Whether no request is outstanding; notices the end of a cancelled one."""
        if self._pending and self._deadline_s is not None:
            self.poll()
        return not self._pending

    def submit(self, request: MotionRequest) -> None:
        """Send a request; waits first for the end of a cancelled one.

        Raises:
            RuntimeError: When a request is outstanding that was not cancelled.
        """
        if self._pending and self._deadline_s is None:
            raise RuntimeError("one request at a time: poll the answer or cancel before the next")
        while self._pending:
            self.wait(CANCEL_GRACE_S)
            self.poll()
        self._pending = True
        with suppress(OSError):  # the next poll reports the dead process
            self._child.channel.send_bytes(_REQUESTS.encode(request))

    def poll(self) -> MotionAnswer | None:
        """The answer, once; of a dead process `NoPlan` with code RUNNER_LOST, of a cancelled request CANCELLED."""
        if not self._pending:
            return None
        answer: MotionAnswer | None = None
        try:
            if self._child.channel.poll():
                answer = _ANSWERS.decode(self._child.channel.recv_bytes())
        except (EOFError, OSError):
            code = self._replace()
            answer = _refuse("RUNNER_LOST", f"The planner process ended with code {code}; another one was started.")
        if self._deadline_s is not None:
            if answer is None and self._clock.now_s() >= self._deadline_s:
                self._replace()
                answer = _refuse("CANCELLED", "The planner did not stop in time and was replaced.")
            elif answer is not None:
                answer = _refuse("CANCELLED", "The request was cancelled.")
        if answer is not None:
            self._pending, self._deadline_s = False, None
        return answer

    def wait(self, timeout_s: float) -> bool:
        """Sleep until the process has answered or died, at most `timeout_s` [s]."""
        if self._deadline_s is not None:
            timeout_s = max(0.0, min(timeout_s, self._deadline_s - self._clock.now_s()))
        try:
            return self._child.channel.poll(timeout_s)
        except OSError:
            return True

    def cancel(self) -> None:
        """Raise the flag; the process is replaced unless it answers within `CANCEL_GRACE_S`."""
        if self._pending and self._deadline_s is None:
            self._deadline_s = self._clock.now_s() + CANCEL_GRACE_S
            with suppress(OSError):
                self._child.channel.send_bytes(_REQUESTS.encode(Cancel()))

    def close(self) -> None:
        """End the process."""
        self._child.close(CLOSE_GRACE_S)

    def _replace(self) -> int:
        """Kill the process and start another; returns the exit code of the old one."""
        code = self._child.kill()
        self._child = self._start()
        return code


def _refuse(code: str, message: str) -> NoPlan:
    return NoPlan(code=code, message=message, timing=Timing(ms={}))


class _Inbox:
    """Reads the connection in a thread, so that a flag can be raised while a search runs."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        # a request and the bytes that it came as; None: the other side is gone
        self.requests: queue.SimpleQueue[tuple[bytes, MotionRequest] | None] = queue.SimpleQueue()
        self.cancelled = threading.Event()
        threading.Thread(target=self._read, name="planner-inbox", daemon=True).start()

    def _read(self) -> None:
        while True:
            try:
                data = self._connection.recv_bytes()
                message = _REQUESTS.decode(data)
            except (EOFError, OSError):
                self.cancelled.set()
                self.requests.put(None)
                return
            if isinstance(message, Cancel):
                self.cancelled.set()
            else:
                self.cancelled.clear()
                self.requests.put((data, message))


def serve(
    profile_file: Path,
    bounds: ToolBounds,
    neighbours: Mapping[str, Path],
    speed: float,
    connection: "Connection[Any, Any]",
) -> None:
    """Answer requests until the other side closes.

    The latest approaches are kept: a skill asks first what its preflight asked. Their timing says what they took then.
    """
    from phyagentos.runtime.motion.planner import MotionPlanner  # the port alone loads no simulator

    inbox = _Inbox(connection)
    planner = MotionPlanner.open(profile_file, bounds=bounds, neighbours=neighbours, speed=speed)
    if inbox.requests.empty():
        warm_up(planner)  # else what is asked loads what it needs, and is not kept waiting for the rest
    gc.freeze()  # modules and models stay: they are not searched for garbage in the midst of a request
    gc.enable()
    known: dict[bytes, bytes] = {}
    while (received := inbox.requests.get()) is not None:
        message, request = received
        if (reply := known.get(message)) is None:
            answer = planner.answer(request, inbox.cancelled.is_set)
            reply = _ANSWERS.encode(answer)
            if isinstance(answer, Approaches):
                known = dict([*known.items(), (message, reply)][-KEPT:])
        try:
            connection.send_bytes(reply)
        except OSError:
            return


def warm_up(planner: "MotionPlanner") -> None:
    """Load every kernel; where they are compiled for the first time, a process beside compiles a half of them."""
    from phyagentos.runtime.motion.chain import compute_links

    if not compute_links.stats.cache_misses:
        planner.warm_up()
        return
    as_started = {name: value for name, value in os.environ.items() if name != GRAPHICS}  # so that a server forks it
    command = ["-m", "phyagentos.runtime.motion.path_kernels"]
    beside = start_python(command, environment=as_started, leads_group=False)
    with suppress(subprocess.TimeoutExpired):  # then this one compiles them as well
        planner.warm_up(lambda: beside.wait(COMPILE_MAX_S))


def main() -> None:
    """Entry point of the planner process."""
    parser = argparse.ArgumentParser(description="Answers motion requests for one robot.")
    parser.add_argument("--profile", type=Path, required=True, help="robots/<name>/target.yaml")
    parser.add_argument("--bounds", required=True, help="where the tool may be, as JSON")
    parser.add_argument("--neighbour", action="append", default=[], help="NAME=robots/<name>/target.yaml")
    parser.add_argument("--speed", type=float, required=True, help="share of the speed limits")
    parser.add_argument("--descriptor", type=int, required=True, help="socket to the worker, inherited")
    arguments = parser.parse_args()
    gc.disable()  # until all is loaded
    os.environ[GRAPHICS] = "disable"  # no planner draws
    bounds = msgspec.json.decode(arguments.bounds, type=dict[str, Corners])
    neighbours = {name: Path(file) for name, _, file in (each.partition("=") for each in arguments.neighbour)}
    serve(arguments.profile, bounds, neighbours, arguments.speed, Connection(arguments.descriptor))
    gc.unfreeze()  # at its end the process would report what is frozen as leaked


if __name__ == "__main__":
    main()
