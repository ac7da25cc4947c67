"""What the processes of a run import, for a fork server: in the order in which a run needs them.

A large library stands before what imports it: the server forks between two of these, not while it loads one.
"""

LIBRARIES = (
    "phyagentos.assembly.graphics:choose_graphics",
    "phyagentos.cli.app",
    "phyagentos.cli.running",
    "networkx",
    "phyagentos.assembly.agent_plane",
    "phyagentos.assembly.runtime_plane",
    "phyagentos",
    "numba",
    "phyagentos.assembly.kernels:open_compiler",
    "phyagentos.runtime.drivers.mujoco.shared_target",
    "phyagentos.runtime.targets.server",
    "phyagentos.runtime.targets.served_target",
    "phyagentos.assembly.processes",
    "scipy.sparse.csgraph",
    "scipy.spatial",
    "phyagentos.runtime.perception.perceived_world",
    "phyagentos.assembly.worker_process",
    "scipy.optimize",
    "scipy.interpolate",
    "phyagentos.runtime.motion.planner",
    "phyagentos.runtime.motion.process",
)
WITH_KERNELS = (LIBRARIES[0], "phyagentos.assembly.kernels:load_kernels", *LIBRARIES[1:])  # of many runs, for each fork
