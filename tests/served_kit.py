"""Bodies that the kit serves in processes of their own, and workspaces whose target is served elsewhere."""

import os
import subprocess
import sys
from pathlib import Path

from phyagentos.assembly.paths import TOKENS
from phyagentos.runtime.targets.handshake import make_key
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.testing import ReachedTarget

ROOT = Path(__file__).resolve().parents[1]
KIT = ROOT / "kits" / "target_server"
SLIDE = ROOT / "examples" / "projects" / "05_any_body" / "slide.py"


class Served:
    """Processes of the kit, of one key; `body` is a script, or the text of one, which may import the slide."""

    def __init__(self, folder, body=SLIDE, python=sys.executable, options=(), **environment):
        if isinstance(body, str):
            script = folder / "body.py"
            script.write_text(body)
            body = script
        self.key, self.log, self.stop_file = make_key(), folder / "receive-counter.jsonl", folder / "stop"
        self._command = [python, str(body), "--log", str(self.log), "--stop-file", str(self.stop_file), *options]
        self._environment = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ} | environment
        self._environment["PYTHONPATH"] = f"{KIT}{os.pathsep}{SLIDE.parent}"
        self._processes = []

    def start(self):
        """A fresh process; what it prints."""
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        process = subprocess.Popen(self._command, text=True, env=self._environment, **pipes)
        self._processes.append(process)
        process.stdin.write(f"{self.key.hex()}\n")
        process.stdin.flush()
        return process.stdout.readline().strip()

    def reach(self):
        endpoint = self.start()
        return ReachedTarget(lambda: connect_websocket(endpoint), self.key)

    def set_stop(self, is_stopped):
        self.stop_file.touch() if is_stopped else self.stop_file.unlink(missing_ok=True)

    def close(self):
        """End what is left, as the end of a parent does; each in order."""
        codes = []
        for process in self._processes:
            process.stdin.close()
            codes.append(process.wait(15.0))
            process.stdout.close()
        assert not any(codes), codes


def lead_elsewhere(workspace, target, endpoint, key, more=""):
    """The target of a workspace is the one that is served at an endpoint; the file of its key."""
    registry = workspace.target_registry
    entry = f"target: {target}\ndriver: remote\nendpoint: {endpoint}\n{more}"
    registry.write_text(registry.read_text().replace(f"target: {target}\n", entry))
    secret = workspace.root / TOKENS / target
    secret.parent.mkdir(parents=True)
    secret.touch(mode=0o600)
    secret.write_text(key)
    return secret
