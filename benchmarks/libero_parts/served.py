"""The process that serves a benchmark's environment, LIBERO's or CALVIN's, in a Python environment of its own."""

import json
import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import greet, make_key, mint
from phyagentos.runtime.targets.websocket import connect_websocket

KIT = find_shipped_root() / "kits" / "target_server"
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class Server:
    """A process that serves one target.

    Attributes:
        endpoint: `ws://127.0.0.1:PORT`.
        key: Of its tokens.
        outcomes: File to which the benchmark's own scorer appends a line a session.
    """

    endpoint: str
    key: bytes
    outcomes: Path

    def describe(self, profile: TargetProfile, **arguments: Any) -> dict[str, Any]:
        """The task as its environment describes it, by arguments of its tool."""
        channel = connect_websocket(self.endpoint)
        greet(channel, mint(self.key))
        driver = RemoteDriver(profile, channel, self.key)
        try:
            result = driver.carry_out(wire.InvokeTool("describe_scene", arguments))
        finally:
            driver.close()
        found: dict[str, Any] = json.loads(result.artefacts["scene.json"].data)
        return found

    def read_outcomes(self) -> dict[str, dict[str, Any]]:
        """The scorer's lines by session."""
        lines = self.outcomes.read_text().splitlines() if self.outcomes.exists() else []
        return {line["session"]: line for line in map(json.loads, lines)}


def serve(
    python: Path, profile: TargetProfile, scene: str, outcomes: Path, *, draws: bool = False
) -> AbstractContextManager[Server]:
    """LIBERO with a scene loaded, and its graphics open where it `draws`."""
    settings = {"scene": scene, "draws": draws}
    return serve_module("target_server.libero_body", python, profile, settings, outcomes)


@contextmanager
def serve_module(
    module: str, python: Path, profile: TargetProfile, more: Mapping[str, Any], outcomes: Path, *paths: Path
) -> Iterator[Server]:
    """A process of a kit's module; it ends with the block. `more` are settings beside those of every body.

    Raises:
        RuntimeError: With its words, when it fails.
    """
    key = make_key()
    settings = {
        "target": profile.target,
        "velocity_rad_s": profile.arm.velocity_rad_s,
        "outcomes": str(outcomes),
        **more,
    }
    with outcomes.with_suffix(".log").open("ab") as log:
        process = subprocess.Popen(
            [python, "-m", module],
            env={"MUJOCO_GL": "egl"} | os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (KIT, ROOT, *paths)))},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(f"{key.hex()}\n{json.dumps(settings)}\n")
        process.stdin.flush()
        said: list[str] = []
        for line in iter(process.stdout.readline, ""):
            said.append(line.strip())
            if line.startswith("ws://"):
                break
        else:
            raise RuntimeError(f"{python} serves nothing: {said[-1:] or 'no word'}; see {outcomes.with_suffix('.log')}")
        yield Server(said[-1], key, outcomes)
    finally:
        process.stdin.close()
        process.stdout.close()
        process.wait()
