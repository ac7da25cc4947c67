"""Records, in every process of a run, the stacks in which its waypoints are called. Read by `tools/count_hops.py`.

Loaded by the interpreter itself: its folder stands first on PYTHONPATH. Environment: HOPS_PACKAGE is the folder whose
functions count, HOPS_OUT takes one file a process, HOPS_CALLS names the waypoints (qualified names, comma-separated).
"""

import hashlib
import itertools
import json
import os
import sys
import threading
import time
from types import CodeType, FrameType
from typing import Any

PACKAGE = os.environ["HOPS_PACKAGE"] + os.sep
CALLS = frozenset(os.environ["HOPS_CALLS"].split(","))
SEND, RECEIVE, STEP = "Connection._send_bytes", "Connection._recv_bytes", "mj_step"
INLINED = {"<listcomp>", "<genexpr>", "<dictcomp>", "<setcomp>", "<module>"}  # part of the function around them


class Probe:
    """Notes waypoints; a frame is told from a later one at the same address by its number."""

    def __init__(self) -> None:
        folder = os.environ["HOPS_OUT"]
        self._out = open(f"{folder}/{os.getpid()}.jsonl", "w", buffering=1)  # noqa: SIM115, PTH123
        with open("/proc/self/cmdline", encoding="utf-8") as file:  # noqa: PTH123
            self._write({"command": file.read().split("\0")})
        self._count = itertools.count()
        self._numbers: dict[int, int] = {}
        self._kinds: dict[object, tuple[bool, str]] = {}  # code -> whether it counts, and which waypoint it is

    def _write(self, record: dict[str, Any]) -> None:
        self._out.write(json.dumps(record) + "\n")

    def _classify(self, code: CodeType) -> tuple[bool, str]:
        name = code.co_qualname if code.co_qualname in CALLS or code.co_qualname in (SEND, RECEIVE) else ""
        return code.co_filename.startswith(PACKAGE) and code.co_name not in INLINED, name

    def __call__(self, frame: FrameType, event: str, arg: Any) -> None:
        """The interpreter's profile function: called at every call and return."""
        if event == "c_call":
            if arg.__name__ == STEP:
                self._note(STEP, frame)
        elif event == "call":
            code = frame.f_code
            kind = self._kinds.get(code)
            if kind is None:
                kind = self._kinds[code] = self._classify(code)
            if kind[0]:
                self._numbers[id(frame)] = next(self._count)
            if kind[1] and kind[1] != RECEIVE:
                self._note(kind[1], frame, frame.f_locals["buf"] if kind[1] == SEND else None)
        elif event == "return":
            counts, name = self._kinds.get(frame.f_code, (False, ""))
            if name == RECEIVE and arg is not None:
                self._note(RECEIVE, frame, arg.getvalue())
            if counts:
                self._numbers.pop(id(frame), None)

    def _note(self, name: str, frame: FrameType | None, message: bytes | None = None) -> None:
        stack = []
        while frame is not None:
            number = self._numbers.get(id(frame))
            if number is not None:
                code = frame.f_code
                stack.append((number, code.co_filename[len(PACKAGE) :], code.co_qualname))
            frame = frame.f_back
        record = {"at": time.monotonic_ns(), "name": name, "stack": stack[::-1]}
        if message is not None:
            data = bytes(message)
            record |= {"message": hashlib.sha256(data).hexdigest()[:16], "head": data[:24].decode("latin-1")}
        self._write(record)


def load_unprofiled(load: Any) -> Any:
    """Modules are loaded without the profile function: that is most of what a process does, and no way leads there."""

    def load_one(spec: Any) -> Any:
        sys.setprofile(None)
        try:
            return load(spec)
        finally:
            sys.setprofile(_probe)

    return load_one


if "phyagentos" in " ".join(sys.orig_argv):
    _probe = Probe()
    _bootstrap: Any = sys.modules["_frozen_importlib"]
    _bootstrap._load_unlocked = load_unprofiled(_bootstrap._load_unlocked)
    threading.setprofile(_probe)
    sys.setprofile(_probe)
