"""Compiles what numba compiles, once for a machine and a version of the source, so that no goal waits for it.

A robot plans, its world is looked at and believed, so that each kernel is compiled for the types that sessions pass.
numba keeps machine code in `NUMBA_CACHE_DIR`, else in `__pycache__` beside the source, else, where that cannot be
written, in the user's own cache.
"""

import os.path
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba.core import event
from numba.extending import is_jitted
from typing_extensions import override

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.session import Scene

ROBOT, SCENE = "panda", "tabletop/cubes_and_trays"  # any would do: types differ between none


@dataclass(frozen=True, slots=True)
class Kernels:
    """How many kernels were compiled now, how many were kept from before, and the folder below which they are kept."""

    compiled: int
    kept: int
    folder: str


class _Listener(event.Listener):  # type: ignore[misc]
    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    @override
    def on_start(self, event: "event.Event") -> None:
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith("phyagentos"):
            self._tell(function.__name__.strip("_"))

    @override
    def on_end(self, event: "event.Event") -> None:
        """The next one is told of."""


def compile_kernels(library: Library, tell: Callable[[str], None]) -> Kernels:
    """Compile each kernel that is not kept yet; `tell` is called with its name as that begins.

    Raises:
        RuntimeError: numba found no folder that can be written.
    """
    with event.install_listener("numba:compile", _Listener(tell)):
        _use_kernels(library)
    statistics = [each.stats for each in iter_kernels()]
    return Kernels(
        compiled=sum(sum(each.cache_misses.values()) for each in statistics),
        kept=sum(sum(each.cache_hits.values()) for each in statistics),
        folder=os.path.commonpath([each.cache_path for each in statistics]),
    )


def _use_kernels(library: Library) -> None:
    """One plan, one look through every camera, one belief; the guard's kernels compile at import."""
    import phyagentos.runtime.actions.guard_kernels  # noqa: F401 - numba may refuse when a module is imported
    from phyagentos.protocol.settings.sensors import read_sensors
    from phyagentos.protocol.world.scenes import read_scene
    from phyagentos.runtime.drivers.mujoco.physics import Physics
    from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.motion.planner import MotionPlanner
    from phyagentos.runtime.perception.inventory import build_inventory
    from phyagentos.runtime.perception.pipeline import Pipeline
    from phyagentos.runtime.perception.robot_mask import RobotMask
    from phyagentos.runtime.targets.wire import Frames

    path = library.get_target(ROBOT)
    MotionPlanner.open(path).warm_up()
    profile, folder = read_profile(path)
    spec, sensors = (
        read_scene(library.get_scene(SCENE)),
        read_sensors(find_shipped_root() / "protocol" / "sensors.yaml"),
    )
    physics = Physics.alone(profile, folder, spec, seed=0)
    physics.start(spec.settle_s)
    physics.look()
    cameras, data = open_cameras(physics.model, sensors, seed=0), pose_state(physics.model, physics.data.qpos)
    frames = Frames(tuple(each.capture(data, 1.0, np.random.default_rng(0)) for each in cameras.values()))
    pipeline = Pipeline(build_inventory(spec), RobotMask(profile, folder), ROBOT)
    pipeline.sense(frames, physics.read_target({}), Scene(name=SCENE, seed=0, episode="kernels"), 1.0)


def iter_kernels() -> Iterator[Any]:
    """Every compiled function of this package that was imported, once."""
    modules = [module for name, module in sys.modules.items() if name.startswith("phyagentos.")]
    found = {id(value): value for module in modules for value in vars(module).values() if is_jitted(value)}
    yield from (each for each in found.values() if each.py_func.__module__.startswith("phyagentos."))
