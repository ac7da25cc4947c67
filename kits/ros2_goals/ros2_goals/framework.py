"""What other processes may do with a workspace of phyagentos: its tools over MCP, its commands, its journal."""

import json
import queue
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ros2_goals.processes import make_environment, start, start_kept

_PROTOCOL = "2025-06-18"  # of MCP: what this client speaks
_STOP_S, _CALL_S, _COMMAND_S = 3.0, 60.0, 120.0
_AGAIN_S = 1.0
Record = Mapping[str, Any]


class Refused(Exception):
    """The framework refused, or is gone; the message says what, where and what is possible."""


class Gone(Refused):
    """The tools do not answer."""


class Tools:
    """The tools of one workspace, over the standard streams of `paos mcp`, which is started anew when it has ended."""

    def __init__(self, command: list[str]) -> None:
        self._command, self._lock = command, threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._waiting: dict[int, queue.SimpleQueue[Record]] = {}
        self._number = 0

    def call(self, tool: str, *, patience_s: float = _CALL_S, **arguments: Any) -> Record:
        """The facts that a tool answers; raises `Refused` with every problem, and where no answer comes in time."""
        if not self._lock.acquire(timeout=patience_s):
            raise Gone(f"{tool}: {' '.join(self._command)} has not begun within {patience_s:g} s")
        try:
            if self._process is None or self._process.poll() is not None:
                self._open()
            answer = self._send("tools/call", {"name": tool, "arguments": arguments})
        finally:
            self._lock.release()
        return _read(tool, self._await(answer, tool, patience_s))

    def open(self) -> None:
        """Start them, so that the first call need not wait; raises `Refused`."""
        with self._lock:
            self._open()

    def _open(self) -> None:
        try:
            self._process = start(self._command, stdout=subprocess.PIPE)
        except OSError as error:
            raise Gone(f"{error}; expected the command of an environment that has phyagentos[mcp]") from error
        threading.Thread(target=self._listen, args=[self._process], daemon=True).start()
        about = {"name": "ros2_goals", "version": "0.1.0"}
        greeting = {"protocolVersion": _PROTOCOL, "capabilities": {}, "clientInfo": about}
        self._await(self._send("initialize", greeting), "the greeting", _CALL_S)
        self._write({"method": "notifications/initialized"})

    def _send(self, method: str, parameters: Record) -> "queue.SimpleQueue[Record]":
        self._number += 1
        answer = self._waiting[self._number] = queue.SimpleQueue()
        self._write({"id": self._number, "method": method, "params": parameters})
        return answer

    def _write(self, message: Record) -> None:
        assert self._process is not None, "it was opened before"
        assert self._process.stdin is not None, "a pipe"
        try:
            self._process.stdin.write(json.dumps({"jsonrpc": "2.0", **message}) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise Gone(f"{' '.join(self._command)}: {error}; what it printed says why") from error

    def _await(self, answer: "queue.SimpleQueue[Record]", what: str, patience_s: float) -> Record:
        try:
            found = answer.get(timeout=patience_s)
        except queue.Empty:
            raise Gone(f"{what}: no answer within {patience_s:g} s from {' '.join(self._command)}") from None
        if "error" in found:
            raise (Gone if found.get("is_gone") else Refused)(
                f"{what}: {found['error'].get('message', found['error'])}"
            )
        result: Record = found["result"]
        return result

    def _listen(self, process: "subprocess.Popen[str]") -> None:
        assert process.stdout is not None, "a pipe"
        for line in process.stdout:
            message = json.loads(line)
            if (answer := self._waiting.pop(message.get("id"), None)) is not None:
                answer.put(message)
        process.wait()
        for number in [*self._waiting]:
            ended = f"{' '.join(self._command)} ended with code {process.returncode}; what it printed says why"
            self._waiting.pop(number).put({"error": {"message": ended}, "is_gone": True})


def _read(tool: str, result: Record) -> Record:
    facts: Record = result.get("structuredContent") or {}
    if result.get("isError"):
        found = [
            f"{each.get('code', '')} {each.get('address', '')}: found {each.get('found', '')}"
            + (f"; expected {each['expected']}" if each.get("expected") else "")
            + (f" {each['hint']}" if each.get("hint") else "")
            for each in facts.get("problems", ())
        ]
        raise Refused(" | ".join(found) or f"{tool} failed: {json.dumps(result)[:500]}")
    return facts


class Framework:
    """One workspace: `paos` is the command, `level` how far the tools go, as for `paos mcp`."""

    def __init__(self, paos: str, root: Path, level: str) -> None:
        self.paos, self.root, self.level = paos, root, level
        self.tools = Tools([paos, "mcp", "--workspace", str(root), "--level", level])

    def is_stopped(self) -> bool:
        """Whether the emergency stop is latched."""
        return (self.root / "signals" / "estop.json").exists()

    def stop(self, tool: str, **arguments: Any) -> Record:
        """Call a tool that stops, which waits for no other call; where the tools are gone, the command of that name."""
        try:
            return self.tools.call(tool, patience_s=_STOP_S, **arguments)
        except Gone:
            reason = str(arguments.pop("reason"))
            found: Record = self.run(tool, *map(str, arguments.values()), "--reason", reason)
            return found

    def run(self, *words: str) -> Any:
        """What a short command answers; raises `Refused` where it answers nothing in time."""
        command = [self.paos, *words, "--workspace", str(self.root), "--json"]
        given: Any = {"env": make_environment(), "capture_output": True, "encoding": "utf-8", "timeout": _COMMAND_S}
        try:
            done = subprocess.run(command, check=False, **given)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise Refused(str(error)) from error
        try:
            return json.loads(done.stdout)
        except ValueError:
            raise Refused(" | ".join(done.stderr.splitlines()[-5:])) from None

    def start(self, *words: str, **pipes: Any) -> "subprocess.Popen[str]":
        """Start a long command."""
        return start_kept([self.paos, *words, "--workspace", str(self.root)], **pipes)

    def follow(
        self, on_record: Callable[[Record], object], is_over: threading.Event, say: Callable[[str], object]
    ) -> None:
        """Hand over every record of the journal once, the old ones first, until it is over."""
        seen, command = 0, [self.paos, "store", "follow", str(self.root), "--json"]
        while not is_over.is_set():
            process = start_kept(command, stdout=subprocess.PIPE)
            assert process.stdout is not None, "a pipe"
            for line in process.stdout:
                record = json.loads(line)
                if is_over.is_set():
                    break
                if record["seq"] > seen:
                    seen = record["seq"]
                    on_record(record)
            process.wait()
            if not is_over.is_set():
                say(f"{' '.join(command)} ended with code {process.returncode}; it is started again")
                time.sleep(_AGAIN_S)
