"""The drivers that ship, registered by name; each is imported when it is opened."""

import os

import msgspec

from phyagentos.assembly.paths import FAULTS, STRIKES
from phyagentos.runtime.targets.driver import TargetDriver
from phyagentos.runtime.targets.driver_registry import DriverRegistry, DriverSite, DriverSpec


def build_driver_registry() -> DriverRegistry:
    """What ships, and what installed packages announce."""
    registry = DriverRegistry()
    registry.register("debug", DriverSpec(open=_open_debug, kinds=("debug",), own_process=False))
    registry.register("mujoco", DriverSpec(open=_open_mujoco, kinds=("simulation",)))
    registry.load_plug_ins()
    return registry


def choose_graphics() -> None:
    """Render without a display where there is none; MuJoCo reads this when it is imported."""
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")


def _open_debug(site: DriverSite) -> TargetDriver:
    from phyagentos.runtime.drivers.debug import DebugDriver

    return DebugDriver(site.profile, site.workspace.library())


def _open_mujoco(site: DriverSite) -> TargetDriver:
    choose_graphics()
    from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
    from phyagentos.protocol.settings.sensors import read_sensors
    from phyagentos.protocol.world.faults import read_faults
    from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, Schedule, draw_schedule, read_strikes
    from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
    from phyagentos.runtime.targets.wire import FaultStruck

    workspace = site.workspace
    path, strikes = workspace.root / FAULTS, workspace.root / STRIKES
    file = read_faults(path) if path.exists() else None

    def make_faults(episode: str, seed: int) -> FaultInjector:
        if strikes.exists():
            return FaultInjector(read_strikes(msgspec.json.decode(strikes.read_bytes(), type=list[FaultStruck])))
        return FaultInjector(draw_schedule(file, episode, seed) if file is not None else Schedule())

    world = SimulatedWorld(
        workspace.library(),
        faults=make_faults,
        mode=read_runtime_contract(workspace.runtime_contract).world_mode,
        sensors=read_sensors(workspace.sensors),
    )
    return MujocoDriver(world, site.profile, site.folder)
