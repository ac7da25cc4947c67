"""Any Gymnasium environment as a target (`driver: gymnasium`), in a Python environment of its own.

`gymnasium.yaml` beside the target's profile names the environment, its interpreter, and how set-points become actions.
Its process is a child of the worker and ends with it; one that outlives workers is served apart, for `driver: remote`.
"""

import contextlib
import json
import os
import select
import subprocess
from pathlib import Path
from typing import Any

from typing_extensions import override

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.environments import find_python
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets.handshake import greet, make_key, mint
from phyagentos.runtime.targets.websocket import connect_websocket

SETTINGS = "gymnasium.yaml"
START_S = 120.0  # a cold interpreter imports a simulator


class GymnasiumDriver(RemoteDriver):
    """One environment; raises ExecutionError as `RemoteDriver` does."""

    NAME = "gymnasium"

    def __init__(self, profile: TargetProfile, channel: Channel, key: bytes, process: "subprocess.Popen[str]") -> None:
        super().__init__(profile, channel, key)
        self._process = process

    @override
    def close(self) -> None:
        super().close()
        self._process.communicate()  # the end of its standard input ends it


def open_gymnasium(profile: TargetProfile, folder: Path, outcomes: Path | None = None) -> GymnasiumDriver:
    """Start the environment and connect to it; its own success goes to the file `outcomes`, for who measures.

    Raises:
        DefinitionError: `NO_DRIVER` when its process does not start.
        ExecutionError: `TARGET_LOST` when it ends before it is connected to.
    """
    path, key = folder / SETTINGS, make_key()
    data: Any = read_yaml(path).data
    if not isinstance(data, dict):
        raise _explain(path, "no mapping")
    settings = data | {"target": profile.target, "step_s": profile.physics_step_s}
    settings["steps_per_command"] = round(profile.control_period_s / profile.physics_step_s)
    if outcomes is not None:
        outcomes.parent.mkdir(parents=True, exist_ok=True)
        settings.setdefault("outcomes", str(outcomes.absolute()))
    kit = find_shipped_root() / "kits" / "target_server"
    made = settings.pop("environment", None)
    python = settings.pop("python", "python3") if made is None else str(find_python(made))
    command = [python, "-m", "target_server.gymnasium_body"]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    try:
        process = subprocess.Popen(command, env=os.environ | {"PYTHONPATH": str(kit)}, **pipes)
    except OSError as error:
        raise _explain(path, f"{command[0]!r}: {error.strerror}") from error
    answer = _read_endpoint(process, f"{key.hex()}\n{json.dumps(settings)}\n")
    if not answer.startswith("ws://"):
        process.kill()
        process.communicate()
        raise _explain(path, answer)
    channel = connect_websocket(answer)
    greet(channel, mint(key))
    return GymnasiumDriver(profile, channel, key, process)


def _read_endpoint(process: "subprocess.Popen[str]", lines: str) -> str:
    """What the process answers to its key and settings: its endpoint, or why there is none."""
    assert process.stdin is not None
    assert process.stdout is not None
    with contextlib.suppress(BrokenPipeError):
        process.stdin.write(lines)
        process.stdin.flush()
    if not select.select([process.stdout], [], [], START_S)[0]:
        return f"no endpoint within {START_S:g} s"
    return process.stdout.readline().strip() or f"exit status {process.wait()}; the worker's log has its words"


def _explain(path: Path, found: str) -> DefinitionError:
    return DefinitionError.of(
        "NO_DRIVER",
        str(path),
        found,
        "a process that serves the environment",
        hint="Name an interpreter (`python`), or what `paos bench setup` has made (`environment`): docs/targets.md.",
    )
