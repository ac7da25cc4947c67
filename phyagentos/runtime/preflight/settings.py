"""The settings files against which sessions are checked, read together.

Upstream: safety.yaml, sensors.yaml, perception.yaml and runtime_contract.yaml of a workspace. Downstream: the checks of
this package.
"""

from dataclasses import dataclass
from typing import TypeVar

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.settings.perception import Perception, read_perception
from phyagentos.protocol.settings.runtime_contract import RuntimeContract, read_runtime_contract
from phyagentos.protocol.settings.safety import TargetLimits, get_target_limits, read_safety
from phyagentos.protocol.settings.sensors import Sensors, read_sensors
from phyagentos.protocol.workspace.workspace import Workspace

ValueT = TypeVar("ValueT")


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What people have set.

    Attributes:
        limits: Of the one target that is checked.
        sensors: What can be observed.
        perception: How observations become facts.
        contract: What both sides of the wire count on.
    """

    limits: TargetLimits
    sensors: Sensors
    perception: Perception
    contract: RuntimeContract


def read_settings(workspace: Workspace, target: str) -> Settings:
    """The settings of a workspace, for one target.

    Raises:
        DefinitionError: With every problem of all four files.
    """
    problems: list[Problem] = []

    def collect(error: DefinitionError) -> None:
        problems.extend(problem for problem in error.problems if problem not in problems)

    limits = sensors = perception = contract = None
    try:
        limits = get_target_limits(read_safety(workspace.safety), target, str(workspace.safety))
    except DefinitionError as error:
        collect(error)
    try:
        sensors = read_sensors(workspace.sensors)
    except DefinitionError as error:
        collect(error)
    try:
        perception = read_perception(workspace.perception)
    except DefinitionError as error:
        collect(error)
    try:
        contract = read_runtime_contract(workspace.runtime_contract)
    except DefinitionError as error:
        collect(error)
    if limits is None or sensors is None or perception is None or contract is None:
        raise DefinitionError(problems)
    return Settings(limits=limits, sensors=sensors, perception=perception, contract=contract)
