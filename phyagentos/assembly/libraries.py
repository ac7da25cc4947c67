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
KERNELS = "phyagentos.assembly.kernels:load_kernels"  # compiled ones; first, where many runs share what is loaded
