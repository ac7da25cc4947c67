"""A world that another workspace serves, behind a network that can fail: what `chaos --remote` attacks.

Upstream: `chaos`. Downstream: the process that serves a target at a WebSocket, and the relay of the tests. A world
that dies is started again, at another port that the relay leads to.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from chaos_planes import change

from phyagentos.assembly.paths import TOKENS
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.handshake import make_key
from tests.faulty_network import FaultyNetwork

DELAY_S = 0.02
SILENCE_S = 3.0
KILL, STOP, DELAY, LOSS, CUT = "kill -9", "SIGSTOP", "delay", "loss", "cut"
CELLS = (*(("network", kind) for kind in (CUT, LOSS, DELAY)), ("served world", STOP), ("served world", KILL))


class Elsewhere:
    """The serving side of the target of a workspace, and the network between both.

    Attributes:
        root: Of the workspace that serves it.
    """

    def __init__(self, near: Path, mode: str) -> None:
        self.root = near.parent / "there"
        there = Workspace.create(self.root, Library.open(Path.cwd()))
        change(there.runtime_contract, there.runtime_contract, r"(?m)^world_mode: \S+", f"world_mode: {mode}")
        self._key = make_key().hex()
        self._log = (near.parent / "served.log").open("ab")
        self._process, port = self._start()
        self.network = FaultyNetwork(port)
        registry = near / "TARGETS.md"
        endpoint = f"endpoint: ws://127.0.0.1:{self.network.port}\nsilence_max_s: {SILENCE_S}"
        change(registry, registry, "(?m)^target: panda$", f"target: panda\ndriver: remote\n{endpoint}")
        secret = near / TOKENS / "panda"
        secret.parent.mkdir(parents=True)
        secret.touch(mode=0o600)
        secret.write_text(self._key)

    def attack(self, kind: str, wait: Callable[[], None]) -> None:
        """Strike, `wait`, and let it be well again."""
        if kind == KILL:
            self._process.kill()
            self._process.wait()
            self._process, self.network.to_port = self._start()
            return
        if kind == STOP:
            self._process.send_signal(signal.SIGSTOP)
        elif kind == CUT:
            self.network.cut()
        else:
            self.network.is_lossy, self.network.delay_s = kind == LOSS, DELAY_S if kind == DELAY else 0.0
        wait()
        self._process.send_signal(signal.SIGCONT)
        self.network.mend()

    def close(self) -> None:
        """End the served world and the network."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGCONT)
        self._process.communicate()
        self.network.close()
        self._log.close()

    def _start(self) -> "tuple[subprocess.Popen[str], int]":
        command = [sys.executable, "-m", "phyagentos.assembly.processes", "world", "--workspace", str(self.root)]
        command += ["--target", "panda", "--socket", "ws://127.0.0.1:0"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._log}
        process = subprocess.Popen(command, text=True, **pipes)
        process.stdin.write(f"panda {self._key}\n")
        process.stdin.flush()
        return process, int(process.stdout.readline().rpartition(":")[2])


@contextlib.contextmanager
def serve_elsewhere(near: Path, mode: str) -> Iterator[Elsewhere]:
    """The target of the workspace `near`, served by another one while the block runs."""
    with contextlib.closing(Elsewhere(near, mode)) as served:
        yield served
