"""A body of `kits/target_server` that the worker starts (`driver: kit`), in a Python of its own if need be.

The profile's settings name its module, found beside the profile or in a kit that ships. Its process is a child of the
worker and ends with it; one that outlives workers is served apart, for `driver: remote`.
"""

import contextlib
import os
import select
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from typing_extensions import override

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.environments import find_python
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets.handshake import greet, make_key, mint
from phyagentos.runtime.targets.websocket import connect_websocket

START_S = 120.0  # a cold interpreter imports a simulator
OUTCOMES = "PHYAGENTOS_OUTCOMES"  # as kits/target_server reads it


class ChildDriver(RemoteDriver):
    """A body in a child process; raises ExecutionError as `RemoteDriver` does."""

    def __init__(
        self, name: str, profile: TargetProfile, channel: Channel, key: bytes, process: "subprocess.Popen[str]"
    ) -> None:
        super().__init__(profile, channel, key)
        self.NAME, self._process = name, process

    @override
    def close(self) -> None:
        super().close()
        self._process.communicate()  # the end of its standard input ends it


def open_kit(profile: TargetProfile, folder: Path, outcomes: Path | None = None) -> ChildDriver:
    """Start the body of the profile in `folder`; raises as `start_body`.

    Its own word of success goes to the file `outcomes`, which its environment names, for who measures.
    Its settings are `module`, and `environment`, what `paos bench setup` has made, or `python`; ours without both.
    """
    settings, place = dict(profile.settings), folder / "target.yaml"
    if not isinstance(module := settings.get("module"), str):
        found = f"settings.module: {module!r}" if module is not None else "no settings.module"
        hint = "Name it: `settings: {module: workbench}`, beside the profile or in kits/; docs/howto/tools.md."
        raise DefinitionError.of("NO_DRIVER", str(place), found, "the module of a body of kits/target_server", hint)
    made = settings.get("environment")
    python = str(settings.get("python", sys.executable) if made is None else find_python(str(made)))
    environment = {}
    if outcomes is not None:
        outcomes.parent.mkdir(parents=True, exist_ok=True)
        environment[OUTCOMES] = str(outcomes.absolute())
    return start_body("kit", profile, (python, "-m", module), place, beside=folder, environment=environment)


def start_body(
    name: str,
    profile: TargetProfile,
    command: Sequence[str],
    place: Path,
    settings: str = "",
    beside: Path | None = None,
    environment: Mapping[str, str] = MappingProxyType({}),
) -> ChildDriver:
    """Start a process that serves a body, and connect to it.

    Args:
        name: Of the driver.
        profile: Of its target.
        command: What starts it: it reads a key and then `settings` from its standard input, and prints its endpoint.
        place: The file that says so, for messages.
        settings: One line.
        beside: A folder where it may import from.
        environment: Variables that it has beside ours.

    Raises:
        DefinitionError: `NO_DRIVER` when its process does not start.
        ExecutionError: `TARGET_LOST` when it ends before it is connected to.
    """
    key, kits = make_key(), sorted(each for each in (find_shipped_root() / "kits").iterdir() if each.is_dir())
    paths = os.pathsep.join(map(str, (*kits, *([beside.absolute()] if beside is not None else []))))
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    try:
        process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": paths, **environment}, **pipes)
    except OSError as error:
        raise _explain(place, f"{command[0]!r}: {error.strerror}") from error
    answer = _read_endpoint(process, f"{key.hex()}\n{settings}\n" if settings else f"{key.hex()}\n")
    if not answer.startswith("ws://"):
        process.kill()
        process.communicate()
        raise _explain(place, answer)
    channel = connect_websocket(answer)
    greet(channel, mint(key))
    return ChildDriver(name, profile, channel, key, process)


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


def _explain(place: Path, found: str) -> DefinitionError:
    return DefinitionError.of(
        "NO_DRIVER",
        str(place),
        found,
        "a process that serves the environment",
        hint="Name an interpreter (`python`), or what `paos bench setup` has made (`environment`): docs/targets.md.",
    )
