"""What the processes of a run import, for a fork server: in the order in which a run needs them."""

LIBRARIES = (
    "phyagentos.assembly.graphics:choose_graphics",
    "phyagentos.cli.app",
    "phyagentos.cli.running",
    "phyagentos.assembly.agent_plane",
    "phyagentos.assembly.runtime_plane",
    "phyagentos",
    "phyagentos.runtime.drivers.mujoco.shared_target",
    "phyagentos.runtime.targets.server",
    "phyagentos.runtime.targets.served_target",
    "phyagentos.assembly.worker_process",
    "phyagentos.assembly.processes",
    "phyagentos.runtime.motion.planner",
    "phyagentos.runtime.motion.process",
)
WITH_KERNELS = (LIBRARIES[0], "phyagentos.assembly.kernels:load_kernels", *LIBRARIES[1:])  # of many runs, for each fork
