"""Compiles what numba compiles, once for a machine and a version of the source, so that no goal waits for it.

A robot plans, its world is looked at and believed: each kernel is compiled for the types that sessions pass. numba
keeps it in `NUMBA_CACHE_DIR`, or beside the source, or, where that cannot be written, in the user's own cache.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba.core import event
from numba.core.registry import cpu_target
from typing_extensions import override

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.session import Scene

ROBOT, SCENE = "panda", "tabletop/cubes_and_trays"  # any would do: types differ between none


@dataclass
class _Listener(event.Listener):  # type: ignore[misc]
    tell: Callable[[str], None]

    @override
    def on_start(self, event: "event.Event") -> None:
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith("phyagentos"):
            self.tell(function.__name__.strip("_"))

    @override
    def on_end(self, event: "event.Event") -> None:
        """Announces the next one."""


def open_compiler() -> None:
    """Load what numba needs before its first kernel, compiled or kept: 0.2 s, which forks of this process share."""
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


def load_kernels() -> None:
    """Load, or compile, each kernel into this process."""
    _use_kernels(Library.open())


def compile_kernels(library: Library, tell: Callable[[str], None]) -> str:
    """Compile each kernel that is not kept yet; `tell` is called with its name as that begins.

    Returns where those of planning are kept; RuntimeError where numba found no folder that can be written.
    """
    with event.install_listener("numba:compile", _Listener(tell)):
        return _use_kernels(library)


def _use_kernels(library: Library) -> str:
    """One plan, no step, one look through every camera, one belief."""
    from phyagentos.protocol.settings.sensors import read_sensors
    from phyagentos.protocol.world.scenes import read_scene
    from phyagentos.runtime.drivers.mujoco.local_limits import LocalLimits
    from phyagentos.runtime.drivers.mujoco.physics import Physics
    from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
    from phyagentos.runtime.drivers.mujoco.stride import Strider
    from phyagentos.runtime.models.robot import count_steps, read_profile
    from phyagentos.runtime.motion.chain import compute_links
    from phyagentos.runtime.motion.planner import MotionPlanner
    from phyagentos.runtime.perception.inventory import build_inventory
    from phyagentos.runtime.perception.pipeline import Pipeline
    from phyagentos.runtime.perception.robot_mask import RobotMask
    from phyagentos.runtime.targets.wire import Frames

    profile, folder = read_profile(library.get_target(ROBOT))
    MotionPlanner(profile, folder).warm_up()
    sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
    spec = read_scene(library.get_scene(SCENE))
    physics = Physics.alone(profile, folder, spec, seed=0)
    Strider(physics, LocalLimits(profile, physics, count_steps(profile)))
    physics.start(spec.settle_s)
    physics.queries.look()
    cameras, data = open_cameras(physics.model, sensors, seed=0), pose_state(physics.model, physics.data.qpos)
    frames = Frames(tuple(each.capture(data, 1.0, np.random.default_rng(0)) for each in cameras.values()))
    pipeline = Pipeline(build_inventory(spec), RobotMask(profile, folder), ROBOT)
    pipeline.sense(frames, physics.queries.read_target({}), Scene(name=SCENE, seed=0, episode="kernels"), 1.0)
    return str(compute_links.stats.cache_path)
