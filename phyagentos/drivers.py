"""What a driver of a target is written with; `phyagentos.drivers` is its entry point group.

    from phyagentos.drivers import DriverSpec, TargetDriver

    class ArmDriver(TargetDriver):
        # Ten methods: what the body is, how it is observed, commanded and brought to rest.

    MY_ARM = DriverSpec(open=lambda site: ArmDriver(site.profile), kinds=("real_robot",))

A target in a program of its own is served by the kit `target_server` instead, in fewer lines.
"""

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Entity, Pose, Region, TargetState
from phyagentos.protocol.world.idealisations import Aspect, Idealisation
from phyagentos.runtime.targets.driver import TargetDriver
from phyagentos.runtime.targets.driver_registry import DriverSite, DriverSpec
from phyagentos.runtime.targets.wire import (
    WIRE_VERSION,
    Artefact,
    Capture,
    Command,
    Description,
    Frames,
    Kinematics,
    Loaded,
    LoadScene,
    Observation,
    RecordedFault,
    Step,
    Tool,
    ToolResult,
)

__all__ = [
    "WIRE_VERSION",
    "Artefact",
    "Aspect",
    "Capture",
    "Command",
    "Description",
    "DriverSite",
    "DriverSpec",
    "Entity",
    "Frames",
    "Idealisation",
    "Kinematics",
    "LoadScene",
    "Loaded",
    "Observation",
    "Pose",
    "RecordedFault",
    "Region",
    "Step",
    "TargetDriver",
    "TargetProfile",
    "TargetState",
    "Tool",
    "ToolResult",
]
