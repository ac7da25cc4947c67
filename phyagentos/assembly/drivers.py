"""The shipped drivers by name; each is imported when it is opened."""

import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from phyagentos.assembly.graphics import choose_graphics
from phyagentos.assembly.paths import FAULTS, OUTCOMES, RECORDED_FAULTS, TOKENS
from phyagentos.errors import DefinitionError, ExecutionError, raise_any
from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.targets import TargetProfile, find_unshared
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.driver_registry import ENTRY_POINT_GROUP, DriverSite, DriverSpec, find_driver
from phyagentos.runtime.targets.handshake import KEY_BYTES

if TYPE_CHECKING:
    from phyagentos.runtime.drivers.mujoco.simulation import ReadAgreement
    from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
    from phyagentos.runtime.targets.driver import TargetPort


def choose_driver(targets: Mapping[str, TargetProfile], target: str) -> DriverSpec:
    """The driver that moves a target of TARGETS.md; raises DefinitionError: `NO_DRIVER`, `WORLD_CONFLICT`."""
    spec, world = find_driver(DRIVERS, targets[target]), targets[target].world
    raise_any(find_unshared([each for each in targets.values() if world and each.world == world]))
    return spec


def _open_debug(site: DriverSite) -> "TargetPort":
    from phyagentos.runtime.drivers.debug import DebugDriver

    return DebugDriver(site.profile, site.workspace.library())


def open_shared_world(sites: Sequence[DriverSite], read_agreement: "ReadAgreement | None") -> "list[MujocoDriver]":
    """The robots of a world that several targets share; raises `WORLD_CONFLICT` for one that is no MuJoCo simulation.

    `read_agreement` reports the sessions that run; None in real time.
    """
    raise_any(find_unshared([site.profile for site in sites]))
    world = _open_world(sites[0].workspace, read_agreement)
    return [_open_robot(world, site) for site in sites]


def _open_robot(world: "SimulatedWorld", site: DriverSite) -> "MujocoDriver":
    from phyagentos.runtime.drivers.mujoco.world import MujocoDriver

    if site.profile.end_effector == "suction":
        found = repr(site.profile.end_effector)
        expected = "'opening' or 'none', for driver 'mujoco'"
        hint = "Name a driver that moves such a hand, or give the model a gripper."
        raise DefinitionError.of("NO_DRIVER", f"{site.profile.target}/target.yaml: end_effector", found, expected, hint)
    return MujocoDriver(world, site.profile, site.folder)


def _open_world(workspace: Workspace, read_agreement: "ReadAgreement | None" = None) -> "SimulatedWorld":
    choose_graphics()
    from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
    from phyagentos.protocol.settings.sensors import read_sensors
    from phyagentos.protocol.world.faults import read_faults
    from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, Schedule, draw_schedule, read_activations
    from phyagentos.runtime.drivers.mujoco.world import SimulatedWorld
    from phyagentos.runtime.targets.wire import RecordedFault

    path, recorded = workspace.root / FAULTS, workspace.root / RECORDED_FAULTS
    file = read_faults(path) if path.exists() else None

    def make_faults(episode: str, seed: int) -> FaultInjector:
        if recorded.exists():
            return FaultInjector(read_activations(msgspec.json.decode(recorded.read_bytes(), type=list[RecordedFault])))
        return FaultInjector(draw_schedule(file, episode, seed) if file is not None else Schedule())

    return SimulatedWorld(
        workspace.library(),
        faults=make_faults,
        mode=read_runtime_contract(workspace.runtime_contract).world_mode,
        sensors=read_sensors(workspace.sensors),
        read_agreement=read_agreement,
    )


def _open_remote(site: DriverSite) -> "TargetPort":
    from phyagentos.runtime.drivers.remote import RemoteDriver
    from phyagentos.runtime.targets.handshake import greet, mint
    from phyagentos.runtime.targets.websocket import connect_websocket

    path = site.workspace.root / TOKENS / site.profile.target
    key = read_secret(path)
    trusted = path.with_name(f"{path.name}.pem")
    channel = connect_websocket(site.profile.endpoint, trusted if trusted.exists() else None)
    try:
        greet(channel, mint(key))
    except ExecutionError as error:
        channel.close()
        if error.code == "TARGET_LOST":
            where = f"{site.profile.target!r} at {site.profile.endpoint}"
            raise ExecutionError(error.code, f"{where}: {error.message}") from error
        raise DefinitionError.of(error.code, str(path), str(error)) from error
    return RemoteDriver(site.profile, channel, key)


def _open_gymnasium(site: DriverSite) -> "TargetPort":
    from phyagentos.runtime.drivers.gymnasium import open_gymnasium

    choose_graphics()
    return open_gymnasium(site.profile, site.folder, site.workspace.root / OUTCOMES)


def _open_kit(site: DriverSite) -> "TargetPort":
    from phyagentos.runtime.drivers.kit import open_kit

    return open_kit(site.profile, site.folder, site.workspace.root / OUTCOMES)


def read_secret(path: Path) -> bytes:
    """The key of a remote target, in hexadecimal digits, from a file of its owner alone; raises `NOT_SECURED`."""
    try:
        is_private = not path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)
        key = bytes.fromhex(path.read_text(encoding="ascii").strip()) if is_private else b""
    except (OSError, ValueError):
        is_private, key = True, b""
    if len(key) == KEY_BYTES:
        return key
    found = "no key" if is_private else "a file that other users can read"
    hint = "Write the key that the serving side was started with there, with mode 0600."
    expected = f"{2 * KEY_BYTES} hexadecimal digits"
    raise DefinitionError.of("NOT_SECURED", str(path), found, expected, hint)


DRIVERS = Plugins[DriverSpec](
    ENTRY_POINT_GROUP,
    {
        "debug": DriverSpec(open=_open_debug, kinds=("debug",), own_process=False),
        "mujoco": DriverSpec(open=lambda site: _open_robot(_open_world(site.workspace), site), kinds=("simulation",)),
        "remote": DriverSpec(open=_open_remote, kinds=("simulation", "real_robot", "debug"), own_process=False),
        "gymnasium": DriverSpec(open=_open_gymnasium, kinds=("simulation",), own_process=False),
        "kit": DriverSpec(open=_open_kit, kinds=("simulation",), own_process=False),
    },
    kind=DriverSpec,
)
"""Shipped drivers and those of installed packages; each is imported when it is opened."""
